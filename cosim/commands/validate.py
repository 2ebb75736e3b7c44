"""`cosim validate`: check FMU files with fmpy's validator, one line a finding."""

from __future__ import annotations

import argparse
import zipfile
from pathlib import Path
from typing import Any

from fmpy.validation import validate_fmu

from cosim.file_kinds import FMU, NPZ, SSP, WORKBOOK, kind_of, not_read


def register(subparsers: Any) -> None:
    """Add the parser of `cosim validate`."""
    parser = subparsers.add_parser(
        "validate", help="check FMU files", description="Check FMU files; prints one line a finding, exits 1 on any."
    )
    parser.add_argument("fmu", nargs="+", type=Path, help="FMU file")
    parser.set_defaults(run=run)


def _problems(path: Path) -> list[str]:
    if not path.is_file():
        return ["there is no such file"]
    if kind_of(path) in (SSP, NPZ, WORKBOOK):
        return [not_read(path, "an FMU", "").removeprefix(f"{path}: ")]
    try:
        return list(validate_fmu(str(path)))
    except zipfile.BadZipFile:
        return [not_read(path, "an FMU", "not an FMU (not a zip archive)", FMU).removeprefix(f"{path}: ")]


def run(args: argparse.Namespace) -> int:
    """Run `cosim validate`; returns 0 when nothing was found, else 1."""
    found = False
    for path in args.fmu:
        problems = _problems(path)
        for problem in problems:
            print(f"{path}: {' '.join(problem.split())}")
        found = found or bool(problems)
        if not problems:
            print(f"{path}: ok")
    return int(found)
