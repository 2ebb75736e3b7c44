"""The channel to an FMU in another process as Python sees it; see channel.h."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import c_bool, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint32, c_uint64, c_void_p
from functools import cache
from mmap import mmap
from typing import Any

from cosim.loop.binding import loop_library

#: Statuses beyond those of FMI and of the loop: the worker is gone, a call that was deferred has failed, the arguments
#: are too large.
LOST, FAILED_BEFORE, TOO_LARGE = 110, 111, 112

#: Number of what a worker is asked for first: to load its FMU (as in channel.h).
ASKED_TO_LOAD = 1

#: Called while a call takes long, with its seconds so far; whether the worker is to be given up.
GivesUp = ctypes.CFUNCTYPE(c_int, c_double)

#: Takes a message: status, category, text.
Takes = ctypes.CFUNCTYPE(None, c_int, c_char_p, c_char_p)

#: Told of a deferred call that returned a warning: the number of its function.
WarnedOf = ctypes.CFUNCTYPE(None, c_int)

#: Arguments of the functions that make an instance: not those of FMI, for callbacks are the worker's own.
_MAKING = {
    "fmi1InstantiateSlave": (c_void_p, c_char_p, c_char_p, c_char_p, c_char_p),
    "fmi2Instantiate": (c_void_p, c_char_p, c_int, c_char_p, c_char_p),
    "fmi3InstantiateCoSimulation": (
        *(c_void_p, c_char_p, c_char_p, c_char_p, c_bool),
        *(c_void_p, c_size_t, c_void_p),
    ),
    "fmi3InstantiateModelExchange": (c_void_p, c_char_p, c_char_p, c_char_p),
}

#: What the functions of relays return, and their arguments.
_RELAYING: dict[str, tuple[Any, ...]] = {
    "asked": (c_uint32, c_void_p, c_uint32, c_int64),
    "request": (c_uint64, c_void_p, ctypes.POINTER(c_uint64)),
    "at": (None, c_void_p, c_uint32),
    "answer": (None, c_void_p, c_uint32),
    "hand_on": (c_uint64, c_void_p, c_char_p, c_uint64),
    "ask": (c_uint32, c_void_p, c_uint64, c_uint64),
    "is_answered": (c_bool, c_void_p, c_uint32, c_int64),
    "reach": (c_uint64, c_void_p, ctypes.POINTER(c_uint32)),
    "take": (c_uint64, c_void_p, c_char_p),
    "room": (c_uint64,),
}


@cache
def channel_library() -> ctypes.CDLL:
    """The library of the loop, with the functions of channels declared."""
    library = loop_library()
    library.channel_make.argtypes, library.channel_make.restype = [c_void_p], None
    library.channel_begin.argtypes = [c_void_p, c_uint64, GivesUp, Takes, WarnedOf]
    library.channel_begin.restype = c_void_p
    library.channel_spin.argtypes = [c_void_p, c_uint32, c_uint32]
    library.channel_spin.restype = library.channel_hear.restype = library.channel_free.restype = None
    for function in (library.channel_loaded, library.channel_end, library.channel_hear, library.channel_free):
        function.argtypes = [c_void_p]
    library.channel_failed.argtypes = [c_void_p, ctypes.POINTER(c_int)]
    library.channel_current.argtypes = [c_void_p]
    library.channel_answer.argtypes = [c_void_p]
    library.channel_answer.restype = library.channel_serve.restype = None
    library.channel_serve.argtypes = [c_void_p, c_uint64, c_void_p]
    library.channel_end_with.argtypes, library.channel_end_with.restype = [c_int], c_bool
    library.channel_functions.restype = ctypes.POINTER(c_char_p)
    library.channel_area.restype = c_uint64
    library.core_keep.restype = library.core_release.restype = None
    for name, prototype in _RELAYING.items():
        function = getattr(library, f"relay_{name}")
        function.restype, *function.argtypes = prototype
    for name, arguments in _MAKING.items():
        function = getattr(library, f"isolated_{name}")
        function.argtypes, function.restype = arguments, c_void_p
    return library


def make_channel(memory: mmap) -> None:
    """Make new memory a channel, before the other side is started."""
    channel_library().channel_make(ctypes.addressof(ctypes.c_char.from_buffer(memory)))


@cache
def functions() -> tuple[str, ...]:
    """Names of the functions that can be called over a channel, by their numbers."""
    names = channel_library().channel_functions()
    found: list[str] = []
    while name := names[len(found)]:
        found.append(name.decode())
    return tuple(found)


@contextmanager
def on_one_core() -> Iterator[None]:
    """Context in which this thread stays on one core, and isolated FMUs that it calls come there; see core.c."""
    channel_library().core_keep()
    try:
        yield
    finally:
        channel_library().core_release()


class _Relay:
    """One end of a channel whose other end is on another machine; see channel_relay.c."""

    def __init__(self, memory: mmap) -> None:
        self._memory = memory
        self._library = channel_library()
        self._address = ctypes.addressof(ctypes.c_char.from_buffer(memory))
        self._area: int = self._library.channel_area()

    def _write(self, data: bytes) -> None:
        self._memory[self._area : self._area + len(data)] = data


class RelayToMaster(_Relay):
    """The end of the master, for which it stands in for the worker; `memory` is that of the channel."""

    def asked(self, before: int, longest: int) -> int:
        """What the master has asked for, by its number, once that is another one, or after so long (ns)."""
        asked: int = self._library.relay_asked(self._address, before, longest)
        return asked

    def request(self) -> tuple[int, bytes]:
        """How many calls the master asks for, and their bytes."""
        n_calls = c_uint64()
        used = self._library.relay_request(self._address, ctypes.byref(n_calls))
        return n_calls.value, self._memory[self._area : self._area + used]

    def note_call(self, call: int) -> None:
        """Say at which call the worker is."""
        self._library.relay_at(self._address, call)

    def write(self, data: bytes) -> None:
        """Put bytes at the beginning of the area."""
        self._write(data)

    def answer(self, asked: int) -> None:
        """Tell the master that it has its answer."""
        self._library.relay_answer(self._address, asked)

    def hand_on(self, messages: bytes) -> bytes:
        """Hand messages on; those for which there is no room yet."""
        return messages[self._library.relay_hand_on(self._address, messages, len(messages)) :]


class RelayToWorker(_Relay):
    """The end of the worker, for which it stands in for the master; `memory` is that of the channel."""

    def ask(self, n_calls: int, calls: bytes) -> int:
        """Ask for calls; the number of what was asked for."""
        self._write(calls)
        asked: int = self._library.relay_ask(self._address, n_calls, len(calls))
        return asked

    def is_answered(self, asked: int, longest: int) -> bool:
        """Whether what was asked for is done, soon or within so long (ns)."""
        done: bool = self._library.relay_is_answered(self._address, asked, longest)
        return done

    def answer(self) -> bytes:
        """The bytes of the calls, and of what they have given."""
        reach = self._library.relay_reach(self._address, ctypes.byref(c_uint32()))
        return self._memory[self._area : self._area + reach]

    @property
    def call(self) -> int:
        """Number of the call that the worker is at, or was at last."""
        call = c_uint32()
        self._library.relay_reach(self._address, ctypes.byref(call))
        return call.value

    def messages(self) -> bytes:
        """The messages that have come."""
        taken = ctypes.create_string_buffer(self._library.relay_room())
        size = self._library.relay_take(self._address, taken)
        return ctypes.string_at(taken, size)
