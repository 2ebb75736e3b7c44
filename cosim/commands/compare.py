"""`cosim compare`: compare a result with a reference, one line a finding."""

from __future__ import annotations

import argparse
import dataclasses
import math
import time as clock
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cosim.regression.comparison import compare_signals
from cosim.regression.tolerances import ToleranceError, Tolerances
from cosim.results.results import Results

#: So many signals that the reference lacks are named.
_MOST_NAMED = 5

_EXAMPLES = """\
examples:
  cosim compare results/tanks/results.csv reference.csv --rtol 1e-4
  cosim compare mine.parquet theirs.mat --atol 1e-3 --report differences.html
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim compare`."""
    parser = subparsers.add_parser(
        "compare",
        help="compare a result with a reference",
        epilog=_EXAMPLES,
        description="Compare all signals of a reference; prints one line a finding, exits 1 on any. Both are tables: "
        "CSV, Parquet, MAT, .npz or JSON. Tolerances are read from the reference's name with .toml in place of .csv, "
        "if there is such a file. To run FMUs and compare them in one go: pytest --fmu FMU (docs/regression.md).",
    )
    parser.add_argument("result", type=Path, help="file of the result")
    parser.add_argument("reference", type=Path, help="file of the reference")
    parser.add_argument("--tolerances", type=Path, metavar="TOML", help="another file of tolerances")
    parser.add_argument(
        "--rtol",
        type=float,
        metavar="R",
        help="relative tolerance: of the range of each signal (default 1e-9); in place of that of the file",
    )
    parser.add_argument(
        "--atol",
        type=float,
        metavar="A",
        help="absolute tolerance, in the unit of each signal (default 0); in place of that of the file",
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a page with curves and bands")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim compare`; returns 0 when nothing was found, else 1."""
    began = clock.perf_counter()
    result, reference = Results.read(args.result), Results.read(args.reference)
    beside = args.reference.with_suffix(".toml")
    path = args.tolerances if args.tolerances is not None else (beside if beside.is_file() else None)
    tolerances = _with_options(Tolerances() if path is None else Tolerances.from_toml(path), args)
    comparison = compare_signals(result, reference, tolerances)
    for finding in comparison.findings:
        print(finding)
    if not comparison.findings:
        agreement = f"{args.result}: all {len(reference.names)} signals agree with {args.reference}"
        print(agreement + _further(result.names, reference.names))
    if args.report is not None:
        from cosim.regression.outcome import Outcome
        from cosim.regression.page import part, write_page

        seconds = clock.perf_counter() - began
        outcome = Outcome(
            args.reference.stem, str(args.result), "", comparison.findings, comparison.signals, "", seconds
        )
        off = sum(bool(signal.finding) for signal in comparison.signals)
        said = f"{off} of {len(reference.names)} signals differ" if comparison.findings else "all signals agree"
        write_page([part(outcome)], args.report, f"{args.result} against {args.reference}: {said}")
    return int(bool(comparison.findings))


def _further(names: Sequence[str], known: Sequence[str]) -> str:
    """What is said of signals that nothing is compared with."""
    further = [name for name in names if name not in known]
    if not further:
        return ""
    more = f" and {len(further) - _MOST_NAMED} more" if len(further) > _MOST_NAMED else ""
    return f", which lacks {', '.join(further[:_MOST_NAMED])}{more}"


def _with_options(tolerances: Tolerances, args: argparse.Namespace) -> Tolerances:
    """The tolerances of a file, with the common ones of the command line; signals keep their own.

    Raises
    ------
    ToleranceError
        An option is no tolerance.
    """
    given = {}
    for option, key, value in (("--rtol", "relative", args.rtol), ("--atol", "absolute", args.atol)):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise ToleranceError(f"{option} {value}: must be a finite number, 0 or greater")
        if value is not None:
            given[key] = value
    return dataclasses.replace(tolerances, **given)
