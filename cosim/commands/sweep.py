"""`cosim sweep`: many runs of a system, on all cores of this machine or on a cluster."""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from cosim.commands.options import (
    IsolationOptions,
    Standard,
    add_algorithm_options,
    add_isolation_options,
    add_iterations_option,
    add_model_exchange_options,
    add_signature_option,
    check_signatures,
    chosen_interfaces,
    standard_of,
    take_from_isolated,
)
from cosim.errors import CosimError, nearest
from cosim.files.temporary import TemporaryFolder
from cosim.scenario.family import ScenarioFamily, default_scenario, families, family_name, named
from cosim.scenario.scenario import Scenario, ScenarioComponent
from cosim.sweep.errors import SweepError
from cosim.sweep.points import DESIGNS, Factor, Levels, Points, Range, advice, design, parse_factor, parse_whole_numbers
from cosim.terminal import screen

if TYPE_CHECKING:
    from cosim.scenario.metrics import Metric
    from cosim.sweep.page.live import SweepView
    from cosim.sweep.store import SweepSummary

_DESCRIPTION = """\
Run a system at many points: start values of variables, seeds, scenarios, FMU files.

Each run becomes a row of metrics in Parquet files, also a run that fails. The same command
resumes a sweep that was stopped. docs/sweeps.md helps to plan large sweeps.

Scenarios: {names}TOML files, or SSP files; several of them are a factor.
"""

_EXAMPLES = """\
examples:
  cosim sweep --vary controller.alpha=0.5:3:11 --vary controller.beta=1,1.5,2 --seeds 1:10
  cosim sweep --vary controller.alpha=0.5:3 --vary plant.tau_d.rms=0:0.05 --design sobol --points 1024
  cosim sweep tracking pd --flavour fmi2,fmi3 --seeds 1:100 --scheduler tcp://head:8786
  cosim sweep --vary controller.alpha=0.5:3:11 --vary controller.beta=0.5:3:11 --live
  cosim sweep tanks.ssp --vary pump.mode=low,high --metric highest=max:tank.level
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim sweep`."""
    known = families()
    names = [name for family in known.values() for name in family.scenario_names()]
    parser = subparsers.add_parser(
        "sweep",
        help="run a system at many points, on all cores or a Dask cluster",
        description=_DESCRIPTION.format(names="".join(f"{name}, " for name in names)),
        epilog=_EXAMPLES,
    )
    defaults = [family.default for family in known.values() if family.default is not None]
    default = f" (default {defaults[0]})" if len(defaults) == 1 else ""
    parser.add_argument("scenario", nargs="*", help=f"names or paths{default}")
    what = parser.add_argument_group("factors")
    what.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="COMPONENT.NAME=VALUES",
        help="a start value, or a number of a signal (plant.tau_d.rms): LOW:HIGH, LOW:HIGH:LEVELS or VALUE,VALUE,...; "
        "values are numbers, true and false, items of an enumeration, or texts; may be repeated",
    )
    what.add_argument("--seeds", metavar="FIRST:LAST", help="seeds of the random signals: FIRST:LAST or SEED,SEED,...")
    what.add_argument("--step", metavar="H,H", help="communication steps in s")
    what.add_argument(
        "--fmu",
        action="append",
        default=[],
        metavar="COMPONENT=FILE,FILE",
        help="FMU files of a component in place of those of the scenario, as controller=a.fmu,b.fmu; may be repeated",
    )
    points = parser.add_argument_group("points")
    points.add_argument(
        "--design",
        choices=DESIGNS,
        default="grid",
        help="all combinations of levels (default), a Latin hypercube, or the Sobol' sequence",
    )
    points.add_argument("--points", type=int, metavar="N", help="number of points of lhs and sobol")
    points.add_argument("--design-seed", type=int, default=0, metavar="S", help="fixes lhs and sobol (default 0)")
    measured = parser.add_argument_group("metrics")
    measured.add_argument(
        "--metric",
        action="append",
        default=[],
        metavar="NAME=MEASURE:VARIABLE",
        help="a column of the rows, besides the metrics of the scenario: final, max, rms, ... of a variable; "
        "NAME=MEASURE:VARIABLE:OTHER for a difference, @T behind it for the part from T on; may be repeated",
    )
    measured.add_argument(
        "--curves", type=float, metavar="P", help="also keep the variables of metrics over time, with a point every P s"
    )
    run_ = parser.add_argument_group("execution")
    run_.add_argument(
        "--build", action="store_true", help="compile the C sources of FMUs that have no binary for a worker's machine"
    )
    add_signature_option(run_)
    add_isolation_options(run_)
    run_.add_argument("--stop", type=float, metavar="T", help="stop time in s")
    add_algorithm_options(run_)
    add_model_exchange_options(run_)
    add_iterations_option(run_)
    run_.add_argument("--out", type=Path, metavar="DIR", help="results folder (default results/sweep-<scenario>)")
    run_.add_argument(
        "--live", action="store_true", help="show the runs in the browser as they come: a scatter plot and a table"
    )
    run_.add_argument("--workers", type=int, metavar="N", help="processes on this machine (default: one for each core)")
    run_.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a Dask scheduler whose cluster makes the runs, as tcp://head:8786",
    )
    options = {}
    for name, family in known.items():
        group = parser.add_argument_group(f"scenarios of {name}", family.system)
        family.add_sweep_options(group)
        options[name] = {action.option_strings[0]: action.dest for action in group._group_actions}
    parser.set_defaults(run=run, family_options=options)


