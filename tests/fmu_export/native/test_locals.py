"""Locals, states that are no outputs, and nominal values, as importers find them."""

from __future__ import annotations

from ctypes import c_double
from pathlib import Path

import control
import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmu_export import build_pythonfmu, compose, to_control
from fmu_export.errors import ArgumentError, TraceError
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.native.backend import build_native
from fmu_export.trace.trace import trace
from tests.support.native_fmus import FLAVOURS, Host, unpack

#: Two masses on springs: position and velocity of the first, of which the second position alone is an output.
K, START = 4.0, (1.0, -0.5, 0.25, 2.0)
NAMES = ("x_1", "v_1", "x_2", "v_2")
MASSES = Model(
    name="Masses",
    parameters=Layout([Variable("k", "N/m", start=K)]),
    inputs=Layout([Variable("F", "N")]),
    outputs=Layout([Variable("x_2", "m", nominal=0.1), Variable("power", "W")]),
    locals=Layout(
        [
            Variable("x_1", "m", nominal=2.0),
            Variable("energy", "J"),
            Variable("v_1", "m/s"),
            Variable("v_2", "m/s", nominal=5.0),
            Variable("spring", "N", size=2),
        ]
    ),
    states=NAMES,
    initial_state=lambda p: np.array(START) * p[0] / p[0],
    derivatives=lambda t, x, u, p: np.stack(
        [x[1], p[0] * (x[2] - 2.0 * x[0]) + u[0], x[3], p[0] * (x[0] - 2.0 * x[2])]
    ),
    # x_2 and power; then energy and the springs' forces
    output_values=lambda t, x, u, p: np.stack(
        [
            x[2],
            u[0] * x[1],
            0.5 * (x[1] ** 2 + x[3] ** 2) + 0.5 * p[0] * (x[0] ** 2 + x[2] ** 2 + (x[0] - x[2]) ** 2),
            p[0] * x[0],
            p[0] * x[2],
        ]
    ),
    default_experiment=DefaultExperiment(1.0, 0.1),
)
VALUES = {
    "x_2": 0.25,
    "power": -1.5,
    "x_1": 1.0,
    "energy": 0.5 * (0.25 + 4.0) + 2.0 * (1.0 + 0.0625 + 0.5625),
    "v_1": -0.5,
    "v_2": 2.0,
    "spring[1]": 4.0,
    "spring[2]": 1.0,
}


def built(folder: Path, flavour: str) -> Path:
    return build_pythonfmu(MASSES, folder) if flavour == "pythonfmu" else build_native(MASSES, folder, flavour)  # type: ignore[arg-type]


@pytest.mark.parametrize("flavour", ["pythonfmu", *FLAVOURS])
def test_descriptions(tmp_path: Path, flavour: str) -> None:
    fmu = built(tmp_path, flavour)
    assert validate_fmu(str(fmu)) == []
    description = fmpy.read_model_description(str(fmu))
    found = {v.name: v for v in description.modelVariables}
    assert {n: found[n].causality for n in VALUES} == dict.fromkeys(VALUES, "local") | {
        "x_2": "output",
        "power": "output",
    }
    assert [u.variable.name for u in description.outputs] == ["x_2", "power"]
    assert {n: float(found[n].nominal) for n in NAMES if found[n].nominal} == {"x_2": 0.1, "x_1": 2.0, "v_2": 5.0}
    unknowns = {u.variable.name for u in description.initialUnknowns}
    states = set(NAMES) if flavour != "pythonfmu" else set()
    assert unknowns == {"x_2", "power"} | states | {f"der({n})" for n in states}
    if states:
        assert {u.variable.derivative.name for u in description.derivatives} == states


