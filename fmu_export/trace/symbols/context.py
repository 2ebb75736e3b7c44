"""The context in which the author's functions run with symbols, and how arguments go in and results come out."""

from __future__ import annotations

import dis
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import CodeType
from typing import Any

import numpy as np

from fmu_export.errors import TraceError, needs
from fmu_export.trace.symbols import functions, ufuncs  # noqa: F401  # they give arrays their operators
from fmu_export.trace.symbols.arrays import (
    FLOAT,
    Array,
    Scalar,
    Selection,
    as_array,
    as_symbols,
    cast_elements,
    elements_of,
    has_symbols,
    plain,
)
from fmu_export.trace.symbols.expressions import as_written
from fmu_export.trace.symbols.refusal import place_of, refused
from fmu_export.trace.symbols.tables import forget_tables

with needs("export"):
    import casadi as ca

# Arrays that are made while tracing can hold symbols

_thread = threading.local()


def _ours(name: str, depth: int = 2) -> bool:
    """Whether the author's code calls np.<name> itself, in this thread, while it is traced.

    Compiled code that the author calls, such as that of np.random, has no frames of its own; it gets numpy's arrays,
    since it takes their memory without a question.
    """
    if not getattr(_thread, "tracing", False):
        return False
    frame = sys._getframe(depth)
    module = frame.f_globals.get("__name__", "")
    if module.partition(".")[0] in ("numpy", "scipy", "casadi") or module.startswith(_NOT_AUTHORS):
        return False
    called = _called(frame.f_code, frame.f_lasti)
    return called == name or frame.f_locals.get(called) is getattr(np, name)


