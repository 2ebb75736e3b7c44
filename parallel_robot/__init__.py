"""The parallel robot of Han et al. 2021 under adaptive robust control: everything that knows this robot."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cosim.errors import needs

#: Name -> module; loaded when first used, since SciPy and matplotlib take a while to import.
_MODULES = {
    "BuildError": "parallel_robot.fmus",
    "CONNECTIONS": "parallel_robot.wiring",
    "MODELS": "parallel_robot.models",
    "RobotScenario": "parallel_robot.scenario",
    "build": "parallel_robot.fmus",
    "closed_loop_poles": "parallel_robot.stability",
    "inconsistency": "parallel_robot.mechanics",
    "largest_stable_step": "parallel_robot.stability",
    "load_scenario": "parallel_robot.scenario",
    "transmission_map": "parallel_robot.workspace",
    "udwadia_kalaba": "parallel_robot.mechanics",
    "write_figures": "parallel_robot.figures",
    "write_robot_ssp": "parallel_robot.ssp",
}

__all__ = [
    "CONNECTIONS",
    "MODELS",
    "BuildError",
    "RobotScenario",
    "build",
    "closed_loop_poles",
    "inconsistency",
    "largest_stable_step",
    "load_scenario",
    "transmission_map",
    "udwadia_kalaba",
    "write_figures",
    "write_robot_ssp",
]

if TYPE_CHECKING:
    from parallel_robot.figures import write_figures
    from parallel_robot.fmus import BuildError, build
    from parallel_robot.mechanics import inconsistency, udwadia_kalaba
    from parallel_robot.models import MODELS
    from parallel_robot.scenario import RobotScenario, load_scenario
    from parallel_robot.ssp import write_robot_ssp
    from parallel_robot.stability import closed_loop_poles, largest_stable_step
    from parallel_robot.wiring import CONNECTIONS
    from parallel_robot.workspace import transmission_map
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'parallel_robot' has no attribute {name!r}")
        with needs("robot"):
            return getattr(import_module(_MODULES[name]), name)
