"""What the robot's commands let choose from; apart from what does it, which takes a while to import."""

from __future__ import annotations

from pathlib import Path

#: Flavours of FMUs that can be built. The native ones need a C compiler to build and nothing to run.
FLAVOURS = ("fmi2", "fmi3", "pythonfmu")

#: What can be built and runs in browsers instead: WebAssembly modules, by the ziglang package.
WASM = "wasm"

#: Folder of the scenarios that come with the robot.
SCENARIOS = Path(__file__).parent / "scenarios"


def scenario_names() -> list[str]:
    """Names of the scenarios that come with the robot."""
    return sorted(path.stem for path in SCENARIOS.glob("*.toml"))
