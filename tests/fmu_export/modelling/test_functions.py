"""Length, saturation and the Runge-Kutta step, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fmu_export.modelling.functions import norm, rk4_step, saturate


def test_the_length_of_a_vector() -> None:
    assert norm(np.array([3.0, -4.0])) == 5.0
    assert norm(np.array([2.0, 3.0, 6.0])) == 7.0
    assert norm(np.zeros(3)) == 0.0
    assert norm(np.array([1e-150, 0.0])) == pytest.approx(1e-150, rel=1e-12, abs=0.0)


def test_the_length_has_a_derivative_everywhere() -> None:
    """By complex steps, with one added to the square at 0 only."""
    h = 1e-30
    assert norm(np.array([3.0 + 1j * h, 4.0])).imag / h == pytest.approx(0.6)
    assert norm(np.array([0.0 + 1j * 0.0, 0.0])) == 0.0


NEXT = math.nextafter


@pytest.mark.parametrize(
    ("v", "limit", "expected"),
    [
        (0.0, 2.0, 0.0),
        (1.5, 2.0, 1.5),
        (-1.5, 2.0, -1.5),
        (NEXT(2.0, 0.0), 2.0, NEXT(2.0, 0.0)),
        (2.0, 2.0, 2.0),
        (NEXT(2.0, 3.0), 2.0, 2.0),
        (NEXT(-2.0, 0.0), 2.0, NEXT(-2.0, 0.0)),
        (-2.0, 2.0, -2.0),
        (-7.0, 2.0, -2.0),
        (7.0, 2.0, 2.0),
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0),
        (-1.0, 0.0, 0.0),
        (1e300, 1e60, 1e60),
    ],
)
def test_saturation(v: float, limit: float, expected: float) -> None:
    assert saturate(np.array([v]), np.array([limit])).tolist() == [expected]


def test_what_is_not_a_number_stays_so() -> None:
    assert np.isnan(saturate(np.array([np.nan, 1.0]), np.array([2.0, 2.0]))).tolist() == [True, False]


EMPTY = np.zeros(0)


@pytest.mark.parametrize("h", [0.5, 2.0])
def test_a_step_of_a_linear_equation_is_the_series_of_the_exponential(h: float) -> None:
    """X' = -3 x: the step multiplies by 1 + z + z^2/2 + z^3/6 + z^4/24 with z = -3 h."""
    z = -3.0 * h
    series = 1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0
    found = rk4_step(lambda t, x, u, p: -3.0 * x, 0.0, np.array([2.0]), EMPTY, EMPTY, h)
    assert found == pytest.approx([2.0 * series], rel=1e-14)


def test_a_step_integrates_cubics_of_time_without_an_error() -> None:
    """Simpson's rule, from 0.7 to 1.2."""
    found = rk4_step(lambda t, x, u, p: np.stack([4.0 * t**3]), 0.7, np.array([1.0]), EMPTY, EMPTY, 0.5)
    assert found == pytest.approx([1.0 + 1.2**4 - 0.7**4], rel=1e-14)


def test_inputs_change_at_their_rate() -> None:
    """X' = u^3 with u = 0.7 + 2 t: x = u^4 / 8."""
    found = rk4_step(lambda t, x, u, p: u**3, 9.0, np.array([0.0]), np.array([0.7]), EMPTY, 0.25, np.array([2.0]))
    assert found == pytest.approx([(1.2**4 - 0.7**4) / 8.0], rel=1e-14)
    held = rk4_step(lambda t, x, u, p: u**3, 9.0, np.array([0.0]), np.array([0.7]), EMPTY, 0.25)
    assert held == pytest.approx([0.25 * 0.7**3], rel=1e-14)


def test_parameters_reach_every_stage() -> None:
    seen = []

    def derivatives(t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        seen.append((t, float(u[0]), float(p[0])))
        return p * x

    rk4_step(derivatives, 1.0, np.array([1.0]), np.array([5.0]), np.array([3.0]), 0.5, np.array([4.0]))
    assert seen == [(1.0, 5.0, 3.0), (1.25, 6.0, 3.0), (1.25, 6.0, 3.0), (1.5, 7.0, 3.0)]


def test_a_first_stage_that_is_known_is_not_computed() -> None:
    seen = []

    def derivatives(t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        seen.append(t)
        return -x

    given = rk4_step(derivatives, 0.0, np.array([1.0]), EMPTY, EMPTY, 0.1, k1=np.array([-1.0]))
    assert seen == [0.05, 0.05, 0.1]
    assert given.tolist() == rk4_step(derivatives, 0.0, np.array([1.0]), EMPTY, EMPTY, 0.1).tolist()
