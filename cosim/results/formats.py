"""The formats of result files, in one table: command line, docstrings and documentation read it.

A new format is one entry of `FORMATS`, and a function that writes it. Importing this module imports neither NumPy nor
pyarrow: the command line needs the names at once.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cosim.errors import CosimError
from cosim.files.whole import part_of, publish
from cosim.results.streams import CsvStream, ParquetStream, StreamWriter

if TYPE_CHECKING:
    import numpy as np
    import pyarrow as pa

    from cosim.results.columns import TypedColumn

_Described = TypeVar("_Described", bound=Callable[..., Any])

#: Name of the first column.
TIME = "time"

#: Values in a group of rows of a file.
_GROUPED_VALUES = 1_000_000


class FormatError(CosimError):
    """A file name ends in no known format, or in one that can't be written as it grows."""


@dataclass(frozen=True)
class Contents:
    """Contents of a file: times (n,) in s, and values (n, columns) with their names and, as far as known, units.

    `typed` has the columns of what is not a real number, by name.
    """

    time: np.ndarray
    names: Sequence[str]
    values: np.ndarray
    units: Mapping[str, str] = field(default_factory=dict)
    typed: Mapping[str, TypedColumn] = field(default_factory=dict)

    @property
    def types(self) -> dict[str, str]:
        """Name -> type of what is not a real number."""
        return {name: column.type for name, column in self.typed.items()}


@dataclass(frozen=True)
class Format:
    """A format of result files.

    Attributes
    ----------
    name : str
        Name on the command line; files end in it.
    use : str
        What it is good for, and who reads it.
    write : callable
        `write(table, path)` writes a whole file.
    stream : callable, optional
        `stream(path, schema)` opens a file that grows, for runs that are too long for memory.
    bytes_per_value : int
        About how large a file that grows becomes.
    has_texts : bool
        Whether it has room for texts and binary values; else these are left out.
    """

    name: str
    use: str
    write: Callable[[Contents, Path], None]
    stream: Callable[[Path, pa.Schema], StreamWriter] | None = None
    bytes_per_value: int = 8
    has_texts: bool = True

    @property
    def ending(self) -> str:
        """Ending of the names of its files."""
        return f".{self.name}"


def schema(
    names: Sequence[str], units: Mapping[str, str] | None = None, types: Mapping[str, str] | None = None
) -> pa.Schema:
    """Schema of a table of real numbers and of other `types`; the metadata of a field has its unit."""
    import pyarrow as pa

    known = {TIME: "s", **(units or {})}
    types = types or {}
    return pa.schema(
        pa.field(
            name,
            pa.type_for_alias(types.get(name, "double")),
            metadata={"unit": known[name]} if name in known else None,
        )
        for name in (TIME, *names)
    )


def record_batch(table: Contents, wanted: pa.Schema) -> pa.RecordBatch:
    """Rows in Arrow's columns."""
    import numpy as np
    import pyarrow as pa

    columns = [
        np.ascontiguousarray(table.time, dtype=np.float64),
        *np.array(table.values, dtype=np.float64, order="F").T,
    ]
    # pa.array would import pandas, where it is installed, which takes longer than most runs
    arrays = [pa.Array.from_buffers(pa.float64(), len(table.time), [None, pa.py_buffer(column)]) for column in columns]
    for name, column in table.typed.items():
        position = wanted.get_field_index(name)
        arrays[position] = pa.array(column.values.tolist(), wanted.field(position).type)
    return pa.record_batch(arrays, schema=wanted)


def write_csv(table: Contents, path: Path) -> None:
    """Write a CSV file, whatever the ending of its name."""
    _write_stream(CsvStream, table, path)


def _csv_with_units(path: Path, schema: pa.Schema) -> StreamWriter:
    return CsvStream(path, schema, units_row=True)


def _write_csv_with_units(table: Contents, path: Path) -> None:
    _write_stream(_csv_with_units, table, path)


