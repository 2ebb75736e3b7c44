"""The native FMUs (C, FMI 2.0 and 3.0): the same numbers as the pythonfmu flavour, and every call of the C interfaces.

Oracles are scipy's DOP853 on the models' numpy functions, central differences through the FMU itself, and the headers
of the standard.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import re
import shutil
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable
from ctypes import byref, c_double, c_int
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from cosim import Results, simulate
from fmu_export.modelling.variables import Layout
from fmu_export.native import backend, toolchain
from fmu_export.native.backend import build_native
from fmu_export.package.start_values import StartValueError, write_start_values
from parallel_robot.fmus import build
from parallel_robot.models import MODELS
from parallel_robot.scenario import load_scenario
from plant_fmu.model import INPUTS, OUTPUTS, PARAMETERS
from plant_fmu.model import MODEL as PLANT
from tests.support.compilation import OPTIMISATION_OF_ROBOT
from tests.support.native_fmus import (
    DISCARD,
    ERROR,
    FLAVOURS,
    OK,
    Host,
    Refused,
    library_path,
    unpack,
)
from tests.support.native_misuse import CASES, MISSING, TORQUE, Misuse, advance, good_run, prepared
from tests.support.patience import PATIENCE

CHECKOUT = Path(__file__).resolve().parents[3]
NAMES = [model.name for model in MODELS.values()]
BOTH = pytest.mark.parametrize("flavour", FLAVOURS)
ALL = pytest.mark.parametrize("name", NAMES)

STATES = list(PLANT.state_layout.names)
ENDS = ["x_E", "y_E"]


def plant_inputs(**parts: Any) -> np.ndarray:
    """Inputs (7,) of the plant, zero where not given."""
    return INPUTS.pack(**{"tau_a": np.zeros(3), "tau_d": np.zeros(3), "dm": 0.0, "dm_rate": 0.0, **parts})


def dop853(inputs: Callable[[float], np.ndarray], times: np.ndarray) -> np.ndarray:
    """States (n, 12) of the plant at the times, from its numpy functions."""
    p = PARAMETERS.starts
    solution = solve_ivp(
        lambda t, x: PLANT.derivatives(t, x, inputs(t), p),
        (times[0], times[-1]),
        PLANT.initial_state(p),
        method="DOP853",
        t_eval=times,
        rtol=1e-12,
        atol=1e-13,
    )
    assert solution.success
    return solution.y.T


def ends_of(states: np.ndarray, inputs: Callable[[float], np.ndarray], times: np.ndarray) -> np.ndarray:
    """End effector (n, 2) in m."""
    where = [OUTPUTS.names.index(name) for name in ENDS]
    return np.array(
        [PLANT.output_values(t, x, inputs(t), PARAMETERS.starts)[where] for t, x in zip(times, states, strict=True)]
    )


# 1. All flavours agree


@pytest.fixture(scope="module")
def tracking(robot_fmus: Path, native_fmus: Path) -> dict[str, Results]:
    scenario = load_scenario("tracking")
    folders = {"pythonfmu": robot_fmus} | dict.fromkeys(FLAVOURS, native_fmus)
    return {
        flavour: simulate(
            scenario.system(folder, flavour), 1.0, scenario.step_size, order="sequential", extrapolation="hold"
        )
        for flavour, folder in folders.items()
    }


@pytest.mark.slow
@BOTH
def test_closed_loop_is_that_of_the_pythonfmu_flavour(tracking: dict[str, Results], flavour: str) -> None:
    reference, found = tracking["pythonfmu"], tracking[flavour]
    assert found.names == reference.names
    assert len(found.time) == 1001
    ranges = np.ptp(reference.values, axis=0)
    ranges[ranges == 0.0] = 1.0  # tau_d, which is zero before t = 4 s
    # lengths that cancel: no digit of the closure error is more than rounding, which is theirs
    ranges[found.names.index("plant.closure_error")] = np.abs(found["plant.x_E"]).max()
    difference = np.abs(found.values - reference.values).max(axis=0) / ranges
    print(f"largest difference {difference.max():.1e} of the range, in {found.names[int(difference.argmax())]}")
    assert difference.max() < 1e-12
    assert np.ptp(found["plant.x_E"]) > 0.01


@pytest.mark.slow
def test_flavours_agree_with_feedforward_and_weak_motors(robot_fmus: Path, native_fmus: Path) -> None:
    scenario = load_scenario("tracking-feedforward").with_start_value("controller", "tau_max", 0.1)
    folders = {"pythonfmu": robot_fmus} | dict.fromkeys(FLAVOURS, native_fmus)
    reference, *others = (
        simulate(scenario.system(folder, flavour), 1.0, scenario.step_size, extrapolation="hold")
        for flavour, folder in folders.items()
    )
    torque = np.abs(reference["plant.tau_a"])
    assert torque.max() == 0.1
    assert 0.05 < (torque == 0.1).mean() < 0.95
    for found in others:
        np.testing.assert_allclose(found.values, reference.values, rtol=1e-12, atol=1e-12)


# 2. Contract


@BOTH
@ALL
def test_fmpy_finds_nothing_to_complain_about(native_fmus: Path, flavour: str, name: str) -> None:
    assert validate_fmu(str(native_fmus / flavour / f"{name}.fmu")) == []


def contract(fmu: Path) -> list[tuple[Any, ...]]:
    """What importers see of every variable, in order; without the guesses that states have in model exchange."""
    description = fmpy.read_model_description(str(fmu))
    rows = []
    for v in description.modelVariables:
        start = None if v.initial == "approx" else v.start
        numbers = tuple(None if value is None else float(value) for value in (start, v.min, v.max))
        rows.append(
            (v.name, v.valueReference, v.causality, v.variability, v.unit, v.displayUnit, v.description, *numbers)
        )
    return rows


@BOTH
@ALL
def test_variables_are_those_of_the_pythonfmu_flavour(
    fmus: Path,
    native_fmus: Path,
    flavour: str,
    name: str,
) -> None:
    expected, found = contract(fmus / f"{name}.fmu"), contract(native_fmus / flavour / f"{name}.fmu")
    assert found[: len(expected)] == expected
    states = next(m for m in MODELS.values() if m.name == name).state_layout.names
    extra = [(row[0], row[2]) for row in found[len(expected) :]]
    time = [("time", "independent")] if flavour == "fmi3" else []
    assert extra == [(f"der({state})", "local") for state in states] + time


@BOTH
@ALL
def test_derivatives_belong_to_their_states(native_fmus: Path, flavour: str, name: str) -> None:
    description = fmpy.read_model_description(str(native_fmus / flavour / f"{name}.fmu"))
    rates = [v for v in description.modelVariables if v.name.startswith("der(")]
    assert [f"der({v.derivative.name})" for v in rates] == [v.name for v in rates]
    assert all(v.unit == {"1": "s-1", "rad": "rad/s", "rad/s": "rad/s2"}[v.derivative.unit] for v in rates)
    assert [u.variable.name for u in description.derivatives] == [v.name for v in rates]
    assert description.numberOfContinuousStates == len(rates)
    assert description.modelExchange is not None
    assert description.coSimulation is not None


@BOTH
def test_same_sources_same_bytes(
    native_fmus: Path, tmp_path: Path, flavour: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(toolchain, "OPTIMISATION", OPTIMISATION_OF_ROBOT)  # as those of the robot are built
    (again,) = build(tmp_path, flavour, ["controller"])
    assert again.read_bytes() == (native_fmus / flavour / again.name).read_bytes()


@BOTH
def test_guid_changes_with_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flavour: str) -> None:
    controller = MODELS["controller"]
    # by its sources alone, whatever a compiler makes of them
    monkeypatch.setattr(backend, "compile_library", lambda *_, **__: b"")

    def guid(path: Path) -> str:
        return fmpy.read_model_description(str(path)).guid

    changed = [replace(v, start=13.0) if v.name == "k" else v for v in controller.parameters.variables]
    original = guid(build_native(controller, tmp_path / "original", flavour))
    start = replace(controller, parameters=Layout(changed))
    equations = replace(controller, derivatives=lambda t, x, u, p: 2.0 * controller.derivatives(t, x, u, p))
    guids = [original, *(guid(build_native(m, tmp_path / str(i), flavour)) for i, m in enumerate((start, equations)))]
    assert len(set(guids)) == 3
    other = "fmi3" if flavour == "fmi2" else "fmi2"
    assert guid(build_native(controller, tmp_path / "original", other)) != original


# 3. Model exchange


@BOTH
def test_model_exchange_with_cvode_is_dop853(native_fmus: Path, flavour: str) -> None:
    found = fmpy.simulate_fmu(
        str(native_fmus / flavour / "RobotPlant.fmu"),
        fmi_type="ModelExchange",
        solver="CVode",
        stop_time=5.0,
        output_interval=0.05,
        relative_tolerance=1e-10,
        start_values=TORQUE,
        output=ENDS,
    )
    times = np.asarray(found["time"])
    assert times[-1] == pytest.approx(5.0)

    def inputs(_: float) -> np.ndarray:
        return plant_inputs(tau_a=np.array(list(TORQUE.values())))

    expected = ends_of(dop853(inputs, times), inputs, times)
    distance = np.hypot(found["x_E"] - expected[:, 0], found["y_E"] - expected[:, 1])
    print(f"largest distance {distance.max():.1e} m, path {np.ptp(expected, axis=0)} m")
    assert distance.max() < 1e-8
    assert np.ptp(expected, axis=0).max() > 0.01


@BOTH
@ALL
def test_derivatives_are_those_of_the_model(unpacked: Path, flavour: str, name: str) -> None:
    """At states and inputs away from the start, also through the variables der(...)."""
    model = next(m for m in MODELS.values() if m.name == name)
    with Host(unpacked / flavour / name, "ModelExchange") as host:
        n = len(model.state_layout)
        host.run_up().continuous()
        rng = np.random.default_rng(1)
        x = np.array(host.get_states(n)) + 0.1 * rng.standard_normal(n)
        u = 0.1 * rng.standard_normal(len(model.inputs))
        host.must(host.call("SetTime", 0.7))
        host.must(host.set(dict(zip(model.inputs.names, u, strict=True))))
        host.must(host.set_states(x))
        status, rates = host.try_derivatives(n)
        host.must(status)
        p = model.parameters.starts
        assert rates == pytest.approx(model.derivatives(0.7, x, u, p), rel=1e-12, abs=1e-13)
        assert host.get([f"der({s})" for s in model.state_layout.names]) == rates
        outputs = host.get(list(model.outputs.names))
        assert outputs == pytest.approx(model.output_values(0.7, x, u, p), rel=1e-12, abs=1e-13)
        assert host.get_states(n) == x.tolist()
        if flavour == "fmi3":
            assert host.get(["time"]) == [0.7]


# 4. Directional derivatives


def differences(values: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: float = 2e-4) -> np.ndarray:
    """Jacobian (m, n) by central differences, extrapolated to order 4."""
    columns = []
    for i in range(len(at)):
        slopes = []
        for h in (step, step / 2):
            above, below = at.copy(), at.copy()
            above[i] += h
            below[i] -= h
            slopes.append((values(above) - values(below)) / (above[i] - below[i]))
        columns.append((4.0 * slopes[1] - slopes[0]) / 3.0)
    return np.array(columns).T


def directions(host: Host, unknowns: list[str], knowns: list[str]) -> np.ndarray:
    """The Jacobian (m, n) as the FMU gives it, known by known."""
    columns = []
    for known in knowns:
        status, column = host.direction(unknowns, {known: 1.0})
        host.must(status)
        columns.append(column)
    return np.array(columns).T


def assert_jacobian(found: np.ndarray, expected: np.ndarray, unknowns: list[str], knowns: list[str]) -> None:
    """To 1e-6 of the largest entry of the row."""
    assert found.shape == expected.shape
    assert np.isfinite(found).all(), [(unknowns[i], knowns[j]) for i, j in np.argwhere(~np.isfinite(found)).tolist()]
    scale = np.maximum(np.abs(expected).max(axis=1, keepdims=True), 1e-3)
    error = np.abs(found - expected) / scale
    worst = np.unravel_index(error.argmax(), error.shape)
    assert error.max() < 1e-6, (unknowns[worst[0]], knowns[worst[1]], found[worst], expected[worst])
    assert np.abs(expected).max() > 1e-2


@BOTH
@pytest.mark.parametrize("instance", ["plant", "controller"])
def test_directional_derivatives_in_continuous_time_mode(
    unpacked: Path,
    flavour: str,
    instance: str,
) -> None:
    model = MODELS[instance]
    states, inputs = list(model.state_layout.names), list(model.inputs.names)
    unknowns = [*model.outputs.names, *(f"der({s})" for s in states)]
    rng = np.random.default_rng(2)
    with Host(unpacked / flavour / model.name, "ModelExchange") as host:
        host.run_up().continuous()
        x = np.array(host.get_states(len(states))) + 0.1 * rng.standard_normal(len(states))
        at = np.concatenate([x, 0.2 + 0.1 * rng.random(len(inputs))])

        def values(point: np.ndarray) -> np.ndarray:
            host.must(host.set_states(point[: len(states)]))
            host.must(host.set(dict(zip(inputs, point[len(states) :], strict=True))))
            return np.array(host.get(unknowns))

        expected = differences(values, at)
        before = values(at)
        found = directions(host, unknowns, [*states, *inputs])
        assert_jacobian(found, expected, unknowns, [*states, *inputs])
        # linear in the seeds, several at once, and without effect on the values
        seed = rng.standard_normal(len(at))
        status, combined = host.direction(unknowns, dict(zip([*states, *inputs], seed, strict=True)))
        host.must(status)
        assert combined == pytest.approx(found @ seed, rel=1e-9, abs=1e-9)
        assert host.get(unknowns) == before.tolist()


@BOTH
@pytest.mark.parametrize("instance", ["plant", "controller"])
def test_directional_derivatives_in_co_simulation(unpacked: Path, flavour: str, instance: str) -> None:
    """Outputs with respect to inputs, after some steps."""
    model = MODELS[instance]
    unknowns, inputs = list(model.outputs.names), list(model.inputs.names)
    at = 0.2 + 0.1 * np.random.default_rng(3).random(len(inputs))
    with Host(unpacked / flavour / model.name) as host:
        host.run_up(dict(zip(inputs, at, strict=True)))
        for i in range(20):
            host.must(host.step(i * 1e-2, 1e-2))

        def values(point: np.ndarray) -> np.ndarray:
            host.must(host.set(dict(zip(inputs, point, strict=True))))
            return np.array(host.get(unknowns))

        expected = differences(values, at)
        values(at)
        assert_jacobian(directions(host, unknowns, inputs), expected, unknowns, inputs)


@BOTH
@pytest.mark.parametrize("instance", ["plant", "controller", "trajectory"])
def test_directional_derivatives_of_initial_outputs(unpacked: Path, flavour: str, instance: str) -> None:
    """With respect to parameters, through the initial state, and to inputs."""
    model = MODELS[instance]
    # the loop is closed whatever the parameters are: the error is rounding, and so is its difference
    unknowns = [
        n for n in (*model.outputs.names, *(f"der({s})" for s in model.state_layout.names)) if n != "closure_error"
    ]
    knowns = [*model.parameters.names, *model.inputs.names]
    with Host(unpacked / flavour / model.name) as host:
        at = np.array(host.get_start(knowns))
        at[len(model.parameters) :] = 0.2 + 0.1 * np.random.default_rng(4).random(len(model.inputs))
        if instance == "controller":
            at[knowns.index("psi_start[1]")] = 0.3
            at[knowns.index("bound_constant")] = 0.2  # off its limit
            at[[knowns.index(f"tau_max[{i}]") for i in (1, 2, 3)]] = 0.01, 10.0, 10.0  # the first motor is saturated
        host.must(host.enter(0.4))

        def values(point: np.ndarray) -> np.ndarray:
            host.must(host.set(dict(zip(knowns, point, strict=True))))
            return np.array(host.get(unknowns))

        expected = differences(values, at)
        values(at)
        found = directions(host, unknowns, knowns)
        assert_jacobian(found, expected, unknowns, knowns)
        if model.states:
            assert (directions(host, unknowns, ["max_step"]) == 0.0).all()


@BOTH
@pytest.mark.parametrize("instance", ["plant", "controller"])
def test_directions_at_a_kink_are_those_of_central_differences(unpacked: Path, flavour: str, instance: str) -> None:
    """The closure error of a closed loop and |s| at s = 0 have a kink; central differences give 0 there, not NaN."""
    model = MODELS[instance]
    with Host(unpacked / flavour / model.name) as host:
        host.run_up({} if instance == "plant" else dict.fromkeys(model.inputs.names, 0.3))
        unknowns = [*model.outputs.names, *(f"der({s})" for s in model.state_layout.names)]
        for known in (*model.inputs.names, *model.state_layout.names):
            status, values = host.direction(unknowns, {known: 1.0})
            assert status == OK
            assert np.isfinite(values).all(), known
        kink = {"plant": "closure_error", "controller": "der(psi[1])"}[instance]
        known = {"plant": "omega_b[1]", "controller": "theta_ref[1]"}[instance]
        assert host.direction([kink], {known: 1.0}) == (OK, [0.0])


# 5. Linear inputs


RATE = np.array([0.4, -0.3, 0.2])
LEVEL = np.array([0.05, -0.03, 0.04])
AXES = [f"tau_a[{i}]" for i in (1, 2, 3)]


def ramp(t: float) -> np.ndarray:
    return plant_inputs(tau_a=LEVEL + RATE * t)


def ramp_end(folder: Path, h: float, linear: bool, max_step: float = 1.0) -> np.ndarray:
    """State at 0.64 s under a ramp of torques."""
    with Host(folder) as host:
        host.run_up({"rtol": 0.0, "max_step": max_step})
        for i in range(round(0.64 / h)):
            host.must(host.set(dict(zip(AXES, LEVEL + RATE * (i * h), strict=True))))
            if linear:
                host.must(host.set_rates(dict(zip(AXES, RATE, strict=True))))
            host.must(host.step(i * h, h))
        return np.array(host.get(STATES))


@pytest.mark.parametrize(("linear", "order"), [(True, 4.0), (False, 1.0)], ids=["linear", "held"])
def test_order_of_input_ramps(unpacked: Path, linear: bool, order: float) -> None:
    expected = dop853(ramp, np.array([0.0, 0.64]))[-1]
    steps = [0.04, 0.02, 0.01]
    errors = [np.abs(ramp_end(unpacked / "fmi2" / "RobotPlant", h, linear) - expected).max() for h in steps]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    print(f"errors {errors} at {steps} s, order {slope:.3f}")
    assert slope == pytest.approx(order, abs=0.15)


def test_ramp_is_followed_through_internal_steps(unpacked: Path) -> None:
    """Long communication steps with short internal ones are as exact as short communication steps."""
    folder, expected = unpacked / "fmi2" / "RobotPlant", dop853(ramp, np.array([0.0, 0.64]))[-1]
    short = ramp_end(folder, 5e-3, True)
    long = ramp_end(folder, 0.32, True, max_step=5e-3)
    assert np.abs(short - expected).max() < 1e-7
    assert long == pytest.approx(short, rel=0.0, abs=1e-13)
    assert np.abs(ramp_end(folder, 0.32, False, max_step=5e-3) - expected).max() > 1e-3


def test_input_arrives_and_is_then_held(unpacked: Path) -> None:
    folder, h, rates = unpacked / "fmi2" / "RobotPlant", 0.01, dict(zip(AXES, RATE, strict=True))
    with Host(folder) as host, Host(folder) as other:
        for one in (host, other):
            one.run_up(dict(zip(AXES, LEVEL, strict=True)))
            one.must(one.set_rates(rates))
            assert one.get(AXES) == LEVEL.tolist()  # the extrapolation is of the step, not of the call
            one.must(one.step(0.0, h))
            assert one.get(AXES) == (LEVEL + h * RATE).tolist()
        other.must(other.set_rates(dict.fromkeys(AXES, 0.0)))
        for one in (host, other):
            one.must(one.step(h, h))
            assert one.get(AXES) == (LEVEL + h * RATE).tolist()
        assert host.get(list(OUTPUTS.names)) == other.get(list(OUTPUTS.names))
        # outputs with direct feedthrough have seen the value at the end of the step
        p, x = PARAMETERS.starts, np.array(host.get(STATES))
        expected = PLANT.output_values(2 * h, x, plant_inputs(tau_a=LEVEL + h * RATE), p)
        assert host.get(list(OUTPUTS.names)) == pytest.approx(expected, rel=1e-12, abs=1e-13)


def test_requirements_hold_at_every_internal_step(unpacked: Path) -> None:
    """A mass change that only becomes impossible on the way through the step."""
    with Host(unpacked / "fmi2" / "RobotPlant") as host:
        host.run_up()
        before = host.get(STATES)
        host.must(host.set_rates({"dm": -50.0}))
        assert host.step(0.0, 0.1) == DISCARD
        (message,) = host.messages
        assert "the mass matrix is not positive definite" in message
        assert 0.0 < float(message.split("t = ")[1].split()[0]) < 0.1
        assert host.get(STATES) == before


def test_setting_an_input_alone_holds_it(unpacked: Path) -> None:
    """A derivative that was given before the value belongs to the old value."""
    with Host(unpacked / "fmi2" / "RobotPlant") as host:
        host.run_up()
        host.must(host.set_rates({"tau_a[1]": 1.0}))
        host.must(host.set({"tau_a[1]": 0.5}))
        host.must(host.step(0.0, 0.01))
        assert host.get(["tau_a[1]"]) == [0.5]


# 6. Misuse


def pairs(cases: list[Misuse]) -> list[Any]:
    return [pytest.param(f, c, id=f"{f}-{c.name}".replace(" ", "_")) for c in cases for f in c.flavours]


@pytest.mark.parametrize(("flavour", "case"), pairs(CASES))
def test_misuse_is_refused_with_a_message(unpacked: Path, flavour: str, case: Misuse) -> None:
    with Host(unpacked / flavour / "RobotPlant", case.kind) as host:
        assert case.call(host) == case.status
        assert re.search(case.words, "\n".join(host.messages)), host.messages
        # the last message belongs to the failure and carries its status
        assert host.log[-1] == (case.status, {DISCARD: "logStatusDiscard", ERROR: "logStatusError"}[case.status])


def child(script: str, *arguments: str) -> Any:
    """Result of a script in a new process of this checkout, which prints JSON as its last line."""
    environment = os.environ | {"PYTHONPATH": str(CHECKOUT), "PYTHONFAULTHANDLER": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        cwd=CHECKOUT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, (done.returncode, done.stderr[-3000:])
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("flavour", [pytest.param("fmi2", marks=pytest.mark.slow), "fmi3"])
def test_a_host_survives_all_misuse_and_a_good_run_follows(unpacked: Path, flavour: str) -> None:
    """One instance after the other, in one process; the refused instances live on until the good run is over."""
    script = """
