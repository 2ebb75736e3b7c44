"""What belongs to the process, or its thread, and FMUs change: working folder, locale, arithmetic, streams, signals.

Libraries that are compiled for speed flush small numbers to zero from the moment when they are loaded; others have
divisions by zero end the process, go to the folder of their files, close the standard output, or take Ctrl-C.
"""

from __future__ import annotations

import ctypes
import locale
import os
import signal
import sys
import time as clock
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Any

#: At least the size of C's `fenv_t` on all platforms.
_SIZE_OF_FENV = 256

#: Within the context the process is looked at after this time (s).
_LOOK = 0.02

#: Signals that end a run, where a C library can be asked what they do.
_ENDING = () if sys.platform == "win32" else tuple(map(int, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)))


@cache
def _mathematics() -> Any:
    """The library of C with `fegetenv` and `fesetenv`."""
    return ctypes.CDLL("ucrtbase") if sys.platform == "win32" else ctypes.pythonapi


@dataclass(frozen=True)
class _Process:
    """What the process is like at a moment."""

    folder: str | None
    locale: str
    arithmetic: ctypes.Array[ctypes.c_char] = field(compare=False)

    @classmethod
    def now(cls) -> _Process:
        arithmetic = ctypes.create_string_buffer(_SIZE_OF_FENV)
        _mathematics().fegetenv(arithmetic)
        folder = None
        with suppress(OSError):  # it has been removed
            folder = os.getcwd()  # noqa: PTH109 - pathlib takes a while, and each run comes here
        return cls(folder, locale.setlocale(locale.LC_ALL), arithmetic)

    def is_again(self, instead_of: _Process) -> None:
        """Have folder and locale be these, where they are others."""
        if self.folder is not None and self.folder != instead_of.folder:
            with suppress(OSError):
                os.chdir(self.folder)
        if self.locale != instead_of.locale:
            with suppress(locale.Error):
                locale.setlocale(locale.LC_ALL, self.locale)


class _StandardStreams:
    """The files of standard input, output and error, as they were; a file opened later would take a closed one's place.

    They are compared by device and number, as `os.path.samestat` does.
    """

    def __init__(self) -> None:
        self._files = [(number, _file(number), _copy(number)) for number in (0, 1, 2)]

    def are_again(self) -> None:
        """Have those that were closed, or lead elsewhere, be as they were."""
        for number, file, copy in self._files:
            if copy is not None and _file(number) != file:
                with suppress(OSError):  # the copy is gone, too
                    os.dup2(copy, number)

    def close(self) -> None:
        """Close the copies."""
        for _, _, copy in self._files:
            if copy is not None:
                _close(copy)


def _file(number: int) -> tuple[int, int] | None:
    """Device and number of a file, None of one that is closed."""
    try:
        found = os.fstat(number)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _copy(number: int) -> int | None:
    try:
        return os.dup(number)
    except OSError:
        return None


def _close(number: int) -> None:
    with suppress(OSError):  # an FMU has closed it
        os.close(number)


class _EndingSignals:
    """What the signals do that end a run, as far as C knows: runtimes of some languages ignore them, or exit.

    What a program changes meanwhile, in another thread, it changes by Python, which knows of it: that stays.
    """

    def __init__(self) -> None:
        self._actions = [(number, _kind(number), _action(number)) for number in _ENDING]

    def are_again(self) -> None:
        """Have those do what they did that do something else; handlers come first, not all after them is defined."""
        for number, kind, action in self._actions:
            if _action(number)[0] != action[0] and _kind(number) == kind:
                ctypes.pythonapi.sigaction(number, action, None)


def _kind(number: int) -> Any:
    """What Python has a signal do: one thing for all handlers in Python."""
    handler = signal.getsignal(number)
    return callable if callable(handler) else handler


#: At least as large as C's `struct sigaction` on all platforms.
_SigAction = ctypes.c_void_p * 32


def _action(number: int) -> ctypes.Array[ctypes.c_void_p]:
    """What a signal does, as the C library has it."""
    action = _SigAction()
    ctypes.pythonapi.sigaction(number, None, action)
    return action


class KeptProcess:
    """Keeps what the FMUs of a simulation make of the process to the time in which they are called."""

    def __init__(self) -> None:
        self._of_fmus: _Process | None = None
        self._kept: tuple[_StandardStreams, _EndingSignals] | None = None
        self._looked = 0.0  # when (s)

    @contextmanager
    def while_fmus_are_called(self) -> Iterator[None]:
        """Context in which folder and locale are those to which FMUs have gone; after it all is as it was before."""
        before, streams, signals = _Process.now(), _StandardStreams(), _EndingSignals()
        self._kept, self._looked = (streams, signals), clock.monotonic()
        if self._of_fmus is not None:
            self._of_fmus.is_again(before)
        try:
            yield
        finally:
            after = _Process.now()
            before.is_again(after)
            streams.are_again()
            streams.close()
            signals.are_again()
            self._kept = None
            _mathematics().fesetenv(before.arithmetic)
            self._of_fmus = after if after != before else None

    def restore(self) -> None:
        """Within the context, now and then, have streams be open and signals do what they did: a user may need both."""
        if self._kept is not None and clock.monotonic() - self._looked > _LOOK:
            for each in self._kept:
                each.are_again()
            self._looked = clock.monotonic()
