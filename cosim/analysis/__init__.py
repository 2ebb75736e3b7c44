"""Analysis of coupled systems: when a co-simulation of linear, or linearised, components is stable.

>>> from cosim.analysis import LinearComponent, LinearSystem, largest_stable_step
>>> integrator = LinearComponent(A=[[0.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]], inputs=["u"], outputs=["x"])
>>> gain = LinearComponent(A=(), B=(), C=(), D=[[-4.0]], inputs=["u"], outputs=["y"])
>>> system = LinearSystem({"i": integrator, "g": gain}, [("i.x", "g.u"), ("g.y", "i.u")])
>>> round(largest_stable_step(system, extrapolation="hold"), 3)
0.5
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used.
_MODULES = {
    "LinearComponent": "cosim.analysis.linear",
    "LinearSystem": "cosim.analysis.linear",
    "growth_along": "cosim.analysis.stability",
    "largest_stable_step": "cosim.analysis.stability",
    "largest_stable_step_along": "cosim.analysis.stability",
    "spectral_radius": "cosim.analysis.stability",
    "transition_matrix": "cosim.analysis.stability",
}

__all__ = [
    "LinearComponent",
    "LinearSystem",
    "growth_along",
    "largest_stable_step",
    "largest_stable_step_along",
    "spectral_radius",
    "transition_matrix",
]

if TYPE_CHECKING:
    from cosim.analysis.linear import LinearComponent, LinearSystem
    from cosim.analysis.stability import (
        growth_along,
        largest_stable_step,
        largest_stable_step_along,
        spectral_radius,
        transition_matrix,
    )
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.analysis' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