def run(args: argparse.Namespace) -> int:
    """Run `cosim sweep`; returns the exit code, raises CosimError with one line on bad input."""
    behind = take_from_isolated(args, lambda text: not args.scenario and named(text) is not None)
    args.scenario = [*behind, *args.scenario] or [default_scenario()]
    if len(set(args.scenario)) < len(args.scenario):
        raise SweepError(f"scenarios {' '.join(args.scenario)}: one is named twice")
    with TemporaryFolder("sweep") as unpacked:
        try:
            return _run(args, Path(unpacked))
        except CosimError as error:
            if unpacked not in str(error):
                raise
            raise CosimError(str(error).replace(f"{unpacked}{os.sep}", "")) from error


@dataclass(frozen=True)
class _System:
    """Scenarios of one system, by what the user wrote, and their family.

    `brought_by` has the folder that an SSP was unpacked to -> the SSP.
    """

    scenarios: Mapping[str, Scenario]
    family: ScenarioFamily
    brought_by: Mapping[Path, Path]

    def archive_of(self, fmu: Path) -> Path:
        """The file that has brought an FMU, which is the FMU itself but for those in an SSP."""
        return next((ssp for folder, ssp in self.brought_by.items() if fmu.is_relative_to(folder)), fmu)


def _run(args: argparse.Namespace, unpacked: Path) -> int:
    steps = parse_factor(f"step_size={args.step}") if args.step is not None else None
    if isinstance(steps, Range):
        raise SweepError(f"--step {args.step}: a range; write H,H,... or LOW:HIGH:LEVELS")
    system = _read(args, steps, unpacked)
    isolation = _isolation(args, system.scenarios)
    varied = [parse_factor(text) for text in args.vary]
    own_fmus = _own_fmus(args.fmu)
    alternative, alternatives = system.family.alternatives(args)
    varied += [steps] if steps is not None and len(steps.values) > 1 else []
    discrete = _discrete(system.scenarios, {alternative: tuple(alternatives)}, own_fmus, args.seeds)
    points = design(args.design, [*discrete, *varied], args.points, args.design_seed)

    # Dask and Arrow take a while to import, and wrong options should be told at once
    from cosim.sweep.engine import sweep
    from cosim.sweep.scenarios import check, study_of_alternatives

    prepared = {a: system.family.prepared_alternative(system.scenarios, a, args) for a in alternatives}
    module, _, name = system.family.study.partition(":")
    study, files = study_of_alternatives(
        getattr(import_module(module), name),
        {label: {a: prepared[a][label] for a in alternatives} for label in system.scenarios},
        own_fmus,
        alternative=alternative,
        optional_inputs=system.family.optional_inputs,
        curve_period=args.curves,
        build=args.build,
    )
    study = dataclasses.replace(study, isolate=isolation.isolate, limits=isolation.limits)
    check_signatures(args.require_signed, [system.archive_of(path) for path in files.values()])
    check(study, files, varied)
    if note := advice(args.design, len(points)):
        print(note)
    first = next(iter(system.scenarios.values()))
    folder = args.out if args.out is not None else Path("results") / f"sweep-{first.name}"
    with _shown_live(first.title, points, study.metrics) if args.live else nullcontext() as view:
        with sweep_progress(len(points)) as bar:

            def progress(done: int, workers: int) -> None:
                bar(done, workers)
                if view is not None:
                    view.progress(done, workers)

            summary = sweep(
                study,
                files,
                points,
                folder,
                scheduler=args.scheduler,
                workers=args.workers,
                progress=progress,
                warn=sweep_warning,
                observe=None if view is None else view.observe,
            )
        if view is not None:
            view.ended(interrupted=summary.interrupted)
    print(sweep_table(summary, folder))
    if summary.interrupted:
        print("cosim: interrupted; the same command goes on where it stopped", file=sys.stderr)
        return 130
    check_some_succeeded(summary)
    return 0


def _shown_live(title: str, points: Points, metrics: Sequence[str]) -> SweepView:
    """A page that shows a sweep as it goes on, opened in the browser."""
    import webbrowser

    from cosim.sweep.page.live import SweepView

    def show(address: str) -> bool:
        print(f"live: {address}", flush=True)
        return webbrowser.open(address)

    return SweepView(title, points, metrics, show)


