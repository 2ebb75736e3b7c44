"""Internal steps of the solver rk43 in Python: their lengths by hand, for rates whose error is known exactly."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from fmu_export.modelling.functions import rk4_defect
from fmu_export.modelling.internal_steps import InternalSteps, NoRates, TooManySteps

#: A relative tolerance of which a quarter is spent on a step.
RTOL = 1e-6


@dataclass(frozen=True)
class Problem:
    """One step of the classical Runge-Kutta method, and where it was tried: time and length."""

    derivatives: Callable[[float, list[float]], list[float]]
    tried: list[tuple[float, float]] = field(default_factory=list)
    estimates: list[float] = field(default_factory=list)

    def step(self, t: float, x: list[float], h: float) -> list[float]:
        self.tried.append((t, h))
        f = self.derivatives
        k1 = f(t, x)
        k2 = f(t + h / 2.0, [a + h / 2.0 * k for a, k in zip(x, k1, strict=True)])
        k3 = f(t + h / 2.0, [a + h / 2.0 * k for a, k in zip(x, k2, strict=True)])
        k4 = f(t + h, [a + h * k for a, k in zip(x, k3, strict=True)])
        after = [a + h / 6.0 * (p + 2.0 * (q + r) + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)]
        return [*after, *k1, *k2, *k3, *k4]

    def defect(self, t: float, x: list[float], h: float, stages: list[float]) -> list[float]:
        def derivatives(at: float, states: Any, u: Any, p: Any) -> Any:
            self.estimates.append(at)
            return np.array(self.derivatives(at, list(states)))

        found: list[float] = rk4_defect(
            derivatives, t, np.array(x), None, None, h, [*np.reshape(stages, (4, -1))]
        ).tolist()
        return found

    def advance(
        self,
        steps: InternalSteps,
        x: list[float],
        t: float,
        length: float,
        rtol: float = RTOL,
        max_step: float = math.inf,
        nominals: tuple[float, ...] = (),
    ) -> list[float]:
        return steps.advance(self.step, self.defect, x, (t, length), (rtol, max_step), nominals or (1.0,) * len(x))


def cubic() -> Problem:
    """X' = t^3: a parabola through its rates at 0, h/2 and h differs at h/4 by 3/64 h^3, after a step from 0."""
    return Problem(lambda t, x: [t**3])


def error_of_cubic(h: float, nominal: float) -> float:
    """Error of the first step, from x = 0, in units of what is allowed."""
    return (3.0 / 64.0 * h**4) / (0.25 * RTOL * (1e-4 * nominal + h**4 / 4.0))


@pytest.mark.parametrize("nominal", [1.0, 5.0])
@pytest.mark.parametrize("factor", [0.999, 1.001])
def test_a_step_is_accepted_up_to_the_error_that_is_allowed(nominal: float, factor: float) -> None:
    limit = (0.25e-4 * RTOL * nominal / (3.0 / 64.0 - RTOL / 16.0)) ** 0.25
    h = factor * limit
    assert (error_of_cubic(h, nominal) <= 1.0) == (factor < 1.0)
    problem, steps = cubic(), InternalSteps()
    (x,) = problem.advance(steps, [0.0], 0.0, h, nominals=(nominal,))
    assert x == pytest.approx(h**4 / 4.0, rel=1e-12)
    if factor < 1.0:
        assert problem.tried == [(0.0, h)]
        assert problem.estimates == [0.25 * h]
        assert steps.proposed == pytest.approx(h * 0.9 * error_of_cubic(h, nominal) ** -0.25, rel=1e-12)
    else:  # 0.9 of it is more than a half, so the rest is halved
        assert problem.tried == [(0.0, h), (0.0, 0.5 * h), (0.5 * h, 0.5 * h)]


def test_the_estimate_is_that_of_states_on_the_way() -> None:
    """X' = x: the error of a step is its difference from Taylor's series, worked out for stages by hand."""
    h, problem, steps = 0.1, Problem(lambda t, x: [x[0]]), InternalSteps()
    problem.advance(steps, [1.0], 0.0, h, rtol=1e-3)
    k1, k2 = 1.0, 1.0 + h / 2.0
    k3 = 1.0 + h / 2.0 * k2
    k4 = 1.0 + h * k3
    after = 1.0 + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    early = 1.0 + h / 96.0 * (16.0 * k1 + 5.0 * (k2 + k3) - 2.0 * k4)
    assert early == pytest.approx(math.exp(h / 4.0), rel=1e-5)
    error = abs(h * (early - (3.0 * (k1 + k2 + k3) - k4) / 8.0)) / (0.25e-3 * (1e-4 + after))
    assert 1e-4 < error < 1.0
    assert steps.proposed == pytest.approx(h * 0.9 * error**-0.25, rel=1e-12)
    # the larger of two errors counts, whichever is first
    for order in (1, -1):
        both = Problem(lambda t, x, order=order: [x[0], 0.0][::order])
        two = InternalSteps()
        both.advance(two, [1.0, 1.0], 0.0, h, rtol=1e-3)
        assert two.proposed == pytest.approx(steps.proposed if order == 1 else h * 5.0, rel=1e-12)
        swapped = Problem(lambda t, x, order=order: [0.0, x[1]][::order])
        three = InternalSteps()
        swapped.advance(three, [1.0, 1.0], 0.0, h, rtol=1e-3)
        assert three.proposed == pytest.approx(steps.proposed if order == 1 else h * 5.0, rel=1e-12)


