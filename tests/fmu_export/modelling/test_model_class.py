"""Models as classes: what they become is the flat model that one would write, and what does not fit is refused."""

from __future__ import annotations

import re
from enum import IntEnum
from typing import Any

import numpy as np
import pytest

from fmu_export import (
    DefaultExperiment,
    Layout,
    Model,
    ModelClass,
    compose,
    discrete,
    every,
    local,
    output,
    parameter,
    require,
    state,
    to_control,
    when,
)
from fmu_export import input as input_
from fmu_export.errors import ArgumentError, TraceError
from fmu_export.trace.trace import trace


class Pendulum(ModelClass, name="TwoPendulums", stop_time=5.0, step_size=0.002):
    """Two pendulums on one motor.

    The second line is for readers of the source.
    """

    L = parameter([0.5, 0.8], "m", "Lengths", min=0.1)
    g = parameter(9.81, "m/s2")
    q = state([0.1, 0.2], "rad", "Angles")
    w = state(0.0, "rad/s", size=2)
    heat = state(0.0, "J")
    torque = input_(0.0, "s-2")
    height = output("m", "Heights", size=2)
    total = output("m")

    def gravity(m):
        return m.g / m.L * np.sin(m.q)

    def derivatives(m):
        return {"w": m.torque * np.cos(m.t) - m.gravity(), "heat": m.w @ m.w, "q": m.w}

    def outputs(m):
        height = -m.L * np.cos(m.q)
        return {"total": height[0] + height[1], "height": height}

    @require("g must be positive")
    def gravity_is_positive(m):
        return m.g


class Started(Pendulum, solver="dopri5"):
    """Starts where its end is."""

    x_end = parameter(0.3, "m")

    def initial(m):
        return {"q": np.arcsin(m.x_end / m.L)}

    @require("x_end is out of reach", at="start")
    def within_reach(m):
        return np.min(m.L) - m.x_end


def test_a_class_becomes_the_flat_model_that_one_would_write() -> None:
    model = Pendulum.model()
    assert isinstance(model, Model)
    assert (model.name, model.description) == ("TwoPendulums", "Two pendulums on one motor.")
    assert model.default_experiment == DefaultExperiment(stop_time=5.0, step_size=0.002)
    assert model.solver == "rk4"
    assert model.states == ("q", "w", "heat")
    assert model.parameters.names == (
        *("L[1]", "L[2]", "g"),
        *("q_start[1]", "q_start[2]", "w_start[1]", "w_start[2]", "heat_start"),
    )
    assert model.parameters.starts.tolist() == [0.5, 0.8, 9.81, 0.1, 0.2, 0.0, 0.0, 0.0]
    assert model.inputs.names == ("torque",)
    assert model.outputs.names == ("q[1]", "q[2]", "w[1]", "w[2]", "heat", "height[1]", "height[2]", "total")
    units = {v.name: (v.unit, v.description) for v in (*model.parameters.variables, *model.outputs.variables)}
    assert units["L"] == ("m", "Lengths")
    assert units["q"] == ("rad", "Angles")
    assert units["q_start"] == ("rad", "Start of q: Angles")
    assert units["heat_start"] == ("J", "Start of heat")
    assert {v.name: v.min for v in model.parameters.variables}["L"] == 0.1


def test_its_functions_are_those_of_the_methods() -> None:
    model = Pendulum.model()
    rng = np.random.default_rng(1)
    p = rng.uniform(0.5, 2.0, 8)
    x, u, t = rng.normal(size=5), rng.normal(size=1), 0.7
    q, w = x[:2], x[2:4]
    acceleration = u[0] * np.cos(t) - p[2] / p[:2] * np.sin(q)
    np.testing.assert_array_equal(model.derivatives(t, x, u, p), [*w, *acceleration, w @ w])
    height = -p[:2] * np.cos(q)
    np.testing.assert_array_equal(model.output_values(t, x, u, p), [*x, *height, height[0] + height[1]])
    np.testing.assert_array_equal(model.initial_state(p), p[3:])
    (requirement,) = model.requirements
    assert (requirement.message, requirement.at) == ("g must be positive", "step")
    assert requirement.margin(t, x, u, p) == p[2]


