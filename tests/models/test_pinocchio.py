"""The robot by Pinocchio: accelerations, closure forces and paths from bodies and joints instead of (12)-(20)."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import sqrtm

from fmu_export.trace.trace import trace
from parallel_robot.paper.reproduce.content import PRINTED_START, PRINTED_X, PRINTED_Y
from parallel_robot.scenario import load_scenario
from plant_fmu.dynamics import coriolis_matrix, mass_matrix
from plant_fmu.kinematics import constraint_bias, constraint_matrix
from plant_fmu.model import MODEL, OUTPUTS, PARAMETERS
from tests.support.closed_states import closed_states
from tests.support.continuous_loop import control_law, end_effector, integrate, solve
from tests.support.native_fmus import Host
from tests.support.oracles.links import Links, to_angles, to_joints
from trajectory_fmu.model import PARAMETERS as TRAJECTORY
from trajectory_fmu.model import desired_path

pytest.importorskip(
    "pinocchio", reason="Pinocchio can't be imported: install the extra 'oracles'", exc_type=ImportError
)
from tests.support.oracles.pinocchio_robot import PinocchioRobot

P = PARAMETERS.unpack(PARAMETERS.starts)
LINKS = Links.of_plant()
STATES = closed_states(200)
STATE_NAMES = MODEL.state_layout.names
TRACKING = load_scenario("tracking")

#: Points (s) at which paths are compared.
TIMES = np.arange(0, 1501) * 1e-2


def plant(theta: np.ndarray, omega: np.ndarray, tau_a: np.ndarray, dm: float) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations (6,) and closure force (6,) of the plant as it is shipped."""
    x, u = np.concatenate([theta, omega]), np.concatenate([tau_a, np.zeros(3), [dm, 0.0]])
    outputs = OUTPUTS.unpack(MODEL.output_values(0.0, x, u, PARAMETERS.starts))
    return MODEL.derivatives(0.0, x, u, PARAMETERS.starts)[6:], outputs.F_c


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference over the largest element."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


# --- one state ---


def test_random_states_are_closed_for_pinocchio_too() -> None:
    robot = PinocchioRobot(LINKS)
    for theta, omega, _ in STATES:
        q, v = to_joints(theta), to_joints(omega)
        assert np.ptp(robot.chain_ends(q), axis=0).max() < 1e-15
        assert np.ptp(robot.end_velocities(q, v), axis=0).max() < 1e-14
        assert np.abs(robot.end_velocities(q, v)).max() > 1e-3


def test_accelerations_and_closure_forces_at_random_closed_states() -> None:
    """With masses grown by a random dm within the paper's 0.25 kg."""
    robot, random = PinocchioRobot(LINKS), np.random.default_rng(5)
    differences = []
    for (theta, omega, tau_a), dm in zip(STATES, random.uniform(-0.25, 0.25, len(STATES)), strict=True):
        robot.grow(dm)
        found, expected = robot.closed_chain(theta, omega, tau_a), plant(theta, omega, tau_a, dm)
        differences.append([relative(f, e) for f, e in zip(found, expected, strict=True)])
    worst = np.max(differences, axis=0)
    print(f"largest relative difference: accelerations {worst[0]:.1e}, closure force {worst[1]:.1e}")
    assert (worst < 1e-12).all()


@pytest.mark.parametrize("name", ["m_a", "r_a", "J_a", "m_b", "r_b", "J_b"])
def test_changed_link_is_found(name: str) -> None:
    """A part in 10^8 of any number of the links shows, far above the tolerance of the comparison."""
    robot = PinocchioRobot(dataclasses.replace(LINKS, **{name: getattr(LINKS, name) * (1 + 1e-8)}))
    worst = max(relative(robot.closed_chain(*state)[0], plant(*state, 0.0)[0]) for state in STATES)
    assert 1e-10 < worst < 1e-6


# --- what the paper prints ---


def test_printed_base_leaves_the_loop_open() -> None:
    """Forward kinematics at the printed start angles: the chains meet with A1 = (0, 0.25), not with (0, 0)."""
    q = to_joints(np.array(PRINTED_START))
    gaps = {}
    for y in (0.0, 0.25):
        robot = PinocchioRobot(dataclasses.replace(LINKS, y_A=np.array([y, *LINKS.y_A[1:]])))
        gaps[y] = np.ptp(robot.chain_ends(q), axis=0).max()
    assert gaps[0.0] == pytest.approx(0.25, abs=1e-4)
    assert gaps[0.25] < 1e-4


