"""The run's side of the live view: rows to the page, and commands from it."""

from __future__ import annotations

import base64
import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, Self

import numpy as np

from cosim.errors import needs
from cosim.live.page import live_page
from cosim.master.steering import Steering

#: Rows of a chunk that are shown at most; a fast run has more than a page can draw.
_MOST_ROWS = 200

#: Messages that may wait for the page's process; then rows are left out.
_MOST_WAITING = 100


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
    address : str
        Of the page.
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
        with needs("live"):
            import tornado  # noqa: F401 -- the page's process has it
        self._shown = [i for i, name in enumerate(names) if types.get(name) not in ("string", "binary")]
        shown = [names[i] for i in self._shown]
        self._n_columns = len(names)
        self._page = live_page(title, shown, units, settable, start_time, stop_time)
        self._open_page, self._patience = open_page, patience
        self.steering = Steering(told=self._say)
        self._stopped = False
        self._waiting: queue.Queue[str | None] = queue.Queue()
        self._connected = threading.Event()
        self._rows = 0
        self.address = ""

    def __enter__(self) -> Self:
        """Start the process, show the page, and wait a little for it."""
        command = [sys.executable, "-m", "cosim.live.server"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"page": self._page}) + "\n")
        self._process.stdin.flush()
        self.address = json.loads(self._process.stdout.readline())["address"]
        self._writer = threading.Thread(target=self._write, daemon=True)
        self._writer.start()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if self._open_page is not None and self._open_page(self.address):
            self._connected.wait(self._patience)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.tell({"state": "ended early" if kind is not None else "stopped" if self._stopped else "completed"})
        self._waiting.put(None)
        self._writer.join()
        try:
            self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def observe(self, times: np.ndarray, values: np.ndarray) -> None:
        """Show rows: times (n,) and values (n, columns); of many every so many."""
        if values.shape[1] != self._n_columns:  # an FMU has refused some of them; the results say so
            return
        every = -(-len(times) // _MOST_ROWS)
        first = -self._rows % every
        self._rows += len(times)
        if self._waiting.qsize() >= _MOST_WAITING:
            return
        rows = np.column_stack([times[first::every], values[first::every][:, self._shown].astype(float)])
        if len(rows):
            self.tell({"rows": base64.b64encode(np.ascontiguousarray(rows, dtype="<f8").tobytes()).decode()})

    def _say(self, command: Mapping[str, Any]) -> None:
        """What has become of a command."""
        self._stopped = self._stopped or "stop" in command
        what = ", ".join(f"{name} = {value:g}" for name, value in command.get("set", {}).items())
        if what:
            refused = f" was refused: {command['why']}" if "why" in command else ""
            self.tell({"done": f"t = {command['time']:.9g} s: {what}{refused}"})

    def tell(self, message: Mapping[str, Any]) -> None:
        """A message to the page."""
        self._waiting.put(json.dumps(message))

    def _write(self) -> None:
        stream = self._process.stdin
        assert stream is not None
        while (line := self._waiting.get()) is not None:
            try:
                stream.write(line + "\n")
                stream.flush()
            except (BrokenPipeError, ValueError):  # the page's process is gone; the run goes on
                return
        try:
            stream.close()
        except BrokenPipeError:
            return

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            message = json.loads(line)
            if "connected" in message:
                self._connected.set()
                self.tell({"state": "paused" if self.steering.is_paused else "running"})
            for name, value in message.get("set", {}).items():
                self.steering.set(name, value)
            if message.get("pause"):
                self.steering.pause()
                self.tell({"state": "paused"})
            if message.get("resume"):
                self.steering.resume()
                self.tell({"state": "running"})
            if message.get("stop"):
                self.steering.stop()
