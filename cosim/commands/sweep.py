"""`cosim sweep`: many runs of a scenario, on all cores of this machine or on a cluster."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from cosim.errors import nearest
from cosim.sweep.errors import SweepError
from cosim.sweep.points import DESIGNS, Factor, Levels, Range, advice, design, parse_factor, parse_whole_numbers
from parallel_robot.choices import FLAVOURS, scenario_names
from parallel_robot.commands.robot_fmus import chosen_flavour, make_ready
from parallel_robot.scenario import RobotScenario, load_scenario

if TYPE_CHECKING:
    from cosim.sweep.store import SweepSummary

_DESCRIPTION = f"""\
Run a scenario at many points: start values of variables, seeds, scenarios, FMU files.

Each run becomes a row of metrics in Parquet files, also a run that fails. A sweep that was stopped
goes on when the same command is given again. docs/sweeps.md plans large ones.

Scenarios: {", ".join(scenario_names())}, or TOML files; several of them are a factor.
"""

_EXAMPLES = """\
examples:
  cosim sweep --vary controller.alpha=0.5:3:11 --vary controller.beta=1,1.5,2 --seeds 1:10
  cosim sweep --vary controller.alpha=0.5:3 --vary plant.tau_d.rms=0:0.05 --design sobol --points 1024
  cosim sweep tracking pd --flavour fmi2,fmi3 --seeds 1:100 --scheduler tcp://head:8786
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim sweep`."""
    parser = subparsers.add_parser(
        "sweep",
        help="run a scenario at many points, on all cores or a Dask cluster",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scenario", nargs="*", default=["tracking"], help="names or paths (default tracking)")
    what = parser.add_argument_group("what is varied")
    what.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="INSTANCE.NAME=VALUES",
        help="a start value, or a number of a signal (plant.tau_d.rms): LOW:HIGH, LOW:HIGH:LEVELS or VALUE,VALUE,...; "
        "may be repeated",
    )
    what.add_argument("--seeds", metavar="FIRST:LAST", help="seeds of the random signals: FIRST:LAST or SEED,SEED,...")
    what.add_argument("--step", metavar="H,H", help="communication steps in s")
    what.add_argument("--flavour", metavar="F,F", help=f"flavours of the FMUs, of {', '.join(FLAVOURS)}")
    what.add_argument(
        "--fmu",
        action="append",
        default=[],
        metavar="INSTANCE=FILE,FILE",
        help="FMU files of an instance in place of those of the flavour; may be repeated",
    )
    points = parser.add_argument_group("which points")
    points.add_argument(
        "--design",
        choices=DESIGNS,
        default="grid",
        help="all combinations of levels (default), a Latin hypercube, or Sobol's sequence",
    )
    points.add_argument("--points", type=int, metavar="N", help="number of points of lhs and sobol")
    points.add_argument("--design-seed", type=int, default=0, metavar="S", help="fixes lhs and sobol (default 0)")
    run_ = parser.add_argument_group("how they run")
    run_.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="FMU folder (default fmus)")
    run_.add_argument("--stop", type=float, metavar="T", help="stop time in s")
    run_.add_argument("--order", choices=("sequential", "parallel"), help="order of the value exchange")
    run_.add_argument(
        "--coupling",
        choices=("auto", "hold", "linear"),
        default="auto",
        help="inputs between communication points: held, or linear (auto: linear where the FMU can)",
    )
    run_.add_argument("--curves", type=float, metavar="P", help="keep the errors over time, each P s, with the metrics")
    run_.add_argument("--out", type=Path, metavar="DIR", help="results folder (default results/sweep-<scenario>)")
    run_.add_argument("--workers", type=int, metavar="N", help="processes on this machine (default: one for each core)")
    run_.add_argument("--scheduler", metavar="ADDRESS", help="run on the Dask cluster there, as tcp://head:8786")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim sweep`; returns the exit code, raises CosimError with one line on bad input."""
    steps = parse_factor(f"step_size={args.step}") if args.step is not None else None
    scenarios = {text: _with_options(load_scenario(text), args, steps) for text in args.scenario}
    if len(scenarios) < len(args.scenario):
        raise SweepError(f"scenarios {' '.join(args.scenario)}: one is named twice")
    varied = [parse_factor(text) for text in args.vary]
    flavours = _flavours(args)
    own_fmus = _own_fmus(args.fmu)
    if isinstance(steps, Range):
        raise SweepError(f"--step {args.step}: a range; write H,H,... or LOW:HIGH:LEVELS")
    varied += [steps] if steps is not None and len(steps.values) > 1 else []
    factors = [*_discrete(scenarios, flavours, own_fmus, args.seeds), *varied]
    points = design(args.design, factors, args.points, args.design_seed)

    # Dask and Arrow take a while to import, and wrong options should be told at once
    from cosim.sweep.engine import sweep
    from parallel_robot.sweep import check, robot_study

    for flavour in flavours:
        make_ready(args.fmus, flavour)
    study, files = robot_study(scenarios, args.fmus, flavours, own_fmus, args.coupling, args.curves)
    check(study, files, varied)
    if note := advice(args.design, len(points)):
        print(note)
    folder = args.out if args.out is not None else Path("results") / f"sweep-{next(iter(scenarios.values())).name}"
    with sweep_progress(len(points)) as progress:
        summary = sweep(study, files, points, folder, scheduler=args.scheduler, workers=args.workers, progress=progress)
    print(sweep_table(summary, folder))
    if summary.interrupted:
        print("cosim: interrupted; the same command goes on where it stopped", file=sys.stderr)
        return 130
    return 0


def _with_options(scenario: RobotScenario, args: argparse.Namespace, steps: Levels | Range | None) -> RobotScenario:
    step = float(steps.values[0]) if isinstance(steps, Levels) else None
    given = {"step_size": step, "stop_time": args.stop, "order": args.order}
    return dataclasses.replace(scenario, **{k: v for k, v in given.items() if v is not None})


def _flavours(args: argparse.Namespace) -> list[str]:
    if args.flavour is None:
        return [chosen_flavour(args.fmus, None)]
    flavours = args.flavour.split(",")
    for flavour in flavours:
        if flavour not in FLAVOURS:
            raise SweepError(f"--flavour {args.flavour}: '{flavour}' is unknown; {nearest(flavour, FLAVOURS)}")
    return list(flavours)


def _own_fmus(texts: list[str]) -> dict[str, list[Path]]:
    own: dict[str, list[Path]] = {}
    for text in texts:
        instance, equals, paths = text.partition("=")
        if not (instance and equals and paths) or instance in own:
            raise SweepError(f"--fmu {text}: write INSTANCE=FILE,FILE, once for each instance")
        own[instance] = [Path(path) for path in paths.split(",")]
    return own


def _discrete(
    scenarios: dict[str, RobotScenario], flavours: list[str], own_fmus: dict[str, list[Path]], seeds: str | None
) -> Iterator[Factor]:
    """Factors that are no numbers, slowest first: neighbouring points then share what is expensive to set up."""
    if len(scenarios) > 1:
        yield Levels("scenario", tuple(scenarios))
    if len(flavours) > 1:
        yield Levels("flavour", tuple(flavours))
    for instance, paths in own_fmus.items():
        if len(paths) > 1:
            yield Levels(f"{instance}.fmu", tuple(map(str, paths)))
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
            bars.append(tqdm(total=points, initial=done, unit=" runs", desc=what, disable=no_terminal))
        bars[0].set_postfix_str(f"{workers} workers" if workers else "waiting for workers", refresh=False)
        bars[0].update(done - bars[0].n)

    try:
        yield report
    finally:
        for bar in bars:
            bar.close()


def sweep_table(summary: SweepSummary, folder: Path) -> str:
    """How the sweep has ended, for people."""
    lines = [f"runs      {summary.done} of {summary.points}, {summary.runs} of them now"]
    if summary.failed:
        lines.append(f"failed    {summary.failed}; the first: {summary.first_error}")
    else:
        lines.append("failed    none")
    if summary.runs:
        rate = summary.runs / summary.seconds
        lines.append(f"rate      {rate:.3g} runs a second on {summary.workers} workers, {summary.seconds:.1f} s")
    lines.append(f"results   {folder} (Parquet; cosim.sweep.read reads them)")
    return "\n".join(lines)
