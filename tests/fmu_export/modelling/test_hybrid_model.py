"""Events, sampling and discrete states are checked when a model is made, in one line that names them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fmu_export.control_backend import to_control
from fmu_export.errors import ArgumentError
from fmu_export.modelling.model import Event, Sampled
from fmu_export.modelling.variables import Variable
from fmu_export.pythonfmu.backend import build_pythonfmu
from tests.support.hybrid_models import BALL, SAMPLED_PI, THERMOSTAT


def nothing(*arguments: Any) -> Any:
    """A function that is never called."""
    raise AssertionError(arguments)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Event("a b", nothing, nothing), "event 'a b': the name is not a name of FMI"),
        (lambda: Event("hit", 1.0, nothing), "event 'hit': indicator is not a function"),  # type: ignore[arg-type]
        (lambda: Event("hit", nothing, None), "event 'hit': reset is not a function"),  # type: ignore[arg-type]
        (lambda: Event("hit", nothing, nothing, "down"), "direction is 'down'"),  # type: ignore[arg-type]
        (lambda: Sampled("s", nothing, 0.0), "period 0.0 is not positive"),
        (lambda: Sampled("s", nothing, float("nan")), "period is nan"),
        (lambda: Sampled("s", nothing, 0.1, float("inf")), "offset is inf"),
        (lambda: Sampled("s", 0.1, nothing), "sampled 's': update is not a function"),  # type: ignore[arg-type]
        (lambda: replace(BALL, events=[nothing]), "give a tuple of Events"),  # type: ignore[list-item]
        (lambda: replace(BALL, events=2 * BALL.events), "not unique: bounce"),
        (lambda: replace(BALL, inputs=[Variable("bounce.indicator")]), "of the indicator of that event"),
        (lambda: replace(BALL, discrete=[Variable("z")], events=()), "nothing changes the discrete states z"),
        (lambda: replace(BALL, discrete=[Variable("h")]), "'h': a state has this name too"),
        (lambda: replace(BALL, discrete=[Variable("g")]), "not unique: g"),
        (
            lambda: replace(BALL, outputs=[Variable("h", "m"), Variable("v", type="integer")]),
            "state 'v' is of type integer; continuous states are real",
        ),
        (lambda: replace(BALL, initial_discrete=nothing), "there are no discrete states"),
        (lambda: replace(BALL, sampled=SAMPLED_PI.sampled), "there are no discrete states that it could change"),
        (lambda: replace(THERMOSTAT, discrete=[Variable("on", "K")]), "'on': the output of this name has another"),
        (lambda: replace(THERMOSTAT, discrete=[Variable("on", start=2.0, max=1.0)]), "2.0 is outside"),
        (lambda: replace(THERMOSTAT, discrete=[Variable("on", tunable=True)]), "'on' is not a parameter"),
        (lambda: replace(THERMOSTAT, initial_discrete=1), "initial_discrete is not a function"),  # type: ignore[arg-type]
        (lambda: replace(SAMPLED_PI, sampled=[Sampled("s", nothing, "T")]), "period 'T' is not a scalar parameter"),
        (lambda: replace(SAMPLED_PI, sampled=[Sampled("s", nothing, "offset")]), "starts at 0.0; it must be positive"),
        (lambda: to_control(BALL), "python-control takes continuous models"),
        (lambda: build_pythonfmu(SAMPLED_PI, "unused"), "build an FMU with build_native"),
    ],
)
def test_what_is_wrong_is_named(make: Any, said: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        make()
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_period_that_may_change_during_a_run_is_refused() -> None:
    parameters = [replace(v, tunable=v.name == "period") for v in SAMPLED_PI.parameters.variables]
    with pytest.raises(ArgumentError, match="fixed during a run"):
        replace(SAMPLED_PI, parameters=parameters)


def test_discrete_states_begin_at_their_start_values_or_as_a_function_of_the_parameters() -> None:
    p = THERMOSTAT.parameters.starts
    np.testing.assert_array_equal(THERMOSTAT.initial_discrete_state(p), [0.0, 0.0])
    other = replace(THERMOSTAT, initial_discrete=lambda p: p[:2])
    np.testing.assert_array_equal(other.initial_discrete_state(p), [18.0, 22.0])


def test_what_is_continuous_has_neither_events_nor_discrete_states() -> None:
    assert not BALL.is_continuous
    assert not SAMPLED_PI.is_continuous
    assert replace(BALL, events=()).is_continuous
