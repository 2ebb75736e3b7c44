"""Poles and the largest stable communication step: against closed forms and against the coupled FMUs themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim import SimulationError, simulate
from parallel_robot.metrics import tracking_errors
from parallel_robot.scenario import load_scenario
from parallel_robot.stability import LinearLoop, closed_loop_poles, largest_stable_step
from tests.conftest import DEFAULT_FLAVOUR


def double_integrator(k_p: float, k_d: float) -> LinearLoop:
    """Three masses of 1 on one axis each (only the first moves), PD control on the first; psi is idle."""
    A, B, C = np.zeros((1, 4, 4)), np.zeros((1, 4, 3)), np.zeros((1, 6, 4))
    A[0, 0, 2] = A[0, 1, 3] = 1.0
    B[0, 2, 0] = B[0, 3, 1] = 1.0
    C[0, 0, 0] = C[0, 3, 2] = C[0, 1, 1] = C[0, 4, 3] = 1.0
    D = np.zeros((1, 3, 6))
    D[0, 0, [0, 3]] = D[0, 1, [1, 4]] = -k_p, -k_d
    return LinearLoop(A, B, C, -np.eye(2)[None], np.zeros((1, 2, 6)), np.zeros((1, 3, 2)), D)


def test_poles_of_a_double_integrator_under_pd_control() -> None:
    poles = double_integrator(6.0, 5.0).poles()[0]
    np.testing.assert_allclose(np.sort(poles.real), [-3, -3, -2, -2, -1, -1], atol=1e-6)


def test_sampled_double_integrator_loses_stability_at_its_known_step() -> None:
    """Plant x'' = u held over h, u = -k_p x - k_d x': stable exactly for h < 2 k_d / k_p and h < 2 / k_d."""
    k_p, k_d = 1.0, 4.0
    limit = min(2 * k_d / k_p, 2 / k_d)

    def radius(step: float) -> float:
        return float(np.abs(np.linalg.eigvals(double_integrator(k_p, k_d).step_matrices(step, "sequential"))).max())

    assert radius(0.999 * limit) < 1.0 < radius(1.001 * limit)


def test_parallel_order_of_the_sampled_loop_is_one_step_of_delay() -> None:
    """Plant x' = v, v' = u with u delayed by one step, simulated by hand from the same start."""
    loop, h = double_integrator(1.0, 2.0), 0.1
    matrix = loop.step_matrices(h, "parallel")[0]
    x, v, delayed = 1.0, 0.0, np.array([1.0, 0.0])
    state = np.zeros(12)
    state[0], state[6] = 1.0, 1.0  # x, and the measured x of the step before
    for _ in range(20):
        u = -1.0 * delayed[0] - 2.0 * delayed[1]
        delayed = np.array([x, v])
        x, v = x + h * v + h * h / 2 * u, v + h * u
        state = matrix @ state
        np.testing.assert_allclose(state[[0, 2]], [x, v], atol=1e-13)


def test_closed_loop_is_stable_along_the_path() -> None:
    times, poles = closed_loop_poles(duration=3.0, points=13)
    assert times.shape == (13,)
    assert poles.shape == (13, 6)
    assert poles.real.max() < 0.0
    # psi_2 hardly couples: its pole is that of (90), minus one
    assert np.abs(poles + 1.0).min(axis=1).max() < 1e-3


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_coupled_fmus_are_stable_below_the_largest_step_and_not_above(robot_fmus: Path, order: str) -> None:
    limit = largest_stable_step(order=order, points=24)
    print(f"{order}: largest stable step {limit * 1e3:.1f} ms")

    def diverges(step: float) -> bool:
        scenario = load_scenario("tracking-undisturbed")
        system = scenario.system(robot_fmus, DEFAULT_FLAVOUR)
        try:
            results = simulate(system, step * round(15.0 / step), step, order=order, coupling="hold")
        except SimulationError:
            return True
        late = results.time > 8.0
        return float(np.abs(tracking_errors(results)["x"][late]).max()) > 0.03

    assert not diverges(0.97 * limit)
    assert diverges(1.25 * limit)


def test_higher_gain_allows_a_shorter_step_only() -> None:
    steps = [largest_stable_step({"controller": {"alpha": 0.0, "beta": b}}, points=4, duration=1.0) for b in (1.5, 6.0)]
    assert steps[1] < 0.5 * steps[0]


def test_unstable_gains_are_refused() -> None:
    with pytest.raises(ValueError, match="unstable even at a step"):
        largest_stable_step({"controller": {"alpha": 0.0, "beta": -1.0}}, points=3, duration=0.2)


def test_wrong_parameter_is_named() -> None:
    with pytest.raises(ValueError, match="there is no parameter 'aplha'"):
        largest_stable_step({"controller": {"aplha": 1.0}}, points=3, duration=0.2)