import json, sys
from pathlib import Path
from tests.support.native_fmus import Host
from tests.support.native_misuse import CASES, good_run
folder, hosts = Path(sys.argv[1]), []
for case in CASES:
    if folder.parent.name in case.flavours:
        hosts.append(Host(folder, case.kind))
        case.call(hosts[-1])
values = good_run(folder)
for host in hosts:
    host.free()
print(json.dumps([len(hosts), values]))
"""
    folder = unpacked / flavour / "RobotPlant"
    n, values = child(script, str(folder))
    assert n > 50
    assert values == good_run(folder)


@BOTH
def test_missing_pointers_do_not_abort_the_host(unpacked: Path, flavour: str) -> None:
    """In a process of their own; if it dies, the last line that it printed names the call."""
    script = """
import json, sys
from pathlib import Path
from tests.support.native_fmus import Host
from tests.support.native_misuse import MISSING
found = {}
for case in MISSING:
    if sys.argv[2] in case.flavours:
        print(case.name, file=sys.stderr, flush=True)
        host = Host(Path(sys.argv[1]), case.kind)
        found[case.name] = [case.call(host), host.messages]
        host.free()
print(json.dumps(found))
"""
    found = child(script, str(unpacked / flavour / "RobotPlant"), flavour)
    cases = {case.name: case for case in MISSING if flavour in case.flavours}
    assert found.keys() == cases.keys()
    assert len(found) > 5
    for name, (status, messages) in found.items():
        assert status == ERROR, name
        assert re.search(cases[name].words, "\n".join(messages)), (name, messages)


@BOTH
def test_an_instance_goes_on_from_a_saved_state_after_refused_calls(unpacked: Path, flavour: str) -> None:
    """What is refused leaves no trace: the same bits as without it."""
    folder = unpacked / flavour / "RobotPlant"
    with Host(folder) as host:
        host.run_up(TORQUE)
        for i in range(50):
            for refused in (
                lambda: host.set({"dm": math.nan}),
                lambda: host.set({"l": 1.0}),
                lambda: host.set({"dm": 0.1, "X": -1.0}),
                lambda: host.set({"X": 1.0, "l": 1.0}),
                lambda: host.set({"x_E": 1.0}),
                lambda now=i * 1e-3: host.step(now, -1.0),
                *(
                    [lambda now=i * 1e-3: host.step(now, 1e9)] if i == 1 else []
                ),  # it takes as many steps as there may be
                lambda now=i * 1e-3: host.step(now + 1e-3, 1e-3),
                lambda: host.step(math.nan, 1e-3),
                lambda: host.direction(["dm"], {"dm": 1.0})[0],
                *([lambda: host.set_rates({"dm": math.nan})] if flavour == "fmi2" else []),
            ):
                before = host.save_bytes()
                assert host.tried(refused) in (DISCARD, ERROR)
                assert host.save_bytes() == before
            host.must(host.step(i * 1e-3, 1e-3))
        assert host.get(list(OUTPUTS.names)) == good_run(folder)


@BOTH
def test_derivatives_of_outputs_are_those_of_the_model(unpacked: Path, flavour: str) -> None:
    """Angles change at their speeds; the controller's torques as central differences of the model say."""
    axes = range(1, 4)
    with Host(unpacked / flavour / "RobotTrajectory") as host:
        host.run_up()
        host.must(host.step(0.0, 0.3))
        status, rates = host.output_rates([f"theta_ref[{i}]" for i in axes])
        host.must(status)
        np.testing.assert_allclose(rates, host.get([f"omega_ref[{i}]" for i in axes]), rtol=1e-12)
    with Host(unpacked / flavour / "RobotPlant") as host:
        host.run_up(TORQUE)
        host.must(host.step(0.0, 0.01))
        status, rates = host.output_rates([f"{name}[{i}]" for name in ("theta_b", "omega_a") for i in axes])
        host.must(status)
        expected = [*(f"omega_b[{i}]" for i in axes), *(f"der(omega_a[{i}])" for i in axes)]
        assert rates == host.get(expected)
    controller, moves = MODELS["controller"], flavour == "fmi2"
    u, psi = np.linspace(-0.2, 0.3, len(controller.inputs)), np.zeros(2)
    u_rate = np.cos(np.arange(len(u))) if moves else np.zeros(len(u))
    names, torques = controller.inputs.names, [f"tau_a[{i}]" for i in axes]
    with Host(unpacked / flavour / "RobotController") as host:
        host.run_up(dict(zip(names, u.tolist(), strict=True)))
        if moves:
            host.must(host.set_rates(dict(zip(names, u_rate.tolist(), strict=True))))
        status, rates = host.output_rates(torques)
        host.must(status)
        p = np.array(host.get(list(controller.parameters.names)))
    psi_rate, h = controller.derivatives(0.0, psi, u, p), 1e-5

    def torque(t: float) -> np.ndarray:
        return np.asarray(controller.output_values(t, psi + t * psi_rate, u + t * u_rate, p)[:3])

    assert not moves or np.abs(rates).max() > 1e-3
    np.testing.assert_allclose(rates, (torque(h) - torque(-h)) / (2.0 * h), rtol=1e-6, atol=1e-9)


