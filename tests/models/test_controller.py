"""Control law, adaptive law and desired path against their equations written out by hand, and their invariants."""

from __future__ import annotations

import numpy as np
import pytest

from controller_fmu import model as controller
from plant_fmu.model import PARAMETERS as PLANT
from trajectory_fmu import model as trajectory

RNG = np.random.default_rng(11)

#: Torque of the nominal model (N m), which by default has no part in the control.
TAU_REF = np.array([0.1, -0.2, 0.3])


def parameters(**given: object) -> np.ndarray:
    """Parameters of the controller: its start values but for those given."""
    starts = vars(controller.PARAMETERS.unpack(controller.PARAMETERS.starts))
    return controller.PARAMETERS.pack(**starts | given)


def law(u: np.ndarray, psi: np.ndarray, alpha: float, beta: float, k: float, S: list[float]) -> tuple[list, list]:
    """(38), (89) and (90) element by element, in plain Python."""
    theta_a, omega_a, theta_ref, omega_ref = (list(map(float, part)) for part in np.split(u[:12], 4))
    s = [(omega_a[i] - omega_ref[i]) + S[i] * (theta_a[i] - theta_ref[i]) for i in range(3)]
    squares = sum(a * a for a in theta_a), sum(w * w for w in omega_a)
    bound = psi[0] * squares[0] + psi[1] * squares[1]
    torque = [-alpha * s_i * bound**2 - beta * s_i for s_i in s]
    norm = sum(s_i * s_i for s_i in s) ** 0.5
    return torque, [norm * squares[j] / k - psi[j] for j in range(2)]


@pytest.mark.parametrize("_", range(20))
def test_law_is_the_papers(_: int) -> None:
    u, psi = np.append(RNG.normal(size=12), TAU_REF), RNG.uniform(0, 1, 2)
    alpha, beta, k, S = 1.3, 1.7, 9.0, [2.0, 2.5, 3.0]
    p = parameters(alpha=alpha, beta=beta, S=np.array(S), k=k)
    torque, rate = law(u, psi, alpha, beta, k, S)
    outputs = controller.OUTPUTS.unpack(controller.output_values(0.0, psi, u, p))
    np.testing.assert_allclose(outputs.tau_a, torque, rtol=1e-13)
    np.testing.assert_array_equal(outputs.psi, psi)
    np.testing.assert_allclose(controller.derivatives(0.0, psi, u, p), rate, rtol=1e-13)


def test_a_full_turn_of_a_joint_changes_the_torque() -> None:
    """Erratum: (89) is not invariant under theta_a + 2 pi, although reference and angle turn together."""
    u, psi, p = np.append(RNG.normal(size=12), TAU_REF), np.array([0.05, 0.001]), controller.PARAMETERS.starts
    turned = u.copy()
    turned[[0, 6]] += 2 * np.pi
    before, after = (controller.output_values(0.0, psi, v, p)[:3] for v in (u, turned))
    assert np.abs(after - before).max() > 1e-3


@pytest.mark.parametrize(("angles", "constant"), [(0.0, 1.0), (0.25, 2.0)])
def test_another_bounding_function_is_in_torque_and_adaptation(angles: float, constant: float) -> None:
    """As with the printed one for a psi and a k that give the same first term; with a constant alone turns are free."""
    u, psi = np.append(RNG.normal(size=12), TAU_REF), np.array([0.05, 0.3])
    p = parameters(bound_angles=angles, bound_constant=constant)
    square = u[:3] @ u[:3]
    first = constant + angles * square
    printed = np.array([psi[0] * first / square, psi[1]])
    torque, rate = law(u, printed, 1.3597632624476745, 1.6620017712713446, 12.0, [2.0, 2.0, 2.0])
    np.testing.assert_allclose(controller.output_values(0.0, psi, u, p)[:3], torque, rtol=1e-13)
    growth = (rate + printed) * np.array([first / square, 1.0])
    np.testing.assert_allclose(controller.derivatives(0.0, psi, u, p), growth - psi, rtol=1e-13)
    turned = u.copy()
    turned[[0, 6]] += 2 * np.pi
    change = np.abs(np.subtract(*(controller.output_values(0.0, psi, v, p)[:3] for v in (u, turned)))).max()
    assert (change < 1e-13) == (angles == 0.0)


def test_desired_path_is_93_about_its_centre() -> None:
    """With phase 0 and the centre taken off: the paper's products of cosines."""
    p = trajectory.PARAMETERS.starts.copy()
    names = trajectory.PARAMETERS.names
    p[names.index("phase")] = 0.0
    w, n, R, a, b = 1.0, 5.0, 0.5, 3.0, 0.06 / 3.5
    for t in np.linspace(0, 7, 50):
        position, _, _ = trajectory.desired_path(t, p)
        x = b * (a * np.cos(w * t) + R * np.cos(w * t) * np.cos(n * w * t))
        y = b * (a * np.sin(w * t) + R * np.sin(w * t) * np.cos(n * w * t))
        np.testing.assert_allclose(position, [0.225 + x, 0.355 + y], atol=1e-15)


def test_desired_start_is_where_the_papers_errors_put_it() -> None:
    """(0.225, 0.295): errors of (-5, +5) mm and (0.035, -0.018, -0.025) rad at t = 0 in Figs. 8-12."""
    position, _, _ = trajectory.desired_path(0.0, trajectory.PARAMETERS.starts)
    np.testing.assert_allclose(position, [0.225, 0.295], atol=1e-15)


def test_joint_references_lead_to_the_desired_position_and_velocity() -> None:
    p = trajectory.PARAMETERS.starts
    P = PLANT.unpack(PLANT.starts)
    for t in np.linspace(0, 7, 40):
        out = trajectory.OUTPUTS.unpack(trajectory.output_values(t, np.zeros(0), np.zeros(0), p))
        h = 1e-6
        later, earlier = (
            trajectory.OUTPUTS.unpack(trajectory.output_values(t + d, np.zeros(0), np.zeros(0), p)) for d in (h, -h)
        )
        np.testing.assert_allclose(out.omega_ref, (later.theta_ref - earlier.theta_ref) / (2 * h), atol=1e-8)
        reach = np.hypot(
            out.x_ref - P.x_A - P.l * np.cos(out.theta_ref), out.y_ref - P.y_A - P.l * np.sin(out.theta_ref)
        )
        np.testing.assert_allclose(reach, P.l, rtol=1e-13)  # the passive link spans from the elbow to the path


def test_without_leakage_the_estimate_never_falls() -> None:
    """The leakage is what is subtracted: all of psi with 1, as in (37), and nothing with 0."""
    u, psi = np.append(RNG.normal(size=12), TAU_REF), np.array([0.3, 0.7])
    with_it, half, none = (
        controller.derivatives(0.0, psi, u, parameters(leakage=leakage)) for leakage in (1.0, 0.5, 0.0)
    )
    np.testing.assert_allclose(none - with_it, psi, rtol=1e-12)
    np.testing.assert_allclose(none - half, psi / 2, rtol=1e-12)
    assert (none > 0.0).all()