def test_m_b_is_the_mass_of_the_passive_link() -> None:
    """(13) and (12) are Pinocchio's mass matrix with m_a on the active links; the naming after Fig. 2 gives another."""
    swapped = dataclasses.replace(LINKS, m_a=LINKS.m_b, m_b=LINKS.m_a)
    for theta, _, _ in STATES[:20]:
        expected = mass_matrix(theta, P.X, P.Y, P.Z)
        np.testing.assert_allclose(PinocchioRobot(LINKS).mass_matrix(theta), expected, atol=1e-15)
        assert np.abs(PinocchioRobot(swapped).mass_matrix(theta) - expected).max() > 1e-3


def test_closure_force_needs_the_inverse_root() -> None:
    """(10) with B = A M^(-1/2) is Pinocchio's closure force; with B = A M^(1/2), as printed, it is another."""
    robot = PinocchioRobot(LINKS)
    for theta, omega, tau_a in STATES[:20]:
        M, A = mass_matrix(theta, P.X, P.Y, P.Z), constraint_matrix(theta, P.l)
        Q = np.concatenate([tau_a, np.zeros(3)]) - coriolis_matrix(theta, omega, P.Z) @ omega
        root = np.real(sqrtm(M))
        missing = constraint_bias(theta, omega, P.l) - A @ np.linalg.solve(M, Q)
        _, F_c = robot.closed_chain(theta, omega, tau_a)
        assert relative(root @ np.linalg.pinv(A @ np.linalg.inv(root)) @ missing, F_c) < 1e-11
        assert relative(root @ np.linalg.pinv(A @ root) @ missing, F_c) > 1e-2


# --- whole paths ---


def disturbance(t: float) -> np.ndarray:
    """tau_d, dm and dm_rate (5,) of `tracking`; mass arrives moving."""
    return np.concatenate([_TAU_D(t), _DM(t), [0.0]])


_TAU_D, _DM = (
    TRACKING.signals[n].function(size, TRACKING.seed, n) for n, size in (("plant.tau_d", 3), ("plant.dm", 1))
)
_FIG_4 = load_scenario("open-loop").signals["plant.tau_a"].function(3, 0, "plant.tau_a")


def closed_loop_path(links: Links, times: np.ndarray) -> np.ndarray:
    """End effector (n, 2) in m of the closed loop, in the joint coordinates of Pinocchio."""
    robot, law = PinocchioRobot(links), control_law()

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v, w = state[:6], state[6:12], disturbance(t)
        x = np.concatenate([to_angles(q), to_angles(v)])
        tau_a, psi_rate = (part.full().ravel() for part in law(t, x, state[12:]))
        robot.grow(w[3])
        return np.concatenate([v, robot.joint_accelerations(q, v, tau_a + w[:3]), psi_rate])

    breakpoints = [b for b in TRACKING.signals["plant.tau_d"].breakpoints if b < times[-1]]
    return _end_effector(robot, integrate(rate, _start(psi=2), times, breakpoints, rtol=1e-10))


def open_loop_path(times: np.ndarray) -> np.ndarray:
    """End effector (n, 2) in m under the torques of the paper's Fig. 4."""
    robot = PinocchioRobot(LINKS)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        return np.concatenate([state[6:], robot.joint_accelerations(state[:6], state[6:], _FIG_4(t))])

    return _end_effector(robot, integrate(rate, _start(), times, [], rtol=1e-10))


def our_open_loop_path(times: np.ndarray) -> np.ndarray:
    """The same by the plant."""
    derivatives = trace(MODEL).derivatives

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return derivatives(t, x, np.append(_FIG_4(t), np.zeros(5)), PARAMETERS.starts).full().ravel()

    return end_effector(integrate(rate, MODEL.initial_state(PARAMETERS.starts), times, [], rtol=1e-10))


def _start(psi: int = 0) -> np.ndarray:
    return np.concatenate([to_joints(MODEL.initial_state(PARAMETERS.starts)[:6]), np.zeros(6 + psi)])


