"""Dynamics of the closed chain against other formulations of the same mechanics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import sqrtm

from plant_fmu.dynamics import (
    closed_chain,
    coriolis_matrix,
    inverse_mass_matrix,
    mass_matrix,
    uncertain_inertia,
)
from plant_fmu.kinematics import constraint_bias, constraint_matrix, inverse_kinematics
from plant_fmu.model import PARAMETERS
from plant_fmu.reduced import passive_velocity_map, reduced_form
from tests.support import some
from tests.support.closed_states import closed_states

P = PARAMETERS.unpack(PARAMETERS.starts)
XYZ = (P.X, P.Y, P.Z)
GEOMETRY = (P.l, P.x_A, P.y_A)


def applied_forces(theta: np.ndarray, omega: np.ndarray, tau_a: np.ndarray) -> np.ndarray:
    """Q = tau_o - C_o theta'."""
    return np.concatenate([tau_a, np.zeros(3)]) - coriolis_matrix(theta, omega, P.Z) @ omega


def test_closure_force_is_udwadia_and_kalabas_with_matrix_roots() -> None:
    """(10) literally, with matrix square roots and the Moore-Penrose inverse, and B = A M^(-1/2)."""
    for theta, omega, tau_a in closed_states(20):
        M = mass_matrix(theta, *XYZ)
        root = np.real(sqrtm(M))
        A, b = constraint_matrix(theta, P.l), constraint_bias(theta, omega, P.l)
        Q = applied_forces(theta, omega, tau_a)
        F_c = root @ np.linalg.pinv(A @ np.linalg.inv(root)) @ (b - A @ np.linalg.solve(M, Q))
        np.testing.assert_allclose(closed_chain(theta, omega, tau_a, *XYZ, *GEOMETRY, 0.0)[1], F_c, atol=1e-12)


def test_printed_B_of_the_paper_is_an_erratum() -> None:
    """B = A M^(1/2), as printed after (8) and (19), gives accelerations that break the constraint."""
    theta, omega, tau_a = closed_states(1)[0]
    M = mass_matrix(theta, *XYZ)
    root = np.real(sqrtm(M))
    A, b = constraint_matrix(theta, P.l), constraint_bias(theta, omega, P.l)
    Q = applied_forces(theta, omega, tau_a)
    printed = root @ np.linalg.pinv(A @ root) @ (b - A @ np.linalg.solve(M, Q))
    assert np.abs(A @ np.linalg.solve(M, Q + printed) - b).max() > 1e-2


def test_accelerations_solve_the_saddle_point_equations() -> None:
    """Lagrange multipliers instead of Udwadia-Kalaba: [M -A^T; A 0] [theta''; lambda] = [Q; b]."""
    for theta, omega, tau_a in closed_states():
        M, A = mass_matrix(theta, *XYZ), constraint_matrix(theta, P.l)
        saddle = np.block([[M, -A.T], [A, np.zeros((4, 4))]])
        right = np.concatenate([applied_forces(theta, omega, tau_a), constraint_bias(theta, omega, P.l)])
        accelerations = np.linalg.solve(saddle, right)[:6]
        found, _ = closed_chain(theta, omega, tau_a, *XYZ, *GEOMETRY, 0.0)
        np.testing.assert_allclose(found, accelerations, rtol=1e-12, atol=1e-12)


def test_coriolis_matrix_follows_from_the_kinetic_energy() -> None:
    """Lagrange: d/dt (M omega) - dT/dtheta = M theta'' + C omega for any state, closed or not."""
    random = np.random.default_rng(3)
    for _ in range(50):
        theta, omega = random.uniform(-3, 3, 6), random.uniform(-2, 2, 6)
        M_rate = np.imag(mass_matrix(theta + 1e-30j * omega, *XYZ)) / 1e-30
        dT = [omega @ np.imag(mass_matrix(theta + 1e-30j * e, *XYZ)) @ omega / 2e-30 for e in np.eye(6)]
        np.testing.assert_allclose(coriolis_matrix(theta, omega, P.Z) @ omega, M_rate @ omega - dT, atol=1e-13)


