"""The program `cosim`."""

from __future__ import annotations

import argparse
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module

from cosim.errors import CosimError
from cosim.versions import versions

#: Modules in `cosim.commands`.
COMMANDS = ("run", "sweep", "tune", "reproduce", "robustness", "ssp", "validate", "compare")


def command_line(commands: Sequence[str] = COMMANDS) -> argparse.ArgumentParser:
    """The parser of commands and their options."""
    parser = argparse.ArgumentParser(
        prog="cosim", description="Co-simulation of a closed-chain robot and its controller as FMUs."
    )
    parser.add_argument("--version", action="version", version=versions()["closed-chain-cosim"])
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in commands:
        import_module(f"cosim.commands.{command}").register(subparsers)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit code: 0 only on success, 130 after Ctrl-C."""
    arguments = sys.argv[1:] if arguments is None else arguments
    # the others take a while to import
    asked_for = [argument for argument in arguments if argument in COMMANDS][:1]
    try:
        options = command_line(asked_for or COMMANDS).parse_args(arguments)
        return _run(options)
    except KeyboardInterrupt:
        print("cosim: interrupted", file=sys.stderr)
        return 130


def _run(options: argparse.Namespace) -> int:
    try:
        return int(options.run(options))
    except (CosimError, ValueError, OSError, MemoryError) as error:
        if options.debug:
            traceback.print_exc()
        else:
            print(f"cosim: {' '.join(str(error).split())}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
