"""numpy's functions that look up in tables, on arrays of symbols."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fmu_export.trace.symbols.arrays import Array, depends, plain
from fmu_export.trace.symbols.refusal import refuse


def _searchsorted(a: Any, v: Any, side: str = "left", sorter: Any = None) -> Any:
    if sorter is not None:
        refuse("np.searchsorted with sorter= can't be traced")
    if depends(a):
        refuse("np.searchsorted and np.digitize with symbols as edges can't be traced; the edges must be numbers")
    place: Any = 0
    for edge in plain(a):  # NaN is sorted behind all numbers
        place = place + (~(v <= edge) if side == "left" else ~(v < edge)) * 1
    return place


def _interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None) -> Any:
    if depends(xp) or depends(period):
        refuse("np.interp with symbols as places of its table can't be traced; the places must be numbers")
    xs, ys = np.asarray(plain(xp), dtype=float), fp if type(fp) in (Array, list, tuple) else np.asarray(fp)
    ys = np.array(ys) if isinstance(ys, list | tuple) else ys
    if xs.ndim != 1 or np.shape(ys) != xs.shape:
        refuse("np.interp needs as many values as places, along one axis")
    if period is not None:
        period = abs(float(period))
        left = right = None
        order = np.argsort(xs % period)
        x, xs = x % period, (xs % period)[order]
        ys = ys[order]
        xs = np.concatenate((xs[-1:] - period, xs, xs[:1] + period))
        ys = np.concatenate((ys[-1:], ys, ys[:1]))
    if not np.all(np.diff(xs) > 0.0):
        refuse("np.interp with places that do not grow can't be traced")
    ends = ys[0] if left is None else left, ys[-1] if right is None else right
    if len(xs) == 1:
        return np.where(x < xs[0], ends[0], np.where(x > xs[0], ends[1], np.where(np.isnan(x), x, ys[0])))
    slope, x0, y0 = (ys[1] - ys[0]) / (xs[1] - xs[0]), xs[0], ys[0]
    for j in range(1, len(xs) - 1):
        beyond = x >= xs[j]
        slope = np.where(beyond, (ys[j + 1] - ys[j]) / (xs[j + 1] - xs[j]), slope)
        x0, y0 = np.where(beyond, xs[j], x0), np.where(beyond, ys[j], y0)
    inside = slope * (x - x0) + y0
    return np.where(x < xs[0], ends[0], np.where(x > xs[-1], ends[1], np.where(x == xs[-1], ys[-1], inside)))


HANDLERS: dict[Any, Callable[..., Any]] = {
    np.searchsorted: _searchsorted,
    np.digitize: lambda x, bins, right=False: _searchsorted(bins, x, "left" if right else "right"),
    np.interp: _interp,
}
