"""The longest fixed communication step that keeps a coupling error, found by runs with several steps.

The coupling error of a run with step h is estimated as Richardson did: where the error falls as h^p, y(h) - y(h/2) is
1 - 2^-p of it, and p is what runs with h, h/2 and h/4 show. Compared are the outputs that connections pass on, or what
was asked to be recorded, each relative to the largest magnitude that it reaches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.errors import SetupError
from cosim.master.failures import SimulationError
from cosim.results.results import Results

#: Estimates of the order beyond these are not believed: accuracy has ended in rounding, or h is far too long.
_LEAST_ORDER, _GREATEST_ORDER = 0.5, 6.0

#: No more runs than this are made.
_MOST_RUNS = 24

#: The predicted step is shortened by this factor: a run that keeps the tolerance at once is cheaper than two.
_SAFETY = 0.9

#: The longest and the shortest step that are tried are so many times the first one.
_LONGEST, _SHORTEST = 2.0**14, 2.0**-10

#: Runs that record more values than this are not made.
MOST_VALUES = 100_000_000

#: An error between this part of the tolerance and the tolerance is near enough to it.
_NEAR = 0.7

#: Differences below this, relative to the largest magnitude, are rounding.
_ROUNDING = 1e-13


#: The times of a run (s), as "time", and by name what is compared.
Curves = dict[str, np.ndarray]


@dataclass(frozen=True)
class Estimate:
    """The estimated coupling error of a run.

    Attributes
    ----------
    step_size : float
        Communication step (s).
    error : float
        Largest estimated error of any variable, relative to its largest magnitude; infinite for a run that failed or
        diverged.
    order : float
        Power of the step by which it falls.
    variable : str
        The variable that has it.
    time : float
        When (s).
    """

    step_size: float
    error: float
    order: float
    variable: str
    time: float


class ToleranceSearch:
    """A search for the longest step whose run keeps a tolerance.

    Parameters
    ----------
    run : callable
        run(step_size) -> results.
    names : sequence of str
        Variables that are compared.
    duration : float
        Of the run (s).
    first_step : float
        Communication step (s) to begin with.
    tolerance : float
        Largest coupling error, relative to the largest magnitude of each variable.
    most_steps : int
        Runs with more steps are not made.

    Raises
    ------
    SetupError
        The tolerance makes no sense, or there is nothing to compare.
    """

    def __init__(
        self,
        run: Callable[[float], Results],
        names: Sequence[str],
        duration: float,
        first_step: float,
        tolerance: float,
        most_steps: int,
    ) -> None:
        checked_tolerance(tolerance)
        if not names:
            raise SetupError(
                "coupling tolerance: no real output is connected, and no coupling error known; leave it out"
            )
        self._run, self._names = run, list(names)
        self._steps = round(duration / first_step)
        self._duration, self._tolerance, self._most_steps = duration, tolerance, most_steps
        self._curves: dict[int, Curves | SimulationError] = {}
        self._estimates: dict[int, Estimate] = {}
        self._runs = 0

    def found(self) -> Results:
        """Results of the run with the longest step that keeps the tolerance.

        Its `info["coupling"]` has the step, the estimate, and all that were tried.

        Raises
        ------
        SetupError
            No step keeps it.
        SimulationError
            A run fails whatever the step.
        """
        n = self._steps
        best: int | None = None
        too_long: set[int] = set()
        while self._runs < _MOST_RUNS:
            estimate = self._estimate(n)
            if estimate.error <= self._tolerance:
                best = n if best is None else min(best, n)
                if estimate.error >= _NEAR * self._tolerance:
                    break
            else:
                too_long.add(n)
            following = self._following(estimate, n, best, max(too_long, default=0))
            if following is None:
                break
            n = following
        if best is None:
            self._raise()
        assert best is not None
        return self._told(best)

    def _following(self, estimate: Estimate, n: int, best: int | None, too_long: int) -> int | None:
        """The number of steps to try next; None where the longest step that keeps the tolerance is known."""
        if math.isfinite(estimate.error) and estimate.error > 0.0:
            wanted = n * (estimate.error / (_SAFETY * self._tolerance)) ** (1.0 / estimate.order)
        else:
            wanted = n * (0.5 if estimate.error == 0.0 else 2.0)
        wanted = min(max(wanted, n / 8.0), 8.0 * n)
        candidates = [k for k in self._candidates() if k > too_long and (best is None or k < best)]
        if not candidates:
            return None
        enough = [k for k in candidates if k >= wanted]
        return enough[0] if enough else candidates[-1]

    def _candidates(self) -> list[int]:
        """Numbers of steps that may be tried, ascending: the first one, and those with two digits and zeros."""
        least, most = max(4.0, self._steps / _LONGEST), min(self._steps / _SHORTEST, self._most_steps / 4.0)
        round_ones = (digits * 10**power for power in range(12) for digits in range(10 if power else 1, 100))
        return sorted({n for n in (*round_ones, self._steps) if least <= n <= most})

    def _estimate(self, n: int) -> Estimate:
        if n not in self._estimates:
            self._estimates[n] = self._estimated(n)
        return self._estimates[n]

    def _estimated(self, n: int) -> Estimate:
        step = self._duration / n
        runs = []
        for times in (1, 2, 4):
            results = self._ran(times * n)
            if isinstance(results, SimulationError):
                return Estimate(step, math.inf, 1.0, "", math.nan)
            runs.append(results)
        error, variable, time = self._difference(runs[0], runs[1])
        smaller, *_ = self._difference(runs[1], runs[2])
        if not math.isfinite(error):
            return Estimate(step, math.inf, 1.0, variable, time)
        if error <= _ROUNDING:
            return Estimate(step, 0.0, 1.0, variable, time)
        order = math.log2(error / smaller) if 0.0 < smaller < math.inf else _GREATEST_ORDER
        order = min(max(order, _LEAST_ORDER), _GREATEST_ORDER)
        # y(h) - y(h/2) = (1 - 2^-p) e(h)
        return Estimate(step, error / (1.0 - 2.0**-order), order, variable, time)

    def _ran(self, n: int) -> Curves | SimulationError:
        if n not in self._curves:
            self._runs += 1
            try:
                results = self._run(self._duration / n)
                self._curves[n] = {"time": results.time, **{name: results[name].copy() for name in self._names}}
            except SimulationError as error:
                self._curves[n] = error
        return self._curves[n]

    def _difference(self, coarse: Curves, fine: Curves) -> tuple[float, str, float]:
        """Largest difference, relative to the largest magnitude of each variable, at points of both; where it is."""
        time = coarse["time"]
        largest, where, when = 0.0, self._names[0], float(time[0])
        every = max(1, (len(fine["time"]) - 1) // max(1, len(time) - 1))
        for name in self._names:
            at_coarse, at_fine = coarse[name], fine[name][::every]
            if len(at_coarse) != len(at_fine):  # one of them was ended before
                return math.inf, name, float(time[-1])
            scale = float(np.abs(at_fine).max())
            if scale == 0.0:
                continue
            with np.errstate(all="ignore"):
                difference = np.abs(at_coarse - at_fine) / scale
            i = int(np.argmax(difference))
            if not difference[i] <= largest:  # NaN, too
                largest, where, when = float(difference[i]), name, float(time[i])
                if math.isnan(largest):
                    return math.inf, where, when
        return largest, where, when

    def _raise(self) -> None:
        failed = {n: found for n, found in self._curves.items() if isinstance(found, SimulationError)}
        if failed:
            raise failed[max(failed)]
        least = min(self._estimates.values(), key=lambda e: e.error)
        raise SetupError(
            f"coupling tolerance {self._tolerance:g}: no step keeps it; with {least.step_size:.3g} s "
            f"'{least.variable}' has an estimated coupling error of {least.error:.3g}; allow more, or use another "
            "extrapolation"
        )

    def _told(self, n: int) -> Results:
        results, estimate = self._run(self._duration / n), self._estimates[n]
        results.info["coupling"] = {
            "tolerance": self._tolerance,
            "step_size": estimate.step_size,
            "error": estimate.error,
            "order": estimate.order,
            "variable": estimate.variable,
            "time": estimate.time,
            "runs": self._runs + 1,
            "tried": [
                {"step_size": e.step_size, "error": e.error if math.isfinite(e.error) else None}
                for e in sorted(self._estimates.values(), key=lambda e: e.step_size)
            ],
        }
        return results


def checked_tolerance(tolerance: float) -> float:
    """A coupling tolerance.

    Raises
    ------
    SetupError
        It makes no sense.
    """
    if not (isinstance(tolerance, int | float) and 0.0 < tolerance < 1.0):
        raise SetupError(f"coupling tolerance {tolerance!r} must be a number between 0 and 1, relative, as 1e-4")
    return tolerance


def compared_names(recorded: Sequence[str], feeding: Sequence[str], *, chosen: bool) -> list[str]:
    """Variables whose coupling error counts: those that were chosen to be recorded, else those that feed others."""
    return list(recorded) if chosen else [name for name in recorded if name in set(feeding)]
