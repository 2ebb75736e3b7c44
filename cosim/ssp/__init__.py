"""SSP archives (System Structure and Parameterization 1.0 and 2.0): read them into a `System`, write a `System` as one.

An SSP is a zip archive of FMUs, of `SystemStructure.ssd`, which says how they are connected, and of parameter sets
(SSV) and mappings of their names (SSM).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used: the schemas take a while to read, and need the extra ssp.
_MODULES = {
    "Experiment": "cosim.ssp.writer",
    "ParameterSet": "cosim.ssp.writer",
    "ReadSystem": "cosim.system.read",
    "SSPFile": "cosim.ssp.editing",
    "SSPError": "cosim.ssp.errors",
    "read_ssp": "cosim.ssp.reader",
    "write_ssp": "cosim.ssp.writer",
}

__all__ = [
    "Experiment",
    "ParameterSet",
    "ReadSystem",
    "SSPError",
    "SSPFile",
    "read_ssp",
    "write_ssp",
]

if TYPE_CHECKING:
    from cosim.ssp.editing import SSPFile
    from cosim.ssp.errors import SSPError
    from cosim.ssp.reader import read_ssp
    from cosim.ssp.writer import Experiment, ParameterSet, write_ssp
    from cosim.system.read import ReadSystem
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.ssp' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