def _end_effector(robot: PinocchioRobot, states: np.ndarray) -> np.ndarray:
    return np.array([robot.chain_ends(state[:6]).mean(axis=0) for state in states])


@pytest.fixture(scope="module")
def path() -> np.ndarray:
    """End effector (n, 2) in m of `tracking` by Pinocchio, over 15 s."""
    return closed_loop_path(LINKS, TIMES)


@pytest.mark.slow
def test_closed_loop_is_the_same_over_15_s(path: np.ndarray) -> None:
    """With mass change and disturbance torque. Pinocchio's closure is not stabilised, ours is: neither matters."""
    ours = end_effector(solve(TIMES, disturbance, TRACKING.signals["plant.tau_d"].breakpoints, rtol=1e-10))
    distance = np.hypot(*(path - ours).T).max()
    print(f"largest distance {distance:.1e} m")
    assert distance < 1e-10


@pytest.mark.slow
def test_a_gram_on_the_passive_links_is_found_on_the_path(path: np.ndarray) -> None:
    times = TIMES[TIMES <= 1.0]
    heavier = closed_loop_path(dataclasses.replace(LINKS, m_b=LINKS.m_b + 1e-3), times)
    assert np.hypot(*(heavier - path[: len(times)]).T).max() > 1e-7


def test_steady_errors_are_millimetres_for_pinocchio_too(path: np.ndarray) -> None:
    """The insets of Figs. 8 and 9 show 1e-6 m: our equations of the plant are not the reason that we don't get it."""
    desired = np.array([desired_path(t, TRAJECTORY.starts)[0] for t in TIMES])
    steady = np.abs(path - desired)[TRACKING.steady_after <= TIMES].max(axis=0)
    print(f"largest steady errors {1e3 * steady} mm")
    assert steady == pytest.approx([3.713e-3, 4.314e-3], abs=0.01e-3)


def test_open_loop_is_the_same_and_leaves_the_axes_of_fig_4() -> None:
    """Under tau_a = 0.1 cos(pi t) N m the path leaves the printed axes before the 15 s of the other figures."""
    path = open_loop_path(TIMES)
    distance = np.hypot(*(path - our_open_loop_path(TIMES)).T).max()
    x, y = path.T
    outside = (x < PRINTED_X[0]) | (x > PRINTED_X[1]) | (y < PRINTED_Y[0]) | (y > PRINTED_Y[1] + 1e-9)
    first = TIMES[np.argmax(outside)]
    print(f"largest distance {distance:.1e} m, out of the axes at {first} s")
    assert distance < 1e-10
    assert 6.0 < first < 8.0


# --- through a stretched chain ---


@pytest.mark.parametrize("torque", [0.5, 1.0, 3.0])
def test_a_chain_is_driven_through_its_stretched_position(unpacked: Path, torque: float) -> None:
    """There J_a of (23) is infinite, but the constraint keeps its rank: steps of 1 ms pass as Pinocchio does."""
    tau_a, times = torque * np.array([0.0, 1.0, 1.0]), np.linspace(0.0, 1.2 / np.sqrt(torque), 121)
    robot = PinocchioRobot(LINKS)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        return np.concatenate([state[6:], robot.joint_accelerations(state[:6], state[6:], tau_a)])

    expected = integrate(rate, _start(), times, [], rtol=1e-11)
    angles = np.array([to_angles(state[:6]) for state in expected])
    stretched = np.sin(angles[:, 3:] - angles[:, :3])
    assert (np.diff(np.sign(stretched), axis=0) != 0.0).any()  # the elbow comes to the other side
    with Host(unpacked / "fmi2" / "RobotPlant") as host:
        host.run_up(dict(zip(["tau_a[1]", "tau_a[2]", "tau_a[3]"], tau_a, strict=True)))
        found = [host.get(list(STATE_NAMES))]
        for t, end in itertools.pairwise(times):
            host.must(host.step(t, end - t))
            found.append(host.get(list(STATE_NAMES)))
        assert host.get(["closure_error"])[0] < 1e-6
    distance = np.abs(np.array(found)[:, :6] - angles).max()
    print(f"{torque} N m: largest difference of an angle {distance:.1e} rad")
    assert distance < 1e-6
