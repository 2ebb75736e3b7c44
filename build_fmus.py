"""Build the FMUs: `python build_fmus.py` writes fmus/<flavour>/*.fmu, and fmus/wasm/*.wasm for browsers.

Their SHA-256 are in fmus/fmus.sha256. Equal sources, tools and platforms give equal ones: `--all-platforms`, which
compiles by zig, with the packages of requirements/all.txt.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from cosim.errors import CosimError
from fmu_export import ModelError
from parallel_robot.choices import FLAVOURS, WASM
from parallel_robot.fmus import BUILDABLE, build

#: File of the SHA-256 of all FMUs, in their folder.
HASHES = "fmus.sha256"


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
    parser.add_argument(
        "--check",
        type=Path,
        metavar="FILE",
        help=f"compare with published hashes, those of a {HASHES}; exits 1 where one differs",
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
    if not failed:
        write_hashes(options.fmus)
        failed = options.check is not None and not has_hashes(options.fmus, options.check)
    return int(failed)


def write_hashes(folder: Path) -> None:
    """Write the SHA-256 of all FMUs in a folder into `<folder>/fmus.sha256`, as `sha256sum -c` reads them."""
    lines = [f"{sha256}  {name}\n" for name, sha256 in hashes_of(folder).items()]
    (folder / HASHES).write_text("".join(lines), encoding="utf-8", newline="\n")


def hashes_of(folder: Path) -> dict[str, str]:
    """Name below a folder -> SHA-256 of its FMUs, and of modules for browsers."""
    paths = sorted(path for path in folder.glob("*/*") if path.suffix in (".fmu", ".wasm"))
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def has_hashes(folder: Path, published: Path) -> bool:
    """Whether the FMUs in a folder are those that a file of hashes lists; says which are not."""
    found, same = hashes_of(folder), True
    for line in published.read_text(encoding="utf-8").splitlines():
        sha256, _, name = line.partition("  ")
        if found.get(name) != sha256:
            print(f"build_fmus.py: {name} is {'missing' if name not in found else 'not that of ' + str(published)}")
            same = False
    return same


if __name__ == "__main__":
    sys.exit(main())
