"""Kinematics of three equal two-link chains whose ends meet at the end effector.

All angles are absolute (from the x axis). Joint coordinates are theta = [theta_a; theta_b] (6,) in rad: active links
first, then passive links. Equation numbers are those of Han et al. 2021.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

Array = Any

#: Working mode of every chain: +1 puts the elbow on the left of the line from base to end effector.
BRANCH = 1.0

#: The paper counts theta_b of the third chain one turn further than atan2 does; (89) makes turns part of the contract.
FULL_TURNS_B = np.array([0.0, 0.0, 2.0 * np.pi])


class Directions(NamedTuple):
    """Cosines and sines (6,) of joint angles: all that the matrices of the robot need of them."""

    cosines: Array
    sines: Array


def directions(theta: Array | Directions) -> Directions:
    """Directions of all links, from joint angles (6,) in rad, unless they are known already."""
    return theta if isinstance(theta, Directions) else Directions(np.cos(theta), np.sin(theta))


def chain_ends(theta: Array, l: Any, x_A: Array, y_A: Array) -> tuple[Array, Array]:
    """Positions of the three passive ends.

    Parameters
    ----------
    theta : array (6,)
        Joint angles (rad).
    l : float
        Link length (m).
    x_A, y_A : array (3,)
        Base positions (m).

    Returns
    -------
    x, y : array (3,)
        End of each chain (m).
    """
    a, b = theta[:3], theta[3:]
    return x_A + l * (np.cos(a) + np.cos(b)), y_A + l * (np.sin(a) + np.sin(b))


def loop_closure(theta: Array, l: Any, x_A: Array, y_A: Array) -> Array:
    """Left side of the closure constraint (16): (4,) in m, zero when the three ends coincide."""
    x, y = chain_ends(theta, l, x_A, y_A)
    return np.stack([x[0] - x[1], y[0] - y[1], x[0] - x[2], y[0] - y[2]])


#: Rows of (16) as differences of chain ends: end 1 - end 2, end 1 - end 3.
_DIFFERENCES = np.array([[1.0, -1.0, 0.0], [1.0, 0.0, -1.0]])


def _interleave(rows_x: Array, rows_y: Array) -> Array:
    """Order rows as (16) does: x of the first pair, y of the first pair, x of the second, y of the second."""
    return np.stack([rows_x[0], rows_y[0], rows_x[1], rows_y[1]])


def constraint_matrix(theta: Array, l: Any) -> Array:
    """A of the constraint in second order form, (17), (18): (4, 6) in m."""
    D = _DIFFERENCES
    x_rows = -l * np.concatenate([D @ np.diag(np.sin(theta[:3])), D @ np.diag(np.sin(theta[3:]))], axis=1)
    y_rows = l * np.concatenate([D @ np.diag(np.cos(theta[:3])), D @ np.diag(np.cos(theta[3:]))], axis=1)
    return _interleave(x_rows, y_rows)


def constraint_bias(theta: Array, omega: Array, l: Any) -> Array:
    """Right side b of the constraint in second order form, (17), (18): (4,) in m/s^2."""
    a, b = theta[:3], theta[3:]
    squares_a, squares_b = omega[:3] ** 2, omega[3:] ** 2
    x_rows = l * (_DIFFERENCES @ (np.cos(a) * squares_a + np.cos(b) * squares_b))
    y_rows = l * (_DIFFERENCES @ (np.sin(a) * squares_a + np.sin(b) * squares_b))
    return _interleave(x_rows, y_rows)


def inverse_kinematics(x_E: Any, y_E: Any, l: Any, x_A: Array, y_A: Array) -> Array:
    """Joint angles (6,) in rad of all chains for an end-effector position in m.

    The angles are continuous over the whole workspace of the paper's robot: from no base can the end effector be
    seen in the direction where atan2 jumps. A position out of reach gives NaN; see `reach_margin`.
    """
    dx, dy = x_E - x_A, y_E - y_A
    half_apex = np.arccos(np.sqrt(dx**2 + dy**2) / (2.0 * l))
    direction = np.arctan2(dy, dx)
    return np.concatenate([direction + BRANCH * half_apex, direction - BRANCH * half_apex + FULL_TURNS_B])


def directions_to(x_E: Any, y_E: Any, l: Any, x_A: Array, y_A: Array) -> Directions:
    """Directions of all links for an end-effector position in m; out of reach NaN.

    Those of `inverse_kinematics` without angles, which take several times as long: from the base halfway to the end
    effector, then across, is the elbow.
    """
    dx, dy = (x_E - x_A) / l, (y_E - y_A) / l
    across = BRANCH * np.sqrt(1.0 / (dx**2 + dy**2) - 0.25)
    cosines = np.concatenate([0.5 * dx - across * dy, 0.5 * dx + across * dy])
    sines = np.concatenate([0.5 * dy + across * dx, 0.5 * dy - across * dx])
    return Directions(cosines, sines)


def reach_margin(x_E: Any, y_E: Any, l: Any, x_A: Array, y_A: Array) -> Array:
    """How far inside the reach of each chain a position lies: (2 l)^2 - distance^2, (3,) in m^2."""
    return (2.0 * l) ** 2 - (x_E - x_A) ** 2 - (y_E - y_A) ** 2


def relative_angles(theta: Array | Directions) -> tuple[Array, Array]:
    """Cosines (3,) and sines (3,) of theta_a - theta_b.

    By the addition theorems: the kinematics need the sines and cosines of the angles themselves, so that these cost
    no further one, and sines and cosines are what the models spend most of their time on.
    """
    c, s = directions(theta)
    return c[:3] * c[3:] + s[:3] * s[3:], s[:3] * c[3:] - c[:3] * s[3:]


def velocity_jacobians(theta: Array | Directions, l: Any) -> tuple[Array, Array]:
    """J_a and J_b, each (3, 2) in 1/m, of (23): omega_a = J_a v_E and omega_b = J_b v_E.

    Infinite where a chain is stretched or folded, sin(theta_b - theta_a) = 0.
    """
    c, s = directions(theta)
    _, sines = relative_angles(theta)
    n = -1.0 / (l * sines)
    J_a = np.stack([n * c[3:], n * s[3:]], axis=1)
    J_b = np.stack([-n * c[:3], -n * s[:3]], axis=1)
    return J_a, J_b


def velocity_jacobian_rates(theta: Array | Directions, omega: Array, l: Any) -> tuple[Array, Array]:
    """Rates of J_a and J_b of (23), each (3, 2) in 1/(m s), at joint angles and velocities (6,) of a closed state."""
    c, s = directions(theta)
    J_a, J_b = velocity_jacobians(theta, l)
    # n' / n, and the turning of the unit vectors along the links
    cosines, sines = relative_angles(theta)
    relative_rate = np.diag((omega[3:] - omega[:3]) * cosines / sines)
    n = -1.0 / (l * sines)
    turn_b, turn_a = n * omega[3:], n * omega[:3]
    J_a_rate = relative_rate @ J_a + np.stack([-turn_b * s[3:], turn_b * c[3:]], axis=1)
    J_b_rate = relative_rate @ J_b + np.stack([turn_a * s[:3], -turn_a * c[:3]], axis=1)
    return J_a_rate, J_b_rate
