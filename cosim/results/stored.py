"""Results of a run that is too long for memory: written as they come, and read as far as they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.files.whole import part_of, publish
from cosim.results.columns import TypedColumn, numbers_of
from cosim.results.formats import (
    CSV_WITH_UNITS,
    FORMATS,
    TIME,
    Contents,
    format_of,
    record_batch,
    rows_in_group,
    schema,
    with_endings,
)
from cosim.results.recorded import Recorded
from cosim.results.results import Results
from cosim.results.streams import StreamWriter
from cosim.results.unfinished import open_parquet

if TYPE_CHECKING:
    import pyarrow as pa


@with_endings
class TableWriter:
    """Context that writes rows into one or more {streamed} files as they come; a sink for `Simulation.run`.

    Each file is written under the name `<path>.part`, and gets its name when all is written. When that fails, or what
    is done in the context, a file of that name stays as it was, and the one with `.part` has all rows until then:
    `Results.read` and `StoredResults` read it, also after a kill.

    Parameters
    ----------
    paths : sequence of path
        Ending in {streamed}.
    names : sequence of str
        Names of the columns after the time.
    types : mapping, optional
        Name -> type of what is not a real number; see `TypedColumn`.
    units : mapping, optional
        Name -> unit.
    units_row : bool
        Whether CSV files have the units in a second line.
    growing_in : path, optional
        Folder of the files with `.part`; that of each file by default.

    Raises
    ------
    FormatError
        An ending is another one.
    OSError
        A file can't be written.
    """

    def __init__(
        self,
        paths: Sequence[str | PathLike[str]],
        names: Sequence[str],
        types: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        *,
        units_row: bool = False,
        growing_in: str | PathLike[str] | None = None,
    ) -> None:
        self._names, self._types = list(names), dict(types or {})
        self._schema = schema(names, units, self._types)
        formats = {path: format_of(path, streamed=True) for path in map(Path, paths)}
        self._streams = {
            path: CSV_WITH_UNITS.stream if units_row and known is FORMATS["csv"] else known.stream
            for path, known in formats.items()
        }
        self._parts = {path: part_of(path if growing_in is None else Path(growing_in) / path.name) for path in formats}
        self._writers: list[StreamWriter] = []
        self._group = rows_in_group(len(names))
        self._waiting: list[pa.RecordBatch] = []
        self._rows = 0  # of those
        self._failed = False  # to write

    def __enter__(self) -> TableWriter:
        try:
            for path, stream in self._streams.items():
                assert stream is not None
                self._writers.append(stream(self._parts[path], self._schema))
        except BaseException:
            self._abandon()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._failed:
            self._abandon()
            return
        try:
            if self._rows:
                self._write(self._rows)
            for writer in self._writers:
                writer.close()
        except OSError:
            self._abandon()
            if kind is None:
                raise
            return
        if kind is None:
            for path, part in self._parts.items():
                publish(part, path)

    def _abandon(self) -> None:
        for writer in self._writers:
            writer.abandon()

    def __call__(self, times: np.ndarray, values: np.ndarray) -> None:
        """Append rows."""
        typed = {n: TypedColumn(kind, values[:, self._names.index(n)]) for n, kind in self._types.items()}
        if typed:
            values = numbers_of(values, self._names, typed)
        self.write(record_batch(Contents(times.copy(), self._names, values, typed=typed), self._schema))

    def write(self, batch: pa.RecordBatch) -> None:
        """Append a batch of rows."""
        self._waiting.append(batch)
        self._rows += batch.num_rows
        if self._rows >= self._group:
            self._write(self._group)

    def _write(self, size: int) -> None:
        """Write what waits in groups of so many rows; what is less waits on."""
        import pyarrow as pa

        whole = pa.Table.from_batches(self._waiting).combine_chunks()
        written = whole.num_rows - whole.num_rows % size
        self._failed = True  # unless all goes well
        for first in range(0, written, size):
            for batch in whole.slice(first, size).to_batches():
                for writer in self._writers:
                    writer.write(batch)
        self._failed = False
        self._rows, self._waiting = whole.num_rows - written, whole.slice(written).to_batches()


class StoredResults(Recorded):
    """Results in a Parquet file, of which only the columns that are asked for are read.

    Parameters
    ----------
    path : path
        File that `TableWriter` or `Results.save` wrote, or has not finished (`.part`).
    info : mapping
        How the run was made.

    Attributes
    ----------
    time : array (n,)
        Recorded communication points (s).
    names : list of str
        Scalar names `component.variable`.
    info : dict
        As of `Results`.
    """

    def __init__(self, path: str | PathLike[str], info: Mapping[str, Any]) -> None:
        self._file = open_parquet(Path(path))
        self.names = self._file.schema_arrow.names[1:]
        self._types = {f.name: str(f.type) for f in self._file.schema_arrow if str(f.type) != "double"}
        self.info = dict(info)
        self.time = self._column(TIME)

    @property
    def types(self) -> dict[str, str]:
        """Scalar name -> type of what is not a real number; see `TypedColumn`."""
        return dict(self._types)

    def _column(self, name: str, every: int = 1) -> np.ndarray:
        parts, rows = [], 0
        for i in range(self._file.num_row_groups):
            part = self._file.read_row_group(i, columns=[name]).column(0).to_numpy()
            parts.append(part[-rows % every :: every].copy())
            rows += len(part)
        return np.concatenate(parts) if parts else np.empty(0)

    def _values(self, positions: int | list[int], every: int = 1) -> np.ndarray:
        if isinstance(positions, int):
            return self._column(self.names[positions], every)
        columns = [self._column(self.names[i], every) for i in positions]
        return np.column_stack(columns) if columns else np.empty((len(self.time[::every]), 0))

    def _batches(self) -> Iterator[pa.RecordBatch]:
        yield from self._file.iter_batches()

    def _row(self, position: int) -> list[Any]:
        group = 0 if position == 0 else self._file.num_row_groups - 1
        table = self._file.read_row_group(group)
        return [table.column(name)[position].as_py() for name in self.names]

    def thinned(self, every: int) -> Results:
        """Every so many-th row, in memory."""
        typed = {name: TypedColumn(kind, self._column(name, every)) for name, kind in self._types.items()}
        columns = [typed[n].numbers if n in typed else self._column(n, every) for n in self.names]
        time = self.time[::every]
        values = np.column_stack(columns) if columns else np.empty((len(time), 0))
        return Results(time, list(self.names), values, self.info, typed)

    @with_endings
    def save(self, path: str | PathLike[str]) -> None:
        """Write a file whose ending says how: {endings}; all but {streamed} by way of the memory.

        Raises
        ------
        FormatError
            The ending is another one.
        OSError
            The file can't be written; an unfinished one is left behind under the name `<path>.part`.
        """
        target = Path(path)
        if format_of(target).stream is None:
            self.thinned(1).save(target)
            return
        with TableWriter([target], self.names, self._types) as writer:
            for batch in self._batches():
                writer.write(batch)
