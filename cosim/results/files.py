"""Files of results: CSV, Parquet, NumPy and MATLAB archives; the first two also chunk by chunk, for long runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cosim.errors import CosimError

if TYPE_CHECKING:
    import pyarrow as pa


#: Name of the first column.
TIME = "time"


@dataclass(frozen=True)
class Table:
    """What is written: times (n,) in s, and values (n, columns) with their names and, as far as known, units."""

    time: np.ndarray
    names: Sequence[str]
    values: np.ndarray
    units: Mapping[str, str] = field(default_factory=dict)


class FormatError(CosimError):
    """A file name whose ending stands for no format."""


class _Writer(Protocol):
    """What pyarrow's writers of both formats have in common."""

    def write(self, batch: pa.RecordBatch) -> None: ...

    def close(self) -> None: ...


class TableWriter:
    """Context that writes rows into one or more CSV or Parquet files as they come; a sink for `Simulation.run`.

    Each file is written under the name `<path>.part`, and gets its name when all is written.

    Parameters
    ----------
    paths : sequence of path
        Ending in .csv or .parquet.
    names : sequence of str
        Names of the columns after the time.

    Raises
    ------
    FormatError
        An ending is another one.
    OSError
        A file can't be written.
    """

    def __init__(self, paths: Sequence[Path], names: Sequence[str]) -> None:
        self._schema = schema(names)
        self._paths = list(paths)
        for path in paths:
            if path.suffix not in STREAMED:
                raise FormatError(f"{path}: can't be written as it grows; use {' or '.join(STREAMED)}")
        self._writers: list[_Writer] = []

    def __enter__(self) -> TableWriter:
        for path in self._paths:
            self._writers.append(STREAMED[path.suffix](_part(path), self._schema))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for writer in self._writers:
            writer.close()
        for path in self._paths:  # what a failed run had recorded is as good as its last row
            _part(path).replace(path)

    def __call__(self, times: np.ndarray, values: np.ndarray) -> None:
        """Append rows."""
        batch = record_batch(times, values, self._schema)
        for writer in self._writers:
            writer.write(batch)


def _part(path: Path) -> Path:
    return path.with_name(path.name + ".part")


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
    import pyarrow as pa

    columns = [np.ascontiguousarray(times, dtype=np.float64), *np.array(values, dtype=np.float64, order="F").T]
    # pa.array would import pandas, where it is installed, which takes longer than most runs
    arrays = [pa.Array.from_buffers(pa.float64(), len(times), [None, pa.py_buffer(column)]) for column in columns]
    return pa.record_batch(arrays, schema=wanted)


def _csv_writer(path: Path, schema: pa.Schema) -> _Writer:
    from pyarrow import csv

    writer: _Writer = csv.CSVWriter(str(path), schema)  # the shortest digits that read back to the same number
    return writer


def _parquet_writer(path: Path, schema: pa.Schema) -> _Writer:
    from pyarrow import parquet

    # numbers of a simulation hardly repeat: dictionaries and compression cost more than they save
    writer: _Writer = parquet.ParquetWriter(str(path), schema, use_dictionary=False, compression="none")
    return writer


#: Formats that are written as they grow.
STREAMED: dict[str, Callable[[Path, Any], _Writer]] = {".csv": _csv_writer, ".parquet": _parquet_writer}


def write_csv(table: Table, path: Path) -> None:
    """Write a CSV file, whatever the ending of its name.

    Raises
    ------
    OSError
        The file can't be written; an unfinished one is left behind under the name `<path>.part`.
    """
    _write_whole(table, path, _csv_writer)


def _write_parquet(table: Table, path: Path) -> None:
    _write_whole(table, path, _parquet_writer)


def _write_whole(table: Table, path: Path, open_writer: Callable[[Path, Any], _Writer]) -> None:
    wanted = schema(table.names, table.units)
    writer = open_writer(_part(path), wanted)
    writer.write(record_batch(table.time, table.values, wanted))
    writer.close()
    _part(path).replace(path)


def _write_npz(table: Table, path: Path) -> None:
    part = _part(path)
    with part.open("wb") as stream:
        units = np.array([table.units.get(name, "") for name in table.names], dtype=str)
        np.savez(stream, time=table.time, names=np.array(table.names, dtype=str), values=table.values, units=units)
    part.replace(path)


def _write_mat(table: Table, path: Path) -> None:
    """The trajectory format of Dymola and OpenModelica (Dymola User Manual, "Matlab result files"; version 1.1)."""
    from scipy.io import savemat

    names = [TIME, *table.names]
    n = len(names)
    trajectory = {
        "Aclass": np.array(["Atrajectory", "1.1", "", "binTrans"]),
        "name": _characters(names),
        "description": _characters(
            ["Time in [s]", *(f"[{u}]" if (u := table.units.get(v)) else "" for v in table.names)]
        ),
        # which data matrix, which row of it, linear interpolation, constant outside
        "dataInfo": np.array([[0, *[2] * (n - 1)], range(1, n + 1), [0] * n, [-1] * n], dtype=np.int32),
        "data_1": np.array([[table.time[0], table.time[-1]]] if len(table.time) else np.zeros((1, 2))),
        "data_2": np.vstack([table.time, table.values.T]),
    }
    part = _part(path)
    savemat(part, trajectory, format="4", appendmat=False)
    part.replace(path)


def _characters(texts: Sequence[str]) -> np.ndarray:
    """One text a column, as "binTrans" wants them."""
    width = max(1, *(len(t) for t in texts))
    return np.ascontiguousarray(np.array([list(t.ljust(width)) for t in texts]).T)


_WRITERS: dict[str, Callable[[Table, Path], None]] = {
    ".csv": write_csv,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
    ".mat": _write_mat,
}


def save(table: Table, path: str | PathLike[str]) -> None:
    """Write a table into a file whose ending says how: .csv, .parquet, .npz or .mat.

    Raises
    ------
    FormatError
        The ending is another one.
    OSError
        The file can't be written; an unfinished one is left behind under the name `<path>.part`.
    """
    target = Path(path)
    if target.suffix not in _WRITERS:
        raise FormatError(f"{target}: unknown format '{target.suffix}'; use {', '.join(_WRITERS)}")
    _WRITERS[target.suffix](table, target)