def _write_parquet(table: Contents, path: Path) -> None:
    _write_stream(ParquetStream, table, path)


def _write_stream(stream: Callable[[Path, Any], StreamWriter], table: Contents, path: Path) -> None:
    wanted = schema(table.names, table.units, table.types)
    batch, size = record_batch(table, wanted), rows_in_group(len(table.names))
    writer = stream(path, wanted)
    try:
        for first in range(0, batch.num_rows, size):
            writer.write(batch.slice(first, size))
        writer.close()
    except BaseException:
        writer.abandon()
        raise


def rows_in_group(columns: int) -> int:
    """Rows that are written at once into a file with so many columns besides the time.

    Whatever the chunks that rows come in, equal rows make equal files.
    """
    return max(1, _GROUPED_VALUES // (columns + 1))


def _write_npz(table: Contents, path: Path) -> None:
    import numpy as np

    units = np.array([table.units.get(name, "") for name in table.names], dtype=str)
    with path.open("wb") as file:
        np.savez(
            file,
            time=table.time,
            names=np.array(table.names, dtype=str),
            values=table.values,
            units=units,
            **{name: _without_objects(column) for name, column in table.typed.items()},  # type: ignore[arg-type]
        )


def _without_objects(column: TypedColumn) -> np.ndarray:
    """Values as NumPy keeps them without Python's objects; binary values with digits of base 16."""
    import numpy as np

    if not column.is_text:
        return column.values
    return np.array([v if column.type == "string" else v.hex() for v in column.values.tolist()], dtype=str)


def _write_json(table: Contents, path: Path) -> None:
    """An object of lists; binary values with digits of base 16, numbers that are not finite as null."""
    import math

    columns: dict[str, list[Any]] = {TIME: table.time.tolist()}
    for i, name in enumerate(table.names):
        column = table.typed.get(name)
        values = table.values[:, i].tolist() if column is None else column.values.tolist()
        if column is None:
            values = [v if math.isfinite(v) else None for v in values]
        columns[name] = values if column is None or column.type != "binary" else [v.hex() for v in values]
    path.write_text(json.dumps({"units": {TIME: "s", **table.units}, "values": columns}), encoding="utf-8")


def _write_mat(table: Contents, path: Path) -> None:
    """The trajectory format of Dymola and OpenModelica (Dymola User Manual, "Matlab result files"; version 1.1)."""
    import numpy as np

    kept = [i for i, name in enumerate(table.names) if name not in table.typed or not table.typed[name].is_text]
    names = [TIME, *(table.names[i] for i in kept)]
    n = len(names)
    units = [f"[{u}]" if (u := table.units.get(name)) else "" for name in names[1:]]
    ends = [table.time[0], table.time[-1]] if len(table.time) else [0.0, 0.0]
    # which data matrix, which row of it, linear interpolation, constant outside
    data_info = np.array([[0, *[2] * (n - 1)], range(1, n + 1), [0] * n, [-1] * n])
    with path.open("wb") as file:
        for name, matrix, kind in (
            ("Aclass", _characters(["Atrajectory", "1.1", "", "binTrans"]).T, _TEXT),
            ("name", _characters(names), _TEXT),
            ("description", _characters(["Time in [s]", *units]), _TEXT),
            ("dataInfo", data_info, _INTEGER),
            ("data_1", np.array([ends]), _DOUBLE),
            ("data_2", np.vstack([table.time, table.values[:, kept].T]), _DOUBLE),
        ):
            file.write(_mat_header(name, matrix.shape, kind) + matrix.astype(_MAT_TYPES[kind]).tobytes(order="F"))


#: Types of matrices in a MAT file of version 4 ("MAT-File Format", MathWorks), and how their elements are stored.
_DOUBLE, _INTEGER, _TEXT = 0, 20, 51
_MAT_TYPES = {_DOUBLE: "<f8", _INTEGER: "<i4", _TEXT: "u1"}


def _mat_header(name: str, shape: tuple[int, ...], kind: int) -> bytes:
    text = name.encode("ascii") + b"\0"
    return struct.pack("<5i", kind, *shape, 0, len(text)) + text


def _characters(texts: Sequence[str]) -> np.ndarray:
    """Bytes of the texts (width, number of texts), one a column, filled up with spaces."""
    import numpy as np

    encoded = [text.encode("utf-8") for text in texts]
    width = max(1, *(len(text) for text in encoded))
    return np.frombuffer(b"".join(text.ljust(width) for text in encoded), np.uint8).reshape(-1, width).T


#: CSV with the units in a row of their own, below the names.
CSV_WITH_UNITS = Format("csv", "CSV with a row of units", _write_csv_with_units, _csv_with_units, bytes_per_value=20)

#: Name -> format; the first is the default.
FORMATS: dict[str, Format] = {
    known.name: known
    for known in (
        Format(
            "csv",
            "everything, and every bit of a number: `Results.from_csv`, spreadsheets",
            write_csv,
            CsvStream,
            bytes_per_value=20,
        ),
        Format(
            "parquet",
            "data frames and long runs: pandas, Polars, DuckDB, MATLAB's `parquetread`",
            _write_parquet,
            ParquetStream,
        ),
        Format("npz", "NumPy: `numpy.load` gives `time`, `names`, `values`, `units`", _write_npz),
        Format(
            "mat",
            "the trajectory format of Dymola and OpenModelica: their plot windows, DyMat, MATLAB's `load` "
            "(a row of `data_2` for each row of `name`)",
            _write_mat,
            has_texts=False,
        ),
        Format("json", "web pages and scripts: `units`, and `values` with a list a name", _write_json),
    )
}


def endings(*, streamed: bool = False) -> str:
    """Endings of all formats, or of those that can be written as they grow, in words."""
    *others, last = [known.ending for known in FORMATS.values() if known.stream or not streamed]
    return f"{', '.join(others)} or {last}" if others else last


def format_of(path: Path, *, streamed: bool = False) -> Format:
    """The format of a file by the ending of its name.

    Raises
    ------
    FormatError
        The ending is that of no format, or of one that can't be written as it grows where that is wanted.
    """
    known = FORMATS.get(path.suffix.removeprefix("."))
    if known is None:
        raise FormatError(f"{path}: unknown format '{path.suffix}'; use {endings(streamed=streamed)}")
    if streamed and known.stream is None:
        raise FormatError(f"{path}: can't be written as it grows; use {endings(streamed=True)}")
    return known


def save(table: Contents, path: str | PathLike[str], wanted: Format | None = None) -> None:
    """Write a table into a file, by default in the format that its ending says; it replaces an older one when whole.

    Raises
    ------
    FormatError
        The ending is that of no format.
    OSError
        The file can't be written; an unfinished one is left behind under the name `<path>.part`.
    """
    target = Path(path)
    (wanted or format_of(target)).write(table, part_of(target))
    publish(part_of(target), target)


def with_endings(function: _Described) -> _Described:
    """Decorator: `{endings}` and `{streamed}` in a docstring become the endings of the table."""
    text = function.__doc__
    if text is not None:  # python -OO has none
        function.__doc__ = text.replace("{endings}", endings()).replace("{streamed}", endings(streamed=True))
    return function


def option_help() -> str:
    """What `--format` chooses from, for the help of a command."""
    uses = "; ".join(f"{name}: {known.use}" for name, known in FORMATS.items()).replace("`", "")
    return f"format of the results (default {next(iter(FORMATS))}); may be repeated. {uses}"


def markdown_table() -> str:
    """The formats as a table in Markdown, for the documentation."""
    rows = [f"| `{known.ending}` | {known.use} | {'yes' if known.stream else 'no'} |" for known in FORMATS.values()]
    return "\n".join(["| ending | for | written as it grows |", "|---|---|---|", *rows])