@BOTH
def test_a_discarded_step_leaves_the_state(unpacked: Path, flavour: str) -> None:
    folder = unpacked / flavour / "RobotPlant"
    with Host(folder) as host:
        host.run_up(TORQUE)
        for i in range(50):
            host.must(host.set({"tau_a[1]": 1e300}))
            if flavour == "fmi3":  # "the FMU is in the same state as before the call"
                assert host.step(i * 1e-3, 1.0) == DISCARD
            else:
                assert host.tried(lambda now=i * 1e-3: host.step(now, 1.0)) == DISCARD
            host.must(host.set({"tau_a[1]": TORQUE["tau_a[1]"]}))
            host.must(host.step(i * 1e-3, 1e-3))
        assert host.get(list(OUTPUTS.names)) == good_run(folder)


@BOTH
def test_path_out_of_reach_is_an_error_that_says_so(unpacked: Path, flavour: str) -> None:
    """As the pythonfmu flavour does: the requirement that does not hold, not just 'not finite'."""
    with Host(unpacked / flavour / "RobotTrajectory") as host:
        host.run_up({"w": 0.5, "R": 0.0, "a": 20.0, "x_c": -0.14, "phase": 0.0})
        host.must(host.step(0.0, 3.0))
        status, _ = host.try_get(["theta_ref[1]"])
        assert status == ERROR
        assert "leaves the reach of chain" in host.messages[-1]


