"""Batches: points that travel to a worker together, their rows that come back, and how many points to send at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from cosim.sweep.points import Value

#: Value in a row: a number, an array (n,) of numbers, or nothing.
RowValue = float | np.ndarray | None

#: Time (s) that a batch should take: long against the few ms that Dask spends on a task, short enough for a lost worker
#: and an early end to cost little.
_BATCH_TIME = 1.5

#: Batches a second that one scheduler can be asked for at ease: with many workers they become longer.
_MOST_BATCHES = 100

#: Runs in a batch at most, for its rows to fit one message.
_MOST_RUNS = 5_000

#: Weight of the earlier batches in the mean time of a run, at each new batch.
_MEMORY = 0.7


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
    metrics: Mapping[str, RowValue] | None
    error: str | None


@dataclass
class Rows:
    """Results of a batch, column by column: a third of the bytes that single rows take.

    Attributes
    ----------
    indices : list of int
        Numbers of the points.
    metrics : dict
        Name -> a number, or a curve as an array (n,), a run; None of runs that failed.
    errors : list of str or None
        Why runs failed.
    seconds : float
        What the runs took (s), without opening simulations.
    """

    indices: list[int] = field(default_factory=list)
    metrics: dict[str, list[RowValue]] = field(default_factory=dict)
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


class BatchSize:
    """Sizes batches by what the runs before have taken: the first are single runs."""

    def __init__(self) -> None:
        self._runs = self._seconds = 0.0

    def learn(self, runs: int, seconds: float) -> None:
        """Take note of what a batch has taken (s)."""
        self._runs = _MEMORY * self._runs + runs
        self._seconds = _MEMORY * self._seconds + seconds

    def next(self, left: int, slots: int) -> int:
        """Runs of the next batch, of those that are left; towards the end smaller, for all workers to end together."""
        if not self._runs:
            return 1
        time = max(_BATCH_TIME, slots / _MOST_BATCHES)
        wanted = min(time * self._runs / self._seconds, _MOST_RUNS) if self._seconds else _MOST_RUNS
        return max(1, min(int(wanted), math.ceil(left / (2 * slots))))