def test_it_is_traced_to_the_same_as_numpy() -> None:
    traced = trace(Pendulum)
    rng = np.random.default_rng(2)
    p, x, u = rng.uniform(0.5, 2.0, 8), rng.normal(size=5), rng.normal(size=1)
    for f, g in ((traced.derivatives, traced.model.derivatives), (traced.outputs, traced.model.output_values)):
        np.testing.assert_allclose(f(0.3, x, u, p).full().ravel(), g(0.3, x, u, p), rtol=1e-14)
    assert trace(Pendulum) is trace(Pendulum.model())


def test_other_start_values_by_keyword() -> None:
    model = Pendulum(g=1.62, L=1.0, q_start=[0.3, 0.4], torque=2.0).model()
    assert model.parameters.starts.tolist() == [1.0, 1.0, 1.62, 0.3, 0.4, 0.0, 0.0, 0.0]
    assert model.inputs.starts.tolist() == [2.0]
    assert Pendulum.model().parameters.starts[2] == 9.81


def test_methods_can_be_called_by_hand_at_the_start() -> None:
    m: Any = Pendulum(g=1.62, L=1.0, q_start=[0.3, 0.4], torque=2.0)
    np.testing.assert_array_equal(m.q, [0.3, 0.4])
    np.testing.assert_array_equal(m.derivatives()["w"], 2.0 - 1.62 * np.sin([0.3, 0.4]))
    assert m.gravity().shape == (2,)
    assert Pendulum().t == 0.0


def test_a_class_inherits_variables_methods_and_settings() -> None:
    model = Started.model()
    assert (model.name, model.description) == ("Started", "Starts where its end is.")
    assert model.default_experiment.stop_time == 5.0
    assert model.parameters.names == ("L[1]", "L[2]", "g", "x_end", "w_start[1]", "w_start[2]", "heat_start")
    p = model.parameters.starts
    np.testing.assert_array_equal(model.initial_state(p), [*np.arcsin(0.3 / p[:2]), 0.0, 0.0, 0.0])
    assert [r.at for r in model.requirements] == ["step", "start"]
    assert model.requirements[1].margin(None, None, None, p) == pytest.approx(0.2)

    class Damped(Started, stop_time=8.0):
        d = parameter(0.1, "s-1")
        g = parameter(3.7, "m/s2", "On Mars")
        heat = None  # type: ignore[assignment]

        def derivatives(m):
            rates = super().derivatives()
            return {"q": rates["q"], "w": rates["w"] - m.d * m.w}

        gravity_is_positive = None  # type: ignore[assignment]

    model = Damped.model()
    assert (model.description, model.solver) == ("Starts where its end is.", "dopri5")
    assert model.default_experiment == DefaultExperiment(stop_time=8.0, step_size=0.002)
    assert model.states == ("q", "w")
    assert dict(zip(model.parameters.names, model.parameters.starts, strict=True))["g"] == 3.7
    assert [r.at for r in model.requirements] == ["start"]
    assert Started.model().states == ("q", "w", "heat")


def test_a_class_without_states_or_outputs() -> None:
    class Sum(ModelClass):
        a = input_(1.0)
        b = input_(2.0)
        y = output()

        def outputs(self):
            return {"y": self.a + self.b}

    model = Sum.model()
    assert model.description == ""
    assert model.output_values(0.0, np.zeros(0), np.array([1.0, 5.0]), np.zeros(0)).tolist() == [6.0]
    assert trace(Sum).outputs(0, [], [3, 4], []).full().tolist() == [[7.0]]

    class Nothing(ModelClass):
        pass

    assert len(Nothing.model().outputs) == 0


