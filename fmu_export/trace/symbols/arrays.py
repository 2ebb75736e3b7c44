"""Arrays and scalars of symbols, which stand for numbers while a model's functions run.

An `Array` keeps its elements in an object array of numpy, so that views, slices, writes, broadcasting and the order
of elements are numpy's own. What can't be traced is refused where it happens, with the line of the author's file and
the remedy; nothing falls back to something else. What numpy's functions do with these arrays is said in
`fmu_export.trace.symbols.ufuncs` and `fmu_export.trace.symbols.functions`, which give these classes their operators.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal

import numpy as np

from fmu_export.errors import needs
from fmu_export.trace.symbols.expressions import either, is_number, truncated
from fmu_export.trace.symbols.refusal import BRANCH, MASK, SHIFT, STORED, refuse, refuse_number

with needs("export"):
    import casadi as ca

FLOAT, INT, BOOL = np.dtype(float), np.dtype(np.int64), np.dtype(bool)

#: Names of the symbols of what depends on the time alone, when it is traced once and again.
_OF_TIME = ({"t"}, {"t_"})


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

    def __array__(self, *_: Any, **__: Any) -> Any:
        if is_number(self.sx):
            return np.asarray(self.number())
        return refuse(STORED)

    def number(self) -> Any:
        """The number that a constant is."""
        return self.dtype.type(float(self.sx)) if is_number(self.sx) else refuse_number()

    def __bool__(self) -> bool:
        return bool(self.number()) if is_number(self.sx) else refuse(BRANCH)

    def __float__(self) -> float:
        return float(self.number()) if is_number(self.sx) else refuse_number()

    def __int__(self) -> int:
        return int(self.number()) if is_number(self.sx) else refuse_number()

    def __index__(self) -> int:
        if is_number(self.sx) and self.dtype == INT:
            return int(self.number())
        return refuse("a value can't be an index or a number of repetitions; use np.where, np.select or np.interp")

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
        return cast(self, np.dtype(dtype))

    def __floor__(self) -> Any:
        return np.floor(self)

    def __ceil__(self) -> Any:
        return np.ceil(self)

    def __trunc__(self) -> Any:
        return np.trunc(self)

    def __round__(self, n: int | None = None) -> Any:
        if n is not None and {str(s) for s in ca.symvar(self.sx)} in _OF_TIME:
            refuse(
                "round(t, n) can't be traced: the time is a Python number, which rounds otherwise; use np.round(t, n)"
            )
        return np.round(self, n or 0)

    def __getitem__(self, key: Any) -> Any:
        return unwrapped(elements_of(self)[0][key], self.dtype)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(Array(elements_of(self)[0], self.dtype), name)


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

    @property
    def T(self) -> Array:
        """The transposed view."""
        return Array(self.base.T, self.dtype)

    @property
    def flat(self) -> Array:
        """All elements, in the order of C."""
        flat = self.base.reshape(-1)
        if not np.shares_memory(flat, self.base):
            flat.flags.writeable = False
        return Array(flat, self.dtype)

    def flatten(self, order: Literal["C", "F", "A", "K"] = "C") -> Array:
        """A copy of all elements along one axis."""
        return Array(self.base.flatten(order), self.dtype)

    def __array__(self, *_: Any, **__: Any) -> Any:
        if self.is_constant():
            return self.numbers()
        return refuse(MASK if self.dtype == BOOL else STORED)

    def is_constant(self) -> bool:
        """Whether all elements are numbers."""
        return all(is_number(e.sx) for e in self.base.flat)

    def numbers(self) -> Any:
        """The numbers that constants are."""
        if not self.is_constant():
            refuse(STORED)
        return np.array([float(e.sx) for e in self.base.flat]).reshape(self.shape).astype(self.dtype)

    def __len__(self) -> int:
        return len(self.base)

    def __iter__(self) -> Iterator[Any]:
        if not self.ndim:
            raise TypeError("iteration over a 0-d array")
        return (self[i] for i in range(len(self)))

    def __bool__(self) -> bool:
        return bool(self.numbers()) if self.is_constant() else refuse(BRANCH)

    def __float__(self) -> float:
        return float(self.numbers()) if self.is_constant() else refuse_number()

    def __int__(self) -> int:
        return int(self.numbers()) if self.is_constant() else refuse_number()

    def __index__(self) -> int:
        return self.base.item().__index__()  # type: ignore[no-any-return]

    def __format__(self, spec: str) -> str:
        refuse("a symbol has no text; leave the f-string or print out of the model's functions")

    __hash__ = None  # type: ignore[assignment]

    def __contains__(self, value: Any) -> bool:
        return bool(np.any(self == value))

    def __lshift__(self, other: Any) -> Any:
        refuse(SHIFT)

    __rlshift__ = __rshift__ = __rrshift__ = __lshift__

    def __getitem__(self, key: Any) -> Any:
        key = _key(key)
        if isinstance(key, _Mask):
            return _selection(self, key.mask)
        return unwrapped(self.base[key], self.dtype)

    def __setitem__(self, key: Any, value: Any) -> None:
        key = _key(key)
        self.check_writeable()
        if type(value) is Selection:
            if not isinstance(key, _Mask) or not _same(value.mask, key.mask):
                refuse("what a Boolean mask selects can be assigned to the same mask only; use np.where")
            value = value.values
        base, dtype = elements_of(value)
        if not np.can_cast(dtype, self.dtype, "same_kind") and self.dtype not in (INT, BOOL):
            refuse(f"numpy can't store {dtype} in an array of {self.dtype}")
        base = cast_elements(base, dtype, self.dtype)
        if isinstance(key, _Mask):
            if base.ndim and base.shape != self.shape:
                refuse("values of another shape can't be assigned to a Boolean mask; use np.where")
            mask = key.mask.base
            if mask.shape != self.shape[: mask.ndim]:
                refuse(f"a Boolean mask of shape {mask.shape} is not an index of an array of shape {self.shape}")
            mask = mask.reshape(mask.shape + (1,) * (self.ndim - mask.ndim))
            self.base[...] = elementwise(either, np.broadcast_arrays(mask, base, self.base), self.dtype)
        else:
            self.base[key] = base if isinstance(self.base[key], np.ndarray) else base.item()

    def check_writeable(self) -> None:
        """Refuse a write into an argument."""
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
        return Array(cast_elements(self.base, self.dtype, np.dtype(dtype)).copy(), np.dtype(dtype))

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
        return unwrapped(self.base.reshape(*shape, **options), self.dtype)

    def transpose(self, *axes: Any) -> Any:
        """A view with other axes."""
        return unwrapped(self.base.transpose(*axes), self.dtype)

    def __getattr__(self, name: str) -> Any:
        if name in _METHODS:
            function = getattr(np, _METHODS[name])
            return lambda *args, **kwargs: function(self, *args, **kwargs)
        if name.startswith("_"):
            raise AttributeError(name)
        return refuse(f"the method or attribute .{name} of an array can't be traced")


#: What is made of all that a mask selects.
_TOTALS = (np.sum, np.prod, np.any, np.all, np.mean)


class Selection:
    """What a Boolean mask selects: all elements and the mask, since the number of those selected is not known."""

    def __init__(self, values: Array, mask: Array) -> None:
        self.values, self.mask = values, mask

    dtype = property(lambda self: self.values.dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if method == "reduce" and ufunc in NEUTRAL and not set(options) - {"axis"}:
            neutral = NEUTRAL[ufunc]
            return ufunc.reduce(np.where(self.mask, self.values, neutral), axis=None)
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

    def __setitem__(self, key: Any, value: Any) -> None:
        refuse("what a Boolean mask selects is a copy, and what is written into it is lost; write d[mask] = ...")

    def __array_function__(self, f: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if f in _TOTALS and len(args) == 1 and not kwargs:
            return getattr(self, f.__name__)()
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
        refuse(BRANCH)

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
}


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
            array = key if type(key) is Array else Array(elements_of(key)[0], BOOL)
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


def unwrapped(base: Any, dtype: np.dtype[Any]) -> Any:
    """An object array as an `Array`, its single element as a scalar."""
    if isinstance(base, np.ndarray):
        return Array(base, dtype)
    if type(base) is Scalar and is_number(base.sx):
        return base.number()
    return base


def elements_of(value: Any) -> tuple[Any, np.dtype[Any]]:
    """Anything that numpy takes for an array, as an object array of scalars and its type."""
    if type(value) is Array:
        return value.base, value.dtype
    if type(value) is Scalar:
        base = np.empty((), dtype=object)
        base[()] = value
        return base, value.dtype
    if type(value) is Selection:
        refuse("what a Boolean mask selects has no fixed length; use np.where")
    parts: list[tuple[Any, np.dtype[Any]]]
    if isinstance(value, list | tuple) and has_symbols(value):
        parts = [elements_of(v) for v in value]
        dtype = np.result_type(*(d for _, d in parts))
        shapes = {b.shape for b, _ in parts}
        if len(shapes) > 1:
            refuse(f"rows of different lengths make no array: {', '.join(map(str, sorted(shapes)))}")
        base = np.empty((len(parts), *shapes.pop()), dtype=object)
        for i, (b, d) in enumerate(parts):
            base[i, ...] = cast_elements(b, d, dtype)
        return base, dtype
    numbers = np.asarray(value)
    if numbers.dtype == object and all(_is_element(e) for e in numbers.flat):  # of numpy's own functions
        parts = [elements_of(e) for e in numbers.flat]
        dtype = np.result_type(*(d for _, d in parts))
        return filled([b.item() for b, _ in parts], numbers.shape), dtype
    if numbers.dtype.kind not in "fiub":
        refuse(f"values of the type {numbers.dtype} can't be traced")
    dtype = {"f": FLOAT, "i": INT, "u": INT, "b": BOOL}[numbers.dtype.kind]
    return filled([Scalar(ca.SX(float(n)), dtype) for n in numbers.ravel().tolist()], numbers.shape), dtype


def _is_element(value: Any) -> bool:
    return type(value) is Scalar or isinstance(value, int | float | np.number | np.bool_)


def filled(elements: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """An object array of elements, each stored as it is."""
    base = np.empty(len(elements), dtype=object)
    for i, element in enumerate(elements):
        base[i] = element
    return base.reshape(shape)


def has_symbols(value: Any) -> bool:
    """Whether a value is one of symbols, or a list or tuple with one."""
    if isinstance(value, list | tuple):
        return any(has_symbols(v) for v in value)
    return type(value) in (Scalar, Array, Selection)


def cast(value: Scalar, dtype: np.dtype[Any]) -> Scalar:
    """A scalar as another type; to int towards zero."""
    if dtype == value.dtype:
        return value
    if dtype == BOOL:
        return Scalar(value.sx != 0.0, BOOL)
    if dtype not in (FLOAT, INT):
        refuse(f"the type {dtype} can't be traced; only float, int and bool")
    return Scalar(truncated(value.sx) if dtype == INT and value.dtype == FLOAT else value.sx, dtype)


def cast_elements(base: Any, dtype: np.dtype[Any], wanted: np.dtype[Any]) -> Any:
    """The elements of an object array as another type."""
    if dtype == wanted:
        return base
    return filled([cast(value, wanted) for value in base.flat], base.shape)


#: What a reduction begins with.
NEUTRAL: dict[Any, Any] = {np.add: 0, np.multiply: 1, np.logical_or: False, np.logical_and: True}


def elementwise(f: Callable[..., Any], bases: Sequence[Any], dtype: np.dtype[Any]) -> Any:
    """A function of expressions, applied to the elements of object arrays of one shape."""
    flat = [[e.sx for e in base.flat] for base in bases]
    return filled([Scalar(_expression(f(*values)), dtype) for values in zip(*flat, strict=True)], bases[0].shape)


def _expression(value: Any) -> Any:
    return value if type(value) is ca.SX else ca.SX(value)


def depends(value: Any) -> bool:
    """Whether a value depends on symbols; those that are numbers do not."""
    if isinstance(value, list | tuple):
        return any(depends(v) for v in value)
    if type(value) is Selection:
        return True
    if type(value) is Array:
        return not value.is_constant()
    return type(value) is Scalar and not is_number(value.sx)


def plain(value: Any) -> Any:
    """A value with numbers in place of symbols that are numbers."""
    if isinstance(value, list | tuple):
        return type(value)(plain(v) for v in value)
    return value.numbers() if type(value) is Array else value.number() if type(value) is Scalar else value


def as_symbols(numbers: Any) -> Any:
    """Numbers as an array that takes symbols."""
    return Array(*elements_of(numbers))


def as_array(value: Any, dtype: Any = None, *, copy: Any = None, ndmin: int = 0, **_: Any) -> Any:
    """np.array and np.asarray of symbols."""
    if type(value) is Array and copy is False and dtype is None:
        return value
    base, kind = elements_of(value)
    wanted = kind if dtype is None else np.dtype(dtype)
    base = cast_elements(base, kind, wanted)
    base = base if copy is False and type(value) is Array else base.copy()
    return Array(base.reshape((1,) * max(0, ndmin - base.ndim) + base.shape), wanted)
