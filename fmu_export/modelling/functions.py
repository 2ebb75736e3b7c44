"""Functions for models that need care to be traced or differentiated: length of a vector, saturation, Runge-Kutta."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fmu_export.modelling.model import ModelFunction
from fmu_export.modelling.variables import Array


def norm(v: Array) -> Any:
    """Euclidean norm of a vector (n,), which can be differentiated everywhere.

    At v = 0, where the norm has a kink, the derivative of its square root is 1/0, and importers that ask an FMU for
    directional derivatives would get NaN. Written as below, the derivative along any direction is 0 there, which is
    what central differences give.
    """
    square = v @ v
    return square / np.sqrt(square + (square == 0.0))


def saturate(v: Array, limit: Array) -> Array:
    """The values v (n,), each within -limit to limit (n,), limits at least 0.

    The limit holds to the last bit, NaN stays NaN. Where a limit is reached the derivative is 0, at the kink itself
    too. Written with minimum and maximum, the C of a traced model would turn NaN into a limit, and so hide it.
    """
    inside = (v < limit) * (-limit < v)
    # a value inside comes out as it went in; the other terms are then 0
    return v * inside + limit * (limit <= v) - limit * (v <= -limit)


def numeric(function: Callable[..., Any]) -> Callable[..., np.ndarray]:
    """A function of a model that always returns an array of floats, and no list, as an author may."""
    return lambda *arguments: np.asarray(function(*arguments), dtype=float)


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
    """State (n_x,) at t + h, by the classical Runge-Kutta method of order 4.

    After Kutta 1901; Hairer, Norsett, Wanner, table II.1.2. The inputs are u at t and change at `u_rate` per second:
    0 holds them. Who knows the derivatives (n_x,) at t already gives them as `k1`.
    """
    u_half, u_end = u + h / 2.0 * u_rate, u + h * u_rate
    k1 = derivatives(t, x, u, p) if k1 is None else k1
    k2 = derivatives(t + h / 2.0, x + h / 2.0 * k1, u_half, p)
    k3 = derivatives(t + h / 2.0, x + h / 2.0 * k2, u_half, p)
    k4 = derivatives(t + h, x + h * k3, u_end, p)
    return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def rk4_defect(
    derivatives: ModelFunction, t: Any, x: Array, u_quarter: Array, p: Array, h: Any, stages: Sequence[Array]
) -> Array:
    """What is wrong with such a step (n_x,): its length times what the derivatives are off after a quarter of it.

    There they are compared with those of the polynomial of degree 3 that the stages give. At the middle and at the ends
    that would not see what depends on time only. The inputs there are `u_quarter`; `stages` are the four derivatives
    of the step from x at t.
    """
    k1, k2, k3, k4 = stages
    early = x + h / 96.0 * (16.0 * k1 + 5.0 * (k2 + k3) - 2.0 * k4)
    return h * (derivatives(t + 0.25 * h, early, u_quarter, p) - 0.125 * (3.0 * (k1 + k2 + k3) - k4))