@BOTH
@pytest.mark.parametrize("torque", [1e3, 1e4, 1e6])
def test_torques_that_the_step_does_not_resolve_are_refused_before_the_loop_opens(
    unpacked: Path, flavour: str, torque: float
) -> None:
    """Outputs of the step in which the closure was lost are an error; who does not look is told by the next step."""
    with Host(unpacked / flavour / "RobotPlant") as host, Host(unpacked / flavour / "RobotPlant") as blind:
        for each in (host, blind):
            each.run_up({"tau_a[1]": torque, "rtol": 0.0})
        for i in range(100):
            host.must(host.step(i * 1e-3, 1e-3))
            status, _ = host.try_get(["closure_error", "x_E"])
            if status != OK:
                break
            host.must(blind.step(i * 1e-3, 1e-3))
            assert host.get(["closure_error"])[0] <= 0.244 / 250.0
        assert status == ERROR
        lost = f"t = {(i + 1) * 1e-3:.9g} s: the loop closure is lost, closure_error is above l / 250"
        assert host.messages[-1].startswith(lost)
        blind.must(blind.step(i * 1e-3, 1e-3))
        assert blind.step((i + 1) * 1e-3, 1e-3) == DISCARD
        assert blind.messages[-1].startswith(lost)
    with Host(unpacked / flavour / "RobotPlant") as host:  # steps that resolve it, as the FMU chooses them
        host.run_up({"tau_a[1]": torque})
        host.must(host.step(0.0, 1.0 / torque))
        assert host.get(["closure_error"])[0] < 1e-6


