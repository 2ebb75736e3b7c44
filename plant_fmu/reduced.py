"""The paper's reduced form (27): the closed chain in the space of the active joints.

M theta_a'' + C theta_a' + F = tau_a, for tests and analysis. The simulation uses `plant_fmu.dynamics`, which needs no
inverse of sin(theta_b - theta_a) and goes straight through poses where one chain is stretched.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_fmu.dynamics import coriolis_matrix, mass_matrix
from plant_fmu.kinematics import velocity_jacobian_rates, velocity_jacobians

Array = Any


@dataclass(frozen=True)
class ReducedForm:
    """Matrices of (27) at one state; M (3, 3) kg m^2, C (3, 3) kg m^2/s, F (3,) N m, P (6, 3)."""

    M: Array
    C: Array
    F: Array
    P: Array


def passive_velocity_map(theta: Array, omega: Array, l: Any) -> tuple[Array, Array]:
    """N of (22), (23) with omega_b = N omega_a, and its rate N' of (24).

    Parameters
    ----------
    theta, omega : array (6,)
        Joint angles (rad) and velocities (rad/s) of a closed state.
    l : float
        Link length (m).

    Returns
    -------
    N : array (3, 3)
    N_rate : array (3, 3)
        In 1/s.
    """
    J_a, J_b = velocity_jacobians(theta, l)
    J_a_rate, J_b_rate = velocity_jacobian_rates(theta, omega, l)
    G = J_a.T @ J_a
    J_a_pinv = np.linalg.solve(G, J_a.T)
    G_rate = J_a_rate.T @ J_a + J_a.T @ J_a_rate
    J_a_pinv_rate = np.linalg.solve(G, J_a_rate.T - G_rate @ J_a_pinv)
    return J_b @ J_a_pinv, J_b_rate @ J_a_pinv + J_b @ J_a_pinv_rate


def reduced_form(theta: Array, omega: Array, F_c: Array, X: Any, Y: Any, Z: Any, l: Any) -> ReducedForm:
    """M, C and F of (27) at a closed state.

    Parameters
    ----------
    theta, omega, F_c : array (6,)
        Joint angles (rad), velocities (rad/s) and closure force (N m) of the closed chain.
    X, Y, Z : float
        Inertia constants (kg m^2).
    l : float
        Link length (m).
    """
    N, N_rate = passive_velocity_map(theta, omega, l)
    P = np.concatenate([np.eye(3), N])
    P_rate = np.concatenate([np.zeros((3, 3)), N_rate])
    M_o = mass_matrix(theta, X, Y, Z)
    C_o = coriolis_matrix(theta, omega, Z)
    return ReducedForm(M=P.T @ M_o @ P, C=P.T @ (M_o @ P_rate + C_o @ P), F=-P.T @ F_c, P=P)
