"""Our loop against one C program of the same arithmetic, and against the pythonfmu FMUs' own time."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.bare import bare_time
from benchmarks.measure import Section, interleaved, ratio
from benchmarks.monolith import COLUMNS, Monolith
from benchmarks.system import STEP, STOP_TIME, disturbed
from cosim import Simulation, System
from parallel_robot.fmus import fmu_path

ROUNDS = 51


def loop_time(simulation: Simulation) -> Callable[[], float]:
    """A run that returns the time of its loop."""
    return lambda: float(simulation.run(STOP_TIME, STEP).info["loop_time_s"])


def measure_loop(folder: Path) -> Section:
    """Native FMUs against the monolith."""
    scenario, monolith, shared, n = disturbed(), Monolith(), Monolith("shared"), round(STOP_TIME / STEP)
    with (
        Simulation(scenario.system(folder, "fmi2"), extrapolation="linear") as linear,
        Simulation(scenario.system(folder, "fmi2"), extrapolation="hold") as held,
        Simulation(scenario.system(folder, "fmi3"), extrapolation="linear") as version_3,
    ):
        results = linear.run(STOP_TIME, STEP)
        signals = np.column_stack([results["plant.tau_d"], results["plant.dm"]])
        jumps = np.zeros(n + 1, dtype=np.uint8)
        jumps[[0, round(4.0 / STEP)]] = 1  # the start, and where the disturbance sets in

        def one_program(program: Monolith) -> float:
            began = time.perf_counter()
            program.run(n, STEP, signals, jumps)
            return time.perf_counter() - began

        def whole_run() -> float:
            began = time.perf_counter()
            linear.run(STOP_TIME, STEP)
            return time.perf_counter() - began

        record = monolith.run(n, STEP, signals, jumps)
        difference = max(np.abs(record[:, i] - results[name]).max() for i, name in enumerate(COLUMNS))
        seconds = interleaved(
            {
                "one C program, inputs linear": lambda: one_program(monolith),
                "one C program, outputs and derivatives computed together": lambda: one_program(shared),
                "our master, FMI 2, inputs linear": loop_time(linear),
                "our master, FMI 2, inputs held": loop_time(held),
                "our master, FMI 3, inputs linear (intermediate update)": loop_time(version_3),
                "a whole Simulation.run, FMI 2, inputs linear": whole_run,
            },
            ROUNDS,
        )
    plain, shared_name, ours, *_, whole = seconds
    against = {name: ratio(values, seconds[plain]) for name, values in seconds.items()}
    to_shared = ratio(seconds[ours], seconds[shared_name])
    rate = 1.0 / statistics.median(seconds[whole])
    return Section(
        "Our loop against one C program",
        f"15 s at 1 ms, mass change and disturbance, {len(COLUMNS)} values recorded at each point; medians of {ROUNDS} "
        "interleaved runs. The C program is generated from the same models, a file each, and gives the same numbers "
        f"(largest difference {difference:.1e}). It calls the models' functions one after the other; the FMUs compute "
        "outputs and derivatives at a point together, and so does the program of the second row.",
        ("what", "ms a run", "us a step", "ratio"),
        [
            (n, f"{statistics.median(v) * 1e3:.1f}", f"{statistics.median(v) / 15e-3:.2f}", f"{against[n]:.2f}")
            for n, v in seconds.items()
        ],
        {"seconds": seconds, "ratios": against, "runs_per_second": rate},
        [
            (f"our master / one C program: {against[ours]:.2f}, at most 1.25", against[ours] <= 1.25),
            (f"our master / the program of the second row: {to_shared:.2f}, at most 1.25", to_shared <= 1.25),
            (f"complete runs a second through Simulation.run: {rate:.1f}, at least 30", rate >= 30.0),
        ],
    )


def measure_pythonfmu(folder: Path) -> Section:
    """The pythonfmu flavour: our master against the FMUs called in a bare loop."""
    scenario, steps = disturbed(), 2000
    with Simulation(scenario.system(folder, "pythonfmu")) as simulation:

        def ours() -> float:
            return float(simulation.run(steps * STEP, STEP).info["loop_time_s"])

        seconds = interleaved({"our master": ours, "bare loop": lambda: bare_time(folder, "pythonfmu", steps)}, 7)
    against = ratio(seconds["our master"], seconds["bare loop"])
    return Section(
        "With pythonfmu FMUs",
        f"{steps} steps of the same system; the bare loop makes the same calls (set inputs, do step, get outputs) with "
        "constant inputs and nothing between them. Medians of 7 interleaved runs.",
        ("what", "us a step"),
        [(n, f"{statistics.median(v) / steps * 1e6:.1f}") for n, v in seconds.items()],
        {"seconds": seconds, "ratio": against},
        [(f"our master / the FMUs alone: {against:.2f}, at most 1.1", against <= 1.1)],
    )


def measure_stepping(folder: Path) -> Section:
    """A run that is stepped by hand, with the robot's vectors read and set at each communication point.

    And one in which a function does the same inside the loop.
    """
    steps = 5000
    system, closed = System(), System()
    for either in (system, closed):
        either.add("plant", fmu_path(folder, "fmi2", "plant"), start={"tau_a": [0, 0, 0], "tau_d": [0, 0, 0], "dm": 0})
    closed.add_function("law", lambda t, omega: -0.1 * omega, inputs={"omega": 3}, outputs={"tau": 3})
    closed.connect("plant.omega_a", "law.omega")
    closed.connect("law.tau", "plant.tau_a")
    with Simulation(system) as simulation, Simulation(closed, extrapolation="hold") as with_function:

        def loop(simulation: Simulation) -> float:
            return float(simulation.run(steps * STEP, STEP).info["loop_time_s"])

        def by_hand(*, exchanging: bool) -> float:
            with simulation.start(step_size=STEP) as run:
                began = time.perf_counter()
                for _ in range(steps):
                    if exchanging:
                        run["plant.tau_a"] = -0.1 * run["plant.omega_a"]
                    run.step()
                return time.perf_counter() - began

        parts = {
            "the compiled loop": lambda: loop(simulation),
            "the compiled loop, with a function": lambda: loop(with_function),
            "step": lambda: by_hand(exchanging=False),
            "get, set, step": lambda: by_hand(exchanging=True),
        }
        seconds = interleaved(parts, 7)
    median = {name: statistics.median(values) / steps * 1e6 for name, values in seconds.items()}
    more = median["get, set, step"] - median["the compiled loop"]
    return Section(
        "Stepped by hand",
        f"The robot alone, {steps} steps of 1 ms, all inputs and outputs recorded: `Simulation.run` against "
        "`Simulation.start` with a step at a time, and with three velocities read and three torques set at each point; "
        "and against a function in Python that computes the torques from the velocities inside the loop. "
        "Medians of 7 interleaved runs.",
        ("what", "us a step"),
        [(name, f"{value:.1f}") for name, value in median.items()],
        {"seconds": seconds, "above_the_loop_us": more},
        [(f"get, set, step above the compiled loop: {more:.1f} us, at most 15", more <= 15.0)],
    )
