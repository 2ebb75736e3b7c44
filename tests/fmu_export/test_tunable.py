"""Tunable parameters: what declares them, what the model descriptions say, when FMUs in C take new values.

Oracles are the models' numpy functions with the new values, and differences of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmu_export import ArgumentError, TraceError
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.model import Model, Requirement
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.package.interface import interface_of
from fmu_export.trace.trace import trace
from parallel_robot.models import MODELS, closed_loop_model
from plant_fmu.model import INPUTS, OUTPUTS, PARAMETERS
from plant_fmu.model import MODEL as PLANT
from tests.support.native_fmus import DISCARD, ERROR, FLAVOURS, Host
from tests.support.native_misuse import TORQUE
from tests.support.tiny_models import INTEGRATOR

BOTH = pytest.mark.parametrize("flavour", FLAVOURS)
STATES = list(PLANT.state_layout.names)

#: Values of all parameters of the plant that are tunable.
CHANGED = {"X": 0.11, "Y": 0.05, "Z": 0.035, "baumgarte": 4.0}


# Declarations


def with_tunable(model: Model, *names: str) -> Model:
    return replace(model, parameters=Layout([replace(v, tunable=v.name in names) for v in model.parameters.variables]))


@pytest.mark.parametrize("which", ["inputs", "outputs"])
def test_only_parameters_can_be_tunable(which: str) -> None:
    first, *others = getattr(INTEGRATOR, which).variables
    with pytest.raises(ArgumentError, match=f"Integrator: '{first.name}' is not a parameter"):
        replace(INTEGRATOR, **{which: Layout([replace(first, tunable=True), *others])})


def test_a_parameter_that_acts_at_the_start_only_can_not_be_tunable() -> None:
    with pytest.raises(TraceError, match=r"Integrator: parameter 'x_start' is declared as tunable.*no effect"):
        interface_of(trace(with_tunable(INTEGRATOR, "x_start")))
    variables = interface_of(trace(with_tunable(INTEGRATOR, "T"))).variables
    assert [(v.name, v.variability) for v in variables] == [
        ("x_start", "fixed"),
        ("T", "tunable"),
        ("max_step", "fixed"),
        ("u", "continuous"),
        ("x", "continuous"),
    ]


def test_a_requirement_of_the_start_can_not_depend_on_a_tunable_parameter() -> None:
    """It would not be checked again after a change."""
    for at, reason in (("start", "'T' is declared as tunable, but a requirement"), ("step", None)):
        requirement = Requirement("T is too long", lambda t, x, u, p: 2.0 - p[1], at=at)
        model = replace(with_tunable(INTEGRATOR, "T"), requirements=(requirement,))
        if reason is None:
            interface_of(trace(model))
        else:
            with pytest.raises(TraceError, match=reason):
                interface_of(trace(model))


def test_a_vector_is_tunable_as_a_whole_and_a_composition_keeps_it() -> None:
    tunable = {v.name for v in closed_loop_model().parameters.variables if v.tunable}
    parts = ((n, v.name) for n, model in MODELS.items() for v in model.parameters.variables if v.tunable)
    assert tunable == {".".join(part) for part in parts}
    assert {"controller.S", "plant.X", "trajectory.x_c"} < tunable
    variables = interface_of(trace(MODELS["controller"])).variables
    assert [v.name for v in variables if v.variability == "tunable" and "S" in v.name] == ["S[1]", "S[2]", "S[3]"]


def test_variables_are_fixed_unless_they_say_so() -> None:
    assert not Variable("k", "1", "A parameter").tunable


# Model structure


def that_matter(function: Callable[[np.ndarray], Any], p: np.ndarray, names: Iterable[str]) -> list[set[str]]:
    """For each value of a function of the parameters those that change it."""
    before = np.asarray(function(p))
    found: list[set[str]] = [set() for _ in before]
    for j, name in enumerate(names):
        other = p.copy()
        other[j] += 1e-3 * max(1.0, abs(p[j]))
        for i in np.flatnonzero(np.asarray(function(other)) != before):
            found[i].add(name)
    return found


@pytest.mark.parametrize("instance", MODELS)
def test_fmi_3_lists_the_parameters_of_outputs_and_derivatives_and_fmi_2_none(unpacked: Path, instance: str) -> None:
    """FMI 3.0.2, 2.4.8: parameters are knowns at communication points; FMI 2.0.5, 2.2.8: they are not."""
    model = MODELS[instance]
    rng = np.random.default_rng(5)
    p = model.parameters.starts.copy()
    limited = p == 1e60
    p[p == 0.0] = 0.1
    u = rng.standard_normal(len(model.inputs))
    x = np.array(model.initial_state(p)) + 0.1 * rng.standard_normal(len(model.state_layout) if model.states else 0)
    names = model.parameters.names
    found: list[set[str]] = [set() for _ in (*model.outputs.names, *x)]
    for limit in (0.01, 1e3):  # a torque within its limits does not depend on them, one beyond them on nothing else
        p[limited] = limit
        values = that_matter(lambda q: model.output_values(0.7, x, u, q), p, names)
        rates = that_matter(lambda q: model.derivatives(0.7, x, u, q), p, names)
        found = [a | b for a, b in zip(found, values + rates, strict=True)]
    root = ET.parse(unpacked / "fmi3" / model.name / "modelDescription.xml").getroot()
    name_of = {v.get("valueReference"): v.get("name") for v in root.iterfind("ModelVariables/*")}
    listed = []
    for tag in ("Output", "ContinuousStateDerivative"):
        unknowns = root.findall(f"ModelStructure/{tag}")  # no derivatives, where there are no states
        for unknown in unknowns:
            knowns = unknown.get("dependencies", "").split()
            assert len(knowns) == len(unknown.get("dependenciesKind", "").split())
            assert knowns == sorted(knowns, key=int)
            listed.append({str(name_of[known]) for known in knowns} & set(names))
    assert listed == found
    assert any(found)
    root = ET.parse(unpacked / "fmi2" / model.name / "modelDescription.xml").getroot()
    for tag in ("Outputs", "Derivatives"):
        unknowns = root.findall(f"ModelStructure/{tag}/Unknown")
        assert tag == "Derivatives" or unknowns
        for unknown in unknowns:
            assert all(int(i) > len(names) for i in unknown.get("dependencies", "").split())


# Co-simulation


def changed_parameters() -> np.ndarray:
    return PARAMETERS.pack(**vars(PARAMETERS.unpack(PARAMETERS.starts)) | CHANGED)


@BOTH
def test_a_change_counts_from_the_communication_point_where_it_is_set(unpacked: Path, flavour: str) -> None:
    """Outputs at the point itself and steps after it are those of numpy with the new values."""
    u = INPUTS.pack(tau_a=np.array(list(TORQUE.values())), tau_d=np.zeros(3), dm=0.1, dm_rate=0.0)
    p, h = changed_parameters(), 1e-3
    with Host(unpacked / flavour / "RobotPlant").run_up(TORQUE | {"dm": 0.1}) as host:
        for i in range(20):
            host.must(host.step(i * h, h))
        x = np.array(host.get(STATES))
        before = host.get(list(OUTPUTS.names))
        host.must(host.set(CHANGED))
        assert host.get(list(CHANGED)) == list(CHANGED.values())
        assert host.get(STATES) == x.tolist()
        after = host.get(list(OUTPUTS.names))
        assert after == pytest.approx(PLANT.output_values(20 * h, x, u, p), rel=1e-11, abs=1e-12)
        assert np.abs(np.subtract(after, before)).max() > 1e-3
        for i in range(20, 40):
            host.must(host.step(i * h, h))
            x = rk4_step(PLANT.derivatives, i * h, x, u, p, h)
        assert host.get(STATES) == pytest.approx(x, rel=1e-11, abs=1e-12)
        assert host.messages == []


@BOTH
def test_a_refused_change_leaves_everything_as_it_was(unpacked: Path, flavour: str) -> None:
    with Host(unpacked / flavour / "RobotPlant").run_up(TORQUE) as host:
        host.must(host.step(0.0, 1e-3))
        data = host.save_bytes()
        names = [*PARAMETERS.names, *INPUTS.names, *OUTPUTS.names]
        values = host.get(names)
        for refused, status in (
            ({"dm": 0.1, "X": -1.0}, DISCARD),
            ({"X": 0.1, "tau_a[1]": 1.0, "Y": 0.0}, DISCARD),
            ({"dm": 0.1, "X": 0.1, "l": 0.2}, ERROR),
            ({"X": 0.1, "m_b": 1.0}, ERROR),
        ):
            assert host.tried(lambda refused=refused: host.set(refused)) == status
            assert host.get(names) == values
            assert host.save_bytes() == data
        host.must(host.set({"X": 1e-12 + 0.09}))
        assert host.save_bytes() != data


@BOTH
def test_states_hold_the_values_and_a_reset_brings_those_of_the_start_back(unpacked: Path, flavour: str) -> None:
    folder, names = unpacked / flavour / "RobotPlant", [*CHANGED, *OUTPUTS.names]

    def go_on(host: Host) -> list[float]:
        for i in range(10, 20):
            host.must(host.step(i * 1e-3, 1e-3))
        return host.get(names)

    with Host(folder).run_up(TORQUE) as host, Host(folder) as other, Host(folder).run_up(TORQUE) as untouched:
        for i in range(10):
            host.must(host.step(i * 1e-3, 1e-3))
            untouched.must(untouched.step(i * 1e-3, 1e-3))
        host.must(host.set(CHANGED))
        state, data, here = host.save(), host.save_bytes(), host.get(names)
        expected = go_on(host)
        host.must(host.set({"X": 0.2}))
        host.must(host.restore(state))
        assert host.get(names) == here
        assert go_on(host) == expected
        other.must(other.restore_bytes(data))
        assert other.get(names) == here
        assert go_on(other) == expected
        host.forget(state)
        host.must(host.call("Terminate"))
        host.must(host.call("Reset"))
        host.run_up(TORQUE)
        assert host.get(list(CHANGED)) == [float(PARAMETERS.starts[PARAMETERS.names.index(n)]) for n in CHANGED]
        for i in range(10):
            host.must(host.step(i * 1e-3, 1e-3))
        assert go_on(host) == go_on(untouched)


def test_a_parameter_can_not_be_set_while_a_step_asks_for_inputs(unpacked: Path) -> None:
    """FMI 3.0, Intermediate Update Mode: continuous inputs only."""
    statuses = []

    def update(_: float) -> None:
        statuses.append((host.set({"X": 0.2}), host.set({"tau_a[1]": 0.05})))

    with Host(unpacked / "fmi3" / "RobotPlant", intermediate_update=update) as host:
        host.run_up(TORQUE | {"rtol": 0.0, "max_step": 1e-3})
        host.must(host.step(0.0, 3e-3))
        assert len(statuses) >= 3  # internal steps, and what lies between their ends
        assert statuses[0][0] == ERROR
        assert "parameter 'X' can't be set now; set it between two steps" in host.messages[0]
        assert set(statuses[1:]) == {(ERROR, ERROR)}  # after the error nothing can be set
        assert host.get(["X", "tau_a[1]"]) == [0.0932, TORQUE["tau_a[1]"]]
        assert host.step(3e-3, 3e-3) == ERROR
        assert "can't be called after an error" in host.messages[-1]


# Model exchange


@BOTH
def test_in_model_exchange_a_change_is_made_in_event_mode(unpacked: Path, flavour: str) -> None:
    p = changed_parameters()
    u = INPUTS.pack(tau_a=np.array(list(TORQUE.values())), tau_d=np.zeros(3), dm=0.0, dm_rate=0.0)
    with Host(unpacked / flavour / "RobotPlant", "ModelExchange") as host:
        host.run_up(TORQUE).continuous()
        x = np.array(host.get_states(12)) + 0.1 * np.random.default_rng(6).standard_normal(12)
        host.must(host.set_states(x))
        assert host.tried(lambda: host.set(CHANGED)) == ERROR
        host.must(host.call("EnterEventMode"))
        host.must(host.set(CHANGED))
        host.continuous()
        assert host.get_states(12) == x.tolist()
        status, rates = host.try_derivatives(12)
        host.must(status)
        assert rates == pytest.approx(PLANT.derivatives(0.0, x, u, p), rel=1e-11, abs=1e-12)
        outputs = host.get(list(OUTPUTS.names))
        assert outputs == pytest.approx(PLANT.output_values(0.0, x, u, p), rel=1e-11, abs=1e-12)


# Another importer


@BOTH
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_fmpy_changes_a_tunable_parameter_during_a_run(native_fmus: Path, flavour: str, kind: str) -> None:
    """Against DOP853 on the numpy functions, restarted at the change."""
    start, changed = PARAMETERS.starts, PARAMETERS.starts.copy()
    changed[PARAMETERS.names.index("X")] = 0.15
    rows = [(0.0, start[0]), (0.5, start[0]), (0.5, 0.15), (1.0, 0.15)]
    found = fmpy.simulate_fmu(
        str(native_fmus / flavour / "RobotPlant.fmu"),
        fmi_type=kind,
        stop_time=1.0,
        output_interval=0.01,
        relative_tolerance=1e-10,
        input=np.array(rows, dtype=[("time", float), ("X", float)]),
        start_values=TORQUE,
        output=["X", *STATES],
    )
    u = INPUTS.pack(tau_a=np.array(list(TORQUE.values())), tau_d=np.zeros(3), dm=0.0, dm_rate=0.0)
    x = PLANT.initial_state(start)
    for p in (start, changed):
        run = solve_ivp(
            lambda t, x, p=p: PLANT.derivatives(t, x, u, p), (0.0, 0.5), x, "DOP853", rtol=1e-11, atol=1e-12
        )
        assert run.success
        x = run.y[:, -1]
    assert (found["X"][0], found["X"][-1]) == (start[0], 0.15)
    assert [found[name][-1] for name in STATES] == pytest.approx(x, abs=1e-8)
