"""FMUs in processes of their own, and in this one."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from benchmarks.measure import Section, interleaved
from benchmarks.system import STEP, STOP_TIME, disturbed
from cosim import Simulation

ROUNDS = 9

#: Largest cost (us) of a communication step and FMU.
LARGEST = 10.0

#: What is isolated, and how many FMUs that are.
ISOLATED: dict[str, tuple[bool | tuple[str, ...], int]] = {
    "nothing": (False, 0),
    "the robot": (("plant",), 1),
    "robot and controller": (("plant", "controller"), 2),
    "all three": (True, 3),
}


def measure_isolation(folder: Path) -> Section:
    """The robot with one, two and three of its FMUs isolated."""
    with ExitStack() as stack:

        def timed(isolate: bool | tuple[str, ...]) -> Callable[[], float]:
            system = disturbed().system(folder, "fmi2")
            simulation = stack.enter_context(Simulation(system, isolate=isolate))
            return lambda: float(simulation.run(STOP_TIME, STEP).info["loop_time_s"])

        seconds = interleaved({what: timed(isolate) for what, (isolate, _) in ISOLATED.items()}, ROUNDS)
    steps = STOP_TIME / STEP
    plain = min(seconds["nothing"])
    costs = {what: (min(seconds[what]) - plain) / steps / n * 1e6 for what, (_, n) in ISOLATED.items() if n}
    return Section(
        "Isolated FMUs",
        "The robot's three FMUs, some of them in processes of their own, with equal bits. What isolation costs is the "
        f"time beyond that of the run without, by step and isolated FMU; the best of {ROUNDS} interleaved "
        "runs, for a core that others want makes each round trip wait.",
        ("isolated", "ms a run, median", "best", "us a step and FMU"),
        [
            (
                what,
                f"{statistics.median(values) * 1e3:.1f}",
                f"{min(values) * 1e3:.1f}",
                f"{costs[what]:.1f}" if what in costs else "",
            )
            for what, values in seconds.items()
        ],
        {"seconds": seconds, "costs": costs},
        [
            (f"{what}: {cost:.1f} us a step and FMU, at most {LARGEST:g}", cost <= LARGEST)
            for what, cost in costs.items()
        ],
    )
