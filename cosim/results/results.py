"""Results of a run in memory, to files and from CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.errors import ResultsError
from cosim.results.columns import TypedColumn
from cosim.results.formats import FORMATS, TIME, Table, record_batch, save, schema, with_endings
from cosim.results.recorded import Recorded

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(repr=False)
class Results(Recorded):
    """What a run recorded.

    It is an Arrow stream (`__arrow_c_stream__`): `polars.DataFrame(results)`, `pandas.DataFrame.from_arrow(results)`,
    `pyarrow.table(results)` and DuckDB's `select ... from results` take it as it is.

    Attributes
    ----------
    time : array (n,)
        Recorded communication points (s).
    names : list of str
        Scalar names `component.variable`.
    values : array (n, len(names))
        One column a name, as real numbers; those of texts are NaN.
    info : dict
        How the run was made: step, order, FMUs and their SHA-256, parameters, status, times, and `units`
        (scalar name -> unit).
    typed : mapping
        Name -> `TypedColumn` of what is no real number; `results[name]` gives these values.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.linspace(0.0, 1.0, 5)
    >>> names = ["motor.phi", "motor.tau[1]", "motor.tau[2]"]
    >>> results = Results(time, names, np.outer(time, [1.0, 2.0, 3.0]), {"status": "completed"})
    >>> results
    Results: 5 rows, 0 to 1 s, 3 columns, completed
      motor: phi, tau[1..2]
    >>> results["motor.phi"]
    array([0.  , 0.25, 0.5 , 0.75, 1.  ])
    >>> results["motor.tau"].shape  # whole vectors by their common name
    (5, 2)
    >>> results.to_arrow().column_names
    ['time', 'motor.phi', 'motor.tau[1]', 'motor.tau[2]']
    """

    time: np.ndarray
    names: list[str]
    values: np.ndarray
    info: dict[str, Any] = field(default_factory=dict)
    typed: Mapping[str, TypedColumn] = field(default_factory=dict)

    @property
    def types(self) -> dict[str, str]:
        """Scalar name -> type of what is no real number; see `TypedColumn`."""
        return {name: column.type for name, column in self.typed.items()}

    def _values(self, positions: int | list[int], every: int = 1) -> np.ndarray:
        wanted = [positions] if isinstance(positions, int) else positions
        typed = [self.typed[name] for name in (self.names[i] for i in wanted) if name in self.typed]
        if not typed:
            return self.values[::every, positions]
        columns = np.column_stack([column.values[::every] for column in typed])
        return columns[:, 0] if isinstance(positions, int) else columns

    def _batches(self) -> Iterator[pa.RecordBatch]:
        yield record_batch(self._table(), schema(self.names, types=self.types))

    def _row(self, position: int) -> list[Any]:
        row = self.values[position].tolist()
        return [self.typed[n].values[position] if n in self.typed else v for n, v in zip(self.names, row, strict=True)]

    def _table(self) -> Table:
        return Table(self.time, self.names, self.values, self.units, self.typed)

    def thinned(self, every: int) -> Results:
        """Every so many-th row."""
        typed = {name: column.thinned(every) for name, column in self.typed.items()}
        return Results(self.time[::every], self.names, self.values[::every], self.info, typed)

    @with_endings
    def save(self, path: str | PathLike[str]) -> None:
        """Write a file whose ending says how: {endings}.

        Raises
        ------
        FormatError
            The ending is another one.
        OSError
            The file can't be written; an unfinished one is left behind under the name `<path>.part`.
        """
        save(self._table(), path)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one header line with quoted names, then a line a communication point; floats round-trip.

        Raises
        ------
        OSError
            The file can't be written; an unfinished one is left behind under the name `<path>.part`.
        """
        save(self._table(), path, FORMATS["csv"])

    @classmethod
    def from_csv(cls, path: str | PathLike[str]) -> Results:
        """Read a file that `to_csv` wrote, or any CSV whose first column is the time.

        Raises
        ------
        ResultsError
            The file is missing or not such a table; the message names the line.
        """
        try:
            with Path(path).open(encoding="utf-8-sig", newline="") as stream:
                rows = csv.reader(stream)
                header = next(rows, None)
                if not header or header[0] != TIME:
                    raise ResultsError(f"{path}: the first column must be '{TIME}'")
                data = [_cells(path, number, row, len(header)) for number, row in enumerate(rows, start=2)]
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise ResultsError(f"{path}: can't be read as CSV: {error}") from error
        cells = list(zip(*data, strict=True)) or [()] * len(header)
        columns = [_column(path, list(of_column)) for of_column in cells]
        typed = {n: c for n, c in zip(header, columns, strict=True) if isinstance(c, TypedColumn)}
        if TIME in typed:
            raise ResultsError(f"{path}: column '{TIME}' has values that are no numbers")
        table = np.column_stack([c.numbers if isinstance(c, TypedColumn) else c for c in columns])
        return cls(time=table[:, 0], names=header[1:], values=table[:, 1:], typed=typed)


def _cells(path: str | PathLike[str], line: int, row: list[str], expected: int) -> list[str]:
    if len(row) != expected:
        raise ResultsError(f"{path}: line {line} has {len(row)} columns, the header has {expected}")
    return row


def _column(path: str | PathLike[str], cells: list[str]) -> np.ndarray | TypedColumn:
    """A column of numbers, of true and false, or of texts."""
    if cells and set(cells) <= {"true", "false"}:
        return TypedColumn("bool", np.array([cell == "true" for cell in cells]))
    try:
        return np.array([float(cell) for cell in cells])
    except ValueError as error:
        first = next(i for i, cell in enumerate(cells) if not _is_number(cell))
        if any(_is_number(cell) for cell in cells):  # a mistake in a column of numbers, rather than one of texts
            raise ResultsError(f"{path}: line {first + 2}: {error}") from None
        return TypedColumn("string", np.array(cells, dtype=object))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