def test_a_class_in_a_composition_and_in_python_control() -> None:
    class Load(ModelClass):
        speed = input_(0.0, "rad/s", size=2)
        lost = output("rad/s")

        def outputs(m):
            return {"lost": m.speed[0] - m.speed[1]}

    whole = compose(
        "Whole", "", {"a": Pendulum, "b": Load()}, [("a.w", "b.speed")], DefaultExperiment(stop_time=1.0, step_size=0.1)
    )
    assert whole.states == ("a.q", "a.w", "a.heat")
    x = np.array([0.0, 0.0, 3.0, 1.0, 0.0])
    assert whole.output_values(0.0, x, np.zeros(1), whole.parameters.starts)[-1] == 2.0
    system = to_control(Pendulum(g=1.0), parameters={"L": [1.0, 2.0]})
    np.testing.assert_allclose(system.dynamics(0.0, [0.5, 0.0, 0.0, 0.0, 0.0], [0.0])[2], -np.sin(0.5))


def test_locals_and_what_importers_show_values_by() -> None:
    class Drum(ModelClass):
        length = parameter(2.0, "m", display_unit="mm")
        turns = state(0.0, "rad", nominal=100.0, output=False)
        speed = state(1.0, "rad/s", display_unit="rpm")
        wound = output("m", nominal=1e3)
        rest = local("m", "What is not wound yet", size=2)

        def derivatives(m):
            return {"turns": m.speed, "speed": -m.speed}

        def outputs(m):
            return {"wound": 0.1 * m.turns, "rest": m.length - np.stack([0.1, 0.2]) * m.turns}

    model = Drum.model()
    assert (model.outputs.names, model.locals.names) == (("speed", "wound"), ("turns", "rest[1]", "rest[2]"))
    x = np.array([5.0, 3.0])
    values = model.output_values(0.0, x, np.zeros(0), np.array([2.0, 0.0, 0.0]))
    assert values.tolist() == [3.0, 0.5, 1.5, 1.0]
    declared = {v.name: v for v in (*model.parameters.variables, *model.computed.variables)}
    assert [declared[n].nominal for n in ("turns", "turns_start", "wound", "speed")] == [100.0, 100.0, 1e3, None]
    assert [declared[n].display_unit for n in ("length", "speed", "speed_start", "rest")] == ["mm", "rpm", "rpm", None]
    assert trace(Drum).outputs(0.0, x, [], [2.0, 0.0, 0.0]).full().ravel().tolist() == [3.0, 0.5, 5.0, 1.5, 1.0]


class Mode(IntEnum):
    """What a device does."""

    OFF = 1
    HEAT = 2
    COOL = 5


