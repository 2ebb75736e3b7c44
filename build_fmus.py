"""Build the FMUs: `python build_fmus.py` writes fmus/<flavour>/*.fmu, and fmus/wasm/*.wasm for browsers."""

from __future__ import annotations

import argparse
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from cosim.errors import CosimError
from fmu_export import ModelError
from parallel_robot.choices import FLAVOURS, WASM
from parallel_robot.fmus import BUILDABLE, build


def main(arguments: list[str] | None = None) -> int:
    """Build the chosen flavours; returns the exit code: 0 only when all of them could be built."""
    parser = argparse.ArgumentParser(
        description="Build the FMUs of robot, controller and trajectory, and the closed loop as one FMU."
    )
    parser.add_argument("--flavour", choices=(*FLAVOURS, WASM), action="append", help="flavour to build (default: all)")
    parser.add_argument("--fmu", choices=BUILDABLE, action="append", help="FMU to build (default: all)")
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="folder (default: fmus)")
    parser.add_argument(
        "--all-platforms", action="store_true", help="compile for all platforms, by zig (pip install ziglang)"
    )
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    failed = False
    flavours = options.flavour or [*FLAVOURS, WASM]
    if not options.flavour and not find_spec("ziglang"):
        print(f"note: flavour {WASM} is left out, for it needs zig: pip install ziglang")
        flavours.remove(WASM)
    for flavour in flavours:
        try:
            for path in build(options.fmus, flavour, options.fmu or BUILDABLE, all_platforms=options.all_platforms):
                print(f"{path}  {path.stat().st_size / 1024:.0f} kB")
        except (CosimError, ModelError) as error:  # the other flavours may still be built
            print(f"build_fmus.py: {error}", file=sys.stderr)
            failed = True
    print(f"built in {time.perf_counter() - began:.1f} s")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
