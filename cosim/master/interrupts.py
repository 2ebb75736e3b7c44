"""Ctrl-C between two calls of an FMU, never inside one.

The program `cosim` takes SIGTERM and SIGHUP in the same way.

Python code that runs inside an FMU would otherwise get the KeyboardInterrupt, and the FMU's host with it a fatal error.
A component that is a function in Python is not an FMU: it gets the KeyboardInterrupt, for it may take long.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

#: Signals that end a program from outside, which `cosim` takes as Ctrl-C.
_OTHERS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


def as_ctrl_c(number: int, frame: FrameType | None) -> None:
    """Handler that does what Ctrl-C does at this moment; where that is ignored, what it usually does."""
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(number, frame)
    else:
        raise KeyboardInterrupt


def take_as_ctrl_c() -> None:
    """Have SIGTERM and SIGHUP do what Ctrl-C does, from now on, where they would end the process; for programs."""
    for number in _OTHERS:
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, as_ctrl_c)


class DeferredInterrupt:
    """Context in which the first Ctrl-C only sets `requested`.

    A second one, or one while `at_once` is set, interrupts at once.
    """

    def __init__(self) -> None:
        self.requested = self.at_once = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> DeferredInterrupt:
        # only the main thread may install handlers, and only it gets interrupts
        # and where Ctrl-C is ignored, as in background jobs, it stays so; a handler in C could not be restored
        if threading.current_thread() is threading.main_thread():
            if signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, None):
                self._previous[signal.SIGINT] = signal.signal(signal.SIGINT, self._request)
            for number in _OTHERS:
                if signal.getsignal(number) is as_ctrl_c:
                    self._previous[number] = signal.signal(number, self._request)
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
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous.clear()
