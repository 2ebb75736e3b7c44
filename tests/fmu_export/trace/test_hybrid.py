"""Events and samplers are traced as they are computed; what differs from numpy, or can't be taken, is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fmu_export.errors import TraceError
from fmu_export.modelling.model import Event, Model, Sampled
from fmu_export.modelling.variables import Variable
from fmu_export.package.interface import interface_of
from fmu_export.trace.trace import feedthrough, trace
from tests.support.hybrid_models import BALL, COINCIDENCE, HOLD, HYBRID, SAMPLED_PI, THERMOSTAT

MODELS = list(HYBRID.values())


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_traced_functions_compute_what_numpy_computes(model: Model) -> None:
    traced = trace(model)
    random = np.random.default_rng(1)
    t, p = 0.7, model.parameters.starts
    x, z = random.uniform(-2.0, 2.0, len(model.state_layout)), random.uniform(-2.0, 2.0, len(model.discrete))
    u = random.uniform(-2.0, 2.0, len(model.inputs))
    known = model.arguments(t, x, z, u, p)
    values = [t, x, u, p, z] if len(z) else [t, x, u, p]

    def computed(name: str) -> np.ndarray:
        return np.asarray(traced.change[name](*values)).ravel()

    np.testing.assert_allclose(computed("indicators"), [e.indicator(*known) for e in model.events], rtol=1e-14)
    for i, event in enumerate(model.events):
        after = event.reset(*known)
        np.testing.assert_allclose(computed(f"reset_{i}"), np.concatenate(after) if len(z) else after, rtol=1e-14)
    for i, sampled in enumerate(model.sampled):
        np.testing.assert_allclose(computed(f"update_{i}"), sampled.update(*known), rtol=1e-14)
    start = np.asarray(traced.change["initial_discrete"](p)).ravel()
    np.testing.assert_array_equal(start, model.initial_discrete_state(p))


def test_periods_and_offsets_are_numbers_or_parameters() -> None:
    p = SAMPLED_PI.parameters.starts
    assert np.asarray(trace(SAMPLED_PI).change["instants"](p)).ravel().tolist() == [0.1, 0.0]
    both = [SAMPLED_PI.sampled[0], Sampled("other", lambda t, x, z, u, p: z, 0.5, "limit")]
    assert np.asarray(trace(replace(SAMPLED_PI, sampled=both)).change["instants"](p)).ravel().tolist() == [
        *(0.1, 0.0),
        *(0.5, 1.5),
    ]


def _counts() -> Any:
    calls = [0]

    def reset(t: Any, x: Any, u: Any, p: Any) -> Any:
        calls[0] += 1
        return x * calls[0]

    return reset


def ball(**changes: Any) -> Model:
    return replace(BALL, events=[replace(BALL.events[0], **changes)])


def sampled(update: Any) -> Model:
    return replace(SAMPLED_PI, sampled=[Sampled("sampler", update, 0.1)])


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (ball(reset=lambda t, x, u, p: x[:1]), "the reset of 'bounce' returns 1 values, 2 are declared"),
        (ball(indicator=lambda t, x, u, p: x), "the indicators of events returns"),
        (ball(reset=_counts()), "traced twice, the equations differ"),
        (ball(reset=lambda t, x, u, p: x if x[1] > 0.0 else -x), "np.where"),
        (
            ball(reset=lambda t, x, u, p: x * (1.0 if type(x) is np.ndarray else 2.0)),
            "the reset of 'bounce', element h: numpy computes",
        ),
        (
            ball(indicator=lambda t, x, u, p: x[0] * (1.0 if type(x) is np.ndarray else 2.0)),
            "the indicators of events, element 'bounce': numpy computes",
        ),
        (sampled(lambda t, x, z, u, p: z[:1]), "the update of 'sampler' returns 1 values, 2 are declared"),
        (
            sampled(lambda t, x, z, u, p: z * (1.0 if type(x) is np.ndarray else 2.0)),
            "the update of 'sampler', element integral: numpy computes",
        ),
        (
            replace(THERMOSTAT, events=[replace(THERMOSTAT.events[0], reset=lambda t, x, z, u, p: x)]),
            "the reset of 'too_cold' must return a pair",
        ),
        (
            replace(THERMOSTAT, output_values=lambda t, x, z, u, p: np.stack([x[0], 2.0 * z[0]])),
            "element on: the output has the name of a state",
        ),
        (replace(THERMOSTAT, initial_discrete=lambda p: p[:1]), "initial_discrete returns 1 values, 2 are declared"),
    ],
)
def test_what_is_wrong_is_refused(model: Model, said: str) -> None:
    with pytest.raises(TraceError) as caught:
        trace(model)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_argument_that_is_changed_is_refused() -> None:
    def update(t: Any, x: Any, z: Any, u: Any, p: Any) -> Any:
        z[0] = 1.0
        return z

    with pytest.raises(TraceError, match="change a copy"):
        trace(sampled(update))


def test_discrete_states_are_outputs_or_locals_that_change_at_events_only() -> None:
    interface = interface_of(trace(THERMOSTAT))
    seen = {v.name: (v.causality, v.variability) for v in interface.variables[-3:]}
    assert seen == {
        "T": ("output", "continuous"),
        "on": ("output", "discrete"),
        "switched": ("local", "discrete"),
    }
    assert interface.indicators == ("too_cold.indicator", "too_warm.indicator")


def named(model: Model, of: str) -> dict[str, set[str]]:
    interface = interface_of(trace(model))
    names = [v.name for v in interface.variables]
    first = interface.n_parameters + interface.n_inputs
    rows = getattr(interface, of)
    return {names[first + i]: {names[j] for j in row} for i, row in enumerate(rows)}


def test_outputs_depend_on_inputs_through_what_happens_at_the_same_instant() -> None:
    assert named(HOLD, "dependencies") == {"y": {"u"}, "switched": {"v"}, "when": {"v"}}
    assert feedthrough(HOLD) == [[], [], []]  # between two events there is none
    assert named(SAMPLED_PI, "dependencies") == {"x": set(), "control": {"reference"}, "integral": {"reference"}}
    assert named(SAMPLED_PI, "initial_dependencies")["control"] == {
        "K",
        "K_i",
        "limit",
        "period",
        "offset",
        "reference",
    }
    assert named(THERMOSTAT, "dependencies") == {"T": set(), "on": set(), "switched": set()}
    assert named(THERMOSTAT, "parameter_dependencies")["on"] == {"low", "high"}


def test_a_delay_line_has_no_way_through_but_its_first_element() -> None:
    line = Model(
        name="Delay",
        inputs=[Variable("u")],
        outputs=[Variable("z", size=3)],
        discrete=[Variable("z", size=3)],
        output_values=lambda t, x, z, u, p: z,
        sampled=[Sampled("shift", lambda t, x, z, u, p: np.concatenate([u, z[:2]]), 0.1)],
    )
    assert named(line, "dependencies") == {"z[1]": {"u"}, "z[2]": set(), "z[3]": set()}
    event = Event("clear", lambda t, x, z, u, p: z[0] - 1.0, lambda t, x, z, u, p: (x, 0.0 * z), "rising")
    cleared = replace(line, events=[event])
    assert named(cleared, "dependencies") == {"z[1]": {"u"}, "z[2]": {"u"}, "z[3]": {"u"}}


def test_a_tunable_parameter_may_have_its_effect_in_events_alone() -> None:
    assert THERMOSTAT.parameters.variables[0].tunable
    idle = [*COINCIDENCE.parameters.variables, Variable("idle", tunable=True)]
    with pytest.raises(TraceError, match="'idle' is declared as tunable"):
        interface_of(trace(replace(COINCIDENCE, parameters=idle)))
