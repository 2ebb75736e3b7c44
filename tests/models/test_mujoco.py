"""The robot by MuJoCo: its closures are soft, so that it must come to ours, at a known rate, as they stiffen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fmu_export.trace.trace import trace
from plant_fmu.model import MODEL, PARAMETERS
from tests.support.closed_states import closed_states
from tests.support.continuous_loop import control_law, end_effector, integrate
from tests.support.oracles.links import Links

pytest.importorskip("mujoco", reason="MuJoCo can't be imported: install the extra 'oracles'", exc_type=ImportError)
from tests.support.oracles.mujoco_robot import MujocoRobot

LINKS = Links.of_plant()
STATES = closed_states(200)
START = MODEL.initial_state(PARAMETERS.starts)

#: MuJoCo's impedance d: 1 would be rigid, and 0.9999 is the most it allows.
IMPEDANCES = np.array([0.99, 0.999, 0.9999])

#: Time constants (s) of the decay of a closure error.
TIME_CONSTANTS = np.array([16e-3, 8e-3, 4e-3, 2e-3])

#: Step of MuJoCo's RK4 (s) and duration (s) of the paths.
STEP, DURATION = 1e-3, 1.0


def order(softness: np.ndarray, errors: list[float]) -> float:
    return float(np.polyfit(np.log(softness), np.log(errors), 1)[0])


# --- accelerations ---


def accelerations(links: Links, impedance: float) -> np.ndarray:
    """Accelerations (n, 6) in rad/s^2 at all states."""
    robot = MujocoRobot(links, impedance)
    return np.array([robot.accelerations(*state) for state in STATES])


def our_accelerations(dm: float) -> np.ndarray:
    rates = [
        MODEL.derivatives(
            0.0, np.concatenate([theta, omega]), np.concatenate([tau_a, np.zeros(3), [dm, 0.0]]), PARAMETERS.starts
        )
        for theta, omega, tau_a in STATES
    ]
    return np.array(rates)[:, 6:]


def largest_relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float((np.abs(found - expected).max(axis=1) / np.abs(expected).max(axis=1)).max())


def rigid(links: Links) -> np.ndarray:
    """Accelerations (n, 6) in the limit d -> 1, by the parabola through three stiffnesses."""
    d = np.array([0.999, 0.9995, 0.9999])
    softness = (1 - d) / d  # what MuJoCo adds to A M^-1 A^T is proportional to this
    values = np.array([accelerations(links, impedance) for impedance in d])
    coefficients = np.linalg.solve(np.vander(softness, increasing=True), values.reshape(len(d), -1))
    return coefficients[0].reshape(values.shape[1:])


@pytest.mark.parametrize("dm", [-0.25, 0.0, 0.25])
def test_accelerations_converge_as_the_closures_stiffen(dm: float) -> None:
    """At 200 random closed states, which move: linearly in 1 - d, and to ours."""
    links, expected = LINKS.grown(dm), our_accelerations(dm)
    errors = [largest_relative(accelerations(links, d), expected) for d in IMPEDANCES]
    limit = largest_relative(rigid(links), expected)
    print(f"largest relative differences {errors} at d = {IMPEDANCES}, extrapolated {limit:.1e}")
    assert order(1 - IMPEDANCES, errors) == pytest.approx(1.0, abs=0.02)
    assert limit < 1e-8


@pytest.mark.parametrize("name", ["m_a", "r_a", "J_a", "m_b", "r_b", "J_b"])
def test_changed_link_is_found(name: str) -> None:
    """A part in 10^5 of any number of the links shows in the limit of stiff closures."""
    changed = dataclasses.replace(LINKS, **{name: getattr(LINKS, name) * (1 + 1e-5)})
    assert largest_relative(rigid(changed), our_accelerations(0.0)) > 1e-7


# --- paths ---


_LAW = control_law()


def torque(t: float, theta: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """PD control on the desired path: the paper's law (38) with psi = 0."""
    return _LAW(t, np.concatenate([theta, omega]), np.zeros(2))[0].full().ravel()


@pytest.fixture(scope="module")
def path() -> np.ndarray:
    """End effector (n, 2) in m of our plant under `torque`, after each step."""
    derivatives = trace(MODEL).derivatives

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        u = np.append(torque(t, x[:6], x[6:]), np.zeros(5))
        return derivatives(t, x, u, PARAMETERS.starts).full().ravel()

    times = STEP * np.arange(round(DURATION / STEP) + 1)
    return end_effector(integrate(rate, START, times, [], rtol=1e-12))[1:]


def distance(path: np.ndarray, impedance: float, time_constant: float, links: Links = LINKS) -> float:
    """Largest distance (m) of the end effector by MuJoCo from ours."""
    found = MujocoRobot(links, impedance, time_constant).path(START[:6], torque, DURATION, STEP)
    return float(np.hypot(*(found - path).T).max())


@pytest.mark.slow
def test_closed_loop_converges_as_the_closures_stiffen(path: np.ndarray) -> None:
    """Over 1 s, with MuJoCo's own integrator: linearly in 1 - d, and with the square of the time constant."""
    by_impedance = [distance(path, d, TIME_CONSTANTS[0]) for d in IMPEDANCES]
    by_time_constant = by_impedance[:1] + [distance(path, IMPEDANCES[0], tau) for tau in TIME_CONSTANTS[1:]]
    stiffest = distance(path, IMPEDANCES[-1], TIME_CONSTANTS[-1])
    print(
        f"largest distances {by_impedance} m at d = {IMPEDANCES}, {by_time_constant} m at time constants "
        f"{TIME_CONSTANTS} s, stiffest {stiffest:.1e} m"
    )
    assert order(1 - IMPEDANCES, by_impedance) == pytest.approx(1.0, abs=0.05)
    assert order(TIME_CONSTANTS, by_time_constant) == pytest.approx(2.0, abs=0.1)
    assert stiffest < 1e-9


def test_a_gram_on_the_passive_links_is_found_on_the_path(path: np.ndarray) -> None:
    """However stiff the closures."""
    heavier = dataclasses.replace(LINKS, m_b=LINKS.m_b + 1e-3)
    assert distance(path, IMPEDANCES[-1], TIME_CONSTANTS[-1], heavier) > 1e-6
