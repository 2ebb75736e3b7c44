"""What FMUs say: counted, the first message of each kind kept, and passed on to the log as it comes.

Messages come from any thread, in any number, and also from FMUs that have been freed: they go to the component, which
outlives its instances.
"""

from __future__ import annotations

import ctypes
import itertools
import re
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any
from weakref import WeakValueDictionary

import fmpy.fmi1 as fmi1
import fmpy.fmi2 as fmi2
import fmpy.fmi3 as fmi3

from cosim.fmi.message_log import ERROR, INFO, WARNING, LogWriter
from cosim.loop.binding import TakeMessage, loop_library

#: Names of the statuses of FMI, by their numbers.
STATUSES = ("ok", "warning", "discard", "error", "fatal", "pending")

_GRAVITY = {0: INFO, 1: WARNING, 2: WARNING, 3: ERROR, 4: ERROR, 5: INFO}

#: Statuses of messages about something that failed: discard, error, fatal.
_FAILURES = (2, 3, 4)

#: Kinds of messages that are told apart, those that are shown of one that has failed, and characters kept of a message.
_MOST_KINDS, _MOST_LAST, _MOST_CHARACTERS = 20, 10, 1000

#: Callbacks of so many instances are kept when these are gone: FMUs may still call them.
_MOST_GONE = 1000

