"""The Udwadia-Kalaba equation for classical systems: pendulum, rolling coin, knife edge, redundant constraints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

from cosim import System, simulate
from fmu_export import DefaultExperiment, Layout, Model, Variable
from fmu_export.errors import ArgumentError
from fmu_export.native.backend import build_native
from fmu_export.trace.trace import trace
from parallel_robot.mechanics import inconsistency, udwadia_kalaba
from plant_fmu.dynamics import closed_chain, coriolis_matrix, mass_matrix
from plant_fmu.kinematics import constraint_bias, constraint_matrix
from plant_fmu.model import MODEL, PARAMETERS
from tests.support.native_fmus import require_compiler

G = 9.81


def by_the_letter(M: np.ndarray, Q: np.ndarray, A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Accelerations by (8) as it is printed, with B = A M^(-1/2) and its Moore-Penrose inverse."""
    values, vectors = np.linalg.eigh(M)
    root, inverse_root = ((vectors * values**power) @ vectors.T for power in (0.5, -0.5))
    free = np.linalg.solve(M, Q)
    force = root @ np.linalg.pinv(A @ inverse_root, rcond=1e-9) @ (b - A @ free)
    return free + np.linalg.solve(M, force)


@pytest.mark.parametrize("rank", [0, 1, 2, 3, 4])
def test_accelerations_are_those_of_the_moore_penrose_inverse(rank: int) -> None:
    """Random systems of 5 coordinates and 4 constraints, of which only some are independent."""
    rng = np.random.default_rng(rank)
    for _ in range(20):
        root = rng.normal(size=(5, 5))
        M, Q = root @ root.T + 0.1 * np.eye(5), rng.normal(size=5)
        A = rng.normal(size=(4, rank)) @ rng.normal(size=(rank, 5))
        b = A @ rng.normal(size=5)  # consistent
        motion = udwadia_kalaba(M, Q, A, b)
        np.testing.assert_allclose(motion.acceleration, by_the_letter(M, Q, A, b), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(A @ motion.acceleration, b, atol=1e-8)
        np.testing.assert_allclose(M @ motion.acceleration, Q + motion.force, atol=1e-8)
        # no work on a displacement that the constraints allow
        _, sizes, directions = np.linalg.svd(A)
        allowed = directions[np.sum(sizes > 1e-9) :]
        np.testing.assert_allclose(allowed @ motion.force, 0.0, atol=1e-8)


def test_without_constraints_a_system_moves_freely() -> None:
    motion = udwadia_kalaba(np.diag([1.0, 4.0]), np.array([3.0, 2.0]), np.zeros((0, 2)), np.zeros(0))
    np.testing.assert_array_equal(motion.acceleration, [3.0, 0.5])
    np.testing.assert_array_equal(motion.force, [0.0, 0.0])


def test_constraints_without_a_solution_are_found() -> None:
    M, A = np.diag([1.0, 2.0]), np.array([[1.0, 1.0], [2.0, 2.0]])
    np.testing.assert_allclose(inconsistency(M, A, np.array([1.0, 2.0])), 0.0, atol=1e-12)
    assert np.abs(inconsistency(M, A, np.array([1.0, 3.0]))).max() > 0.5


def test_wrong_shapes_are_named() -> None:
    with pytest.raises(ArgumentError, match=r"A has shape \(1, 3\); \(1, 2\) fits"):
        udwadia_kalaba(np.eye(2), np.zeros(2), np.zeros((1, 3)), np.zeros(1))
    with pytest.raises(ArgumentError, match=r"M has shape \(3, 3\)"):
        udwadia_kalaba(np.eye(3), np.zeros(2), np.zeros((1, 2)), np.zeros(1))


def test_a_pendulum_in_cartesian_coordinates_is_jacobi_s() -> None:
    """Holonomic: x^2 + y^2 = l^2, differentiated twice. The angle is an elliptic function of time."""
    m, l, amplitude = 2.0, 0.7, 1.2

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = state[:2], state[2:]
        motion = udwadia_kalaba(m * np.eye(2), np.array([0.0, -m * G]), q[None, :], np.array([-v @ v]))
        return np.concatenate([v, motion.acceleration])

    start = [l * np.sin(amplitude), -l * np.cos(amplitude), 0.0, 0.0]
    times = np.linspace(0.0, 3.0, 50)
    found = solve_ivp(rate, (0.0, 3.0), start, t_eval=times, rtol=1e-10, atol=1e-12, method="DOP853").y
    modulus = np.sin(amplitude / 2.0) ** 2
    sn, *_ = ellipj(ellipk(modulus) - np.sqrt(G / l) * times, modulus)
    angle = 2.0 * np.arcsin(np.sin(amplitude / 2.0) * sn)
    np.testing.assert_allclose(np.arctan2(found[0], -found[1]), angle, atol=1e-8)


def test_a_bead_on_a_driven_wire_follows_it() -> None:
    """Rheonomic: y = sin(3 t), so that b depends on time; x keeps its velocity."""

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        motion = udwadia_kalaba(np.eye(2), np.zeros(2), np.array([[0.0, 1.0]]), np.array([-9.0 * np.sin(3.0 * t)]))
        return np.concatenate([state[2:], motion.acceleration])

    end = solve_ivp(rate, (0.0, 2.0), [0.0, 0.0, 0.5, 3.0], rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(end[:2], [1.0, np.sin(6.0)], atol=1e-8)


def test_a_knife_edge_on_an_incline_runs_along_a_cycloid() -> None:
    """Nonholonomic: x' sin(phi) = y' cos(phi). Gravity along x, constant spin: a cycloid, no descent in the mean."""
    spin, pull = 1.3, G * np.sin(0.4)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        phi, (vx, vy, w) = state[2], state[3:]
        A = np.array([[np.sin(phi), -np.cos(phi), 0.0]])
        b = np.array([-w * (vx * np.cos(phi) + vy * np.sin(phi))])
        motion = udwadia_kalaba(np.diag([1.0, 1.0, 0.2]), np.array([pull, 0.0, 0.0]), A, b)
        return np.concatenate([state[3:], motion.acceleration])

    times = np.linspace(0.0, 5.0, 40)
    found = solve_ivp(
        rate, (0.0, 5.0), [0.0, 0.0, 0.0, 0.0, 0.0, spin], t_eval=times, rtol=1e-10, atol=1e-12, method="DOP853"
    ).y
    angle = spin * times
    np.testing.assert_allclose(found[0], pull / (2 * spin**2) * np.sin(angle) ** 2, atol=1e-8)
    np.testing.assert_allclose(found[1], pull / (2 * spin**2) * (angle - 0.5 * np.sin(2 * angle)), atol=1e-8)


def test_an_upright_coin_rolls_on_a_circle() -> None:
    """Two nonholonomic constraints, x' = r w cos(phi) and y' = r w sin(phi): spin and roll stay, which is a circle."""
    r, roll, turn = 0.1, 4.0, 0.5

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        phi, v = state[2], state[4:]
        A = np.array([[1.0, 0.0, 0.0, -r * np.cos(phi)], [0.0, 1.0, 0.0, -r * np.sin(phi)]])
        b = r * v[3] * v[2] * np.array([-np.sin(phi), np.cos(phi)])
        motion = udwadia_kalaba(np.diag([1.0, 1.0, 0.002, 0.005]), np.zeros(4), A, b)
        return np.concatenate([v, motion.acceleration])

    start = [0.0, 0.0, 0.0, 0.0, r * roll, 0.0, turn, roll]
    end = solve_ivp(rate, (0.0, 7.0), start, rtol=1e-10, atol=1e-12, method="DOP853").y[:, -1]
    radius = r * roll / turn
    np.testing.assert_allclose(end[:2], [radius * np.sin(turn * 7.0), radius * (1 - np.cos(turn * 7.0))], atol=1e-8)
    np.testing.assert_allclose(end[6:], [turn, roll], atol=1e-10)


def test_the_robot_is_a_case_of_it() -> None:
    """Also with all six differences of chain ends, of which two follow from the others."""
    p = PARAMETERS.unpack(PARAMETERS.starts)
    x = MODEL.initial_state(PARAMETERS.starts)
    theta, omega = x[:6], constrained_velocity(x[:6], p.l)
    tau = np.array([0.3, -0.2, 0.1])
    A, b = constraint_matrix(theta, p.l), constraint_bias(theta, omega, p.l)
    Q = np.concatenate([tau, np.zeros(3)]) - coriolis_matrix(theta, omega, p.Z) @ omega
    M = mass_matrix(theta, p.X, p.Y, p.Z)
    acceleration, force = closed_chain(theta, omega, tau, p.X, p.Y, p.Z, p.l, p.x_A, p.y_A, 0.0)
    # the third pair of ends: their difference is that of the other two
    more_A, more_b = np.concatenate([A, A[2:] - A[:2]]), np.concatenate([b, b[2:] - b[:2]])
    for constraints in ((A, b), (more_A, more_b)):
        motion = udwadia_kalaba(M, Q, *constraints)
        np.testing.assert_allclose(motion.acceleration, acceleration, rtol=1e-10)
        np.testing.assert_allclose(motion.force, force, rtol=1e-9, atol=1e-12)


def constrained_velocity(theta: np.ndarray, l: float) -> np.ndarray:
    """Velocities (6,) that the closure allows."""
    return np.linalg.svd(constraint_matrix(theta, l))[2][4:].T @ np.array([0.4, -0.7])


def pendulum() -> Model:
    """The pendulum in Cartesian coordinates, with its constraint written twice."""

    def derivatives(t, x, u, p):
        q, v = x[:2], x[2:]
        A = np.stack([q, 2.0 * q])
        motion = udwadia_kalaba(
            p[0] * np.eye(2), np.stack([0.0 * q[0], -G * p[0]]), A, np.stack([-v @ v, -2.0 * (v @ v)])
        )
        return np.concatenate([v, motion.acceleration])

    return Model(
        name="Pendulum",
        description="Pendulum in Cartesian coordinates",
        parameters=Layout([Variable("m", "kg", "Mass", start=2.0)]),
        inputs=Layout([]),
        outputs=Layout(
            [Variable(name, unit, "State") for name, unit in zip("xyvw", ("m", "m", "m/s", "m/s"), strict=True)]
        ),
        states=("x", "y", "v", "w"),
        initial_state=lambda p: np.stack([0.7 + 0.0 * p[0], 0.0 * p[0], 0.0 * p[0], 0.0 * p[0]]),
        derivatives=derivatives,
        output_values=lambda t, x, u, p: x,
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.01),
    )


def test_a_model_that_calls_it_can_be_traced() -> None:
    """Symbols give what numbers give."""
    model, x = pendulum(), np.array([0.5, -0.4, 0.4, 0.5])
    found = trace(model).derivatives(0.0, x, [], [2.0]).full().ravel()
    np.testing.assert_allclose(found, model.derivatives(0.0, x, np.zeros(0), np.array([2.0])), rtol=1e-12)


@pytest.mark.slow
def test_a_model_that_calls_it_becomes_an_fmu(tmp_path: Path) -> None:
    """Let go level, the pendulum swings as Jacobi's elliptic function says."""
    require_compiler()
    system = System()
    system.add("pendulum", build_native(pendulum(), tmp_path, "fmi2"))
    results = simulate(system, 1.0, 0.01)
    modulus = np.sin(np.pi / 4.0) ** 2
    sn, *_ = ellipj(ellipk(modulus) - np.sqrt(G / 0.7) * results.time, modulus)
    angle = 2.0 * np.arcsin(np.sqrt(modulus) * sn)
    np.testing.assert_allclose(results["pendulum.x"], 0.7 * np.sin(angle), atol=1e-5)
    np.testing.assert_allclose(results["pendulum.y"], -0.7 * np.cos(angle), atol=1e-5)
