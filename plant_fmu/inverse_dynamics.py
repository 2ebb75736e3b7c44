"""Torque that moves the closed chain as desired: (27) read from right to left.

Three motors drive two degrees of freedom, so that many torques give the same motion; they differ in how hard the chains
pull at each other. The one of least norm is taken. Equation numbers are those of Han et al. 2021.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from plant_fmu.dynamics import coriolis_matrix, mass_matrix
from plant_fmu.kinematics import Directions, velocity_jacobian_rates, velocity_jacobians
from plant_fmu.symmetric import solve_positive_definite

Array = Any


def minimum_norm_torque(
    theta: Array | Directions, velocity: Array, acceleration: Array, X: Any, Y: Any, Z: Any, l: Any
) -> Array:
    """The least torque on the active joints that gives the end effector an acceleration.

    In (27), M theta_a'' + C theta_a' + F = tau_a, the closure force F has no power in any motion of the closed chain,
    J_a^T F = 0. What remains are two equations for three torques, J_a^T tau_a = J_a^T (M theta_a'' + C theta_a'); the
    pseudo-inverse of J_a^T gives their least solution, tau_a = J_a (J_a^T J_a)^-1 J_a^T (M theta_a'' + C theta_a').

    Parameters
    ----------
    theta : array (6,) or Directions
        Joint angles of a closed pose (rad), or the directions of its links.
    velocity, acceleration : array (2,)
        Of the end effector (m/s, m/s^2).
    X, Y, Z : float
        Inertia constants (kg m^2).
    l : float
        Link length (m).

    Returns
    -------
    array (3,)
        In N m; infinite or NaN where a chain is stretched or folded.
    """
    J_a, J_b = velocity_jacobians(theta, l)
    J = np.concatenate([J_a, J_b])  # P J_a, with P of (27)
    omega = J @ velocity
    domega = J @ acceleration + np.concatenate(velocity_jacobian_rates(theta, omega, l)) @ velocity
    tau_o = mass_matrix(theta, X, Y, Z) @ domega + coriolis_matrix(theta, omega, Z) @ omega  # (15)
    return J_a @ solve_positive_definite(J_a.T @ J_a, J.T @ tau_o)
