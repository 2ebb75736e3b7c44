"""Our master against others on the same FMU files: equal work, and time to equal accuracy."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from benchmarks.measure import Section, ratio
from benchmarks.system import STEP, STOP_TIME, case, undisturbed
from cosim import Simulation
from interop.tools.launch import ToolFailed, package_version, run_tool, tool
from tests.support.continuous_loop import end_effector, solve

#: Masters of `interop.tools`, in the order of the table.
PEERS = (
    "fmpy_loop",
    "fmpy_container",
    "fmu_toolbox",
    "fmu_toolbox_sequential",
    "ecos",
    "libcosim",
    "fmi4j",
    "cofmupy",
    "pathsim",
    "fmipp",
    "omsimulator",
    "pyfmi",
)
ROUNDS = 5
#: Masters that are near the fastest one, by this factor, take part in more rounds.
MORE_ROUNDS, NEAR = 15, 2.0
ACCURACY = 1e-6  # m
#: Peers that take longer than this (s) for one run of the time to accuracy are left out of it, with the reason.
PATIENCE = 60.0
#: Those that take less are run several times.
QUICK = 3.0
#: Our short runs are repeated for so long (s); the others' take about as long.
WARM = 1.0
EVERY = 0.06  # s, where paths are compared: points of all steps used


def available() -> tuple[list[str], dict[str, str]]:
    """Peers that can run here, and why the others can't."""
    reasons = {name: tool(name).unavailable() for name in PEERS}
    return [n for n, r in reasons.items() if r is None], {n: r for n, r in reasons.items() if r is not None}


def reference_path() -> np.ndarray:
    """End effector (n, 2) of the continuous loop, every `EVERY` seconds."""
    times = np.arange(round(STOP_TIME / EVERY) + 1) * EVERY
    return end_effector(solve(times, lambda _: np.zeros(5), [], rtol=1e-11))


def error(times: np.ndarray, path: np.ndarray, reference: np.ndarray) -> float:
    """Largest distance (m) from the continuous loop."""
    points = np.round(times / EVERY).astype(int)
    compared = np.abs(times - points * EVERY) < 1e-9
    return float(np.hypot(*(path[compared] - reference[points[compared]]).T).max())


def measure_masters(folder: Path) -> list[Section]:
    """Equal work, then equal accuracy."""
    peers, missing = available()
    reference = reference_path()
    with (
        Simulation(undisturbed(folder), extrapolation="hold") as held,
        Simulation(undisturbed(folder), extrapolation="linear") as linear,
        Simulation(undisturbed(folder), extrapolation="linear", record=["plant.x_E", "plant.y_E"]) as path_only,
    ):

        def ours(
            simulation: Simulation, step: float = STEP, start: Mapping[str, float] | None = None
        ) -> Callable[[], tuple[float, float]]:
            def run() -> tuple[float, float]:
                r = simulation.run(STOP_TIME, step, start=start)
                path = np.column_stack([r["plant.x_E"], r["plant.y_E"]])
                return r.info["loop_time_s"], error(r.time, path, reference)

            return run

        def theirs(name: str, step: float = STEP, only_path: bool = False) -> Callable[[], tuple[float, float]]:
            def run() -> tuple[float, float]:
                r = run_tool(name, case(folder, step, path_only=only_path))
                return r.loop_time_s, error(r.time, np.column_stack([r.x_E, r.y_E]), reference)

            return run

        equal_work = _equal_work(
            {"ours, inputs linear": ours(linear), "ours, inputs held": ours(held)},
            {n: theirs(n) for n in peers},
            missing,
        )
        errors: dict[str, float] = equal_work.data["errors"]  # type: ignore[assignment]
        step = _longest_step(errors["ours, inputs linear"], order=2)
        # the others' steps are so short that the FMUs make one internal step in each; so do ours where that is allowed
        one_internal_step = {"plant.max_step": step, "controller.max_step": step}
        mine = ours(path_only, step, one_internal_step)
        return [equal_work, _equal_accuracy(mine, step, theirs, errors, equal_work)]


def _longest_step(error: float, order: int) -> float:
    """Longest step (s) that is accurate enough, of those that meet the points where paths are compared.

    By the error (m) at `STEP`, which falls with the step to the power of the order of the coupling.
    """
    return float(EVERY / np.ceil(EVERY / (STEP * (0.97 * ACCURACY / error) ** (1.0 / order))))


def _steady(call: Callable[[], tuple[float, float]]) -> float:
    """What a call takes (s) in the long run: a process that has waited for another one needs a while to be as fast."""
    began, taken = time.perf_counter(), []
    while time.perf_counter() - began < WARM:
        taken.append(call()[0])
    return statistics.median(taken)


