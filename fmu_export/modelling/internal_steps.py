"""Internal steps of the solver rk43, and the formulas by which all solvers that estimate their error choose a step.

Copied into the archive of the pythonfmu flavour, so it needs the standard library only. The native flavours make the
same steps in adaptive.c and rk43.h; their numbers and formulas are generated from those here.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, nan, sqrt
from typing import Any

#: More internal steps than this in one communication step is taken for a mistake, not for work to do.
MOST_INTERNAL_STEPS = 1_000_000

#: After so many of them it is foreseen, since here they take long.
SOON = 200

#: Of the tolerance, what one step may use: the errors of many steps add up, and grow where solutions part. What is
#: estimated is of a lower order than the error of the step, which is a small share of it.
SHARE = 0.25

#: A step of this part of what the last estimate allows has less than a hundredth of the error; of so many of them one
#: gets an estimate, which costs as much as two steps.
MUCH_SHORTER, ONE_OF = 0.25, 1000

#: By how much a step may grow or shrink, at most; and when its end can't be computed at all.
MOST_GROWTH, MOST_SHRINKAGE, RETREAT = 5.0, 0.2, 0.1

#: Of the time, what a step must be: a few of the last digits.
LEAST_STEP = 1e-15

#: Errors below this are no reason for longer steps.
LEAST_ERROR = 1e-4

#: step(time, states, h) -> the states a step later, then the derivatives of its four stages.
Step = Callable[[float, list[float], float], list[float]]

#: defect(time, states, h, stages) -> what is wrong with that step, a change of the states; raises an ArithmeticError
#: (`NoRates`) or a ValueError where it can't be computed.
Defect = Callable[[float, list[float], float, list[float]], list[float]]


def allowance(size: Any, nominal: Any, rtol: Any, share: Any) -> Any:
    """By how much one step may be off in a state, of which the larger absolute value of before and after is `size`."""
    return share * rtol * (1e-4 * nominal + size)


def small_change(size: Any, nominal: Any) -> Any:
    """By how much derivatives times the step may change in a step without an estimate.

    For a state of this absolute value. That is the change of one with a time constant of ten steps.
    """
    return 0.01 * (0.01 * nominal + size)


def factor_of(error: Any, root: Callable[[Any], Any] = sqrt) -> Any:
    """By what a step with this estimate should be multiplied."""
    return 0.9 / root(root(error))


class NoRates(ArithmeticError):
    """A model requires what these states do not meet."""


class TooManySteps(Exception):
    """A communication step needs more internal steps than are made, or steps that are too short."""


class InternalSteps:
    """What is kept from step to step.

    Attributes
    ----------
    proposed : float
        Length of the next step (s), 0 before the first one.
    passed_over : float
        Steps since the last one with an estimate.
    """

    def __init__(self) -> None:
        self.proposed = 0.0
        self.passed_over = 0.0

    def advance(
        self,
        step: Step,
        defect: Defect,
        x: list[float],
        span: tuple[float, float],
        numerics: tuple[float, float],
        nominals: tuple[float, ...],
    ) -> list[float]:
        """States after a communication step.

        Parameters
        ----------
        step, defect : callable
        x : list of float
        span : tuple of float
            Time and length (s).
        numerics : tuple of float
            Relative tolerance, longest step (s).
        nominals : tuple of float
            Of the states.

        Raises
        ------
        TooManySteps
        """
        (time, length), (rtol, max_step) = span, numerics
        if self._passes_over(length, max_step):
            found = step(time, x, length)
            if _is_smooth(found, x, length, nominals):
                return found[: len(x)]
            self.passed_over = 0.0
        proposed, done = self.proposed if self.proposed > 0.0 else length, 0.0
        rejected = False
        for tries in range(MOST_INTERNAL_STEPS):
            if tries >= SOON and length - done > MOST_INTERNAL_STEPS * min(proposed, max_step):
                break
            now, rest, h = time + done, length - done, min(proposed, max_step)
            if h < LEAST_STEP * abs(now):
                raise TooManySteps(f"t = {now!r} s: no internal step is short enough for the tolerance {rtol!r}")
            last = h * (1.0 + 1e-6) >= rest
            h = rest if last else 0.5 * rest if 2.0 * h > rest else h
            after, error = _with_estimate(step, defect, x, now, h, rtol, nominals)
            good = error <= 1.0
            proposed = _planned(proposed, h, error, good=good, rejected=rejected)
            rejected = not good
            if rejected:
                continue
            x = after
            if last:
                self.proposed = proposed
                return x
            done += h
        raise TooManySteps(
            f"communication step {length!r} s needs more than {MOST_INTERNAL_STEPS} internal steps "
            f"(max_step {max_step!r} s)"
        )

    def _passes_over(self, length: float, max_step: float) -> bool:
        """Whether a step is so much shorter than the last estimate allows that one now and then is enough."""
        passes = length <= MUCH_SHORTER * self.proposed and length <= max_step and self.passed_over < ONE_OF - 1
        self.passed_over = self.passed_over + 1.0 if passes else 0.0
        return passes


def _is_smooth(found: list[float], x: list[float], h: float, nominals: tuple[float, ...]) -> bool:
    """Whether nothing sudden has happened in a step without an estimate."""
    n = len(x)
    return all(
        abs(h * (k4 - k1)) <= small_change(abs(value), nominal)
        for k4, k1, value, nominal in zip(found[4 * n :], found[n : 2 * n], x, nominals, strict=True)
    )


def _with_estimate(
    step: Step, defect: Defect, x: list[float], time: float, h: float, rtol: float, nominals: tuple[float, ...]
) -> tuple[list[float], float]:
    """The states after a step, and its error, at most 1 where it may be accepted."""
    n = len(x)
    try:
        found = step(time, x, h)
        wrong = defect(time, x, h, found[n:])
    except (ArithmeticError, ValueError):
        return x, nan
    if not all(map(isfinite, (*found, *wrong))):
        return x, nan
    after, error = found[:n], 0.0
    for before, value, off, nominal in zip(x, after, wrong, nominals, strict=True):
        error = max(error, abs(off) / allowance(max(abs(before), abs(value)), nominal, rtol, SHARE))
    return after, error


def _planned(proposed: float, h: float, error: float, *, good: bool, rejected: bool) -> float:
    """What the next step should be after a good one of length h, or after one that was too long."""
    cut_short = good and h < proposed
    factor = RETREAT
    if isfinite(error):
        factor = factor_of(max(error, LEAST_ERROR))
        factor = max(min(factor, 1.0 if rejected else MOST_GROWTH), MOST_SHRINKAGE)
    return h * factor if not cut_short or factor < 1.0 or h * factor > proposed else proposed
