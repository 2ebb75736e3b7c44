"""Components stepped at the same time by a team of threads, and one after the other."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from benchmarks.measure import Section, interleaved, ratio
from benchmarks.system import STEP, STOP_TIME, disturbed
from cosim import Simulation, System
from cosim.loop.team import Threads
from fmu_export import ModelClass, build_native, input, parameter, state
from interop.tools.case import Case
from interop.tools.launch import package_version, run_tool, tool

ROUNDS = 15

#: Masters that step components at the same time, too.
PEERS = ("libcosim", "ecos")

#: A step of some milliseconds: communication step and internal step (s), and number of steps of a run.
LONG, INTERNAL, STEPS = 1e-2, 1e-6, 60


class Oscillator(ModelClass, name="Oscillator"):
    """A Van der Pol oscillator; with a short internal step it stands for an FMU that computes much."""

    mu = parameter(1.0, "1")
    u = input(0.0, "1")
    x = state(2.0, "1")
    v = state(0.0, "1")

    def derivatives(m):  # type: ignore[no-untyped-def] # noqa: D102, N805
        return {"x": m.v, "v": m.mu * (1.0 - m.x * m.x) * m.v - m.x + 0.1 * m.u}


def oscillators(fmu: Path, n: int) -> System:
    """A ring of oscillators."""
    system = System()
    for i in range(n):
        system.add(f"o{i}", fmu, start={"max_step": INTERNAL, "mu": 1.0 + 0.1 * i})
    for i in range(n):
        system.connect(f"o{i}.x", f"o{(i + 1) % n}.u")
    return system


def case_of(fmu: Path, n: int) -> Case:
    """The same ring for other masters."""
    start = {f"o{i}": {"max_step": INTERNAL, "mu": 1.0 + 0.1 * i} for i in range(n)}
    connections = [(f"o{i}.x", f"o{(i + 1) % n}.u") for i in range(n)]
    recorded = [f"o{i}.x" for i in range(n)]
    return Case(dict.fromkeys(start, fmu), connections, start, STEPS * LONG, LONG, recorded, ("o0.x", "o1.x"))


def peers() -> dict[str, str]:
    """Those that can run here, with their versions."""
    return {name: package_version(name) for name in PEERS if tool(name).unavailable() is None}


def measure_threads(folder: Path) -> Section:
    """Two and four oscillators of some milliseconds a step, and the robot, of some microseconds."""
    with tempfile.TemporaryDirectory() as scratch, ExitStack() as stack:
        fmu = build_native(Oscillator, Path(scratch), "fmi2")

        def timed(system: System, stop_time: float, step: float, threads: Threads) -> Callable[[], float]:
            simulation = stack.enter_context(Simulation(system, threads=threads))
            return lambda: float(simulation.run(stop_time, step).info["loop_time_s"])

        variants: dict[str, Callable[[], float]] = {}
        others = peers()
        for n in (2, 4):
            for threads in (1, 2, "auto"):
                run = timed(oscillators(fmu, n), STEPS * LONG, LONG, threads)
                variants[f"{n} oscillators, threads {threads}"] = run
            for name, version in others.items():
                variants[f"{n} oscillators, {version}"] = lambda name=name, n=n: (
                    run_tool(  # type: ignore[misc]
                        name, case_of(fmu, n)
                    ).loop_time_s
                )
        for threads in (1, "auto"):
            variants[f"robot, threads {threads}"] = timed(disturbed().system(folder, "fmi2"), STOP_TIME, STEP, threads)
        seconds = interleaved(variants, ROUNDS)
    gains = {
        f"{what}, threads {threads}": ratio(seconds[f"{what}, threads 1"], seconds[f"{what}, threads {threads}"])
        for what in ("2 oscillators", "4 oscillators", "robot")
        for threads in (2, "auto")
        if f"{what}, threads {threads}" in seconds
    }
    gains |= {
        f"{what}, {version}": ratio(seconds[f"{what}, threads 1"], seconds[f"{what}, {version}"])
        for what in ("2 oscillators", "4 oscillators")
        for version in others.values()
    }
    cost = 1.0 / gains["robot, threads auto"]
    return Section(
        "Several cores",
        "Components stepped at the same time, and one after the other, with equal bits: two and four FMUs whose steps "
        f"take milliseconds, and the robot's three, whose take microseconds. Medians of {ROUNDS} interleaved runs. "
        "Others step the same FMUs by as many threads as there are cores; theirs is the time of steps and recording.",
        ("what", "ms a run", "times as fast as one thread"),
        [(n, f"{statistics.median(v) * 1e3:.1f}", f"{gains.get(n, 1.0):.2f}") for n, v in seconds.items()],
        {"seconds": seconds, "gains": gains},
        [
            (
                f"two FMUs, two threads / one: {gains['2 oscillators, threads 2']:.2f}, at least 1.8",
                gains["2 oscillators, threads 2"] >= 1.8,
            ),
            (f"the robot, time of auto / one thread: {cost:.3f}, at most 1.02", cost <= 1.02),
        ],
    )
