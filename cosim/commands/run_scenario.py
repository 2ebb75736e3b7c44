"""`cosim run`: couple the FMUs in a scenario, write results, summary and figures."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from cosim.commands.execution import Plan, UsageError, check_overrides, execute, in_words, start_value
from cosim.errors import CosimError, SetupError, nearest
from cosim.master.failures import SimulationError, SimulationInterrupted
from cosim.output import OutputError, check_writable, write_json, write_somewhere
from cosim.results.results import Results
from cosim.results.stored import StoredResults
from cosim.scenario.signals import SHAPES, Shape
from cosim.system.system import System
from cosim.versions import versions
from parallel_robot.commands.robot_fmus import chosen_flavour, make_ready
from parallel_robot.figure_process import FigureProcess
from parallel_robot.metrics import metrics
from parallel_robot.own_fmus import replaced
from parallel_robot.scenario import RobotScenario, load_scenario

SHAPE_NAMES = {kind: name for name, kind in SHAPES.items()}


def run_scenario(args: argparse.Namespace, figures: FigureProcess) -> int:
    """Run `cosim run SCENARIO`; returns the exit code, raises CosimError with one line on bad input."""
    scenario = _scenario(args)
    folder: Path = args.out if args.out is not None else Path("results") / scenario.name
    check_writable(folder)
    flavour = chosen_flavour(args.fmus, args.flavour)
    make_ready(args.fmus, flavour)
    system = scenario.system(args.fmus, flavour)
    system = _with_own_fmus(args.fmu, system)
    check_overrides(args.set, system, "change the scenario's TOML")
    formats = args.format or ["csv"]
    write = partial(_write, scenario=scenario, folder=folder, formats=formats, figures=figures)
    try:
        results = execute(system, _plan(scenario), args, folder, formats)
    except SetupError as error:
        raise UsageError(f"{args.scenario}: {error}") from error
    except SimulationError as error:
        if error.results is None:
            raise
        raise CosimError(f"{error}; {_rescued(write, error.results, folder, str(error))}") from error
    except SimulationInterrupted as interrupt:
        where = _rescued(write, interrupt.results, folder, str(interrupt))
        print(f"cosim: {interrupt}; {where}", file=sys.stderr)
        return 130
    summary = write(results)
    print(_table(summary, scenario, folder))
    return 0


def _scenario(args: argparse.Namespace) -> RobotScenario:
    """The scenario with the options of the command line."""
    scenario = load_scenario(args.scenario)
    if args.seed is not None and args.seed < 0:
        raise UsageError(f"--seed {args.seed}: must be 0 or greater")
    given = {"step_size": args.step, "stop_time": args.stop, "order": args.order, "seed": args.seed}
    scenario = dataclasses.replace(scenario, **{k: v for k, v in given.items() if v is not None})
    for assignment in args.set:
        instance, name, value = start_value(assignment)
        if instance not in scenario.components:
            hint = nearest(instance, scenario.components)
            raise UsageError(f"--set {assignment}: the scenario has no component '{instance}'; {hint}")
        scenario = scenario.with_start_value(instance, name, value)
    return scenario


def _with_own_fmus(assignments: list[str], system: System) -> System:
    """The system with the user's own FMU files for some of the instances."""
    own = {}
    for assignment in assignments:
        instance, equals, path = assignment.partition("=")
        if not (instance and equals and path):
            raise UsageError(f"--fmu {assignment}: write INSTANCE=FILE, as controller=PID.fmu")
        if instance not in system.components:
            hint = nearest(instance, system.components)
            raise UsageError(f"--fmu {assignment}: the scenario has no component '{instance}'; {hint}")
        own[instance] = Path(path)
    system, missing = replaced(system, own)
    if missing:
        print(f"note: the FMUs given have no {', '.join(missing)}, so nothing is connected there")
    return system


def _plan(scenario: RobotScenario) -> Plan:
    return Plan(scenario.stop_time, scenario.step_size, scenario.order)


def _rescued(write: Callable[..., Any], results: Results | StoredResults, folder: Path, error: str) -> str:
    """Write what a run had recorded when it ended early; says where, or why not."""
    try:
        write(results, error=error)
    except OutputError as second:
        return str(second)
    return f"what was recorded is in {folder}"


def _as_data(shapes: Mapping[str, Shape]) -> dict[str, dict[str, Any]]:
    """Signals as JSON can write them."""
    return {target: {"shape": SHAPE_NAMES[type(s)], **dataclasses.asdict(s)} for target, s in shapes.items()}


def _write(
    results: Results | StoredResults,
    scenario: RobotScenario,
    folder: Path,
    formats: list[str],
    figures: FigureProcess,
    error: str | None = None,
) -> dict[str, Any]:
    """Write results, unless they are on the disk already, summary and figures; returns the summary."""
    summary = {
        "scenario": scenario.name,
        "title": scenario.title,
        "seed": scenario.seed,
        **results.info,
        "signals": _as_data(scenario.signals),
        "disturbances": _as_data(scenario.disturbances),
        "error": error,
        "metrics": metrics(results, scenario.steady_after) if len(results.time) else None,
        "versions": versions(),
    }

    def save(folder: Path) -> None:
        if isinstance(results, Results):
            for name in formats:
                results.save(folder / f"results.{name}")

    def write(folder: Path) -> None:
        write_json(folder / "summary.json", summary)
        with ThreadPoolExecutor(max_workers=1) as pool:  # tables are written by C++, which lets Python go on
            saved = pool.submit(save, folder)
            if len(results.time) > 1:
                figures.write(results, scenario.title, scenario.steady_after, folder)
        saved.result()

    write_somewhere(write, folder)
    return summary


def _table(summary: dict[str, Any], scenario: RobotScenario, folder: Path) -> str:
    """What the run found, for people."""
    found = summary["metrics"]
    lines = [
        scenario.title,
        *in_words(summary, _plan(scenario)),
    ]
    if found["tracking"]:
        steady = f"steady max (t >= {scenario.steady_after:g} s)"
        lines.append(f"\n{'tracking error':<16}{'max':>14}{'rms':>14}{'accumulated':>16}{steady:>28}")
        for name, e in found["tracking"].items():
            unit = "mm" if name in "xy" else "mrad"
            last = "-" if e["steady_max"] is None else f"{e['steady_max'] * 1e3:.4g} {unit}"
            lines.append(
                f"{name:<16}{e['max'] * 1e3:>9.4g} {unit:<4}{e['rms'] * 1e3:>9.4g} {unit:<4}"
                f"{e['accumulated'] * 1e3:>9.4g} {unit + ' s':<6}{last:>28}"
            )
    effort = found["control_effort"]
    if effort is not None:
        lines += [
            f"\nlargest torque {effort['max']:.4g} N.m, integral of its square {effort['integral']:.4g} N2.m2.s",
            f"largest closure error {found['closure_error_max']:.2g} m",
        ]
    lines.append(f"results, summary and figures: {folder}")
    return "\n".join(lines)
