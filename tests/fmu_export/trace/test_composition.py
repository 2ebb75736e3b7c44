"""Models composed to one: values by hand, the order of evaluation, and what is refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from fmu_export import ModelClass, discrete, every, output, parameter, state, when
from fmu_export import input as input_
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.trace.composition import CompositionError, compose
from fmu_export.trace.trace import trace
from tests.support.tiny_models import CROSS, FRAGILE, FRAGILE_MESSAGE, GAIN, GAIN3, INTEGRATOR, LAG, UNITS


def composed(components: Mapping[str, Model], *connections: tuple[str, str]) -> Model:
    return compose("Whole", "Parts, connected", components, connections, DefaultExperiment(1.0, 0.1))


def outputs(model: Model, u: Sequence[float], x: Sequence[float] = ()) -> dict[str, float]:
    """Outputs by name from numbers, after a check that the traced model gives the same."""
    arguments = 0.0, np.array(x), np.array(u), model.parameters.starts
    values = model.output_values(*arguments)
    np.testing.assert_array_equal(values, trace(model).outputs(*arguments).full().ravel())
    return dict(zip(model.outputs.names, values, strict=True))


def test_variables_have_the_names_of_their_components() -> None:
    whole = composed({"a": GAIN, "b": GAIN}, ("a.y", "b.u"))
    assert whole.inputs.names == ("a.u[1]", "a.u[2]")
    assert whole.outputs.names == ("a.y[1]", "a.y[2]", "b.y[1]", "b.y[2]")
    assert whole.parameters.names == ("a.K", "b.K")
    kept = whole.parameters.variables[0]
    assert (kept.min, kept.max, kept.start, kept.description) == (-10.0, 10.0, 2.0, "Test quantity K")


def test_states_and_parameters_are_those_of_the_components() -> None:
    """Derivatives and states in the order of the components, each with its own parameters."""
    whole = composed({"one": INTEGRATOR, "two": LAG}, ("two.x", "one.u"), ("one.x", "two.u"))
    assert whole.states == ("one.x", "two.x")
    p = whole.parameters.pack(**{"one.x_start": 3.0, "one.T": 0.5, "two.x_start": 5.0, "two.T": 4.0})
    x = whole.initial_state(p)
    np.testing.assert_array_equal(x, [3.0, 5.0])
    np.testing.assert_array_equal(whole.derivatives(0.0, x, np.zeros(0), p), [5.0 / 0.5, (3.0 - 5.0) / 4.0])


def test_parts_that_feed_each_other_without_a_loop_are_evaluated_in_turns() -> None:
    """P = a + 1, q = 2 b: a.p -> b.b, b.q -> a.b passes both components twice, and closes no loop."""
    whole = composed({"one": CROSS, "two": CROSS}, ("one.p", "two.b"), ("two.q", "one.b"))
    assert whole.inputs.names == ("one.a", "two.a")
    values = outputs(whole, [10.0, 20.0])
    assert values == {"one.p": 11.0, "two.q": 22.0, "one.q": 44.0, "two.p": 21.0}


def test_a_component_may_feed_itself_where_that_is_no_loop() -> None:
    assert outputs(composed({"one": CROSS}, ("one.p", "one.b")), [1.0]) == {"one.p": 2.0, "one.q": 4.0}


@pytest.mark.parametrize("backwards", [False, True])
def test_a_chain_is_evaluated_from_its_beginning(backwards: bool) -> None:
    names = ["first", "second", "third"]
    components = dict.fromkeys(reversed(names) if backwards else names, GAIN)
    whole = composed(components, ("first.y", "second.u"), ("second.y", "third.u"))
    values = outputs(whole, [1.0, -3.0])
    assert [values[f"{name}.y[{i}]"] for name in names for i in (1, 2)] == [2.0, -6.0, 4.0, -12.0, 8.0, -24.0]


def test_an_algebraic_loop_is_refused() -> None:
    with pytest.raises(CompositionError, match=r"algebraic loop: each of a.y\[1\], a.y\[2\], b.y\[1\], b.y\[2\] "):
        composed({"a": GAIN, "b": GAIN}, ("a.y", "b.u"), ("b.y", "a.u"))


def test_a_loop_through_a_state_is_none() -> None:
    """The lag sees its own state: x' = (x - x) / T."""
    whole = composed({"plant": LAG, "sensor": FRAGILE}, ("plant.x", "sensor.u"), ("sensor.y", "plant.u"))
    p = whole.parameters.starts
    np.testing.assert_array_equal(whole.derivatives(0.0, np.array([7.0]), np.zeros(0), p), [0.0])


