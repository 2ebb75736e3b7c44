"""The live page of a sweep: rows of runs as they come, and how far it is."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

import numpy as np

from cosim.live.process import PageProcess
from cosim.sweep.batch import Rows
from cosim.sweep.page.page import every_shown, shown, sweep_page
from cosim.sweep.points import Points

#: Progress is told at most so often (s).
_PAUSE = 0.5

#: Rows in a message at most.
_MOST_ROWS = 2000


class SweepView:
    """A page on the loopback that shows a sweep as it goes on; a context around it.

    Parameters
    ----------
    title : str
    points : Points
    metrics : sequence of str
        Columns of rows that hold numbers.
    open_page : callable
        Shows a page at an address; whether there is something that does.

    Raises
    ------
    MissingExtra
        The server is not installed.
    """

    def __init__(
        self, title: str, points: Points, metrics: Sequence[str], open_page: Callable[[str], bool] | None = None
    ) -> None:
        self._points, self._metrics = points, list(metrics)
        self._every = every_shown(len(points), len(points.names) + len(metrics))
        page = sweep_page(title, len(points), points.names, self._metrics)
        self.process = PageProcess(page, open_page=open_page)
        self._failed = 0
        self._told = -_PAUSE
        self._state = "ended early"

    def __enter__(self) -> Self:
        """Start the process and show the page."""
        self.process.__enter__()
        self.process.tell({"state": "running"})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.tell({"state": self._state})
        self.process.__exit__(kind, error, trace)

    def observe(self, rows: Rows) -> None:
        """Show rows of runs that have ended; of many every so many."""
        self._failed += sum(error is not None for error in rows.errors)
        kept = [k for k, index in enumerate(rows.indices) if index % self._every == 0]
        for first in range(0, len(kept), _MOST_ROWS):
            part = kept[first : first + _MOST_ROWS]
            indices = [rows.indices[k] for k in part]
            columns = self._points.take(np.array(indices)) | {
                n: [rows.metrics[n][k] for k in part] for n in self._metrics
            }
            self.process.tell({"runs": shown(indices, columns, [rows.errors[k] for k in part])})

    def progress(self, done: int, workers: int) -> None:
        """Say how far the sweep is."""
        if clock.monotonic() - self._told >= _PAUSE or done == len(self._points):
            self._told = clock.monotonic()
            self.process.tell({"progress": {"done": done, "failed": self._failed, "workers": workers}})

    def ended(self, *, interrupted: bool) -> None:
        """Say how the sweep has ended."""
        self._state = "interrupted" if interrupted else "completed"
