"""Memory that the loop reads: parts that are aligned, apart from each other, and as they were handed out."""

from __future__ import annotations

import ctypes
from itertools import pairwise

import pytest

from cosim.loop.arena import Arena
from cosim.loop.binding import Extrapolated, Operation


def test_parts_keep_their_values_beside_each_other() -> None:
    arena = Arena()
    numbers = arena.array(ctypes.c_double, [1.5, -2.5])
    integers, references = arena.integers([-3, 4, -5]), arena.references([6])
    written, after = arena.zeros(2), arena.array(ctypes.c_double, [7.5])
    assert list(written) == [0.0, 0.0]
    written[:] = [8.5, 9.5]
    assert (list(numbers), list(integers), list(references)) == ([1.5, -2.5], [-3, 4, -5], [6])
    assert (list(written), list(after)) == ([8.5, 9.5], [7.5])


def test_parts_follow_each_other_where_their_type_may_stand() -> None:
    arena = Arena()
    kinds = [ctypes.c_char, ctypes.c_int32, ctypes.c_char, ctypes.c_double, ctypes.c_int16, Operation]
    places = [ctypes.addressof(arena.structure(kind)) for kind in kinds]
    for place, kind in zip(places, kinds, strict=True):
        assert place % ctypes.alignment(kind) == 0
    for (place, kind), (following, _) in pairwise(zip(places, kinds, strict=True)):
        assert 0 <= following - place - ctypes.sizeof(kind) < ctypes.alignment(Operation)


def test_a_structure_is_zero() -> None:
    assert bytes(Arena().structure(Extrapolated)) == bytes(ctypes.sizeof(Extrapolated))


@pytest.mark.parametrize("n", [1, 1000, 8191, 8192, 8193, 100_000])
def test_any_number_of_any_size_has_room(n: int) -> None:
    arena = Arena()
    parts = [arena.array(ctypes.c_double, [float(i)] * n) for i in range(20)]
    for i, part in enumerate(parts):
        assert set(part) == {float(i)}


def test_nothing_has_an_address_too() -> None:
    """The loop is given a pointer also where it reads nothing."""
    assert ctypes.addressof(Arena().integers([])) != 0