class Typed(ModelClass):
    """Values that are no reals, and arrays."""

    stages = parameter(3, type="integer", min=1)
    fluid = parameter("oil", items=("water", "oil"))
    active = parameter([True, False])
    wanted = input_(Mode.OFF)
    A = parameter([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "m")
    x = state(0.0, "m", size=(2, 2))
    mode = discrete(Mode.HEAT)
    M = discrete(np.eye(2))
    hot = output(type="boolean")
    B = output("m", size=(3, 2))
    count = local(type="integer")

    def derivatives(m):
        return {"x": -m.x + m.A[:, :2]}

    def outputs(m):
        return {"hot": m.mode == Mode.HEAT, "B": m.A.T, "count": m.stages * np.where(m.active[0], 2, 1) + m.fluid}

    @every(0.1)
    def sample(m):
        return {"mode": np.where(m.wanted == Mode.OFF, m.mode, m.wanted), "M": m.M @ m.x}


def test_types_and_shapes() -> None:
    model = Typed.model()
    types = {v.name: v.type for v in (*model.parameters.variables, *model.inputs.variables, *model.computed.variables)}
    assert [types[n] for n in ("stages", "fluid", "active", "wanted", "A", "mode", "mode_start", "hot", "count")] == [
        *("integer", "string", "boolean", "enumeration", "real", "enumeration", "enumeration", "boolean", "integer")
    ]
    assert dict(model.inputs.variables[0].items) == {"OFF": 1, "HEAT": 2, "COOL": 5}
    assert model.parameters.names[:10] == (
        *("stages", "fluid", "active[1]", "active[2]"),
        *("A[1,1]", "A[1,2]", "A[1,3]", "A[2,1]", "A[2,2]", "A[2,3]"),
    )
    p, x, u = model.parameters.starts, np.arange(4.0), np.array([5.0])
    z = model.initial_discrete_state(p)
    assert z.tolist() == [2.0, 1.0, 0.0, 0.0, 1.0]
    assert model.derivatives(0.0, x, z, u, p).tolist() == [1.0, 1.0, 2.0, 2.0]
    values = model.output_values(0.0, x, z, u, p)
    assert values.tolist() == [*x, *z, 1.0, 1.0, 4.0, 2.0, 5.0, 3.0, 6.0, 7.0]
    assert model.sampled[0].update(0.0, x, z, u, p).tolist() == [5.0, *x]
    assert model.sampled[0].update(0.0, x, z, [1.0], p)[0] == 2.0
    traced = trace(Typed)
    found = traced.outputs(*(dict(t=0.0, x=x, z=z, u=u, p=p)[a] for a in "txupz")).full().ravel()
    assert sorted(found.tolist()) == sorted(values.tolist())


def test_start_values_by_keyword_are_those_of_the_type() -> None:
    model = Typed(fluid="water", active=False, wanted=Mode.COOL, mode_start="COOL", A=np.zeros((2, 3))).model()
    assert model.parameters.starts[:10].tolist() == [3.0, 0.0, 0.0, 0.0, *[0.0] * 6]
    assert model.inputs.starts.tolist() == [5.0]
    assert model.initial_discrete_state(model.parameters.starts)[0] == 5.0
    for wrong, message in (
        ({"fluid": "milk"}, "the start value is 'milk'; it must be one of 'water', 'oil'"),
        ({"stages": 2.5}, "the start value is 2.5, which is not a whole number"),
        ({"active": 2}, "the start value is 2, which is neither true nor false"),
        ({"A": np.zeros((3, 2))}, "variable 'A' has 2 x 3 elements but 3 x 2 start values"),
    ):
        with pytest.raises(ArgumentError, match=re.escape(f"Typed({next(iter(wrong))}=...): ")) as caught:
            Typed(**wrong)
        assert message in str(caught.value)


def variant(**body: Any) -> Any:
    """A subclass of Pendulum."""
    return lambda: type("Variant", (Pendulum,), body).model()  # type: ignore[attr-defined]


def rates(**changed: Any) -> Any:
    """A subclass with other derivatives."""
    return variant(derivatives=lambda m: {"q": m.w, "w": m.w, "heat": 0.0} | {k: f(m) for k, f in changed.items()})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (rates(p=lambda m: 0.0), "Variant.derivatives: it returns 'p', which is not declared"),
        (rates(heta=lambda m: 0.0), "it returns 'heta', which is not declared; did you mean 'heat'"),
        (
            rates(g=lambda m: 0.0),
            "returns 'g', which is a parameter; this method returns derivatives of states only",
        ),
        (rates(q=lambda m: m.qq), "Variant.derivatives: there is no 'qq'; did you mean 'q'"),
        (rates(q=lambda m: m.height), "Variant.derivatives: 'height' is an output, whose value is not known there"),
        (rates(q=lambda m: m.q[0]), "'q' is declared with shape (2,), but what it returns is as a scalar"),
        (rates(q=lambda m: [0.0, 1.0, 2.0]), "'q' is declared with shape (2,), but what it returns is with shape (3,)"),
        (rates(heat=lambda m: m.q), "'heat' is declared as a scalar, but what it returns is with shape (2,)"),
        (rates(heat=lambda m: None), "'heat' is neither a number nor an array of numbers, but NoneType"),
        (rates(heat=lambda m: setattr(m, "g", 1.0)), "'g' can't be set; return what changes, as dict(g=...)"),
        (variant(derivatives=lambda m: {"q": m.w}), "Variant.derivatives: the derivative of 'w' is missing"),
        (variant(derivatives=lambda m: None), "Variant.derivatives: it returns NoneType; return a dictionary"),
        (variant(outputs=lambda m: {"total": 1.0}), "Variant.outputs: the value of 'height' is missing"),
        (
            variant(outputs=lambda m: {"q": m.q}),
            "it returns 'q', which is a state; this method returns outputs and locals that are not states only",
        ),
        (variant(initial=lambda m: {"q": m.w}), "Variant.initial: 'w' is a state, whose value is not known there"),
        (variant(initial=lambda m: {"total": 0.0}), "Variant.initial: it returns 'total', which is an output"),
        (variant(gravity_is_positive=lambda m: 1.0), "Variant.gravity_is_positive hides a method that is marked"),
        (
            variant(both=require("vector")(lambda m: m.q)),
            "Variant.both: one number is asked for, but it is an array of shape (2,)",
        ),
        (
            variant(early=require("speed", at="start")(lambda m: m.w[0])),
            "Variant.early: 'w' is a state, whose value is not known there; compute it from what is: parameters",
        ),
        (
            variant(g=3.7),
            "g hides a parameter; redeclare it, as g = parameter(...), or leave it out by None",
        ),
        (variant(t=parameter(1.0)), "Variant: a variable can't have the name 't'"),
        (variant(_k=parameter(1.0)), "Variant: a variable can't have the name '_k'"),
        (variant(a=(one := parameter(1.0)), b=one), "Variant: 'b' and 'a' are one declaration; write two"),
        (variant(q_start=parameter(1.0)), "variable names are not unique"),
        (variant(k=parameter(1.0, "wibble")), "'wibble' is not defined"),
        (lambda: Pendulum(gg=1.0), "Pendulum(gg=...): there is no parameter or input 'gg'; did you mean 'g'"),
        (lambda: Pendulum(q=1.0), "there is no parameter or input 'q'; did you mean 'q_start'; known are L, g, "),
        (lambda: Pendulum(total=1.0), "Pendulum(total=...): there is no parameter or input 'total'"),
        (lambda: Pendulum(L=[1.0, 2.0, 3.0]), "Pendulum(L=...): variable 'L' has 2 elements but 3 start values"),
        (
            lambda: Pendulum(g="1"),
            "Pendulum(g=...): variable 'g': the start value is '1', which is not a finite number",
        ),
        (lambda: Pendulum().speed, "Pendulum(): there is no 'speed'"),
        (ModelClass, "ModelClass has no variables"),
        (
            lambda: parameter("m"),
            "parameter: the start value 'm' is not a number; write parameter(0.0, 'm') for a unit",
        ),
        (variant(k=input_([1.0, 2.0], size=3)), "Variant: variable 'k' has 3 elements but 2 start values"),
        (variant(k=state([None])), "Variant: variable 'k': a start value is None, which is not a finite number"),
        (lambda: require("x", at="end"), 'require: at=\'end\'; write "start" or "step"'),  # type: ignore[arg-type]
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(wrong: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(message)) as caught:
        wrong()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (variant(derivatives=lambda m: {"q": m.q + None}), "Variant.derivatives: with the start values it fails"),
        (variant(derivatives=lambda m: {"q": m.q + None}), ": TypeError: unsupported operand type(s) for +"),
        (variant(outputs=lambda m: {"total": 1.0 / 0}), ": ZeroDivisionError: "),
        (variant(outputs=lambda m: {"total": [1.0][5]}), "Variant.outputs: with the start values it fails"),
        (variant(initial=lambda m: {"q": m.L.nothing}), "Variant.initial: with the start values it fails"),
        (variant(good=require("speed")(lambda m: {}["w"])), "Variant.good: with the start values it fails"),
        (
            variant(derivatives=lambda m: {"q": [[1.0], [1.0, 2.0]]}),
            "Variant.derivatives: with the start values it fails:",
        ),
        (
            variant(derivatives=lambda m: np.zeros(2) @ np.zeros(3)),
            "it fails (test_model_class.py, line ",
        ),
    ],
)
def test_a_method_that_fails_with_numbers_is_named_in_one_line(wrong: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(message)) as caught:
        wrong()
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value.__cause__, Exception)  # which has the whole traceback


