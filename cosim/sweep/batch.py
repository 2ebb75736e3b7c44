"""What travels between the sweep and its workers: batches of points out, rows back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cosim.sweep.factors import Value

#: What a row has under a name: a number, an array (n,) of numbers, or nothing.
Entry = float | np.ndarray | None


@dataclass(frozen=True)
class Batch:
    """Points that one task runs.

    Attributes
    ----------
    study : str
        SHA-256 of the pickled study.
    version : str
        Of this package; the worker must have the same.
    indices : list of int
        Numbers of the points in the plan.
    columns : mapping
        Factor -> its values at these points.
    """

    study: str
    version: str
    indices: list[int]
    columns: Mapping[str, Sequence[Value]]

    def points(self) -> Iterator[tuple[int, dict[str, Value]]]:
        """Number and factors of each point."""
        for k, index in enumerate(self.indices):
            yield index, {name: values[k] for name, values in self.columns.items()}

    def after(self, first: int) -> Batch:
        """The batch without its first points."""
        columns = {name: values[first:] for name, values in self.columns.items()}
        return Batch(self.study, self.version, self.indices[first:], columns)


@dataclass(frozen=True)
class Row:
    """One point's result: metrics and curves, or the text of an error."""

    index: int
    metrics: Mapping[str, Entry] | None
    error: str | None


@dataclass
class Rows:
    """Results of a batch, column by column: a third of the bytes that single rows take.

    Attributes
    ----------
    seconds : float
        What the runs took (s), without opening simulations.
    """

    indices: list[int] = field(default_factory=list)
    metrics: dict[str, list[Entry]] = field(default_factory=dict)
    errors: list[str | None] = field(default_factory=list)
    seconds: float = 0.0

    @classmethod
    def of(cls, names: Sequence[str], rows: Sequence[Row], seconds: float) -> Rows:
        """The columns of rows; metrics of failed runs are None."""
        return cls(
            [row.index for row in rows],
            {name: [None if row.metrics is None else row.metrics[name] for row in rows] for name in names},
            [row.error for row in rows],
            seconds,
        )
