"""Every model as a python-control system: same values as the model, right linearisation, wrong parameters named."""

from __future__ import annotations

import control
import numpy as np
import pytest

from fmu_export.control_backend import to_control
from parallel_robot.continuous_loop import closed_loop, initial_state, solve
from parallel_robot.models import MODELS


@pytest.mark.parametrize("name", MODELS)
def test_system_has_the_models_signals_and_values(name: str) -> None:
    model = MODELS[name]
    system = to_control(model)
    assert system.input_labels == list(model.inputs.names)
    assert system.output_labels == list(model.outputs.names)
    assert system.state_labels == list(model.state_layout.names)
    random = np.random.default_rng(2)
    p = model.parameters.starts
    x = model.initial_state(p) + random.uniform(-0.01, 0.01, len(system.state_labels))
    u = random.uniform(-0.1, 0.1, len(model.inputs))
    np.testing.assert_array_equal(system.dynamics(0.3, x, u), model.derivatives(0.3, x, u, p))
    np.testing.assert_array_equal(system.output(0.3, x, u), model.output_values(0.3, x, u, p))


def test_parameters_by_name_scalar_vector_and_params() -> None:
    controller = MODELS["controller"]
    u, psi = np.arange(15.0), np.array([0.1, 0.2])
    plain = to_control(controller).output(0, psi, u)[:3]
    without = to_control(controller, parameters={"alpha": 0.0}).output(0, psi, u)[:3]
    np.testing.assert_array_equal(to_control(controller).output(0, psi, u, params={"alpha": 0.0})[:3], without)
    assert np.abs(plain - without).min() > 0
    stiff = to_control(controller, parameters={"alpha": 0.0, "S": [4.0, 4.0, 4.0]}).output(0, psi, u)[:3]
    beta = controller.parameters.unpack(controller.parameters.starts).beta
    np.testing.assert_allclose(stiff - without, -beta * 2.0 * (u[:3] - u[6:9]), rtol=1e-12)


def test_plant_linearised_at_rest_is_its_inertia() -> None:
    """At rest nothing depends on the angles to first order: only torques accelerate, and none of the states decays."""
    plant = MODELS["plant"]
    x = plant.initial_state(plant.parameters.starts)
    linear = control.linearize(to_control(plant, parameters={"baumgarte": 0.0}), x, np.zeros(8))
    np.testing.assert_allclose(linear.A[:6, 6:], np.eye(6), atol=1e-9)
    np.testing.assert_allclose(linear.A[6:], 0.0, atol=1e-4)
    u = np.array([0.1, -0.2, 0.3, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(linear.B @ u, plant.derivatives(0, x, u, plant.parameters.starts), atol=1e-6)


@pytest.mark.parametrize(("values", "message"), [({"aplha": 1.0}, "'aplha'"), ({"S": [1.0, 2.0]}, "'S'.* 3 values")])
def test_wrong_parameters_are_named(values: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        to_control(MODELS["controller"], parameters=values)


def test_interconnected_loop_adds_up() -> None:
    """The torque that python-control feeds the plant is the controller's of the same instant."""
    loop, x = closed_loop(), initial_state()
    outputs = dict(zip(loop.output_labels, loop.output(0.0, x, np.zeros(5)), strict=True))
    tau_a = np.array([outputs[f"controller_tau_a[{i}]"] for i in (1, 2, 3)])
    plant = MODELS["plant"]
    expected = plant.derivatives(0.0, x[:12], np.concatenate([tau_a, np.zeros(5)]), plant.parameters.starts)
    np.testing.assert_allclose(loop.dynamics(0.0, x, np.zeros(5))[:12], expected, rtol=1e-12)


def test_solution_meets_the_wanted_times_and_restarts_at_breakpoints() -> None:
    """A step of the disturbance inside the interval, with and without being announced, ends at the same state."""

    def step(t: float) -> np.ndarray:
        return np.array([0.1 * (t >= 0.05), 0.0, 0.0, 0.0, 0.0])

    announced = solve([0.0, 0.02, 0.1], step, breakpoints=[0.05])
    unannounced = solve([0.0, 0.02, 0.1], step, rtol=1e-8)
    np.testing.assert_array_equal(announced.time, [0.0, 0.02, 0.1])
    np.testing.assert_array_equal(announced.states[0], initial_state())
    np.testing.assert_allclose(announced.states, unannounced.states, atol=1e-7)