def test_requirements_name_their_component_and_see_what_it_sees() -> None:
    whole = composed({"plant": INTEGRATOR, "sensor": FRAGILE}, ("plant.x", "sensor.u"))
    (requirement,) = whole.requirements
    assert requirement.message == f"sensor: {FRAGILE_MESSAGE}"
    margins = [requirement.margin(0.0, np.array([x]), np.zeros(1), whole.parameters.starts) for x in (0.5, -0.5)]
    assert margins == [0.5, -0.5]


@pytest.mark.parametrize(
    ("components", "connections", "message"),
    [
        ({"a b": GAIN}, [], "component: the name 'a b' is not an identifier"),
        ({"a.b": GAIN}, [], "component: the name 'a.b' is not an identifier"),
        ({"a": GAIN, "b": GAIN}, [("a.z", "b.u")], "a.z -> b.u: there is no output 'a.z'; known are a.y, b.y"),
        ({"a": GAIN, "b": GAIN}, [("a.y", "b.y")], "a.y -> b.y: there is no input 'b.y'; known are a.u, b.u"),
        ({"a": GAIN, "b": GAIN3}, [("a.y", "b.u")], "a.y -> b.u: the sizes differ: 2 and 3"),
        ({"a": UNITS, "b": UNITS}, [("a.energy", "b.length")], "the units differ: J and m"),
        (
            {"a": GAIN, "b": GAIN, "c": GAIN},
            [("a.y", "c.u"), ("b.y", "c.u")],
            "b.y -> c.u: a.y feeds this input already",
        ),
    ],
)
def test_wrong_systems_are_refused(
    components: dict[str, Model], connections: list[tuple[str, str]], message: str
) -> None:
    with pytest.raises(CompositionError, match=message.replace("(", r"\(")):
        composed(components, *connections)


class Room(ModelClass):
    """A room that is heated."""

    T = state(20.0, "degC")
    heat = input_(0.0, "K/s")
    opened = discrete(0.0)

    def derivatives(m):
        return {"T": m.heat - 0.01 * (m.T - 10.0)}

    @when(lambda m: m.T - 25.0, "rising")
    def window(m):
        return {"T": m.T - 1.0, "opened": m.opened + 1.0}


class Controller(ModelClass):
    """A sampled controller that counts."""

    period = parameter(2.0, "s")
    measured = input_(0.0, "K")
    control = discrete(0.5, "K/s")
    memory = discrete([1.0, 2.0], output=False)

    @every(period, offset=0.5)
    def sample(m):
        return {"control": 300.0 - m.measured, "memory": np.stack([m.measured, m.memory[0]])}


class Dial(ModelClass):
    """Continuous, and without states."""

    x = input_(0.0, "K/s")
    y = output("K/s")

    def outputs(m):
        return {"y": 2.0 * m.x}


def test_events_and_samples_of_components_are_those_of_the_whole() -> None:
    whole = composed(
        {"dial": Dial, "room": Room, "law": Controller},
        *(("law.control", "dial.x"), ("dial.y", "room.heat"), ("room.T", "law.measured")),
    )
    assert whole.discrete.names == ("room.opened", "law.control", "law.memory[1]", "law.memory[2]")
    assert whole.outputs.names == ("dial.y", "room.T", "room.opened", "law.control")
    assert [e.name for e in whole.events] == ["room.window"]
    assert [(s.name, s.period, s.offset) for s in whole.sampled] == [("law.sample", "law.period", 0.5)]
    p = whole.parameters.starts
    z = whole.initial_discrete_state(p)
    assert z.tolist() == [0.0, 0.5, 1.0, 2.0]
    now = (0.0, np.array([26.0]), np.array([3.0, 0.25, 1.0, 2.0]), np.zeros(0), p)
    assert whole.output_values(*now).tolist() == [0.5, 26.0, 3.0, 0.25]
    assert whole.derivatives(*now).tolist() == [0.5 - 0.16]
    (event,), (sampled,) = whole.events, whole.sampled
    assert event.indicator(*now) == 1.0
    x, z = event.reset(*now)
    assert (x.tolist(), z.tolist()) == ([25.0], [4.0, 0.25, 1.0, 2.0])
    # the room's degrees Celsius are the controller's kelvins
    np.testing.assert_allclose(sampled.update(*now), [3.0, 300.0 - 299.15, 299.15, 1.0], rtol=1e-15)


def test_an_event_of_one_component_among_continuous_ones() -> None:
    class Ball(ModelClass):
        h = state(1.0)
        v = state(0.0)

        def derivatives(m):
            return {"h": m.v, "v": -9.81}

        @when(lambda m: m.h)
        def bounce(m):
            return {"h": 0.0, "v": -m.v}

    whole = composed({"lag": LAG, "ball": Ball}, ("ball.h", "lag.u"))
    (event,) = whole.events
    now = (0.0, np.array([3.0, -0.1, -2.0]), np.zeros(0), whole.parameters.starts)
    assert event.indicator(*now) == -0.1
    assert event.reset(*now).tolist() == [3.0, 0.0, 2.0]
