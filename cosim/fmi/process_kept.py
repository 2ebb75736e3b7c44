"""What belongs to the process, or its thread, and FMUs change: working folder, locale, arithmetic, standard streams.

Libraries that are compiled for speed flush small numbers to zero from the moment when they are loaded; others have
divisions by zero end the process, go to the folder of their files, or close the standard output.
"""

from __future__ import annotations

import ctypes
import locale
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

#: At least the size of C's `fenv_t` on all platforms.
_SIZE_OF_FENV = 256


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
            folder = str(Path.cwd())
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
        self._copies: dict[int, tuple[int, tuple[int, int]]] = {}
        for number in (0, 1, 2):
            with suppress(OSError):  # the user has closed it
                self._copies[number] = os.dup(number), _file(number)

    def are_again(self) -> None:
        """Have those that were closed, or lead elsewhere, be as they were."""
        for number, (copy, file) in self._copies.items():
            try:
                if _file(number) == file:
                    continue
            except OSError:
                pass
            with suppress(OSError):  # the copy is gone, too
                os.dup2(copy, number)

    def close(self) -> None:
        """Close the copies."""
        for copy, _ in self._copies.values():
            with suppress(OSError):
                os.close(copy)


def _file(number: int) -> tuple[int, int]:
    found = os.fstat(number)
    return found.st_dev, found.st_ino


class KeptProcess:
    """Keeps what the FMUs of a simulation make of the process to the time in which they are called."""

    def __init__(self) -> None:
        self._of_fmus: _Process | None = None
        self._streams: _StandardStreams | None = None

    @contextmanager
    def while_fmus_are_called(self) -> Iterator[None]:
        """Context in which folder and locale are those to which FMUs have gone; after it all is as it was before."""
        before, streams = _Process.now(), _StandardStreams()
        self._streams = streams
        if self._of_fmus is not None:
            self._of_fmus.is_again(before)
        try:
            yield
        finally:
            after = _Process.now()
            before.is_again(after)
            streams.are_again()
            streams.close()
            self._streams = None
            _mathematics().fesetenv(before.arithmetic)
            self._of_fmus = after if after != before else None

    def restore_streams(self) -> None:
        """Have standard streams that FMUs have closed be open, within the context: something may be printed."""
        if self._streams is not None:
            self._streams.are_again()
