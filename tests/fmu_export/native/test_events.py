"""Events and sampling in native FMUs of both versions, against closed forms.

Co-simulation is called as importers do, with all kinds of communication steps; model exchange by FMPy's CVode.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from cosim import System, simulate
from fmu_export.modelling.model import Event, Model, Sampled
from fmu_export.modelling.variables import Variable
from fmu_export.native.backend import build_native
from tests.support.compilation import shared_compilation
from tests.support.hybrid_models import BALL, HYBRID, SAMPLED_PI, THERMOSTAT
from tests.support.native_fmus import DISCARD, ERROR, FLAVOURS, OK, Host, require_compiler, unpack

#: A lag, and a sampled PI controller for it.
LAG = Model(
    name="Lag",
    inputs=[Variable("u")],
    outputs=[Variable("x")],
    states=["x"],
    initial_state=lambda p: np.zeros(1),
    derivatives=lambda t, x, u, p: u - x,
)
CONTROLLER = Model(
    name="Controller",
    parameters=[v for v in SAMPLED_PI.parameters.variables if v.name not in ("period", "offset")],
    inputs=[Variable("reference", start=1.0), Variable("x")],
    outputs=[Variable("control")],
    discrete=SAMPLED_PI.discrete,
    output_values=lambda t, x, z, u, p: z[1:],
    sampled=[Sampled("controller", lambda t, x, z, u, p: SAMPLED_PI.sampled[0].update(t, u[1:], z, u, p), 0.1)],
)

#: What the core does is the same below both faces of FMI: the slow tests take the other one too.
CORE = pytest.mark.parametrize(
    "flavour", [FLAVOURS[0], *(pytest.param(f, marks=pytest.mark.slow) for f in FLAVOURS[1:])]
)

BOUNCE = math.sqrt(2.0 / 9.81)


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Any, str], Path]:
    """Build a model, or one of HYBRID by its name, when first asked for; the path of the FMU."""
    require_compiler()
    folder = tmp_path_factory.mktemp("hybrid")
    built: dict[tuple[str, str], Path] = {}

    def fmu(model: Any, flavour: str) -> Path:
        model = HYBRID.get(model, model)
        if (model.name, flavour) not in built:
            with shared_compilation():
                built[model.name, flavour] = build_native(model, folder / flavour, flavour)  # type: ignore[arg-type]
        return built[model.name, flavour]

    return fmu


@pytest.fixture(scope="module")
def unpacked(fmus: Callable[[Any, str], Path]) -> Callable[[Any, str], Path]:
    def folder(model: Any, flavour: str) -> Path:
        fmu = fmus(model, flavour)
        return unpack(fmu, fmu.with_suffix("")) if not fmu.with_suffix("").exists() else fmu.with_suffix("")

    return folder


def points(stop: float, step: float, accumulated: bool = False) -> Iterator[tuple[float, float]]:
    """Begin and length of the communication steps; importers that add them up are off by rounding."""
    time = 0.0
    for i in range(round(stop / step)):
        yield time if accumulated else i * step, step
        time += step


def outputs(host: Host, names: list[str], stop: float, step: float, accumulated: bool = False) -> np.ndarray:
    """Time and values at all communication points."""
    rows = [[0.0, *host.get(names)]]
    for time, h in points(stop, step, accumulated):
        host.must(host.step(time, h))
        rows.append([time + h, *host.get(names)])
    return np.array(rows)


def ball(time: float, e: float = 0.8, g: float = 9.81) -> tuple[float, float]:
    """Height and speed."""
    landed, v = math.sqrt(2.0 / g), math.sqrt(2.0 * g)
    if time <= landed:
        return 1.0 - g * time**2 / 2.0, -g * time
    while True:
        v *= e
        if time <= landed + 2.0 * v / g:
            s = time - landed
            return v * s - g * s**2 / 2.0, v - g * s
        landed += 2.0 * v / g


def thermostat(time: float) -> tuple[float, int, int]:
    """Temperature, whether the heater is on, and how often it was switched."""
    start, T, on, n = 0.0, 20.0, 0, 0
    while True:
        rest, limit = (40.0, 22.0) if on else (10.0, 18.0)
        end = start + 100.0 * math.log((T - rest) / (limit - rest))
        if time < end:
            return rest + (T - rest) * math.exp(-(time - start) / 100.0), on, n
        start, T, on, n = end, limit, 1 - on, n + 1


def sampled_pi(time: float, period: float = 0.1, offset: float = 0.0, start: float = 0.0) -> tuple[float, float]:
    """State of the lag, and the control, by the exponential between the sampling instants."""
    x, integral, control, k = 0.0, 0.0, 0.0, max(0, math.ceil((start - offset) / period - 1e-9))
    now = start
    while offset + k * period <= time + 1e-12 * (1.0 + time):
        instant = offset + k * period
        x = control + (x - control) * math.exp(-(instant - now))
        error = 1.0 - x
        unlimited = 2.0 * error + integral + 0.5 * error
        control = min(max(unlimited, -1.5), 1.5)
        integral += 0.5 * error if control == unlimited else 0.0
        now, k = instant, k + 1
    return control + (x - control) * math.exp(-(time - now)), control


@CORE
@pytest.mark.parametrize("name", HYBRID)
def test_fmpy_validates_them(fmus: Any, name: str, flavour: str) -> None:
    assert validate_fmu(str(fmus(name, flavour))) == []


@CORE
@pytest.mark.parametrize("step", [0.1, 0.03, 0.01, 0.001])
def test_ball_bounces_at_the_right_times(unpacked: Any, flavour: str, step: float) -> None:
    with Host(unpacked("Ball", flavour)) as host:
        host.run_up({"max_step": step})
        rows = outputs(host, ["h", "v"], 3.0, step)
    exact = np.array([ball(t) for t in rows[:, 0]])
    # a bounce that is 1e-10 s late leaves an error of 1e-10 times twice the speed
    np.testing.assert_allclose(rows[:, 1], exact[:, 0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(rows[:, 2], exact[:, 1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("solver", ["dopri5", "rodas4"])
@pytest.mark.parametrize("step", [0.1, 0.7])
def test_ball_bounces_with_the_other_solvers(unpacked: Any, solver: Any, step: float) -> None:
    with Host(unpacked(replace(BALL, name=f"Ball_{solver}", solver=solver), "fmi3")) as host:
        host.run_up()
        rows = outputs(host, ["h", "v"], 2.8, step)
    np.testing.assert_allclose(rows[:, 1:], [ball(t) for t in rows[:, 0]], rtol=0, atol=1e-8)


@pytest.mark.parametrize("solver", ["rk4", "dopri5", "rodas4"])
def test_ball_that_keeps_its_height_bounces_too(unpacked: Any, solver: Any) -> None:
    """The reset turns the speed only, so that the height stays below zero by what the location is late."""
    event = replace(BALL.events[0], reset=lambda t, x, u, p: np.stack([x[0], -p[1] * x[1]]))
    model = replace(BALL, name=f"Turned_{solver}", events=[event], solver=solver)
    with Host(unpacked(model, "fmi2")) as host:
        host.run_up()
        rows = outputs(host, ["h", "v"], 3.9, 0.1)
        np.testing.assert_allclose(rows[:, 1], [ball(t)[0] for t in rows[:, 0]], rtol=0, atol=1e-7)
        assert host.step(3.9, 0.5) == DISCARD


@CORE
@pytest.mark.parametrize("e", [0.8, 0.5, 0.1, 0.0])
@pytest.mark.parametrize("step", [0.5, 1e-3])
def test_events_without_time_between_end_in_a_message(unpacked: Any, flavour: str, e: float, step: float) -> None:
    limit = BOUNCE * (1.0 + 2.0 * e / (1.0 - e))
    with Host(unpacked("Ball", flavour)) as host:
        host.run_up({"e": e})
        time, status = 0.0, OK
        while time < limit + 1.0:
            before = host.get(["h", "v"])
            status = host.step(time, step)
            if status != OK:
                break
            time += step
        assert status == DISCARD
        assert limit - step - 1e-6 <= time <= limit
        assert "'bounce' happens again and again without time passing" in host.messages[-1]
        assert host.get(["h", "v"]) == before
        # FMI 3.0: as before the step; FMI 2.0: a state must be restored
        assert host.step(time, step) == (ERROR if flavour == "fmi2" else DISCARD)


@CORE
@pytest.mark.parametrize("step", [0.1, 1.0, 7.0, 130.0])
def test_thermostat_switches(unpacked: Any, flavour: str, step: float) -> None:
    with Host(unpacked("Thermostat", flavour)) as host:
        host.run_up({"max_step": 1.0})
        rows = outputs(host, ["T", "on", "switched"], 1001.0, step)
    exact = np.array([thermostat(t) for t in rows[:, 0]])
    np.testing.assert_allclose(rows[:, 1], exact[:, 0], rtol=0, atol=1e-7)
    np.testing.assert_array_equal(rows[:, 2:], exact[:, 1:])
    assert exact[-1, 2] > 20


@CORE
@pytest.mark.parametrize(
    ("step", "accumulated", "stop"),
    [
        (0.03, False, 3.0),
        (0.1, False, 3.0),
        (0.25, False, 3.0),
        (0.07, True, 3.0),
        (0.1, True, 200.0),
        (0.35, True, 21.0),
    ],
)
def test_sampled_controller(unpacked: Any, flavour: str, step: float, accumulated: bool, stop: float) -> None:
    with Host(unpacked("SampledPI", flavour)) as host:
        host.run_up()
        rows = outputs(host, ["x", "control"], stop, step, accumulated)
    exact = np.array([sampled_pi(t) for t in rows[:, 0]])
    np.testing.assert_allclose(rows[:, 1:], exact, rtol=0, atol=1e-11)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_sampled_controller_at_tiny_steps_and_another_start(unpacked: Any, flavour: str) -> None:
    with Host(unpacked("SampledPI", flavour)) as host:
        host.run_up({"period": 1e-3, "offset": 2.5e-4}, start=1e-4)
        for i in range(3000):
            host.must(host.step(1e-4 + i * 1e-6, 1e-6))
        np.testing.assert_allclose(
            host.get(["x", "control"]), sampled_pi(3.1e-3, 1e-3, 2.5e-4, 1e-4), rtol=0, atol=1e-11
        )
    with Host(unpacked("SampledPI", flavour)) as host:
        host.run_up({"offset": 0.025}, start=7.13)
        assert host.get(["control"]) == [0.0]
        host.must(host.step(7.13, 0.6))
        np.testing.assert_allclose(host.get(["x", "control"]), sampled_pi(7.73, 0.1, 0.025, 7.13), rtol=0, atol=1e-11)


@CORE
@pytest.mark.parametrize("step", [0.05, 0.01, 0.3, 0.07, 1.05])
def test_samplers_of_different_periods(unpacked: Any, flavour: str, step: float) -> None:
    """Both at 0.2, 0.5, 0.8: there the slow one sees what the fast one had counted before."""
    with Host(unpacked("Samplers", flavour)) as host:
        host.run_up()
        rows = outputs(host, ["fast", "slow", "seen"], 2.1, step)
    for time, fast, slow, seen in rows:
        n_fast = math.floor(time / 0.1 + 1e-9) + 1
        n_slow = math.floor((time - 0.05) / 0.15 + 1e-9) + 1 if time > 0.049 else 0
        assert (fast, slow) == (n_fast, n_slow)
        last = 0.05 + 0.15 * (n_slow - 1)
        assert seen == (math.ceil(last / 0.1 - 1e-9) if n_slow else 0)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_what_happens_at_a_communication_point_sees_the_inputs_set_there(unpacked: Any, flavour: str) -> None:
    with Host(unpacked("Hold", flavour)) as host:
        host.run_up({"u": 1.0})
        assert host.get(["y", "switched"]) == [1.0, 0.0]
        host.must(host.set({"u": 2.0}))
        assert host.get(["y"]) == [2.0]
        host.must(host.step(0.0, 0.05))
        host.must(host.set({"u": 3.0}))
        assert host.get(["y"]) == [2.0]
        host.must(host.step(0.05, 0.05))
        assert host.get(["y"]) == [3.0]
        host.must(host.set({"u": 4.0, "v": 1.0}))
        assert host.get(["y", "switched", "when"]) == [4.0, 1.0, 0.1]
        host.must(host.set({"v": 0.0}))  # with this input nothing has been switched
        assert host.get(["y", "switched", "when"]) == [4.0, 0.0, 0.0]
        host.must(host.set({"v": 1.0}))
        host.must(host.step(0.1, 0.2))
        assert host.get(["y", "switched", "when"]) == [4.0, 1.0, 0.1]
        host.must(host.set({"v": 0.0}))
        host.must(host.step(0.3, 0.01))
        host.must(host.set({"v": 1.0}))
        host.must(host.step(0.31, 0.01))
        assert host.get(["switched", "when"]) == [2.0, 0.31]
    description = fmpy.read_model_description(str(unpacked("Hold", flavour)))
    dependencies = {o.variable.name: [v.name for v in o.dependencies] for o in description.outputs}
    assert dependencies == {"y": ["u"], "switched": ["v"], "when": ["v"]}
    assert {v.name: v.variability for v in description.modelVariables if v.causality == "output"} == dict.fromkeys(
        dependencies, "discrete"
    )


def test_samplers_see_inputs_that_change_linearly(unpacked: Any) -> None:
    with Host(unpacked("Hold", "fmi2")) as host:
        host.run_up({"u": 1.0})
        host.must(host.set_rates({"u": 2.0, "v": 10.0}))
        host.must(host.step(0.0, 0.25))
        np.testing.assert_allclose(host.get(["y", "switched", "when"]), [1.4, 1.0, 0.05], rtol=0, atol=1e-10)
    asked: list[float] = []

    def update(time: float) -> None:
        asked.append(time)
        host.must(host.set({"u": 10.0 * time, "v": 4.0 * time}))

    with Host(unpacked("Hold", "fmi3"), intermediate_update=update) as host:
        host.run_up({"max_step": 10.0})
        host.must(host.step(0.0, 0.25))
        np.testing.assert_allclose(asked[:4], [0.05, 0.1, 0.15, 0.2])
        assert asked[-1] == 0.25
        np.testing.assert_allclose(
            host.get(["y", "u", "v", "switched", "when"]), [2.0, 2.5, 1.0, 1.0, 0.125], rtol=0, atol=1e-10
        )


@CORE
@pytest.mark.parametrize("step", [0.05, 0.1, 0.07, 0.25, 0.2])
@pytest.mark.parametrize("max_step", [1e-3, 0.013, 1.0])
def test_at_one_instant_samplers_come_before_events(unpacked: Any, flavour: str, step: float, max_step: float) -> None:
    with Host(unpacked("Coincidence", flavour)) as host:
        host.run_up({"max_step": max_step})
        rows = outputs(host, ["hits", "seen"], 0.5, step)
    for time, hits, seen in rows:
        if abs(time - 0.2) > 1e-9:  # else rounding decides
            assert hits == (time >= 0.2), time
        assert seen == (math.floor(time / 0.1 + 1e-9) >= 3), time


@CORE
@pytest.mark.parametrize("step", [0.1, 0.23, 0.5, 3.0, 0.05])
def test_directions_of_crossings_without_states(unpacked: Any, flavour: str, step: float) -> None:
    """At multiples of half a second, some of them communication points; the crossing that begins at zero is none."""
    with Host(unpacked("Crossings", flavour)) as host:
        host.run_up({"max_step": 0.1})
        assert host.get(["falls", "rises", "all"]) == [0.0, 0.0, 0.0]
        rows = outputs(host, ["falls", "rises", "all", "last"], 2.99, step)
    for time, falls, rises, both, last in rows:
        if abs(2.0 * time - round(2.0 * time)) < 1e-6:
            continue  # rounding decides
        n = math.floor(2.0 * time)
        assert (falls, rises, both) == ((n + 1) // 2, n // 2, n)
        assert last == pytest.approx(n / 2.0, abs=1e-10)


@CORE
def test_rounding_of_times_makes_no_crossings(unpacked: Any, flavour: str) -> None:
    """The time of an event, added up in different ways, is on different sides of a crossing."""
    random = np.random.default_rng(3)
    for _ in range(60):
        f = random.uniform(0.3, 3.0)
        with Host(unpacked("Crossings", flavour)) as host:
            host.run_up({"f": f, "max_step": random.choice([0.01, 0.08 / f])})
            time = 0.0
            for h in random.uniform(1e-4, 1.5, 5):
                host.must(host.step(time, h))
                time += h
            n = math.floor(2.0 * f * time)
            assert host.get(["falls", "rises", "all"]) == [(n + 1) // 2, n // 2, n]
            assert host.get(["last"])[0] == pytest.approx(n / 2.0 / f, abs=1e-10)


@CORE
def test_an_event_at_a_communication_point_happens_once(unpacked: Any, flavour: str) -> None:
    """The state arrives at zero to the last bit there, and goes on."""
    with Host(unpacked("Coincidence", flavour)) as host:
        host.run_up({"max_step": 0.125})
        host.must(host.step(0.0, 0.2))
        assert host.get(["x"]) == [0.0]
        assert host.get(["hits"]) == [1.0]
        host.must(host.step(0.2, 0.2))
        host.must(host.step(0.4, 0.2))
        assert host.get(["hits"]) == [1.0]


@CORE
@pytest.mark.parametrize("step", [1.0, 0.5, 0.25])
def test_two_crossings_in_one_step(unpacked: Any, flavour: str, step: float) -> None:
    with Host(unpacked("Dip", flavour)) as host:
        host.run_up({"max_step": 1.0})
        rows = outputs(host, ["falls", "rises", "last"], 1.0, step)
    np.testing.assert_allclose(rows[-1, 1:], [1.0, 1.0, 0.51], rtol=0, atol=1e-10)


@pytest.mark.parametrize("step", [0.1, 1.5])
def test_many_events_at_one_instant(unpacked: Any, step: float) -> None:
    with Host(unpacked("Balls", "fmi3")) as host:
        host.run_up({"max_step": 0.05})
        rows = outputs(host, [f"h[{i + 1}]" for i in range(30)], 3.0, step)
    for time, *heights in rows:
        np.testing.assert_allclose(heights, ball(time)[0], rtol=0, atol=1e-10)


@CORE
def test_events_set_each_other_off(unpacked: Any, flavour: str) -> None:
    names = [f"z[{i}]" for i in (1, 2, 3, 4)]
    with Host(unpacked("Chain", flavour)) as host:
        host.run_up()
        host.must(host.step(0.0, 0.1))
        assert host.get(names) == [0.0] * 4
        host.must(host.set({"u": 1.0}))
        assert host.get(names) == [1.0, 1.0, 0.0, 1.0]
    with Host(unpacked("Chain", flavour)) as host:
        host.run_up({"endless": 1.0})
        host.must(host.step(0.0, 0.1))
        host.must(host.set({"u": 1.0}))
        assert host.tried(lambda: host.step(0.1, 0.1)) == ERROR
        assert "events set each other off without end" in host.messages[-1]
        host.must(host.set({"u": 0.0}))  # nothing has happened
        host.must(host.step(0.1, 0.1))
        assert host.get(names) == [0.0] * 4


RUNS = {
    "Ball": (["h", "v"], {"max_step": 0.02}, {}),
    "Thermostat": (["T", "on", "switched"], {"tau": 0.5, "rate": 60.0}, {"ambient": 12.0}),
    "SampledPI": (["x", "control", "integral"], {"offset": 0.03}, {"reference": -0.5}),
    "Hold": (["y", "switched", "when"], {}, {"u": 2.0, "v": 1.0}),
    "Crossings": (["falls", "rises", "all", "last"], {}, {}),
}


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("name", RUNS)
def test_a_saved_state_goes_on_as_it_would_have(unpacked: Any, name: str, flavour: str) -> None:
    """Also where something happens at the point of saving, whether or not that was looked at, and with other inputs."""
    names, start, inputs = RUNS[name]

    def rest(host: Host, at: int) -> list[list[float]]:
        rows = []
        for i in range(at, 30):
            if i == at + 2 and inputs:
                host.must(host.set(inputs))
            host.must(host.step(i * 0.1, 0.1))
            rows.append(host.get(names))
        return rows

    with Host(unpacked(name, flavour)) as host, Host(unpacked(name, flavour)) as other:
        host.run_up(start)
        other.run_up(start)
        for at in range(12):
            before, bytes_before = host.save(), host.save_bytes()
            if at % 2:
                host.get(names)
                assert host.save_bytes() == bytes_before  # looking changes nothing
            expected = rest(host, at)
            host.must(host.restore(before))
            assert host.save_bytes() == bytes_before
            assert rest(host, at) == expected
            other.must(other.restore_bytes(bytes_before))
            assert rest(other, at) == expected
            host.must(host.restore(before))
            host.forget(before)
            host.must(host.step(at * 0.1, 0.1))
        host.must(host.call("Reset"))
        host.run_up(start)
        with Host(unpacked(name, flavour)) as fresh:
            fresh.run_up(start)
            assert rest(host, 0) == rest(fresh, 0)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_damaged_state_is_refused(unpacked: Any, flavour: str) -> None:
    with Host(unpacked("Thermostat", flavour)) as host:
        host.run_up()
        data = bytearray(host.save_bytes())
        for place in range(40, len(data), 97):
            damaged = bytearray(data)
            damaged[place] ^= 0x55
            assert host.restore_bytes(bytes(damaged)) == ERROR


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_samplers_refuse_periods_and_times_that_make_no_sense(unpacked: Any, flavour: str) -> None:
    for period, said in ((0.0, "must be positive"), (-0.1, "must be positive"), (1e-300, "too short to count")):
        with Host(unpacked("SampledPI", flavour)) as host:
            host.must(host.set({"period": period}))
            host.must(host.enter(1.0))
            assert host.exit() == ERROR
            assert said in host.messages[-1]
    with Host(unpacked("SampledPI", flavour)) as host:
        host.run_up()
        host.must(host.step(0.0, 0.1))
        assert host.tried(lambda: host.step(0.5, 0.1)) == ERROR
        assert "this FMU is at 0.1" in host.messages[-1]
        host.must(host.step(0.1, 0.1))
    with Host(unpacked("SampledPI", flavour)) as host:
        host.run_up({"period": 1e-9})
        assert host.step(0.0, 1.0) == DISCARD
        assert "make it shorter" in host.messages[-1]


@CORE
def test_what_is_not_finite_is_refused_by_name(unpacked: Any, flavour: str) -> None:
    lost = Model(
        name="Lost",
        inputs=[Variable("u", start=1.0), Variable("v", start=1.0), Variable("w", start=1.0)],
        outputs=[Variable("z")],
        discrete=[Variable("z")],
        output_values=lambda t, x, z, u, p: z,
        events=[Event("root", lambda t, x, z, u, p: np.sqrt(u[0]) - 0.5, lambda t, x, z, u, p: (x, z + 1.0 / u[1]))],
        sampled=[Sampled("look", lambda t, x, z, u, p: np.log(u[2:]), 0.1)],
    )
    for inputs, said in (
        ({"u": -1.0}, "the indicator of 'root' is not finite"),
        ({"u": 0.01, "v": 0.0}, "'root' makes states that are not finite"),
        ({"w": 0.0}, "'look' makes discrete states that are not finite"),
    ):
        with Host(unpacked(lost, flavour)) as host:
            host.run_up()
            host.must(host.step(0.0, 0.1))
            host.must(host.set(inputs))
            assert host.tried(lambda: host.step(0.1, 0.1)) == DISCARD
            assert said in host.messages[-1]
            host.must(host.set({"u": 1.0, "v": 1.0, "w": 1.0}))
            host.must(host.step(0.1, 0.1))


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_directional_derivatives_hold_the_discrete_states(unpacked: Any, flavour: str) -> None:
    with Host(unpacked("SampledPI", flavour)) as host:
        host.run_up()
        host.must(host.step(0.0, 0.35))
        assert host.direction(["x", "control", "der(x)"], {"x": 1.0, "reference": 1.0}) == (OK, [1.0, 0.0, -1.0])
    with Host(unpacked("Thermostat", flavour)) as host:
        host.run_up()
        host.must(host.step(0.0, 30.0))
        assert host.get(["on"]) == [1.0]
        assert host.direction(["der(T)"], {"T": 1.0, "low": 1.0, "rate": 2.0}) == (OK, [2.0 - 0.01])


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_tunable_parameter_of_an_event_has_effect_between_steps(unpacked: Any, flavour: str) -> None:
    with Host(unpacked("Thermostat", flavour)) as host:
        host.run_up()
        host.must(host.step(0.0, 1.0))
        assert host.get(["on"]) == [0.0]
        host.must(host.set({"low": 20.5}))
        assert host.get(["on", "switched"]) == [1.0, 1.0]
        host.must(host.step(1.0, 1.0))
        assert host.get(["on"]) == [1.0]


@CORE
@pytest.mark.parametrize("step", [0.1, 0.05, 0.025])
def test_a_sampled_controller_and_its_plant_as_two_fmus(fmus: Any, flavour: str, step: float) -> None:
    """Exact, since the controller's output is that of its input at the same instant, and held after it."""
    system = System()
    system.add("controller", fmus(CONTROLLER, flavour))
    system.add("plant", fmus(LAG, flavour))
    system.connect("plant.x", "controller.x")
    system.connect("controller.control", "plant.u")
    results = simulate(system, 3.0, step)
    exact = np.array([sampled_pi(t) for t in results["time"]])
    np.testing.assert_allclose(results["plant.x"], exact[:, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(results["controller.control"], exact[:, 1], rtol=0, atol=1e-12)


def by_fmpy(fmu: Path, names: list[str], stop: float, interval: float, **start: float) -> np.ndarray:
    rows = fmpy.simulate_fmu(
        str(fmu),
        fmi_type="ModelExchange",
        stop_time=stop,
        output_interval=interval,
        relative_tolerance=1e-10,
        output=names,
        start_values=start,
    )
    return np.array([rows[n] for n in ["time", *names]]).T


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_model_exchange(fmus: Any, flavour: str) -> None:
    rows = by_fmpy(fmus("Ball", flavour), ["h"], 3.0, 0.01)
    np.testing.assert_allclose(rows[:, 1], [ball(t)[0] for t in rows[:, 0]], rtol=0, atol=1e-8)
    rows = by_fmpy(fmus("Thermostat", flavour), ["T", "switched"], 1000.0, 10.0)
    exact = np.array([thermostat(t) for t in rows[:, 0]])
    np.testing.assert_allclose(rows[:, 1], exact[:, 0], rtol=0, atol=1e-5)
    assert rows[-1, 2] == exact[-1, 2]
    rows = by_fmpy(fmus("SampledPI", flavour), ["x"], 2.1, 0.07, offset=0.03)
    np.testing.assert_allclose(rows[:, 1], [sampled_pi(t, offset=0.03)[0] for t in rows[:, 0]], rtol=0, atol=1e-7)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_model_exchange_has_time_events_and_indicators(unpacked: Any, flavour: str) -> None:
    with Host(unpacked("Coincidence", flavour), "ModelExchange") as host:
        host.run_up()
        assert host.new_discrete_states() == (False, 0.1)
        host.must(host.call("EnterContinuousTimeMode"))
        host.must(host.call("SetTime", 0.05))
        host.must(host.set_states([-0.15]))
        assert host.indicators(1) == [-0.15]
        assert host.get(["hit.indicator"]) == [-0.15]
        assert not host.completed_step()
        host.must(host.call("SetTime", 0.1))
        assert host.completed_step()
        host.must(host.call("EnterEventMode"))
        assert host.new_discrete_states() == (False, 0.2)
        assert host.new_discrete_states() == (False, 0.2)
        host.must(host.call("EnterContinuousTimeMode"))
        host.must(host.call("SetTime", 0.2))
        host.must(host.set_states([1e-9]))
        assert host.completed_step()
        host.must(host.call("EnterEventMode"))
        assert host.get(["hits"]) == [0.0]
        assert host.new_discrete_states()[1] == pytest.approx(0.3)
        assert host.get(["hits", "seen"]) == [1.0, 0.0]
        host.must(host.call("SetTime", 0.5))
        assert host.update() == ERROR
        assert "stop at each instant" in host.messages[-1]
    with Host(unpacked("Ball", flavour), "ModelExchange") as host:
        host.run_up()
        assert host.new_discrete_states() == (False, None)
        host.must(host.call("EnterContinuousTimeMode"))
        host.must(host.set_states([-1e-9, -4.0]))
        host.must(host.call("EnterEventMode"))
        assert host.new_discrete_states() == (True, None)
        assert host.get_states(2) == [0.0, 3.2]
        state = host.save_bytes()
        host.must(host.call("EnterContinuousTimeMode"))
        host.must(host.set_states([-1e-9, -1.0]))
        host.must(host.call("EnterEventMode"))
        assert host.new_discrete_states() == (True, None)  # it had begun at zero, and fallen again
        host.must(host.restore_bytes(state))
        assert host.get_states(2) == [0.0, 3.2]


@pytest.mark.slow
def test_thermostat_with_other_solvers(unpacked: Any) -> None:
    for solver in ("dopri5", "rodas4"):
        model = replace(THERMOSTAT, name=f"Thermostat_{solver}", solver=solver)  # type: ignore[arg-type]
        with Host(unpacked(model, "fmi2")) as host:
            host.run_up()
            rows = outputs(host, ["T", "on", "switched"], 1000.0, 25.0)
        exact = np.array([thermostat(t) for t in rows[:, 0]])
        np.testing.assert_allclose(rows[:, 1], exact[:, 0], rtol=0, atol=1e-4)
        np.testing.assert_array_equal(rows[:, 2:], exact[:, 1:])
