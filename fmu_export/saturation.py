"""Saturation, for models: the limit holds to the last bit, NaN stays NaN, and it can be differentiated everywhere."""

from __future__ import annotations

from fmu_export.model import Array


def saturate(v: Array, limit: Array) -> Array:
    """The values v (n,), each within -limit to limit (n,), limits at least 0.

    Where a limit is reached the derivative is 0, at the kink itself too. Written with minimum and maximum, the C of a
    traced model would turn NaN into a limit, and so hide it.
    """
    inside = (v < limit) * (-limit < v)
    # a value inside comes out as it went in; the other terms are then 0
    return v * inside + limit * (limit <= v) - limit * (v <= -limit)
