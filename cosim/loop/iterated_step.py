"""Iterated steps and kept states as the compiled loop sees them; see iterated_step.h and kept_states.h."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_double, c_int32, c_int64, c_uint32, c_void_p
from enum import IntEnum
from functools import cache

from cosim.loop.binding import Operation, check_layout, loop_library

#: Status beyond those of the loop.
NOT_CONVERGED = 131


class Doing(IntEnum):
    """What an iterated step performs when it fails; see iterated_step.h."""

    KEEPING = 0
    GOING_BACK = 1
    STEPPING = 2
    EXCHANGING = 3
    SETTING = 4


class KeptState(ctypes.Structure):
    """A state of an FMU in memory."""

    _fields_ = (
        ("instance", c_void_p),
        ("get", c_void_p),
        ("set", c_void_p),
        ("state", POINTER(c_void_p)),
        ("code_of_get", c_uint32),
        ("code_of_set", c_uint32),
    )


class IteratedStep(ctypes.Structure):
    """What is repeated, and how the iteration goes."""

    _fields_ = (
        *((name, POINTER(Operation)) for name in ("steps", "exchange", "sets")),
        *((f"codes_of_{name}", POINTER(c_uint32)) for name in ("steps", "exchange", "sets")),
        *((f"n_{name}", c_int64) for name in ("steps", "exchange", "sets")),
        ("states", POINTER(KeptState)),
        ("positions", POINTER(c_int32)),
        *((name, POINTER(c_double)) for name in ("before", "ahead", "found", "residuals", "best", "sizes")),
        *((name, POINTER(c_double)) for name in ("last_found", "last_residuals", "differences")),
        *((name, POINTER(c_double)) for name in ("basis", "weights", "room")),
        ("chosen", POINTER(c_int32)),
        *((name, c_double) for name in ("tolerance", "acceptable")),
        ("n_values", c_int64),
        *((name, c_int32) for name in ("n", "n_held", "n_states", "most", "columns", "n_columns")),
        *((name, c_int32) for name in ("must_converge", "demanded", "failed_in", "most_taken")),
        *((name, c_int64) for name in ("n_points", "n_iterations", "n_unsolved", "failed")),
        *((name, c_double) for name in ("largest_residual", "residual")),
    )


@cache
def iterated_step_library() -> ctypes.CDLL:
    """The library of the loop, for iterated steps.

    Raises
    ------
    LoopLibraryError
        It is missing, or lays the structs out otherwise.
    """
    library = loop_library()
    check_layout(library.iterated_step_layout, (KeptState, IteratedStep))
    return library
