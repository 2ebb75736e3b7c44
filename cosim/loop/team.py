"""A team of threads that steps the components of a system at the same time (team.c)."""

from __future__ import annotations

import ctypes
import os
import weakref
from collections.abc import Sequence
from typing import Literal

from cosim.errors import SetupError, positive_whole
from cosim.loop.binding import loop_library

#: Number of threads, or: as many as pay.
Threads = int | Literal["auto"]

_MOST_THREADS = 1024


def checked_threads(threads: object) -> Threads:
    """A number of threads that makes sense, or "auto".

    Raises
    ------
    SetupError
        It is something else.
    """
    if threads == "auto":
        return "auto"
    number = positive_whole(threads)
    if number is None or number > _MOST_THREADS:
        raise SetupError(f"threads = {threads!r} must be a whole number from 1 to {_MOST_THREADS}, or 'auto'")
    return number


def cores() -> int:
    """Number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Team:
    """Threads that perform units of the operations at_step at the same time; freed with this object.

    Parameters
    ----------
    threads : int or "auto"
        Number of threads, that of the loop included. "auto" has one for each core at most, and steps one component
        after the other where that is measured to be faster.
    ends : sequence of int
        The operations of unit i end before this one.
    stays : sequence of bool
        Whether a unit is left to the thread of the loop.

    Attributes
    ----------
    address : int or None
        Of the team in C; None where one thread does all.
    threads : int
        How many there are.
    """

    def __init__(self, threads: Threads, ends: Sequence[int], stays: Sequence[bool]) -> None:
        useful = min(sum(not stay for stay in stays) + any(stays), cores() if threads == "auto" else _MOST_THREADS)
        self.threads = max(1, useful if threads == "auto" else min(threads, useful))
        self.address: int | None = None
        if self.threads == 1:
            return
        library = loop_library()
        library.team_new.argtypes = [ctypes.c_int32, ctypes.c_bool, ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p]
        library.team_new.restype = ctypes.c_void_p
        library.team_free.argtypes = library.team_steps_together.argtypes = [ctypes.c_void_p]
        library.team_free.restype = None
        library.team_steps_together.restype = ctypes.c_int64
        starts = (ctypes.c_int64 * (len(ends) + 1))(0, *ends)
        stay = (ctypes.c_uint8 * max(1, len(stays)))(*stays)
        self.address = library.team_new(self.threads, threads == "auto", len(ends), starts, stay)
        if self.address is None:
            self.threads = 1
        else:
            weakref.finalize(self, library.team_free, self.address)

    @property
    def steps_together(self) -> int:
        """How many steps were made at the same time."""
        return 0 if self.address is None else int(loop_library().team_steps_together(self.address))