def test_names_stand_in_a_class_once() -> None:
    """Python would let the last one win, and events vanish."""
    for body in (
        "k = parameter(1.0)\n    k = parameter(2.0)",
        "k = parameter(1.0)\n    def k(m): ...",
        "@when(lambda m: m.t)\n    def k(m): ...\n    @when(lambda m: -m.t)\n    def k(m): ...",
    ):
        with pytest.raises(ArgumentError, match="Twice: 'k' is defined twice in the class"):
            exec(f"class Twice(ModelClass):\n    {body}")

    class Fine(ModelClass):
        n = 3
        n = n + 1

        def helper(m): ...

        def helper(m):  # noqa: F811
            return m.n

    assert Fine().helper() == 4


def test_times_of_a_class_are_numbers() -> None:
    for times, message in (
        ({"stop_time": "3"}, "Timed: default experiment: stop_time is '3', which is not a finite number"),
        ({"step_size": 0.0}, "Timed: default experiment: step_size 0.0 is not positive"),
        ({"start_time": 5}, "Timed: default experiment: stop_time 1.0 is not after start_time 5.0"),
    ):
        with pytest.raises(ArgumentError, match=re.escape(message)):
            type("Timed", (ModelClass,), {}, **times)  # type: ignore[call-overload]


def test_a_name_that_only_a_branch_has_is_refused_while_tracing() -> None:
    calls = []

    class Fickle(ModelClass):
        x = state()

        def derivatives(m):
            calls.append(0)
            return {"x": m.x} if len(calls) == 1 else {"x": m.x, "y": 0.0}

    with pytest.raises(TraceError, match=r"Fickle.derivatives: it returns 'y', which is not declared"):
        trace(Fickle)


