"""What the models declare: variables with their units, start values and bounds, and what has to hold for them."""

from __future__ import annotations

import numpy as np
import pytest

from controller_fmu.model import MODEL as CONTROLLER
from controller_fmu.model import NO_LIMIT
from fmu_export.modelling.model import Model
from fmu_export.modelling.variables import Layout
from plant_fmu.kinematics import inverse_kinematics, velocity_jacobians
from plant_fmu.model import MODEL as PLANT
from plant_fmu.model import PARAMETERS as PLANT_PARAMETERS
from trajectory_fmu.model import MODEL as TRAJECTORY
from trajectory_fmu.model import PARAMETERS as PATH_PARAMETERS
from trajectory_fmu.model import desired_path

#: Of the robot (87), with the first base as it has to be: name -> unit, size, start, min.
ROBOT = {
    "X": ("kg.m2", None, 0.0932, 1e-12),
    "Y": ("kg.m2", None, 0.0381, 1e-12),
    "Z": ("kg.m2", None, 0.0426, 0.0),
    "l": ("m", None, 0.244, 1e-6),
    "x_A": ("m", 3, (0.0, 0.43, 0.4269), None),
    "y_A": ("m", 3, (0.25, 0.0, 0.5005), None),
}

PARAMETERS = {
    PLANT: ROBOT
    | {
        "m_a": ("kg", None, 1.2525, 1e-12),
        "m_b": ("kg", None, 1.0771, 1e-12),
        "r_a": ("m", None, 0.122, 0.0),
        "x_E_start": ("m", None, 0.22, None),
        "y_E_start": ("m", None, 0.30, None),
        "v_x_start": ("m/s", None, 0.0, None),
        "v_y_start": ("m/s", None, 0.0, None),
        "baumgarte": ("s-1", None, 10.0, 0.0),
    },
    CONTROLLER: {
        "alpha": ("1", None, 1.3597632624476745, 0.0),
        "beta": ("N.m.s/rad", None, 1.6620017712713446, 0.0),
        "S": ("s-1", 3, 2.0, 0.0),
        "k": ("1", None, 12.0, 1e-12),
        "leakage": ("s-1", None, 1.0, 0.0),
        "bound_angles": ("1", None, 1.0, 0.0),
        "bound_constant": ("1", None, 0.0, 0.0),
        "psi_start": ("1", 2, 0.0, None),
        "feedforward": ("1", None, 0.0, None),
        "tau_max": ("N.m", 3, 1e60, 0.0),
    },
    TRAJECTORY: ROBOT
    | {
        "x_c": ("m", None, 0.225, None),
        "y_c": ("m", None, 0.355, None),
        "phase": ("rad", None, -1.5707963267948966, None),
        "w": ("rad/s", None, 1.0, None),
        "n": ("1", None, 5.0, None),
        "R": ("1", None, 0.5, None),
        "a": ("1", None, 3.0, None),
        "b": ("m", None, 0.017142857142857144, None),
    },
}

TUNABLE = {
    PLANT: "X Y Z baumgarte",
    CONTROLLER: "alpha beta S k leakage bound_angles bound_constant feedforward tau_max",
    TRAJECTORY: "x_c y_c phase R a b X Y Z",
}

#: Inputs and outputs by model: name -> unit and size.
SIGNALS = {
    PLANT: (
        {"tau_a": ("N.m", 3), "tau_d": ("N.m", 3), "dm": ("kg", None)} | {"dm_rate": ("kg/s", None)},
        {"theta_a": ("rad", 3), "theta_b": ("rad", 3), "omega_a": ("rad/s", 3), "omega_b": ("rad/s", 3)}
        | {"x_E": ("m", None), "y_E": ("m", None), "F_c": ("N.m", 6), "closure_error": ("m", None)}
        | {"kinetic_energy": ("J", None)},
    ),
    CONTROLLER: (
        {"theta_a": ("rad", 3), "omega_a": ("rad/s", 3), "theta_ref": ("rad", 3), "omega_ref": ("rad/s", 3)}
        | {"tau_ref": ("N.m", 3)},
        {"tau_a": ("N.m", 3), "psi": ("1", 2)},
    ),
    TRAJECTORY: (
        {},
        {"theta_ref": ("rad", 3), "omega_ref": ("rad/s", 3), "x_ref": ("m", None), "y_ref": ("m", None)}
        | {"tau_ref": ("N.m", 3)},
    ),
}

