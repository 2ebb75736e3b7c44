"""numpy's functions of single elements, and Python's operators, on arrays of symbols.

Types (float, int, bool) are those that numpy gives, asked of numpy itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fmu_export.errors import needs
from fmu_export.trace.symbols import expressions
from fmu_export.trace.symbols.arrays import (
    BOOL,
    FLOAT,
    INT,
    NEUTRAL,
    Array,
    Scalar,
    Selection,
    cast_elements,
    elements_of,
    elementwise,
    unwrapped,
)
from fmu_export.trace.symbols.refusal import STORED, refuse

with needs("export"):
    import casadi as ca


#: What numpy's functions of numbers are on expressions.
_UFUNCS: dict[np.ufunc, Callable[..., Any]] = {
    np.add: expressions.plus,
    np.subtract: expressions.minus,
    np.multiply: expressions.times,
    np.divide: expressions.divided,
    np.negative: lambda a: -a,
    np.positive: lambda a: a,
    np.power: expressions.power,
    np.float_power: expressions.power,
    np.square: expressions.squared,
    np.reciprocal: lambda a: 1.0 / a,
    np.sqrt: ca.sqrt,
    np.exp: ca.exp,
    np.exp2: lambda a: ca.SX(2.0) ** a,
    np.log: ca.log,
    np.log2: expressions.log2,
    np.log10: expressions.log10,
    np.log1p: ca.log1p,
    np.expm1: ca.expm1,
    np.sin: ca.sin,
    np.cos: ca.cos,
    np.tan: ca.tan,
    np.arcsin: ca.asin,
    np.arccos: ca.acos,
    np.arctan: ca.atan,
    np.arctan2: ca.atan2,
    np.hypot: ca.hypot,
    np.sinh: ca.sinh,
    np.cosh: ca.cosh,
    np.tanh: ca.tanh,
    np.arcsinh: ca.asinh,
    np.arccosh: ca.acosh,
    np.arctanh: ca.atanh,
    np.absolute: ca.fabs,
    np.fabs: ca.fabs,
    np.sign: ca.sign,
    np.floor: ca.floor,
    np.ceil: ca.ceil,
    np.trunc: expressions.truncated,
    np.rint: expressions.rint,
    np.copysign: ca.copysign,
    np.signbit: lambda a: ca.copysign(1.0, a) < 0.0,
    np.heaviside: expressions.heaviside,
    np.fmod: ca.fmod,
    np.remainder: expressions.mod,
    np.floor_divide: expressions.floor_divide,
    np.minimum: ca.fmin,
    np.maximum: ca.fmax,
    np.fmin: expressions.fmin,
    np.fmax: expressions.fmax,
    np.less: lambda a, b: a < b,
    np.less_equal: lambda a, b: a <= b,
    np.greater: lambda a, b: a > b,
    np.greater_equal: lambda a, b: a >= b,
    np.equal: lambda a, b: a == b,
    np.not_equal: lambda a, b: a != b,
    np.logical_and: lambda a, b: ca.logic_and(a, b),
    np.logical_or: lambda a, b: ca.logic_or(a, b),
    np.logical_not: lambda a: ca.logic_not(a),
    np.logical_xor: expressions.xor,
    np.bitwise_and: lambda a, b: ca.logic_and(a, b),
    np.bitwise_or: lambda a, b: ca.logic_or(a, b),
    np.bitwise_xor: expressions.xor,
    np.invert: lambda a: ca.logic_not(a),
    np.isnan: expressions.is_nan,
    np.isinf: lambda a: ca.fabs(a) == ca.inf,
    np.isfinite: lambda a: ca.fabs(a) < ca.inf,
    np.deg2rad: lambda a: a * (np.pi / 180.0),
    np.radians: lambda a: a * (np.pi / 180.0),
    np.rad2deg: lambda a: a * (180.0 / np.pi),
    np.degrees: lambda a: a * (180.0 / np.pi),
    np.conjugate: lambda a: a,
    np.cbrt: expressions.cbrt,
    np.logaddexp: expressions.logaddexp,
}
#: Those whose reductions do not depend on the order but for rounding, or go from left to right.
_IN_ORDER = {
    *(np.add, np.multiply, np.subtract, np.divide, np.minimum, np.maximum, np.fmin, np.fmax, np.hypot),
    *(np.logical_and, np.logical_or, np.logical_xor, np.bitwise_and, np.bitwise_or, np.bitwise_xor),
}
_BITWISE = {np.bitwise_and, np.bitwise_or, np.bitwise_xor, np.invert}


def _weak(value: Any) -> Any:
    """The type of an operand as numpy's promotion sees it."""
    return type(value) if type(value) in (int, float) else getattr(value, "dtype", None) or np.asarray(value).dtype


