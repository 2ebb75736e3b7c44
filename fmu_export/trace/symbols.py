"""Arrays and scalars of symbols, which stand for numbers while a model's functions run.

An `Array` keeps its elements in an object array of numpy, so that views, slices, writes, broadcasting and the order
of elements are numpy's own. Types (float, int, bool) are those that numpy gives, found by running the same call on
numbers. What can't be traced is refused where it happens, with the line of the author's file and the remedy; nothing
falls back to something else.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any, NoReturn

import numpy as np

from fmu_export.errors import TraceError, needs

with needs("export"):
    import casadi as ca

FLOAT, INT, BOOL = np.dtype(float), np.dtype(np.int64), np.dtype(bool)

#: Packages whose frames are not the author's.
_OTHERS = ("numpy", "casadi", "fmu_export.trace", "fmu_export.modelling.model", "scipy", "contextlib", "functools")

_IF = "an `if`, `and`, `or`, `max`, `min` or loop on values can't be traced; use np.where, np.maximum, np.clip, &, |"
_NUMBER = "math.*, float() and int() take no symbols; use np.sin, np.floor, ..."
_ARRAY = (
    "a symbol can't be stored in an array of numbers; make the array by np.zeros, np.array or np.stack in this function"
)


def _place() -> str:
    """File and line of the author's code that runs now."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if _is_authors(frame):
            return f"{frame.f_code.co_filename}:{frame.f_lineno}: "
        frame = frame.f_back
    return ""


def _place_of(error: BaseException) -> str:
    """File and line of the author's code that an error comes from."""
    found, step = "", error.__traceback__
    while step is not None:
        if _is_authors(step.tb_frame):
            found = f"{step.tb_frame.f_code.co_filename}:{step.tb_lineno}: "
        step = step.tb_next
    return found


def _is_authors(frame: FrameType) -> bool:
    module = frame.f_globals.get("__name__", "")
    return not any(module == other or module.startswith(other + ".") for other in _OTHERS)


_refused: list[TraceError] = []


def refuse(text: str) -> NoReturn:
    """Refuse an idiom at the line where it stands; remembered, in case the author's code catches the error."""
    error = TraceError(f"{_place()}{text}")
    _refused.append(error)
    raise error


def _constant(value: Any) -> bool:
    return bool(value.is_constant())


