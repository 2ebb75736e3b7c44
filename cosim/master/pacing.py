"""Run in real time, or a multiple of it, and say how well that went."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable

import numpy as np

from cosim.errors import SetupError

#: While waiting, Ctrl-C is looked for after this time (s) at the latest.
_LOOK = 0.1


class Pacer:
    """Waits for the wall-clock time at which a communication point is due.

    Parameters
    ----------
    factor : float
        Simulated seconds in a second: 1 is real time, 2 twice as fast.

    Raises
    ------
    SetupError
        The factor is not positive and finite.
    """

    def __init__(self, factor: float) -> None:
        number = isinstance(factor, int | float) and not isinstance(factor, bool)
        if not (number and factor > 0.0 and math.isfinite(factor)):
            raise SetupError(f"real-time factor {factor!r} must be a positive number")
        self._factor = factor
        self._began: float | None = None
        self._lateness: list[float] = []
        self._overruns = 0

    def wait(self, elapsed: float, stop: Callable[[], bool]) -> None:
        """Wait until `elapsed` simulated seconds after the first call are due, or `stop` says so."""
        now = clock.perf_counter()
        if self._began is None:
            self._began = now
        due = self._began + elapsed / self._factor
        if now > due and self._lateness:  # the point before took longer than its step
            self._overruns += 1
        while (rest := due - clock.perf_counter()) > 0.0 and not stop():
            clock.sleep(min(rest, _LOOK))
        self._lateness.append(clock.perf_counter() - due)

    def begin_later(self, seconds: float) -> None:
        """Have all points that follow be due later (s): the run was paused."""
        if self._began is not None:
            self._began += seconds

    def report(self) -> dict[str, float]:
        """Overruns (points that were not done when the next one was due), and how late points began (s)."""
        late = np.array(self._lateness or [0.0])
        return {
            "factor": self._factor,
            "overruns": self._overruns,
            "lateness_max_s": float(late.max()),
            "lateness_mean_s": float(late.mean()),
            "jitter_rms_s": float(late.std()),
        }