ALL = pytest.mark.parametrize("model", [PLANT, CONTROLLER, TRAJECTORY], ids=lambda m: m.name)


@ALL
def test_parameters_with_units_start_values_and_bounds(model: Model) -> None:
    found = {v.name: (v.unit, v.size, v.start, v.min) for v in model.parameters.variables}
    assert found == PARAMETERS[model]
    assert all(v.max is None for v in model.parameters.variables)


@ALL
def test_parameters_that_may_change_during_a_run(model: Model) -> None:
    """Not the geometry, nor what acts at the start only, nor what multiplies the time."""
    assert {v.name for v in model.parameters.variables if v.tunable} == set(TUNABLE[model].split())


@ALL
def test_inputs_and_outputs_with_units_that_start_at_zero_and_have_no_bounds(model: Model) -> None:
    for layout, expected in zip((model.inputs, model.outputs), SIGNALS[model], strict=True):
        assert isinstance(layout, Layout)
        assert {v.name: (v.unit, v.size) for v in layout.variables} == expected
        assert not layout.starts.any()
        assert all((v.min, v.max) == (None, None) for v in layout.variables)


@ALL
def test_every_variable_and_model_is_described_in_one_line(model: Model) -> None:
    variables = [*model.parameters.variables, *model.inputs.variables, *model.outputs.variables]
    for text in (model.description, *(v.description for v in variables)):
        assert len(text) > 10
        assert text == text.strip()
        assert "\n" not in text


@ALL
def test_the_proposed_experiment_is_the_papers(model: Model) -> None:
    proposed = model.default_experiment
    assert (proposed.start_time, proposed.stop_time, proposed.step_size) == (0.0, 15.0, 1e-3)


# The controller


def torque(u: np.ndarray, **given: object) -> np.ndarray:
    starts = vars(CONTROLLER.parameters.unpack(CONTROLLER.parameters.starts))
    p = CONTROLLER.parameters.pack(**starts | given)
    return CONTROLLER.outputs.unpack(CONTROLLER.output_values(0.0, np.zeros(2), u, p)).tau_a


def test_no_limit_is_none() -> None:
    """Whatever torque a simulation may reach passes to the last bit."""
    u = CONTROLLER.inputs.pack(
        theta_a=np.zeros(3),
        omega_a=np.array([1e3, -1e30, 1e59]),
        theta_ref=np.zeros(3),
        omega_ref=np.zeros(3),
        tau_ref=np.zeros(3),
    )
    np.testing.assert_array_equal(torque(u, beta=1.0), [-1e3, 1e30, -1e59])
    np.testing.assert_array_equal(torque(u, beta=1.0, tau_max=np.array([1e2, 1e30, 1e58])), [-1e2, 1e30, -1e58])
    assert NO_LIMIT == 1e60
    assert "1e60 is none" in {v.name: v.description for v in CONTROLLER.parameters.variables}["tau_max"]


def test_the_estimate_starts_where_it_is_told() -> None:
    starts = vars(CONTROLLER.parameters.unpack(CONTROLLER.parameters.starts))
    p = CONTROLLER.parameters.pack(**starts | {"psi_start": np.array([0.25, 0.5])})
    np.testing.assert_array_equal(CONTROLLER.initial_state(p), [0.25, 0.5])


def test_the_controller_asks_for_nothing() -> None:
    assert CONTROLLER.requirements == ()


# The plant


def plant_parameters(**given: object) -> np.ndarray:
    return PLANT_PARAMETERS.pack(**vars(PLANT_PARAMETERS.unpack(PLANT_PARAMETERS.starts)) | given)


def margins(model: Model, at: str, p: np.ndarray, u: np.ndarray, t: float = 0.0) -> list[float]:
    x = np.zeros(len(model.state_layout) if model.states else 0)
    return [float(r.margin(t, x, u, p)) for r in model.requirements if r.at == at]


