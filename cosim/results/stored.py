"""Results of a run that is too long for memory: a file, of which only what is asked for is read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.results.files import STREAMED, TIME, TableWriter
from cosim.results.recorded import Recorded
from cosim.results.results import Results

if TYPE_CHECKING:
    import pyarrow as pa


class StoredResults(Recorded):
    """Results in a Parquet file, of which only the columns that are asked for are read.

    Parameters
    ----------
    path : Path
        File that `TableWriter` or `Results.save` wrote.
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

    def __init__(self, path: Path, info: Mapping[str, Any]) -> None:
        from pyarrow import parquet

        self._file = parquet.ParquetFile(path)
        self.names = self._file.schema_arrow.names[1:]
        self.info = dict(info)
        self.time = self._column(TIME)

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

    def _row(self, position: int) -> np.ndarray:
        group = 0 if position == 0 else self._file.num_row_groups - 1
        table = self._file.read_row_group(group)
        return np.array([table.column(name)[position].as_py() for name in self.names])

    def thinned(self, every: int) -> Results:
        """Every so many-th row, in memory."""
        values = self._values(list(range(len(self.names))), every)
        return Results(self.time[::every], list(self.names), values, self.info)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a file whose ending says how: .csv, .parquet, .npz or .mat; the last two by way of the memory.

        Raises
        ------
        CosimError
            The ending is another one.
        OSError
            The file can't be written; an unfinished one is left behind under the name `<path>.part`.
        """
        target = Path(path)
        if target.suffix not in STREAMED:
            self.thinned(1).save(target)
            return
        with TableWriter([target], self.names) as writer:
            for batch in self._batches():
                time, *columns = (column.to_numpy() for column in batch.columns)
                writer(time, np.column_stack(columns) if columns else np.empty((len(time), 0)))
