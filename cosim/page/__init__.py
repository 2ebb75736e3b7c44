"""Pages of HTML that need no other file: their frame, plots, diagrams and servers; what is shown comes from above.

A package adds a section to the pages of runs by a function in the entry-point group `cosim.pages`, which gives a
`Section`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used.
_MODULES = {"Section": "cosim.page.document"}

__all__ = ["Section"]

if TYPE_CHECKING:
    from cosim.page.document import Section
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.page' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
