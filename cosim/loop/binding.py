"""The compiled loop as Python sees it: its library, and the layout of what it reads."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from ctypes import (
    POINTER,
    c_bool,
    c_char_p,
    c_double,
    c_int32,
    c_int64,
    c_size_t,
    c_uint8,
    c_uint32,
    c_uint64,
    c_void_p,
)
from enum import IntEnum
from functools import cache
from typing import Any

from cosim.errors import CosimError
from cosim.loop.source import LIBRARY, source_hash

_REMEDY = "install the package again (pip install .), or in a checkout: python hatch_build.py"


class LoopLibraryError(CosimError):
    """The compiled loop is missing, or belongs to another version of its source."""


class OperationKind(IntEnum):
    """Kinds of operations; see loop.c."""

    SAMPLE = 0
    SET = 1
    GET = 2
    EXTRAPOLATE = 3
    STEP = 4
    TRANSFORM = 5
    CALL = 6
    CONVERT = 7
    GROUP = 8
    DIFFERENTIATE = 9


#: Sources of derivatives in place of a column of the samples: the last values, or none: held.
EXTRAPOLATED, HELD = -1, -2

#: In place of the position of what is added to a transformed value.
NONE = -1

#: Statuses beyond those of FMI.
NOT_FINITE, WANTS_TO_END, RETURNED_EARLY, DOES_NOT_FIT = 100, 101, 102, 103


class Cell(ctypes.Structure):
    """A variable of a component that is a function in Python; see loop.c."""

    _fields_ = (("address", c_void_p), ("size", c_size_t))


#: Function of a CALL operation: takes the time (s) and returns a status.
Called = ctypes.CFUNCTYPE(ctypes.c_int, c_double)


#: Receiver of messages from the loop's logger: environment, name of the instance, status, category, text.
TakeMessage = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, ctypes.c_int, c_char_p, c_char_p)


class Extrapolated(ctypes.Structure):
    """Extrapolation of the inputs of an FMU over a step; see loop.c."""

    _fields_ = (
        ("history", POINTER(c_double)),
        ("rates", POINTER(c_double)),
        ("derivatives", POINTER(c_double)),
        ("watched", POINTER(c_double)),
        ("buffer", POINTER(c_double)),
        ("ahead", POINTER(c_double)),
        ("orders", POINTER(c_int32)),
        ("weights", POINTER(c_double)),
        ("time", c_double),
        ("points", c_int32),
        ("degree", c_int32),
        ("known", c_int32),
        ("refused", c_int32),
        ("first_rate", c_int32),
        ("left", c_int32),
    )


class Rates(ctypes.Structure):
    """What rates of outputs depend on besides time and states; see loop.c."""

    _fields_ = (
        ("function", c_void_p),
        ("knowns", POINTER(c_uint32)),
        ("positions", POINTER(c_int32)),
        ("orders", POINTER(c_int32)),
        ("seed", POINTER(c_double)),
        ("change", POINTER(c_double)),
        ("n", c_int32),
    )


class Conversion(ctypes.Structure):
    """Range of values that a connection between two types may carry; see loop.c."""

    _fields_ = (("smallest", c_int64), ("largest", c_uint64), ("from", c_int32), ("to", c_int32))


class Operation(ctypes.Structure):
    """One entry of the table; see loop.c."""

    _fields_ = (
        ("kind", c_uint8),
        ("type", c_uint8),
        ("version", c_uint8),
        ("more", c_uint8),
        ("every", c_int32),
        ("function", c_void_p),
        ("instance", c_void_p),
        ("references", POINTER(c_uint32)),
        ("data", c_void_p),
        ("targets", POINTER(c_int32)),
        ("n_references", c_int32),
        ("first", c_int32),
        ("n", c_int32),
        ("n_targets", c_int32),
    )


class Predicted(ctypes.Structure):
    """What inputs were predicted to be, against what they are; see loop.h."""

    _fields_ = (
        ("steps", POINTER(Operation)),
        ("n_steps", c_int64),
        ("positions", POINTER(c_int32)),
        ("values", POINTER(c_double)),
        ("squares", POINTER(c_double)),
        ("sizes", POINTER(c_double)),
        ("n_values", c_int64),
        ("n_points", c_int64),
        ("n", c_int64),
        ("is_predicted", c_int64),
    )


class Profile(ctypes.Structure):
    """How long operations take; see loop.h."""

    _fields_ = (
        ("every", c_int64),
        ("at_point", POINTER(c_int64)),
        ("at_step", POINTER(c_int64)),
        ("n_points", c_int64),
        ("n_steps", c_int64),
        ("predicted", POINTER(Predicted)),
    )


#: Receiver of operations that returned a warning.
Warned = ctypes.CFUNCTYPE(None, POINTER(Operation))

#: Called while the loop waits, for Python to look for Ctrl-C.
Looks = ctypes.CFUNCTYPE(None)


class Loop(ctypes.Structure):
    """Input of the loop, and its report of how it ended; see loop.c."""

    _fields_ = (
        ("start_time", c_double),
        ("step_size", c_double),
        ("per_second", c_double),
        ("last_point", c_int64),
        ("values", POINTER(c_double)),
        ("samples", POINTER(c_double)),
        ("samples_inside", POINTER(c_double)),
        ("jumps", POINTER(c_uint8)),
        ("n_samples", c_int64),
        ("first_sample", c_int64),
        ("n_rows", c_int64),
        ("records", POINTER(c_double)),
        ("runs", POINTER(c_int32)),
        ("n_runs", c_int64),
        ("n_recorded", c_int64),
        ("record_every", c_int64),
        ("first_record", c_int64),
        ("at_point", POINTER(Operation)),
        ("at_step", POINTER(Operation)),
        ("n_at_point", c_int64),
        ("n_at_step", c_int64),
        ("codes_at_point", POINTER(c_uint32)),
        ("codes_at_step", POINTER(c_uint32)),
        ("call", c_void_p),
        ("team", c_void_p),
        ("profile", POINTER(Profile)),
        ("start", c_void_p),
        ("warned", Warned),
        ("looks", Looks),
        ("point", c_int64),
        ("failed", c_int64),
        ("status", c_int32),
        ("failed_at_step", c_int32),
    )


class _Field(ctypes.Structure):
    """Offset and size of a field in its struct, or of a whole struct, as the loop reports them."""

    _fields_ = (("name", c_char_p), ("offset", c_size_t), ("size", c_size_t))


def _layout_here(structs: Iterable[type[ctypes.Structure]]) -> dict[str, tuple[int, int]]:
    """Offset and size of each struct and field, as declared in Python."""
    layout = {}
    for struct in structs:
        layout[struct.__name__] = (0, ctypes.sizeof(struct))
        for declared in struct._fields_:
            name = declared[0]
            field = getattr(struct, name)
            layout[f"{struct.__name__}.{name}"] = (field.offset, field.size)
    return layout


def _layout_of(fields: Any) -> dict[str, tuple[int, int]]:
    """Offset and size of each struct and field, as the C compiler laid them out."""
    layout: dict[str, tuple[int, int]] = {}
    while (field := fields[len(layout)]).name:
        layout[field.name.decode()] = (field.offset, field.size)
    return layout


def check_layout(function: Any, structs: Iterable[type[ctypes.Structure]]) -> None:
    """Whether structs are laid out as the loop has them, by what a function of its library says.

    Raises
    ------
    LoopLibraryError
        They are not.
    """
    function.restype = POINTER(_Field)
    differing = sorted(name for name, _ in set(_layout_of(function()).items()) ^ set(_layout_here(structs).items()))
    if differing:
        raise LoopLibraryError(
            f"the compiled loop {LIBRARY} lays out its data in another way than Python: {differing[0]}"
        )


@cache
def loop_library() -> ctypes.CDLL:
    """The loaded library.

    Raises
    ------
    LoopLibraryError
        It is missing, or not that of this source.
    """
    try:
        library = ctypes.CDLL(str(LIBRARY))
    except OSError as error:
        raise LoopLibraryError(f"the compiled loop {LIBRARY} can't be loaded: {error}; {_REMEDY}") from error
    library.loop_hash.restype = c_char_p
    if library.loop_hash().decode() != source_hash():
        raise LoopLibraryError(f"the compiled loop {LIBRARY} belongs to another version of its source; {_REMEDY}")
    check_layout(library.loop_layout, (Cell, Extrapolated, Rates, Conversion, Operation, Predicted, Profile, Loop))
    library.loop_perform.argtypes = [POINTER(Loop), POINTER(Operation), POINTER(c_uint32), c_int64, c_int64]
    library.loop_run.argtypes = [POINTER(Loop), c_int64, c_int64, c_bool]
    for function in (library.cells_get, library.cells_set):
        function.argtypes = [c_void_p, POINTER(c_uint32), c_size_t, c_void_p, c_size_t]
    library.log_to.argtypes = [TakeMessage]
    library.log_to.restype = None
    library.loop_evaluate_all.argtypes = [POINTER(Extrapolated), c_double, c_int32]
    library.loop_evaluate_all.restype = None
    library.loop_rest_of_step.argtypes = [POINTER(Loop), c_int64, c_int64]
    library.loop_perform.restype = library.loop_run.restype = library.loop_rest_of_step.restype = c_bool
    return library
