"""Measures and errata of the dynamic model, sections 2 and 3 of the paper, and of its numbers in section 6."""

from __future__ import annotations

from functools import cache

import numpy as np

from cosim.results.results import Results
from parallel_robot.paper.reproduce.content import PRINTED_START, PRINTED_X, PRINTED_Y, Erratum, Measured
from parallel_robot.paper.reproduce.material import Material, measure
from parallel_robot.workspace import transmission_map
from plant_fmu.dynamics import closed_chain, coriolis_matrix, mass_matrix
from plant_fmu.kinematics import chain_ends, constraint_bias, constraint_matrix, loop_closure, velocity_jacobians
from plant_fmu.model import PARAMETERS
from plant_fmu.reduced import reduced_form

#: Every so many-th point of the open loop is looked at.
_EVERY = 250

_P = PARAMETERS.unpack(PARAMETERS.starts)


@measure
def closure_error(material: Material) -> Measured:
    """Largest closure error (m) of the open loop and of the closed loops."""
    values = {"open loop": float(material.runs.open_loop["plant.closure_error"].max())}
    for (_, condition), results in material.runs.closed_loop.items():
        label = f"closed loop, {condition}"
        values[label] = max(values.get(label, 0.0), float(results["plant.closure_error"].max()))
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
    M = mass_matrix(theta, _P.X, _P.Y, _P.Z)
    A, b = constraint_matrix(theta, _P.l), constraint_bias(theta, omega, _P.l)
    Q = np.concatenate([tau_a, np.zeros(3)]) - coriolis_matrix(theta, omega, _P.Z) @ omega
    B = A @ square_root(M, power_in_B)
    by_pseudoinverse = square_root(M) @ np.linalg.pinv(B) @ (b - A @ np.linalg.solve(M, Q))
    saddle = np.block([[M, A.T], [A, np.zeros((4, 4))]])
    multipliers = -np.linalg.solve(saddle, np.concatenate([Q, b]))[6:]
    return by_pseudoinverse, A.T @ multipliers


@measure
def closure_force_forms(material: Material) -> Measured:
    """Closure force of the FMU against (19) to the letter, and against multipliers: largest relative difference."""
    by_form = {"(19) with B = A M^(-1/2)": 0.0, "Lagrange multipliers": 0.0}
    states = _open_loop_states(material)
    scale = max(float(np.abs(F_c).max()) for *_, F_c in states)
    for theta, omega, tau_a, F_c in states:
        for label, force in zip(by_form, closure_force(theta, omega, tau_a), strict=True):
            by_form[label] = max(by_form[label], float(np.abs(force - F_c).max()) / scale)
    return Measured(by_form)


@measure
def reduced_form_residual(material: Material) -> Measured:
    """Residual (N m) of (27), M theta_a'' + C theta_a' + F = tau_a, along the open loop."""
    worst = 0.0
    for theta, omega, tau_a, _ in _open_loop_states(material):
        accelerations, F_c = closed_chain(theta, omega, tau_a, _P.X, _P.Y, _P.Z, _P.l, _P.x_A, _P.y_A, 0.0)
        form = reduced_form(theta, omega, F_c, _P.X, _P.Y, _P.Z, _P.l)
        residual = form.M @ accelerations[:3] + form.C @ omega[:3] + form.F - tau_a
        worst = max(worst, float(np.abs(residual).max()))
    return Measured({"open loop": worst}, "N m")


@measure
def energy_balance(material: Material) -> Measured:
    """Kinetic energy less the work of the torques, over the largest kinetic energy, in the open loop.

    The work is summed by the trapezoidal rule at the communication points, which leaves about 1e-6 of the energy.
    """
    r = material.runs.open_loop
    power = (r["plant.tau_a"] * r["plant.omega_a"]).sum(axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(r.time))])
    energy = r["plant.kinetic_energy"]
    return Measured({"open loop": float(np.abs(energy - work).max() / energy.max())})


@cache
def _transmission() -> dict[tuple[int, ...], np.ndarray]:
    found = transmission_map(81)
    return {driven: values[np.isfinite(values)] for driven, values in found.values.items()}


@measure
def least_transmission(material: Material) -> Measured:  # noqa: ARG001
    """Smallest singular value of the directions in which three motors push the end effector, over the workspace."""
    found = _transmission()
    pairs = max(float(values.min()) for driven, values in found.items() if len(driven) == 2)
    return Measured({"three motors": float(found[1, 2, 3].min())}, note=f"at most {pairs:.2g} with any two motors")


@measure
def transmission_gain(material: Material) -> Measured:  # noqa: ARG001
    """The same with three motors over that with two, in the median over the workspace."""
    found = _transmission()
    three = found[1, 2, 3]
    return Measured(
        {
            f"motors {' and '.join(map(str, driven))}": float(np.median(three) / np.median(values))
            for driven, values in found.items()
            if len(driven) == 2
        }
    )


