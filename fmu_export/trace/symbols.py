"""The context in which the author's functions run with symbols, and how arguments go in and results come out."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from fmu_export.errors import TraceError, needs
from fmu_export.trace import array_functions, ufuncs  # noqa: F401  # they give arrays their operators
from fmu_export.trace.arrays import (
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
from fmu_export.trace.expressions import as_written
from fmu_export.trace.refusal import place_of, refused

with needs("export"):
    import casadi as ca

# Arrays that are made while tracing can hold symbols

_thread = threading.local()


def _ours() -> bool:
    """Whether the author's code of this thread calls, while it is traced."""
    if not getattr(_thread, "tracing", False):
        return False
    module = sys._getframe(2).f_globals.get("__name__", "")
    return module.partition(".")[0] not in ("numpy", "scipy", "casadi") and not module.startswith("fmu_export.trace")


def _replacements() -> dict[str, Callable[..., Any]]:
    def maker(original: Callable[..., Any]) -> Callable[..., Any]:
        def make(*args: Any, **kwargs: Any) -> Any:
            made = original(*(plain(a) if type(a) in (Array, Scalar) else a for a in args), **kwargs)
            if original is np_empty and made.dtype == FLOAT:
                made.fill(np.nan)
            return as_symbols(made) if _ours() and made.dtype == FLOAT and made.size <= 4096 else made

        return make

    def converter(original: Callable[..., Any], copy: bool) -> Callable[..., Any]:
        def convert(value: Any, *args: Any, **kwargs: Any) -> Any:
            if not getattr(_thread, "tracing", False):
                return original(value, *args, **kwargs)
            if type(value) is Selection:
                return value
            if has_symbols(value):
                if args:
                    kwargs["dtype"] = args[0]
                return as_array(value, kwargs.get("dtype"), copy=copy, ndmin=kwargs.get("ndmin", 0))
            made = original(value, *args, **kwargs)
            if copy and _ours() and made.dtype == FLOAT and made.size <= 4096:
                return as_symbols(made)
            return made

        return convert

    def full(shape: Any, fill_value: Any, dtype: Any = None, **kwargs: Any) -> Any:
        if not getattr(_thread, "tracing", False) or not has_symbols(fill_value):
            made = np_full(shape, fill_value, dtype, **kwargs)
            return as_symbols(made) if _ours() and made.dtype == FLOAT else made
        base, kind = elements_of(fill_value)
        wanted = kind if dtype is None else np.dtype(dtype)
        return Array(np.broadcast_to(cast_elements(base, kind, wanted), shape).copy(), wanted)

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
        refused.clear()
        for name, function in replaced.items():
            setattr(np, name, function)
        try:
            with as_written():
                yield
            if refused:  # the author's code has caught it
                raise refused[0]
        except TraceError as error:
            text = str(error)
            raise TraceError(text if text.startswith(f"{model}: ") else f"{model}: {text}") from error
        except (TypeError, ValueError, IndexError, AttributeError, NotImplementedError) as error:
            if refused:
                raise TraceError(f"{model}: {refused[0]}") from error
            raise TraceError(f"{model}: {place_of(error)}{error}") from error
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
    base, _ = elements_of(value)
    if base.ndim > 1 or (base.ndim == 0 and length != 1):
        raise TraceError(
            f"{what} returns an array of shape {base.shape}; ({length},) is declared, so flatten it by np.ravel"
        )
    if base.size != length:
        raise TraceError(f"{what} returns {base.size} values, {length} are declared")
    return ca.vertcat(*(e.sx for e in base.flat)) if length else ca.SX(0, 1)