@pytest.mark.parametrize("flavour", ["pythonfmu", *FLAVOURS])
def test_values_in_co_simulation(tmp_path: Path, flavour: str) -> None:
    result = fmpy.simulate_fmu(
        str(built(tmp_path, flavour)),
        stop_time=0.5,
        step_size=0.1,
        output_interval=0.1,
        output=list(VALUES),
        start_values={"F": 3.0},
        fmi_type="CoSimulation",
    )
    assert {name: result[name][0] for name in VALUES} == pytest.approx(VALUES, rel=1e-15)
    # the energy grows by the work that is done on the first mass
    energy, end = result["energy"], 3.0 * (result["x_1"] - 1.0)
    np.testing.assert_allclose(energy - energy[0], end, rtol=1e-10, atol=1e-10)
    assert np.ptp(end) > 0.1
    np.testing.assert_array_equal(result["spring[2]"], K * result["x_2"])


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_model_exchange(tmp_path: Path, flavour: str) -> None:
    folder = unpack(built(tmp_path, flavour), tmp_path / "unpacked")
    with Host(folder, "ModelExchange") as host:
        host.run_up({"F": 3.0})
        assert host.get_states(4) == list(START)
        nominals = (c_double * 4)()
        host.must(host.call("GetNominalsOfContinuousStates", nominals, 4))
        assert list(nominals) == [2.0, 1.0, 0.1, 5.0]
        assert host.get(list(VALUES)) == pytest.approx(list(VALUES.values()), rel=1e-15)
        host.must(host.set({"x_1": 0.5, "v_2": 7.0}))
        assert host.get_states(4) == [0.5, -0.5, 0.25, 7.0]
        # d(energy)/d(x_1), d(spring)/dx by differences of the closed form
        status, change = host.direction(["energy", "spring[1]", "power", "der(v_1)"], {"x_1": 1.0})
        host.must(status)
        assert change == pytest.approx([K * (0.5 + 0.25), K, 0.0, -2.0 * K])
    result = fmpy.simulate_fmu(
        str(tmp_path / "Masses.fmu"),
        stop_time=0.5,
        output=["energy", "x_1"],
        start_values={"F": 3.0},
        fmi_type="ModelExchange",
        relative_tolerance=1e-8,
    )
    np.testing.assert_allclose(result["energy"] - result["energy"][0], 3.0 * (result["x_1"] - 1.0), atol=1e-6)


def test_a_composed_model_and_a_control_system_have_outputs_alone_as_outputs() -> None:
    whole = compose("Whole", "", {"a": MASSES, "b": MASSES}, [], DefaultExperiment(1.0, 0.1))
    assert whole.outputs.names == ("a.x_2", "a.power", "b.x_2", "b.power")
    assert whole.locals.names[0] == "a.x_1"
    x = np.concatenate([START, np.negative(START)])
    traced = dict(
        zip(whole.computed.names, trace(whole).outputs(0.0, x, [3.0, 3.0], [K, K]).full().ravel(), strict=True)
    )
    assert {n: traced[f"a.{n}"] for n in VALUES} == pytest.approx(VALUES, rel=1e-15)
    assert traced["b.x_1"] == -1.0
    assert traced["b.energy"] == traced["a.energy"]
    system = to_control(MASSES)
    assert system.noutputs == 2
    y = control.input_output_response(system, [0.0, 0.1], [3.0, 3.0], START).outputs
    assert y[:, 0] == pytest.approx([0.25, -1.5])


def test_all_states_may_be_locals_and_outputs_may_be_left_out(tmp_path: Path) -> None:
    hidden = Model(
        name="Hidden",
        locals=Layout([Variable("x")]),
        states=("x",),
        initial_state=lambda p: np.ones(1),
        derivatives=lambda t, x, u, p: -x,
    )
    for flavour in FLAVOURS:
        fmu = build_native(hidden, tmp_path, flavour)  # type: ignore[arg-type]
        assert validate_fmu(str(fmu)) == []
        result = fmpy.simulate_fmu(str(fmu), stop_time=1.0, output=["x"], fmi_type="CoSimulation")
        assert result["x"][-1] == pytest.approx(np.exp(-1.0), rel=1e-12)


def test_some_states_are_outputs_without_a_function() -> None:
    model = Model(
        name="Some",
        outputs=Layout([Variable("b")]),
        locals=Layout([Variable("a")]),
        states=("a", "b"),
        initial_state=lambda p: np.array([1.0, 2.0]),
        derivatives=lambda t, x, u, p: -x,
    )
    assert list(model.output_values(0.0, np.array([3.0, 4.0]), np.zeros(0), np.zeros(0))) == [4.0]
    assert trace(model).outputs(0.0, [3.0, 4.0], [], []).full().ravel().tolist() == [4.0, 3.0]
    with pytest.raises(ArgumentError, match="Some: 'c' has no value; give output_values"):
        Model(
            name="Some",
            locals=Layout([Variable("a"), Variable("c")]),
            states=("a",),
            initial_state=lambda p: np.ones(1),
            derivatives=lambda t, x, u, p: -x,
        )


def test_locals_are_compared_with_numpy() -> None:
    state = {"kept": 0.0}

    def values(t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        state["kept"] += 1.0
        return np.stack([x[0], x[0] + state["kept"]])

    model = Model(
        name="Other",
        outputs=Layout([Variable("x")]),
        locals=Layout([Variable("wrong")]),
        states=("x",),
        initial_state=lambda p: np.ones(1),
        derivatives=lambda t, x, u, p: -x,
        output_values=values,
    )
    with pytest.raises(TraceError):
        trace(model)


@pytest.mark.parametrize("nominal", [0.0, -1.0, float("nan"), float("inf"), "1"])
def test_nominals_are_positive(nominal: float) -> None:
    with pytest.raises(ArgumentError, match="variable 'x': nominal is "):
        Variable("x", nominal=nominal)
