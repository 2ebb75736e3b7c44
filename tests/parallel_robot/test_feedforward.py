"""Feedforward of the nominal robot and torque limits, against other formulations, and in the closed loop of FMUs."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from controller_fmu import model as controller
from cosim import Results, System
from cosim.master.simulation import Simulation
from cosim.scenario import replaced
from fmu_export.modelling.functions import saturate
from fmu_export.modelling.variables import Layout
from fmu_export.pythonfmu.backend import build_pythonfmu
from fmu_export.trace.trace import trace
from parallel_robot.metrics import tracking_errors
from parallel_robot.models import MODELS
from parallel_robot.scenario import load_scenario
from parallel_robot.wiring import OPTIONAL_INPUTS
from plant_fmu.dynamics import closed_chain
from plant_fmu.inverse_dynamics import minimum_norm_torque
from plant_fmu.kinematics import inverse_kinematics, velocity_jacobian_rates, velocity_jacobians
from plant_fmu.model import PARAMETERS
from plant_fmu.reduced import reduced_form
from tests.support import some
from tests.support.native_fmus import DEFAULT_FLAVOUR
from trajectory_fmu import model as trajectory

P = PARAMETERS.unpack(PARAMETERS.starts)
XYZ = (P.X, P.Y, P.Z)
GEOMETRY = (P.l, P.x_A, P.y_A)


def desired_motions(n: int = 50) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Random poses theta (6,), with velocities and accelerations (2,) of the end effector."""
    random = np.random.default_rng(27)
    return [
        (
            inverse_kinematics(random.uniform(0.18, 0.27), random.uniform(0.27, 0.38), *GEOMETRY),
            random.uniform(-1, 1, 2),
            random.uniform(-5, 5, 2),
        )
        for _ in range(n)
    ]


# --- the torque ---


def test_the_torque_gives_the_desired_acceleration() -> None:
    """In the Udwadia-Kalaba equation of the whole chain, which knows no J_a and no (27)."""
    for theta, velocity, acceleration in desired_motions():
        J = np.concatenate(velocity_jacobians(theta, P.l))
        omega = J @ velocity
        tau = minimum_norm_torque(theta, velocity, acceleration, *XYZ, P.l)
        found, _ = closed_chain(theta, omega, tau, *XYZ, *GEOMETRY, 0.0)
        # the passive end of chain 1, differentiated twice
        i = [0, 3]
        direction = np.stack([-np.sin(theta[i]), np.cos(theta[i])])
        inward = np.stack([-np.cos(theta[i]), -np.sin(theta[i])])
        moved = P.l * (direction @ found[i] + inward @ omega[i] ** 2)
        np.testing.assert_allclose(moved, acceleration, atol=1e-11)


def test_the_torque_is_the_least_solution_of_27() -> None:
    """Singular values (numpy) in place of normal equations, and the matrices M, C of (27) in place of M_o, C_o."""
    for theta, velocity, acceleration in some(desired_motions()):
        J_a, J_b = velocity_jacobians(theta, P.l)
        omega = np.concatenate([J_a, J_b]) @ velocity
        domega_a = J_a @ acceleration + velocity_jacobian_rates(theta, omega, P.l)[0] @ velocity
        form = reduced_form(theta, omega, np.zeros(6), *XYZ, P.l)
        wanted = J_a.T @ (form.M @ domega_a + form.C @ omega[:3])
        tau = minimum_norm_torque(theta, velocity, acceleration, *XYZ, P.l)
        np.testing.assert_allclose(tau, np.linalg.lstsq(J_a.T, wanted, rcond=None)[0], atol=1e-12)
        null = np.linalg.svd(J_a.T)[2][2]  # torques along it move nothing
        assert abs(null @ tau) < 1e-12
        more = closed_chain(theta, omega, tau + null, *XYZ, *GEOMETRY, 0.0)[0]
        np.testing.assert_allclose(more, closed_chain(theta, omega, tau, *XYZ, *GEOMETRY, 0.0)[0], atol=1e-11)


