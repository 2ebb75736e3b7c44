"""An FMU on another machine: the time of a step, and how many bytes go over."""

from __future__ import annotations

import dataclasses
import logging
import statistics
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measure import Section, interleaved
from benchmarks.system import STEP, disturbed
from cosim import Simulation, System
from tests.support.small_fmus import compiled

ROUNDS = 3

#: Simulated time (s), and bytes that an FMU gets and gives at each step.
STOP_TIME, LARGE = 0.5, 120_000


def measure_placement(folder: Path) -> Section:
    """The robot, and an FMU with large values, on a worker of a cluster on this machine."""
    from distributed import LocalCluster

    local = LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL
    )
    with TemporaryDirectory() as fmus, local as cluster:
        place = next(iter(cluster.scheduler.workers))
        robot = disturbed().system(folder, "fmi2")
        placed = {"plant": dataclasses.replace(robot.components["plant"], place=place)}
        robot = dataclasses.replace(robot, components={**robot.components, **placed})
        large = System()
        large.add("large", compiled(Path(fmus), "fmi3_types"), {"Binary": bytes(LARGE)}, place=place)
        steps = round(STOP_TIME / STEP)
        with (
            Simulation(robot, scheduler=cluster.scheduler_address) as one,
            Simulation(large, record=["large.Binary_out"], scheduler=cluster.scheduler_address) as two,
        ):
            seconds = interleaved(
                {
                    "the robot": lambda: float(one.run(STOP_TIME, STEP).info["loop_time_s"]) / steps,
                    "large values": lambda: float(two.run(1.0, 0.1).info["loop_time_s"]) / 10,
                },
                ROUNDS,
            )
    medians = {what: statistics.median(values) for what, values in seconds.items()}
    return Section(
        "FMUs on another machine",
        "An FMU on a worker of a Dask cluster, whose scheduler and worker are processes on this machine: what the way "
        f"there costs without a network. The FMU with large values gives {LARGE / 1e3:g} kB at each step. Medians of "
        f"{ROUNDS} runs.",
        ("system", "ms a step", "MB/s"),
        [
            ("the robot", f"{medians['the robot'] * 1e3:.1f}", ""),
            ("large values", f"{medians['large values'] * 1e3:.1f}", f"{LARGE / medians['large values'] / 1e6:.0f}"),
        ],
        {"seconds": seconds},
    )
