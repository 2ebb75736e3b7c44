"""`cosim run`: couple the FMUs in a scenario, write results, summary and figures."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from cosim.commands.execution import Plan, UsageError, check_overrides, execute, in_words, start_value
from cosim.commands.robot_fmus import chosen_flavour, make_ready
from cosim.errors import CosimError, SetupError, nearest
from cosim.failures import SimulationError, SimulationInterrupted
from cosim.output import OutputError, check_writable, write_json, write_somewhere
from cosim.results import Results
from cosim.robot import fmus
from cosim.robot.metrics import metrics
from cosim.robot.own_fmus import replaced
from cosim.robot.scenario import Scenario, load_scenario, names
from cosim.robot.signals import SHAPES, Shape
from cosim.stored import StoredResults
from cosim.system import System
from cosim.tables import FORMATS
from cosim.versions import versions

SHAPE_NAMES = {kind: name for name, kind in SHAPES.items()}


def register(subparsers: Any) -> None:
    """Add the parser of `cosim run`."""
    parser = subparsers.add_parser(
        "run",
        help="run a scenario of the coupled FMUs, or an SSP",
        description=f"Couple the FMUs in a scenario. Scenarios: {', '.join(names())}, or a TOML file. Or "
        "couple those in an SSP, of any system.",
    )
    parser.add_argument("scenario", nargs="?", default="tracking", help="name or path (default %(default)s)")
    parser.add_argument(
        "--flavour", choices=fmus.FLAVOURS, help="default fmi2; pythonfmu where there is no C compiler to build it"
    )
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="FMU folder (default fmus)")
    parser.add_argument(
        "--fmu",
        action="append",
        default=[],
        metavar="INSTANCE=FILE",
        help="FMU of your own for an instance, as controller=PID.fmu; may be repeated",
    )
    parser.add_argument("--step", type=float, metavar="H", help="communication step in s")
    parser.add_argument("--stop", type=float, metavar="T", help="stop time in s")
    parser.add_argument("--order", choices=("sequential", "parallel"), help="order of the value exchange")
    parser.add_argument(
        "--coupling",
        choices=("auto", "hold", "linear"),
        default="auto",
        help="inputs between communication points: held, or linear (auto: linear where the FMU can)",
    )
    parser.add_argument("--record", action="append", metavar="NAME", help="record this variable only; may be repeated")
    parser.add_argument(
        "--record-every", type=int, default=1, metavar="N", help="record at every N-th communication point"
    )
    parser.add_argument(
        "--format",
        action="append",
        choices=FORMATS,
        help="format of the results (default csv), mat for Dymola and OpenModelica; may be repeated",
    )
    parser.add_argument(
        "--realtime", type=float, metavar="FACTOR", help="pace the run: simulated seconds in a second (1: real time)"
    )
    parser.add_argument("--seed", type=int, help="seed of the random signals")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default results/<scenario>)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="INSTANCE.NAME=VALUE",
        help="start value of a variable, as controller.alpha=2; may be repeated",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim run`; returns the exit code, raises CosimError with one line on bad input."""
    if args.scenario.lower().endswith(".ssp"):
        from cosim.commands.run_ssp import run_ssp  # xmlschema takes a while to import

        return run_ssp(args)
    scenario = _scenario(args)
    folder: Path = args.out if args.out is not None else Path("results") / scenario.name
    check_writable(folder)
    flavour = chosen_flavour(args.fmus, args.flavour)
    make_ready(args.fmus, flavour)
    system = scenario.system(args.fmus, flavour)
    system = _with_own_fmus(args.fmu, system)
    check_overrides(args.set, system, "change the scenario's TOML")
    formats = args.format or ["csv"]
    try:
        results = execute(system, _plan(scenario), args, folder, formats)
    except SetupError as error:
        raise UsageError(f"{args.scenario}: {error}") from error
    except SimulationError as error:
        if error.results is None:
            raise
        where = _rescue(error.results, scenario, folder, formats, str(error))
        raise CosimError(f"{error}; {where}") from error
    except SimulationInterrupted as interrupt:
        where = _rescue(interrupt.results, scenario, folder, formats, str(interrupt))
        print(f"cosim: {interrupt}; {where}", file=sys.stderr)
        return 130
    summary = _write(results, scenario, folder, formats)
    print(_table(summary, scenario, folder))
    return 0


def _scenario(args: argparse.Namespace) -> Scenario:
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


def _plan(scenario: Scenario) -> Plan:
    return Plan(scenario.stop_time, scenario.step_size, scenario.order)


def _rescue(results: Results | StoredResults, scenario: Scenario, folder: Path, formats: list[str], error: str) -> str:
    """Write what a run had recorded when it ended early; says where, or why not."""
    try:
        _write(results, scenario, folder, formats, error)
    except OutputError as second:
        return str(second)
    return f"what was recorded is in {folder}"


def _as_data(shapes: Mapping[str, Shape]) -> dict[str, dict[str, Any]]:
    """Signals as JSON can write them."""
    return {target: {"shape": SHAPE_NAMES[type(s)], **dataclasses.asdict(s)} for target, s in shapes.items()}


def _write(
    results: Results | StoredResults,
    scenario: Scenario,
    folder: Path,
    formats: list[str],
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
                # matplotlib takes longer to import than most runs
                from cosim.robot.figures import write_figures

                write_figures(results, scenario.title, scenario.steady_after, folder)
        saved.result()

    write_somewhere(write, folder)
    return summary


def _table(summary: dict[str, Any], scenario: Scenario, folder: Path) -> str:
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