def desired(t: float) -> dict[str, np.ndarray]:
    p = trajectory.PARAMETERS.starts
    return vars(trajectory.OUTPUTS.unpack(trajectory.output_values(t, np.zeros(0), np.zeros(0), p)))


def test_the_trajectory_gives_the_torque_of_its_own_path() -> None:
    """The robot under tau_ref accelerates as omega_ref rises, by central differences."""
    h = 1e-5
    for t in np.linspace(0.0, 7.0, 30):
        now, later, earlier = desired(t), desired(t + h), desired(t - h)
        theta = inverse_kinematics(now["x_ref"], now["y_ref"], *GEOMETRY)
        velocity = np.array([later[name] - earlier[name] for name in ("x_ref", "y_ref")]) / (2 * h)
        omega = np.concatenate(velocity_jacobians(theta, P.l)) @ velocity
        found, _ = closed_chain(theta, omega, now["tau_ref"], *XYZ, *GEOMETRY, 0.0)
        np.testing.assert_allclose(found[:3], (later["omega_ref"] - earlier["omega_ref"]) / (2 * h), atol=1e-7)


# --- the controller ---


def parameters(**given: object) -> np.ndarray:
    starts = vars(controller.PARAMETERS.unpack(controller.PARAMETERS.starts))
    return controller.PARAMETERS.pack(**starts | given)


def torque(u: np.ndarray, psi: np.ndarray, p: np.ndarray) -> np.ndarray:
    return controller.output_values(0.0, psi, u, p)[:3]


def random_inputs(n: int = 20) -> list[tuple[np.ndarray, np.ndarray]]:
    random = np.random.default_rng(5)
    return [(random.normal(size=15), random.uniform(0, 1, 2)) for _ in range(n)]


def test_off_by_default_to_the_last_bit() -> None:
    p = controller.PARAMETERS.starts
    P_c = controller.PARAMETERS.unpack(p)
    for u, psi in random_inputs():
        U = controller.INPUTS.unpack(u)
        s = (U.omega_a - U.omega_ref) + P_c.S * (U.theta_a - U.theta_ref)
        Pi = psi @ np.stack([U.theta_a @ U.theta_a, U.omega_a @ U.omega_a])
        np.testing.assert_array_equal(torque(u, psi, p), P_c.alpha * (-s * Pi**2) + P_c.beta * -s)


def test_the_share_of_the_feedforward_is_added() -> None:
    for u, psi in random_inputs():
        added = torque(u, psi, parameters(feedforward=0.5)) - torque(u, psi, parameters())
        np.testing.assert_allclose(added, 0.5 * u[12:], atol=1e-13 * np.abs(torque(u, psi, parameters())).max())


def test_limits_hold_for_the_sum_and_do_not_touch_the_estimate() -> None:
    limits = np.array([0.5, 1.0, 0.0])
    for u, psi in random_inputs():
        free, limited = parameters(feedforward=1.0), parameters(feedforward=1.0, tau_max=limits)
        np.testing.assert_array_equal(torque(u, psi, limited), np.clip(torque(u, psi, free), -limits, limits))
        rates = [controller.derivatives(0.0, psi, u, p) for p in (free, limited)]
        np.testing.assert_array_equal(*rates)


def test_saturation_is_a_clip_that_keeps_nan() -> None:
    limit = np.full(9, 2.0)
    v = np.array([-np.inf, -2.5, -2.0, np.nextafter(-2.0, 0.0), 0.0, 1.0, np.nextafter(2.0, 0.0), 2.0, 1e300])
    np.testing.assert_array_equal(saturate(v[1:], limit[1:]), np.clip(v, -2.0, 2.0)[1:])
    assert np.isnan(saturate(np.array([np.nan]), np.array([2.0]))[0])


