"""Errata of sections 2, 3 and 6: the model, its numbers and the figures."""

from __future__ import annotations

import numpy as np

from controller_fmu import model as controller
from parallel_robot.paper.reproduce.content import Erratum
from parallel_robot.paper.reproduce.draw_errors import PRINTED_STEADY
from parallel_robot.paper.reproduce.draw_model import PRINTED_X, PRINTED_Y, seconds_in_printed_axes
from parallel_robot.paper.reproduce.material import ERRORS, Material
from parallel_robot.paper.reproduce.measure_model import closure_force
from plant_fmu.dynamics import coriolis_matrix, mass_matrix
from plant_fmu.kinematics import chain_ends, constraint_bias, constraint_matrix, loop_closure
from plant_fmu.model import PARAMETERS
from plant_fmu.reduced import reduced_form

#: Start angles as printed in section 6 (rad).
PRINTED_START = np.array([1.3137, 2.9036, -1.4326, -0.8667, 1.4593, 2.972])

_P = PARAMETERS.unpack(PARAMETERS.starts)


def base_1(material: Material) -> Erratum:  # noqa: ARG001
    """A1 is not at the origin."""
    as_printed, corrected = (
        float(np.linalg.norm(loop_closure(PRINTED_START, _P.l, _P.x_A, np.array([y, *_P.y_A[1:]]))))
        for y in (0.0, 0.25)
    )
    x, y = (end.mean() for end in chain_ends(PRINTED_START, _P.l, _P.x_A, _P.y_A))
    return Erratum(
        "base-1",
        "section 6",
        "A1 = (0, 0)",
        "A1 = (0, 0.25) m",
        "Loop closure at the printed start angles, with either base. Only with the second do the three chains meet.",
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
        "Residual of the constraint A theta'' = b (17) at states of the open loop, with the closure force of either B.",
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
        "What a kilogram of either link adds to the inertia X felt by the active joint, from the motion of the links, "
        "and the factors of m_a and m_b in (13): m_b is the mass of the link that is carried.",
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
        "M theta_e'' less the torque, along a run without uncertainty, against the terms of (33) with either sign.",
        {
            "largest term (N m)": scale,
            "difference as printed (N m)": difference_plus,
            "difference with -C (N m)": difference_minus,
        },
        bool(difference_plus > 10 * difference_minus and m.time.size),
    )


def mass_support(material: Material) -> Erratum:
    """The mass change leaves its own fuzzy set."""
    dm = material.runs.closed_loop["1", "disturbed"]["plant.dm"]
    return Erratum(
        "mass-support",
        "(88) and after (93)",
        "dm is close to 0.25 on [0, 0.5]; dm = 0.25 sin(pi t)",
        "dm = 0.25 sin(pi t) is negative for nearly half of the run and never above the middle of (88)",
        "Values of dm along a run.",
        {
            "least dm (kg)": float(dm.min()),
            "largest dm (kg)": float(dm.max()),
            "share of negative (1)": float((dm < 0).mean()),
        },
        bool(dm.min() < 0.0),
    )


def turns(material: Material) -> Erratum:
    """(89) depends on how full turns are counted."""
    r = material.runs.closed_loop["1", "disturbed"]
    i = len(r.time) // 2
    inputs = {v.name: r[f"controller.{v.name}"][i] for v in controller.INPUTS.variables}
    turn = np.array([0.0, 0.0, 2 * np.pi])
    torques = []
    for shift in (0.0 * turn, turn):
        turned = {name: inputs[name] + shift for name in ("theta_a", "theta_ref")}
        u = controller.INPUTS.pack(**inputs | turned)
        p = controller.PARAMETERS.starts
        torques.append(controller.output_values(0.0, r["controller.psi"][i], u, p)[:3])
    ratio = float(np.linalg.norm(torques[1]) / np.linalg.norm(torques[0]))
    return Erratum(
        "full-turns",
        "(89)",
        "Pi depends on |theta_a|^2",
        "the control depends on how full turns are counted; the branch of the angles belongs to the controller's "
        "contract",
        "Torque in the same pose with the third active angle, measured and desired, counted one turn further.",
        {"torque with one more turn over torque (1)": ratio},
        abs(ratio - 1.0) > 0.01,
    )


def fig_4_duration(material: Material) -> Erratum:
    """How long the run of Fig. 4 was."""
    duration = seconds_in_printed_axes(material.runs.open_loop)
    return Erratum(
        "fig-4-duration",
        "Fig. 4",
        "no duration",
        f"at most {duration:.2f} s: then the path leaves the printed axes",
        f"Time that the end effector stays in x {PRINTED_X}, y {PRINTED_Y} m.",
        {"time in the axes (s)": duration, "run of the other figures (s)": float(material.runs.info["stop_time"])},
        0.0 < duration < material.runs.info["stop_time"],
    )


def steady_errors(material: Material) -> Erratum:
    """The insets of Figs. 8 to 12."""
    ratios = {n: material.metric("10", n, "steady_max") / PRINTED_STEADY[n] for n in ERRORS}
    return Erratum(
        "steady-errors",
        "insets of Figs. 8-12",
        "steady errors of 1e-6 m and 1e-5 rad",
        "millimetres and hundredths of a radian, from the printed law with the printed gains",
        "Largest steady error with the best gains (mu/nu = 10) over the largest that the printed inset can show.",
        {f"{name} (1)": ratio for name, ratio in ratios.items()},
        min(ratios.values()) > 10.0,
    )
