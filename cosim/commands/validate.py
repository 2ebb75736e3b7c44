"""`cosim validate`: check FMU files, and run them by the references that they bring along."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cosim.commands.options import add_signature_option, check_signatures
from cosim.errors import CosimError
from cosim.files.kinds import NPZ, SSP, WORKBOOK, kind_of, not_read
from cosim.files.temporary import TemporaryFolder
from cosim.fmi.fmu_file import read_fmu
from cosim.fmi.validation import problems_of

#: So many findings of one file are printed.
_MOST_PROBLEMS = 100

_EXAMPLES = """\
examples:
  cosim validate Model.fmu Other.fmu
  cosim validate Model.fmu --run --build
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim validate`."""
    parser = subparsers.add_parser(
        "validate",
        help="check FMU files",
        epilog=_EXAMPLES,
        description="Check FMU files; prints one line a finding, exits 1 on any.",
    )
    parser.add_argument("fmu", nargs="+", type=Path, help="FMU file")
    parser.add_argument(
        "--run",
        action="store_true",
        dest="run_references",
        help="also run the experiments that an FMU brings along (fmi-ls-ref), and compare with their reference results",
    )
    parser.add_argument(
        "--build",
        action="store_true",
        help="with --run: compile the C sources of FMUs that have no binary for this machine",
    )
    parser.add_argument(
        "--isolated",
        action="store_true",
        help="with --run: each FMU lives in a process of its own, which is the default where the platform can do that",
    )
    add_signature_option(parser)
    parser.set_defaults(run=run)


def _problems(path: Path) -> list[str]:
    """What is wrong with an FMU file, or not as its standard has it, a text each."""
    if not path.is_file():
        return ["there is no such file"]
    if kind_of(path) in (SSP, NPZ, WORKBOOK):
        return [not_read(path, "an FMU", "").removeprefix(f"{path}: ")]
    try:
        problems = problems_of(path)
        more = len(problems) - _MOST_PROBLEMS
        return problems[:_MOST_PROBLEMS] + ([f"and {more} findings more"] if more > 0 else [])
    except CosimError as error:
        return [str(error).removeprefix(f"{path}: ")]


def _run_references(path: Path, *, build: bool) -> bool:
    """Run the cases that an FMU brings along, one line each; whether anything was found."""
    from cosim.regression.outcome import check
    from cosim.regression.run import interfaces_of
    from cosim.regression.shipped import shipped_cases

    found = False
    with TemporaryFolder() as folder:
        try:
            shipped = shipped_cases(path, Path(folder))
            interfaces = interfaces_of(read_fmu(path, str(path))) if shipped.cases else []
        except CosimError as error:
            print(" ".join(str(error).split()))
            return True
        for note in shipped.notes:
            print(f"{path}: not tried: {note}")
        if not shipped.cases:
            print(f"{path}: brings no references along that can be run; nothing was run")
        for case in shipped.cases:
            for interface in interfaces:
                outcome = check(case, path, interface, build=build)
                spoken = {"co_simulation": "co-simulation", "model_exchange": "model exchange"}[interface]
                here = f"{path}: {case.name}, {spoken}"
                for finding in outcome.findings:
                    print(f"{here}: {' '.join(finding.split())}")
                if not outcome.findings:
                    print(f"{here}: {outcome.unclear or '; '.join(['ok', *outcome.notes])}")
                found = found or bool(outcome.findings)
    return found


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
        if args.run_references and path.is_file():
            check_signatures(args.require_signed, [path])
            found = _run_references(path, build=args.build) or found
    return int(found)