@BOTH
def test_status_of_steps(unpacked: Path, flavour: str) -> None:
    """When a step was discarded, the importer can ask for the time until which all was well."""
    with Host(unpacked / flavour / "RobotPlant") as host:
        host.run_up(start=2.0)
        host.must(host.step(2.0, 0.5))
        state = host.save()
        host.must(host.set({"dm": -5.0}))
        assert host.step(2.5, 0.5) == DISCARD
        if flavour == "fmi2":
            time, terminated = c_double(), c_int(-1)
            host.must(host.call("GetRealStatus", 2, byref(time)))
            host.must(host.call("GetBooleanStatus", 3, byref(terminated)))
            assert (time.value, terminated.value) == (2.5, 1)
            assert host.call("GetStatus", 0, byref(c_int())) == DISCARD
        else:
            assert host.last_time.value == 2.5
            assert [f.value for f in host.flags] == [False, False, False]
        if flavour == "fmi2":
            host.must(host.restore(state))
        host.forget(state)
        host.must(host.set({"dm": 0.0}))
        host.must(host.step(2.5, 0.5))
        if flavour == "fmi3":
            assert host.last_time.value == 3.0
            assert host.get(["time"]) == [3.0]


# Instantiation


@BOTH
@pytest.mark.parametrize("token", ["", "{00000000000000000000000000000000}", "{"], ids=["empty", "other", "short"])
def test_wrong_token_is_refused(unpacked: Path, flavour: str, token: str) -> None:
    with pytest.raises(Refused, match=r"(GUID|instantiation token) is not that of this FMU"):
        Host(unpacked / flavour / "RobotPlant", token=token)


