"""The channel to an FMU in another process as Python sees it; see channel.h."""

from __future__ import annotations

import ctypes
from ctypes import c_bool, c_char_p, c_double, c_int, c_size_t, c_uint32, c_uint64, c_void_p
from functools import cache

from cosim.loop.binding import loop_library

#: Statuses beyond those of FMI and of the loop: the worker is gone, a call that was deferred has failed, the arguments
#: are too large.
LOST, FAILED_BEFORE, TOO_LARGE = 110, 111, 112

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


@cache
def channel_library() -> ctypes.CDLL:
    """The library of the loop, with the functions of channels declared."""
    library = loop_library()
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
    for name, arguments in _MAKING.items():
        function = getattr(library, f"isolated_{name}")
        function.argtypes, function.restype = arguments, c_void_p
    return library


@cache
def functions() -> tuple[str, ...]:
    """Names of the functions that can be called over a channel, by their numbers."""
    names = channel_library().channel_functions()
    found: list[str] = []
    while name := names[len(found)]:
        found.append(name.decode())
    return tuple(found)
