"""Lookup tables: data over one or two variables, interpolated linearly.

In a text file a table over one variable has a line `x,y` for each point, after a line of headings or without one. A
table over two variables begins with a line of the second variable's breakpoints, after a cell that does not count; each
further line has a breakpoint of the first variable and its values.
"""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.errors import ArgumentError
from fmu_export.modelling.names import check_identifier


class Table:
    """A lookup table over one or two variables, with linear interpolation; beyond its ends it keeps their values.

    `table(x)` is `np.interp(x, table.x, table.values)`; `table(x, y)` is bilinear. Both take numbers and arrays. An
    exported FMU has the data in `resources/tables/<name>.csv`, where `write_table` replaces them without a compiler.

    Parameters
    ----------
    name : str
        An identifier, unique in a model.
    x : sequence of float
        Breakpoints (n,) of the first variable, increasing, at least two.
    y : sequence of float
        Values (n,); for two variables the breakpoints (m,) of the second one, increasing, at least two.
    z : sequence of sequence of float, optional
        Values (n, m) of a table over two variables.

    Attributes
    ----------
    breakpoints : tuple of array
        Those of each variable.
    values : array
        (n,) or (n, m).

    Raises
    ------
    ArgumentError
        The name is not an identifier, shapes do not fit, breakpoints do not increase, or a number is not finite.
    """

    def __init__(
        self, name: str, x: Sequence[float] | Any, y: Sequence[float] | Any, z: Sequence[Sequence[float]] | Any = None
    ) -> None:
        check_identifier("table", name)
        self.name = name
        try:
            arrays = [np.array(a, dtype=float) for a in ((x, y) if z is None else (x, y, z))]
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"table '{name}': its data are not arrays of numbers: {error}") from None
        *self.breakpoints, self.values = arrays
        for array in arrays:
            if not np.isfinite(array).all():
                raise ArgumentError(f"table '{name}' has a number that is not finite")
            array.flags.writeable = False
        for which, points in zip("xy", self.breakpoints, strict=False):
            if points.ndim != 1 or len(points) < 2:
                raise ArgumentError(
                    f"table '{name}': {which} has the shape {points.shape}; give at least two breakpoints"
                )
            if (wrong := np.flatnonzero(np.diff(points) <= 0.0)).size:
                raise ArgumentError(
                    f"table '{name}': {which} does not increase: {float(points[wrong[0] + 1])!r} follows "
                    f"{float(points[wrong[0]])!r}"
                )
        if self.values.shape != (shape := tuple(len(points) for points in self.breakpoints)):
            raise ArgumentError(f"table '{name}': its values have the shape {self.values.shape}; {shape} fits")

    @classmethod
    def from_file(cls, path: str | PathLike[str], name: str | None = None) -> Table:
        """A table from a text file: numbers with points, separated by commas.

        Parameters
        ----------
        path : path
        name : str, optional
            By default that of the file, without its suffix.

        Raises
        ------
        ArgumentError
            A cell is not a number, lines have different lengths, or the data are no table.
        OSError
            The file can't be read.
        """
        path = Path(path)
        return table_of_text(path.read_text(encoding="utf-8-sig"), path.stem if name is None else name, str(path))

    @property
    def n_variables(self) -> int:
        """How many variables it has, one or two."""
        return len(self.breakpoints)

    @property
    def x(self) -> np.ndarray:
        """Breakpoints (n,) of the first variable."""
        return self.breakpoints[0]

    def has_data_of(self, other: Table) -> bool:
        """Whether breakpoints and values are equal to the last bit."""
        mine, others = (*self.breakpoints, self.values), (*other.breakpoints, other.values)
        return len(mine) == len(others) and all(a.tobytes() == b.tobytes() for a, b in zip(mine, others, strict=True))

    def __call__(self, *where: Any) -> Any:
        """The value at one place or at many: numbers or arrays, one for each variable."""
        if len(where) != self.n_variables:
            raise ArgumentError(f"table '{self.name}' is called with {len(where)} values; it has {self.n_variables}")
        for value in where:
            if looked_up := getattr(type(value), "__look_up__", None):  # symbols of a back end
                return looked_up(self, *where)
        if self.n_variables == 1:
            return np.interp(where[0], self.x, self.values)
        corners, (s, r), _ = self._cell(*where)
        return (1.0 - s) * ((1.0 - r) * corners[0] + r * corners[1]) + s * ((1.0 - r) * corners[2] + r * corners[3])

    def slopes(self, *where: Any) -> tuple[Any, ...]:
        """Derivatives by each variable, to the right of a breakpoint; beyond the ends they are 0."""
        if self.n_variables == 1:
            (x,) = where
            i = _interval(self.x, x)
            slope = (self.values[i + 1] - self.values[i]) / (self.x[i + 1] - self.x[i])
            return (_inside(self.x, x, slope),)
        corners, (s, r), (width, height) = self._cell(*where)
        by_x = (((1.0 - r) * corners[2] + r * corners[3]) - ((1.0 - r) * corners[0] + r * corners[1])) / width
        by_y = ((1.0 - s) * (corners[1] - corners[0]) + s * (corners[3] - corners[2])) / height
        x, y = self.breakpoints
        nan = 0.0 * (where[0] + where[1])
        return _inside(x, where[0], by_x) + nan, _inside(y, where[1], by_y) + nan

    def _cell(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Values at the corners of the cell of a place, where in it the place is, and its sizes."""
        xs, ys = self.breakpoints
        i, j = _interval(xs, x), _interval(ys, y)
        sizes = xs[i + 1] - xs[i], ys[j + 1] - ys[j]
        within = (np.clip(x, xs[0], xs[-1]) - xs[i]) / sizes[0], (np.clip(y, ys[0], ys[-1]) - ys[j]) / sizes[1]
        corners = [self.values[i + k, j + m] for k in (0, 1) for m in (0, 1)]
        return corners, within, sizes

    @property
    def text(self) -> str:
        """The data as a text file has them."""
        if self.n_variables == 1:
            rows = [["x", "y"], *zip(self.x.tolist(), self.values.tolist(), strict=True)]
        else:
            rows = [["x\\y", *self.breakpoints[1].tolist()]]
            rows += [[x, *row] for x, row in zip(self.x.tolist(), self.values.tolist(), strict=True)]
        return "".join(",".join(map(str, row)) + "\n" for row in rows)


def _interval(points: np.ndarray, where: Any) -> Any:
    """Index of the interval in which a place is: the first one before all breakpoints, the last one after all."""
    return np.clip(np.searchsorted(points, where, side="right") - 1, 0, len(points) - 2)


def _inside(points: np.ndarray, where: Any, slope: Any) -> Any:
    """A slope within the breakpoints, 0 beyond them, NaN at NaN."""
    return np.where((points[0] <= where) & (where < points[-1]), slope, 0.0 * (where - where))


def table_of_text(text: str, name: str, path: str) -> Table:
    """A table from the text of a file; messages have its path."""
    return Table(name, *_data(text, path))


def _data(text: str, path: str) -> tuple[Any, ...]:
    """Arguments of a table: x and y, or x, y and z."""
    rows: list[list[float | str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        cells: list[float | str] = []
        for cell in line.split(","):
            try:
                cells.append(float(cell))
            except ValueError:
                if rows or (cells and len(line.split(",")) > 2):
                    raise ArgumentError(f"{path}, line {number}: '{cell.strip()}' is not a number") from None
                cells.append(cell)
        if rows and len(cells) != len(rows[0]):
            raise ArgumentError(f"{path}, line {number} has {len(cells)} cells; the first line has {len(rows[0])}")
        rows.append(cells)
    if not rows or len(rows[0]) < 2:
        raise ArgumentError(f"{path} is not a table: separate numbers by commas, at least two in a line")
    if len(rows[0]) > 2:
        return [row[0] for row in rows[1:]], rows[0][1:], [row[1:] for row in rows[1:]]
    if all(isinstance(cell, str) for cell in rows[0]):
        del rows[0]
    return [row[0] for row in rows], [row[1] for row in rows]
