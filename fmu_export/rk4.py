"""One step of the classical Runge-Kutta method of order 4."""

from __future__ import annotations

from typing import Any

from fmu_export.model import Array, ModelFunction


def rk4_step(derivatives: ModelFunction, t: Any, x: Array, u: Array, p: Array, h: Any) -> Array:
    """State (n_x,) at t + h with the inputs held (Kutta 1901; Hairer, Norsett, Wanner, table II.1.2)."""
    k1 = derivatives(t, x, u, p)
    k2 = derivatives(t + h / 2.0, x + h / 2.0 * k1, u, p)
    k3 = derivatives(t + h / 2.0, x + h / 2.0 * k2, u, p)
    k4 = derivatives(t + h, x + h * k3, u, p)
    return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