def test_the_plant_starts_at_rest_at_its_position() -> None:
    p = plant_parameters(x_E_start=0.24, y_E_start=0.33)
    x = PLANT.initial_state(p)
    found = PLANT.outputs.unpack(PLANT.output_values(0.0, x, PLANT.inputs.starts, p))
    assert (found.x_E, found.y_E) == pytest.approx((0.24, 0.33), abs=1e-15)
    np.testing.assert_array_equal(np.concatenate([found.omega_a, found.omega_b]), np.zeros(6))
    np.testing.assert_array_equal(np.concatenate([found.theta_a, found.theta_b]), x[:6])
    assert found.closure_error < 1e-15
    assert found.kinetic_energy == 0.0


def test_the_end_effector_is_the_mean_of_the_chain_ends_and_the_closure_their_distance() -> None:
    """An open state: the second chain ends 1 cm to the right, the third 2 cm above where they meet."""
    p = plant_parameters()
    x = PLANT.initial_state(p)
    moved = plant_parameters(x_A=np.array([0.0, 0.44, 0.4269]), y_A=np.array([0.25, 0.0, 0.5205]))
    found = PLANT.outputs.unpack(PLANT.output_values(0.0, x, PLANT.inputs.starts, moved))
    assert (found.x_E, found.y_E) == pytest.approx((0.22 + 0.01 / 3, 0.30 + 0.02 / 3), abs=1e-14)
    # (16) holds the ends of the first and second, and of the first and third chain together
    assert found.closure_error == pytest.approx(np.hypot(0.01, 0.02), abs=1e-14)


def test_the_kinetic_energy_is_that_of_six_bars() -> None:
    """Of every link as a rigid bar: mass, mass centre, moment of inertia about it; X, Y, Z by their definitions."""
    m_a, m_b, l, r_a, r_b, I_a, I_b = 1.2525, 1.0771, 0.244, 0.122, 0.162, 0.01, 0.0098
    X, Y, Z = I_a + m_a * r_a**2 + m_b * l**2, I_b + m_b * r_b**2, m_b * l * r_b
    p = plant_parameters(X=X, Y=Y, Z=Z)
    x = np.concatenate([[1.3, 2.9, -1.4, -0.9, 1.5, 2.9], [0.3, -0.5, 0.7, 1.1, -1.3, 1.7]])
    energy = 0.0
    for i in range(3):
        a, b, w_a, w_b = x[i], x[3 + i], x[6 + i], x[9 + i]
        elbow = l * w_a * np.array([-np.sin(a), np.cos(a)])
        centre = elbow + r_b * w_b * np.array([-np.sin(b), np.cos(b)])
        energy += 0.5 * (m_a * (r_a * w_a) ** 2 + I_a * w_a**2 + m_b * centre @ centre + I_b * w_b**2)
    found = PLANT.outputs.unpack(PLANT.output_values(0.0, x, PLANT.inputs.starts, p))
    assert found.kinetic_energy == pytest.approx(energy, rel=1e-13)


def test_torque_and_disturbance_act_alike() -> None:
    p = plant_parameters()
    x = PLANT.initial_state(p)
    first, second = np.array([0.5, -0.25, 0.125]), np.array([-1.0, 2.0, 4.0])
    rates = [
        PLANT.derivatives(0.0, x, PLANT.inputs.pack(tau_a=a, tau_d=d, dm=0.0, dm_rate=0.0), p)
        for a, d in ((first, second), (second, first), (first + second, np.zeros(3)))
    ]
    np.testing.assert_array_equal(rates[0], rates[1])
    np.testing.assert_array_equal(rates[0], rates[2])
    assert np.abs(rates[0][6:]).min() > 1e-3
    np.testing.assert_array_equal(rates[0][:6], x[6:])


def test_a_start_out_of_reach_of_one_chain_is_said() -> None:
    """Each base is 2 l = 0.488 m from where its chain is stretched."""
    u = PLANT.inputs.starts
    assert all(m > 0 for m in margins(PLANT, "start", plant_parameters(), u))
    for i, base in enumerate([(0.0, 0.25), (0.43, 0.0), (0.4269, 0.5005)]):
        for reach, positive in ((0.487, True), (0.489, False)):
            p = plant_parameters(x_E_start=base[0] + reach, y_E_start=base[1])
            assert (margins(PLANT, "start", p, u)[i] > 0) == positive
    messages = [r.message for r in PLANT.requirements if r.at == "start"]
    assert [f"chain {i}" in m and f"x_A[{i}], y_A[{i}]" in m for i, m in enumerate(messages, start=1)] == [True] * 3


