"""How many runs to give to a worker at once."""

from __future__ import annotations

import math

#: Time (s) that a batch should take: long against the few ms that Dask spends on a task, short enough for a lost worker
#: and an early end to cost little.
_BATCH_TIME = 1.5

#: Batches a second that one scheduler can be asked for at ease: with many workers they become longer.
_MOST_BATCHES = 100

#: Runs in a batch at most, for its rows to fit one message.
_MOST_RUNS = 5_000

#: What is left of the batches before in the mean time of a run, at each new batch.
_MEMORY = 0.7


class BatchSize:
    """Sizes batches by what the runs before have taken: the first are single runs."""

    def __init__(self) -> None:
        self._runs = self._seconds = 0.0

    def learn(self, runs: int, seconds: float) -> None:
        """Take note of what a batch has taken (s)."""
        self._runs = _MEMORY * self._runs + runs
        self._seconds = _MEMORY * self._seconds + seconds

    def next(self, left: int, slots: int) -> int:
        """Runs of the next batch, of those that are left; towards the end smaller, for all workers to end together."""
        if not self._runs:
            return 1
        time = max(_BATCH_TIME, slots / _MOST_BATCHES)
        wanted = min(time * self._runs / self._seconds, _MOST_RUNS) if self._seconds else _MOST_RUNS
        return max(1, min(int(wanted), math.ceil(left / (2 * slots))))