def _isolation(args: argparse.Namespace, scenarios: Mapping[str, Scenario]) -> IsolationOptions:
    """The options of isolation; what no run could take is told before any is tried."""
    options = IsolationOptions.of(args)
    components = {name: c.isolate for scenario in scenarios.values() for name, c in scenario.components.items()}
    for scenario in scenarios.values():
        for name, component in scenario.components.items():
            if component.place is not None:
                raise SweepError(
                    f"scenario {scenario.name}: component '{name}' has a place, '{component.place}'; runs of a sweep "
                    "have all their FMUs on one worker: leave the place out"
                )
    for name in options.isolate if isinstance(options.isolate, tuple) else ():
        if name not in components:
            raise SweepError(f"--isolated {name}: there is no such component; {nearest(name, components)}")
    if options.limits is not None and not options.isolate and not any(components.values()):
        raise SweepError("--step-timeout and --memory-limit are for isolated FMUs; isolate some (--isolated)")
    return options


def _read(args: argparse.Namespace, steps: Levels | None, unpacked: Path) -> _System:
    """The scenarios that are named, with the options of the command line."""
    from cosim.scenario.reading import load_with_family  # takes a while to import

    scenarios: dict[str, Scenario] = {}
    of: dict[str, ScenarioFamily] = {}
    brought_by: dict[Path, Path] = {}
    for number, text in enumerate(args.scenario):
        standard = standard_of(text) if named(text) is None else None
        if standard is not None:
            folder = unpacked / f"{number}"
            brought_by[folder] = Path(text)
            scenarios[text], of[text] = _of_description(Path(text), standard, folder, args, steps), ScenarioFamily()
        elif Path(text).suffix.lower() == ".fmu":
            raise SweepError(f"{text} is a single FMU; write a TOML scenario with it as its component, and sweep that")
        else:
            scenarios[text], of[text] = load_with_family(text)
    family = next(iter(of.values()))
    for text, other in of.items():
        if family_name(other) != family_name(family):
            raise SweepError(f"{text}: its system is not that of {args.scenario[0]}; sweep them separately")
    for name, options in args.family_options.items():
        if name != family_name(family):
            for option, dest in options.items():
                if getattr(args, dest) is not None:
                    raise SweepError(f"{option} is for scenarios of {name}; leave it out")
    metrics = _metrics(args.metric, scenarios, family)
    return _System({text: _with_options(s, args, steps, metrics) for text, s in scenarios.items()}, family, brought_by)


def _of_description(
    path: Path, standard: Standard, unpacked: Path, args: argparse.Namespace, steps: Levels | None
) -> Scenario:
    """The system of an SSP or an OSP configuration, and its default experiment."""
    from cosim.system.read import DURATION  # FMPy takes a while to import

    step_size = None if steps is None else float(steps.values[0])
    if standard == "osp":
        from cosim.osp.reader import read_osp

        found = read_osp(path, step_size=step_size, stop_time=args.stop, duration=DURATION)
    else:
        from cosim.ssp.reader import read_ssp

        unpacked.mkdir()
        found = read_ssp(path, unpacked, step_size=step_size, stop_time=args.stop, duration=DURATION)
    if functions := [name for name, component in found.system.components.items() if component.fmu is None]:
        raise SweepError(f"{path}: '{functions[0]}' maps or sums values, which sweeps can't do yet; use cosim run")
    own = [name for name, component in found.system.components.items() if component.every > 1]
    if own and steps is not None and len(steps.values) > 1:
        raise SweepError(f"{path}: '{own[0]}' has a step of its own; give one --step")
    for note in found.notes:
        print(f"note: {note}")
    assert found.stop_time is not None  # which is assumed, if nothing says it
    assert found.step_size is not None
    components = found.system.components
    return Scenario(
        name=path.stem,
        title=found.name,
        components={
            name: ScenarioComponent(c.fmu, c.every, c.isolate, interface=c.interface, place=c.place)
            for name, c in components.items()
        },
        stop_time=found.stop_time,
        step_size=found.step_size,
        start_time=found.start_time,
        start={name: c.start for name, c in components.items()},
        connections=tuple(found.system.connections),
        order=found.order,
        extrapolation=found.extrapolation,
    )


def _with_options(
    scenario: Scenario, args: argparse.Namespace, steps: Levels | None, metrics: Mapping[str, Metric]
) -> Scenario:
    given = {
        "step_size": None if steps is None else float(steps.values[0]),
        "stop_time": args.stop,
        "order": args.order,
        "extrapolation": args.extrapolation,
        "metrics": {**scenario.metrics, **metrics} if metrics else None,
        "solver": args.solver,
        "solver_step": args.solver_step,
        "iterations": args.iterations,
    }
    scenario = dataclasses.replace(scenario, **{k: v for k, v in given.items() if v is not None})
    return scenario.with_interfaces(chosen_interfaces(args.interface, scenario.components))


