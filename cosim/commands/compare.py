"""`cosim compare`: hold a result against a reference, one line a finding."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cosim.regression import Tolerances, compare
from cosim.results import Results


def register(subparsers: Any) -> None:
    """Add the parser of `cosim compare`."""
    parser = subparsers.add_parser(
        "compare",
        help="compare a result with a reference",
        description="Compare all signals of a reference CSV; prints one line a finding, exits 1 on any. Tolerances are "
        "read from the reference's name with .toml in place of .csv, if there is such a file.",
    )
    parser.add_argument("result", type=Path, help="CSV file of the result")
    parser.add_argument("reference", type=Path, help="CSV file of the reference")
    parser.add_argument("--tolerances", type=Path, metavar="TOML", help="another file of tolerances")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim compare`; returns 0 when nothing was found, else 1."""
    beside = args.reference.with_suffix(".toml")
    path = args.tolerances if args.tolerances is not None else (beside if beside.is_file() else None)
    tolerances = Tolerances() if path is None else Tolerances.from_toml(path)
    reference = Results.from_csv(args.reference)
    findings = compare(Results.from_csv(args.result), reference, tolerances)
    for finding in findings:
        print(finding)
    if not findings:
        print(f"{args.result}: all {len(reference.names)} signals agree with {args.reference}")
    return int(bool(findings))
