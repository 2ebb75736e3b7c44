"""The formats of result files, in one table: command line, docstrings and documentation read it.

A new format is one entry of `FORMATS`, and a function that writes it. Importing this module imports neither NumPy nor
pyarrow: the command line needs the names at once.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from cosim.errors import CosimError

if TYPE_CHECKING:
    import numpy as np
    import pyarrow as pa

_Described = TypeVar("_Described", bound=Callable[..., Any])

#: Name of the first column.
TIME = "time"


class FormatError(CosimError):
    """A file name ends in no known format, or in one that can't be written as it grows."""


@dataclass(frozen=True)
class Table:
    """What a file holds: times (n,) in s, and values (n, columns) with their names and, as far as known, units."""

    time: np.ndarray
    names: Sequence[str]
    values: np.ndarray
    units: Mapping[str, str] = field(default_factory=dict)


class StreamWriter(Protocol):
    """A file that grows by batches of rows; pyarrow's writers are such."""

    def write(self, batch: pa.RecordBatch) -> None:
        """Append rows."""

    def close(self) -> None:
        """Finish the file."""


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
    """

    name: str
    use: str
    write: Callable[[Table, Path], None]
    stream: Callable[[Path, pa.Schema], StreamWriter] | None = None
    bytes_per_value: int = 8

    @property
    def ending(self) -> str:
        """Ending of the names of its files."""
        return f".{self.name}"


def schema(names: Sequence[str], units: Mapping[str, str] | None = None) -> pa.Schema:
    """Schema of a table; the metadata of a field has its unit."""
    import pyarrow as pa

    known = {TIME: "s", **units} if units else {}
    return pa.schema(
        pa.field(name, pa.float64(), metadata={"unit": known[name]} if name in known else None)
        for name in (TIME, *names)
    )


def record_batch(times: np.ndarray, values: np.ndarray, wanted: pa.Schema) -> pa.RecordBatch:
    """Rows in Arrow's columns."""
    import numpy as np
    import pyarrow as pa

    columns = [np.ascontiguousarray(times, dtype=np.float64), *np.array(values, dtype=np.float64, order="F").T]
    # pa.array would import pandas, where it is installed, which takes longer than most runs
    arrays = [pa.Array.from_buffers(pa.float64(), len(times), [None, pa.py_buffer(column)]) for column in columns]
    return pa.record_batch(arrays, schema=wanted)


def _csv_stream(path: Path, schema: pa.Schema) -> StreamWriter:
    from pyarrow import csv

    writer: StreamWriter = csv.CSVWriter(str(path), schema)  # the shortest digits that read back to the same number
    return writer


def write_csv(table: Table, path: Path) -> None:
    """Write a CSV file, whatever the ending of its name."""
    _write_stream(_csv_stream, table, path)


def _parquet_stream(path: Path, schema: pa.Schema) -> StreamWriter:
    from pyarrow import parquet

    # numbers of a simulation hardly repeat: dictionaries and compression cost more than they save
    writer: StreamWriter = parquet.ParquetWriter(str(path), schema, use_dictionary=False, compression="none")
    return writer


def _write_parquet(table: Table, path: Path) -> None:
    _write_stream(_parquet_stream, table, path)


def _write_stream(stream: Callable[[Path, Any], StreamWriter], table: Table, path: Path) -> None:
    wanted = schema(table.names, table.units)
    writer = stream(path, wanted)
    writer.write(record_batch(table.time, table.values, wanted))
    writer.close()


def _write_npz(table: Table, path: Path) -> None:
    import numpy as np

    units = np.array([table.units.get(name, "") for name in table.names], dtype=str)
    with path.open("wb") as file:
        np.savez(file, time=table.time, names=np.array(table.names, dtype=str), values=table.values, units=units)


def _write_mat(table: Table, path: Path) -> None:
    """The trajectory format of Dymola and OpenModelica (Dymola User Manual, "Matlab result files"; version 1.1)."""
    import numpy as np

    names = [TIME, *table.names]
    n = len(names)
    units = [f"[{u}]" if (u := table.units.get(name)) else "" for name in table.names]
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
            ("data_2", np.vstack([table.time, table.values.T]), _DOUBLE),
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


#: Name -> format; the first is the default.
FORMATS: dict[str, Format] = {
    known.name: known
    for known in (
        Format(
            "csv",
            "everything, and every bit of a number: `Results.from_csv`, spreadsheets",
            write_csv,
            _csv_stream,
            bytes_per_value=20,
        ),
        Format(
            "parquet",
            "data frames and long runs: pandas, Polars, DuckDB, MATLAB's `parquetread`",
            _write_parquet,
            _parquet_stream,
        ),
        Format("npz", "NumPy: `numpy.load` gives `time`, `names`, `values`, `units`", _write_npz),
        Format(
            "mat",
            "the trajectory format of Dymola and OpenModelica: their plot windows, DyMat, MATLAB's `load` "
            "(a row of `data_2` for each row of `name`)",
            _write_mat,
        ),
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


def unfinished(path: Path) -> Path:
    """Name of a file while it is being written."""
    return path.with_name(f"{path.name}.part")


def save(table: Table, path: str | PathLike[str], wanted: Format | None = None) -> None:
    """Write a table into a file, by default in the format that its ending says.

    Raises
    ------
    FormatError
        The ending is that of no format.
    OSError
        The file can't be written; an unfinished one is left behind under the name `<path>.part`.
    """
    target = Path(path)
    (wanted or format_of(target)).write(table, unfinished(target))
    unfinished(target).replace(target)


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
