"""Models with events and sampling run in numpy: against closed forms, and by the rules of events at one instant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fmu_export.modelling.hybrid import HybridRun
from fmu_export.modelling.model import Event
from tests.support.hybrid_models import BALL, CHAIN, CROSSINGS


def test_numpy_bounces_the_ball_at_the_right_times() -> None:
    run = HybridRun(BALL, BALL.parameters.starts, 0.05)
    u = np.zeros(0)
    state = run.settled(0.0, run.start(0.0), u)
    time, v = np.sqrt(2.0 / 9.81), np.sqrt(2.0 * 9.81)  # of the first bounce
    before = 0.0
    for _ in range(8):
        v *= 0.8
        top = time + v / 9.81
        state = run.settled(top, run.advanced(before, state, u, top), u)
        np.testing.assert_allclose(state.x, [v**2 / 2.0 / 9.81, 0.0], rtol=0, atol=1e-10)
        before, time = top, top + v / 9.81


def test_numpy_counts_crossings_by_their_direction() -> None:
    run = HybridRun(CROSSINGS, CROSSINGS.parameters.starts, 0.05)
    u = np.zeros(0)
    state = run.settled(0.0, run.start(0.0), u)
    state = run.settled(3.3, run.advanced(0.0, state, u, 3.3), u)
    np.testing.assert_allclose(state.z, [3.0, 3.0, 6.0, 3.0], rtol=0, atol=1e-10)


def test_events_that_set_each_other_off_without_end_are_an_error() -> None:
    run = HybridRun(CHAIN, np.ones(1), 0.01)
    state = run.settled(0.0, run.start(0.0), np.zeros(1))
    with pytest.raises(ArithmeticError, match="without end"):
        run.settled(0.1, run.advanced(0.0, state, np.zeros(1), 0.1), np.ones(1))


def test_an_event_of_a_model_without_an_event_before_it_is_no_crossing() -> None:
    resting = replace(BALL, events=[Event("never", lambda t, x, u, p: -1.0 + 0.0 * x[0], lambda t, x, u, p: x)])
    run = HybridRun(resting, BALL.parameters.starts, 0.05)
    u = np.zeros(0)
    state = run.advanced(0.0, run.settled(0.0, run.start(0.0), u), u, 1.0)
    np.testing.assert_allclose(state.x, [1.0 - 9.81 / 2.0, -9.81], rtol=1e-12)


@pytest.mark.parametrize(
    ("direction", "indicator", "sides"),
    [
        ("falling", lambda t: t, 1.0),  # it leaves
        ("falling", lambda t: -t, -1.0),  # it crosses at once
        ("rising", lambda t: -t, -1.0),
        ("rising", lambda t: t, 1.0),
        ("falling", lambda t: t * (t - 0.5), 1.0),  # it rests for one step, and is moved in the next
        ("falling", lambda t: 0.0 * t, -1.0),  # it rests
    ],
)
def test_an_indicator_that_is_zero_at_the_start_is_on_the_side_that_it_comes_from(direction, indicator, sides) -> None:
    """Looked at are the next two thousandths of the longest step, here half a second each."""
    model = replace(
        CROSSINGS,
        events=[
            Event("hit", lambda t, x, z, u, p: np.float64(indicator(t)), lambda t, x, z, u, p: (x, z + 1.0), direction)
        ],
    )
    run = HybridRun(model, CROSSINGS.parameters.starts, 500.0)
    state = run.settled(0.0, run.start(0.0), np.zeros(0))
    np.testing.assert_array_equal(state.sides, [sides])
    np.testing.assert_array_equal(state.z, 0.0)