#: What is another function of whole numbers.
_WHOLE = {np.floor_divide: expressions.whole_floor_divide, np.remainder: expressions.whole_mod}


def _is_whole_exponent(base: Any) -> bool:
    return all(expressions.is_number(e.sx) and float(e.sx) >= 0.0 for e in base.flat)


def _applied(ufunc: np.ufunc, inputs: Sequence[Any]) -> tuple[Any, np.dtype[Any]]:
    """A ufunc element by element, with the type that numpy gives to the result."""
    f, converted, dtype = _chosen(ufunc, inputs)
    bases = np.broadcast_arrays(*converted) if len(converted) > 1 else converted
    return elementwise(f, bases, dtype), dtype


def _chosen(ufunc: np.ufunc, inputs: Sequence[Any]) -> tuple[Callable[..., Any], list[Any], np.dtype[Any]]:
    """The function of expressions that a ufunc is for such inputs, these as object arrays, and the result's type."""
    converted = [elements_of(i) for i in inputs]
    types = [_weak(i) if type(i) in (int, float) else d for i, (_, d) in zip(inputs, converted, strict=True)]
    dtype = ufunc.resolve_dtypes((*types, None))[-1]
    if dtype not in (FLOAT, INT, BOOL):
        if not all(d == BOOL for _, d in converted):
            refuse(f"np.{ufunc.__name__} gives {dtype}, which can't be traced")
        dtype = FLOAT
        refuse(f"np.{ufunc.__name__} of Boolean values gives {np.dtype(np.float16)}; write 1.0 * (...)")
    kinds = [d for _, d in converted]
    if ufunc in _BITWISE and dtype != BOOL:
        refuse(f"np.{ufunc.__name__} of whole numbers can't be traced; use &, |, ~ on comparisons only")
    f = _UFUNCS[ufunc]
    if dtype == INT and ufunc in (np.fmod, np.reciprocal):
        refuse(f"np.{ufunc.__name__} of whole numbers can't be traced; use floats, such as 2.0")
    if dtype == INT and ufunc in _WHOLE:
        f = _WHOLE[ufunc]
    if dtype == INT and ufunc is np.power and not _is_whole_exponent(converted[1][0]):
        refuse(
            "a power of whole numbers with another exponent than the numbers 0, 1, 2, ... can't be traced; use floats"
        )
    if ufunc is np.add and dtype == BOOL:
        f = ca.logic_or
    if ufunc in (np.power, np.float_power) and converted[1][1] in (INT, BOOL) and kinds[0] == BOOL:
        refuse("a power of a Boolean can't be traced; write 1.0 * (...)")
    return f, [base for base, _ in converted], dtype


