"""FMUs of the user in place of the robot's, as a controller of one's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cosim.scenario import own_fmus
from cosim.system.system import System
from parallel_robot.wiring import OPTIONAL_INPUTS


def replaced(system: System, fmus: Mapping[str, Path]) -> tuple[System, list[str]]:
    """As `cosim.scenario.replaced`; what feeds the inputs of `OPTIONAL_INPUTS` may be missing."""
    return own_fmus.replaced(system, fmus, OPTIONAL_INPUTS)
