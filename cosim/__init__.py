"""Fixed-step co-simulation of FMUs (FMI 2.0 and 3.0).

>>> from cosim import System, simulate
"""

from cosim.errors import CosimError, SetupError
from cosim.failures import SimulationError, SimulationInterrupted
from cosim.master import simulate
from cosim.results import Results
from cosim.system import System

__all__ = ["CosimError", "Results", "SetupError", "SimulationError", "SimulationInterrupted", "System", "simulate"]
