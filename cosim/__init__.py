"""Fixed-step co-simulation of FMUs (FMI 2.0 and 3.0).

>>> from cosim import System, simulate
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.errors import CosimError, SetupError
    from cosim.failures import SimulationError, SimulationInterrupted
    from cosim.master import simulate
    from cosim.results import Results
    from cosim.simulation import Simulation
    from cosim.system import Signal, System

#: Name -> module; loaded when first used, since fmpy takes a while to import.
_MODULES = {
    "CosimError": "cosim.errors",
    "Results": "cosim.results",
    "SetupError": "cosim.errors",
    "Signal": "cosim.system",
    "Simulation": "cosim.simulation",
    "SimulationError": "cosim.failures",
    "SimulationInterrupted": "cosim.failures",
    "System": "cosim.system",
    "simulate": "cosim.master",
}

__all__ = [
    "CosimError",
    "Results",
    "SetupError",
    "Signal",
    "Simulation",
    "SimulationError",
    "SimulationInterrupted",
    "System",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'cosim' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