def test_values_are_where_they_were_declared() -> None:
    """Every element of every variable has its own place, whatever the order in which a method returns them."""
    model = Started.model()
    for layout in (model.parameters, model.outputs):
        np.testing.assert_array_equal(
            Layout(layout.variables).pack(**vars(layout.unpack(np.arange(len(layout))))), np.arange(len(layout))
        )


class Machine(ModelClass):
    """Everything that is not continuous."""

    T_s = parameter(0.1, "s")
    limit = parameter(2.0)
    x = state(1.0)
    v = state([1.0, 2.0])
    u = input_(0.5)
    on = discrete(False)
    count = discrete(0.0, output=False)
    memory = discrete([0.1, 0.2, 0.3])

    def initial(m):
        return {"memory": np.full(3, m.limit), "v": np.stack([m.limit, 1.0])}

    def derivatives(m):
        return {"x": np.where(m.on, -m.x, m.u), "v": -m.v}

    @when(lambda m: m.x - m.limit, "rising")
    def too_much(m):
        return {"on": True, "x": m.limit, "count": m.count + 1.0}

    @when(lambda m: m.x)
    def empty(m):
        return {"on": ~m.on & (m.x < m.limit)}

    @every(T_s, offset=0.05)
    def remember(m):
        return {"memory": np.concatenate([np.stack([m.x]), m.memory[:-1]])}

    @every("T_s")
    def tick(m):
        return {"count": m.count + 10.0}

    @require("x is above 5")
    def bounded(m):
        return 5.0 - m.x - m.count


def test_events_and_samples_become_those_of_the_flat_model() -> None:
    model = Machine.model()
    assert model.parameters.names == ("T_s", "limit", "x_start", "on_start", "count_start")
    assert model.discrete.names == ("on", "count", "memory[1]", "memory[2]", "memory[3]")
    assert model.outputs.names == ("x", "v[1]", "v[2]", "on", "memory[1]", "memory[2]", "memory[3]")
    assert [(e.name, e.direction) for e in model.events] == [("too_much", "rising"), ("empty", "falling")]
    assert [(s.name, s.period, s.offset) for s in model.sampled] == [("remember", "T_s", 0.05), ("tick", "T_s", 0.0)]
    p, u = np.array([0.1, 2.0, 1.0, 1.0, 4.0]), np.array([0.5])
    assert model.initial_state(p).tolist() == [1.0, 2.0, 1.0]
    z = model.initial_discrete_state(p)
    assert z.tolist() == [1.0, 4.0, 2.0, 2.0, 2.0]
    x = np.array([3.0, 1.0, -1.0])
    now = (0.2, x, z, u, p)
    assert model.derivatives(*now).tolist() == [-3.0, -1.0, 1.0]
    assert model.derivatives(0.2, x, 0.0 * z, u, p).tolist() == [0.5, -1.0, 1.0]
    assert model.output_values(*now).tolist() == [*x, 1.0, 2.0, 2.0, 2.0]
    assert [e.indicator(*now) for e in model.events] == [1.0, 3.0]
    new_x, new_z = model.events[0].reset(*now)
    assert (new_x.tolist(), new_z.tolist()) == ([2.0, 1.0, -1.0], [1.0, 5.0, 2.0, 2.0, 2.0])
    new_x, new_z = model.events[1].reset(0.2, [1.0, 1.0, 1.0], np.zeros(5), u, p)
    assert (new_x.tolist(), new_z.tolist()) == ([1.0, 1.0, 1.0], [1.0, 0.0, 0.0, 0.0, 0.0])
    assert model.sampled[0].update(*now).tolist() == [1.0, 4.0, 3.0, 2.0, 2.0]
    assert model.sampled[1].update(*now).tolist() == [1.0, 14.0, 2.0, 2.0, 2.0]
    assert model.requirements[0].margin(*now) == -2.0


