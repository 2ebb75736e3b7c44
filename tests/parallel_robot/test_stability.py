"""Poles and the largest stable communication step: against python-control and the coupled FMUs themselves."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from pathlib import Path

import control
import numpy as np
import pytest

from cosim import Simulation, SimulationError
from fmu_export.control_backend import to_control
from parallel_robot.continuous_loop import (
    ContinuousSolution,
    closed_loop,
    closed_loop_dynamics,
    controller_inputs,
    initial_state,
    solve,
)
from parallel_robot.metrics import tracking_errors
from parallel_robot.models import MODELS
from parallel_robot.scenario import load_scenario
from parallel_robot.stability import closed_loop_poles, largest_stable_step, linearize_along
from tests.support.native_fmus import DEFAULT_FLAVOUR


def test_closed_loop_is_stable_along_the_path() -> None:
    times, poles = closed_loop_poles(duration=3.0, points=13)
    assert times.shape == (13,)
    assert poles.shape == (13, 6)
    assert poles.real.max() < 0.0
    # psi_2 hardly couples: its pole is that of (90), minus one
    assert np.abs(poles + 1.0).min(axis=1).max() < 1e-3


def largest_error(simulation: Simulation, step: float, start: Mapping[str, float]) -> float:
    """Largest distance (m) of the end effector from the desired path over 15 s; infinite where the run fails."""
    try:
        results = simulation.run(step * round(15.0 / step), step, start=start)
    except SimulationError:
        return math.inf
    errors = tracking_errors(results)
    return float(np.hypot(errors["x"], errors["y"]).max())


#: Gains alpha and beta: those of Table 1, row (1, 1), and others.
GAINS = [None, (2.0, 1.5), (0.8, 2.5)]


@pytest.mark.slow
@pytest.mark.skipif(DEFAULT_FLAVOUR == "pythonfmu", reason="needs a C compiler: pythonfmu's FMUs can only hold inputs")
@pytest.mark.parametrize(
    ("order", "extrapolation", "gains"),
    [
        (order, extrapolation, gains)
        for order in ("sequential", "parallel")
        for extrapolation in ("auto", "hold", "linear")
        for gains in GAINS
    ],
)
def test_runs_are_stable_up_to_the_largest_step_and_not_a_quarter_above(
    robot_fmus: Path, order: str, extrapolation: str, gains: tuple[float, float] | None
) -> None:
    """At the promised step a run stays within ten times the error at half of it, at 1.25 times that step it doesn't."""
    controller = {} if gains is None else {"alpha": gains[0], "beta": gains[1]}
    limit = largest_stable_step({"controller": controller}, order=order, extrapolation=extrapolation)
    start = {f"controller.{name}": value for name, value in controller.items()}
    system = load_scenario("tracking-undisturbed").system(robot_fmus, DEFAULT_FLAVOUR)
    with Simulation(system, order=order, extrapolation=extrapolation) as simulation:
        allowed = 10.0 * largest_error(simulation, limit / 2, start)
        assert allowed < 0.1
        assert largest_error(simulation, limit, start) <= allowed
        assert largest_error(simulation, 1.25 * limit, start) > allowed


def test_the_default_algorithm_is_that_of_a_simulation() -> None:
    parameters = inspect.signature(largest_stable_step).parameters
    of_simulation = inspect.signature(Simulation).parameters
    assert parameters["order"].default == of_simulation["order"].default
    assert parameters["extrapolation"].default == of_simulation["extrapolation"].default


def test_linearisation_is_that_of_python_control() -> None:
    """Complex steps against finite differences; a basis of the free directions takes the plant's matrices."""
    time = np.array([0.7, 1.4])
    solution = solve(np.concatenate([[0.0], time]), rtol=1e-6)
    loop = linearize_along(ContinuousSolution(time, solution.states[1:]))
    plant, controller = loop.components["plant"], loop.components["controller"]
    start = MODELS["trajectory"].parameters.starts
    for i, (t, x) in enumerate(zip(time, solution.states[1:], strict=True)):
        u = controller_inputs(x, MODELS["trajectory"].output_values(t, np.empty(0), np.empty(0), start))
        K = control.linearize(to_control(MODELS["controller"]), x[12:], u, t=t)
        for name in "ABCD":
            np.testing.assert_allclose(getattr(controller, name)[i], getattr(K, name), rtol=1e-4, atol=1e-5)
        tau_a = to_control(MODELS["controller"]).output(t, x[12:], u)[:3]
        P = control.linearize(to_control(MODELS["plant"]), x[:12], np.concatenate([tau_a, np.zeros(5)]), t=t)
        # joint angles and velocities are the first twelve outputs, so these rows are the basis itself
        T = plant.C[i][:12]
        np.testing.assert_allclose(T.T @ T, np.eye(4), atol=1e-9)
        np.testing.assert_allclose(plant.A[i], T.T @ P.A @ T, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(plant.B[i], T.T @ P.B, rtol=1e-4, atol=1e-4)
        smooth = [n != "closure_error" for n in plant.outputs]  # a length, which has a kink where it is 0
        np.testing.assert_allclose(plant.C[i][smooth], (P.C @ T)[smooth], rtol=1e-4, atol=1e-4)


def test_the_fast_continuous_loop_is_that_of_python_control_to_the_last_bit() -> None:
    generator = np.random.default_rng(5)
    for parameters in ({}, {"controller": {"alpha": 2.0, "tau_max": 0.5, "feedforward": 1.0}}):
        system, dynamics = closed_loop(parameters), closed_loop_dynamics(parameters)
        start = initial_state(parameters)
        for _ in range(20):
            x, w = start + 0.1 * generator.standard_normal(14), generator.standard_normal(5)
            t = generator.uniform(0.0, 15.0)
            assert (system.dynamics(t, x, w) == dynamics(t, x, w)).all()


def test_higher_gain_allows_a_shorter_step_only() -> None:
    steps = [largest_stable_step({"controller": {"alpha": 0.0, "beta": b}}, points=8, duration=1.0) for b in (1.5, 6.0)]
    assert steps[1] < 0.5 * steps[0]


def test_unstable_gains_are_refused() -> None:
    with pytest.raises(ValueError, match="unstable even at a communication step"):
        largest_stable_step({"controller": {"alpha": 0.0, "beta": -1.0}}, points=3, duration=0.2)


def test_wrong_parameter_is_named() -> None:
    with pytest.raises(ValueError, match="there is no parameter 'aplha'"):
        largest_stable_step({"controller": {"aplha": 1.0}}, points=3, duration=0.2)
