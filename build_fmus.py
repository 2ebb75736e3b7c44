"""Build the FMUs: `python build_fmus.py` writes fmus/<flavour>/*.fmu."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from cosim.errors import CosimError
from cosim.robot.fmus import FLAVOURS, build


def main(arguments: list[str] | None = None) -> int:
    """Build the chosen flavours; returns the exit code."""
    parser = argparse.ArgumentParser(description="Build the FMUs of robot, controller and trajectory.")
    parser.add_argument("--flavour", choices=FLAVOURS, action="append", help="flavour to build (default: all)")
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="folder (default: fmus)")
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    try:
        for flavour in options.flavour or FLAVOURS:
            for path in build(options.fmus, flavour):
                print(f"{path}  {path.stat().st_size / 1024:.0f} kB")
    except CosimError as error:
        print(f"build_fmus.py: {error}", file=sys.stderr)
        return 1
    print(f"built in {time.perf_counter() - began:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
