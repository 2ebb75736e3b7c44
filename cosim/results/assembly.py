"""From the columns of a file to a table: the time, units in names, elements of arrays, types."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from cosim.errors import ResultsError
from cosim.results.columns import TypedColumn
from cosim.results.formats import TIME, Contents

#: How units of the time are written that are seconds.
_SECONDS = ("", "s", "sec", "second", "seconds")

#: Units that a column of times may have, as far as they are recognised.
TIME_UNITS = (*_SECONDS[1:], "ns", "us", "µs", "ms", "min", "h", "d")


def is_time(text: str) -> bool:
    """Whether a column of this name has the time: `time` in any case, or `t`, with or without a unit."""
    name = re.sub(r"\s*[\[(][^\[\]()]*[\])]$", "", text.strip())
    return name.lower() == TIME or name == "t"


def check_seconds(path: object, unit: str) -> None:
    """Refuse times that are not in s.

    Raises
    ------
    ResultsError
        They are not.
    """
    if unit not in _SECONDS:
        raise ResultsError(f"{path}: the time is in '{unit}'; it must be in s")


def check_once(where: object, names: Sequence[str]) -> None:
    """Refuse names of which two are equal.

    Raises
    ------
    ResultsError
        There are such.
    """
    known: set[str] = set()
    for name in names:
        if name in known:
            raise ResultsError(f"{where}: column '{name}' is there twice; give each column its own name")
        known.add(name)


def time_unit(text: str) -> str:
    """Unit in the name of the column of the time; empty where there is none."""
    found = re.search(r"[\[(]([^\[\]()]*)[\])]$", text.strip())
    return found[1].strip() if found else ""


def assembled(
    path: object,
    time: np.ndarray,
    columns: Sequence[tuple[str, np.ndarray]],
    units: Mapping[str, str] | None = None,
) -> Contents:
    """A table of columns of any type; those of arrays (n, size) become columns `name[1]`, `name[2]`, ...

    Raises
    ------
    ResultsError
        A name stands twice or is none, the times are no numbers, or a column has values of another kind than real
        numbers, whole numbers, Booleans, texts and binary values.
    """
    if np.ndim(time) != 1 or np.asarray(time).dtype.kind not in "iuf":
        raise ResultsError(f"{path}: column '{TIME}' has values that are not numbers")
    units = units or {}
    names: list[str] = []
    values: list[np.ndarray] = []
    typed: dict[str, TypedColumn] = {}
    found: dict[str, str] = {}
    for stem, array in columns:
        for name, column in _elements(stem, array):
            kind = _type(path, name, column)
            if kind is not None:
                typed[name] = TypedColumn(kind, column)
            values.append(typed[name].numbers if kind is not None else column.astype(np.float64))
            names.append(name)
            if stem in units or name in units:
                found[name] = units.get(name, units.get(stem, ""))
    check_once(path, [TIME, *names])
    table = np.column_stack(values) if values else np.empty((len(time), 0))
    return Contents(np.asarray(time, dtype=np.float64), names, table, found, typed)


def _elements(name: str, array: np.ndarray) -> list[tuple[str, np.ndarray]]:
    if array.ndim == 1:
        return [(name, array)]
    shape = array.shape[1:]
    flat = array.reshape(len(array), -1)
    places = product(*(range(1, size + 1) for size in shape))
    return [(f"{name}[{','.join(map(str, place))}]", flat[:, k]) for k, place in enumerate(places)]


def _type(path: object, name: str, column: np.ndarray) -> str | None:
    """Arrow's name of the type of a column; None for real numbers."""
    known = {"f": None, "b": "bool", "i": "int64", "u": "uint64", "U": "string", "S": "binary"}
    if column.dtype.kind in known:
        return known[column.dtype.kind]
    if column.dtype.kind == "O":
        for of, kind in ((str, "string"), (bytes, "binary")):
            if all(isinstance(value, of) for value in column.tolist()):
                return kind
    raise ResultsError(f"{path}: column '{name}' has values that are neither numbers, Booleans nor texts")
