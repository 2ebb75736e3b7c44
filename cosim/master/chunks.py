"""How many steps a run takes at once: between two chunks it looks for Ctrl-C and commands, and reports progress."""

from __future__ import annotations

#: How long (s) a chunk should take.
TIME = 0.05

#: Steps of the first one, how many times as long as the one before one may be, and the most steps.
FIRST, GROWTH, MOST = 64, 16, 1 << 16

_SHORTEST_TIME = 1e-6  # clocks have a resolution


class ChunkLength:
    """The number of steps of the next chunk, by how long the last one took.

    Parameters
    ----------
    most : int, optional
        It is never more than this; `MOST` by default.

    Attributes
    ----------
    steps : int
    """

    def __init__(self, most: int | None = None) -> None:
        self._most = MOST if most is None else most
        self.steps = min(FIRST, self._most)

    def took(self, steps: int, seconds: float) -> None:
        """So many steps took so long (s)."""
        rate = steps / max(seconds, _SHORTEST_TIME)
        self.steps = max(1, min(round(rate * TIME), GROWTH * self.steps, self._most))