def test_the_derivative_of_the_torque_is_finite_at_the_kink_and_zero_beyond() -> None:
    """As importers get it who ask for directional derivatives."""
    direction = trace(MODELS["controller"]).direction
    u, psi = random_inputs(1)[0]
    size = np.abs(torque(u, psi, parameters()))
    du = np.concatenate([np.ones(3), np.zeros(12)])

    def along(p: np.ndarray) -> np.ndarray:
        zeros = [np.zeros(n) for n in (2, len(p))]
        return np.asarray(ca.DM(direction(0.0, psi, u, p, zeros[0], du, zeros[1]))).ravel()[:3]

    h = 1e-6
    free = (torque(u + h * du, psi, parameters()) - torque(u - h * du, psi, parameters())) / (2 * h)
    np.testing.assert_allclose(along(parameters()), free, rtol=1e-6)
    np.testing.assert_allclose(along(parameters(tau_max=1.001 * size)), free, rtol=1e-6)
    np.testing.assert_array_equal(along(parameters(tau_max=size)), 0.0)
    np.testing.assert_array_equal(along(parameters(tau_max=0.9 * size)), 0.0)


# --- the FMUs ---


@pytest.fixture(scope="module")
def loop(robot_fmus: Path) -> Iterator[Simulation]:
    scenario = load_scenario("tracking-undisturbed")
    system, linear = (
        scenario.system(robot_fmus, DEFAULT_FLAVOUR),
        "auto" if DEFAULT_FLAVOUR == "pythonfmu" else "linear",
    )
    with Simulation(system, order=scenario.order, extrapolation=linear) as simulation:
        yield simulation


def test_with_the_true_masses_the_error_is_that_of_the_coupling(loop: Simulation) -> None:
    """It vanishes with the communication step, in second order; without feedforward it does not."""

    def error(step: float, feedforward: float) -> float:
        results = loop.run(9.0, step, start={"controller.feedforward": feedforward})
        errors = tracking_errors(results)
        return float(np.hypot(errors["x"], errors["y"])[results.time > 8.0].max())

    coarse, fine = (error(step, 1.0) for step in (4e-3, 2e-3))
    assert coarse / fine == pytest.approx(4.0, rel=0.1)
    assert fine < 1e-6 < 1e-3 < error(2e-3, 0.0)


def test_the_estimate_does_not_wind_up(loop: Simulation) -> None:
    """Once motors that are too weak for the start have caught up, psi forgets it at its rate of 1/s."""
    free, limited = (loop.run(12.0, 1e-3, start={"controller.tau_max": limit}) for limit in (1e60, 0.2))
    apart = np.linalg.norm(limited["controller.psi"] - free["controller.psi"], axis=1)
    saturated = np.abs(limited["plant.tau_a"]).max(axis=1) == 0.2
    last = limited.time[saturated].max()
    assert 0.0 < last < 5.0
    after = limited.time > last + 5.0
    assert apart[limited.time <= last].max() > 1e-4
    assert apart[after].max() < np.exp(-5.0) * apart.max()


def test_a_desired_path_without_torque_still_fits(tmp_path: Path, fmus: Path) -> None:
    """The controller's optional input is then held at zero."""
    model = MODELS["trajectory"]
    of_torque = ("X", "Y", "Z")  # nothing else depends on them
    parameters = [
        dataclasses.replace(v, tunable=False) if v.name in of_torque else v for v in model.parameters.variables
    ]
    bare = dataclasses.replace(
        model,
        parameters=Layout(parameters),
        outputs=Layout([v for v in model.outputs.variables if v.name != "tau_ref"]),
        output_values=lambda t, x, u, p: model.output_values(t, x, u, p)[:8],
    )
    own = build_pythonfmu(bare, tmp_path)
    given = load_scenario("tracking").system(fmus.parent, "pythonfmu")
    system, missing = replaced(given, {"trajectory": own}, OPTIONAL_INPUTS)
    assert missing == ["trajectory.tau_ref"]
    assert system.components["controller"].start["tau_ref"] == 0.0
    assert "tau_ref" not in given.components["controller"].start
    same = [run(s) for s in (given, system)]
    np.testing.assert_array_equal(same[0]["plant.x_E"], same[1]["plant.x_E"])


def run(system: System) -> Results:
    with Simulation(system) as simulation:
        return simulation.run(0.02, 1e-3)
