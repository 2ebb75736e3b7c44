"""Fixed-step co-simulation of FMUs (FMI 1.0, 2.0 and 3.0).

>>> from cosim import System, simulate
>>> system = System()
>>> system.add("plant", "fmus/fmi2/RobotPlant.fmu", start={"tau_d": [0, 0, 0], "dm": 0})
>>> system.drive("plant.tau_a", lambda t: [0.1, 0.1, 0.1])
>>> simulate(system, stop_time=0.1, step_size=1e-3, record=["plant.x_E", "plant.theta_a"])
Results: 101 rows, 0 to 0.1 s, 4 columns, completed
  plant: x_E, theta_a[1..3]
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used, since fmpy takes a while to import.
_MODULES = {
    "ArgumentError": "cosim.errors",
    "Checkpoint": "cosim.master.checkpoint",
    "Component": "cosim.system.system",
    "Connection": "cosim.system.system",
    "CosimError": "cosim.errors",
    "Extrapolation": "cosim.master.coupling.algorithm",
    "FormatError": "cosim.results.formats",
    "Limits": "cosim.fmi.isolation.limits",
    "Log": "cosim.fmi.message_log",
    "MissingExtra": "cosim.errors",
    "Order": "cosim.master.coupling.algorithm",
    "OutputError": "cosim.results.output",
    "Results": "cosim.results.results",
    "ResultsError": "cosim.errors",
    "RunState": "cosim.master.state",
    "SetupError": "cosim.errors",
    "Signal": "cosim.system.system",
    "SignalFunction": "cosim.system.system",
    "Simulation": "cosim.master.simulation",
    "SimulationError": "cosim.master.failures",
    "SimulationInterrupted": "cosim.master.failures",
    "Sink": "cosim.master.recording",
    "Steering": "cosim.master.steering",
    "SteppedRun": "cosim.master.stepping",
    "StoredResults": "cosim.results.stored",
    "System": "cosim.system.system",
    "TableWriter": "cosim.results.stored",
    "Units": "cosim.system.system",
    "VariableSpecs": "cosim.system.function",
    "register": "cosim.master.coupling.algorithm",
    "simulate": "cosim.master.simulation",
}

__all__ = [
    "ArgumentError",
    "Checkpoint",
    "Component",
    "Connection",
    "CosimError",
    "Extrapolation",
    "FormatError",
    "Limits",
    "Log",
    "MissingExtra",
    "Order",
    "OutputError",
    "Results",
    "ResultsError",
    "RunState",
    "SetupError",
    "Signal",
    "SignalFunction",
    "Simulation",
    "SimulationError",
    "SimulationInterrupted",
    "Sink",
    "Steering",
    "SteppedRun",
    "StoredResults",
    "System",
    "TableWriter",
    "Units",
    "VariableSpecs",
    "__version__",
    "register",
    "simulate",
]

if TYPE_CHECKING:
    __version__: str
    from cosim.errors import ArgumentError, CosimError, MissingExtra, ResultsError, SetupError
    from cosim.fmi.isolation.limits import Limits
    from cosim.fmi.message_log import Log
    from cosim.master.checkpoint import Checkpoint
    from cosim.master.coupling.algorithm import Extrapolation, Order, register
    from cosim.master.failures import SimulationError, SimulationInterrupted
    from cosim.master.recording import Sink
    from cosim.master.simulation import Simulation, simulate
    from cosim.master.state import RunState
    from cosim.master.steering import Steering
    from cosim.master.stepping import SteppedRun
    from cosim.results.formats import FormatError
    from cosim.results.output import OutputError
    from cosim.results.results import Results
    from cosim.results.stored import StoredResults, TableWriter
    from cosim.system.function import VariableSpecs
    from cosim.system.system import Component, Connection, Signal, SignalFunction, System, Units
else:

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            return import_module("cosim.versions").package_version()
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