def _equal_work(
    ours: dict[str, Callable[[], tuple[float, float]]],
    theirs: dict[str, Callable[[], tuple[float, float]]],
    missing: dict[str, str],
) -> Section:
    calls = {**ours, **theirs}
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    errors: dict[str, float] = {}
    for i in range(MORE_ROUNDS):
        if i == ROUNDS:
            medians = {name: statistics.median(seconds[name]) for name in calls if name not in ours}
            near = [name for name, median in medians.items() if median <= NEAR * min(medians.values())]
            calls = {name: call for name, call in calls.items() if name in (*ours, *near)}
        for name, call in list(calls.items()):
            try:
                if name in ours:  # others warm up in their own processes
                    _steady(call)
                taken, errors[name] = call()
            except ToolFailed as failure:
                missing[name] = f"failed: {failure}"
                del calls[name], seconds[name]
                continue
            seconds[name].append(taken)
    mine = seconds["ours, inputs linear"]
    against = {name: ratio(values, mine[: len(values)]) for name, values in seconds.items()}
    peers = {n: r for n, r in against.items() if n not in ours}
    rows = [
        (
            n,
            "" if n in ours else package_version(n),
            f"{statistics.median(v) * 1e3:.0f}",
            f"{against[n]:.1f}",
            f"{errors[n]:.1e}",
        )
        for n, v in sorted(seconds.items(), key=lambda item: statistics.median(item[1]))
    ]
    rows += [(name, reason, "-", "-", "-") for name, reason in missing.items()]
    verdicts = []
    if peers:
        fastest = min(peers, key=lambda n: peers[n])
        verdicts.append(
            (f"the fastest other master ({fastest}) / ours: {peers[fastest]:.1f}, at least 2", peers[fastest] >= 2)
        )
    for name, least in (("libcosim", 8), ("omsimulator", 8), ("fmpy_loop", 20)):
        if name in peers:
            verdicts.append((f"{name} / ours: {peers[name]:.1f}, at least {least}", peers[name] >= least))
    return Section(
        "Other masters, equal work",
        f"15 s at 1 ms without disturbance (not every master can feed signals), FMI 2.0 FMUs, inputs and outputs "
        f"recorded where the master can; medians of {ROUNDS} interleaved runs, of {MORE_ROUNDS} for the fastest "
        "masters, each peer in its own process, set-up excluded. Error: largest distance of the end effector from the "
        "continuous loop.",
        ("master", "version, or why not", "ms a run", "/ ours", "error (m)"),
        rows,
        {"seconds": seconds, "ratios": against, "errors": errors, "missing": missing},
        verdicts,
    )


def _equal_accuracy(
    mine: Callable[[], tuple[float, float]],
    my_step: float,
    theirs: Callable[[str, float, bool], Callable[[], tuple[float, float]]],
    errors: dict[str, float],
    equal_work: Section,
) -> Section:
    """The longest step of each master that stays below the accuracy, from its error and order; then verified."""
    times: dict[str, list[float]] = equal_work.data["seconds"]  # type: ignore[assignment]
    rows, data, verdicts = [], {}, []
    fastest, (_, found) = _steady(mine), mine()
    rows.append(("ours, inputs linear", f"{my_step * 1e3:.3g}", f"{found:.1e}", f"{fastest * 1e3:.1f}", "1"))
    data["ours"] = {"step": my_step, "error": found, "seconds": [fastest]}
    assert found < ACCURACY
    for name in times:
        if name.startswith("ours"):
            continue
        step = _longest_step(errors[name], order=1)
        expected = statistics.median(times[name]) * STEP / step
        if expected > PATIENCE:
            rows.append(
                (name, f"{step * 1e3:.3g}", "-", f"not run, about {expected:.0f} s", f"about {expected / fastest:.0f}")
            )
            continue
        own, seconds, reached = [], [], 0.0
        try:
            for _ in range(ROUNDS if expected < QUICK else 1):
                own.append(_steady(mine))
                taken_by_it, reached = theirs(name, step, True)()
                seconds.append(taken_by_it)
        except ToolFailed as failure:
            rows.append((name, f"{step * 1e3:.3g}", "-", f"failed: {failure}", "-"))
            continue
        times_ours, milliseconds = ratio(seconds, own), statistics.median(seconds) * 1e3
        rows.append((name, f"{step * 1e3:.3g}", f"{reached:.1e}", f"{milliseconds:.0f}", f"{times_ours:.0f}"))
        data[name] = {"step": step, "error": reached, "seconds": seconds, "ours": own}
        verdicts.append((f"{name} / ours: {times_ours:.0f}, at least 100 (error {reached:.1e} m)", times_ours >= 100))
    return Section(
        "Time to accuracy",
        f"The same run with the end effector within {ACCURACY:g} m of the continuous loop over 15 s; each with its "
        "longest step that is accurate enough (from its error at 1 ms, of second order for ours, of first for all "
        "others) and one internal step of the FMUs in it, recording the path only. "
        f"Medians of {ROUNDS} runs, interleaved with ours, each of which is repeated for {WARM:g} s; one run where it "
        f"takes over {QUICK:g} s.",
        ("master", "step (ms)", "error (m)", "ms a run", "/ ours"),
        rows,
        data,
        verdicts,
    )
