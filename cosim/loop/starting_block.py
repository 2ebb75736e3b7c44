"""Starting blocks as the compiled loop sees them; see starting_block.h."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_double, c_int32, c_int64
from functools import cache

from cosim.loop.binding import Extrapolated, check_layout, loop_library
from cosim.loop.iterated_step import KeptState


class StartingBlock(ctypes.Structure):
    """Steps that are computed together where inputs know too little."""

    _fields_ = (
        ("states", POINTER(KeptState)),
        ("first", POINTER(Extrapolated)),
        *((name, POINTER(c_double)) for name in ("rows", "before")),
        *((name, POINTER(c_int32)) for name in ("known", "refused")),
        ("n_values", c_int64),
        *((name, c_int32) for name in ("n_states", "steps")),
        *((name, c_int64) for name in ("n_blocks", "n_not_found", "n_trials")),
        *((name, c_int32) for name in ("failed", "status")),
    )


@cache
def check_starting_block() -> None:
    """Whether the loop lays the struct out as it stands here.

    Raises
    ------
    LoopLibraryError
        It does not.
    """
    check_layout(loop_library().starting_block_layout, (StartingBlock,))