def ends(results: Results) -> tuple[np.ndarray, np.ndarray]:
    """Positions x and y (m), each (n, 3), of the ends of the three chains."""
    theta = np.column_stack([results["plant.theta_a"], results["plant.theta_b"]])
    x, y = chain_ends(theta.T, _P.l, _P.x_A[:, None], _P.y_A[:, None])
    return x.T, y.T


def seconds_in_printed_axes(results: Results) -> float:
    """How long (s) the end effector stays inside the printed axes of Fig. 4; rounding at the start doesn't count."""
    x, y = results["plant.x_E"], results["plant.y_E"]
    slack = 1e-9
    outside = (x < PRINTED_X[0]) | (x > PRINTED_X[1]) | (y < PRINTED_Y[0]) | (y > PRINTED_Y[1] + slack)
    return float(results.time[np.argmax(outside)] if outside.any() else results.time[-1])


def base_1(material: Material) -> Erratum:  # noqa: ARG001
    """A1 is not at the origin."""
    as_printed, corrected = (
        float(np.linalg.norm(loop_closure(np.array(PRINTED_START), _P.l, _P.x_A, np.array([y, *_P.y_A[1:]]))))
        for y in (0.0, 0.25)
    )
    x, y = (end.mean() for end in chain_ends(np.array(PRINTED_START), _P.l, _P.x_A, _P.y_A))
    return Erratum(
        "base-1",
        "section 6",
        "A1 = (0, 0)",
        "A1 = (0, 0.25) m",
        "The loop closure at the printed start angles is computed with either base. The three chains meet only "
        "with the "
        "second.",
        {
            "closure error as printed (m)": as_printed,
            "closure error with (0, 0.25) (m)": corrected,
            "the chains meet at x (m)": float(x),
            "the chains meet at y (m)": float(y),
        },
        as_printed > 0.1 and corrected < 1e-4,
    )


def matrix_b(material: Material) -> Erratum:
    """B = A M^(1/2) does not give the closure force."""
    r = material.runs.open_loop.thinned(1000)
    worst = {0.5: 0.0, -0.5: 0.0}
    for i in range(1, len(r.time)):
        theta = np.concatenate([r["plant.theta_a"][i], r["plant.theta_b"][i]])
        omega = np.concatenate([r["plant.omega_a"][i], r["plant.omega_b"][i]])
        Q = np.concatenate([r["plant.tau_a"][i], np.zeros(3)]) - coriolis_matrix(theta, omega, _P.Z) @ omega
        for power in worst:
            F_c, _ = closure_force(theta, omega, r["plant.tau_a"][i], power)
            acceleration = np.linalg.solve(mass_matrix(theta, _P.X, _P.Y, _P.Z), Q + F_c)
            residual = constraint_matrix(theta, _P.l) @ acceleration - constraint_bias(theta, omega, _P.l)
            worst[power] = max(worst[power], float(np.abs(residual).max()))
    return Erratum(
        "matrix-B",
        "after (8) and (19)",
        "B = A M^(1/2)",
        "B = A M^(-1/2)",
        "The residual of the constraint A theta'' = b (17) is computed at states of the open loop with either B.",
        {"residual as printed (m/s^2)": worst[0.5], "residual with M^(-1/2) (m/s^2)": worst[-0.5]},
        worst[0.5] > 1e-3 and worst[-0.5] < 1e-12,
    )


def masses(material: Material) -> Erratum:  # noqa: ARG001
    """m_a is the active link's mass."""

    def inertia_at_active_joint(driven: float, carried: float) -> float:
        """Twice the kinetic energy (J) at omega_a = 1 rad/s, omega_b = 0, of links with these masses (kg)."""
        centre_of_driven = np.array([0.0, _P.r_a])  # velocities in m/s
        centre_of_carried = np.array([0.0, _P.l])  # that of the elbow, since this link does not turn
        return float(driven * centre_of_driven @ centre_of_driven + carried * centre_of_carried @ centre_of_carried)

    driven, carried = inertia_at_active_joint(1.0, 0.0), inertia_at_active_joint(0.0, 1.0)
    before_m_a, before_m_b = float(_P.r_a**2), float(_P.l**2)  # as (13) has them
    return Erratum(
        "masses",
        "after Fig. 2",
        "m_a is the mass of the passive link and m_b that of the active link",
        "the other way round",
        "The motion of the links shows what a kilogram of either link adds to the inertia X at the active joint. The "
        "factors of m_a and m_b in (13) show that m_b is the mass of the carried link.",
        {
            "of the active link (m^2)": driven,
            "of the passive link (m^2)": carried,
            "factor of m_a in (13) (m^2)": before_m_a,
            "factor of m_b in (13) (m^2)": before_m_b,
        },
        abs(driven - before_m_a) + abs(carried - before_m_b) < 1e-15 < abs(carried - before_m_a),
    )


