"""`cosim reproduce`: the paper's figures, table, claims and errata, from runs of the FMUs."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from cosim.commands.options import add_overwrite_option
from cosim.errors import CosimError, needs
from cosim.results.output import ResultFolder
from cosim.terminal import screen
from parallel_robot.commands.robot_fmus import make_ready

if TYPE_CHECKING:
    from parallel_robot.paper.reproduce.content import Reproduction
    from parallel_robot.paper.robustness.content import Robustness


class ReproductionError(CosimError):
    """Something that was computed differs from what it has to be; the files are written all the same."""


_EXAMPLES = """\
examples:
  cosim reproduce
  cosim reproduce --out results/paper --robustness results/robustness
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim reproduce`."""
    parser = subparsers.add_parser(
        "reproduce",
        help="reproduce the paper: figures, Table 1, claims, errata",
        epilog=_EXAMPLES,
        description="Run the paper's six controllers and its open loop from FMU files, draw Figs. 4 to 17, compute "
        "Table 1, "
        "and judge every claim. Writes figures/, table1.csv, claims.json, errata.json, summary.json and report.html.",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("results/reproduction"), metavar="DIR", help="folder (default %(default)s)"
    )
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="FMU folder (default fmus)")
    parser.add_argument(
        "--robustness", type=Path, metavar="DIR", help="results of `cosim robustness`, for a section of the report"
    )
    add_overwrite_option(parser)
    parser.set_defaults(run=run)


@needs("robot")
def run(args: argparse.Namespace) -> int:
    """Run `cosim reproduce`; returns the exit code, raises CosimError with one line when it fails."""
    # matplotlib and SciPy take a while to import, and other commands don't need them
    from parallel_robot.paper.reproduce import run as reproduction
    from parallel_robot.paper.reproduce.runs import FLAVOUR, run_all
    from parallel_robot.paper.robustness.content import load

    folder: Path = args.out
    found: list[Reproduction] = []
    with (
        ResultFolder(folder, reproduction.TABLES, overwrite=args.overwrite) as results,
        _progress(reproduction.number_of_steps()) as progress,
    ):
        study = None if args.robustness is None else (load(args.robustness), args.robustness)
        make_ready(args.fmus, FLAVOUR)
        runs = run_all(args.fmus, progress)

        def write(where: Path) -> None:
            content = reproduction.reproduce(runs, where, progress)
            _write_report(content, where, study, args.fmus)
            found.append(content)

        results.put(write)
    content = found[-1]
    print(_in_words(content, folder))
    _check(content)
    return 0


def _write_report(content: Reproduction, folder: Path, study: tuple[Robustness, Path] | None, fmus: Path) -> None:
    from parallel_robot.fmus import BuildError
    from parallel_robot.live.page import live_section
    from parallel_robot.paper.report import write_report

    try:
        live = live_section(fmus)
    except BuildError as error:
        print(f"note: the report has no gains to turn, because {error}")
        live = None
    write_report(content, folder, study, live)


def _check(content: Reproduction) -> None:
    """What has to come out, whatever the paper's claims come to.

    Raises
    ------
    ReproductionError
        Table 1 differs from what is printed, or an erratum can't be shown.
    """
    wrong = [f"Table 1, row ({row.mu:g}, {row.nu:g})" for row in content.table1 if not row.agrees]
    wrong += [f"erratum '{erratum.id}'" for erratum in content.errata if not erratum.shown]
    if wrong:
        raise ReproductionError(f"not reproduced: {', '.join(wrong)}; rebuild the FMUs with: python build_fmus.py")


@contextmanager
def _progress(total: int) -> Iterator[Callable[[str], None]]:
    """A progress bar, drawn when the work takes more than two seconds and there is a terminal."""
    layout = "{desc} {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} {postfix} [{elapsed}<{remaining}]"
    with tqdm(
        file=screen(), total=total, desc="reproducing", delay=2.0, leave=False, bar_format=layout, disable=None
    ) as bar:

        def report(what: str) -> None:
            bar.set_postfix_str(what, refresh=False)
            bar.update()

        yield report


def _in_words(content: Reproduction, folder: Path) -> str:
    """Every claim with its verdict, for people."""
    width = max(len(claim.id) for claim in content.claims)
    lines = [f"{claim.id:<{width}}  {claim.verdict}" for claim in content.claims]
    verdicts = [claim.verdict for claim in content.claims]
    counts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(sorted(verdicts)))
    agree = sum(row.agrees for row in content.table1)
    lines += [
        "",
        f"claims: {counts}",
        f"Table 1: {agree} of {len(content.table1)} rows to the printed digits",
        f"errata: {sum(e.shown for e in content.errata)} of {len(content.errata)} shown",
        f"figures, tables and report: {folder}",
    ]
    return "\n".join(lines)
