"""Tables in files of any format, as they come from this project, from other tools, and from data frames."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import ResultsError
from cosim.files.kinds import no_table
from cosim.files.whole import is_part, whole_of
from cosim.results.assembly import assembled, check_seconds, is_time, time_unit
from cosim.results.csv_reading import read_csv
from cosim.results.formats import Contents
from cosim.results.headings import name_and_unit
from cosim.results.mat_reading import read_mat
from cosim.results.unfinished import open_parquet


def read_table(path: str | PathLike[str]) -> Contents:
    """Read a table whose format the ending of its name says; one with another ending is read as CSV.

    Of a CSV or Parquet file that was cut off while this project wrote it (`.part`), all that is whole is read.

    Raises
    ------
    ResultsError
        The file is missing, is no such table, or could mean two things.
    MissingExtra
        It needs a package that is not installed.
    """
    path = Path(path)
    reader = READERS.get(whole_of(path).suffix.lower())
    try:
        if not is_part(path) and (why := no_table(path)):
            raise ResultsError(why)
        return read_csv(path) if reader is None else reader(path)
    except OSError as error:
        raise ResultsError(f"{path}: can't be read: {error.strerror or error}") from error


def _with_time(path: Path, columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> Contents:
    """A table of columns one of which is the time, wherever it stands."""
    times = [name for name in columns if is_time(name)]
    if len(times) > 1:  # of `time` and `t`, the latter is another variable
        times = [name for name in times if name.lower() == "time"]
    if len(times) != 1:
        raise ResultsError(f"{path}: has {'no column' if not times else 'several columns'} 'time'; write one, in s")
    check_seconds(path, units.get(times[0], "") or time_unit(times[0]))
    # who says the units beside the names has none in them
    parts = {name: (name, "") if units else name_and_unit(name) for name in columns if name != times[0]}
    units = {known: units.get(name) or unit for name, (known, unit) in parts.items() if units.get(name) or unit}
    time = columns[times[0]]
    for name in parts:
        if len(columns[name]) != len(time):
            raise ResultsError(f"{path}: '{name}' has {len(columns[name])} values for {len(time)} times")
    return assembled(path, time, [(known, columns[name]) for name, (known, _) in parts.items()], units)


def _read_parquet(path: Path) -> Contents:
    import pyarrow as pa

    try:
        table = open_parquet(path).read()
    except pa.ArrowInvalid as error:
        raise ResultsError(f"{path}: can't be read as Parquet: {' '.join(str(error).split())}") from error
    columns, units = {}, {}
    for field, column in zip(table.schema, table.columns, strict=True):
        if field.name in columns:
            raise ResultsError(f"{path}: column '{field.name}' is there twice")
        if re.fullmatch(r"__index_level_\d+__", field.name):  # the numbers of the rows of a data frame
            continue
        columns[field.name] = _from_arrow(path, field.name, column)
        if unit := (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace"):
            units[field.name] = unit
    return _with_time(path, columns, units)


def _from_arrow(path: Path, name: str, column: Any) -> np.ndarray:
    import pyarrow as pa

    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        return _array(path, name, column.to_pylist())
    if pa.types.is_floating(kind):  # data frames write NaN as null
        return np.array(column.cast(pa.float64()).to_numpy(), dtype=np.float64)
    if column.null_count:
        raise ResultsError(f"{path}: column '{name}' has rows without a value")
    for known, wanted in (
        (pa.types.is_boolean, np.bool_),
        (pa.types.is_signed_integer, np.int64),
        (pa.types.is_unsigned_integer, np.uint64),
    ):
        if known(kind):
            return np.array(column.to_pylist(), dtype=wanted)
    return np.array([*column.to_pylist(), None], dtype=object)[:-1]


def _array(path: Path, name: str, values: Sequence[Any]) -> np.ndarray:
    """Values of one kind as an array: numbers (null is NaN), Booleans, texts, or lists of them of one size."""
    flat = list(_flat(values))
    kinds = {type(value) for value in flat if value is not None}
    try:
        if kinds <= {int, float} and (None in flat or float in kinds):
            return np.array(values, dtype=np.float64)
        if kinds <= {bool}:
            return np.array(values, dtype=bool if flat else np.float64)
        if kinds <= {int}:
            exact = np.array(values)
            large = exact.dtype.kind in "iu" and bool((exact > 2**53).any() or (exact < -(2**53)).any())
            return exact if large else exact.astype(np.float64)
        if kinds <= {str} and None not in flat:
            return np.array([*values, None], dtype=object)[:-1]
    except (ValueError, OverflowError):
        pass
    raise ResultsError(f"{path}: '{name}' has values of several kinds or sizes")


def _flat(values: Any) -> Any:
    for value in values:
        if isinstance(value, list):
            yield from _flat(value)
        else:
            yield value


def _read_npz(path: Path) -> Contents:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, zipfile.BadZipFile, EOFError) as error:
        raise ResultsError(f"{path}: can't be read as NumPy's .npz: {' '.join(str(error).split())}") from error
    units: dict[str, str] = {}
    if {"time", "names", "values"} <= arrays.keys() and arrays["names"].dtype.kind == "U":
        names = arrays.pop("names").tolist()
        table, texts = arrays.pop("values"), arrays.pop("units", np.full(len(names), ""))
        if table.shape != (len(arrays["time"]), len(names)) or len(texts) != len(names):
            raise ResultsError(f"{path}: names, units and values don't fit each other")
        units = {"time": "s", **{name: unit for name, unit in zip(names, texts.tolist(), strict=True) if unit}}
        arrays = {"time": arrays["time"]} | {n: arrays.get(n, table[:, i]) for i, n in enumerate(names)}
    whole = {n: a.astype(np.int64) if a.dtype.kind == "i" else a for n, a in arrays.items()}
    columns = {n: a.astype(np.uint64) if a.dtype.kind == "u" else a for n, a in whole.items()}
    columns = {n: a.astype(object) if a.dtype.kind == "U" else a for n, a in columns.items()}
    if without := [n for n, a in columns.items() if not a.ndim]:
        raise ResultsError(f"{path}: '{without[0]}' has no row for each time")
    return _with_time(path, columns, units)


def _read_json(path: Path) -> Contents:
    """An object of lists, a list of objects, or what `Results.save` writes."""
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise ResultsError(f"{path}: can't be read as JSON: {error}") from error
    units: dict[str, str] = {}
    if isinstance(data, dict) and data.keys() == {"units", "values"} and isinstance(data["units"], dict):
        units, data = {str(name): str(unit) for name, unit in data["units"].items()}, data["values"]
    if isinstance(data, list) and data and all(isinstance(r, dict) and r.keys() == data[0].keys() for r in data):
        data = {name: [row[name] for row in data] for name in data[0]}
    if not (isinstance(data, dict) and all(isinstance(column, list) for column in data.values())):
        raise ResultsError(f"{path}: must be an object with a list for each name, 'time' among them")
    return _with_time(path, {name: _array(path, name, column) for name, column in data.items()}, units)


#: Ending -> function that reads such a file.
READERS: dict[str, Callable[[Path], Contents]] = {
    ".csv": read_csv,
    ".parquet": _read_parquet,
    ".npz": _read_npz,
    ".mat": read_mat,
    ".json": _read_json,
}