def uncertainty_sign(material: Material) -> Erratum:
    """The sign of C theta_e' in (33)."""
    key = "1"
    m = material.motions[key]
    r = material.runs.closed_loop[key, "nominal"]
    rate_ref = np.gradient(r["trajectory.omega_ref"], r.time, axis=0, edge_order=2)
    alpha_a = np.gradient(r["plant.omega_a"], r.time, axis=0, edge_order=2)
    scale = difference_minus = difference_plus = 0.0
    for i in range(500, len(r.time), 500):
        theta = np.concatenate([r["plant.theta_a"][i], r["plant.theta_b"][i]])
        omega = np.concatenate([r["plant.omega_a"][i], r["plant.omega_b"][i]])
        form = reduced_form(theta, omega, r["plant.F_c"][i], _P.X, _P.Y, _P.Z, _P.l)
        error_rate = r["plant.omega_a"][i] - r["trajectory.omega_ref"][i]
        rest = -form.F - form.M @ rate_ref[i] - form.C @ r["trajectory.omega_ref"][i]
        # M theta_e'' = tau_a + (what (33) has besides the terms in S and M')
        needed = form.M @ (alpha_a[i] - rate_ref[i]) - r["controller.tau_a"][i]
        scale = max(scale, float(np.abs(needed).max()))
        difference_minus = max(difference_minus, float(np.abs(rest - form.C @ error_rate - needed).max()))
        difference_plus = max(difference_plus, float(np.abs(rest + form.C @ error_rate - needed).max()))
    return Erratum(
        "uncertainty-sign",
        "(33), as the scan reads",
        "g = C theta_e' - F - ...",
        "g = -C theta_e' - F - ..., as (51) has it",
        "M theta_e'' less the torque is compared with the terms of (33) with either sign, along a run without "
        "uncertainty.",
        {
            "largest term (N m)": scale,
            "difference as printed (N m)": difference_plus,
            "difference with -C (N m)": difference_minus,
        },
        bool(difference_plus > 10 * difference_minus and m.time.size),
    )


def force_of_torque(material: Material) -> Erratum:
    """F of (28) depends on the torque."""
    theta, omega, tau_a, _ = _open_loop_states(material)[1]
    J_a, _ = velocity_jacobians(theta, _P.l)
    internal = np.linalg.svd(J_a.T)[2][-1]  # no power in any motion of the closed chain
    found = []
    for extra in (0.0, 10.0):
        torque = tau_a + extra * internal
        acceleration, F_c = closed_chain(theta, omega, torque, _P.X, _P.Y, _P.Z, _P.l, _P.x_A, _P.y_A, 0.0)
        found.append((acceleration, reduced_form(theta, omega, F_c, _P.X, _P.Y, _P.Z, _P.l).F))
    (before, F_before), (after, F_after) = found
    change = float(np.linalg.norm(F_after - F_before))
    return Erratum(
        "force-of-torque",
        "(28), (33), Assumption 4",
        "F(theta', theta, delta)",
        "F depends on the torque as well, by (19): the motors can pull at each other and move nothing. The bound "
        "of |g| then depends on the control, and with it on the gains",
        "10 N m of torque that moves nothing are added in a state of the open loop.",
        {
            "change of F (N m)": change,
            "change of the accelerations (rad/s^2)": float(np.abs(after - before).max()),
        },
        abs(change - 10.0) < 1e-6 and float(np.abs(after - before).max()) < 1e-10,
    )


def sizes(material: Material) -> Erratum:
    """One element a constraint in c and b."""
    theta, omega, *_ = _open_loop_states(material)[1]
    A, b = constraint_matrix(theta, _P.l), constraint_bias(theta, omega, _P.l)
    return Erratum(
        "sizes",
        "(3), (6)",
        "c and b in R^n",
        "in R^m: one element for each of the m constraints",
        "A and b of the robot's closure are computed.",
        {"joints n": float(A.shape[1]), "constraints m": float(A.shape[0]), "elements of b": float(b.size)},
        b.size == A.shape[0] != A.shape[1],
    )


def fig_4_duration(material: Material) -> Erratum:
    """How long the run of Fig. 4 was."""
    duration = seconds_in_printed_axes(material.runs.open_loop)
    return Erratum(
        "fig-4-duration",
        "Fig. 4",
        "no duration",
        f"at most {duration:.2f} s: then the path leaves the printed axes",
        f"The end effector leaves x {PRINTED_X}, y {PRINTED_Y} m at this time.",
        {"time in the axes (s)": duration, "run of the other figures (s)": float(material.runs.info["stop_time"])},
        0.0 < duration < material.runs.info["stop_time"],
    )
