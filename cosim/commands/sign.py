"""`cosim sign`: sign FMUs with a key of one's own, or make one."""

from __future__ import annotations

import argparse
import getpass
import sys
from pathlib import Path
from typing import Any

from cosim.errors import CosimError

_EXAMPLES = """\
examples:
  cosim sign --new-key mine.pem
  cosim sign Model.fmu System.ssp --key mine.pem
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim sign`."""
    parser = subparsers.add_parser(
        "sign",
        help="sign FMUs and SSPs, so that others can check who made them",
        epilog=_EXAMPLES,
        description="Sign FMUs and SSPs with an Ed25519 key: FILE.sig beside each, which cosim verify checks.",
    )
    parser.add_argument("archive", nargs="*", type=Path, help="FMU or SSP")
    parser.add_argument("--key", type=Path, metavar="KEY", help="file of the private key (PEM)")
    parser.add_argument(
        "--new-key",
        type=Path,
        metavar="KEY",
        help="make a key first: KEY, which stays with you, and KEY.pub for those who verify",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim sign`; returns the exit code, raises CosimError with one line on bad input."""
    from cosim.signing import new_key, sign

    if args.new_key is not None and args.key is not None:
        raise CosimError("--new-key makes a key, and --key has one; give one of them")
    if args.new_key is not None:
        print(f"{args.new_key}.pub: {new_key(args.new_key, _new_passphrase())}")
    key = args.new_key or args.key
    if key is None:
        raise CosimError("no key is given: --key KEY, or make one with --new-key KEY")
    if not args.archive and args.new_key is None:
        raise CosimError("no archive is given; name an FMU or an SSP")
    asked: list[str] = []

    def passphrase() -> str:
        if not asked:
            asked.append(getpass.getpass(f"passphrase of {key}: "))
        return asked[0]

    for path in args.archive:
        print(sign(path, key, passphrase))
    return 0


def _new_passphrase() -> str:
    """A passphrase for a new key, on a terminal; none elsewhere."""
    if not sys.stdin.isatty():
        return ""
    first = getpass.getpass("passphrase of the new key (empty for none): ")
    if first and getpass.getpass("once more: ") != first:
        raise CosimError("the passphrases differ; try again")
    return first
