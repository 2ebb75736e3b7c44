"""A system packed into one FMU against the containers of other tools, and in the importers at hand."""

from __future__ import annotations

import itertools
import statistics
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.masters import error, reference_path
from benchmarks.measure import Section, ratio
from benchmarks.system import STEP, STOP_TIME, case, undisturbed
from cosim import Simulation
from cosim.pack import pack
from interop.tools.case import Case
from interop.tools.container_loop import run_container
from interop.tools.launch import ToolFailed, package_version, run_tool, tool
from parallel_robot.models import MODELS

#: Containers of other tools.
CONTAINERS = ("fmpy_container", "fmu_toolbox", "fmu_toolbox_sequential")

#: Importers, and the versions of FMI that they know.
IMPORTERS = {
    "c_host": (2, 3),
    "fmpy_loop": (2, 3),
    "libcosim": (2,),
    "ecos": (2, 3),
    "fmi4j": (2,),
    "pathsim": (2, 3),
}

#: Communication steps (s) by which the order of a coupling is found.
STEPS = (4e-3, 2e-3, 1e-3)

ROUNDS = 7


def outputs_only(folder: Path, step: float) -> Case:
    """The case for containers: all outputs are recorded."""
    return replace(case(folder, step), recorded=[f"{n}.{v}" for n, m in MODELS.items() for v in m.outputs.names])


def path_of(names: list[str], table: np.ndarray) -> np.ndarray:
    """End effector (n, 2) of a table."""
    return np.column_stack([table[:, names.index(name)] for name in ("plant.x_E", "plant.y_E")])


def measure_packed(folder: Path) -> list[Section]:
    """Containers side by side, then the packed system in other tools."""
    with tempfile.TemporaryDirectory(prefix="packed-") as name:
        return [measure_containers(folder, Path(name)), measure_importers(folder, Path(name))]


def measure_containers(folder: Path, temporary: Path) -> Section:
    """Error, order and time of each container at the same communication steps."""
    reference = reference_path()
    recorded = outputs_only(folder, STEP).recorded
    times: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    missing: dict[str, str] = {}

    count = itertools.count()

    def ours(extrapolation: str) -> Callable[[float], tuple[float, float]]:
        def run(step: float) -> tuple[float, float]:
            own = temporary / f"{next(count)}"  # unpacked anew each time, as the others are
            packed = pack(undisturbed(folder), own / "Whole.fmu", step, extrapolation=extrapolation)
            chosen = outputs_only(folder, step)
            table, seconds = run_container(packed.path, own / "unpacked", chosen, recorded)
            return seconds, error(chosen.times, path_of(recorded, table), reference)

        return run

    def theirs(name: str) -> Callable[[float], tuple[float, float]]:
        def run(step: float) -> tuple[float, float]:
            r = run_tool(name, outputs_only(folder, step))
            return r.loop_time_s, error(r.time, np.column_stack([r.x_E, r.y_E]), reference)

        return run

    with Simulation(undisturbed(folder), extrapolation="linear", record=recorded) as simulation:

        def unpacked(step: float) -> tuple[float, float]:
            r = simulation.run(STOP_TIME, step)
            return r.info["loop_time_s"], error(r.time, np.column_stack([r["plant.x_E"], r["plant.y_E"]]), reference)

        calls: dict[str, Callable[[float], tuple[float, float]]] = {
            "unpacked, in our master, inputs linear": unpacked,
            "packed, inputs linear": ours("linear"),
            "packed, inputs held": ours("hold"),
        }
        for name in CONTAINERS:
            reason = tool(name).unavailable()
            if reason is None:
                calls[f"{name} {package_version(name)}"] = theirs(name)
            else:
                missing[name] = reason
        for label, call in calls.items():
            errors[label] = [call(step)[1] for step in STEPS]
        for _ in range(ROUNDS):
            for label, call in calls.items():
                times.setdefault(label, []).append(call(STEP)[0])
    fast = times["packed, inputs linear"]
    rows = [
        (
            label,
            f"{statistics.median(found) * 1e3:.0f}",
            f"{ratio(found, fast):.2f}",
            *(f"{e:.1e}" for e in errors[label]),
            f"{np.polyfit(np.log(STEPS), np.log(errors[label]), 1)[0]:.2f}",
        )
        for label, found in times.items()
    ]
    rows += [(name, reason, "-", *("-" for _ in STEPS), "-") for name, reason in missing.items()]
    return Section(
        "A packed system against containers",
        f"{STOP_TIME:g} s without disturbance, FMI 2.0, 38 outputs read at each communication point; medians of "
        f"{ROUNDS} interleaved runs at 1 ms. Error: largest distance of the end effector from the continuous loop (m).",
        ("what", "ms a run", "/ packed", *(f"{s * 1e3:g} ms" for s in STEPS), "order"),
        rows,
        {"times": times, "errors": errors},
    )


def measure_importers(folder: Path, temporary: Path) -> Section:
    """The packed system in importers, at communication steps that are ten internal ones; compared with our master."""
    step = 10 * STEP
    with Simulation(undisturbed(folder), extrapolation="linear", record=["plant.x_E", "plant.y_E"]) as simulation:
        r = simulation.run(STOP_TIME, STEP, record_every=10)
    expected = np.column_stack([r["plant.x_E"], r["plant.y_E"]])
    rows = []
    for version in (2, 3):
        whole = pack(undisturbed(folder), temporary / f"Whole{version}.fmu", STEP, fmi=version, extrapolation="linear")
        recorded = [f"whole.{name}" for name in whole.outputs]
        chosen = Case({"whole": whole.path}, [], {}, STOP_TIME, step, recorded, ("whole.plant.x_E", "whole.plant.y_E"))
        for name in (n for n, versions in IMPORTERS.items() if version in versions):
            reason = tool(name).unavailable()
            if reason is not None:
                rows.append((name, f"{version}.0", reason, "-"))
                continue
            try:
                found = run_tool(name, chosen)
            except ToolFailed as failure:
                rows.append((name, f"{version}.0", f"failed: {failure}", "-"))
                continue
            points = np.round(found.time / step).astype(int)
            common = points < len(expected)  # some go a step beyond the end
            differences = np.column_stack([found.x_E, found.y_E])[common] - expected[points[common]]
            difference = float(np.abs(differences).max())
            rows.append((name, f"{version}.0", f"{found.loop_time_s * 1e3:.0f}", f"{difference:.1e}"))
    return Section(
        "A packed system in importers",
        f"The same system at communication steps of {step * 1e3:g} ms, each split into ten; difference of the end "
        "effector from our master with the FMUs themselves at 1 ms (m).",
        ("importer", "FMI", "ms a run", "difference (m)"),
        rows,
        {},
    )
