"""Records of a run, in memory or in a file: values by name, for users, plots and other libraries."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.errors import ResultsError, nearest
from cosim.results.display import as_html, as_text, headline
from cosim.results.formats import TIME, schema, with_endings
from cosim.results.names import grouped, vectors

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.axes import Axes

    from cosim.results.plotting import Panel

#: More names than these fill the cell of a notebook without any values.
_MOST_IN_CELL = 4000


class Recorded(ABC):
    """Values by name; the common part of `Results` and `StoredResults`.

    It is an Arrow stream (`__arrow_c_stream__`): `polars.DataFrame(results)`, `pandas.DataFrame.from_arrow(results)`,
    `pyarrow.table(results)` and DuckDB's `select ... from results` take it as it is.

    Attributes
    ----------
    time : array (n,)
        Recorded communication points (s).
    names : list of str
        Scalar names `component.variable`.
    info : dict
        How the run was made: step, order, FMUs and their SHA-256, parameters, status, times.
    """

    time: np.ndarray
    names: list[str]
    info: dict[str, Any]

    @abstractmethod
    def _values(self, positions: int | list[int], every: int = 1) -> np.ndarray:
        """One column (n,) or several (n, k), of every so many-th row."""

    @abstractmethod
    def _batches(self) -> Iterator[pa.RecordBatch]:
        """All rows, the time first."""

    @abstractmethod
    def _row(self, position: int) -> list[Any]:
        """Values of one row, as many as there are names; -1 is the last one."""

    @property
    @abstractmethod
    def types(self) -> dict[str, str]:
        """Scalar name -> type of what is not a real number; see `TypedColumn`."""

    @abstractmethod
    def thinned(self, every: int) -> Recorded:
        """Every so many-th row, in memory."""

    @abstractmethod
    @with_endings
    def save(self, path: str | PathLike[str]) -> None:
        """Write a file whose ending says how: {endings}."""

    @property
    def units(self) -> Mapping[str, str]:
        """Scalar name -> unit, as far as the FMUs say."""
        units: Mapping[str, str] = self.info.get("units", {})
        return units

    def __getitem__(self, name: str) -> np.ndarray:
        """Values of a scalar (n,) or a vector (n, size), of the type of the variable.

        Raises
        ------
        ResultsError
            Nothing of this name was recorded; the message offers the nearest name.
        """
        return self.time if name == TIME else self._values(self._find(name))

    def __contains__(self, name: str) -> bool:
        return name == TIME or name in self._positions or name in self._vectors

    @cached_property
    def _positions(self) -> dict[str, int]:
        return {name: i for i, name in reversed([*enumerate(self.names)])}

    @cached_property
    def _vectors(self) -> dict[str, list[int]]:
        return vectors(self.names)

    def _find(self, name: str) -> int | list[int]:
        """Position of a scalar in `names`, or those of the elements of a vector.

        Raises
        ------
        ResultsError
            Nothing of this name was recorded; the message offers the nearest name.
        """
        if name in self._positions:
            return self._positions[name]
        if name in self._vectors:
            return self._vectors[name]
        raise ResultsError(f"nothing was recorded as '{name}'; {nearest(name, self.names)}")

    def to_arrow(self) -> pa.Table:
        """A pyarrow table: `time`, then a column a name; the metadata of a field has its `unit` where it is known."""
        return self._reader().read_all()

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        return self._reader().__arrow_c_stream__(requested_schema)

    def _reader(self) -> pa.RecordBatchReader:
        import pyarrow as pa

        wanted = schema(self.names, self.units, self.types)
        return pa.RecordBatchReader.from_batches(wanted, (b.cast(wanted) for b in self._batches()))

    def plot(self, *names: str) -> list[Axes]:
        """Draw values over time with matplotlib, a panel for each name; `matplotlib.pyplot.show()` shows them.

        Parameters
        ----------
        *names : str
            Scalars or vectors; all that was recorded by default, but texts.

        Returns
        -------
        list of matplotlib.axes.Axes
            One for each name; `axes[0].figure.savefig("plot.png")` saves them.

        Raises
        ------
        ResultsError
            Nothing of a name was recorded, or there are too many to draw them all.
        MissingExtra
            matplotlib is not installed.
        """
        texts = [name for name, kind in self.types.items() if kind in ("string", "binary")]
        chosen = {name: self._find(name) for name in names}
        if not chosen:
            chosen = dict(self.drawable())
        for name, found in chosen.items():
            if self.names[found if isinstance(found, int) else found[0]] in texts:
                raise ResultsError(f"'{name}' is text and can't be drawn; results['{name}'] has its values")
        if not chosen:
            raise ResultsError("nothing was recorded; there is nothing to plot")

        from cosim.results.plotting import MOST_PANELS, MOST_POINTS, draw  # matplotlib takes a while to import

        if len(chosen) > MOST_PANELS:
            first = next(iter(chosen))
            raise ResultsError(
                f"{len(chosen)} variables are too many for one figure; name some, as results.plot('{first}')"
            )
        every = max(1, len(self.time) // MOST_POINTS)
        return draw(self.time[::every], self.panels(chosen, every))

    def report(self, path: str | PathLike[str], title: str = "") -> None:
        """Write a page of HTML: the system's diagram, all curves with zoom and search, what happened, how it was made.

        It is one file that needs no other and no network. Curves that are too many for it are reduced to the smallest
        and largest values of equal pieces of time, and the page says so.

        Parameters
        ----------
        path : path
        title : str
            By default that of the scenario.

        Raises
        ------
        OSError
            The file can't be written.
        """
        from cosim.results.page.run_page import write_run_page  # with the styles and scripts of the page

        write_run_page(self, Path(path), title)

    def drawable(self) -> dict[str, list[int]]:
        """Scalars and vectors that can be drawn, all but texts -> positions of their elements."""
        texts = [name for name, kind in self.types.items() if kind in ("string", "binary")]
        return {name: found for name, found in grouped(self.names).items() if self.names[found[0]] not in texts}

    def panels(self, chosen: Mapping[str, int | list[int]], every: int = 1) -> list[Panel]:
        """Values to draw of variables, whose elements are at these positions: every N-th row."""
        from cosim.results.plotting import Panel  # matplotlib takes a while to import

        panels = []
        for name, found in chosen.items():
            positions = [found] if isinstance(found, int) else found
            scalars = [self.names[i] for i in positions]
            units = {self.units.get(scalar, "") for scalar in scalars}
            labels = [scalar.removeprefix(name) for scalar in scalars]
            values = np.asarray(self._values(positions, every), dtype=np.float64)
            panels.append(Panel(name, units.pop() if len(units) == 1 else "", labels, values))
        return panels

    def _headline(self) -> str:
        return headline(type(self).__name__, self.time, len(self.names), self.info.get("status", ""))

    def __repr__(self) -> str:
        return as_text(self._headline(), self.names)

    def _repr_html_(self) -> str:
        """The page of the run, for notebooks; where that is more than a cell should have, a table."""
        from cosim.page.notebook import MOST_BYTES, frame  # with the styles and scripts of the page
        from cosim.results.page.run_page import run_page

        few = len(self.names) <= _MOST_IN_CELL
        for budget in (MOST_BYTES * part // 10 for part in (6, 3, 1)) if few else ():
            cell = frame(run_page(self, budget=budget), self._headline())
            if len(cell.encode()) <= MOST_BYTES:
                return cell
        ends = [(float(self.time[i]), self._row(i)) for i in (0, -1)] if len(self.time) else []
        return as_html(self._headline(), self.names, self.units, ends)