def test_a_mass_matrix_that_is_not_positive_definite_is_said() -> None:
    """X, Y and X Y - Z^2 by the definitions, with the mass change dm in both links."""
    l, r_a, r_b = 0.244, 0.122, 0.0426 / (1.0771 * 0.244)
    assert all(m > 0 for m in margins(PLANT, "step", plant_parameters(), PLANT.inputs.starts)[:3])
    for dm in (-0.5, 0.0, 0.7, -1.5):
        u = PLANT.inputs.pack(tau_a=np.zeros(3), tau_d=np.zeros(3), dm=dm, dm_rate=0.0)
        X, Y, Z = 0.0932 + dm * (r_a**2 + l**2), 0.0381 + dm * r_b**2, 0.0426 + dm * l * r_b
        assert margins(PLANT, "step", plant_parameters(), u)[:3] == pytest.approx([X, Y, X * Y - Z * Z], rel=1e-12)
    messages = [r.message for r in PLANT.requirements if r.at == "step"][:3]
    assert [m.split(": ")[1].split(" must")[0] for m in messages] == ["X", "Y", "X Y - Z^2"]


def test_an_open_loop_is_said_where_the_fmu_integrates() -> None:
    """A chain end that is off by d, and so both rows of (16) that it is in, has room until sqrt(2) d is l / 250."""
    p, l = plant_parameters(), 0.244
    (closure,) = [r for r in PLANT.requirements if r.of_integration]
    x = PLANT.initial_state(p)
    for off, positive in ((0.0, True), (0.0028, True), (0.0029, False)):
        moved = x.copy()
        moved[3] += off  # the passive link of the first chain: its end moves by l off
        found = closure.margin(0.0, moved, PLANT.inputs.starts, p)
        assert found == pytest.approx((l / 250.0) ** 2 - 2.0 * (2.0 * l * np.sin(off / 2.0)) ** 2, rel=1e-9, abs=1e-18)
        assert (found > 0) == positive
    assert "the loop closure is lost" in closure.message


# The trajectory


def path_parameters(**given: object) -> np.ndarray:
    return PATH_PARAMETERS.pack(**vars(PATH_PARAMETERS.unpack(PATH_PARAMETERS.starts)) | given)


def test_velocity_and_acceleration_are_the_derivatives_of_the_path() -> None:
    """By central differences, of a path all of whose parameters count."""
    p = path_parameters(w=1.3, n=4.0, R=0.7, a=2.5, b=0.02, phase=0.4)
    h = 1e-5
    for t in np.linspace(0.0, 5.0, 23):
        position, velocity, acceleration = desired_path(t, p)
        later, earlier = desired_path(t + h, p), desired_path(t - h, p)
        np.testing.assert_allclose(velocity, (later[0] - earlier[0]) / (2 * h), atol=1e-8)
        np.testing.assert_allclose(acceleration, (later[1] - earlier[1]) / (2 * h), atol=1e-8)
        assert np.hypot(*(position - [0.225, 0.355])) == pytest.approx(0.02 * (2.5 + 0.7 * np.cos(4.0 * 1.3 * t)))


def test_a_path_out_of_reach_of_one_chain_is_said_at_its_time() -> None:
    """A small circle about a place that a base just reaches: the far side is out of reach, the near side not."""
    messages = [r.message for r in TRAJECTORY.requirements]
    assert [f"chain {i}" in m and f"x_A[{i}], y_A[{i}]" in m for i, m in enumerate(messages, start=1)] == [True] * 3
    assert all(r.at == "step" for r in TRAJECTORY.requirements)
    for i, base in enumerate([(0.0, 0.25), (0.43, 0.0), (0.4269, 0.5005)]):
        p = path_parameters(x_c=base[0] + 0.488, y_c=base[1], phase=0.0, R=0.0, a=1.0, b=0.01)
        near, far = margins(TRAJECTORY, "step", p, np.zeros(0), np.pi), margins(TRAJECTORY, "step", p, np.zeros(0), 0.0)
        assert near[i] > 0 > far[i]


