"""`cosim ssp`: the robot's closed loop as one SSP archive, for other tools."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cosim.errors import needs
from cosim.results.output import OutputError
from parallel_robot.choices import FLAVOURS
from parallel_robot.commands.robot_fmus import chosen_flavour, make_ready

_EXAMPLES = """\
examples:
  cosim ssp
  cosim ssp --version 2.0 --flavour fmi3 --out robot.ssp
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim ssp`."""
    parser = subparsers.add_parser(
        "ssp",
        help="write the whole system as an SSP archive",
        epilog=_EXAMPLES,
        description="Write robot, controller and trajectory, their connections and units, a diagram, and the optimal "
        "gains of each row of Table 1 as parameter sets into an SSP archive.",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("RobotClosedLoop.ssp"), metavar="FILE", help="file (default %(default)s)"
    )
    parser.add_argument("--flavour", choices=FLAVOURS, help="flavour of the FMUs (default fmi2)")
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="FMU folder (default fmus)")
    parser.add_argument(
        "--mu", type=float, default=1.0, metavar="M", help="row of Table 1 for the controller (default 1)"
    )
    parser.add_argument("--nu", type=float, default=1.0, metavar="N", help="nu of that row (default 1)")
    parser.add_argument("--version", choices=("1.0", "2.0"), default="1.0", help="version of SSP (default %(default)s)")
    parser.set_defaults(run=run)


@needs("robot")
def run(args: argparse.Namespace) -> int:
    """Run `cosim ssp`; returns the exit code, raises CosimError with one line on bad input."""
    # xmlschema and SciPy take a while to import, and other commands don't need them
    from parallel_robot.ssp import write_robot_ssp

    flavour = chosen_flavour(args.fmus, args.flavour)
    make_ready(args.fmus, flavour)
    try:
        write_robot_ssp(args.out, args.fmus, flavour, row=(args.mu, args.nu), version=args.version)
    except OSError as error:
        raise OutputError(f"can't write {args.out}: {error.strerror or error}; choose another --out") from error
    print(f"wrote {args.out}; run it with: cosim run {args.out}")
    return 0