def test_lengths_grow_by_five_at_most_and_shrink_to_a_fifth_at_least() -> None:
    still, steps = Problem(lambda t, x: [0.0]), InternalSteps()
    still.advance(steps, [1.0], 0.0, 0.1)
    assert steps.proposed == pytest.approx(0.5, rel=1e-15)  # no error: five times
    steep, other = Problem(lambda t, x: [1e9 * t**3]), InternalSteps()
    steep.advance(other, [0.0], 0.0, 1.0, rtol=1e-3)
    lengths = [h for _, h in steep.tried]
    assert lengths[:4] == pytest.approx([1.0, 0.2, 0.04, 0.008], rel=1e-12)


def test_after_a_step_that_was_too_long_the_next_one_is_not_longer() -> None:
    problem, steps = cubic(), InternalSteps()
    steps.proposed = 1.0
    problem.advance(steps, [0.0], 0.0, 1.0)
    lengths = [h for _, h in problem.tried]
    first = next(i for i, (t, _) in enumerate(problem.tried) if t > 0.0)
    assert first > 1
    assert lengths[first] <= lengths[first - 1] * (1.0 + 1e-12)


def test_the_rest_is_divided_evenly_and_the_proposal_outlives_a_short_step() -> None:
    still, steps = Problem(lambda t, x: [0.0]), InternalSteps()
    steps.proposed = 0.4
    assert still.advance(steps, [1.0], 2.0, 0.7) == [1.0]
    assert still.tried == [(2.0, 0.35), (2.35, 0.35)]
    # cut short, and nothing says that it should be shorter
    assert steps.proposed == pytest.approx(5.0 * 0.35, rel=1e-12)
    cut = InternalSteps()
    cut.proposed = 0.9
    still.advance(cut, [1.0], 0.0, 0.3, rtol=1e-12)
    assert cut.proposed == pytest.approx(1.5, rel=1e-12)
    longer = Problem(lambda t, x: [0.0]), InternalSteps()
    longer[1].proposed = 10.0
    longer[0].advance(longer[1], [1.0], 0.0, 3.0, max_step=1.0)
    assert longer[0].tried == [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0)]
    assert longer[1].proposed == 10.0


def test_short_steps_have_an_estimate_now_and_then() -> None:
    still, steps = Problem(lambda t, x: [0.0]), InternalSteps()
    steps.proposed = 1.0
    for i in range(2000):
        still.advance(steps, [1.0], 0.25 * i, 0.25)
    assert len(still.tried) == 2000
    assert still.estimates == [0.25 * 999 + 0.0625, 0.25 * 1999 + 0.0625]
    longer = Problem(lambda t, x: [0.0]), InternalSteps()
    longer[1].proposed = 1.0
    longer[0].advance(longer[1], [1.0], 0.0, 0.26)
    assert len(longer[0].estimates) == 1
    limited = Problem(lambda t, x: [0.0]), InternalSteps()
    limited[1].proposed = 10.0
    limited[0].advance(limited[1], [1.0], 0.0, 1.0, max_step=0.5)
    assert [h for _, h in limited[0].tried] == [0.5, 0.5]


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize(("change", "sudden"), [(0.99, False), (1.01, True)])
def test_a_sudden_change_within_a_short_step_is_estimated(row: int, change: float, sudden: bool) -> None:
    """Rates that change over the step by h (k4 - k1) = 0.01 (0.01 nominal + |x|) are still smooth."""
    h, nominals, x = 0.1, (2.0, 3.0), [0.5, -0.25]
    allowed = 0.01 * (0.01 * nominals[row] + abs(x[row])) / h

    def derivatives(t: float, _: list[float]) -> list[float]:
        return [change * allowed * t / h if i == row else 0.0 for i in (0, 1)]

    problem, steps = Problem(derivatives), InternalSteps()
    steps.proposed = 100.0
    problem.advance(steps, x, 0.0, h, rtol=1.0, nominals=nominals)
    assert bool(problem.estimates) == sudden
    assert steps.passed_over == (0.0 if sudden else 1.0)


@pytest.mark.parametrize("error", [NoRates("too hot"), ValueError("no logarithm"), ZeroDivisionError()])
def test_where_there_are_no_rates_a_tenth_is_tried(error: Exception) -> None:
    def derivatives(t: float, x: list[float]) -> list[float]:
        if t > 0.3:
            raise error
        return [0.0]

    problem = Problem(derivatives)
    with pytest.raises(TooManySteps, match=r"t = 0\.\d+ s: no internal step is short enough for the tolerance 1e-06"):
        problem.advance(InternalSteps(), [1.0], 0.0, 1.0)
    lengths = [h for _, h in problem.tried]
    assert lengths[:2] == pytest.approx([1.0, 0.1], rel=1e-15)
    assert max(t for t, _ in problem.tried) == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_rates_that_are_not_finite_are_none(value: float) -> None:
    at_quarter = Problem(lambda t, x: [value if t == 0.25 else 0.0])
    assert at_quarter.advance(InternalSteps(), [1.0], 0.0, 1.0) == [1.0]
    assert [h for _, h in at_quarter.tried][:2] == pytest.approx([1.0, 0.1], rel=1e-15)


def test_endless_work_is_foreseen() -> None:
    problem = Problem(lambda t, x: [0.0])
    with pytest.raises(TooManySteps, match=r"step 1\.0 s needs more than 1000000 internal steps \(max_step 1e-09 s\)"):
        problem.advance(InternalSteps(), [1.0], 0.0, 1.0, max_step=1e-9)
    assert 200 <= len(problem.tried) < 1000
