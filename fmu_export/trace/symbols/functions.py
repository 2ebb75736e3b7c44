"""numpy's functions of whole arrays on arrays of symbols: those that move elements, and where the others are.

Those that move elements run as numpy's own code on the arrays of objects; their types are found by running the same
call on numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import signature
from typing import Any

import numpy as np

from fmu_export.errors import needs
from fmu_export.trace.symbols import choices, matrices, reductions, tables, writes
from fmu_export.trace.symbols.arrays import (
    BOOL,
    FLOAT,
    INT,
    Array,
    Scalar,
    as_array,
    as_symbols,
    cast,
    depends,
    elements_of,
    filled,
    has_symbols,
    plain,
    unwrapped,
)
from fmu_export.trace.symbols.refusal import refuse
from fmu_export.trace.symbols.ufuncs import stored

with needs("export"):
    import casadi as ca

#: Those that move elements or are sums of products: numpy's own, on the object array.
_STRUCTURAL = {
    *(np.reshape, np.ravel, np.transpose, np.concatenate, np.stack, np.vstack, np.hstack, np.dstack, np.column_stack),
    *(np.block, np.roll, np.flip, np.fliplr, np.flipud, np.tile, np.repeat, np.squeeze, np.expand_dims, np.moveaxis),
    *(np.swapaxes, np.rollaxis, np.rot90, np.broadcast_to, np.diag, np.diagonal, np.diagflat, np.atleast_1d),
    *(np.atleast_2d, np.atleast_3d, np.append, np.insert, np.delete, np.split, np.array_split, np.hsplit, np.vsplit),
    *(np.tril, np.triu, np.copy, np.take, np.take_along_axis, np.pad, np.permute_dims, np.matrix_transpose, np.resize),
    *(np.dot, np.inner, np.outer, np.matmul, np.vdot, np.tensordot, np.kron, np.einsum, np.cross, np.diff),
    *(
        np.polyval,
        np.meshgrid,
        np.broadcast_arrays,
        np.ediff1d,
        np.trim_zeros,
        np.convolve,
        np.linalg.matmul,
        np.vander,
    ),
    *(np.linalg.multi_dot, np.linalg.vecdot, np.linalg.outer, np.linalg.cross, np.linalg.diagonal),
    *(np.linalg.matrix_transpose, np.unstack),
} - {np.matmul, np.trim_zeros}
_STRUCTURAL.add(np.matmul)

#: Those of them that take a sequence of arrays.
_OF_SEQUENCES = {
    *(np.concatenate, np.stack, np.vstack, np.hstack, np.dstack, np.column_stack, np.block, np.linalg.multi_dot)
}

#: Products, which of Boolean values are Boolean.
_PRODUCTS = {
    *(np.dot, np.inner, np.matmul, np.vdot, np.tensordot, np.outer, np.kron, np.einsum, np.convolve, np.linalg.matmul),
    *(np.linalg.vecdot, np.linalg.outer, np.linalg.multi_dot),
}

#: Functions that tell about shapes.
_SHAPES = {np.shape, np.ndim, np.size, np.iscomplexobj, np.isrealobj, np.result_type}


def _numbers_like(value: Any) -> Any:
    """Numbers of the same shape and type, to find what numpy makes of them."""
    if isinstance(value, list | tuple):
        return type(value)(_numbers_like(v) for v in value)
    if type(value) is Array:
        return np.ones(value.shape, value.dtype)
    return value.dtype.type(1) if type(value) is Scalar else value


def _objects(value: Any, is_array: bool = True) -> Any:
    """A value with object arrays in place of arrays of symbols; a list is an array, or a sequence of arrays."""
    if isinstance(value, list | tuple):
        if is_array and has_symbols(value) and not any(isinstance(v, np.ndarray | list | tuple) for v in value):
            return elements_of(value)[0]  # a row of scalars: numpy would take numbers out of them
        return type(value)(_objects(v) for v in value)
    if type(value) is Array:
        return value.base
    if type(value) is Scalar:
        return elements_of(value)[0]
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return elements_of(value)[0]
    return value


def _wrapped(result: Any, like: Any) -> Any:
    if isinstance(result, list | tuple):
        parts = [_wrapped(r, n) for r, n in zip(result, like, strict=True)]
        return parts if isinstance(result, list) else tuple(parts)
    dtype = np.asarray(like).dtype
    dtype = {"f": FLOAT, "i": INT, "u": INT, "b": BOOL}.get(dtype.kind, FLOAT)
    if type(result) is Array:
        return result
    if isinstance(result, np.ndarray):
        if any(type(e) is not Scalar or e.dtype != dtype for e in result.flat):  # numbers, or values of another type
            elements = [e if type(e) is Scalar else Scalar(ca.SX(float(e)), FLOAT) for e in result.flat]
            result = filled([cast(e, dtype) for e in elements], result.shape)
        if np.shape(like) == () and result.ndim == 0 and not isinstance(like, np.ndarray):
            return unwrapped(result.item(), dtype)
        return Array(result, dtype)
    return unwrapped(result, dtype) if type(result) is Scalar else result


def _function(f: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    module = "np.linalg" if "linalg" in getattr(f, "__module__", "") else "np"
    name = f"{module}.{getattr(f, '__name__', f)}"
    if kwargs.get("out") is not None and (f in _HANDLERS or f in _STRUCTURAL):
        others = {k: v for k, v in kwargs.items() if k != "out"}
        return stored(_function(f, args, others), kwargs["out"], name)
    if f in _HANDLERS:
        options = {k: v for k, v in kwargs.items() if v is not np._NoValue and k != "out"}
        try:
            signature(_HANDLERS[f]).bind(*args, **options)
        except TypeError:
            refuse(f"{name} with these arguments ({', '.join(options) or len(args)}) can't be traced")
        return _HANDLERS[f](*args, **options)
    if f in _SHAPES:
        return f(*(_numbers_like(a) for a in args), **{k: _numbers_like(v) for k, v in kwargs.items()})
    if f in _STRUCTURAL:
        if kwargs.get("where", True) is not True or kwargs.get("dtype") is not None:
            refuse(f"{name} with where= or dtype= can't be traced")
        like = f(*(_numbers_like(a) for a in args), **{k: _numbers_like(v) for k, v in kwargs.items()})
        if f in _PRODUCTS and np.asarray(like).dtype == BOOL:
            refuse(f"{name} of Boolean values can't be traced; write 1.0 * (...)")
        objects = [_objects(a, is_array=f not in _OF_SEQUENCES) for a in args]
        return _wrapped(f(*objects, **{k: _objects(v) for k, v in kwargs.items()}), like)
    if not any(depends(a) for a in [*args, *kwargs.values()]):
        return f(*(plain(a) for a in args), **{k: plain(v) for k, v in kwargs.items()})
    return refuse(f"{name} can't be traced; see the page 'numpy that can be traced'")


def _like(value: float) -> Callable[..., Any]:
    def like(a: Any, dtype: Any = None, shape: Any = None, **_: Any) -> Any:
        kind = elements_of(a)[1] if dtype is None else np.dtype(dtype)
        return as_symbols(np.full(np.shape(a) if shape is None else shape, value, FLOAT).astype(kind))

    return like


def _full_like(a: Any, fill_value: Any, dtype: Any = None, shape: Any = None, **_: Any) -> Any:
    result = _like(0.0)(a, dtype, shape)
    result[...] = fill_value
    return result


def _round(a: Any, decimals: int = 0) -> Any:
    if decimals == 0:
        return np.rint(a)
    factor = 10.0 ** abs(decimals)
    return np.rint(a * factor) / factor if decimals > 0 else np.rint(a / factor) * factor


def _isclose(a: Any, b: Any, rtol: float = 1e-5, atol: float = 1e-8, equal_nan: bool = False) -> Any:
    close = (np.abs(a - b) <= atol + rtol * np.abs(b)) & np.isfinite(b) | np.equal(a, b)
    return close | np.isnan(a) & np.isnan(b) if equal_nan else close


def _sinc(x: Any) -> Any:
    turned = np.pi * np.where(x == 0, 1e-20, x)
    return np.sin(turned) / turned


def _trapezoid(y: Any, x: Any = None, dx: float = 1.0, axis: int = -1) -> Any:
    y = np.moveaxis(as_array(y), axis, -1)
    if np.ndim(x) > 1:
        refuse("np.trapezoid with places along several axes can't be traced")
    return np.sum((dx if x is None else np.diff(x)) * (y[..., 1:] + y[..., :-1]) / 2.0, axis=-1)


def _linspace(start: Any, stop: Any, num: int = 50, endpoint: bool = True) -> Any:
    n = num - 1 if endpoint else num
    steps = [start + (stop - start) / max(n, 1) * i for i in range(num)]
    return np.stack([*steps[:-1], stop]) if endpoint and num > 1 else np.stack(steps)


def _apply_along_axis(func1d: Callable[..., Any], axis: int, arr: Any, *args: Any, **kwargs: Any) -> Any:
    moved = np.moveaxis(as_array(arr), axis, -1)
    rows = [as_array(func1d(row, *args, **kwargs)) for row in np.reshape(moved, (-1, moved.shape[-1]))]
    result = np.reshape(np.stack(rows), (*moved.shape[:-1], *rows[0].shape))
    return np.moveaxis(result, -1, axis) if rows[0].ndim == 1 else result


_HANDLERS: dict[Any, Callable[..., Any]] = {
    **reductions.HANDLERS,
    **choices.HANDLERS,
    **matrices.HANDLERS,
    **tables.HANDLERS,
    **writes.HANDLERS,
    np.round: _round,
    np.around: _round,
    np.linspace: _linspace,
    np.apply_along_axis: _apply_along_axis,
    np.zeros_like: _like(0.0),
    np.ones_like: _like(1.0),
    np.empty_like: _like(np.nan),
    np.full_like: _full_like,
    np.isclose: _isclose,
    np.sinc: _sinc,
    np.real: lambda a: a,
    np.fix: lambda a: np.trunc(a),
    np.trapezoid: _trapezoid,
    np.may_share_memory: lambda a, b: np.may_share_memory(elements_of(a)[0], elements_of(b)[0]),
    np.trace: lambda a, offset=0, axis1=0, axis2=1: np.sum(np.diagonal(a, offset, axis1, axis2), axis=-1),
    np.linalg.trace: lambda x, offset=0: np.sum(np.diagonal(x, offset, -2, -1), axis=-1),
    np.array_equal: lambda a, b: np.shape(a) == np.shape(b) and np.all(np.equal(a, b)),
}


def _dispatched(_: Any, f: Any, types: Any, args: Any, kwargs: Any) -> Any:  # noqa: ARG001
    return _function(f, args, kwargs)


for _kind in (Scalar, Array):
    setattr(_kind, "__array_function__", _dispatched)  # noqa: B010
