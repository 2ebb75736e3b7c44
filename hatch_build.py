"""Compile the stepping loop when the package is built or installed; `python hatch_build.py` does it in a checkout.

It takes the C compiler it finds; where there is none, pip brings zig for the time of the build: whoever installs the
package needs no compiler.
"""

from __future__ import annotations

import sys
import sysconfig
from importlib.util import find_spec
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ModuleNotFoundError:  # run as a script
    BuildHookInterface = object

sys.path.insert(0, str(Path(__file__).parent))

from cosim.loop.source import LIBRARY, SOURCE, source_hash
from fmu_export.native.toolchain import ToolchainError, compile_library, find_compiler


def compile_loop() -> Path:
    """Compile the loop beside its source; returns the library.

    Raises
    ------
    ToolchainError
        There is no C compiler, or it fails.
    """
    sources = {"loop.c": SOURCE.read_bytes(), "loop_hash.h": f'#define LOOP_HASH "{source_hash()}"\n'.encode()}
    part = LIBRARY.with_name(f"{LIBRARY.name}.part")
    part.write_bytes(compile_library(sources, LIBRARY.stem))
    part.replace(LIBRARY)  # a process that has the old one loaded keeps it
    return LIBRARY


class LoopBuildHook(BuildHookInterface):
    """hatchling's hook."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """What pip has to bring for the build."""
        try:
            find_compiler()
        except ToolchainError:
            return ["ziglang>=0.13"]
        return ["ziglang>=0.13"] if find_spec("ziglang") else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002
        """Compile, and have the library packed; it depends on the platform, but not on the version of Python."""
        if self.target_name != "wheel":
            return
        library = compile_loop()
        build_data["artifacts"].append(library.relative_to(self.root).as_posix())
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"


if __name__ == "__main__":
    print(compile_loop())
