"""The log of what FMUs say: which messages are written, and where to."""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from cosim.errors import SetupError, nearest

#: Level of a log -> the least grave message that it takes. `all` asks the FMUs besides for all that they can say.
LEVELS = {"none": 3, "error": 2, "warning": 1, "info": 0, "all": 0}

#: Severity of a message.
INFO, WARNING, ERROR = range(3)
_LEVELS_OF_LOGGING = (logging.INFO, logging.WARNING, logging.ERROR)

#: Size (bytes) of a log, after which only the last lines are kept, so many of them.
MOST_LOG_BYTES = 50_000_000
_MOST_LAST_LINES = 1000


@dataclass(frozen=True)
class Log:
    """Choice of messages of the FMUs, and the file that they are written to.

    Parameters
    ----------
    level : {"none", "error", "warning", "info", "all"}
        What is written: nothing, errors, warnings too, or everything. "all" also asks the FMUs to say all that they can
        (`fmi2SetDebugLogging`, `fmi3SetDebugLogging`).
    categories : sequence of str, optional
        Log categories of the FMUs: those that list one are asked for it, and of other messages only errors are written.
    file : path, optional
        A file, which is replaced; without one, messages go to Python's logger `cosim.messages`.

    Raises
    ------
    SetupError
        There is no such level, or nothing is to be logged of categories.
    """

    level: str = "info"
    categories: Sequence[str] = ()
    file: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        if self.level not in LEVELS:
            raise SetupError(f"log level '{self.level}': choose {', '.join(LEVELS)}")
        if isinstance(self.categories, str):
            raise SetupError(f"log categories {self.categories!r} must be a list of names: [{self.categories!r}]")
        if self.categories and self.level == "none":
            raise SetupError("log categories mean nothing at level 'none'; choose another level")

    def asked_of(self, offered: Sequence[str]) -> tuple[str, ...] | None:
        """Categories that an FMU with these ones is asked for: none for all of them; None to leave it as it is."""
        if not self.categories:
            return () if self.level == "all" else None
        return tuple(name for name in self.categories if name in offered) or None

    def check_categories(self, offered: Iterable[Sequence[str]]) -> None:
        """Whether each category is one that an FMU has; FMUs that list none may have any.

        Raises
        ------
        SetupError
            No FMU has one.
        """
        lists = list(offered)
        known = list(dict.fromkeys(name for names in lists for name in names))
        for name in self.categories if all(lists) else ():
            if name not in known:
                raise SetupError(f"no FMU has a log category '{name}'; {nearest(name, known)}")


class LogWriter:
    """The log of a simulation while it is open: lines of all components, in the order in which they came."""

    def __init__(self, log: Log) -> None:
        self.log = log
        self._least = LEVELS[log.level]
        self._categories = frozenset(log.categories)
        self._lock = threading.RLock()
        self._stream: BinaryIO | None = None
        self._size = 0
        self._last: deque[bytes] = deque(maxlen=_MOST_LAST_LINES)
        self._n_beyond = self._n_told = 0
        self._problem: str | None = None

    def open(self) -> None:
        """Begin the file.

        Raises
        ------
        SetupError
            It can't be written.
        """
        if self.log.file is None or self.log.level == "none":
            return
        try:
            self._stream = Path(self.log.file).open("wb", buffering=0)  # noqa: SIM115 (what comes before a crash is there)
        except OSError as error:
            raise SetupError(f"can't write the log {self.log.file}: {error.strerror or error}") from error
        self._size = self._n_beyond = self._n_told = 0
        self._problem = None

    @contextmanager
    def moving(self, to: Callable[[], Path]) -> Iterator[None]:
        """Context in which the file is closed and may be moved; the log goes on in the one that `to` then names."""
        was_open = self._stream is not None
        self.close()
        yield
        path = to()
        if was_open and path.is_file():
            self._stream = path.open("ab", buffering=0)

    def close(self) -> None:
        """End the file; of a log that is full the last lines come after a line that says so."""
        with self._lock:
            if self._stream is None:
                return
            if self._last:
                left_out = self._n_beyond - self._n_told - len(self._last)
                note = f"--- {left_out} messages are left out here: the log reached {MOST_LOG_BYTES} bytes ---\n"
                self._put(b"".join([note.encode(), *self._last]))
            self._last.clear()
            self._n_told = self._n_beyond
            self._stream.close()
            self._stream = None

    def takes(self, gravity: int, category: str) -> bool:
        """Whether a message is one to write."""
        return gravity >= self._least and (gravity == ERROR or not self._categories or category in self._categories)

    def heading(self, text: str) -> None:
        """Write a line that is no message."""
        if self._stream is not None:
            self._write(f"--- {text} ---\n")

    def write(self, time: float | None, component: str, gravity: int, status: str, category: str, text: str) -> None:
        """Write a message."""
        when = "outside the run" if time is None else f"t = {time:.9g} s"
        line = f"{when}: {component}: {status}: {f'[{category}] ' if category else ''}{text}"
        if self.log.file is None:
            logging.getLogger("cosim.messages").log(_LEVELS_OF_LOGGING[gravity], "%s", line)
        else:
            self._write(f"{line}\n")

    def _write(self, line: str) -> None:
        data = line.encode("utf-8", "replace")
        with self._lock:
            if self._n_beyond or self._size + len(data) > MOST_LOG_BYTES:
                self._n_beyond += 1
                self._last.append(data)
            else:
                self._size += len(data)
                self._put(data)

    def _put(self, data: bytes) -> None:
        if self._stream is None or self._problem is not None:
            return
        try:
            self._stream.write(data)
        except OSError as error:  # a run does not end because its log can't go on
            self._problem = error.strerror or str(error)

    def about(self) -> dict[str, Any]:
        """Entry of results about the log."""
        about: dict[str, Any] = {"level": self.log.level, "categories": list(self.log.categories)}
        if self.log.file is not None:
            about["file"] = str(self.log.file)
        if self._problem is not None:
            about["incomplete"] = self._problem
        elif self._n_beyond:
            about["incomplete"] = f"it reached {MOST_LOG_BYTES} bytes; its first and last lines are there"
        return about