def _ufunc(ufunc: np.ufunc, method: str, inputs: Sequence[Any], options: dict[str, Any]) -> Any:
    name = f"np.{ufunc.__name__}" + ("" if method == "__call__" else f".{method}")
    options = {k: v for k, v in options.items() if v is not None and v is not np._NoValue}
    out = options.pop("out", None)
    where = options.pop("where", True)
    if where is not True and (method != "__call__" or out is None):
        refuse(f"{name} with where= and without out= can't be traced; use np.where")
    if "dtype" in options and np.dtype(options["dtype"]) in (FLOAT, INT, BOOL):
        wanted = np.dtype(options.pop("dtype"))
        inputs = [np.asarray(i).astype(wanted) for i in inputs]
    for i in inputs:
        if type(i) is Selection:
            return i.__array_ufunc__(ufunc, method, *inputs, **options)
    if ufunc is np.matmul and method == "__call__" and not options:
        product = np.linalg.matmul(*inputs)
        return product if out is None else stored(product, out, name)
    if ufunc in (np.divmod, np.modf) and method == "__call__" and not options and out is None:
        if ufunc is np.divmod:
            return np.floor_divide(*inputs), np.remainder(*inputs)
        (a,) = inputs
        return a - np.trunc(a), np.trunc(a)
    if ufunc not in _UFUNCS:
        refuse(f"{name} can't be traced; see the page 'numpy that can be traced'")
    wrong = set(options) - ({"axis", "keepdims", "dtype", "casting", "order"} if method != "__call__" else set())
    if wrong or "dtype" in options:
        refuse(f"{name} with {', '.join(sorted(wrong or {'dtype'}))}= can't be traced; use np.where")
    if method == "__call__":
        base, dtype = _applied(ufunc, inputs)
    elif method in ("reduce", "accumulate") and ufunc not in _IN_ORDER:
        refuse(f"{name} can't be traced: numpy does not say in which order it computes")
    elif method == "reduce":
        base, dtype = reduced(ufunc, inputs[0], options.get("axis", 0), bool(options.get("keepdims", False)))
    elif method == "accumulate":
        base, dtype = accumulated(ufunc, inputs[0], options.get("axis", 0))
    elif method == "outer":
        a, b = (np.asanyarray(i) if type(i) not in (Array, Scalar) else i for i in inputs)
        base, dtype = _applied(ufunc, (np.reshape(a, np.shape(a) + (1,) * np.ndim(b)), b))
    else:
        refuse(f"{name} can't be traced; see the page 'numpy that can be traced'")
    if out is not None:
        return stored(Array(base, dtype), out, name, where)
    return unwrapped(base if base.ndim else base.item(), dtype)


def stored(value: Any, out: Any, name: str, where: Any = True) -> Any:
    """What out= gets, where a condition holds."""
    target = out[0] if isinstance(out, tuple) else out
    if type(target) is not Array:
        refuse(STORED)
    target.check_writeable()
    base, dtype = elements_of(value)
    if not np.can_cast(dtype, target.dtype, "same_kind"):
        refuse(f"numpy can't store the {dtype} that {name} gives in an array of {target.dtype}")
    base = cast_elements(np.broadcast_to(base, target.shape), dtype, target.dtype)
    if where is not True:
        condition = cast_elements(*elements_of(where), BOOL)
        base = elementwise(expressions.either, np.broadcast_arrays(condition, base, target.base), target.dtype)
    target.base[...] = base
    return target


def _axes(axis: Any, ndim: int) -> tuple[int, ...]:
    if axis is None:
        return tuple(range(ndim))
    axes = axis if isinstance(axis, tuple) else (axis,)
    return tuple(np.lib.array_utils.normalize_axis_index(a, ndim) for a in axes)


