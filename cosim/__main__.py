"""The program `cosim`."""

from __future__ import annotations

import argparse
import sys
import traceback
from collections.abc import Sequence

from cosim.commands import compare, reproduce, robustness, run, ssp, sweep, tune, validate
from cosim.errors import CosimError
from cosim.versions import versions


def command_line() -> argparse.ArgumentParser:
    """The parser of all commands and their options."""
    parser = argparse.ArgumentParser(
        prog="cosim", description="Co-simulation of a closed-chain robot and its controller as FMUs."
    )
    parser.add_argument("--version", action="version", version=versions()["closed-chain-cosim"])
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in (run, sweep, tune, reproduce, robustness, ssp, validate, compare):
        command.register(subparsers)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit code: 0 only on success, 130 after Ctrl-C."""
    options = command_line().parse_args(arguments)
    try:
        return int(options.run(options))
    except KeyboardInterrupt:
        print("cosim: interrupted", file=sys.stderr)
        return 130
    except (CosimError, ValueError, OSError, MemoryError) as error:
        if options.debug:
            traceback.print_exc()
        else:
            print(f"cosim: {' '.join(str(error).split())}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
