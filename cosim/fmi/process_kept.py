"""What belongs to the process, or to its thread, and FMUs change: working folder, locale, floating-point arithmetic.

Libraries that are compiled for speed flush small numbers to zero from the moment when they are loaded; others have
divisions by zero end the process, or go to the folder of their files.
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


class KeptProcess:
    """Keeps what the FMUs of a simulation make of the process to the time in which they are called."""

    def __init__(self) -> None:
        self._of_fmus: _Process | None = None

    @contextmanager
    def while_fmus_are_called(self) -> Iterator[None]:
        """Context in which folder and locale are those to which FMUs have gone; after it all is as it was before."""
        before = _Process.now()
        if self._of_fmus is not None:
            self._of_fmus.is_again(before)
        try:
            yield
        finally:
            after = _Process.now()
            before.is_again(after)
            _mathematics().fesetenv(before.arithmetic)
            self._of_fmus = after if after != before else None
