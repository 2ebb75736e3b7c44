"""Results of a run in memory, to files and from files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.results.columns import TypedColumn
from cosim.results.csv_reading import read_csv
from cosim.results.formats import CSV_WITH_UNITS, FORMATS, Contents, record_batch, save, schema, with_endings
from cosim.results.recorded import Recorded

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(repr=False)
class Results(Recorded):
    """Records of a run.

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
        Name -> `TypedColumn` of what is not a real number; `results[name]` gives these values.

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
        """Scalar name -> type of what is not a real number; see `TypedColumn`."""
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

    def _table(self) -> Contents:
        return Contents(self.time, self.names, self.values, self.units, self.typed)

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

    def to_csv(self, path: str | PathLike[str], *, units_row: bool = False) -> None:
        """Write one header line with quoted names, then a line a communication point; floats round-trip.

        Parameters
        ----------
        path : path
        units_row : bool
            Whether a second line has the units, as far as they are known.

        Raises
        ------
        OSError
            The file can't be written; an unfinished one is left behind under the name `<path>.part`.
        """
        save(self._table(), path, CSV_WITH_UNITS if units_row else FORMATS["csv"])

    @classmethod
    def from_csv(cls, path: str | PathLike[str]) -> Results:
        """Read a file that `to_csv` wrote, or any CSV whose first column is the time.

        Columns are separated by comma, semicolon or tab; the decimal sign is point or comma. Units may stand in the
        names, as `x [m]`, or in a row below them; arrays have spaces between their elements.

        Raises
        ------
        ResultsError
            The file is missing, not such a table, or could mean two things; the message names the line.
        """
        return cls._of(read_csv(path))

    @classmethod
    def read(cls, path: str | PathLike[str]) -> Results:
        """Read a file that `save` wrote, or a table of another tool: CSV, Parquet, MAT, NumPy's .npz, JSON.

        The ending of the name says the format. A column, `time` in any case or `t`, has the time in s; in CSV it is the
        first one. Units that the file names are in `units`.

        Raises
        ------
        ResultsError
            The file is missing, no such table, or could mean two things; the message names the line.
        MissingExtra
            It is a MAT file of version 5 or later, and SciPy is not installed.
        """
        from cosim.results.reading import read_table  # with all formats

        return cls._of(read_table(path))

    @classmethod
    def _of(cls, table: Contents) -> Results:
        info = {"units": dict(table.units)} if table.units else {}
        return cls(table.time, list(table.names), table.values, info, table.typed)
