"""What a long build is doing, on a line of the terminal."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import TextIO


class Progress:
    """A line on a terminal with the present stage of a build and the seconds so far, once it takes long.

    Parameters
    ----------
    what : str
        What is built.
    after : float, optional
        Seconds without a line.
    stream : text stream, optional
        Where the line goes, by default the standard error; one that is no terminal gets none.
    """

    def __init__(self, what: str, after: float = 5.0, stream: TextIO | None = None) -> None:
        self.what, self.after = what, after
        self.stage = ""
        self._stream = stream or sys.stderr
        self._done = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Progress:
        if self._stream is not None and self._stream.isatty():
            self._thread = threading.Thread(target=self._show, daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._done.set()
        if self._thread is not None:
            self._thread.join()

    def _show(self) -> None:
        began, wait, width = time.monotonic(), self.after, 0
        while not self._done.wait(wait):
            line = f"{self.what}: {self.stage}, {time.monotonic() - began:.0f} s"
            self._stream.write("\r" + line.ljust(width))
            self._stream.flush()
            wait, width = 1.0, len(line)
        if width:
            self._stream.write("\r" + " " * width + "\r")
            self._stream.flush()
