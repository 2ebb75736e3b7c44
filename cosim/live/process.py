"""The process that serves a live page, as its owner sees it: messages to the page, and messages from it."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Self

from cosim.errors import needs

#: Messages that may wait for the process before it is called late.
_MOST_WAITING = 100


class PageProcess:
    """A process that serves a page at an address of this machine; a context.

    Parameters
    ----------
    page : str
        HTML.
    heard : callable
        Gets each message of the page, and `{"connected": True}` when one is opened, in a thread of its own.
    open_page : callable, optional
        Shows a page at an address; whether there is something that does.
    patience : float
        So long (s) a page that was opened is waited for.

    Attributes
    ----------
    address : str
        Of the page.
    returncode : int or None
        Of the process, once it has ended.

    Raises
    ------
    MissingExtra
        The server is not installed.
    """

    def __init__(
        self,
        page: str,
        heard: Callable[[Mapping[str, Any]], None] = lambda message: None,
        open_page: Callable[[str], bool] | None = None,
        patience: float = 10.0,
    ) -> None:
        with needs("live"):
            import tornado  # noqa: F401 -- the process has it
        self._page, self._heard = page, heard
        self._open_page, self._patience = open_page, patience
        self._waiting: queue.Queue[str | None] = queue.Queue()
        self._connected = threading.Event()
        self.address = ""
        self.returncode: int | None = None

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
        self._waiting.put(None)
        self._writer.join()
        try:
            self.returncode = self._process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self.returncode = self._process.wait()
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()

    @property
    def is_late(self) -> bool:
        """Whether many messages wait to be sent."""
        return self._waiting.qsize() >= _MOST_WAITING

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
            except (BrokenPipeError, ValueError):  # the process is gone; what it showed goes on
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
            self._heard(message)
