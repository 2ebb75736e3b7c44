"""Measures of the dynamic model: closure, closure force, reduced form, energy."""

from __future__ import annotations

import numpy as np

from parallel_robot.paper.reproduce.content import Measured
from parallel_robot.paper.reproduce.material import Material
from plant_fmu.dynamics import closed_chain, coriolis_matrix, mass_matrix
from plant_fmu.kinematics import constraint_bias, constraint_matrix
from plant_fmu.model import PARAMETERS
from plant_fmu.reduced import reduced_form

#: Every so many-th point of the open loop is looked at.
_EVERY = 250


def closure_error(material: Material) -> Measured:
    """Largest closure error (m) of the open loop and of the closed loops."""
    values = {"open loop": float(material.runs.open_loop["plant.closure_error"].max())}
    for (key, condition), results in material.runs.closed_loop.items():
        label = f"closed loop, {condition}"
        values[label] = max(values.get(label, 0.0), float(results["plant.closure_error"].max()))
        del key
    return Measured(values, "m")


def _open_loop_states(material: Material) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Theta (6,), omega (6,), tau_a (3,) and the FMU's F_c (6,) along the open loop."""
    r = material.runs.open_loop.thinned(_EVERY)
    theta = np.column_stack([r["plant.theta_a"], r["plant.theta_b"]])
    omega = np.column_stack([r["plant.omega_a"], r["plant.omega_b"]])
    return list(zip(theta, omega, r["plant.tau_a"], r["plant.F_c"], strict=True))


def square_root(M: np.ndarray, power: float = 0.5) -> np.ndarray:
    """M^(power) of a symmetric positive definite matrix."""
    values, vectors = np.linalg.eigh(M)
    root: np.ndarray = (vectors * values**power) @ vectors.T
    return root


def closure_force(
    theta: np.ndarray, omega: np.ndarray, tau_a: np.ndarray, power_in_B: float = -0.5
) -> tuple[np.ndarray, np.ndarray]:
    """F_c (6,) in N m by (19) to the letter, with B = A M^(power), and by Lagrange's multipliers."""
    p = PARAMETERS.unpack(PARAMETERS.starts)
    M = mass_matrix(theta, p.X, p.Y, p.Z)
    A, b = constraint_matrix(theta, p.l), constraint_bias(theta, omega, p.l)
    Q = np.concatenate([tau_a, np.zeros(3)]) - coriolis_matrix(theta, omega, p.Z) @ omega
    B = A @ square_root(M, power_in_B)
    by_pseudoinverse = square_root(M) @ np.linalg.pinv(B) @ (b - A @ np.linalg.solve(M, Q))
    saddle = np.block([[M, A.T], [A, np.zeros((4, 4))]])
    multipliers = -np.linalg.solve(saddle, np.concatenate([Q, b]))[6:]
    return by_pseudoinverse, A.T @ multipliers


def closure_force_forms(material: Material) -> Measured:
    """Closure force of the FMU against (19) to the letter, and against multipliers: largest relative difference."""
    by_form = {"(19) with B = A M^(-1/2)": 0.0, "Lagrange multipliers": 0.0}
    states = _open_loop_states(material)
    scale = max(float(np.abs(F_c).max()) for *_, F_c in states)
    for theta, omega, tau_a, F_c in states:
        for label, force in zip(by_form, closure_force(theta, omega, tau_a), strict=True):
            by_form[label] = max(by_form[label], float(np.abs(force - F_c).max()) / scale)
    return Measured(by_form)


def reduced_form_residual(material: Material) -> Measured:
    """Residual (N m) of (27), M theta_a'' + C theta_a' + F = tau_a, along the open loop."""
    p = PARAMETERS.unpack(PARAMETERS.starts)
    worst = 0.0
    for theta, omega, tau_a, _ in _open_loop_states(material):
        accelerations, F_c = closed_chain(theta, omega, tau_a, p.X, p.Y, p.Z, p.l, p.x_A, p.y_A, 0.0)
        form = reduced_form(theta, omega, F_c, p.X, p.Y, p.Z, p.l)
        residual = form.M @ accelerations[:3] + form.C @ omega[:3] + form.F - tau_a
        worst = max(worst, float(np.abs(residual).max()))
    return Measured({"open loop": worst}, "N m")


def energy_balance(material: Material) -> Measured:
    """Kinetic energy less the work of the torques, over the largest kinetic energy, in the open loop.

    The work is summed by the trapezoidal rule at the communication points, which leaves about 1e-6 of the energy.
    """
    r = material.runs.open_loop
    power = (r["plant.tau_a"] * r["plant.omega_a"]).sum(axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(r.time))])
    energy = r["plant.kinetic_energy"]
    return Measured({"open loop": float(np.abs(energy - work).max() / energy.max())})