_NUMBER = re.compile(rb"0[xX][0-9a-fA-F]+|[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclass
class _Kind:
    """Messages that differ in numbers only: the first one, and how many there were."""

    time: float | None
    status: str
    category: str
    text: str
    count: int = 0


class Messages:
    """Messages of the FMU of a component, and warnings that its functions return.

    Parameters
    ----------
    component : str
    writer : LogWriter, optional
        Takes those that are to be logged.
    asked : tuple of str, optional
        Categories that the FMU is asked for: none for all that it has; None not to ask.
    """

    def __init__(self, component: str, writer: LogWriter | None = None, asked: tuple[str, ...] | None = None) -> None:
        self.component = component
        self.asked = asked
        self.writer = writer
        self._lock = threading.RLock()
        self._time_of_run: Callable[[], float | None] = _no_time
        #: Whether one of the last messages tells of something that failed.
        self.tell_of_failure = False
        self._last: dict[tuple[int, bytes, bytes], str] = {}
        self._forget()

    def _forget(self) -> None:
        self._counts = [0, 0, 0]
        self._kinds: dict[tuple[int, bytes, bytes], _Kind] = {}
        self._n_of_further_kinds = 0
        self._warned_at: float | None = None

    def begin(self) -> None:
        """Count from zero: another run begins."""
        with self._lock:
            self._forget()
            self.last()
            self._time_of_run = _no_time

    def follow(self, time: Callable[[], float | None]) -> None:
        """Let messages come at the time (s) that a function gives; None when no run goes on."""
        self._time_of_run = time

    def take(self, status: int, category: bytes | None, message: bytes | None) -> None:
        """Take a message of the FMU as it comes, from whichever thread."""
        gravity = _GRAVITY.get(status, WARNING)
        if not message and gravity == INFO:
            return
        with self._lock:
            self.tell_of_failure = self.tell_of_failure or status in _FAILURES
            self._take(gravity, _status_name(status), category or b"", message or b"(a message without text)")

    def _take(self, gravity: int, status: str, category: bytes, message: bytes) -> None:
        self._counts[gravity] += 1
        logged = self.writer is not None and self.writer.takes(gravity, _clean(category))
        if gravity == INFO and not logged:
            return
        time = self._time_of_run()
        text = _clean(message)
        if gravity != INFO:
            self._warned_at = time
            key = (gravity, category, _NUMBER.sub(b"#", message[:_MOST_CHARACTERS]))
            self._last.pop(key, None)
            self._last[key] = text
            if len(self._last) > _MOST_LAST:
                del self._last[next(iter(self._last))]
            if key not in self._kinds and len(self._kinds) < _MOST_KINDS:
                self._kinds[key] = _Kind(time, status, _clean(category), text)
            if key in self._kinds:
                self._kinds[key].count += 1
            else:
                self._n_of_further_kinds += 1
        if logged:
            assert self.writer is not None
            self.writer.write(time, self.component, gravity, status, _clean(category), text)

    def warned(self, what: str) -> None:
        """Count a call that returned a warning, unless a message at the same time says why."""
        with self._lock:
            if not self._counts[WARNING] or self._warned_at != self._time_of_run():
                self._take(WARNING, "warning", b"", f"{what} returned warning".encode())

    def last(self) -> str:
        """The last messages that were not just information, one a kind, in one line; they are then forgotten."""
        with self._lock:
            text = "; ".join(dict.fromkeys(self._last.values()))
            self._last.clear()
            self.tell_of_failure = False
        return text

    def about(self) -> dict[str, Any] | None:
        """Number of messages, and the first ones; None if there were none."""
        with self._lock:
            if not any(self._counts):
                return None
            about: dict[str, Any] = dict(zip(("info", "warnings", "errors"), self._counts, strict=True))
            about["first"] = [dict(vars(kind)) for kind in self._kinds.values()]
            if self._n_of_further_kinds:
                about["of_further_kinds"] = self._n_of_further_kinds
            return about

    # Callbacks

    def callbacks_fmi1(self) -> Any:
        """The callbacks of a new instance of FMI 1.0, which passes its address to the logger."""
        callbacks = fmi1.fmi1CallbackFunctions()
        callbacks.logger = ctypes.cast(_logger(), fmi1.fmi1CallbackLoggerTYPE)
        callbacks.allocateMemory = fmi1.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi1.defaultCallbacks.freeMemory
        return callbacks

    def of_instance_made_by(self, make: Callable[[], int | None]) -> int | None:
        """Make an instance of FMI 1.0 and take what it says; returns its address, which is not known before."""
        _making.messages = self
        try:
            component = make()
        finally:
            _making.messages = None
        if component is not None:
            _by_environment[component] = self
        return component

    def callbacks_fmi2(self) -> Any:
        """The callbacks of a new instance of FMI 2.0."""
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = ctypes.cast(_logger(), fmi2.fmi2CallbackLoggerTYPE)
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        callbacks.componentEnvironment = number = next(_numbers)
        _by_environment[number] = self
        return callbacks

    def callback_fmi3(self) -> Any:
        """The log callback of a new instance of FMI 3.0."""

        def log(_environment: Any, status: int, category: bytes | None, message: bytes | None) -> None:
            self.take(status, category, message)

        return fmi3.fmi3LogMessageCallback(log)


def keep_callbacks(*callbacks: Any) -> None:
    """Keep what an FMU may call or read even when its instance is gone; the oldest are given up."""
    _gone.append(callbacks)


def summary(messages: Iterable[Messages]) -> dict[str, Any]:
    """Entries of the results: how many warnings there were, what each component said, and what its log is."""
    every = list(messages)
    said = {each.component: about for each in every if (about := each.about()) is not None}
    entries = {"warnings": sum(about["warnings"] for about in said.values()), "messages": said}
    writer = next((each.writer for each in every if each.writer is not None), None)
    return entries if writer is None else {**entries, "log": writer.about()}


def notes(messages: dict[str, Any]) -> list[str]:
    """Lines for users about the messages in results."""
    lines = []
    for component, about in messages.items():
        counts = [_counted(about[key], key[:-1]) for key in ("warnings", "errors") if about[key]]
        if not counts:
            continue
        shown = about["first"][:_MOST_SHOWN]
        texts = [f"'{kind['text']}'{_times(kind)}" for kind in shown]
        further = len(about["first"]) - len(shown)
        more = "" if not further and "of_further_kinds" not in about else ", and other kinds"
        lines.append(f"{component}: {' and '.join(counts)} from its FMU: {', '.join(texts)}{more}")
    return lines


#: Kinds of messages of a component that a note shows.
_MOST_SHOWN = 3


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _times(kind: dict[str, Any]) -> str:
    when = "before the run" if kind["time"] is None else f"at t = {kind['time']:.9g} s"
    return f" {when}" if kind["count"] == 1 else f" ({kind['count']} times, first {when})"


def _no_time() -> None:
    return None


def _status_name(status: int) -> str:
    if _GRAVITY.get(status) == INFO:
        return "info"
    return STATUSES[status] if 0 <= status < len(STATUSES) else f"status {status}"


def _clean(text: bytes) -> str:
    """A text of an FMU in one line, without what a terminal would obey."""
    line = " ".join(text[: 4 * _MOST_CHARACTERS].decode("utf-8", "replace").split())
    if len(line) > _MOST_CHARACTERS:
        line = f"{line[:_MOST_CHARACTERS]} ..."
    return line if line.isprintable() else "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in line)


#: Messages by what FMUs pass to the logger: a number; in FMI 1.0 the address of the instance.
_by_environment: WeakValueDictionary[int, Messages] = WeakValueDictionary()
_numbers = itertools.count(1)
#: Of each thread, the messages of the instance of FMI 1.0 that is being made and has no address yet.
_making = threading.local()
_gone: deque[tuple[Any, ...]] = deque(maxlen=_MOST_GONE)


def _dispatch(
    environment: int | None, name: bytes | None, status: int, category: bytes | None, message: bytes | None
) -> None:
    messages = None if environment is None else _by_environment.get(environment)
    messages = messages or getattr(_making, "messages", None)
    if messages is None:  # an FMU that passes something else: perhaps its name is right
        named = [m for m in list(_by_environment.values()) if m.component.encode() == name]
        messages = named[0] if len(set(map(id, named))) == 1 else None
    if messages is not None:
        messages.take(status, category, message)
    elif _GRAVITY.get(status, WARNING) != INFO:
        print(f"{_clean(name or b'an FMU')}: {_status_name(status)}: {_clean(message or b'')}", file=sys.stderr)


_take_message = TakeMessage(_dispatch)


@cache
def _logger() -> Any:
    """The logger of all instances of FMI 1.0 and 2.0, in C, for it formats printf's arguments."""
    library = loop_library()
    library.log_to(_take_message)
    return library.log_message
