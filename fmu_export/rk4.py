"""One step of the classical Runge-Kutta method of order 4."""

from __future__ import annotations

from typing import Any

from fmu_export.model import Array, ModelFunction


def rk4_step(
    derivatives: ModelFunction,
    t: Any,
    x: Array,
    u: Array,
    p: Array,
    h: Any,
    u_rate: Any = 0.0,
    k1: Array | None = None,
) -> Array:
    """State (n_x,) at t + h (Kutta 1901; Hairer, Norsett, Wanner, table II.1.2).

    The inputs are u at t and change at `u_rate` per second: 0 holds them. Who knows the derivatives (n_x,) at t already
    gives them as `k1`.
    """
    u_half, u_end = u + h / 2.0 * u_rate, u + h * u_rate
    k1 = derivatives(t, x, u, p) if k1 is None else k1
    k2 = derivatives(t + h / 2.0, x + h / 2.0 * k1, u_half, p)
    k3 = derivatives(t + h / 2.0, x + h / 2.0 * k2, u_half, p)
    k4 = derivatives(t + h, x + h * k3, u_end, p)
    return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
