"""Dynamics of the closed chain by the Udwadia-Kalaba equation.

Joint coordinates theta = [theta_a; theta_b] (6,) in rad, omega = theta' in rad/s. The robot moves in a horizontal
plane without friction (paper, section 2.2). Equation numbers are those of Han et al. 2021.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from plant_fmu.kinematics import Directions, constraint_bias, constraint_matrix, loop_closure, relative_angles
from plant_fmu.symmetric import solve_positive_definite

Array = Any


def uncertain_inertia(X: Any, Y: Any, Z: Any, dm: Any, l: Any, r_a: Any, r_b: Any) -> tuple[Any, Any, Any]:
    """Inertia constants (13) after both link masses have grown by dm (section 6).

    Parameters
    ----------
    X, Y, Z : float
        Nominal constants (kg m^2).
    dm : float
        Growth of m_a and of m_b (kg).
    l, r_a, r_b : float
        Link length and distances of the mass centres from their joints (m).

    Returns
    -------
    X, Y, Z : float
        Constants with the uncertainty (kg m^2).
    """
    return X + dm * (r_a**2 + l**2), Y + dm * r_b**2, Z + dm * l * r_b


def mass_matrix(theta: Array | Directions, X: Any, Y: Any, Z: Any) -> Array:
    """M_o of the three open chains, (12), (15): (6, 6) in kg m^2."""
    E = np.eye(3)
    cosines, _ = relative_angles(theta)
    coupling = Z * np.diag(cosines)
    return np.block([[X * E, coupling], [coupling, Y * E]])


def inverse_mass_matrix(theta: Array, X: Any, Y: Any, Z: Any) -> Array:
    """Inverse of M_o, (6, 6) in 1/(kg m^2); in closed form, since its blocks are diagonal."""
    cosines, _ = relative_angles(theta)
    determinants = X * Y - (Z * cosines) ** 2
    coupling = np.diag(-Z * cosines / determinants)
    return np.block([[np.diag(Y / determinants), coupling], [coupling, np.diag(X / determinants)]])


def coriolis_matrix(theta: Array | Directions, omega: Array, Z: Any) -> Array:
    """C_o of the three open chains, (12), (15): (6, 6) in kg m^2/s."""
    O = np.zeros((3, 3))
    _, sines = relative_angles(theta)
    return np.block([[O, np.diag(Z * sines * omega[3:])], [-np.diag(Z * sines * omega[:3]), O]])


def closed_chain(
    theta: Array,
    omega: Array,
    tau_a: Array,
    X: Any,
    Y: Any,
    Z: Any,
    l: Any,
    x_A: Array,
    y_A: Array,
    baumgarte: Any,
    inertia_rates: tuple[Any, Any, Any] = (0.0, 0.0, 0.0),
) -> tuple[Array, Array]:
    """Accelerations and closure force of the closed chain, (19), (20).

    The closure force is that of (19); because A has full row rank, M^(1/2) (A M^(-1/2))^+ equals
    A^T (A M^(-1) A^T)^(-1), which is what is evaluated. (The B = A M^(1/2) printed after (8) and (19) is an erratum.)
    Baumgarte's stabilisation adds -2 g phi' - g^2 phi to b, with g = `baumgarte` and phi the left side of (16)
    (Baumgarte 1972, doi 10.1016/0045-7825(72)90018-7): rounding errors of the closure then decay instead of grow.

    Parameters
    ----------
    theta, omega : array (6,)
        Joint angles (rad) and velocities (rad/s).
    tau_a : array (3,)
        Torques on the active joints (N m).
    X, Y, Z : float
        Inertia constants (kg m^2).
    l : float
        Link length (m).
    x_A, y_A : array (3,)
        Base positions (m).
    baumgarte : float
        Stabilisation rate (1/s), 0 for none.
    inertia_rates : tuple of float, optional
        Rates of X, Y, Z (kg m^2/s) of mass that arrives, or leaves, at rest: Lagrange's equations, d/dt (M theta') =
        ..., then have a term M' theta' beside those of (14). The paper does not have it: its mass arrives with the
        velocity of the link.

    Returns
    -------
    accelerations : array (6,)
        theta'' (rad/s^2).
    F_c : array (6,)
        Closure force in joint coordinates (N m).
    """
    M_inverse = inverse_mass_matrix(theta, X, Y, Z)
    A = constraint_matrix(theta, l)
    phi = loop_closure(theta, l, x_A, y_A)
    b = constraint_bias(theta, omega, l) - 2.0 * baumgarte * (A @ omega) - baumgarte**2 * phi
    Q = np.concatenate([tau_a, np.zeros(3)]) - coriolis_matrix(theta, omega, Z) @ omega
    Q = Q - mass_matrix(theta, *inertia_rates) @ omega
    F_c = A.T @ solve_positive_definite(A @ M_inverse @ A.T, b - A @ (M_inverse @ Q))
    return M_inverse @ (Q + F_c), F_c
