"""numpy's functions that make one value of many, on arrays of symbols: sums, means, extremes, orders."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fmu_export.trace.symbols.arrays import (
    BOOL,
    FLOAT,
    INT,
    NEUTRAL,
    Array,
    Selection,
    as_array,
    cast_elements,
    elements_of,
    unwrapped,
)
from fmu_export.trace.symbols.refusal import refuse
from fmu_export.trace.symbols.ufuncs import accumulated, reduced

_NOTHING = np._NoValue


def _typed(a: Any, dtype: Any) -> Any:
    """An array in the type that dtype= asks for."""
    if dtype is None:
        return a
    if np.dtype(dtype) not in (FLOAT, INT, BOOL):
        refuse(f"the type {np.dtype(dtype)} can't be traced; only float, int and bool")
    base, kind = elements_of(a)
    return Array(cast_elements(base, kind, np.dtype(dtype)), np.dtype(dtype))


def _reduction(ufunc: np.ufunc) -> Callable[..., Any]:
    def reduce(
        a: Any,
        axis: Any = None,
        dtype: Any = None,
        out: Any = None,
        keepdims: Any = False,
        initial: Any = _NOTHING,
        where: Any = True,
    ) -> Any:
        if out is not None:
            refuse(f"np.{ufunc.__name__}.reduce with a fourth argument can't be traced; write out=")
        plain = initial is _NOTHING and where is True
        if type(a) is Selection:
            return (
                a.__array_ufunc__(ufunc, "reduce", a) if plain else refuse("initial= and where= of what a mask selects")
            )
        a = _typed(a, dtype)
        if where is not True and where is not _NOTHING:
            neutral = NEUTRAL.get(ufunc, initial)
            if neutral is _NOTHING:
                refuse(f"np.{ufunc.__name__}.reduce with where= and without initial= has no value where none is taken")
            a = np.where(where, a, neutral)
        base, kind = reduced(ufunc, a, axis, keepdims is True)
        result = unwrapped(base if base.ndim else base.item(), kind)
        return result if initial is _NOTHING else ufunc(initial, result)

    return reduce


def _extreme(ufunc: np.ufunc) -> Callable[..., Any]:
    reduce = _reduction(ufunc)

    def extreme(
        a: Any,
        axis: Any = None,
        out: Any = None,
        keepdims: Any = False,
        initial: Any = _NOTHING,
        where: Any = True,
    ) -> Any:
        return reduce(a, axis, None, out, keepdims, initial, where)

    return extreme


def _cumulative(ufunc: np.ufunc) -> Callable[..., Any]:
    def accumulate(a: Any, axis: Any = None, dtype: Any = None) -> Any:
        a = _typed(np.ravel(a) if axis is None else a, dtype)
        return Array(*accumulated(ufunc, a, 0 if axis is None else axis))

    return accumulate


def _mean(
    a: Any, axis: Any = None, dtype: Any = None, out: Any = None, keepdims: Any = False, where: Any = True
) -> Any:
    if out is not None:
        refuse("np.mean with a fourth argument can't be traced; write out=")
    if type(a) is Selection:
        return a.mean()
    total = np.sum(_typed(a, dtype), axis=axis, keepdims=keepdims is True, where=where)
    if where is not True and where is not _NOTHING:
        return total / np.sum(np.broadcast_to(where, np.shape(a)), axis=axis, keepdims=keepdims is True)
    return total / (np.size(a) / max(np.size(total), 1))


def _average(a: Any, axis: Any = None, weights: Any = None) -> Any:
    if weights is None:
        return _mean(a, axis)
    weights = np.asarray(weights)
    if np.ndim(weights) == 1 and np.ndim(a) > 1:
        if axis is None:
            refuse("np.average with weights of another shape needs axis=")
        shape = [1] * np.ndim(a)
        shape[axis] = -1
        weights = np.reshape(weights, shape)
    weights = np.broadcast_to(weights, np.shape(a))
    return np.sum(a * weights, axis=axis) / np.sum(weights, axis=axis)


def _var(a: Any, axis: Any = None, dtype: Any = None, out: Any = None, ddof: float = 0, keepdims: Any = False) -> Any:
    if out is not None:
        refuse("np.var with a fourth argument can't be traced; write out=")
    a = _typed(a, dtype)
    deviation = a - np.mean(a, axis=axis, keepdims=True)
    total = np.sum(deviation * deviation, axis=axis, keepdims=keepdims is True)
    return total / (np.size(a) / max(np.size(total), 1) - ddof)


def _std(*args: Any, **kwargs: Any) -> Any:
    return np.sqrt(_var(*args, **kwargs))


def _place_of_extreme(better: np.ufunc) -> Callable[..., Any]:
    def place_of_first(flat: Any) -> Any:
        best: Any
        place: Any
        best, place = flat[0], np.int64(0)
        for i in range(1, len(flat)):
            wins = better(flat[i], best) | (np.isnan(flat[i]) & ~np.isnan(best))
            wins = wins & ~np.isnan(best)
            best, place = np.where(wins, flat[i], best)[()], np.where(wins, i, place)[()]
        return place

    def argument(a: Any, axis: Any = None) -> Any:
        a = as_array(a)
        if axis is None:
            return place_of_first(np.ravel(a))
        return np.stack([place_of_first(row) for row in _rows(a, axis)]).reshape(np.delete(a.shape, axis).tolist())

    return argument


def _rows(a: Any, axis: int) -> Any:
    """What stands along an axis, one row each."""
    moved = np.moveaxis(a, axis, -1)
    return np.reshape(moved, (-1, np.shape(moved)[-1]))


def _sort(a: Any, axis: Any = -1, kind: Any = None) -> Any:  # noqa: ARG001  # all kinds give the same
    a = as_array(a)
    if axis is None:
        a, axis = np.ravel(a), 0
    base = np.moveaxis(a.base, axis, 0).copy()
    for last in range(len(base) - 1, 0, -1):
        for i in range(last):
            pair = Array(base[i : i + 1].copy(), a.dtype), Array(base[i + 1 : i + 2].copy(), a.dtype)
            base[i : i + 1], base[i + 1 : i + 2] = np.minimum(*pair).base, np.maximum(*pair).base
    return Array(np.moveaxis(base, 0, axis), a.dtype)


def _median(a: Any, axis: Any = None) -> Any:
    sorted_ = np.moveaxis(np.sort(a, axis=axis), 0 if axis is None else axis, 0)
    n = len(sorted_)
    return np.mean(sorted_[(n - 1) // 2 : n // 2 + 1], axis=0)


def _without_nan(f: Callable[..., Any], instead: float) -> Callable[..., Any]:
    return lambda a, axis=None: f(np.where(np.isnan(a), instead, a), axis=axis)


def _nanmean(a: Any, axis: Any = None) -> Any:
    return np.sum(np.where(np.isnan(a), 0.0, a), axis=axis) / np.sum(~np.isnan(a), axis=axis)


HANDLERS: dict[Any, Callable[..., Any]] = {
    np.sum: _reduction(np.add),
    np.prod: _reduction(np.multiply),
    np.any: _reduction(np.logical_or),
    np.all: _reduction(np.logical_and),
    np.min: _extreme(np.minimum),
    np.max: _extreme(np.maximum),
    np.amin: _extreme(np.minimum),
    np.amax: _extreme(np.maximum),
    np.ptp: lambda a, axis=None: np.max(a, axis=axis) - np.min(a, axis=axis),
    np.cumsum: _cumulative(np.add),
    np.cumprod: _cumulative(np.multiply),
    np.mean: _mean,
    np.average: _average,
    np.var: _var,
    np.std: _std,
    np.median: _median,
    np.count_nonzero: lambda a, axis=None: np.sum(as_array(a) != 0, axis=axis),
    np.argmax: _place_of_extreme(np.greater),
    np.argmin: _place_of_extreme(np.less),
    np.sort: _sort,
    np.nansum: _without_nan(np.sum, 0.0),
    np.nanprod: _without_nan(np.prod, 1.0),
    np.nanmax: lambda a, axis=None: np.fmax.reduce(a, axis=axis),
    np.nanmin: lambda a, axis=None: np.fmin.reduce(a, axis=axis),
    np.nanmean: _nanmean,
}
