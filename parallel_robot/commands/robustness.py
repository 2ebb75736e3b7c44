"""`cosim robustness`: Monte Carlo over all uncertainties, and the Pareto front over the gains."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from cosim.commands.options import add_overwrite_option
from cosim.commands.sweep import check_some_succeeded, sweep_progress, sweep_table, sweep_warning
from cosim.errors import needs
from cosim.files.whole import write_json
from cosim.results.output import SUMMARY, ResultFolder
from cosim.terminal import screen
from parallel_robot.commands.robot_fmus import chosen_flavour, make_ready

if TYPE_CHECKING:
    from parallel_robot.paper.robustness.content import Robustness

_DESCRIPTION = """\
Study the robustness of the closed loop: Monte Carlo runs of the paper's 15 s over all uncertainties (the
fuzzy mass change, start point, disturbance, sensor noise, communication step), what the steady error
depends on (Sobol' indices), and the Pareto front of steady error against control effort over
(alpha, beta), with the paper's optima on it.

The same command resumes a stopped study. It writes the rows of both sweeps (monte-carlo/, gains/),
figures/, bands.csv, robustness.json, robustness.md and summary.json.
"""

_EXAMPLES = """\
examples:
  cosim robustness --runs 1000
  cosim robustness --levels 40 --scheduler tcp://head:8786
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim robustness`."""
    parser = subparsers.add_parser(
        "robustness",
        help="Monte Carlo over all uncertainties, sensitivities, Pareto front over the gains",
        epilog=_EXAMPLES,
        description=_DESCRIPTION,
    )
    parser.add_argument(
        "--out", type=Path, default=Path("results/robustness"), metavar="DIR", help="folder (default %(default)s)"
    )
    parser.add_argument(
        "--runs",
        type=int,
        default=10_000,
        metavar="N",
        help="Monte Carlo runs, rounded up to what Sobol' indices need (default %(default)s)",
    )
    parser.add_argument(
        "--levels", type=int, default=25, metavar="N", help="levels of alpha and of beta (default %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="fixes the design (default 0)")
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="FMU folder (default fmus)")
    parser.add_argument(
        "--workers", type=int, metavar="N", help="processes on this machine (default: one for each core)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a Dask scheduler whose cluster makes the runs, as tcp://head:8786",
    )
    add_overwrite_option(parser)
    parser.set_defaults(run=run)


@needs("robot")
def run(args: argparse.Namespace) -> int:
    """Run `cosim robustness`; returns the exit code, raises CosimError with one line on bad input."""
    from parallel_robot.paper.robustness.content import BANDS, DATA, TEXT

    with ResultFolder(args.out, (BANDS, DATA, TEXT), overwrite=args.overwrite) as results:
        return _run(args, results)


def _run(args: argparse.Namespace, results: ResultFolder) -> int:
    # Dask, SciPy and matplotlib take a while to import, and other commands don't need them
    from cosim.sweep.engine import sweep
    from parallel_robot.paper.robustness.analyse import STEPS, analyse
    from parallel_robot.paper.robustness.study import gains, monte_carlo

    folder = results.folder
    flavour = chosen_flavour(args.fmus, None)
    make_ready(args.fmus, flavour)
    sweeps = (monte_carlo(args.fmus, flavour, args.runs, args.seed), gains(args.fmus, flavour, args.levels))
    for each in sweeps:
        where = folder / each.name
        with sweep_progress(len(each.points), each.name) as progress:
            summary = sweep(
                each.study,
                each.files,
                each.points,
                where,
                scheduler=args.scheduler,
                workers=args.workers,
                progress=progress,
                warn=sweep_warning,
            )
        print(sweep_table(summary, where))
        if summary.interrupted:
            print("cosim: interrupted; the same command goes on where it stopped", file=sys.stderr)
            return 130
        check_some_succeeded(summary)
    found: list[Robustness] = []
    no_terminal = None  # tqdm's word for: no bar where there is no terminal to draw it on
    with tqdm(file=screen(), total=STEPS, desc="figures", delay=2.0, leave=False, disable=no_terminal) as bar:

        def write(where: Path) -> None:
            study = analyse(folder, where, args.seed, args.levels, bar.update)
            about = {name: getattr(study, name) for name in ("runs", "failed", "seed", "levels", "versions")}
            write_json(where / SUMMARY, about)
            found.append(study)

        results.put(write)
    print("\n".join(f"\n{finding.question}\n  {finding.answer}" for finding in found[-1].findings))
    print(f"\ntext, tables and figures: {folder} (in the report: cosim reproduce --robustness {folder})")
    return 0