@cache
def _called(code: CodeType, at: int) -> str:
    """The name by which code calls something at a place: the last that is loaded where the call begins."""
    positions = list(code.co_positions())
    begin = positions[at // 2][0], positions[at // 2][2]
    found = ""
    for step in dis.get_instructions(code):
        if step.offset >= at:
            break
        line, _, column, _ = positions[step.offset // 2]
        if step.opname.startswith("LOAD_") and isinstance(step.argval, str) and (line, column) == begin:
            found = step.argval
    return found


#: Modules of this package whose arrays are numbers.
_NOT_AUTHORS = ("fmu_export.trace", "fmu_export.modelling.tables")

#: Functions that make new arrays, which take symbols when they are called while tracing.
_OF_SHAPES = ("zeros", "ones", "empty", "eye", "identity", "arange")
_OF_ARRAYS = (
    *("linspace", "zeros_like", "ones_like", "empty_like", "copy", "diag", "tile", "repeat", "stack", "concatenate"),
    *("vstack", "hstack", "column_stack", "outer", "kron"),
)


def _replacements() -> dict[str, Any]:
    def maker(name: str) -> Callable[..., Any]:
        original = getattr(np, name)

        def make(*args: Any, **kwargs: Any) -> Any:
            if not _ours(name):
                return original(*args, **kwargs)
            if name in _OF_SHAPES:
                args = tuple(plain(a) for a in args)
            made = original(*args, **kwargs)
            if type(made) is not np.ndarray or made.dtype != FLOAT or made.size > 4096:
                return made
            if name.startswith("empty"):
                made.fill(np.nan)
            return as_symbols(made)

        return make

    def converter(name: str, copy: bool) -> Callable[..., Any]:
        original = getattr(np, name)

        def convert(value: Any, *args: Any, **kwargs: Any) -> Any:
            if not getattr(_thread, "tracing", False):
                return original(value, *args, **kwargs)
            if type(value) is Selection:
                return value
            if has_symbols(value) and _makes_arrays(name):
                if args:
                    kwargs["dtype"] = args[0]
                copies = kwargs.get("copy", copy)
                return as_array(value, kwargs.get("dtype"), copy=copies, ndmin=kwargs.get("ndmin", 0))
            made = original(value, *args, **kwargs)
            if copy and _ours(name) and made.dtype == FLOAT and made.size <= 4096:
                return as_symbols(made)
            return made

        return convert

    def full(shape: Any, fill_value: Any, dtype: Any = None, **kwargs: Any) -> Any:
        if not _ours("full"):
            return np_full(shape, fill_value, dtype, **kwargs)
        if not has_symbols(fill_value):
            made = np_full(shape, fill_value, dtype, **kwargs)
            return as_symbols(made) if made.dtype == FLOAT else made
        base, kind = elements_of(fill_value)
        wanted = kind if dtype is None else np.dtype(dtype)
        return Array(np.broadcast_to(cast_elements(base, kind, wanted), shape).copy(), wanted)

    np_full = np.full
    return {
        **{n: maker(n) for n in _OF_SHAPES + _OF_ARRAYS},
        "full": full,
        "r_": _Joined(np.r_, np.concatenate),
        "c_": _Joined(np.c_, np.column_stack),
        "array": converter("array", copy=True),
        **{n: converter(n, copy=False) for n in ("asarray", "asanyarray", "ascontiguousarray")},
    }


#: Functions to which numpy does not give the word where they get a list.
_OF_LISTS = {
    np: (
        "sum",
        "prod",
        "mean",
        "min",
        "max",
        "any",
        "all",
        "std",
        "var",
        "median",
        "cumsum",
        "sort",
        "argmax",
        "argmin",
    ),
    np.linalg: ("norm",),
}


def _of_list(original: Callable[..., Any]) -> Callable[..., Any]:
    """A function that takes a list with symbols for an array."""

    def call(value: Any, *args: Any, **kwargs: Any) -> Any:
        if isinstance(value, list | tuple) and getattr(_thread, "tracing", False) and has_symbols(value):
            value = as_array(value)
        return original(value, *args, **kwargs)

    return call


class _Joined:
    """np.r_ and np.c_ of symbols."""

    def __init__(self, original: Any, join: Callable[..., Any]) -> None:
        self.original, self.join = original, join

    def __getitem__(self, key: Any) -> Any:
        parts = key if isinstance(key, tuple) else (key,)
        if not has_symbols(parts) or any(isinstance(k, slice | str) for k in parts):
            return self.original[key]
        return self.join([np.atleast_1d(as_array(k)) for k in parts])


def _makes_arrays(name: str) -> bool:
    """Whether Python code, the author's or the tracer's, calls np.<name> itself."""
    frame = sys._getframe(2)
    return _called(frame.f_code, frame.f_lasti) == name or _ours(name, 3)


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
        replaced = [(np, name, function) for name, function in _replacements().items()]
        replaced += [(m, name, _of_list(getattr(m, name))) for m, names in _OF_LISTS.items() for name in names]
        before = [(module, name, getattr(module, name)) for module, name, _ in replaced]
        _thread.tracing = True
        refused.clear()
        forget_tables()
        for module, name, function in replaced:
            setattr(module, name, function)
        try:
            with as_written():
                yield
            if refused:  # the author's code has caught it
                raise refused[0]
        except TraceError as error:
            text = str(error)
            raise TraceError(text if text.startswith(f"{model}: ") else f"{model}: {text}") from error
        except Exception as error:  # whatever the author's code raises
            if refused:
                raise TraceError(f"{model}: {refused[0]}") from error
            said = " ".join(str(error).split()) or type(error).__name__
            raise TraceError(
                f"{model}: {place_of(error)}{said}, while tracing; if it runs with numbers, write it with what "
                "the page 'numpy that can be traced' lists"
            ) from error
        finally:
            for module, name, original in before:
                setattr(module, name, original)
            _thread.tracing = False


def argument(symbols: Any) -> Array:
    """A flat argument, which can't be written."""
    base = np.empty(symbols.numel(), dtype=object)
    for i, symbol in enumerate(ca.vertsplit(symbols)):
        base[i] = Scalar(symbol)
    base.flags.writeable = False
    return Array(base, FLOAT)


def column(value: Any, what: str, length: int) -> Any:
    """What a function returns as a column of expressions (length, 1).

    Raises
    ------
    TraceError
        It has another shape.
    """
    try:
        base, _ = elements_of(value)
    except TraceError as error:
        raise TraceError(f"{what} returns something other than an array of numbers: {type(value).__name__}") from error
    if base.ndim > 1 or (base.ndim == 0 and length != 1):
        raise TraceError(
            f"{what} returns an array of shape {base.shape}; ({length},) is declared, so flatten it by np.ravel"
        )
    if base.size != length:
        raise TraceError(f"{what} returns {base.size} values, {length} are declared")
    return ca.vertcat(*(e.sx for e in base.flat)) if length else ca.SX(0, 1)
