"""Analysis of coupled systems: when a co-simulation of linear, or linearised, components is stable.

>>> from cosim.analysis import LinearComponent, LinearSystem, largest_stable_step
>>> integrator = LinearComponent(A=[[0.0]], B=[[1.0]], C=[[1.0]], D=[[0.0]], inputs=["u"], outputs=["x"])
>>> gain = LinearComponent(A=(), B=(), C=(), D=[[-4.0]], inputs=["u"], outputs=["y"])
>>> system = LinearSystem({"i": integrator, "g": gain}, [("i.x", "g.u"), ("g.y", "i.u")])
>>> round(largest_stable_step(system, extrapolation="hold"), 3)
0.5
"""

from __future__ import annotations

from cosim.analysis.linear import LinearComponent, LinearSystem
from cosim.analysis.stability import (
    growth_along,
    largest_stable_step,
    largest_stable_step_along,
    spectral_radius,
    transition_matrix,
)

__all__ = [
    "LinearComponent",
    "LinearSystem",
    "growth_along",
    "largest_stable_step",
    "largest_stable_step_along",
    "spectral_radius",
    "transition_matrix",
]
