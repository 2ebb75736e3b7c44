"""Events and sampling with solvers that choose their steps; oracles are closed solutions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmu_export.modelling.model import Event, Model, Solver
from fmu_export.modelling.variables import Variable
from tests.support.built_fmus import Built
from tests.support.hybrid_models import BALL, SAMPLED_PI, THERMOSTAT
from tests.support.native_fmus import Host
from tests.support.stiff_models import van_der_pol

pytestmark = pytest.mark.slow  # events with the default solver are tested in test_events.py by default

#: Each solver in one of the FMI versions.
SOLVERS = pytest.mark.parametrize(("solver", "flavour"), [("dopri5", "fmi2"), ("rodas4", "fmi3")])


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    return Built(tmp_path_factory.mktemp("solver_events"))


def run(host: Host, end: float, n: int, names: list[str], values: dict[str, float] | None = None) -> np.ndarray:
    """Values (n, k) after n equal communication steps to the end, and after each before."""
    host.run_up(values)
    found = []
    for i in range(n):
        host.must(host.step(end * i / n, end / n))
        found.append(host.get(names))
    return np.array(found)


@SOLVERS
@pytest.mark.parametrize("n", [1, 7, 300])
def test_a_ball_bounces_where_it_should(built: Built, solver: Solver, flavour: str, n: int) -> None:
    """Six bounces in 3 s, all of them in one communication step, or one a step."""
    with built.host(replace(BALL, solver=solver), flavour) as host:
        found = run(host, 3.0, n, ["h", "v"])
    g, e, begin, speed, height = 9.81, 0.8, 0.0, 0.0, 1.0
    expected = np.empty((n, 2))
    times = 3.0 * np.arange(1, n + 1) / n
    while begin < 3.0:
        t = times[times >= begin] - begin
        expected[times >= begin] = np.stack([height + speed * t - 0.5 * g * t**2, speed - g * t], axis=1)
        flight = (speed + np.sqrt(speed**2 + 2.0 * g * height)) / g
        begin, speed, height = begin + flight, e * (g * flight - speed), 0.0
    np.testing.assert_allclose(found, expected, atol=1e-8)


@SOLVERS
@pytest.mark.parametrize("n", [1, 143])
def test_a_thermostat_switches_where_it_should(built: Built, solver: Solver, flavour: str, n: int) -> None:
    with built.host(replace(THERMOSTAT, solver=solver), flavour) as host:
        found = run(host, 1000.0, n, ["T", "on"])
    times, begin, start, on = 1000.0 * np.arange(1, n + 1) / n, 0.0, 20.0, 0.0
    expected = np.empty((n, 2))
    while begin < 1000.0:
        rest = 10.0 + 30.0 * on
        after = times >= begin
        expected[after, 0] = rest + (start - rest) * np.exp(-(times[after] - begin) / 100.0)
        expected[after, 1] = on
        limit = 22.0 if on else 18.0
        begin += 100.0 * np.log((start - rest) / (limit - rest))
        start, on = limit, 1.0 - on
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@SOLVERS
@pytest.mark.parametrize("n", [1, 30])
def test_a_sampled_controller_samples_when_it_should(built: Built, solver: Solver, flavour: str, n: int) -> None:
    """Communication steps of 2.1 s and of 0.07 s against samples each 0.1 s; between them x decays to the control."""
    with built.host(replace(SAMPLED_PI, solver=solver), flavour) as host:
        found = run(host, 2.05, n, ["x"])[-1, 0]
    x, integral = 0.0, 0.0
    for _ in range(20):
        error = 1.0 - x
        wanted = 2.0 * error + integral + 0.5 * error
        control = min(max(wanted, -1.5), 1.5)
        integral += 0.5 * error if control == wanted else 0.0
        x = control + (x - control) * np.exp(-0.1)
    error = 1.0 - x
    control = min(max(2.0 * error + integral + 0.5 * error, -1.5), 1.5)
    assert found == pytest.approx(control + (x - control) * np.exp(-0.05), rel=1e-6)


@SOLVERS
def test_an_event_in_a_step_as_long_as_the_run_is_found(built: Built, solver: Solver, flavour: str) -> None:
    """A ramp over 1e6 s is one internal step, the event in it is where the ramp is 250,000."""

    def reset(t: Any, x: Any, z: Any, u: Any, p: Any) -> Any:
        return 0.0 * x, np.stack([t])

    model = Model(
        name="Ramp",
        outputs=[Variable("x"), Variable("when", "s")],
        states=["x"],
        discrete=[Variable("when", "s")],
        initial_state=lambda p: np.zeros(1),
        derivatives=lambda t, x, z, u, p: 0.0 * x + 0.5,
        output_values=lambda t, x, z, u, p: np.stack([x[0], z[0]]),
        events=[Event("top", lambda t, x, z, u, p: 250_000.0 - x[0], reset)],
        solver=solver,
    )
    with built.host(model, flavour) as host:
        x, when = run(host, 700_000.0, 1, ["x", "when"])[0]
    assert when == pytest.approx(500_000.0, abs=1e-4)
    assert x == pytest.approx(100_000.0, abs=1e-4)


@pytest.mark.slow
def test_the_jumps_of_a_stiff_oscillator_are_events(built: Built) -> None:
    """The instants at which Van der Pol's oscillator passes 0, in jumps of milliseconds, in steps of 100 s."""
    smooth = van_der_pol()

    def with_z(f: Any) -> Any:
        return lambda t, x, z, u, p: f(t, x, u, p)

    model = replace(
        smooth,
        outputs=[*smooth.outputs.variables, Variable("when", "s"), Variable("count")],
        discrete=[Variable("when", "s"), Variable("count")],
        derivatives=with_z(smooth.derivatives),
        output_values=lambda t, x, z, u, p: np.concatenate([x, z]),
        events=[
            Event(
                "passes",
                lambda t, x, z, u, p: x[0],
                lambda t, x, z, u, p: (x, np.stack([t, z[1] + 1.0])),
                direction="both",
            )
        ],
    )
    with built.host(model) as host:
        when, count = run(host, 1700.0, 17, ["when", "count"])[-1]

    def passes(t: float, x: np.ndarray) -> float:
        return float(x[0])

    p = smooth.parameters.starts
    solution = solve_ivp(
        lambda t, x: smooth.derivatives(t, x, [], p),
        (0.0, 1700.0),
        [2.0, 0.0],
        "Radau",
        rtol=1e-11,
        atol=1e-14,
        events=passes,
    )
    assert len(solution.t_events[0]) == count == 2.0
    assert when == pytest.approx(solution.t_events[0][-1], abs=2e-5)


@SOLVERS
def test_states_with_events_are_saved_and_restored(built: Built, solver: Solver, flavour: str) -> None:
    with built.host(replace(BALL, solver=solver), flavour) as host:
        expected = run(host, 3.0, 10, ["h", "v"])
        host.must(host.call("Reset"))
        host.run_up()
        for i in range(4):
            host.must(host.step(3.0 * i / 10, 0.3))
        state, data = host.save(), host.save_bytes()
        for restore in (lambda: host.restore(state), lambda: host.restore_bytes(data)):
            host.must(restore())
            for i in range(4, 10):
                host.must(host.step(3.0 * i / 10, 0.3))
            assert host.get(["h", "v"]) == list(expected[-1])
        host.forget(state)