def test_the_trajectory_has_no_state() -> None:
    p = path_parameters()
    assert (TRAJECTORY.states, TRAJECTORY.initial_state(p).shape) == ((), (0,))
    assert TRAJECTORY.derivatives(1.0, np.zeros(0), np.zeros(0), p).shape == (0,)


def test_the_torque_of_the_path_moves_the_closed_chain_along_it() -> None:
    """Put on the plant in the desired state, it gives the desired acceleration of the joints."""
    p, robot, h = path_parameters(), plant_parameters(baumgarte=0.0), 1e-5

    def joints(t: float) -> np.ndarray:
        return TRAJECTORY.outputs.unpack(TRAJECTORY.output_values(t, np.zeros(0), np.zeros(0), p)).omega_ref

    for t in (0.3, 1.7, 4.1):
        position, velocity, _ = desired_path(t, p)
        P = PLANT_PARAMETERS.unpack(robot)
        theta = inverse_kinematics(*position, P.l, P.x_A, P.y_A)
        omega = np.concatenate(velocity_jacobians(theta, P.l)) @ velocity
        out = TRAJECTORY.outputs.unpack(TRAJECTORY.output_values(t, np.zeros(0), np.zeros(0), p))
        u = PLANT.inputs.pack(tau_a=out.tau_ref, tau_d=np.zeros(3), dm=0.0, dm_rate=0.0)
        found = PLANT.derivatives(t, np.concatenate([theta, omega]), u, robot)[6:9]
        np.testing.assert_allclose(found, (joints(t + h) - joints(t - h)) / (2 * h), atol=1e-6)


def test_the_robot_starts_with_the_velocity_that_it_is_given() -> None:
    """The end effector, differenced along the start's velocities, moves as it has to, and the loop stays closed."""
    p, h = plant_parameters(v_x_start=0.07, v_y_start=-0.11), 1e-6
    x, u = PLANT.initial_state(p), PLANT.inputs.starts
    ahead, behind = (
        PLANT.outputs.unpack(PLANT.output_values(0.0, np.concatenate([x[:6] + s * x[6:], x[6:]]), u, p))
        for s in (h, -h)
    )
    assert (ahead.x_E - behind.x_E) / (2 * h) == pytest.approx(0.07, abs=1e-9)
    assert (ahead.y_E - behind.y_E) / (2 * h) == pytest.approx(-0.11, abs=1e-9)
    assert ahead.closure_error < 1e-12
    assert not PLANT.initial_state(plant_parameters())[6:].any()


@pytest.mark.parametrize(("at_rest", "sign"), [(0.0, 1.0), (1.0, -1.0)], ids=["arrives moving", "arrives at rest"])
def test_energy_of_a_mass_that_changes(at_rest: float, sign: float) -> None:
    """Beside the power of the torques, the energy of mass that arrives.

    Moving, it brings its kinetic energy along. At rest it is brought to the velocity of the link by an inelastic
    collision, in which as much is lost.
    """
    rng, h = np.random.default_rng(5), 1e-6
    for _ in range(10):
        v, dm, dm_rate = rng.normal(size=2), rng.uniform(-0.2, 0.2), rng.normal()
        p = plant_parameters(v_x_start=v[0], v_y_start=v[1])
        x, tau = PLANT.initial_state(p), rng.normal(size=3)

        def energy(state: np.ndarray, mass: float, p: np.ndarray = p) -> float:
            u = PLANT.inputs.pack(tau_a=np.zeros(3), tau_d=np.zeros(3), dm=mass, dm_rate=0.0)
            return float(PLANT.outputs.unpack(PLANT.output_values(0.0, state, u, p)).kinetic_energy)

        u = PLANT.inputs.pack(tau_a=tau, tau_d=np.zeros(3), dm=dm, dm_rate=at_rest * dm_rate)
        rate = PLANT.derivatives(0.0, x, u, p)
        found = (energy(x + h * rate, dm + h * dm_rate) - energy(x - h * rate, dm - h * dm_rate)) / (2 * h)
        of_the_mass = dm_rate * (energy(x, dm + 1.0) - energy(x, dm))  # linear in dm
        assert found == pytest.approx(float(tau @ x[6:9]) + sign * of_the_mass, rel=1e-6, abs=1e-6)
