"""numpy's functions that write into an array, on arrays of symbols."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fmu_export.trace.symbols.arrays import Array, cast_elements, depends, elements_of, plain
from fmu_export.trace.symbols.refusal import STORED, refuse
from fmu_export.trace.symbols.ufuncs import stored


def _copyto(dst: Any, src: Any, casting: str = "same_kind", where: Any = True) -> None:
    if type(dst) is not Array or casting != "same_kind":
        refuse(STORED)
    stored(src, dst, "np.copyto", where)


def _written(
    f: Callable[..., Any], array: Any, values: Any, write: Callable[[Any, Any], None], where: Any = None
) -> None:
    """Write values into an array by numpy's own function, which is given the elements of both."""
    name = f"np.{f.__name__}"
    if type(array) is not Array:
        refuse(STORED)
    if depends(where):
        refuse(f"{name} where symbols say can't be traced; use np.where")
    array.check_writeable()
    write(array.base, cast_elements(*elements_of(values), array.dtype))


def _put(a: Any, ind: Any, v: Any, mode: Any = "raise") -> None:
    _written(np.put, a, v, lambda to, values: np.put(to, plain(ind), values, mode), ind)


def _place(arr: Any, mask: Any, vals: Any) -> None:
    _written(np.place, arr, vals, lambda to, values: np.place(to, plain(mask), values), mask)


def _put_along_axis(arr: Any, indices: Any, values: Any, axis: int | None = -1) -> None:
    def write(to: Any, elements: Any) -> None:
        np.put_along_axis(to, plain(indices), elements, axis)

    _written(np.put_along_axis, arr, values, write, indices)


def _fill_diagonal(a: Any, val: Any, wrap: bool = False) -> None:
    _written(np.fill_diagonal, a, val, lambda to, values: np.fill_diagonal(to, values, wrap))


HANDLERS: dict[Any, Callable[..., Any]] = {
    np.copyto: _copyto,
    np.putmask: lambda a, mask, values: _copyto(a, np.broadcast_to(values, np.shape(a)), where=mask),
    np.put: _put,
    np.place: _place,
    np.put_along_axis: _put_along_axis,
    np.fill_diagonal: _fill_diagonal,
}
