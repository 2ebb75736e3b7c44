"""Algebraic loops as the compiled loop sees them; see algebraic_loop.h."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_double, c_int32, c_int64, c_uint32, c_void_p
from functools import cache

from cosim.loop.binding import Operation, check_layout, loop_library

#: Status beyond those of the loop.
NO_SOLUTION = 130


class Direction(ctypes.Structure):
    """A part of how a change goes through an exchange."""

    _fields_ = (
        ("function", c_void_p),
        ("instance", c_void_p),
        ("unknowns", POINTER(c_uint32)),
        ("knowns", POINTER(c_uint32)),
        ("to", POINTER(c_int32)),
        ("from", POINTER(c_int32)),
        ("seed", POINTER(c_double)),
        ("change", POINTER(c_double)),
        ("factor", c_double),
        ("n_to", c_int32),
        ("n_from", c_int32),
        ("version", c_int32),
        ("code", c_uint32),
    )


class AlgebraicLoop(ctypes.Structure):
    """What is torn, and how its solution goes."""

    _fields_ = (
        ("operations", POINTER(Operation)),
        ("codes", POINTER(c_uint32)),
        ("n_operations", c_int64),
        ("positions", POINTER(c_int32)),
        *(
            (name, POINTER(c_double))
            for name in ("jacobian", "factors", "residuals", "tried", "step", "assumed", "outputs", "origin", "way")
        ),
        ("directions", POINTER(Direction)),
        ("changes", POINTER(c_double)),
        ("tolerance", c_double),
        ("n_values", c_int64),
        ("n_directions", c_int32),
        ("is_directed", c_int32),
        ("n", c_int32),
        ("most", c_int32),
        ("has_jacobian", c_int32),
        ("follows", c_int32),
        *((name, c_int64) for name in ("n_points", "n_iterations", "n_exchanges", "failed_operation")),
        ("largest_residual", c_double),
        ("residual", c_double),
    )


@cache
def algebraic_loop_library() -> ctypes.CDLL:
    """The library of the loop, for algebraic loops.

    Raises
    ------
    LoopLibraryError
        It is missing, or lays the struct out otherwise.
    """
    library = loop_library()
    check_layout(library.algebraic_loop_layout, (Direction, AlgebraicLoop))
    return library
