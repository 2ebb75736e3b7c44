"""`cosim live`: the page on which the robot answers to the gains."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cosim.errors import needs

_EXAMPLES = """\
examples:
  cosim live
  cosim live --out robot.html
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim live`."""
    parser = subparsers.add_parser(
        "live",
        help="write a page on which the robot answers to the gains",
        epilog=_EXAMPLES,
        description="Write a page that computes the robot's closed loop in the browser, as WebAssembly: controls of "
        "gains, path, start and what acts on the robot, presets, and the map of J. One file that loads nothing.",
    )
    parser.add_argument("--out", type=Path, default=Path("live.html"), metavar="FILE", help="default: %(default)s")
    parser.add_argument(
        "--fmus",
        type=Path,
        default=Path("fmus"),
        metavar="DIR",
        help="where the modules are built (default: %(default)s)",
    )
    parser.set_defaults(run=run)


@needs("robot")
def run(args: argparse.Namespace) -> int:
    """Run `cosim live`; returns the exit code."""
    # CasADi and SciPy take a while to import, and other commands don't need them
    from cosim.files.whole import write_whole
    from parallel_robot.live.page import live_page

    page = live_page(args.fmus)
    write_whole(args.out, lambda part: part.write_text(page, encoding="utf-8"))
    print(f"wrote {args.out}, {args.out.stat().st_size / 1024:.0f} kB")
    return 0
