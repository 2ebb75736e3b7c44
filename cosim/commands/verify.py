"""`cosim verify`: who made an FMU, and whether it was changed since."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cosim.errors import CosimError, MissingExtra

_EXAMPLES = """\
examples:
  cosim verify Model.fmu System.ssp --key theirs.pem.pub
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim verify`."""
    parser = subparsers.add_parser(
        "verify",
        help="check the signatures of FMUs and SSPs",
        epilog=_EXAMPLES,
        description="Check that FMUs and SSPs are as the owner of a key has signed them; prints one line a file, exits "
        "1 on any that is not.",
    )
    parser.add_argument("archive", nargs="+", type=Path, help="FMU or SSP")
    parser.add_argument(
        "--key", action="append", required=True, type=Path, metavar="KEY", help="public key (PEM); may be repeated"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim verify`; returns the exit code."""
    from cosim.signing import verify

    wrong = False
    for path in args.archive:
        try:
            found = verify(path, args.key)
            print(f"{path}: signed with {found.key} ({found.fingerprint}), unchanged, {found.members} members")
        except MissingExtra:
            raise
        except (CosimError, OSError) as error:
            wrong = True
            print(error if isinstance(error, CosimError) else f"{path}: can't be read: {error.strerror or error}")
    return int(wrong)
