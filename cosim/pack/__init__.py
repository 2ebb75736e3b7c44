"""A whole system as one FMU, without Python: `pack`, and the command `cosim pack`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used, since the build of the package reads `cosim.pack.source` without fmpy.
_MODULES = {"PackedFMU": "cosim.pack.packing", "pack": "cosim.pack.packing"}

__all__ = ["PackedFMU", "pack"]

if TYPE_CHECKING:
    from cosim.pack.packing import PackedFMU, pack
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.pack' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