def reduced(ufunc: np.ufunc, value: Any, axis: Any, keepdims: bool) -> tuple[Any, np.dtype[Any]]:
    """What a ufunc makes of all elements along axes, in order, and its type."""
    base, dtype = elements_of(value)
    axes = _axes(axis, base.ndim)
    others = tuple(i for i in range(base.ndim) if i not in axes)
    kept = tuple(base.shape[i] for i in others)
    columns = base.transpose(*axes, *others).reshape(-1, *kept) if base.ndim else base.reshape(1)
    if dtype == BOOL and ufunc in (np.add, np.multiply):
        columns, dtype = cast_elements(columns, BOOL, INT), INT
    if ufunc in (np.logical_and, np.logical_or):
        columns, dtype = cast_elements(columns, dtype, BOOL), BOOL
    if not len(columns):
        if ufunc not in NEUTRAL:
            refuse(f"np.{ufunc.__name__} of an array without elements has no value")
        total = elements_of(np.full(kept, NEUTRAL[ufunc], dtype))[0]
    else:
        total, f, before = columns[0:1].reshape(kept), None, dtype
        for i in range(1, len(columns)):
            column = columns[i : i + 1].reshape(kept)
            if f is None or dtype != before:  # else the function is that of the step before
                before = dtype
                f, _, dtype = _chosen(ufunc, (Array(total, dtype), Array(column, dtype)))
            total = elementwise(f, [total, column], dtype)
    if keepdims:
        total = total.reshape(tuple(1 if i in axes else n for i, n in enumerate(base.shape)))
    return total, dtype


def accumulated(ufunc: np.ufunc, value: Any, axis: Any) -> tuple[Any, np.dtype[Any]]:
    """What a ufunc makes of all elements up to each along an axis, and its type."""
    base, dtype = elements_of(value)
    if dtype == BOOL and ufunc in (np.add, np.multiply):
        base, dtype = cast_elements(base, BOOL, INT), INT
    result = np.moveaxis(base, axis, 0).copy()
    for i in range(1, len(result)):
        step, dtype = _applied(ufunc, (Array(result[i - 1 : i], dtype), Array(result[i : i + 1], dtype)))
        result[i : i + 1] = step
    return np.moveaxis(result, 0, axis), dtype


def _operators() -> None:
    """Python's operators, as numpy's functions."""
    binary = {
        "add": np.add,
        "sub": np.subtract,
        "mul": np.multiply,
        "truediv": np.divide,
        "pow": np.power,
        "mod": np.remainder,
        "floordiv": np.floor_divide,
        "and": np.bitwise_and,
        "or": np.bitwise_or,
        "xor": np.bitwise_xor,
        "matmul": np.matmul,
        "divmod": np.divmod,
    }
    compare = {
        "lt": np.less,
        "le": np.less_equal,
        "gt": np.greater,
        "ge": np.greater_equal,
        "eq": np.equal,
        "ne": np.not_equal,
    }
    unary = {"neg": np.negative, "pos": np.positive, "abs": np.absolute, "invert": np.invert}

    def two(ufunc: np.ufunc) -> tuple[Any, Any]:
        quick = _UFUNCS[ufunc] if ufunc in (np.add, np.subtract, np.multiply, np.divide) else None

        def forward(self: Any, other: Any) -> Any:
            if quick and type(self) is Scalar and type(other) is Scalar and self.dtype == other.dtype == FLOAT:
                return Scalar(quick(self.sx, other.sx))
            return NotImplemented if other is None or isinstance(other, str) else ufunc(self, other)

        return forward, lambda self, other: ufunc(other, self)

    def inplace(ufunc: np.ufunc) -> Any:
        return lambda self, other: ufunc(self, other, out=self)

    def one(ufunc: np.ufunc) -> Any:
        return lambda self: ufunc(self)

    def dispatched(_: Any, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return _ufunc(ufunc, method, inputs, options)

    for kind in (Scalar, Array, Selection):
        if kind is not Selection:
            setattr(kind, "__array_ufunc__", dispatched)  # noqa: B010
        for name, ufunc in {**binary, **compare}.items():
            forward, reflected = two(ufunc)
            setattr(kind, f"__{name}__", forward)
            if name in binary:
                setattr(kind, f"__r{name}__", reflected)
                if kind is Array and name not in ("divmod", "matmul"):
                    setattr(kind, f"__i{name}__", inplace(ufunc))
        for name, ufunc in unary.items():
            setattr(kind, f"__{name}__", one(ufunc))
    for ufunc in _UFUNCS:  # numpy's loops over objects call methods of the elements
        if ufunc.nin == 1 and not hasattr(Scalar, ufunc.__name__):
            setattr(Scalar, ufunc.__name__, one(ufunc))


_operators()
