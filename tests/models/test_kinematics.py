"""Kinematics of the three chains against complex-step derivatives, the paper's printed start and exact inverses."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plant_fmu.kinematics import (
    chain_ends,
    constraint_bias,
    constraint_matrix,
    directions,
    directions_to,
    inverse_kinematics,
    loop_closure,
    reach_margin,
    velocity_jacobians,
)
from plant_fmu.model import PARAMETERS
from trajectory_fmu import model as trajectory

P = PARAMETERS.unpack(PARAMETERS.starts)
GEOMETRY = (P.l, P.x_A, P.y_A)

angles = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


def test_start_is_the_papers_to_its_printed_digits() -> None:
    theta = inverse_kinematics(0.22, 0.30, *GEOMETRY)
    np.testing.assert_array_equal(theta.round(4), [1.3137, 2.9036, -1.4326, -0.8667, 1.4594, 2.9720])
    # the paper prints 1.4593: it cut 1.45940 where it rounded the others
    np.testing.assert_allclose(theta, [1.3137, 2.9036, -1.4326, -0.8667, 1.4593, 2.972], atol=1e-4)


def test_papers_first_base_does_not_close_the_loop() -> None:
    """Erratum: with A1 = (0, 0), as printed, the chains miss each other by a quarter of a metre."""
    printed = np.array([1.3137, 2.9036, -1.4326, -0.8667, 1.4593, 2.972])
    assert np.abs(loop_closure(printed, P.l, P.x_A, P.y_A)).max() < 4e-5
    assert np.abs(loop_closure(printed, P.l, P.x_A, np.array([0.0, 0.0, 0.5005]))).max() > 0.24


@given(st.floats(0.18, 0.27), st.floats(0.25, 0.38))
def test_inverse_kinematics_closes_every_chain_at_the_position(x: float, y: float) -> None:
    theta = inverse_kinematics(x, y, *GEOMETRY)
    x_ends, y_ends = chain_ends(theta, *GEOMETRY)
    np.testing.assert_allclose(x_ends, x, atol=1e-15)
    np.testing.assert_allclose(y_ends, y, atol=1e-15)


@given(st.floats(0.18, 0.27), st.floats(0.25, 0.38))
def test_directions_without_angles_are_those_of_the_angles(x: float, y: float) -> None:
    links = directions_to(x, y, *GEOMETRY)
    expected = directions(inverse_kinematics(x, y, *GEOMETRY))
    np.testing.assert_allclose(links.cosines, expected.cosines, atol=2e-15)
    np.testing.assert_allclose(links.sines, expected.sines, atol=2e-15)
    np.testing.assert_allclose(np.hypot(*links), 1.0, atol=1e-15)


def test_directions_out_of_reach_are_no_numbers() -> None:
    with np.errstate(invalid="ignore"):
        assert np.isnan(directions_to(2.0, 0.3, *GEOMETRY).cosines).all()


def test_angles_are_continuous_over_the_whole_reachable_workspace() -> None:
    """|theta_a|^2 in (89) is not invariant under whole turns, so no turn may be gained on the way."""
    grid = [(x, y) for x in np.linspace(-0.1, 0.5, 121) for y in np.linspace(-0.05, 0.55, 121)]
    reachable = {p for p in grid if reach_margin(*p, *GEOMETRY).min() > 1e-3}
    assert len(reachable) > 3000
    right = [(p, q) for p, q in zip(grid, grid[121:], strict=False) if p in reachable and q in reachable]
    jumps = [np.abs(inverse_kinematics(*p, *GEOMETRY) - inverse_kinematics(*q, *GEOMETRY)).max() for p, q in right]
    assert max(jumps) < 0.5


@given(angles)
def test_constraint_matrix_is_the_derivative_of_the_closure(theta: np.ndarray) -> None:
    step = 1e-30
    columns = [np.imag(loop_closure(theta + 1j * step * e, *GEOMETRY)) / step for e in np.eye(6)]
    np.testing.assert_allclose(constraint_matrix(theta, P.l), np.array(columns).T, atol=1e-15)


@given(angles, angles)
def test_constraint_bias_is_minus_the_rate_of_the_matrix(theta: np.ndarray, omega: np.ndarray) -> None:
    """A theta'' + A' theta' = 0 is (16) differentiated twice, so b = -A' theta'."""
    A_rate = np.imag(constraint_matrix(theta + 1e-30j * omega, P.l)) / 1e-30
    np.testing.assert_allclose(constraint_bias(theta, omega, P.l), -A_rate @ omega, atol=1e-12)


@given(st.floats(0.18, 0.27), st.floats(0.25, 0.38), st.floats(-1, 1), st.floats(-1, 1))
def test_jacobians_map_the_end_effector_velocity_to_joint_velocities(
    x: float, y: float, v_x: float, v_y: float
) -> None:
    """(22), (23): joints that move by J_a v, J_b v move every chain end by v, so the loop stays closed."""
    theta = inverse_kinematics(x, y, *GEOMETRY)
    J_a, J_b = velocity_jacobians(theta, P.l)
    omega = np.concatenate([J_a, J_b]) @ [v_x, v_y]
    x_ends, y_ends = chain_ends(theta + 1e-30j * omega, *GEOMETRY)
    np.testing.assert_allclose(np.imag(x_ends) / 1e-30, v_x, atol=1e-12)
    np.testing.assert_allclose(np.imag(y_ends) / 1e-30, v_y, atol=1e-12)


def test_constraint_matrix_has_full_rank_over_the_whole_reachable_workspace() -> None:
    """What lets (19) be written without a pseudo-inverse; on the default path cond(A) is 2.3 to 3.9."""
    grid = [(x, y) for x in np.linspace(-0.1, 0.5, 61) for y in np.linspace(-0.05, 0.55, 61)]
    reachable = [p for p in grid if reach_margin(*p, *GEOMETRY).min() > 0]
    conditions = [np.linalg.cond(constraint_matrix(inverse_kinematics(*p, *GEOMETRY), P.l)) for p in reachable]
    assert max(conditions) < 20
    path = [trajectory.desired_path(t, trajectory.PARAMETERS.starts)[0] for t in np.linspace(0, 2 * np.pi, 200)]
    on_path = [np.linalg.cond(constraint_matrix(inverse_kinematics(*p, *GEOMETRY), P.l)) for p in path]
    assert 2.2 < min(on_path) < max(on_path) < 4.0


def test_reach_margin_changes_sign_where_the_chain_is_stretched() -> None:
    x = P.x_A[0] + 2 * P.l
    assert reach_margin(x - 1e-9, P.y_A[0], *GEOMETRY)[0] > 0
    assert reach_margin(x + 1e-9, P.y_A[0], *GEOMETRY)[0] < 0
