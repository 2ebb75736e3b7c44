"""Ctrl-C between two calls of an FMU, never inside one.

Python code that runs inside an FMU would otherwise get the KeyboardInterrupt, and the FMU's host with it a fatal error.
A component that is a function in Python is no FMU: it gets the KeyboardInterrupt, for it may take long.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any


class DeferredInterrupt:
    """Context in which the first Ctrl-C only sets `requested`.

    A second one, or one while `at_once` is set, interrupts at once.
    """

    def __init__(self) -> None:
        self.requested = self.at_once = False
        self._previous: Any = None

    def __enter__(self) -> DeferredInterrupt:
        # only the main thread may install handlers, and only it gets interrupts
        # and where Ctrl-C is ignored, as in background jobs, it stays so; a handler in C could not be restored
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, None):
            self._previous = signal.signal(signal.SIGINT, self._request)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def _request(self, _number: int, _frame: FrameType | None) -> None:
        self.requested = True
        self._restore()
        if self.at_once:
            raise KeyboardInterrupt

    def _restore(self) -> None:
        if self._previous is not None:
            signal.signal(signal.SIGINT, self._previous)
            self._previous = None