class Scalar:
    """One element: an expression and its type. It can't be changed, as a number can't."""

    __slots__ = ("dtype", "sx")

    def __init__(self, sx: Any, dtype: np.dtype[Any] = FLOAT) -> None:
        self.sx = sx
        self.dtype = dtype

    @property  # type: ignore[misc]  # a number to isinstance, as it is when numpy runs
    def __class__(self) -> type:
        return self.dtype.type

    ndim, size, shape = 0, 1, ()
    T = property(lambda self: self)
    real = property(lambda self: self)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return _ufunc(ufunc, method, inputs, options)

    def __array_function__(self, f: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return _function(f, args, kwargs)

    def __array__(self, *_: Any, **__: Any) -> Any:
        if _constant(self.sx):
            return np.asarray(self.number())
        refuse(_ARRAY)

    def number(self) -> Any:
        """The number that a constant is."""
        return self.dtype.type(float(self.sx))

    def __bool__(self) -> bool:
        return bool(self.number()) if _constant(self.sx) else refuse(_IF)

    def __float__(self) -> float:
        return float(self.number()) if _constant(self.sx) else refuse(_NUMBER)

    def __int__(self) -> int:
        return int(self.number()) if _constant(self.sx) else refuse(_NUMBER)

    def __index__(self) -> int:
        if _constant(self.sx) and self.dtype == INT:
            return int(self.number())
        refuse("a value can't be an index or a number of repetitions; use np.where, np.select or np.interp")

    def __format__(self, spec: str) -> str:
        refuse("a symbol has no text; leave the f-string or print out of the model's functions")

    def __hash__(self) -> int:
        refuse("a value can't be a key of a dictionary, a set or a cache; use np.where or np.select")

    def __iter__(self) -> Iterator[Any]:
        raise TypeError("iteration over a 0-d array")

    def __copy__(self) -> Scalar:
        return self

    def __deepcopy__(self, memo: Any) -> Scalar:
        return self

    def copy(self) -> Scalar:
        """The scalar itself, which can't be changed."""
        return self

    def item(self) -> Scalar:
        """The scalar itself."""
        return self

    def astype(self, dtype: Any, **_: Any) -> Any:
        """The scalar as another type; to int towards zero."""
        return _cast(self, np.dtype(dtype))

    def __floor__(self) -> Any:
        return np.floor(self)

    def __ceil__(self) -> Any:
        return np.ceil(self)

    def __trunc__(self) -> Any:
        return np.trunc(self)

    def __round__(self, n: int | None = None) -> Any:
        return np.round(self, n or 0)

    def __getitem__(self, key: Any) -> Any:
        return _out(_in(self)[0][key], self.dtype)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(Array(_in(self)[0], self.dtype), name)


class Array:
    """Elements in an object array; what numpy's arrays do by views and writes is done by that array."""

    __slots__ = ("base", "dtype")

    def __init__(self, base: Any, dtype: np.dtype[Any]) -> None:
        self.base = base
        self.dtype = dtype

    @property  # type: ignore[misc]
    def __class__(self) -> type:
        return np.ndarray

    shape = property(lambda self: self.base.shape)
    ndim = property(lambda self: self.base.ndim)
    size = property(lambda self: self.base.size)
    real = property(lambda self: self)
    flat = property(lambda self: iter(self.ravel()))

    @property
    def T(self) -> Array:
        """The transposed view."""
        return Array(self.base.T, self.dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return _ufunc(ufunc, method, inputs, options)

    def __array_function__(self, f: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return _function(f, args, kwargs)

    def __array__(self, *_: Any, **__: Any) -> Any:
        if self.is_constant():
            return self.numbers()
        refuse(_ARRAY)

    def is_constant(self) -> bool:
        """Whether all elements are numbers."""
        return all(_constant(e.sx) for e in self.base.flat)

    def numbers(self) -> Any:
        """The numbers that constants are."""
        return np.array([float(e.sx) for e in self.base.flat]).reshape(self.shape).astype(self.dtype)

    def __len__(self) -> int:
        return len(self.base)

    def __iter__(self) -> Iterator[Any]:
        if not self.ndim:
            raise TypeError("iteration over a 0-d array")
        return (self[i] for i in range(len(self)))

    def __bool__(self) -> bool:
        return bool(self.numbers()) if self.is_constant() else refuse(_IF)

    def __float__(self) -> float:
        return float(self.numbers()) if self.is_constant() else refuse(_NUMBER)

    def __int__(self) -> int:
        return int(self.numbers()) if self.is_constant() else refuse(_NUMBER)

    def __index__(self) -> int:
        return self.base.item().__index__()  # type: ignore[no-any-return]

    def __format__(self, spec: str) -> str:
        refuse("a symbol has no text; leave the f-string or print out of the model's functions")

    __hash__ = None  # type: ignore[assignment]

    def __contains__(self, value: Any) -> bool:
        return bool(np.any(self == value))

    def __getitem__(self, key: Any) -> Any:
        key = _key(key)
        if isinstance(key, _Mask):
            return _selection(self, key.mask)
        return _out(self.base[key], self.dtype)

    def __setitem__(self, key: Any, value: Any) -> None:
        key = _key(key)
        self._writeable()
        if type(value) is Selection:
            if not isinstance(key, _Mask) or not _same(value.mask, key.mask):
                refuse("what a Boolean mask selects can be assigned to the same mask only; use np.where")
            value = value.values
        base, dtype = _in(value)
        if not np.can_cast(dtype, self.dtype, "same_kind") and self.dtype not in (INT, BOOL):
            refuse(f"numpy can't store {dtype} in an array of {self.dtype}")
        base = _cast_base(base, dtype, self.dtype)
        if isinstance(key, _Mask):
            if base.ndim and base.shape != self.shape:
                refuse("values of another shape can't be assigned to a Boolean mask; use np.where")
            self.base[...] = _elementwise(_where, np.broadcast_arrays(key.mask.base, base, self.base), self.dtype)
        else:
            self.base[key] = base if isinstance(self.base[key], np.ndarray) else base.item()

    def _writeable(self) -> None:
        if not self.base.flags.writeable:
            refuse("an argument of the function, or a view of one, is changed; change a copy, such as x.copy()")

    def __copy__(self) -> Array:
        return Array(self.base.copy(), self.dtype)

    def __deepcopy__(self, memo: Any) -> Array:
        return Array(self.base.copy(), self.dtype)

    def copy(self, order: str = "C") -> Array:  # noqa: ARG002
        """A copy that can be changed."""
        return Array(self.base.copy(), self.dtype)

    def astype(self, dtype: Any, copy: bool = True, **_: Any) -> Array:  # noqa: ARG002
        """A copy of another type; to int towards zero."""
        return Array(_cast_base(self.base, self.dtype, np.dtype(dtype)).copy(), np.dtype(dtype))

    def fill(self, value: Any) -> None:
        """Set all elements."""
        self[...] = value

    def item(self, *where: int) -> Any:
        """One element."""
        return self.base.item(*where)

    def tolist(self) -> Any:
        """The elements as lists."""
        return self.base.tolist()

    def reshape(self, *shape: Any, **options: Any) -> Any:
        """A view of another shape."""
        return _out(self.base.reshape(*shape, **options), self.dtype)

    def transpose(self, *axes: Any) -> Any:
        """A view with other axes."""
        return _out(self.base.transpose(*axes), self.dtype)

    def __getattr__(self, name: str) -> Any:
        if name in _METHODS:
            function = getattr(np, _METHODS[name])
            return lambda *args, **kwargs: _function(function, (self, *args), kwargs)
        if name.startswith("_"):
            raise AttributeError(name)
        return refuse(f"the method or attribute .{name} of an array can't be traced")


class Selection:
    """What a Boolean mask selects: all elements and the mask, since the number of those selected is not known."""

    def __init__(self, values: Array, mask: Array) -> None:
        self.values, self.mask = values, mask

    dtype = property(lambda self: self.values.dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method == "reduce" and ufunc in _NEUTRAL and not set(options) - {"axis"}:
            neutral = _NEUTRAL[ufunc]
            return _ufunc(ufunc, method, (np.where(self.mask, self.values, neutral),), {"axis": None})
        if method != "__call__" or options:
            refuse(f"np.{ufunc.__name__} of what a Boolean mask selects can't be traced; use np.where")
        return _selection(ufunc(*(self._full(i) for i in inputs)), self.mask)

    def _full(self, value: Any) -> Any:
        if type(value) is Selection:
            if not _same(value.mask, self.mask):
                refuse("what two Boolean masks select can't be combined; use np.where")
            return value.values
        if np.ndim(value):
            refuse(
                "what a Boolean mask selects can be combined with single numbers and the same mask only; use np.where"
            )
        return value

    def __array_function__(self, f: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if f in (np.sum, np.prod, np.any, np.all) and len(args) == 1 and not kwargs:
            return getattr(self, f.__name__)()
        if f is np.mean and len(args) == 1 and not kwargs:
            return self.mean()
        if f in (np.size, np.count_nonzero) and len(args) == 1 and not kwargs:
            return self.mask.sum() if f is np.size else np.sum(np.not_equal(self, 0))
        return refuse(f"np.{f.__name__} of what a Boolean mask selects can't be traced; use np.where")

    def sum(self) -> Any:
        """Sum of what is selected."""
        return np.sum(np.where(self.mask, self.values, self.dtype.type(0)))

    def prod(self) -> Any:
        """Product of what is selected."""
        return np.prod(np.where(self.mask, self.values, self.dtype.type(1)))

    def any(self) -> Any:
        """Whether any of what is selected holds."""
        return np.any(np.logical_and(self.mask, self.values))

    def all(self) -> Any:
        """Whether all of what is selected holds."""
        return np.all(np.logical_or(np.logical_not(self.mask), self.values))

    def mean(self) -> Any:
        """Mean of what is selected."""
        return self.sum() / np.sum(self.mask)

    size = property(lambda self: np.sum(self.mask))

    def copy(self) -> Selection:
        """A selection has no views."""
        return self

    def __array__(self, *_: Any, **__: Any) -> Any:
        refuse("what a Boolean mask selects has no fixed length; use np.where")

    def __bool__(self) -> bool:
        refuse(_IF)

    def __len__(self) -> int:
        refuse("what a Boolean mask selects has no fixed length; use np.where, or np.sum(mask) for the number")

    def __iter__(self) -> Iterator[Any]:
        refuse("what a Boolean mask selects has no fixed length; use np.where")

    def __getitem__(self, key: Any) -> Any:
        refuse("what a Boolean mask selects has no fixed places; use np.where")

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return refuse(f".{name} of what a Boolean mask selects can't be traced; use np.where")


#: Methods of arrays that are functions of numpy, too.
_METHODS = {
    name: name
    for name in (
        *("sum", "prod", "mean", "std", "var", "min", "max", "any", "all", "clip", "dot", "round", "ravel", "trace"),
        *("diagonal", "cumsum", "cumprod", "repeat", "swapaxes", "squeeze", "take", "argmax", "argmin", "conj"),
        *("searchsorted", "nonzero", "argsort", "ptp", "conjugate", "compress", "choose"),
    )
} | {"flatten": "ravel"}


class _Mask:
    """A Boolean mask of symbols, which covers the whole array."""

    def __init__(self, mask: Array) -> None:
        self.mask = mask


def _key(key: Any) -> Any:
    """An index that the object array takes."""
    if type(key) is Selection:
        refuse("what a Boolean mask selects can't be an index")
    if isinstance(key, tuple):
        keys = tuple(_key(k) for k in key)
        if any(isinstance(k, _Mask) for k in keys):
            if len(keys) == 1:
                return keys[0]
            refuse("a Boolean mask can't be one index of several; use np.where")
        return keys
    if type(key) is Array or type(key) is Scalar:
        if key.dtype == BOOL:
            array = key if type(key) is Array else Array(_in(key)[0], BOOL)
            return array.numbers() if array.is_constant() else _Mask(array)
        if type(key) is Scalar:
            return key.__index__()
        if key.is_constant():
            return key.numbers()
        refuse("values can't be indices; use np.where, np.select or np.interp")
    if isinstance(key, list) and any(type(k) in (Scalar, Array) for k in key):
        return _key(np.array(key))
    return key


def _same(a: Array, b: Array) -> bool:
    return a is b or (
        a.shape == b.shape and all(ca.is_equal(v.sx, w.sx, 20) for v, w in zip(a.base.flat, b.base.flat, strict=True))
    )


def _selection(values: Any, mask: Array) -> Selection:
    if np.shape(values) != mask.shape:
        refuse("a Boolean mask of another shape than the array can't be traced; use np.where")
    return Selection(values.copy(), mask.copy())


def _out(base: Any, dtype: np.dtype[Any]) -> Any:
    """An object array as an `Array`, its single element as a scalar."""
    if isinstance(base, np.ndarray):
        return Array(base, dtype)
    if type(base) is Scalar and _constant(base.sx):
        return base.number()
    return base


def _in(value: Any) -> tuple[Any, np.dtype[Any]]:
    """Anything that numpy takes for an array, as an object array of scalars and its type."""
    if type(value) is Array:
        return value.base, value.dtype
    if type(value) is Scalar:
        base = np.empty((), dtype=object)
        base[()] = value
        return base, value.dtype
    if type(value) is Selection:
        refuse("what a Boolean mask selects has no fixed length; use np.where")
    if isinstance(value, list | tuple) and _has_symbols(value):
        parts = [_in(v) for v in value]
        dtype = np.result_type(*(d for _, d in parts))
        shapes = {b.shape for b, _ in parts}
        if len(shapes) > 1:
            refuse(f"rows of different lengths make no array: {', '.join(map(str, sorted(shapes)))}")
        base = np.empty((len(parts), *shapes.pop()), dtype=object)
        for i, (b, d) in enumerate(parts):
            base[i, ...] = _cast_base(b, d, dtype)
        return base, dtype
    numbers = np.asarray(value)
    if numbers.dtype.kind not in "fiub":
        refuse(f"values of the type {numbers.dtype} can't be traced")
    dtype = {"f": FLOAT, "i": INT, "u": INT, "b": BOOL}[numbers.dtype.kind]
    return _filled([Scalar(ca.SX(float(n)), dtype) for n in numbers.ravel().tolist()], numbers.shape), dtype


def _filled(elements: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """An object array of elements, each stored as it is."""
    base = np.empty(len(elements), dtype=object)
    for i, element in enumerate(elements):
        base[i] = element
    return base.reshape(shape)


def _has_symbols(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(_has_symbols(v) for v in value)
    return type(value) in (Scalar, Array, Selection)


def _cast(value: Scalar, dtype: np.dtype[Any]) -> Scalar:
    if dtype == value.dtype:
        return value
    if dtype == BOOL:
        return Scalar(value.sx != 0.0, BOOL)
    if dtype not in (FLOAT, INT):
        refuse(f"the type {dtype} can't be traced; only float, int and bool")
    return Scalar(_trunc(value.sx) if dtype == INT and value.dtype == FLOAT else value.sx, dtype)


def _cast_base(base: Any, dtype: np.dtype[Any], wanted: np.dtype[Any]) -> Any:
    if dtype == wanted:
        return base
    return _filled([_cast(value, wanted) for value in base.flat], base.shape)


# Elementwise operations


def _where(condition: Any, a: Any, b: Any) -> Any:
    if _constant(condition):
        return a if float(condition) else b
    return ca.if_else(condition, a, b)


def _trunc(a: Any) -> Any:
    return ca.if_else(a < 0.0, ca.ceil(a), ca.floor(a))


def _is_nan(a: Any) -> Any:
    return ca.logic_not(a <= ca.inf)


def _rint(a: Any) -> Any:
    below = ca.floor(a)
    rest = a - below
    half = below * 0.5
    odd = half != ca.floor(half)
    up = ca.logic_or(rest > 0.5, ca.logic_and(rest == 0.5, odd))
    return ca.copysign(below + up, a)


def _mod(a: Any, b: Any) -> Any:
    rest = ca.fmod(a, b)
    other_side = ca.if_else(b < 0.0, rest > 0.0, rest < 0.0)
    return ca.if_else(rest == 0.0, ca.copysign(0.0, b), ca.if_else(other_side, rest + b, rest))


def _floor_divide(a: Any, b: Any) -> Any:
    quotient = (a - _mod(a, b)) / b
    below = ca.floor(quotient)
    return ca.if_else(b == 0.0, a / b, ca.if_else(quotient - below > 0.5, below + 1.0, below))


def _xor(a: Any, b: Any) -> Any:
    return (a != 0.0) != (b != 0.0)


def _fmin(a: Any, b: Any) -> Any:
    return ca.if_else(_is_nan(a), b, ca.if_else(_is_nan(b), a, ca.fmin(a, b)))


def _fmax(a: Any, b: Any) -> Any:
    return ca.if_else(_is_nan(a), b, ca.if_else(_is_nan(b), a, ca.fmax(a, b)))


def _heaviside(a: Any, b: Any) -> Any:
    return ca.if_else(_is_nan(a), a, ca.if_else(a == 0.0, b, a > 0.0))


def _logaddexp(a: Any, b: Any) -> Any:
    return ca.if_else(a == b, a + np.log(2.0), ca.fmax(a, b) + ca.log1p(ca.exp(-ca.fabs(a - b))))


_LN2, _LN10 = float(np.log(2.0)), float(np.log(10.0))

#: What numpy's functions of numbers are on expressions.
_UFUNCS: dict[np.ufunc, Callable[..., Any]] = {
    np.add: ca.plus,
    np.subtract: ca.minus,
    np.multiply: ca.times,
    np.divide: ca.rdivide,
    np.negative: lambda a: -a,
    np.positive: lambda a: a,
    np.power: lambda a, b: a**b,
    np.float_power: lambda a, b: a**b,
    np.square: lambda a: a**2,
    np.reciprocal: lambda a: 1.0 / a,
    np.sqrt: ca.sqrt,
    np.exp: ca.exp,
    np.exp2: lambda a: ca.SX(2.0) ** a,
    np.log: ca.log,
    np.log2: lambda a: ca.log(a) / _LN2,
    np.log10: lambda a: ca.log(a) / _LN10,
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
    np.trunc: _trunc,
    np.rint: _rint,
    np.copysign: ca.copysign,
    np.signbit: lambda a: ca.copysign(1.0, a) < 0.0,
    np.heaviside: _heaviside,
    np.fmod: ca.fmod,
    np.remainder: _mod,
    np.floor_divide: _floor_divide,
    np.minimum: ca.fmin,
    np.maximum: ca.fmax,
    np.fmin: _fmin,
    np.fmax: _fmax,
    np.less: lambda a, b: a < b,
    np.less_equal: lambda a, b: a <= b,
    np.greater: lambda a, b: a > b,
    np.greater_equal: lambda a, b: a >= b,
    np.equal: lambda a, b: a == b,
    np.not_equal: lambda a, b: a != b,
    np.logical_and: lambda a, b: ca.logic_and(a, b),
    np.logical_or: lambda a, b: ca.logic_or(a, b),
    np.logical_not: lambda a: ca.logic_not(a),
    np.logical_xor: _xor,
    np.bitwise_and: lambda a, b: ca.logic_and(a, b),
    np.bitwise_or: lambda a, b: ca.logic_or(a, b),
    np.bitwise_xor: _xor,
    np.invert: lambda a: ca.logic_not(a),
    np.isnan: _is_nan,
    np.isinf: lambda a: ca.fabs(a) == ca.inf,
    np.isfinite: lambda a: ca.fabs(a) < ca.inf,
    np.deg2rad: lambda a: a * (np.pi / 180.0),
    np.radians: lambda a: a * (np.pi / 180.0),
    np.rad2deg: lambda a: a * (180.0 / np.pi),
    np.degrees: lambda a: a * (180.0 / np.pi),
    np.conjugate: lambda a: a,
    np.cbrt: lambda a: ca.copysign(ca.fabs(a) ** (1.0 / 3.0), a),
    np.logaddexp: _logaddexp,
}
_NEUTRAL = {np.add: 0, np.multiply: 1, np.logical_or: False, np.logical_and: True}
_BITWISE = {np.bitwise_and, np.bitwise_or, np.bitwise_xor, np.invert}


def _elementwise(f: Callable[..., Any], bases: Sequence[Any], dtype: np.dtype[Any]) -> Any:
    flat = [[e.sx for e in base.flat] for base in bases]
    return _filled([Scalar(_expression(f(*values)), dtype) for values in zip(*flat, strict=True)], bases[0].shape)


def _expression(value: Any) -> Any:
    return value if type(value) is ca.SX else ca.SX(value)


def _weak(value: Any) -> Any:
    """The type of an operand as numpy's promotion sees it."""
    return type(value) if type(value) in (int, float) else getattr(value, "dtype", None) or np.asarray(value).dtype


def _applied(ufunc: np.ufunc, inputs: Sequence[Any]) -> tuple[Any, np.dtype[Any]]:
    """A ufunc element by element, with the type that numpy gives to the result."""
    converted = [_in(i) for i in inputs]
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
    if dtype == INT and ufunc in (np.floor_divide, np.remainder, np.fmod, np.power, np.reciprocal):
        refuse(f"np.{ufunc.__name__} of whole numbers can't be traced; use floats, such as 2.0")
    f = _UFUNCS[ufunc]
    if ufunc is np.add and dtype == BOOL:
        f = ca.logic_or
    if ufunc in (np.power, np.float_power) and converted[1][1] in (INT, BOOL) and kinds[0] == BOOL:
        refuse("a power of a Boolean can't be traced; write 1.0 * (...)")
    bases = np.broadcast_arrays(*(b for b, _ in converted)) if len(converted) > 1 else [converted[0][0]]
    return _elementwise(f, bases, dtype), dtype


def _ufunc(ufunc: np.ufunc, method: str, inputs: Sequence[Any], options: dict[str, Any]) -> Any:
    name = f"np.{ufunc.__name__}" + ("" if method == "__call__" else f".{method}")
    options = {k: v for k, v in options.items() if v is not None and v is not np._NoValue}
    out = options.pop("out", None)
    if "where" in options and options["where"] is True:
        del options["where"]
    for i in inputs:
        if type(i) is Selection:
            return i.__array_ufunc__(ufunc, method, *inputs, **options)
    if ufunc is np.matmul and method == "__call__" and not options and out is None:
        return _function(np.matmul, inputs, {})
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
    elif method == "reduce":
        base, dtype = _reduce(ufunc, inputs[0], options.get("axis", 0), bool(options.get("keepdims", False)))
    elif method == "accumulate":
        base, dtype = _accumulate(ufunc, inputs[0], options.get("axis", 0))
    elif method == "outer":
        a, b = (np.asanyarray(i) if type(i) not in (Array, Scalar) else i for i in inputs)
        base, dtype = _applied(ufunc, (np.reshape(a, np.shape(a) + (1,) * np.ndim(b)), b))
    else:
        refuse(f"{name} can't be traced; see the page 'numpy that can be traced'")
    if out is not None:
        target = out[0] if isinstance(out, tuple) else out
        if type(target) is not Array:
            refuse(_ARRAY)
        target._writeable()
        if not np.can_cast(dtype, target.dtype, "same_kind"):
            refuse(f"numpy can't store the {dtype} that {name} gives in an array of {target.dtype}")
        target.base[...] = _cast_base(np.broadcast_to(base, target.shape), dtype, target.dtype)
        return target
    return _out(base if base.ndim else base.item(), dtype)


def _axes(axis: Any, ndim: int) -> tuple[int, ...]:
    if axis is None:
        return tuple(range(ndim))
    axes = axis if isinstance(axis, tuple) else (axis,)
    return tuple(np.lib.array_utils.normalize_axis_index(a, ndim) for a in axes)


def _reduce(ufunc: np.ufunc, value: Any, axis: Any, keepdims: bool) -> tuple[Any, np.dtype[Any]]:
    base, dtype = _in(value)
    axes = _axes(axis, base.ndim)
    others = tuple(i for i in range(base.ndim) if i not in axes)
    kept = tuple(base.shape[i] for i in others)
    columns = base.transpose(*axes, *others).reshape(-1, *kept) if base.ndim else base.reshape(1)
    if dtype == BOOL and ufunc in (np.add, np.multiply):
        columns, dtype = _cast_base(columns, BOOL, INT), INT
    if ufunc in (np.logical_and, np.logical_or):
        columns, dtype = _cast_base(columns, dtype, BOOL), BOOL
    if not len(columns):
        if ufunc not in _NEUTRAL:
            refuse(f"np.{ufunc.__name__} of an array without elements has no value")
        total = _in(np.full(kept, _NEUTRAL[ufunc], dtype))[0]
    else:
        total = columns[0:1].reshape(kept)
        for i in range(1, len(columns)):
            total, dtype = _applied(ufunc, (Array(total, dtype), Array(columns[i : i + 1].reshape(kept), dtype)))
    if keepdims:
        total = total.reshape(tuple(1 if i in axes else n for i, n in enumerate(base.shape)))
    return total, dtype


def _accumulate(ufunc: np.ufunc, value: Any, axis: Any) -> tuple[Any, np.dtype[Any]]:
    base, dtype = _in(value)
    if dtype == BOOL and ufunc in (np.add, np.multiply):
        base, dtype = _cast_base(base, BOOL, INT), INT
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

    for kind in (Scalar, Array, Selection):
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


# Functions that are no ufuncs

#: Those that move elements or are sums of products: numpy's own, on the object array.
_STRUCTURAL = {
    *(np.reshape, np.ravel, np.transpose, np.concatenate, np.stack, np.vstack, np.hstack, np.dstack, np.column_stack),
    *(np.block, np.roll, np.flip, np.fliplr, np.flipud, np.tile, np.repeat, np.squeeze, np.expand_dims, np.moveaxis),
    *(np.swapaxes, np.rollaxis, np.rot90, np.broadcast_to, np.diag, np.diagonal, np.diagflat, np.atleast_1d),
    *(np.atleast_2d, np.atleast_3d, np.append, np.insert, np.delete, np.split, np.array_split, np.hsplit, np.vsplit),
    *(np.tril, np.triu, np.copy, np.take, np.take_along_axis, np.pad, np.permute_dims, np.matrix_transpose, np.resize),
    *(np.dot, np.inner, np.outer, np.matmul, np.vdot, np.tensordot, np.kron, np.trace, np.einsum, np.cross, np.diff),
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
    *(np.linalg.multi_dot, np.linalg.vecdot, np.linalg.outer, np.linalg.cross, np.linalg.trace, np.linalg.diagonal),
    *(np.linalg.matrix_transpose, np.linalg.matrix_power, np.unstack),
} - {np.matmul, np.trim_zeros}
_STRUCTURAL.add(np.matmul)

#: Functions that tell about shapes.
_SHAPES = {np.shape, np.ndim, np.size, np.iscomplexobj, np.isrealobj, np.result_type}


def _numbers_like(value: Any) -> Any:
    """Numbers of the same shape and type, to find what numpy makes of them."""
    if isinstance(value, list | tuple):
        return type(value)(_numbers_like(v) for v in value)
    if type(value) is Array:
        return np.ones(value.shape, value.dtype)
    return value.dtype.type(1) if type(value) is Scalar else value


def _objects(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return type(value)(_objects(v) for v in value)
    if type(value) is Array:
        return value.base
    if type(value) is Scalar:
        return _in(value)[0]
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return _in(value)[0]
    return value


def _wrapped(result: Any, like: Any) -> Any:
    if isinstance(result, list | tuple):
        parts = [_wrapped(r, n) for r, n in zip(result, like, strict=True)]
        return parts if isinstance(result, list) else tuple(parts)
    dtype = np.asarray(like).dtype
    dtype = {"f": FLOAT, "i": INT, "u": INT, "b": BOOL}.get(dtype.kind, FLOAT)
    if isinstance(result, np.ndarray):
        if any(type(e) is not Scalar for e in result.flat):
            elements = [e if type(e) is Scalar else Scalar(ca.SX(float(e)), dtype) for e in result.flat]
            result = _filled(elements, result.shape)
        if np.shape(like) == () and result.ndim == 0 and not isinstance(like, np.ndarray):
            return _out(result.item(), dtype)
        return Array(result, dtype)
    return _out(result, dtype) if type(result) is Scalar else result


def _function(f: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    if f in _HANDLERS:
        return _HANDLERS[f](*args, **kwargs)
    if f in _SHAPES:
        return f(*(_numbers_like(a) for a in args), **{k: _numbers_like(v) for k, v in kwargs.items()})
    if f in _STRUCTURAL:
        if kwargs.get("where", True) is not True or kwargs.get("out") is not None or kwargs.get("dtype") is not None:
            refuse(f"np.{f.__name__} with where=, out= or dtype= can't be traced")
        like = f(*(_numbers_like(a) for a in args), **{k: _numbers_like(v) for k, v in kwargs.items()})
        if f in (np.dot, np.inner, np.matmul, np.vdot, np.tensordot, np.outer) and np.asarray(like).dtype == BOOL:
            refuse(f"np.{f.__name__} of Boolean values can't be traced; write 1.0 * (...)")
        return _wrapped(f(*(_objects(a) for a in args), **{k: _objects(v) for k, v in kwargs.items()}), like)
    arguments = [*args, *kwargs.values()]
    if not any(_depends(a) for a in arguments):
        return f(*(_plain(a) for a in args), **{k: _plain(v) for k, v in kwargs.items()})
    module = "np.linalg" if "linalg" in getattr(f, "__module__", "") else "np"
    return refuse(f"{module}.{getattr(f, '__name__', f)} can't be traced; see the page 'numpy that can be traced'")


def _depends(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(_depends(v) for v in value)
    if type(value) is Selection:
        return True
    if type(value) is Array:
        return not value.is_constant()
    return type(value) is Scalar and not _constant(value.sx)


def _plain(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return type(value)(_plain(v) for v in value)
    return value.numbers() if type(value) is Array else value.number() if type(value) is Scalar else value


def _reduction(ufunc: np.ufunc) -> Callable[..., Any]:
    def reduce(
        a: Any, axis: Any = None, dtype: Any = None, out: Any = None, keepdims: Any = False, **options: Any
    ) -> Any:
        given = {k for k, v in options.items() if v is not np._NoValue and not (k == "where" and v is True)}
        if given or dtype is not None or out is not None:
            names = ", ".join(sorted(given)) or "dtype or out"
            refuse(f"np.{ufunc.__name__}.reduce with {names}= can't be traced; use np.where")
        if type(a) is Selection:
            return a.__array_ufunc__(ufunc, "reduce", a)
        base, kind = _reduce(ufunc, a, axis, keepdims is True)
        return _out(base if base.ndim else base.item(), kind)

    return reduce


def _min_or_max(ufunc: np.ufunc) -> Callable[..., Any]:
    reduce = _reduction(ufunc)

    def extreme(a: Any, axis: Any = None, out: Any = None, keepdims: Any = False, **options: Any) -> Any:
        return reduce(a, axis, None, out, keepdims, **options)

    return extreme


def _cumulative(ufunc: np.ufunc) -> Callable[..., Any]:
    def accumulate(a: Any, axis: Any = None, dtype: Any = None, out: Any = None) -> Any:
        if dtype is not None or out is not None:
            refuse(f"np.{ufunc.__name__}.accumulate with dtype= or out= can't be traced")
        a = np.ravel(a) if axis is None else a
        return Array(*_accumulate(ufunc, a, 0 if axis is None else axis))

    return accumulate


def _mean(a: Any, axis: Any = None, dtype: Any = None, out: Any = None, keepdims: Any = False, **options: Any) -> Any:
    if dtype is not None or out is not None or options:
        refuse("np.mean with dtype=, out= or where= can't be traced")
    if type(a) is Selection:
        return a.mean()
    total = np.sum(a, axis=axis, keepdims=keepdims is True)
    return total / (np.size(a) / max(np.size(total), 1))


def _var(
    a: Any, axis: Any = None, dtype: Any = None, out: Any = None, ddof: float = 0, keepdims: Any = False, **o: Any
) -> Any:
    if dtype is not None or out is not None or o:
        refuse("np.var with dtype=, out= or where= can't be traced")
    deviation = a - np.mean(a, axis=axis, keepdims=True)
    total = np.sum(deviation * deviation, axis=axis, keepdims=keepdims is True)
    return total / (np.size(a) / max(np.size(total), 1) - ddof)


def _clip(a: Any, a_min: Any = None, a_max: Any = None, out: Any = None, **options: Any) -> Any:
    low, high = options.pop("min", a_min), options.pop("max", a_max)
    low, high = (None if v is np._NoValue else v for v in (low, high))
    if options:
        refuse("np.clip with further options can't be traced")
    result = a
    if low is not None:
        result = np.maximum(result, low)
    if high is not None:
        result = np.minimum(result, high)
    if out is not None:
        return np.positive(result, out=out)
    return result if result is not a else np.positive(a)


def _np_where(condition: Any, *values: Any) -> Any:
    if len(values) != 2:
        refuse("np.where with a condition only gives indices, which can't be traced; give both values")
    (c, kind), (a, _), (b, _) = _in(condition), _in(values[0]), _in(values[1])
    c = _cast_base(c, kind, BOOL)
    dtype = np.result_type(*(v if type(v) in (int, float) else _in(v)[1] for v in values))
    dtype = dtype if dtype in (FLOAT, INT, BOOL) else FLOAT
    result = _elementwise(_where, np.broadcast_arrays(c, a, b), dtype)
    return Array(result, dtype)


def _select(conditions: Sequence[Any], choices: Sequence[Any], default: Any = 0) -> Any:
    result = default
    for condition, choice in zip(reversed(conditions), reversed(choices), strict=True):
        result = np.where(condition, choice, result)
    return result


def _piecewise(x: Any, conditions: Sequence[Any], functions: Sequence[Any]) -> Any:
    conditions = list(conditions) if isinstance(conditions, list | tuple) else [conditions]
    if len(functions) == len(conditions) + 1:
        result = functions[-1](x) if callable(functions[-1]) else functions[-1]
    else:
        result = 0.0
    if not all(np.shape(c) == np.shape(x) for c in conditions):
        refuse("np.piecewise with conditions of another shape than x can't be traced")
    for condition, function in zip(conditions, functions, strict=False):  # the last that holds counts
        result = np.where(condition, function(x) if callable(function) else function, result)
    return result


def _round(a: Any, decimals: int = 0, out: Any = None) -> Any:
    if out is not None:
        refuse("np.round with out= can't be traced")
    if decimals == 0:
        return np.rint(a)
    factor = 10.0 ** abs(decimals)
    return np.rint(a * factor) / factor if decimals > 0 else np.rint(a / factor) * factor


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if axis is None and ord in (None, 2, "fro") and (ord != 2 or np.ndim(x) == 1):
        flat = np.ravel(x)
        result = np.sqrt(np.dot(flat, flat))
        return np.reshape(result, (1,) * np.ndim(x)) if keepdims else result
    if (axis is None and np.ndim(x) != 1) or isinstance(axis, tuple):
        refuse("np.linalg.norm of a matrix with ord= can't be traced")
    axis = 0 if axis is None else axis
    if ord in (None, 2):
        return np.sqrt(np.sum(x * x, axis=axis, keepdims=keepdims))
    if ord == 1:
        return np.sum(np.abs(x), axis=axis, keepdims=keepdims)
    if ord in (np.inf, -np.inf):
        return (np.max if ord > 0 else np.min)(np.abs(x), axis=axis, keepdims=keepdims)
    return refuse("np.linalg.norm with this ord= can't be traced")


def _matrix(a: Any) -> Any:
    base, _ = _in(a)
    if base.ndim != 2:
        refuse("np.linalg functions of stacks of matrices can't be traced")
    return ca.vertcat(*(ca.horzcat(*(e.sx for e in row)) for row in base))


def _from_matrix(matrix: Any) -> Array:
    dense = ca.densify(matrix)
    base = np.empty(matrix.shape, dtype=object)
    for i, j in np.ndindex(*matrix.shape):
        base[i, j] = Scalar(dense[i, j])
    return Array(base, FLOAT)


def _solve(a: Any, b: Any) -> Any:
    right = b if np.ndim(b) == 2 else np.reshape(b, (-1, 1))
    return np.reshape(_from_matrix(ca.solve(_matrix(a), _matrix(right))), np.shape(b))


def _searchsorted(a: Any, v: Any, side: str = "left", sorter: Any = None) -> Any:
    if sorter is not None:
        refuse("np.searchsorted with sorter= can't be traced")
    place: Any = 0
    for edge in a:  # NaN is sorted behind all numbers
        place = place + (~(v <= edge) if side == "left" else ~(v < edge)) * 1
    return place


def _interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None) -> Any:
    if _depends(xp) or _depends(period):
        refuse("np.interp with symbols as places of its table can't be traced; the places must be numbers")
    xs, ys = np.asarray(_plain(xp), dtype=float), fp if type(fp) in (Array, list, tuple) else np.asarray(fp)
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


def _argument(better: np.ufunc) -> Callable[..., Any]:
    def argument(a: Any, axis: Any = None, out: Any = None, **_: Any) -> Any:
        best: Any
        place: Any
        if axis is not None or out is not None:
            refuse("np.argmax and np.argmin with axis= can't be traced")
        flat = np.ravel(a)
        best, place = flat[0], np.int64(0)
        for i in range(1, len(flat)):
            wins = better(flat[i], best) | (np.isnan(flat[i]) & ~np.isnan(best))
            wins = wins & ~np.isnan(best)
            best, place = np.where(wins, flat[i], best)[()], np.where(wins, i, place)[()]
        return place

    return argument


def _sort(a: Any, axis: Any = -1, **options: Any) -> Any:
    if options or axis is None:
        refuse("np.sort with options can't be traced")
    base = np.moveaxis(_in(a)[0], axis, 0).copy()
    dtype = a.dtype
    for last in range(len(base) - 1, 0, -1):
        for i in range(last):
            pair = Array(base[i : i + 1].copy(), dtype), Array(base[i + 1 : i + 2].copy(), dtype)
            base[i : i + 1], base[i + 1 : i + 2] = np.minimum(*pair).base, np.maximum(*pair).base
    return Array(np.moveaxis(base, 0, axis), dtype)


def _like(value: float) -> Callable[..., Any]:
    def like(a: Any, dtype: Any = None, shape: Any = None, **_: Any) -> Any:
        kind = _in(a)[1] if dtype is None else np.dtype(dtype)
        return _made(np.full(np.shape(a) if shape is None else shape, value, FLOAT).astype(kind))

    return like


def _full_like(a: Any, fill_value: Any, dtype: Any = None, shape: Any = None, **_: Any) -> Any:
    result = _like(0.0)(a, dtype, shape)
    result[...] = fill_value
    return result


def _made(numbers: Any) -> Any:
    return Array(*_in(numbers))


_HANDLERS: dict[Any, Callable[..., Any]] = {
    np.sum: _reduction(np.add),
    np.prod: _reduction(np.multiply),
    np.any: _reduction(np.logical_or),
    np.all: _reduction(np.logical_and),
    np.min: _min_or_max(np.minimum),
    np.max: _min_or_max(np.maximum),
    np.amin: _min_or_max(np.minimum),
    np.amax: _min_or_max(np.maximum),
    np.ptp: lambda a, axis=None: np.max(a, axis=axis) - np.min(a, axis=axis),
    np.cumsum: _cumulative(np.add),
    np.cumprod: _cumulative(np.multiply),
    np.mean: _mean,
    np.average: lambda a, axis=None, weights=None: (
        _mean(a, axis) if weights is None else np.sum(a * weights, axis=axis) / np.sum(weights + 0.0 * a, axis=axis)
    ),
    np.var: _var,
    np.std: lambda *a, **k: np.sqrt(_var(*a, **k)),
    np.count_nonzero: lambda a, axis=None: np.sum(_asarray(a) != 0, axis=axis),
    np.clip: _clip,
    np.where: _np_where,
    np.select: _select,
    np.piecewise: _piecewise,
    np.round: _round,
    np.around: _round,
    np.linalg.norm: _norm,
    np.linalg.solve: _solve,
    np.linalg.inv: lambda a: _from_matrix(ca.solve(_matrix(a), ca.SX.eye(len(a)))),
    np.linalg.det: lambda a: _out(Scalar(ca.det(_matrix(a))), FLOAT),
    np.searchsorted: _searchsorted,
    np.digitize: lambda x, bins, right=False: _searchsorted(bins, x, "left" if right else "right"),
    np.interp: _interp,
    np.argmax: _argument(np.greater),
    np.argmin: _argument(np.less),
    np.sort: _sort,
    np.zeros_like: _like(0.0),
    np.ones_like: _like(1.0),
    np.empty_like: _like(np.nan),
    np.full_like: _full_like,
    np.isclose: lambda a, b, rtol=1e-5, atol=1e-8, equal_nan=False: (
        refuse("np.isclose with equal_nan= can't be traced")
        if equal_nan
        else (np.abs(a - b) <= atol + rtol * np.abs(b)) & np.isfinite(b) | (a == b)
    ),
    np.sinc: lambda x: np.sin(np.pi * np.where(x == 0, 1e-20, x)) / (np.pi * np.where(x == 0, 1e-20, x)),
    np.real: lambda a: a,
    np.copyto: lambda dst, src, casting="same_kind", where=True: (
        dst.__setitem__(..., src) if where is True and type(dst) is Array else refuse(_ARRAY)
    ),
    np.fix: lambda a, out=None: np.trunc(a) if out is None else refuse("np.fix with out= can't be traced"),
    np.trapezoid: lambda y, x=None, dx=1.0: np.sum((dx if x is None else np.diff(x)) * (y[1:] + y[:-1]) / 2.0),
    np.may_share_memory: lambda a, b: False,
    np.array_equal: lambda a, b, equal_nan=False: (
        np.all(a == b) if not equal_nan else refuse("equal_nan= can't be traced")
    ),
}


# Arrays that are made while tracing can hold symbols

_thread = threading.local()


def _asarray(value: Any, dtype: Any = None, *, copy: Any = None, ndmin: int = 0, **_: Any) -> Any:
    """np.array and np.asarray of symbols."""
    if type(value) is Array and copy is False and dtype is None:
        return value
    base, kind = _in(value)
    wanted = kind if dtype is None else np.dtype(dtype)
    base = _cast_base(base, kind, wanted)
    base = base if copy is False and type(value) is Array else base.copy()
    return Array(base.reshape((1,) * max(0, ndmin - base.ndim) + base.shape), wanted)


def _ours() -> bool:
    """Whether the author's code of this thread calls, while it is traced."""
    if not getattr(_thread, "tracing", False):
        return False
    module = sys._getframe(2).f_globals.get("__name__", "")
    return module.partition(".")[0] not in ("numpy", "scipy", "casadi") and module != __name__


def _replacements() -> dict[str, Callable[..., Any]]:
    def maker(original: Callable[..., Any]) -> Callable[..., Any]:
        def make(*args: Any, **kwargs: Any) -> Any:
            made = original(*(_plain(a) if type(a) in (Array, Scalar) else a for a in args), **kwargs)
            if original is np_empty and made.dtype == FLOAT:
                made.fill(np.nan)
            return _made(made) if _ours() and made.dtype == FLOAT and made.size <= 4096 else made

        return make

    def converter(original: Callable[..., Any], copy: bool) -> Callable[..., Any]:
        def convert(value: Any, *args: Any, **kwargs: Any) -> Any:
            if not getattr(_thread, "tracing", False):
                return original(value, *args, **kwargs)
            if type(value) is Selection:
                return value
            if _has_symbols(value):
                if args:
                    kwargs["dtype"] = args[0]
                return _asarray(value, kwargs.get("dtype"), copy=copy, ndmin=kwargs.get("ndmin", 0))
            made = original(value, *args, **kwargs)
            if copy and _ours() and made.dtype == FLOAT and made.size <= 4096:
                return _made(made)
            return made

        return convert

    def full(shape: Any, fill_value: Any, dtype: Any = None, **kwargs: Any) -> Any:
        if not getattr(_thread, "tracing", False) or not _has_symbols(fill_value):
            made = np_full(shape, fill_value, dtype, **kwargs)
            return _made(made) if _ours() and made.dtype == FLOAT else made
        base, kind = _in(fill_value)
        wanted = kind if dtype is None else np.dtype(dtype)
        return Array(np.broadcast_to(_cast_base(base, kind, wanted), shape).copy(), wanted)

    np_empty, np_full = np.empty, np.full
    return {
        **{n: maker(getattr(np, n)) for n in ("zeros", "ones", "empty", "eye", "identity", "linspace")},
        "full": full,
        "array": converter(np.array, copy=True),
        **{n: converter(getattr(np, n), copy=False) for n in ("asarray", "asanyarray", "ascontiguousarray")},
    }


_lock = threading.RLock()


@contextmanager
def tracing(model: str) -> Iterator[None]:
    """Context in which the author's functions run with symbols; other threads see numpy as it is.

    Raises
    ------
    TraceError
        Something can't be traced; the message has the model, file, line and remedy.
    """
    with _lock:
        if getattr(_thread, "tracing", False):
            yield
            return
        replaced = _replacements()
        before = {name: getattr(np, name) for name in replaced}
        _thread.tracing = True
        _refused.clear()
        for name, function in replaced.items():
            setattr(np, name, function)
        try:
            yield
            if _refused:  # the author's code has caught it
                raise _refused[0]
        except TraceError as error:
            text = str(error)
            raise TraceError(text if text.startswith(f"{model}: ") else f"{model}: {text}") from error
        except (TypeError, ValueError, IndexError, AttributeError, NotImplementedError) as error:
            if _refused:
                raise TraceError(f"{model}: {_refused[0]}") from error
            raise TraceError(f"{model}: {_place_of(error)}{error}") from error
        finally:
            for name, original in before.items():
                setattr(np, name, original)
            _thread.tracing = False


def argument(symbols: Any) -> Array:
    """A flat argument, which can't be written."""
    base = np.empty(symbols.numel(), dtype=object)
    for i in range(symbols.numel()):
        base[i] = Scalar(symbols[i])
    base.flags.writeable = False
    return Array(base, FLOAT)


def column(value: Any, what: str, length: int) -> Any:
    """What a function returns as a column of expressions (length, 1).

    Raises
    ------
    TraceError
        It has another shape.
    """
    base, _ = _in(value)
    if base.ndim > 1 or (base.ndim == 0 and length != 1):
        raise TraceError(
            f"{what} returns an array of shape {base.shape}; ({length},) is declared, so flatten it by np.ravel"
        )
    if base.size != length:
        raise TraceError(f"{what} returns {base.size} values, {length} are declared")
    return ca.vertcat(*(e.sx for e in base.flat)) if length else ca.SX(0, 1)
