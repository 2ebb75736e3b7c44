"""Compile the stepping loop and the library of packed FMUs when the package is built or installed.

In a checkout `python hatch_build.py` does it.

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

from cosim.loop.source import LIBRARY, SYSTEM_LIBRARIES, loop_sources
from cosim.pack.source import LIBRARY as PACKED_LIBRARY
from cosim.pack.source import SYSTEM_LIBRARIES as PACKED_SYSTEM_LIBRARIES
from cosim.pack.source import library_sources
from fmu_export.native.toolchain import ToolchainError, compile_library, find_compiler


def compile_loop() -> Path:
    """Compile the loop beside its source; returns the library.

    Raises
    ------
    ToolchainError
        There is no C compiler, or it fails.
    """
    return _replace(LIBRARY, compile_library(loop_sources(), LIBRARY.stem, libraries=SYSTEM_LIBRARIES))


def compile_packed() -> Path:
    """Compile the library of packed FMUs beside its sources; returns it.

    Raises
    ------
    ToolchainError
        There is no C compiler, or it fails.
    """
    library = compile_library(library_sources(), PACKED_LIBRARY.stem, libraries=PACKED_SYSTEM_LIBRARIES)
    return _replace(PACKED_LIBRARY, library)


def _replace(library: Path, content: bytes) -> Path:
    part = library.with_name(f"{library.name}.part")
    part.write_bytes(content)
    part.replace(library)  # a process that has the old one loaded keeps it
    return library


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
        libraries = (compile_loop(), compile_packed())
        build_data["artifacts"] += [library.relative_to(self.root).as_posix() for library in libraries]
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"


if __name__ == "__main__":
    print(compile_loop())
    print(compile_packed())