def _metrics(texts: list[str], scenarios: Mapping[str, Scenario], family: ScenarioFamily) -> dict[str, Metric]:
    """Metrics from `NAME=MEASURE:VARIABLE`, `NAME=MEASURE:VARIABLE:OTHER`, both with `@T` behind."""
    from cosim.scenario.metrics import Metric

    found: dict[str, Metric] = {}
    taken = {*family.metric_names, *(name for scenario in scenarios.values() for name in scenario.metrics)}
    for text in texts:
        name, _, rest = text.partition("=")
        what, at, after = rest.partition("@")
        measure, *variables = what.split(":")
        try:
            time = float(after) if at else None
        except ValueError:
            variables = []
        if not name or len(variables) not in (1, 2) or not all(variables):
            raise SweepError(f"--metric {text}: write NAME=MEASURE:VARIABLE[:OTHER][@T], as error=rms:a.y:a.u@8")
        if name in taken or name in found:
            raise SweepError(f"--metric {text}: there is a metric '{name}' already; choose another name")
        try:
            found[name] = Metric(variables[0], measure, variables[1] if len(variables) == 2 else None, time)
        except ValueError as error:
            raise SweepError(f"--metric {text}: {error}") from None
    return found


def _own_fmus(texts: list[str]) -> dict[str, list[Path]]:
    own: dict[str, list[Path]] = {}
    for text in texts:
        component, equals, paths = text.partition("=")
        if not (component and equals and paths) or component in own:
            raise SweepError(f"--fmu {text}: write COMPONENT=FILE,FILE, once for each component")
        own[component] = [Path(path) for path in paths.split(",")]
    return own


def _discrete(
    scenarios: Mapping[str, Scenario],
    alternatives: Mapping[str, tuple[str, ...]],
    own_fmus: Mapping[str, list[Path]],
    seeds: str | None,
) -> Iterator[Factor]:
    """Factors that are not numbers, slowest first: neighbouring points then share what is expensive to set up."""
    if len(scenarios) > 1:
        yield Levels("scenario", tuple(scenarios))
    for name, values in alternatives.items():
        if len(values) > 1:
            yield Levels(name, values)
    for component, paths in own_fmus.items():
        if len(paths) > 1:
            yield Levels(f"{component}.fmu", tuple(map(str, paths)))
    if seeds is not None:
        levels = parse_whole_numbers("seed", seeds)
        if any(int(seed) < 0 for seed in levels.values):
            raise SweepError(f"--seeds {seeds}: seeds must be 0 or greater")
        yield levels


@contextmanager
def sweep_progress(points: int, what: str = "sweep") -> Iterator[Callable[[int, int], None]]:
    """A bar with rate and time left, on terminals."""
    bars: list[Any] = []

    def report(done: int, workers: int) -> None:
        if not bars:  # what was there before must not count for the rate
            no_terminal = None  # tqdm's word for: no bar where there is no terminal to draw it on
            bars.append(tqdm(file=screen(), total=points, initial=done, unit=" runs", desc=what, disable=no_terminal))
        bars[0].set_postfix_str(
            f"{workers} worker{'s' * (workers > 1)}" if workers else "waiting for workers", refresh=False
        )
        bars[0].update(done - bars[0].n)

    try:
        yield report
    finally:
        for bar in bars:
            bar.close()


def sweep_warning(line: str) -> None:
    """Say what goes wrong with a sweep while it goes on, beside its bar."""
    tqdm.write(f"warning: {line}", file=sys.stderr)


def check_some_succeeded(summary: SweepSummary) -> None:
    """Whether a single run of a sweep that has ended has been one.

    Raises
    ------
    SweepError
        All have failed.
    """
    if summary.failed == summary.points:
        raise SweepError(f"all {summary.points} runs failed; the first: {summary.first_error}")


def sweep_table(summary: SweepSummary, folder: Path) -> str:
    """How the sweep has ended, for people."""
    lines = [f"runs      {summary.done} of {summary.points}, {summary.runs} of them now"]
    if summary.failed:
        lines.append(f"failed    {summary.failed}; the first: {summary.first_error}")
    else:
        lines.append("failed    none")
    if summary.runs:
        rate = summary.runs / summary.seconds
        workers = f"{summary.workers} worker{'s' * (summary.workers > 1)}"
        lines.append(f"rate      {rate:.3g} runs a second on {workers}, {summary.seconds:.1f} s")
    lines.append(f"results   {folder} (Parquet; cosim.sweep.read reads them)")
    return "\n".join(lines)
