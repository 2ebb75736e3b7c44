"""The run's side of the live view: rows to the page, and commands from it."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, Self

import numpy as np

from cosim.live.page import live_page
from cosim.live.process import PageProcess
from cosim.master.steering import Steering

#: Rows of a chunk that are shown at most; a fast run has more than a page can draw.
_MOST_ROWS = 200


class LiveView:
    """A page on the loopback that shows a run and steers it; a context around the run.

    Parameters
    ----------
    title : str
    names : sequence of str
        Columns of the values that the run hands out.
    types : mapping
        Name -> type of columns that are no real numbers; texts are not shown.
    units : mapping
        Name -> unit.
    settable : mapping
        What can be set; see `Simulation.settable`.
    start_time, stop_time : float
        In s.
    open_page : callable
        Shows a page at an address; whether there is something that does.
    patience : float
        So long (s) a run waits for the page that was opened before it begins.

    Attributes
    ----------
    process : PageProcess
        That serves the page.
    steering : Steering
        Of the run.

    Raises
    ------
    MissingExtra
        The server is not installed.
    """

    def __init__(
        self,
        title: str,
        names: Sequence[str],
        types: Mapping[str, str],
        units: Mapping[str, str],
        settable: Mapping[str, Mapping[str, Any]],
        start_time: float,
        stop_time: float,
        *,
        open_page: Callable[[str], bool] | None = None,
        patience: float = 10.0,
    ) -> None:
        self._shown = [i for i, name in enumerate(names) if types.get(name) not in ("string", "binary")]
        shown = [names[i] for i in self._shown]
        self._n_columns = len(names)
        page = live_page(title, shown, units, settable, start_time, stop_time)
        self.process = PageProcess(page, self._heard, open_page, patience)
        self.steering = Steering(told=self._say)
        self._stopped = False
        self._rows = 0

    @property
    def address(self) -> str:
        """Of the page."""
        return self.process.address

    def __enter__(self) -> Self:
        """Start the process, show the page, and wait a little for it."""
        self.process.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._tell({"state": "ended early" if kind is not None else "stopped" if self._stopped else "completed"})
        self.process.__exit__(kind, error, trace)

    def observe(self, times: np.ndarray, values: np.ndarray) -> None:
        """Show rows: times (n,) and values (n, columns); of many every so many."""
        if values.shape[1] != self._n_columns:  # an FMU has refused some of them; the results say so
            return
        every = -(-len(times) // _MOST_ROWS)
        first = -self._rows % every
        self._rows += len(times)
        if self.process.is_late:
            return
        rows = np.column_stack([times[first::every], values[first::every][:, self._shown].astype(float)])
        if len(rows):
            self._tell({"rows": base64.b64encode(np.ascontiguousarray(rows, dtype="<f8").tobytes()).decode()})

    def _say(self, command: Mapping[str, Any]) -> None:
        """What has become of a command."""
        self._stopped = self._stopped or "stop" in command
        what = ", ".join(f"{name} = {value:g}" for name, value in command.get("set", {}).items())
        if what:
            refused = f" was refused: {command['why']}" if "why" in command else ""
            self._tell({"done": f"t = {command['time']:.9g} s: {what}{refused}"})

    def _tell(self, message: Mapping[str, Any]) -> None:
        self.process.tell(message)

    def _heard(self, message: Mapping[str, Any]) -> None:
        if "connected" in message:
            self._tell({"state": "paused" if self.steering.is_paused else "running"})
        for name, value in message.get("set", {}).items():
            self.steering.set(name, value)
        if message.get("pause"):
            self.steering.pause()
            self._tell({"state": "paused"})
        if message.get("resume"):
            self.steering.resume()
            self._tell({"state": "running"})
        if message.get("stop"):
            self.steering.stop()