@BOTH
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"name": ""}, "has no name"),
        ({"name": None}, "has no name"),
        ({"resources": None}, "resource (location|path) is missing"),
        ({"resources": "/no/such/folder"}, r"/no/such/folder/start_values.txt is missing or unreadable"),
        ({"resources": "/" + 5000 * "x"}, "too long"),
    ],
    ids=["empty-name", "no-name", "no-resources", "missing-folder", "long-path"],
)
def test_bad_arguments_of_instantiate(
    unpacked: Path,
    flavour: str,
    options: dict[str, Any],
    words: str,
) -> None:
    with pytest.raises(Refused, match=words):
        Host(unpacked / flavour / "RobotPlant", **options)


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        ("CoSimulation", {"event_mode": True}, "no event mode"),
        ("ScheduledExecution", {}, "no scheduled execution"),
    ],
)
def test_what_fmi3_does_not_offer(unpacked: Path, kind: str, options: dict[str, Any], words: str) -> None:
    with pytest.raises(Refused, match=words):
        Host(unpacked / "fmi3" / "RobotPlant", kind, **options)


@BOTH
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (r"Y = .*\n", "", "'Y' is missing"),
        (r"dm = .*\n", "", "'dm' is missing"),
        (r"(?s).*", "", "'X' is missing"),
        (r"Y = .*", "Y = nan", "'Y = nan'"),
        (r"Y = .*", "Y = inf", "'Y = inf'"),
        (r"Y = .*", "Y = 1e999", "'Y = 1e999'"),
        (r"Y = .*", "Y = ", "'Y = '"),
        (r"Y = .*", "Y = one", "'Y = one'"),
        (r"Y = .*", "Y", "'Y'"),
        (r"Y = .*", "Y = 0,5", "'Y = 0,5'"),
        (r"Y = .*", "Y = 0.5x", "'Y = 0.5x'"),
        (r"Y = .*", "Y = 0.5 0.6", "'Y = 0.5 0.6'"),
        (r"Y = .*", "Y = " + 400 * "1", "1111"),
    ],
    ids=["lacks-parameter", "lacks-input", "empty", "nan", "inf", "overflow", "no-value", "word", "no-separator",
         "comma", "rest", "two-values", "long"],
)  # fmt: skip
def test_broken_start_values_are_refused(
    unpacked: Path,
    tmp_path: Path,
    flavour: str,
    old: str,
    new: str,
    words: str,
) -> None:
    folder = unpacked / flavour / "RobotPlant"
    text = (folder / "resources" / "start_values.txt").read_text()
    (tmp_path / "start_values.txt").write_text(re.sub(old, new, text, count=1))
    with pytest.raises(Refused, match="start values can't be read: ") as refused:
        Host(folder, resources=tmp_path.as_uri() if flavour == "fmi2" else str(tmp_path))
    assert words in str(refused.value)


@BOTH
@pytest.mark.parametrize("form", ["uri", "uri with host", "short uri", "trailing slash"])
def test_resources_in_a_folder_with_a_difficult_name(
    unpacked: Path,
    tmp_path: Path,
    flavour: str,
    form: str,
) -> None:
    folder = tmp_path / "a b%41#ü+é"
    folder.mkdir()
    shutil.copy(unpacked / flavour / "RobotPlant" / "resources" / "start_values.txt", folder)
    if flavour == "fmi3":  # a path there, never a URI
        resources = str(folder) + ("/" if form == "trailing slash" else "")
    else:
        uri = folder.as_uri()
        resources = {
            "uri": uri,
            "uri with host": uri.replace("file:///", "file://localhost/"),
            "short uri": uri.replace("file:///", "file:/"),
            "trailing slash": uri + "/",
        }[form]
    with Host(unpacked / flavour / "RobotPlant", resources=resources) as host:
        assert host.get_start(["X"]) == [0.0932]


@BOTH
def test_windows_line_ends_are_read(unpacked: Path, tmp_path: Path, flavour: str) -> None:
    """People edit the file with what their system has."""
    folder = unpacked / flavour / "RobotPlant"
    text = (folder / "resources" / "start_values.txt").read_bytes()
    (tmp_path / "start_values.txt").write_bytes(text.replace(b"\n", b"\r\n").rstrip(b"\r\n"))
    with Host(folder, resources=tmp_path.as_uri() if flavour == "fmi2" else str(tmp_path)) as host:
        names = [*PARAMETERS.names, *INPUTS.names]
        assert host.get_start(names) == [*PARAMETERS.starts, *INPUTS.starts]


@BOTH
def test_hosts_with_a_decimal_comma_read_the_same_start_values(unpacked: Path, tmp_path: Path, flavour: str) -> None:
    """Host programs set the user's locale; in a German one strtod reads 0.0932 as 0."""
    localedef = shutil.which("localedef")
    if localedef is None:
        pytest.skip("localedef is not installed: no locale with a decimal comma can be made")
    made = _made_locale(localedef, tmp_path)
    if made.returncode > 1 or not (tmp_path / "de_DE.UTF-8" / "LC_NUMERIC").is_file():
        pytest.skip(f"no locale with a decimal comma can be made: {made.stderr[-200:]}")
    script = """
import ctypes, json, locale, os, sys
os.environ["LOCPATH"] = sys.argv[2]
locale.setlocale(locale.LC_NUMERIC, "de_DE.UTF-8")
assert locale.localeconv()["decimal_point"] == ","
from pathlib import Path
from tests.support.native_fmus import Host
from plant_fmu.model import INPUTS, PARAMETERS
locale.setlocale(locale.LC_NUMERIC, "de_DE.UTF-8")
host = Host(Path(sys.argv[1]))
print(json.dumps(host.get_start([*PARAMETERS.names, *INPUTS.names])))
"""
    assert child(script, str(unpacked / flavour / "RobotPlant"), str(tmp_path)) == [*PARAMETERS.starts, *INPUTS.starts]