def test_closure_force_does_no_work_and_energy_grows_by_the_torques() -> None:
    for theta, omega, tau_a in some(closed_states()):
        accelerations, F_c = closed_chain(theta, omega, tau_a, *XYZ, *GEOMETRY, 0.0)
        assert abs(F_c @ omega) < 1e-13
        M_rate = np.imag(mass_matrix(theta + 1e-30j * omega, *XYZ)) / 1e-30
        power = omega @ mass_matrix(theta, *XYZ) @ accelerations + omega @ M_rate @ omega / 2
        assert power == pytest.approx(tau_a @ omega[:3], abs=1e-12)


def test_inverse_mass_matrix() -> None:
    for theta, _, _ in closed_states(20):
        np.testing.assert_allclose(inverse_mass_matrix(theta, *XYZ) @ mass_matrix(theta, *XYZ), np.eye(6), atol=1e-13)


def test_baumgarte_damps_an_open_closure_at_its_rate() -> None:
    """Closure: phi'' + 2 g phi' + g^2 phi = 0 at any state, also at one that is not closed."""
    random = np.random.default_rng(4)
    g = 10.0
    theta, omega = random.uniform(-3, 3, 6), random.uniform(-2, 2, 6)
    from plant_fmu.kinematics import loop_closure

    A = constraint_matrix(theta, P.l)
    accelerations, _ = closed_chain(theta, omega, np.ones(3), *XYZ, *GEOMETRY, g)
    phi_second = A @ accelerations - constraint_bias(theta, omega, P.l)
    np.testing.assert_allclose(phi_second + 2 * g * (A @ omega) + g**2 * loop_closure(theta, *GEOMETRY), 0, atol=1e-11)


def test_reduced_form_agrees_with_the_closed_chain() -> None:
    """(27): M theta_a'' + C theta_a' + F = tau_a, with theta_a'' from the Udwadia-Kalaba equation."""
    for theta, omega, tau_a in some(closed_states()):
        accelerations, F_c = closed_chain(theta, omega, tau_a, *XYZ, *GEOMETRY, 0.0)
        r = reduced_form(theta, omega, F_c, *XYZ, P.l)
        np.testing.assert_allclose(r.M @ accelerations[:3] + r.C @ omega[:3] + r.F, tau_a, atol=1e-11)
        np.testing.assert_allclose(r.M, r.M.T, atol=1e-15)
        assert np.linalg.eigvalsh(r.M).min() > 0


def test_passive_velocity_map_and_its_rate() -> None:
    """(22) and (24), the rate by a complex step along the motion."""
    for theta, omega, tau_a in closed_states(20):
        N, N_rate = passive_velocity_map(theta, omega, P.l)
        np.testing.assert_allclose(N @ omega[:3], omega[3:], atol=1e-13)
        moved, _ = passive_velocity_map(theta + 1e-30j * omega, omega, P.l)
        np.testing.assert_allclose(N_rate, np.imag(moved) / 1e-30, atol=1e-11)
        accelerations, _ = closed_chain(theta, omega, tau_a, *XYZ, *GEOMETRY, 0.0)
        np.testing.assert_allclose(N_rate @ omega[:3] + N @ accelerations[:3], accelerations[3:], atol=1e-10)


def test_mass_change_enters_as_in_the_definitions() -> None:
    """(13) evaluated with both masses grown by dm."""
    r_b = P.Z / (P.m_b * P.l)
    J_a, J_b = P.X - P.m_b * P.l**2 - P.m_a * P.r_a**2, P.Y - P.m_b * r_b**2
    assert J_a > 0
    assert J_b > 0
    for dm in (-0.25, 0.0, 0.1, 0.25):
        X = J_a + (P.m_a + dm) * P.r_a**2 + (P.m_b + dm) * P.l**2
        Y = J_b + (P.m_b + dm) * r_b**2
        Z = (P.m_b + dm) * P.l * r_b
        np.testing.assert_allclose(uncertain_inertia(*XYZ, dm, P.l, P.r_a, r_b), (X, Y, Z), rtol=1e-14)


def test_motion_goes_straight_through_a_stretched_chain() -> None:
    """Where sin(b - a) = 0 the reduced form (27) has no value, the Udwadia-Kalaba form has."""
    theta = inverse_kinematics(P.x_A[0] + 2 * P.l * (1 - 1e-17), P.y_A[0], *GEOMETRY)
    theta[[0, 3]] = 0.0  # exactly stretched
    accelerations, _ = closed_chain(theta, np.zeros(6), np.ones(3), *XYZ, *GEOMETRY, 0.0)
    assert np.isfinite(accelerations).all()
    assert np.abs(accelerations).max() < 1e3
