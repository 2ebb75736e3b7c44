"""Results of a run that is too long for memory: a file, of which only what is asked for is read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import nearest
from cosim.results import Results, ResultsError, matching
from cosim.tables import TIME


class StoredResults:
    """Results in a Parquet file, of which only the columns that are asked for are read.

    Attributes
    ----------
    names : list of str
    info : dict
    time : array (n,)
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

    def __getitem__(self, name: str) -> np.ndarray:
        """Values of a scalar (n,) or a vector (n, size).

        Raises
        ------
        ResultsError
            Nothing of this name was recorded; the message offers the nearest name.
        """
        if name == TIME:
            return self.time
        if name in self.names:
            return self._column(name)
        found = matching(name, self.names)
        if not found:
            raise ResultsError(f"nothing was recorded as '{name}'; {nearest(name, self.names)}")
        return np.column_stack([self._column(self.names[i]) for i in found])

    def __contains__(self, name: str) -> bool:
        return name == TIME or name in self.names or bool(matching(name, self.names))

    def thinned(self, every: int) -> Results:
        """Every so many-th row, in memory."""
        columns = [self._column(name, every) for name in self.names]
        return Results(self.time[::every], list(self.names), np.column_stack(columns), self.info)
