"""Configurations of the Open Simulation Platform (`OspSystemStructure.xml`): read them into a `System`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used.
_MODULES = {
    "OSPError": "cosim.osp.errors",
    "read_osp": "cosim.osp.reader",
}

__all__ = ["OSPError", "read_osp"]

if TYPE_CHECKING:
    from cosim.osp.errors import OSPError
    from cosim.osp.reader import read_osp
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.osp' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