def test_methods_of_events_can_be_called_by_hand() -> None:
    m: Any = Machine(x_start=3.0, on_start=True)
    assert m.on is np.True_
    assert m.too_much() == {"on": True, "x": 2.0, "count": 1.0}
    assert m.remember()["memory"].tolist() == [3.0, 2.0, 2.0]


def test_a_model_with_events_without_discrete_states() -> None:
    class Ball(ModelClass):
        e = parameter(0.8)
        h = state(1.0, "m")
        v = state(0.0, "m/s")

        def derivatives(m):
            return {"h": m.v, "v": -9.81}

        @when(lambda m: m.h)
        def bounce(m):
            return {"h": 0.0, "v": -m.e * m.v}

    (event,) = Ball.model().events
    arguments = (0.0, np.array([-0.1, -2.0]), np.zeros(0), np.array([0.5, 1.0, 0.0]))
    assert event.indicator(*arguments) == -0.1
    assert event.reset(*arguments).tolist() == [0.0, 1.0]


def machine(**body: Any) -> Any:
    """A subclass of Machine."""
    return lambda: type("Variant", (Machine,), body).model()  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (machine(tick=every(0.1)(lambda m: {"x": 0.0})), "Variant.tick: it returns 'x', which is a state"),
        (
            machine(tick=every(0.1)(lambda m: {"on": 1.0})),
            "'on' is declared as Boolean, but what it returns is a number",
        ),
        (machine(tick=every("T")(lambda m: {"on": True})), "sampled 'tick': period 'T' is not a scalar parameter"),
        (machine(tick=every(-1)(lambda m: {"on": True})), "sampled 'tick': period -1.0 is not positive"),
        (machine(tick=lambda m: {}), "Variant.tick hides a method that is marked"),
        (machine(empty=when(lambda m: m.v)(lambda m: {})), "Variant.empty: one number is asked for"),
        (machine(empty=when(lambda m: m.y)(lambda m: {})), "Variant.empty: there is no 'y'"),
        (machine(empty=when(lambda m: m.x)(lambda m: {"u": 1.0})), "Variant.empty: it returns 'u', which is an input"),
        (machine(empty=when(lambda m: {})), "Variant.empty: the method needs @when(lambda m: ...) above it"),
        (machine(tick=every(lambda m: {})), "Variant.tick: the method needs @every(period) above it"),
        (machine(bounded=require(lambda m: 1.0)), "Variant.bounded: the method needs @require(message) above it"),
        (machine(initial_state=lambda m: {}), "Variant.initial_state: nothing calls it; the method is initial(m)"),
        (lambda: when("x")(lambda m: {}), "when: the indicator 'x' is not a function"),  # type: ignore[arg-type]
        (lambda: when(len, "down")(lambda m: {}), "when: direction='down'; write"),  # type: ignore[arg-type]
        (
            lambda: every(0.1)(when(lambda m: m.x)(lambda m: {})),
            "a method has one of @when, @every and @require; write two methods",
        ),
    ],
)
def test_events_and_samples_that_do_not_fit_are_refused(wrong: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(message)):
        wrong()