def _made_locale(localedef: str, folder: Path) -> Any:
    """A locale with a decimal comma from a few lines: the sources of real ones are seldom installed."""
    source = folder / "comma"
    source.write_text(
        'comment_char %\nescape_char /\nLC_NUMERIC\ndecimal_point ","\nthousands_sep ""\ngrouping -1\nEND LC_NUMERIC\n'
    )
    return subprocess.run(
        [localedef, "-c", "-i", str(source), "-f", "UTF-8", "--no-archive", str(folder / "de_DE.UTF-8")],
        capture_output=True,
        text=True,
        check=False,
    )


# 7. FMU states


@BOTH
@pytest.mark.parametrize("way", ["same instance", "other instance", "bytes", "bytes of another process"])
def test_restored_instances_go_on_bit_by_bit(unpacked: Path, flavour: str, way: str) -> None:
    folder = unpacked / flavour / "RobotPlant"
    with prepared(folder) as host:
        state, data = host.save(), host.save_bytes()
        host.must(host.step(10e-3, 1e-3))
        expected = [host.get([*INPUTS.names, *OUTPUTS.names]), advance(host, 11, 30)]
        with Host(folder, name="other") as other:
            if way == "same instance":
                restored = host
                host.must(host.restore(state))
            elif way == "other instance":
                restored = other
                other.must(other.restore(state))
            else:
                if way == "bytes of another process":
                    script = """
import json, sys
from pathlib import Path
from tests.support.native_misuse import prepared
print(json.dumps(prepared(Path(sys.argv[1])).save_bytes().hex()))
"""
                    assert bytes.fromhex(child(script, str(folder))) == data
                restored = other
                other.must(other.restore_bytes(data))
            restored.must(restored.step(10e-3, 1e-3))
            found = [restored.get([*INPUTS.names, *OUTPUTS.names]), advance(restored, 11, 30)]
            assert found == expected
            if flavour == "fmi2":
                assert expected[0][1] == TORQUE["tau_a[2]"] + 1e-3 * 30.0
        host.forget(state)


@BOTH
def test_equal_states_have_equal_bytes_and_a_discarded_step_leaves_none_behind(unpacked: Path, flavour: str) -> None:
    folder = unpacked / flavour / "RobotPlant"
    with prepared(folder) as host, Host(folder, name="other") as other:
        data = host.save_bytes()
        host.must(host.set({"tau_a[1]": 1e300}))
        assert host.step(10e-3, 1e-3) == DISCARD  # the state overflows
        other.must(other.restore_bytes(host.save_bytes()))
        other.must(other.restore_bytes(data))
        other.must(other.step(10e-3, 1e-3))
        other.must(other.restore_bytes(data))  # now the states stand where the step began
        assert other.save_bytes() == data


@BOTH
def test_states_keep_the_phase(unpacked: Path, flavour: str) -> None:
    """A state from the initialisation mode brings an instance that runs back there, and the other way round."""
    with Host(unpacked / flavour / "RobotPlant") as host:
        host.must(host.enter())
        initial = host.save()
        host.must(host.exit())
        host.must(host.step(0.0, 1e-3))
        host.must(host.restore(initial))
        assert host.tried(lambda: host.step(0.0, 1e-3)) == ERROR
        host.must(host.set({"x_E_start": 0.21}))
        host.must(host.exit())
        assert host.get(["x_E"])[0] == pytest.approx(0.21)
        host.forget(initial)


@BOTH
def test_every_changed_byte_of_a_state_is_noticed(unpacked: Path, flavour: str) -> None:
    with prepared(unpacked / flavour / "RobotPlant") as host:
        data = host.save_bytes()
        before = host.get(list(OUTPUTS.names))
        damaged = [
            data[:-1],
            data + b"\0",
            b"",
            *(data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :] for i in range(len(data))),
        ]
        accepted = [i - 3 for i, bad in enumerate(damaged) if host.restore_bytes(bad) == OK]
        assert not accepted, f"{len(accepted)} of {len(data)} flipped bytes are accepted, the first at {accepted[0]}"
        assert "damaged" in host.messages[-1]
        assert host.get(list(OUTPUTS.names)) == before
        host.must(host.restore_bytes(data))


@BOTH
def test_state_of_another_fmu_is_refused(unpacked: Path, flavour: str) -> None:
    with (
        Host(unpacked / flavour / "RobotController").run_up() as other,
        Host(unpacked / flavour / "RobotPlant") as host,
    ):
        assert host.restore_bytes(other.save_bytes()) == ERROR
        assert "belongs to another FMU" in host.messages[-1]


@BOTH
def test_state_of_the_other_interface_is_refused(unpacked: Path, flavour: str) -> None:
    """In event mode, an instance for co-simulation could neither step nor leave that mode."""
    folder = unpacked / flavour / "RobotPlant"
    with Host(folder, "ModelExchange").run_up() as other, Host(folder).run_up() as host:
        assert host.tried(lambda: host.restore_bytes(other.save_bytes())) == ERROR
        host.must(host.step(0.0, 1e-3))


@BOTH
@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
def test_reset_gives_a_fresh_instance(unpacked: Path, flavour: str, kind: str) -> None:
    folder = unpacked / flavour / "RobotPlant"
    names = [*PARAMETERS.names, *INPUTS.names, *OUTPUTS.names, *(f"der({s})" for s in STATES)]

    def run(host: Host) -> list[float]:
        fresh_values = host.get_start(names)
        host.run_up(TORQUE)
        if kind == "CoSimulation":
            for i in range(20):
                host.must(host.step(i * 1e-3, 1e-3))
        else:
            host.continuous()
            host.must(host.set_states([0.9 * v for v in host.get_states(12)]))
        return fresh_values + host.get(names)

    with Host(folder, kind) as host, Host(folder, kind) as new:
        host.run_up({"x_E_start": 0.21, "X": 0.1, "dm": 0.05, "max_step": 1e-4}, start=3.0)
        if kind == "CoSimulation":
            if flavour == "fmi2":
                host.must(host.set_rates({"tau_a[2]": 30.0}))
                host.must(host.set({"dm": -5.0}))
            host.step(3.0, 1e-3)
        host.must(host.call("Terminate"))
        host.must(host.call("Reset"))
        new_bytes = new.save_bytes()
        assert host.save_bytes() == new_bytes
        assert run(host) == run(new)


def test_restored_state_has_its_last_successful_time(unpacked: Path) -> None:
    with Host(unpacked / "fmi2" / "RobotPlant").run_up() as host:
        host.must(host.step(0.0, 1.0))
        state, time = host.save(), c_double()
        host.must(host.step(1.0, 1.0))
        host.must(host.restore(state))
        host.must(host.call("GetRealStatus", 2, byref(time)))
        assert time.value == 1.0
        host.forget(state)


