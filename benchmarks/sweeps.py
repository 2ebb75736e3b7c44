"""Sweeps on this machine's cores against plain loops of `Simulation.run`."""

from __future__ import annotations

import statistics
from pathlib import Path

from benchmarks.measure import Section, ratio
from benchmarks.sweep_throughput import CORES, on_disk, rates
from parallel_robot.scenario import load_scenario
from parallel_robot.sweep import robot_study

#: Runs of a sweep for each worker.
POINTS, ROUNDS = 300, 5

ROWS = 100_000


def measure_sweeps(folder: Path) -> Section:
    """Rates of sweeps with one worker and with all, and how fast results are read."""
    study, files = robot_study({"tracking": load_scenario("tracking")}, folder, ["fmi2"])
    found = rates(study, files, POINTS, ROUNDS)
    bare, one, bares, many = found.values()
    more, machine = ratio(many, one), ratio(bares, bare)
    of_bare = statistics.median(b / a / CORES for a, b in zip(bare, many, strict=True))
    of_bares = ratio(many, bares)
    disk = on_disk(ROWS)
    reading = disk["reading 100 files of 1,000 rows, s"]
    return Section(
        "Sweeps",
        f"Runs of 15 s at 1 ms, {POINTS} for each worker, in {ROUNDS} interleaved rounds; each round also runs plain "
        "loops of `Simulation.run` that record the same, in one process and in one for each core at once, which shows "
        "what the machine gives.",
        ("what", "runs a second"),
        [(way, f"{statistics.median(values):.1f}") for way, values in found.items()],
        {"rates": found, "of bare loops": of_bare, "of bare loops at once": of_bares, "disk": disk},
        [
            (
                f"{CORES} workers / 1 worker: {more:.2f}, at least {0.9 * CORES:.1f} (loops: {machine:.2f})",
                more >= 0.9 * CORES,
            ),
            (
                f"{CORES} workers / {CORES} times the bare loop: {of_bare:.0%}, at least 75 % (of bare loops at once: "
                f"{of_bares:.0%})",
                of_bare >= 0.75,
            ),
            (f"{ROWS:,} rows read back: {reading:.2f} s, under 1 s", reading < 1.0),
        ],
    )
