"""Memory that the compiled loop reads: small arrays packed one after the other, in the order in which they are used.

Scattered over the heap, the arrays of a thousand FMUs would not stay in the processor's cache.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

_BLOCK = 1 << 16  # bytes


class Arena:
    """Hands out parts of large blocks; lives as long as what points into it."""

    def __init__(self) -> None:
        self._blocks: list[Any] = []
        self._used = _BLOCK

    def array(self, kind: Any, values: Sequence[float]) -> Any:
        """A ctypes array of a type, with these values."""
        array = self.structure(kind * max(1, len(values)))
        array[: len(values)] = values
        return array

    def structure(self, kind: Any) -> Any:
        """A ctypes structure of a type, all zero."""
        size = ctypes.sizeof(kind)
        self._used += -self._used % ctypes.alignment(kind)
        if not self._blocks or self._used + size > len(self._blocks[-1]):
            self._blocks.append((ctypes.c_char * max(_BLOCK, size))())
            self._used = 0
        part = kind.from_buffer(self._blocks[-1], self._used)
        self._used += size
        return part

    def integers(self, values: Sequence[int]) -> Any:
        """Indices."""
        return self.array(ctypes.c_int32, values)

    def references(self, values: Sequence[int]) -> Any:
        """Value references."""
        return self.array(ctypes.c_uint32, values)

    def zeros(self, n: int) -> Any:
        """Doubles to be written by the loop."""
        return self.array(ctypes.c_double, [0.0] * n)
