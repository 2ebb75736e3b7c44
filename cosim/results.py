"""Results of a run: values by name, to and from CSV."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import CosimError, nearest
from cosim.tables import TIME, Table, save, write_csv


class ResultsError(CosimError):
    """A result file can't be read, or has no variable of a name."""


@dataclass
class Results:
    """What a run recorded.

    Attributes
    ----------
    time : array (n,)
        Communication points (s).
    names : list of str
        Scalar names `component.variable`.
    values : array (n, len(names))
        One column a name.
    info : dict
        How the run was made: step, order, FMUs and their SHA-256, parameters, status, times.

    Examples
    --------
    >>> results["plant.x_E"]        # (n,)
    >>> results["plant.theta_a"]    # (n, 3): whole vectors by their common name
    """

    time: np.ndarray
    names: list[str]
    values: np.ndarray
    info: dict[str, Any] = field(default_factory=dict)

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
            return self.values[:, self.names.index(name)]
        columns = matching(name, self.names)
        if not columns:
            raise ResultsError(f"nothing was recorded as '{name}'; {nearest(name, self.names)}")
        return self.values[:, columns]

    def __contains__(self, name: str) -> bool:
        return name == TIME or name in self.names or bool(matching(name, self.names))

    def thinned(self, every: int) -> Results:
        """Every so many-th row."""
        return Results(self.time[::every], self.names, self.values[::every], self.info)

    def save(self, path: str | PathLike[str]) -> None:
        """Write a file whose ending says how: .csv, .parquet, .npz or .mat (Dymola's and OpenModelica's).

        Raises
        ------
        CosimError
            The ending is another one.
        OSError
            The file can't be written; an unfinished one is left behind under the name `<path>.part`.
        """
        save(Table(self.time, self.names, self.values), path)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one header line with quoted names, then a line a communication point; floats round-trip.

        Raises
        ------
        OSError
            The file can't be written; an unfinished one is left behind under the name `<path>.part`.
        """
        write_csv(Table(self.time, self.names, self.values), Path(path))

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
                data = [_numbers(path, number, row, len(header)) for number, row in enumerate(rows, start=2)]
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise ResultsError(f"{path}: can't be read as CSV: {error}") from error
        table = np.array(data, dtype=float).reshape(len(data), len(header))
        return cls(time=table[:, 0], names=header[1:], values=table[:, 1:])


def matching(name: str, names: Sequence[str]) -> list[int]:
    """Positions of the elements of a vector, in the order of their indices."""
    elements = re.compile(re.escape(name) + r"\[\d+(,\d+)*\]")
    columns = [i for i, n in enumerate(names) if elements.fullmatch(n)]
    return sorted(columns, key=lambda i: [int(k) for k in re.findall(r"\d+", names[i][len(name) :])])


def _numbers(path: str | PathLike[str], line: int, row: list[str], expected: int) -> list[float]:
    if len(row) != expected:
        raise ResultsError(f"{path}: line {line} has {len(row)} columns, the header has {expected}")
    try:
        return [float(cell) for cell in row]
    except ValueError as error:
        raise ResultsError(f"{path}: line {line}: {error}") from None