# 8. Start values


@BOTH
def test_written_start_values_take_effect(native_fmus: Path, tmp_path: Path, flavour: str) -> None:
    fmu = Path(shutil.copy(native_fmus / flavour / "RobotPlant.fmu", tmp_path))
    before = contract(fmu)
    new = {"x_E_start": 0.2125, "X": 0.1 / 3.0 + 0.06, "max_step": 5e-4, "y_A[2]": 0.001}
    write_start_values(fmu, new)
    assert contract(fmu) == [(*row[:7], new.get(row[0], row[7]), *row[8:]) for row in before]
    assert validate_fmu(str(fmu)) == []
    with Host(unpack(fmu, tmp_path / "x")) as host:
        assert host.get_start(list(new)) == list(new.values())
        host.run_up()
        assert host.get(["x_E"])[0] == pytest.approx(0.2125, abs=1e-12)
        host.must(host.step(0.0, 1e-3))
        host.must(host.call("Reset"))
        assert host.get_start(list(new)) == list(new.values())
    with zipfile.ZipFile(native_fmus / flavour / "RobotPlant.fmu") as old, zipfile.ZipFile(fmu) as archive:
        changed = [n for n in old.namelist() if old.read(n) != archive.read(n)]
        assert archive.namelist() == old.namelist()
    assert sorted(changed) == ["modelDescription.xml", "resources/start_values.txt"]


@BOTH
@pytest.mark.parametrize(
    ("name", "value", "words"),
    [("nobody", 1.0, "no parameter 'nobody'"), ("l", -1.0, "outside"), ("X", math.nan, "not a finite number"),
     ("dm", 0.1, "no parameter 'dm'"), ("x_E", 0.1, "no parameter 'x_E'")],
)  # fmt: skip
def test_bad_start_values_are_not_written(
    native_fmus: Path,
    tmp_path: Path,
    flavour: str,
    name: str,
    value: float,
    words: str,
) -> None:
    fmu = Path(shutil.copy(native_fmus / flavour / "RobotPlant.fmu", tmp_path))
    before = fmu.read_bytes()
    with pytest.raises(StartValueError, match=words):
        write_start_values(fmu, {"Y": 0.04, name: value})
    assert fmu.read_bytes() == before


@BOTH
def test_start_values_edited_by_hand_take_effect(unpacked: Path, tmp_path: Path, flavour: str) -> None:
    folder = Path(shutil.copytree(unpacked / flavour / "RobotController", tmp_path / "x"))
    text = folder / "resources" / "start_values.txt"
    text.write_text(re.sub(r"(?m)^k = .*", "k = 7.25", text.read_text()))
    with Host(folder) as host:
        assert host.get_start(["k", "rtol"]) == [7.25, 1e-5]


# 9. Memory and threads


@BOTH
def test_instances_leave_no_memory_behind(unpacked: Path, flavour: str) -> None:
    """Also those that were refused, and their FMU states: counted by the C library, which knows every byte."""
    if not hasattr(ctypes.CDLL(None), "mallinfo2"):
        pytest.skip("the C library has no mallinfo2 (glibc 2.33): what is allocated can't be counted")
    script = """
import ctypes, gc, json, sys
from pathlib import Path
from tests.support.native_fmus import Host, Refused
import tests.support.native_fmus as helper

folder = Path(sys.argv[1])
description = helper.fmpy.read_model_description(str(folder))
helper.fmpy.read_model_description = lambda _: description  # that is not what is measured

class Allocated(ctypes.Structure):
    names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost".split()
    _fields_ = [(name, ctypes.c_size_t) for name in names]

mallinfo2 = ctypes.CDLL(None).mallinfo2
mallinfo2.restype = Allocated

def in_use():
    gc.collect()
    found = mallinfo2()
    return found.uordblks + found.hblkhd

def cycle(i):
    with Host(folder, ("CoSimulation", "ModelExchange")[i % 2]) as host:
        host.run_up()
        state = host.save()
        host.must(host.restore(state))
        host.forget(state)
        host.restore_bytes(b"abc")
        if i % 10 == 0:
            host.restore_bytes(host.save_bytes())
            host.call("Reset")
    for options in ({"token": "{}"}, {"resources": "/no/such/folder"}):
        try:
            Host(folder, **options)
        except Refused:
            pass

for i in range(100):
    cycle(i)
before = in_use()
for i in range(400):
    cycle(i)
print(json.dumps(in_use() - before))
"""
    growth = child(script, str(unpacked / flavour / "RobotPlant"))
    assert growth < 40_000  # a fifth of what 400 instances or FMU states of 500 bytes would leave


@BOTH
def test_eight_threads_give_what_one_gives(unpacked: Path, flavour: str) -> None:
    folder = unpacked / flavour / "RobotPlant"

    def run(scale: float, rows: list[list[float]]) -> None:
        with Host(folder) as host:
            host.run_up({name: scale * value for name, value in TORQUE.items()})
            for i in range(200):
                host.must(host.step(i * 0.01, 0.01))
                rows.append(host.get(list(OUTPUTS.names)))

    scales = [1.0 + 0.1 * i for i in range(8)]
    alone: list[list[list[float]]] = [[] for _ in scales]
    for scale, rows in zip(scales, alone, strict=True):
        run(scale, rows)
    together: list[list[list[float]]] = [[] for _ in scales]
    threads = [threading.Thread(target=run, args=pair) for pair in zip(scales, together, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(len(rows) == 200 for rows in together)
    assert together == alone
    assert alone[0] != alone[1]


# 10. Symbols


@BOTH
@ALL
def test_exported_symbols_are_those_of_the_standard(unpacked: Path, flavour: str, name: str) -> None:
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("nm is not installed")
    folder = unpacked / flavour / name
    header = (Path(fmpy.__file__).parent / "c-code" / f"{flavour}Functions.h").read_text()
    demanded = set(re.findall(rf"^\s*{flavour.upper()}_Export\s+\w+TYPE\s+({flavour}\w+)\s*;", header, re.MULTILINE))
    assert len(demanded) > 40
    library = library_path(folder, fmpy.read_model_description(str(folder)))
    options = ["-gU"] if sys.platform == "darwin" else ["-D", "--defined-only"]
    listed = subprocess.run([nm, *options, str(library)], capture_output=True, text=True, check=True).stdout
    exported = {line.split()[-1].removeprefix("_" if sys.platform == "darwin" else "") for line in listed.splitlines()}
    assert exported == demanded
