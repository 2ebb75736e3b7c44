"""Optimisation tools take a model for its states and inputs: they set both by value reference and get derivatives.

CasADi's DaeBuilder does so. FMI 3.0.2 lets importers set states by fmi3SetFloat64 in event mode and in continuous-time
mode, FMI 2.0.5 by fmi2SetReal in continuous-time mode; DaeBuilder does it in event mode in both. The oracles are the
models' numpy functions.
"""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from parallel_robot.models import MODELS
from plant_fmu.model import INPUTS, PARAMETERS
from plant_fmu.model import MODEL as PLANT
from tests.support.native_fmus import DISCARD, ERROR, FLAVOURS, OK, Host, unpack

BOTH = pytest.mark.parametrize("flavour", FLAVOURS)

STATES = list(PLANT.state_layout.names)
N = len(STATES)

#: A pose that is not the start, with speeds, and what acts on it.
AWAY = PLANT.initial_state(PARAMETERS.starts) + np.linspace(-0.02, 0.03, N)
INPUT = INPUTS.pack(tau_a=np.array([0.05, -0.03, 0.04]), tau_d=np.array([0.01, 0.0, -0.02]), dm=0.1, dm_rate=0.0)


@pytest.fixture
def plant(native_fmus: Path, tmp_path: Path, flavour: str) -> Path:
    return unpack(native_fmus / flavour / f"{PLANT.name}.fmu", tmp_path)


def rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.asarray(PLANT.derivatives(0.0, x, u, PARAMETERS.starts))


@BOTH
def test_daebuilder_evaluates_derivatives_outputs_and_jacobians(plant: Path) -> None:
    dae = ca.DaeBuilder("plant", str(plant))
    assert dae.x() == STATES
    f = dae.create("f", ["x", "u"], ["ode", "y"])
    start = np.asarray(dae.start(dae.x()))
    np.testing.assert_allclose(start, PLANT.initial_state(PARAMETERS.starts), rtol=1e-14, atol=1e-14)
    at_rest, _ = f(start, np.zeros(len(INPUT)))
    assert (
        np.abs(at_rest.full()).max() < 1e-9
    )  # rad/s and rad/s2, of a robot that nothing drives, in a horizontal plane
    ode, y = f(AWAY, INPUT)
    expected = rates(AWAY, INPUT)
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(ode.full().ravel(), expected, rtol=1e-10, atol=1e-10)
    expected_y = PLANT.output_values(0.0, AWAY, INPUT, PARAMETERS.starts)
    np.testing.assert_allclose(y.full().ravel(), expected_y, rtol=1e-10, atol=1e-10)
    by_x, by_u = f.factory("J", ["x", "u"], ["jac:ode:x", "jac:ode:u"])(AWAY, INPUT)
    h = 1e-6
    for found, point, other in ((by_x, AWAY, lambda v: rates(v, INPUT)), (by_u, INPUT, lambda v: rates(AWAY, v))):
        columns = [(other(point + h * e) - other(point - h * e)) / (2 * h) for e in np.eye(len(point))]
        np.testing.assert_allclose(found.full(), np.column_stack(columns), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", [name for name, model in ((m.name, m) for m in MODELS.values()) if model.states])
@BOTH
def test_every_model_with_states_begins_at_its_start(
    native_fmus: Path, tmp_path: Path, flavour: str, name: str
) -> None:
    (model,) = [m for m in MODELS.values() if m.name == name]
    dae = ca.DaeBuilder(name, str(unpack(native_fmus / flavour / f"{name}.fmu", tmp_path)))
    start = model.initial_state(model.parameters.starts)
    np.testing.assert_allclose(dae.start(dae.x()), start, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("mode", ["event", "continuous"])
@BOTH
def test_states_set_one_by_one_are_those_set_together(plant: Path, mode: str) -> None:
    with Host(plant, "ModelExchange") as h, Host(plant, "ModelExchange") as together:
        h.run_up()
        together.run_up().continuous().must(together.set_states(AWAY.tolist()))
        if mode == "continuous":
            h.continuous()
        for name, value in reversed(list(zip(STATES, AWAY.tolist(), strict=True))):
            h.must(h.set({"dm": 0.1, name: value}))  # with an input in the same call
        together.must(together.set({"dm": 0.1}))
        assert h.get_states(N) == h.get(STATES) == AWAY.tolist()
        assert h.try_derivatives(N) == together.try_derivatives(N)
        assert h.get(["x_E", "y_E"]) == together.get(["x_E", "y_E"])


@BOTH
def test_a_call_that_fails_sets_no_state(plant: Path) -> None:
    with Host(plant, "ModelExchange") as h:
        before = h.run_up().get_states(N)
        for bad in ({"theta_a[2]": float("nan")}, {"x_E": 0.1}, {"X": -1.0}):
            assert h.set({"theta_a[1]": 1.0} | bad) in (ERROR, DISCARD)
            assert h.get_states(N) == before


@BOTH
def test_a_state_before_the_initialisation_is_a_guess_that_is_warned_of(plant: Path) -> None:
    """Inverse kinematics gives the start, so a guess (initial = "approx") changes nothing; who sets it is told."""
    for kind in ("ModelExchange", "CoSimulation"):
        with Host(plant, kind) as h, Host(plant, kind) as plain:
            assert h.set({"theta_a[1]": 1.0, "dm": 0.1}) == 1
            assert "'theta_a[1]' is a guess that is not needed" in h.messages[-1]
            assert h.log[-1] == (1, "logStatusWarning")
            h.run_up()
            plain.run_up({"dm": 0.1})
            assert h.get(STATES) == plain.get(STATES)
            assert h.get(["dm", "x_E"]) == plain.get(["dm", "x_E"])


@BOTH
@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_a_state_that_starts_at_a_parameter_is_set_before_the_initialisation(
    native_fmus: Path, tmp_path: Path, flavour: str, kind: str
) -> None:
    """The value of the model description is what tools set that set everything; it changes nothing."""
    controller = unpack(native_fmus / flavour / "RobotController.fmu", tmp_path)
    with Host(controller, kind) as h:
        assert h.set({"psi[1]": 0.7}) == OK
        assert h.get_start(["psi_start[1]", "psi_start[2]"]) == [0.7, 0.0]
        h.run_up()
        assert h.get(["psi[1]", "psi[2]"]) == [0.7, 0.0]
    with Host(controller, kind) as h:
        assert h.set({"psi_start[1]": 0.7, "psi_start[2]": 0.8}) == OK
        assert h.set({"psi[1]": 0.0, "psi[2]": 0.9}) == OK
        assert h.messages == []
        h.run_up()
        assert h.get(["psi[1]", "psi[2]"]) == [0.7, 0.9]


@BOTH
def test_states_are_set_neither_in_the_initialisation_nor_in_co_simulation(plant: Path) -> None:
    with Host(plant, "ModelExchange") as h:
        h.must(h.enter())
        assert h.set({"theta_a[1]": 1.0}) == ERROR
        assert "only model exchange sets it, after the initialisation" in h.messages[-1]
    with Host(plant, "CoSimulation") as h:
        h.run_up()
        assert h.tried(lambda: h.set({"theta_a[1]": 1.0})) == ERROR
        assert "only model exchange sets it" in h.messages[-1]
        assert h.step(0.0, 1e-3) == OK
