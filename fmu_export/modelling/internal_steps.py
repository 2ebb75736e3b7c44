"""Internal steps of the solver rk43, as the native flavours make them: adaptive.c and rk4.c say why.

Copied into the archive, so it needs the standard library only.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite, nan, sqrt

#: More internal steps than this in one communication step is taken for a mistake, not for work to do.
MOST_INTERNAL_STEPS = 1_000_000

#: After so many of them it is foreseen, since here they take long.
SOON = 200

SHARE = 0.25
MUCH_SHORTER, ONE_OF, SMALL_CHANGE, OF_NOMINAL = 0.25, 1000, 0.01, 0.01
MOST_GROWTH, MOST_SHRINKAGE, RETREAT = 5.0, 0.2, 0.1
LEAST_STEP, LEAST_ERROR = 1e-15, 1e-4

#: tried(time, states, h) -> the states a step later, then the derivatives of its four stages.
Tried = Callable[[float, list[float], float], list[float]]

#: rates(time, states) -> derivatives; raises an ArithmeticError (`NoRates`) or a ValueError where there are none.
Rates = Callable[[float, list[float]], list[float]]


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
        tried: Tried,
        rates: Rates,
        x: list[float],
        span: tuple[float, float],
        numerics: tuple[float, float],
        nominals: tuple[float, ...],
    ) -> list[float]:
        """States after a communication step.

        Parameters
        ----------
        tried, rates : callable
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
            found = tried(time, x, length)
            if _is_smooth(found, x, length, nominals):
                return found[: len(x)]
            self.passed_over = 0.0
        proposed, done = self.proposed if self.proposed > 0.0 else length, 0.0
        rejected = False
        for tries in range(MOST_INTERNAL_STEPS):
            if tries >= SOON and length - done > MOST_INTERNAL_STEPS * proposed:
                break
            now, rest, h = time + done, length - done, min(proposed, max_step)
            if h < LEAST_STEP * abs(now):
                raise TooManySteps(f"t = {now!r} s: no internal step is short enough for the tolerance {rtol!r}")
            last = h * (1.0 + 1e-6) >= rest
            h = rest if last else 0.5 * rest if 2.0 * h > rest else h
            after, error = _with_estimate(tried, rates, x, now, h, rtol, nominals)
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
        abs(h * (k4 - k1)) <= SMALL_CHANGE * (OF_NOMINAL * nominal + abs(value))
        for k4, k1, value, nominal in zip(found[4 * n :], found[n : 2 * n], x, nominals, strict=True)
    )


def _with_estimate(
    tried: Tried, rates: Rates, x: list[float], time: float, h: float, rtol: float, nominals: tuple[float, ...]
) -> tuple[list[float], float]:
    """The states after a step, and its error, at most 1 where it may be accepted."""
    n = len(x)
    try:
        found = tried(time, x, h)
        after, *stages = (found[i : i + n] for i in range(0, 5 * n, n))
        early = [
            before + h / 96.0 * (16.0 * k1 + 5.0 * (k2 + k3) - 2.0 * k4)
            for before, k1, k2, k3, k4 in zip(x, *stages, strict=True)
        ]
        there = rates(time + 0.25 * h, early)
    except (ArithmeticError, ValueError):
        return x, nan
    if not all(map(isfinite, (*found, *there))):
        return x, nan
    error = 0.0
    for before, value, rate, k1, k2, k3, k4, nominal in zip(x, after, there, *stages, nominals, strict=True):
        allowed = SHARE * rtol * (1e-4 * nominal + max(abs(before), abs(value)))
        error = max(error, abs(h * (rate - 0.125 * (3.0 * (k1 + k2 + k3) - k4))) / allowed)
    return after, error


def _planned(proposed: float, h: float, error: float, *, good: bool, rejected: bool) -> float:
    """What the next step should be after a good one of length h, or after one that was too long."""
    cut_short = good and h < proposed
    factor = RETREAT
    if isfinite(error):
        factor = 0.9 / sqrt(sqrt(max(error, LEAST_ERROR)))
        factor = max(min(factor, 1.0 if rejected else MOST_GROWTH), MOST_SHRINKAGE)
    return h * factor if not cut_short or factor < 1.0 or h * factor > proposed else proposed
