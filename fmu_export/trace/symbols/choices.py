"""numpy's functions that choose between values, on arrays of symbols."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fmu_export.trace.symbols.arrays import BOOL, FLOAT, INT, Array, as_array, cast_elements, elements_of, elementwise
from fmu_export.trace.symbols.expressions import either
from fmu_export.trace.symbols.refusal import refuse
from fmu_export.trace.symbols.ufuncs import stored


def _clip(a: Any, a_min: Any = None, a_max: Any = None, out: Any = None, min: Any = None, max: Any = None) -> Any:
    low, high = (None if v is np._NoValue else v for v in (a_min, a_max))
    low, high = low if min in (None, np._NoValue) else min, high if max in (None, np._NoValue) else max
    result = a if low is not None or high is not None else np.positive(a)
    if low is not None:
        result = np.maximum(result, low)
    if high is not None:
        result = np.minimum(result, high)
    return result if out is None else stored(result, out, "np.clip")


def _where(condition: Any, *values: Any) -> Any:
    if len(values) != 2:
        refuse("np.where with a condition only gives indices, which can't be traced; give both values")
    (c, kind), (a, _), (b, _) = elements_of(condition), elements_of(values[0]), elements_of(values[1])
    c = cast_elements(c, kind, BOOL)
    dtype = np.result_type(*(v if type(v) in (int, float) else elements_of(v)[1] for v in values))
    dtype = dtype if dtype in (FLOAT, INT, BOOL) else FLOAT
    return Array(elementwise(either, np.broadcast_arrays(c, a, b), dtype), dtype)


def _select(condlist: Sequence[Any], choicelist: Sequence[Any], default: Any = 0) -> Any:
    result = default
    for condition, choice in zip(reversed(condlist), reversed(choicelist), strict=True):
        result = np.where(condition, choice, result)
    return result


def _piecewise(x: Any, condlist: Any, funclist: Sequence[Any], *args: Any, **kw: Any) -> Any:
    conditions = list(condlist) if isinstance(condlist, list | tuple) else [condlist]
    values = [f(x, *args, **kw) if callable(f) else f for f in funclist]
    result = values.pop() if len(values) == len(conditions) + 1 else 0.0
    if not all(np.shape(c) == np.shape(x) for c in conditions):
        refuse("np.piecewise with conditions of another shape than x can't be traced")
    for condition, value in zip(conditions, values, strict=True):  # the last that holds counts
        result = np.where(condition, value, result)
    return as_array(result).astype(as_array(x).dtype)


def _choose(a: Any, choices: Sequence[Any]) -> Any:
    result = choices[-1]
    for i in range(len(choices) - 2, -1, -1):
        result = np.where(np.equal(as_array(a).astype(INT), i), choices[i], result)
    return result


def _nan_to_num(x: Any, copy: bool = True, nan: float = 0.0, posinf: Any = None, neginf: Any = None) -> Any:
    if not copy:
        refuse("np.nan_to_num with copy=False can't be traced")
    largest = np.finfo(float).max
    result = np.where(np.isnan(x), nan, x)
    result = np.where(result == np.inf, largest if posinf is None else posinf, result)
    return np.where(result == -np.inf, -largest if neginf is None else neginf, result)


HANDLERS: dict[Any, Callable[..., Any]] = {
    np.clip: _clip,
    np.where: _where,
    np.select: _select,
    np.piecewise: _piecewise,
    np.choose: _choose,
    np.nan_to_num: _nan_to_num,
}
