"""What an FMU does when it is called: in the right order, in the wrong order, and with rubbish.

Most tests drive the built files in a fresh process, which must end with exit code 0: by ctypes alone, some through
fmpy, whose import takes longer than the rest; some drive the class itself, in this process, through a small harness
that stands in for pythonfmu's binary.
"""

import json
import math
import types

import numpy as np
import pytest

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.modelling import internal_steps
from fmu_export.package.interface import interface_of
from fmu_export.package.start_values import start_values_text
from fmu_export.pythonfmu import backend as pythonfmu_backend
from fmu_export.pythonfmu import slave as pythonfmu_slave
from fmu_export.trace.trace import trace
from plant_fmu.model import MODEL as PLANT
from tests.support import some
from tests.support.bare_host import close, fresh, oracle, plant_torques
from tests.support.pythonfmu_calls import SCRIPT as PYTHONFMU_CALLS
from trajectory_fmu.model import MODEL as TRAJECTORY

#: An importer on fmpy's low-level FMU2Slave, with the interface of the plain host.
FMPY = """
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE, defaultCallbacks


class Importer:
    def __init__(self, folder, identifier, guid, name, log):
        self.slave = FMU2Slave(guid=guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName=name)
        callbacks = fmi2CallbackFunctions()
        # without fmpy's proxy the logger sees the format as a printf would
        callbacks.logger = fmi2CallbackLoggerTYPE(lambda e, n, *message: log(*message))
        callbacks.allocateMemory = defaultCallbacks.allocateMemory
        callbacks.freeMemory = defaultCallbacks.freeMemory
        self.slave.instantiate(callbacks=callbacks, loggingOn=True)

    def call(self, name, *arguments):
        try:
            status = getattr(self.slave, "fmi2" + name)(self.slave.component, *arguments)
        except FMICallException as error:
            return error.status
        return status

    def free(self):
        self.slave.fmi2FreeInstance(self.slave.component)
        self.slave.freeLibrary()
"""

#: The host's own importer, by ctypes alone.
CTYPES = """
Importer = Library
"""

HEAD = """
OK, WARNING, DISCARD, ERROR, FATAL = range(5)


def open_fmu(name, **keywords):
    return Host(f"{A.fmus}/{name}.fmu", library=Importer, **keywords)


def state_of(host):
    '''The whole FMU state as bytes.'''
    state = host.save()
    data = host.to_bytes(state)
    assert host.drop(state) == OK
    return data


def same(a, b):
    '''Bit for bit, NaN included.'''
    return [x.hex() for x in a] == [y.hex() for y in b]


nan, inf = float("nan"), float("inf")
MEASURED = ["theta_a[1]", "theta_b[3]", "omega_a[2]", "x_E", "y_E"]
"""


@pytest.fixture
def run(fmus, tmp_path):
    """Run a script in a fresh process that calls the FMUs by ctypes alone."""
    return lambda script, **arguments: fresh(tmp_path, CTYPES + HEAD + script, fmus=str(fmus), **arguments)


@pytest.fixture
def run_in_fmpy(fmus, tmp_path):
    """Run a script in a fresh process that calls the FMUs by fmpy."""
    return lambda script, **arguments: fresh(tmp_path, FMPY + HEAD + script, fmus=str(fmus), **arguments)


# Values


def test_plant_and_trajectory_give_what_the_numpy_models_give(run_in_fmpy):
    rows = run_in_fmpy("""
plant, trajectory = open_fmu("RobotPlant"), open_fmu("RobotTrajectory")
assert plant.initialize() == trajectory.initialize() == OK
report([plant.run(50, inputs=torques), trajectory.run(50, h=0.25)])
""")
    close(rows[0], oracle(PLANT, 50, plant_torques))
    close(rows[1], oracle(TRAJECTORY, 50, h=0.25))


def test_controller_gives_what_the_numpy_model_gives(run_in_fmpy):
    def measurements(t):
        return {
            "theta_a[1]": 0.3 * np.sin(3 * t),
            "omega_a[1]": 0.9 * np.cos(3 * t),
            "theta_ref[2]": 0.2,
            "omega_ref[3]": -t,
        }

    rows = run_in_fmpy("""
controller = open_fmu("RobotController")
assert controller.initialize({"psi_start[1]": 0.5}) == OK
report(controller.run(50, inputs=measurements))
""")
    expected = oracle(CONTROLLER, 50, measurements, **{"psi_start[1]": 0.5})
    close(rows, expected)
    assert np.any(expected[:, 3:])


def test_outputs_during_the_initialisation_follow_parameters_and_inputs(run):
    values = run("""
plant, controller = open_fmu("RobotPlant"), open_fmu("RobotController")
assert plant.setup() == plant.enter() == OK
values = [plant.get("x_E", "y_E")]
assert plant.set({"x_E_start": 0.25, "y_E_start": 0.28}) == OK
values.append(plant.get("x_E", "y_E"))
assert controller.setup() == controller.enter() == OK
assert controller.set({"psi_start[2]": 0.25}) == controller.set({"theta_a[1]": 0.5, "beta": 2.0, "S[1]": 3.0}) == OK
values.append(controller.get("tau_a[1]", "psi[2]"))
assert controller.leave() == plant.leave() == OK
values.append(controller.get("tau_a[1]", "psi[2]"))
report(values)
""")
    assert values[0] == pytest.approx([0.22, 0.30], abs=1e-15)
    assert values[1] == pytest.approx([0.25, 0.28], abs=1e-15)
    # psi[1] = 0 and the velocities are zero, so that (38) is -beta S theta_e
    assert values[2] == values[3] == pytest.approx([-2.0 * 3.0 * 0.5, 0.25])


def test_outputs_follow_inputs_between_steps_without_a_step(run):
    values = run("""
controller = open_fmu("RobotController")
assert controller.initialize() == OK
values = []
for x in (0.0, 0.5, 0.5, -0.5, 0.0):
    assert controller.set({"theta_a[1]": x}) == OK
    values.append(controller.get("tau_a[1]", "theta_a[1]"))
report(values)
""")
    assert [v[1] for v in values] == [0.0, 0.5, 0.5, -0.5, 0.0]
    assert values[0][0] == values[4][0] == 0.0
    assert values[1] == values[2]
    assert values[1][0] == -values[3][0] < 0


def test_outputs_follow_the_start_time_and_the_parameters_of_the_initialisation(run):
    """A look at the outputs must not freeze those of the values before."""
    values = run(
        """
values = []
for look in (False, True):
    trajectory = open_fmu("RobotTrajectory")
    assert trajectory.set({"R": 0.07}) == trajectory.setup() == trajectory.setup(1.5) == trajectory.enter() == OK
    if look:
        trajectory.get()
    assert trajectory.set({"R": A.R}) == OK
    values.append(trajectory.get())
    assert trajectory.leave() == OK
    values.append(trajectory.get())
report(values)
""",
        R=dict(zip(TRAJECTORY.parameters.names, TRAJECTORY.parameters.starts.tolist(), strict=True))["R"],
    )
    assert values[0] == values[1]  # in the initialisation mode and after it
    assert values[3] == values[1]
    assert values[2] == values[1]
    x = TRAJECTORY.output_values(1.5, np.zeros(0), np.zeros(0), TRAJECTORY.parameters.starts)
    np.testing.assert_allclose(values[1], x, rtol=1e-13)


def test_one_long_step_is_many_internal_ones(run):
    long, short = run("""
rows = []
for n, h in ((1, 0.1), (100, 0.001)):
    plant = open_fmu("RobotPlant")
    assert plant.initialize({"tau_a[1]": 0.2, "dm": 0.1, "rtol": 0.0, "max_step": 1e-3}) == OK
    rows.append(plant.run(n, h)[-1])
report(rows)
""")
    np.testing.assert_allclose(long, short, rtol=1e-12, atol=1e-14)


def test_max_step_sets_the_number_of_internal_steps(run):
    """Against the numpy integrator with just that many steps; a step longer by rounding is not cut in two."""
    rows = run("""
rows = []
for max_step, h in ((0.01, 0.02), (0.02, 0.02), (0.03, 0.02), (0.02 / 3, 0.02), (0.02, 0.02 * (1 + 1e-15))):
    plant = open_fmu("RobotPlant")
    assert plant.initialize({"rtol": 0.0, "max_step": max_step, "tau_a[1]": 2.0}) == OK
    rows.append(plant.run(1, h)[-1])
report(rows)
""")
    two, one, still_one, three, rounded = rows
    torque = {"tau_a[1]": 2.0}
    for row, n in ((two, 2), (one, 1), (three, 3)):
        np.testing.assert_allclose(row, oracle(PLANT, n, lambda t: torque, 0.02 / n)[-1], rtol=1e-11, atol=1e-13)
    assert one == still_one
    np.testing.assert_allclose(rounded, one, rtol=1e-12, atol=1e-14)
    assert two != one


# Order of calls


def test_there_are_no_values_before_the_initialisation_mode_and_then_start_values(run):
    """FMI 2.0.5, 2.1.6: values can be inquired after fmi2EnterInitializationMode."""
    said, values = run("""
plant = open_fmu("RobotPlant")
assert plant.call("GetReal", plant._references(["X"]), 1, (ctypes.c_double * 1)()) >= ERROR
said = plant.said()
assert plant.reset() == plant.setup() == plant.enter() == OK
report([said, [plant.get("X", "l", "dm"), plant.get("x_E", "y_E"), plant.said()]])
""")
    assert "get_real can't be called before the initialisation mode" in said
    assert values[0] == [0.0932, 0.244, 0.0]
    assert values[1] == pytest.approx([0.22, 0.30], abs=1e-15)
    assert values[2] == ""


def test_calls_out_of_order_are_refused_and_after_one_only_a_reset_helps(run):
    """In every phase what the standard's table does not allow there."""
    said = run("""
ways = {
    "instantiated": [],
    "initialising": ["setup", "enter"],
    "stepping": ["setup", "enter", "leave"],
    "terminated": ["setup", "enter", "leave", "terminate"],
}
wrong = {
    "instantiated": ["enter", "leave", "step", "terminate"],
    "initialising": ["setup", "enter", "step", "terminate"],
    "stepping": ["setup", "enter", "leave"],
    "terminated": ["setup", "enter", "leave", "step", "terminate", "set"],
}
texts = {}
host = open_fmu("RobotController")
calls = {
    "setup": host.setup, "enter": host.enter, "leave": host.leave, "step": lambda: host.step(0.0, 0.001),
    "terminate": lambda: host.call("Terminate"), "set": lambda: host.set({"alpha": 1.0}),
}
for phase, way in ways.items():
    for name in wrong[phase]:
        assert host.reset() == OK
        for step in way:
            assert calls[step]() == OK
        assert calls[name]() >= ERROR, (phase, name)
        texts[f"{phase} {name}"] = host.said()
        for other in calls:
            assert calls[other]() >= ERROR, (phase, name, other)
            assert "after an error; restore a saved FMU state, or reset" in host.said()
assert host.reset() == host.initialize() == OK
host.run(2)
report(texts)
""")
    assert len(said) == 17
    assert "(fmi2SetupExperiment) must be called before" in said.pop("instantiated enter")
    assert all("can't be called" in text for text in said.values())


def test_steps_go_on_where_the_fmu_is_and_not_past_the_stop_time(run):
    """FMI 2.0.5, 2.1.5 and 4.2.2; times that differ by rounding are the same."""
    said = run("""
texts = []
host = open_fmu("RobotPlant")
stop = 0.3
for i in range(6):
    assert host.reset() == OK
    assert host.call("SetupExperiment", 0, 0.0, 0.1, 1, stop) == host.enter() == host.leave() == OK
    if i == 0:  # 0.1 + 0.1 + 0.1 > 0.3
        assert host.step(0.1, 0.1) == host.step(0.1 + 0.1, 0.1) == OK
        assert host.step(0.3, 0.1) >= ERROR
    if i == 1:
        assert host.step(0.0, 0.1) >= ERROR  # not from the start time
    if i == 2:
        assert host.step(0.1, 0.1) == OK
        assert host.step(0.1, 0.1) >= ERROR  # again
    if i == 3:
        assert host.step(0.1, 0.1) == OK
        assert host.step(0.20002, 0.01) >= ERROR  # forward
    if i == 4:
        assert host.step(0.1, 0.25) >= ERROR  # one step past the end
    if i == 5:  # a state goes back in time
        host.said()
        state = host.save()
        assert host.step(0.1, 0.1) == OK
        assert host.restore(state) == host.step(0.1, 0.1) == OK
        assert host.step(0.1, 0.1) >= ERROR
        assert host.restore(state) == host.step(0.1, 0.05) == OK and host.drop(state) == OK
    texts.append(host.said())
assert host.reset() == OK
assert host.call("SetupExperiment", 0, 0.0, 0.1, 1, nan) >= ERROR
report([*texts, host.said()])
""")
    past, *jumps, long, back, nan = said
    for text in (past, long):
        assert "goes past 0.3 s, which is the stop time of the experiment" in text
    for text in (*jumps, back):
        assert "go on there, or restore an FMU state" in text
    assert "this FMU is at 0.2 s" in jumps[-1]
    assert "stop time nan is not a number" in nan


@pytest.mark.parametrize(
    ("name", "variable", "reason"),
    [
        ("RobotPlant", "l", "parameter 'l' is fixed after the initialisation"),
        ("RobotController", "psi_start[1]", "parameter 'psi_start[1]' is fixed after the initialisation"),
        ("RobotTrajectory", "w", "parameter 'w' is fixed after the initialisation"),
        ("RobotPlant", "max_step", "parameter 'max_step' is fixed"),
        ("RobotPlant", "x_E", "output 'x_E' can't be set"),
        ("RobotTrajectory", "x_ref", "output 'x_ref' can't be set"),
    ],
)
def test_setting_what_must_not_be_set_is_refused_after_the_initialisation(run, name, variable, reason):
    said = run(
        """
host = open_fmu(A.name)
assert host.initialize() == OK
host.run(2)
before = host.get(A.variable), host.get()
assert host.set({A.variable: 0.5}) >= ERROR
texts = [host.said()]
assert (host.get(A.variable), host.get()) == before
assert host.step(0.002, 0.001) >= ERROR
assert host.reset() == host.initialize() == OK
host.run(2)
assert (host.get(A.variable), host.get()) == before
report(texts)
""",
        name=name,
        variable=variable,
    )
    assert all(reason in text for text in said)


def test_a_tunable_parameter_counts_from_the_point_where_it_is_set(run):
    said = run("""
changed = {"alpha": 2.0, "S[2]": 3.0, "tau_max[1]": 0.05}
controller, other = open_fmu("RobotController"), open_fmu("RobotController")
assert controller.initialize() == OK
assert other.initialize(changed) == OK
inputs = measurements(0.0)
for host in (controller, other):
    assert host.set(inputs) == OK
before = controller.get()
assert controller.set(changed) == OK
assert same(controller.get(), other.get()) and not same(controller.get(), before)
assert controller.get(*changed) == list(changed.values())
assert all(same(a, b) for a, b in zip(controller.run(5, inputs=measurements), other.run(5, inputs=measurements)))
report(controller.said() + other.said())
""")
    assert said == ""


def test_a_bad_value_of_a_tunable_parameter_discards_the_step_and_a_good_one_repairs_it(run):
    said = run("""
texts = []
for values, good in (({"alpha": -1.0}, 1.0), ({"k": nan}, 12.0), ({"tau_max[2]": inf}, 1.0)):
    name, = values
    host, other = open_fmu("RobotController"), open_fmu("RobotController")
    assert host.initialize() == other.initialize() == OK
    host.run(3), other.run(3)
    assert host.set(values) == OK
    state = host.save()
    assert host.call("GetReal", host._references(host.outputs[:1]), 1, (ctypes.c_double * 1)()) >= ERROR
    assert host.restore(state) == OK
    assert host.step(0.003, 0.001) == DISCARD
    assert host.restore(state) == OK
    assert host.step(0.003, 0.001) == DISCARD
    texts.append(host.said())
    assert host.restore(state) == OK and host.drop(state) == OK
    assert host.set({name: good}) == other.set({name: good}) == OK
    assert all(same(a, b) for a, b in zip(host.run(3, start=3), other.run(3, start=3)))
report(texts)
""")
    for text, reason in zip(said, ("'alpha' is -1.0", "'k' is nan", "'tau_max[2]' is inf"), strict=True):
        assert f"parameter {reason}" in text


def test_setting_an_output_before_the_initialisation_is_refused(run):
    said = run("""
plant = open_fmu("RobotPlant")
assert plant.set({"x_E": 0.5}) >= ERROR
report(plant.said())
assert plant.setup() >= ERROR
""")
    assert "output 'x_E' can't be set" in said


# Values that are not numbers


def test_nan_input_discards_the_step_and_a_number_repairs_it(run_in_fmpy):
    said = run_in_fmpy("""
texts = []
for name, variable, good in (("RobotPlant", "tau_d[2]", 0.1), ("RobotController", "theta_a[1]", 0.2)):
    host = open_fmu(name)
    other = open_fmu(name)
    assert host.initialize() == other.initialize() == OK
    host.run(3), other.run(3)
    for bad in (nan, inf, -inf):
        before, state = state_of(host), host.save()
        assert host.set({variable: bad}) == OK
        assert host.step(0.003, 0.001) == DISCARD
        texts.append(host.said())
        assert host.step(0.003, 0.001) >= ERROR
        assert "after a discarded step; restore" in host.said()
        assert host.restore(state) == OK and host.drop(state) == OK
        assert state_of(host) == before
    for h in (host, other):
        assert h.set({variable: good}) == OK
        h.run(5, start=3)
    assert same(host.get(), other.get())
report(texts)
""")
    for text, (variable, value) in some(
        zip(said, [(v, b) for v in ("tau_d[2]", "theta_a[1]") for b in ("nan", "inf", "-inf")], strict=True)
    ):
        assert f"'{variable}' is {value}" in text
        assert "set a finite number" in text
        assert "t = 0.003 s" in text


def test_infinities_of_opposite_signs_are_found_too(run):
    text = run("""
plant = open_fmu("RobotPlant")
assert plant.initialize() == OK
plant.set({"tau_a[1]": inf, "tau_a[2]": -inf})
assert plant.step(0.0, 0.001) == DISCARD
report(plant.said())
""")
    assert "'tau_a[1]' is inf, 'tau_a[2]' is -inf" in text


#: Model, values, what the FMU says.
UNUSABLE = [
    ("RobotController", {"alpha": -1.0}, "parameter 'alpha' is -1.0; it must be at least 0.0"),
    ("RobotController", {"beta": math.nan}, "parameter 'beta' is nan; set a finite number"),
    ("RobotController", {"k": math.inf}, "parameter 'k' is inf; set a finite number"),
    ("RobotController", {"k": 0.0}, "parameter 'k' is 0.0; it must be at least 1e-12"),
    ("RobotController", {"psi_start[2]": -math.inf}, "parameter 'psi_start[2]' is -inf"),
    ("RobotController", {"theta_ref[1]": math.nan}, "input 'theta_ref[1]' is nan"),
    ("RobotPlant", {"max_step": 0.0}, "parameter 'max_step' is 0.0; it must be at least 1e-09"),
    ("RobotPlant", {"l": -0.244}, "parameter 'l' is -0.244"),
    ("RobotPlant", {"x_E_start": 0.6}, "out of reach of chain 1"),
    ("RobotPlant", {"x_E_start": -0.05, "y_E_start": 0.3}, "out of reach of chain 2"),
    ("RobotPlant", {"x_E_start": 0.35, "y_E_start": 0.0}, "out of reach of chain 3"),
    ("RobotPlant", {"x_E_start": 1e300}, "out of reach of chain 1"),
    ("RobotPlant", {"dm": -1.3}, "make dm larger"),
    ("RobotPlant", {"X": 0.04}, "X Y - Z^2 must be positive"),
    ("RobotTrajectory", {"a": 30.0}, "the desired path (x_ref, y_ref) leaves the reach of chain"),
    ("RobotTrajectory", {"phase": math.nan}, "parameter 'phase' is nan"),
]


@pytest.mark.parametrize("name", ["RobotController", "RobotPlant", "RobotTrajectory"])
def test_unusable_values_are_refused_at_the_initialisation_and_a_reset_repairs(run, name):
    reasons = [reason for model, _, reason in UNUSABLE if model == name]
    said = run(
        """
texts = []
for values in A.values:
    host = open_fmu(A.name)
    assert host.initialize(values) >= ERROR, values
    texts.append(host.said())
    assert host.step(0.0, 0.001) != OK, values
    host.said()
    assert host.reset() == host.initialize() == OK, values
    host.run(2)
    host.free()
report(texts)
""",
        name=name,
        values=[values for model, values, _ in UNUSABLE if model == name],
    )
    assert [reason in text for reason, text in zip(reasons, said, strict=True)] == [True] * len(some(reasons))


def test_a_failed_initialisation_can_be_repeated_with_better_values(run):
    run("""
controller = open_fmu("RobotController")
state = controller.save()
assert controller.initialize({"alpha": -1.0}) >= ERROR
assert controller.set({"alpha": 1.0}) >= ERROR
assert controller.restore(state) == controller.initialize({"alpha": 1.0}) == OK
assert controller.step(0.0, 0.001) == OK
assert controller.drop(state) == OK
""")


def test_alpha_zero_is_pd_control(run):
    tau = run("""
controller = open_fmu("RobotController")
values = {"alpha": 0.0, "beta": 2.0, "S[1]": 3.0, "psi_start[1]": 5.0, "theta_a[1]": 0.5, "omega_a[1]": 0.25}
assert controller.initialize(values) == OK
report(controller.get("tau_a[1]", "tau_a[2]"))
""")
    assert tau == [-2.0 * (0.25 + 3.0 * 0.5), 0.0]


def test_indefinite_mass_matrix_in_mid_run_discards_and_goes_on_after_repair(run):
    said = run("""
plant, other = open_fmu("RobotPlant"), open_fmu("RobotPlant")
assert plant.initialize({"tau_a[1]": 0.3}) == other.initialize({"tau_a[1]": 0.3}) == OK
plant.run(5), other.run(5)
before, state = (plant.get(), state_of(plant)), plant.save()
assert plant.set({"dm": -1.3}) == OK
assert plant.step(0.005, 0.001) == DISCARD
text = plant.said()
assert plant.restore(state) == OK and plant.drop(state) == OK
assert same(plant.get(), before[0])
assert state_of(plant) == before[1]
plant.run(5, start=5), other.run(5, start=5)
assert same(plant.get(), other.get())
report(text)
""")
    assert "mass matrix is not positive definite" in said
    assert "make dm larger" in said


def test_outputs_that_cannot_be_computed_are_refused_with_a_reason(run):
    values, text = run("""
trajectory = open_fmu("RobotTrajectory")
assert trajectory.initialize({"a": 9.0, "phase": 0.0}) == OK
values, out = [], (ctypes.c_double * 2)()
for i in range(40):
    assert trajectory.step(i * 0.1, 0.1) == OK
    status = trajectory.call("GetReal", trajectory._references(["x_ref", "theta_ref[1]"]), 2, out)
    if status != OK:
        break
    values.append(list(out))
else:
    raise SystemExit("the path stays within reach")
assert status >= ERROR
text = trajectory.said()
assert trajectory.step((i + 1) * 0.1, 0.1) >= ERROR
report([values, text])
""")
    assert "outputs at t = " in text
    assert "leaves the reach of chain" in text
    assert len(values) > 3
    assert all(math.isfinite(x) for row in values for x in row)


# Steps that make no sense


def test_steps_that_make_no_sense_are_refused_at_once_and_change_nothing(run):
    said = run("""
texts = {}
for name in ("RobotPlant", "RobotController", "RobotTrajectory"):
    host = open_fmu(name)
    assert host.initialize() == OK
    host.run(3)
    before, state = state_of(host), host.save()
    for t, h in ((0.003, 0.0), (0.003, -0.001), (0.003, nan), (0.003, inf), (nan, 0.001), (inf, 0.001)):
        assert host.step(t, h) >= ERROR
        texts[f"{name} {t} {h}"] = host.said()
        assert host.restore(state) == OK
        assert state_of(host) == before
    if name == "RobotPlant":  # the controller is at rest, and does arrive
        for h in (1e9, 1e300, 1.7e308):
            assert host.step(0.003, h) == DISCARD  # else it would never end
            texts[f"{name} {h}"] = host.said()
            assert host.restore(state) == OK
            assert state_of(host) == before
    assert host.step(0.003, 0.001) == OK
report(texts)
""")
    assert len(said) == 21
    for key, text in said.items():
        if len(key.split()) == 2:
            assert "internal steps" in text, key
            assert "max_step" in text, key
        else:
            assert "is not positive and finite" in text, key


def test_inputs_too_large_for_floats_discard_the_step_with_a_remedy(run):
    said = run("""
texts = []
for name, variable in (("RobotPlant", "tau_a[1]"), ("RobotPlant", "tau_d[3]"), ("RobotController", "omega_a[1]")):
    for value in (1e60, 1e200, 1e308):
        host = open_fmu(name)
        assert host.initialize({}) == OK
        host.run(2)
        assert host.set({variable: value}) == OK
        for i in range(3):
            if host.step(0.002 + i * 0.001, 0.001) == DISCARD:
                texts.append(host.said())
                break
        host.free()
report(texts)
""")
    assert said
    for text in said:
        assert "reduce the step, max_step or the inputs" in text, text


def test_outputs_of_a_step_that_opens_the_loop_are_refused(run):
    said = run("""
plant = open_fmu("RobotPlant")
assert plant.initialize({"tau_a[1]": 1e6, "rtol": 0.0}) == plant.step(0.0, 0.001) == OK
assert plant.call("GetReal", plant._references(["x_E"]), 1, (ctypes.c_double * 1)()) >= ERROR
report(plant.said())
""")
    assert "outputs at t = 0.001 s: the loop closure is lost" in said


def test_tiny_steps_are_steps(run):
    run("""
plant = open_fmu("RobotPlant")
assert plant.initialize() == OK
time = 0.0
for h in (1e-9, 1e-15, 5e-324):
    assert plant.step(time, h) == OK
    time += h
""")


def test_a_discarded_step_keeps_time(run):
    """Where the path is out of reach a step fails; the state stays that of the old time."""
    run("""
trajectory = open_fmu("RobotTrajectory")
assert trajectory.initialize({"a": 9.0, "phase": 0.0}) == OK
for i in range(40):
    before = state_of(trajectory)
    if trajectory.step(i * 0.1, 0.1) == DISCARD:
        break
else:
    raise SystemExit("the path stays within reach")
assert state_of(trajectory)[8:] == before[8:].replace(b'"STEP"', b'"DISCARDED"')  # behind the checksum
""")


# Wrong calls


def test_wrong_value_references_and_types_are_refused(run_in_fmpy):
    said = run_in_fmpy("""
host = open_fmu("RobotController")
assert host.initialize() == OK
host.run(1)
before, state = host.get(), host.save()
wrong = (ctypes.c_uint * 1)
real, integer, text = (ctypes.c_double * 1)(0.5), (ctypes.c_int * 1)(1), (ctypes.c_char_p * 1)(b"x")
texts = []
for reference in (len(host.vr), 10**6, 2**31 - 1, 2**31, 2**32 - 1):
    for call in ("GetReal", "SetReal"):
        assert host.call(call, wrong(reference), 1, real) >= ERROR
        texts.append(host.said())
        assert host.restore(state) == OK
for name in ("Integer", "Boolean", "String"):
    for verb in ("Get", "Set"):
        value = text if name == "String" else integer
        assert host.call(verb + name, wrong(0), 1, value) >= ERROR
        texts.append(host.said())
        assert host.restore(state) == OK
        assert host.call(verb + name, wrong(), 0, value) == OK  # none asked for, none refused
assert host.call("GetReal", wrong(), 0, real) == OK
assert host.call("SetReal", wrong(), 0, real) == OK
assert host.step(0.001, 0.001) == OK
report([texts, before])
""")[0]
    assert all("no variable has the value reference" in text for text in said[:10])
    assert all("every variable of this FMU is of type Real" in text for text in said[10:])


def test_one_wrong_reference_among_good_ones_is_refused(run):
    run("""
host = open_fmu("RobotController")
assert host.initialize() == OK
references = (ctypes.c_uint * 3)(0, 999, 1)
values = (ctypes.c_double * 3)(1.0, 2.0, 3.0)
assert host.call("GetReal", references, 3, values) >= ERROR
assert list(values) == [1.0, 2.0, 3.0]
""")


def test_values_of_repeated_and_reordered_references(run):
    run("""
plant = open_fmu("RobotPlant")
assert plant.initialize() == OK
everything = dict(zip(plant.vr, plant.get(*plant.vr)))
names = list(plant.vr)[::-1] + list(plant.vr)[::3]
assert plant.get(*names) == [everything[n] for n in names]
assert all(plant.get(n) == [v] for n, v in everything.items())
""")


@pytest.mark.parametrize("name", ["RobotPlant", "RobotController", "RobotTrajectory"])
def test_failing_calls_again_and_again_harm_no_host(run, name):
    """Each failing call drops references in the binary; the process must live, go on, and end well."""
    run(
        """
import gc
host = open_fmu(A.name)
assert host.initialize() == OK
good = host.save()
reference, real = (ctypes.c_uint * 1)(10**6), (ctypes.c_double * 1)()
integer, text = (ctypes.c_int * 1)(1), (ctypes.c_char_p * 1)(b"x")
for i in range(50):
    assert host.call("GetReal", reference, 1, real) >= ERROR
    assert host.call("SetReal", reference, 1, real) >= ERROR
    assert host.call("GetInteger", reference, 1, integer) >= ERROR
    assert host.call("SetBoolean", reference, 1, integer) >= ERROR
    assert host.call("SetString", reference, 1, text) >= ERROR
    assert host.restore(good) == OK
    assert host.step(0.0, -1.0) >= ERROR
    assert host.setup(nan) >= ERROR
    state = host.save()
    status, damaged = host.from_bytes(b"damaged")
    assert status >= ERROR or host.restore(damaged) >= ERROR
    host.drop(damaged)
    host.drop(state)
    if i % 10 == 0:
        gc.collect()
        assert host.reset() == OK
        assert host.initialize() == OK
assert host.restore(good) == host.drop(good) == host.step(0.0, 0.001) == OK
host.get()
host.free()
gc.collect()
again = open_fmu(A.name)
assert again.initialize() == OK
again.run(3)
again.free()
""",
        name=name,
    )


def test_failing_initialisations_again_and_again_harm_no_host(run_in_fmpy):
    run_in_fmpy("""
import gc
for i in range(50):
    host = open_fmu("RobotPlant", folder="plant") if i == 0 else Host(None, folder="plant", library=Importer)
    assert host.initialize({"x_E_start": 9.0}) >= ERROR
    assert host.leave() >= ERROR
    host.free()
gc.collect()
""")


def test_instances_that_are_never_freed_harm_no_exit(run):
    run("""
hosts = [open_fmu(name) for name in ("RobotPlant", "RobotController", "RobotTrajectory")]
for host in hosts:
    assert host.initialize() == OK
    host.run(2)
hosts[0].step(0.0, nan)
hosts[1].setup(nan)
state = hosts[2].save()
""")


def test_freeing_no_state_is_allowed(run):
    """FMI 2.0.4, section 2.1.8: fmi2FreeFMUstate of a null pointer is ignored."""
    run("""
host = open_fmu("RobotController")
assert host.initialize() == OK
assert host.call("FreeFMUstate", ctypes.byref(ctypes.c_void_p())) == OK
host.free()
""")


@pytest.mark.parametrize("name", ["RobotPlant", "RobotController", "RobotTrajectory"])
def test_random_calls_get_what_the_state_machine_says(fmus, tmp_path, name):
    statuses = fresh(tmp_path, PYTHONFMU_CALLS, fmu=fmus / f"{name}.fmu", calls=1500, seed=3)
    assert statuses["0"] > 300
    assert statuses["4"] > 100


# Reset


@pytest.mark.parametrize("name", ["RobotPlant", "RobotController", "RobotTrajectory"])
def test_reset_makes_an_instance_like_new(run, name):
    run(
        """
inputs = {"RobotPlant": torques, "RobotController": measurements}.get(A.name)
new = open_fmu(A.name)
assert new.setup() == new.enter() == OK
starts = new.get(*new.vr)
assert new.leave() == OK
expected = new.run(20, inputs=inputs)

used = open_fmu(A.name)
fixed = {"RobotPlant": "l", "RobotController": "psi_start[1]", "RobotTrajectory": "w"}[A.name]
for spoil in range(4):
    parameter = [n for n, c in used.causality.items() if c == "parameter"]
    first = starts[list(used.vr).index(parameter[0])]
    assert used.initialize({parameter[0]: first * 1.01}, start=2.0) == OK
    used.run(7, start=2000, inputs=inputs)
    if spoil == 0:
        assert used.set({parameter[0]: first * 1.02}) == OK  # it is tunable
        used.run(2, start=2007, inputs=inputs)
    if spoil == 1:
        assert used.step(0.0, nan) >= ERROR
    if spoil == 2:
        assert used.set({fixed: 3.0}) >= ERROR
        assert used.step(2.007, 0.001) != OK
    if spoil == 3:
        assert used.call("Terminate") == OK
    assert used.reset() == used.setup() == used.enter() == OK
    assert same(used.get(*used.vr), starts)
    assert used.leave() == OK
    assert all(same(a, b) for a, b in zip(used.run(20, inputs=inputs), expected))
    assert used.reset() == OK
""",
        name=name,
    )


def test_reset_in_every_phase(run):
    run("""
host = open_fmu("RobotPlant")
for phase in range(5):
    assert host.reset() == OK
    for call in (host.setup, host.enter, host.leave, lambda: host.step(0.0, 0.001))[:phase]:
        assert call() == OK
assert host.reset() == host.initialize() == OK
""")


def test_reset_after_the_resources_have_gone_is_refused_without_harm(run):
    said = run("""
import shutil
host = open_fmu("RobotPlant")
assert host.initialize() == OK
host.run(2)
shutil.rmtree(host.folder + "/resources")
host.run(2, start=2)
assert host.reset() == OK
assert host.initialize() >= ERROR
assert host.step(0.0, 0.001) != OK
report(host.said())
host.free()
""")
    assert "start values can't be read" in said


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "start values can't be read"),
        ("alpha = 1.0\n", "start values can't be read"),
        ("alpha = one\n", "start values can't be read"),
        (None, "'alpha' is nan"),
        ("\x00\x01", "start values can't be read"),
    ],
)
def test_damaged_start_values_are_refused_without_harm(run, content, reason):
    said = run(
        """
import re
host = open_fmu("RobotController", folder="unpacked")
path = "unpacked/resources/start_values.txt"
text = A.content
if text is None:
    text = re.sub("alpha = .*", "alpha = nan", open(path).read())
open(path, "w").write(text)
assert host.reset() == OK
assert host.initialize() >= ERROR
texts = [host.said()]
host.free()
host = Host(None, folder="unpacked", library=Importer)
assert host.initialize() >= ERROR
texts.append(host.said())
report(texts)
""",
        content=content,
    )
    assert all(reason in text for text in said)


# Many instances


def test_two_hundred_instances_one_after_another(run_in_fmpy):
    run_in_fmpy("""
import gc
library = None
rows = set()
open_fmu("RobotController", folder="unpacked").free()
for i in range(200):
    host = Host(None, folder="unpacked", library=Importer)
    if i % 4:
        assert host.initialize({"psi_start[1]": 0.5, "theta_a[1]": 0.1}) == OK
        rows.add(tuple(host.run(2)[-1]))
    host.free()
assert len(rows) == 1
gc.collect()
""")


def test_interleaved_instances_are_independent(run):
    run("""
alone = []
for i in range(3):
    plant = open_fmu("RobotPlant")
    assert plant.initialize({"x_E_start": 0.2 + 0.01 * i, "dm": 0.1 * i, "tau_a[1]": 0.1 * i}) == OK
    alone.append(plant.run(10))
    plant.free()
plants = [Host(None, folder=plant.folder, library=Importer, name=f"p{i}") for i in range(3)]
for i, plant in enumerate(plants):
    assert plant.initialize({"x_E_start": 0.2 + 0.01 * i, "dm": 0.1 * i, "tau_a[1]": 0.1 * i}) == OK
together = [[], [], []]
for k in range(10):
    for i in (2, 0, 1):
        together[i] += plants[i].run(1, start=k)
    if k == 4:  # what one does wrong is of no concern to the others
        state = plants[1].save()
        assert plants[1].step(0.0, nan) >= ERROR
        assert "positive and finite" in plants[1].said()
        assert plants[1].restore(state) == plants[1].drop(state) == OK
        extra = Host(None, folder=plant.folder, library=Importer)
        extra.setup(nan)
        extra.free()
assert together == alone and alone[0] != alone[1]
assert not plants[0].messages and not plants[2].messages
""")


# FMU state


@pytest.mark.parametrize("name", ["RobotPlant", "RobotController", "RobotTrajectory"])
def test_saved_state_is_gone_back_to_bit_for_bit(run, name):
    run(
        """
inputs = {"RobotPlant": torques, "RobotController": measurements}.get(A.name)
host = open_fmu(A.name)
assert host.initialize() == OK
host.run(10, inputs=inputs)
state, everything = host.save(), host.get(*host.vr)
expected = host.run(10, start=10, inputs=inputs)
for again in range(3):  # the state is not used up
    assert host.restore(state) == OK
    assert same(host.get(*host.vr), everything)
    assert all(same(a, b) for a, b in zip(host.run(10, start=10, inputs=inputs), expected))
assert host.drop(state) == OK
host.free()
""",
        name=name,
    )


def test_state_holds_inputs_that_were_set_after_the_last_step(run):
    run("""
host = open_fmu("RobotPlant")
assert host.initialize() == OK
host.run(3)
assert host.set({"tau_a[1]": 0.4}) == OK
state, outputs = host.save(), host.get()
expected = host.run(2, start=3)
assert host.set({"tau_a[1]": -9.0, "dm": 1.0}) == OK
host.run(1, start=5)
assert host.restore(state) == OK
assert same(host.get(), outputs) and host.get("tau_a[1]", "dm") == [0.4, 0.0]
assert all(same(a, b) for a, b in zip(host.run(2, start=3), expected))
""")


def test_states_of_other_phases(run_in_fmpy):
    run_in_fmpy("""
host = open_fmu("RobotController")
new = host.save()
assert host.setup() == host.enter() == OK
assert host.set({"psi_start[1]": 0.5, "theta_a[1]": 0.1}) == OK
initialising = host.save()
assert host.leave() == OK
expected = host.run(5)
running = host.save()

assert host.restore(initialising) == OK
assert host.step(0.0, 0.001) >= ERROR  # not initialised in that state
assert host.restore(initialising) == OK
assert host.set({"psi_start[2]": 0.0}) == OK  # parameters are free again
assert host.leave() == OK
assert all(same(a, b) for a, b in zip(host.run(5), expected))

assert host.restore(new) == OK
assert host.initialize({"psi_start[1]": 0.5, "theta_a[1]": 0.1}) == OK
assert all(same(a, b) for a, b in zip(host.run(5), expected))

assert host.reset() == OK
assert host.restore(running) == OK
assert same(host.get(), expected[-1])
assert host.step(0.005, 0.001) == OK
for state in (new, initialising, running):
    assert host.drop(state) == OK
""")


def test_state_undoes_a_refusal(run):
    run("""
host = open_fmu("RobotController")
assert host.initialize() == OK
state = host.save()
assert host.set({"psi_start[1]": 2.0}) >= ERROR
assert host.step(0.0, 0.001) >= ERROR
assert host.restore(state) == OK
assert host.step(0.0, 0.001) == OK
""")


@pytest.mark.parametrize("name", ["RobotPlant", "RobotController", "RobotTrajectory"])
def test_state_goes_through_bytes_to_another_instance_and_process(run, name):
    first = run(
        """
inputs = {"RobotPlant": torques, "RobotController": measurements}.get(A.name)
host = open_fmu(A.name)
assert host.initialize({[n for n, c in host.causality.items() if c == "parameter"][0]: 0.2}) == OK
host.run(10, inputs=inputs)
data = state_of(host)
expected = host.run(10, start=10, inputs=inputs)
host.free()

other = open_fmu(A.name)  # never initialised
status, state = other.from_bytes(data)
assert status == OK and other.restore(state) == OK and other.drop(state) == OK
assert state_of(other) == data
assert all(same(a, b) for a, b in zip(other.run(10, start=10, inputs=inputs), expected))
report([data.hex(), expected])
""",
        name=name,
    )
    second = run(
        """
inputs = {"RobotPlant": torques, "RobotController": measurements}.get(A.name)
host = open_fmu(A.name)
status, state = host.from_bytes(bytes.fromhex(A.data))
assert status == OK and host.restore(state) == OK and host.drop(state) == OK
report(host.run(10, start=10, inputs=inputs))
""",
        name=name,
        data=first[0],
    )
    assert second == first[1]


def test_state_with_nan_goes_through_bytes(run):
    run("""
host = open_fmu("RobotController")
assert host.initialize() == OK
assert host.set({"theta_a[1]": nan, "theta_a[2]": inf, "theta_a[3]": -0.0}) == OK
data = state_of(host)
status, state = host.from_bytes(data)
assert host.set({"theta_a[1]": 1.0, "theta_a[2]": 1.0, "theta_a[3]": 1.0}) == OK
assert status == OK and host.restore(state) == OK
assert state_of(host) == data
values = host.get("theta_a[1]", "theta_a[2]", "theta_a[3]")
assert same(values, [nan, inf, -0.0])
""")


RUBBISH = [
    b"",
    b"\x00",
    b"damaged",
    b"\xff\xfe\xfd",
    b"[]",
    b"{}",
    b"null",
    b"1e999",
    b'"text"',
    b'{"fingerprint": null}',
    b"[" * 100_000,
    b'{"a":' * 100_000,
    b"1" * 10_000,
]


def test_damaged_bytes_and_states_of_other_fmus_are_refused(run):
    """Refused means: an error, and the instance is as it was."""
    said = run(
        """
host = open_fmu("RobotPlant")
assert host.initialize() == OK
host.run(3, inputs=torques)
good, outputs = state_of(host), host.get()
other = open_fmu("RobotController")
assert other.initialize() == OK
texts = []
cut = [good[:n] for n in (1, 10, len(good) // 2, len(good) - 1)]
extended = [good + b"x", good + good]
for data in [bytes.fromhex(r) for r in A.rubbish] + cut + extended + [state_of(other)]:
    status, state = host.from_bytes(data)
    if status == OK:
        assert host.restore(state) >= ERROR, data[:80]
        assert host.drop(state) == OK
    texts.append(host.said())
    assert same(host.get(), outputs), data[:80]
    status, state = host.from_bytes(good)
    assert status == OK and host.restore(state) == OK and host.drop(state) == OK
    assert state_of(host) == good
host.free()
other.free()
report(texts)
""",
        rubbish=[r.hex() for r in RUBBISH],
    )
    assert all("damaged or belongs to another FMU" in text for text in said)


def test_damage_inside_the_values_is_refused_too(run):
    """One byte changed anywhere, or a value replaced: nothing of it must reach the instance."""
    run("""
import random
random.seed(1)
host = open_fmu("RobotController")
assert host.initialize() == OK
host.run(3, inputs=measurements)
good, kept, outputs = state_of(host), host.save(), host.get()
damaged = []
for _ in range(200):
    data = bytearray(good)
    position = random.randrange(len(data))
    data[position] ^= 1 << random.randrange(7)
    damaged.append(bytes(data))
for old, new in ((b'"x"', b'"y"'), (b"true", b"null"), (b"[", b"{"), (b"0.0", b'"a"'), (b"0.0", b"1.0")):
    if old in good:
        damaged.append(good.replace(old, new, 1))
accepted = 0
for data in damaged:
    status, state = host.from_bytes(data)
    if status == OK:
        accepted += host.restore(state) == OK
        host.drop(state)
    assert same(host.get(), outputs), data
    assert host.restore(kept) == OK
assert accepted == 0
assert host.step(0.003, 0.001) == OK
""")


def test_a_state_of_another_version_of_the_fmu_is_refused(run, tmp_path):
    """Same names, other equations: its state has the same shape, but means something else."""
    from dataclasses import replace

    changed = replace(
        CONTROLLER,
        output_values=lambda t, x, u, p: np.array([2.0, 2.0, 2.0, 1.0, 1.0]) * CONTROLLER.output_values(t, x, u, p),
    )
    other = pythonfmu_backend.build_pythonfmu(changed, tmp_path / "other")
    run(
        """
host, other = open_fmu("RobotController"), Host(A.other, library=Importer)
assert host.initialize() == other.initialize() == OK
kept = host.save()
status, state = host.from_bytes(state_of(other))
assert status >= ERROR or host.restore(state) >= ERROR
assert host.restore(kept) == host.step(0.0, 0.001) == OK
""",
        other=other,
    )


# The class itself, in this process


@pytest.fixture(params=[PLANT, CONTROLLER, TRAJECTORY], ids=lambda m: m.name, scope="module")
def slave_class(request, tmp_path_factory):
    """The class as an FMU defines it, with its resources; no archive, no binary."""
    model = request.param
    traced = trace(model)
    interface = interface_of(traced)
    sources = pythonfmu_backend._modules(traced, interface)
    modules = {}
    for name in ("equations", "interface"):
        modules[name] = types.ModuleType(name)
        exec(sources[f"{name}.py"], vars(modules[name]))
    modules["interface"].FINGERPRINT = "f"
    if model.solver == "rk43":
        modules["internal_steps"] = internal_steps
    folder = tmp_path_factory.mktemp("resources")
    (folder / "start_values.txt").write_bytes(start_values_text(interface))
    cls = type(model.name, (pythonfmu_slave.Fmi2Slave,), modules)
    return model, lambda: cls(instance_name="x", resources=str(folder), logger=0, visible=False)


def test_slave_runs_without_a_binary(slave_class):
    model, make = slave_class
    slave = make()
    slave.setup_experiment(0.0, None, None)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    assert slave.do_step(0.0, 1e-3) is True
    n = len(slave.interface.NAMES)
    outputs = slave.get_real(list(range(n)))[-len(model.outputs) :]
    close([outputs], oracle(model, 1))
    assert slave._get_log_queue() == []


def test_slave_raises_one_readable_error(slave_class):
    """The binary logs repr(error); no chain, no second line, no bare percent sign."""
    _, make = slave_class
    slave = make()
    slave.setup_experiment(0.0, None, None)
    slave.enter_initialization_mode()
    with pytest.raises(pythonfmu_slave.SlaveError) as caught:
        slave.get_real([-1])
    assert "no variable has the value reference -1" in repr(caught.value)
    assert caught.value.__cause__ is None
    assert caught.value.__suppress_context__
    assert repr(pythonfmu_slave.SlaveError("100%")) == "100%%"


def test_log_messages_are_escaped_and_carry_a_status_and_a_category(slave_class):
    _, make = slave_class
    slave = make()
    slave._log("50% of %s")
    message = slave._get_log_queue()[0]
    assert message.msg == "50%% of %%s"
    assert message.status == 3
    assert message.category == "logStatusError"


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, MemoryError, RecursionError, ZeroDivisionError])
def test_whatever_the_equations_raise_a_step_returns_false(slave_class, error, monkeypatch):
    """Ctrl-C in a Python host arrives inside the FMU's code; an exception there would become fmi2Fatal."""
    _, make = slave_class
    slave = make()
    slave.setup_experiment(0.0, None, None)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    before = slave._get_fmu_state()

    def raising(*arguments):
        raise error

    with monkeypatch.context() as patch:
        for name in ("step", "step_margins"):
            patch.setattr(slave.equations, name, raising)
        assert slave.do_step(0.0, 1e-3) is False
    assert error.__name__ in slave._get_log_queue()[0].msg
    assert json.dumps(slave._get_fmu_state() | {"phase": "STEP"}) == json.dumps(before)
    slave._set_fmu_state(before)
    assert slave.do_step(0.0, 1e-3) is True


def test_get_real_returns_a_list_of_floats_for_every_kind_of_request(slave_class):
    """The binary reads nothing but a list."""
    _, make = slave_class
    slave = make()
    slave.setup_experiment(0.0, None, None)
    slave.enter_initialization_mode()
    n = len(slave.interface.NAMES)
    for references in ([], [0], [n - 1], [0, 1], [0, 0], list(range(n))):
        for _ in range(2):  # the second time through the cache
            values = slave.get_real(references)
            assert type(values) is list
            assert len(values) == len(references)
            assert all(type(v) is float for v in values)


def test_restoring_a_state_copies_it(slave_class):
    """The state belongs to the importer: running on must not change it."""
    _, make = slave_class
    slave = make()
    slave.setup_experiment(0.0, None, None)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    state = slave._get_fmu_state()
    kept = json.dumps(state)
    for _ in range(2):
        slave._set_fmu_state(state)
        slave.set_real(
            [slave.interface.N_PARAMETERS] * bool(slave.interface.N_INPUTS),
            [0.3] * bool(slave.interface.N_INPUTS),
        )
        slave.do_step(0.0, 1e-3)
        slave.get_real([0])
        assert json.dumps(state) == kept


def test_state_survives_bytes(slave_class):
    _, make = slave_class
    slave = make()
    slave.setup_experiment(0.0, None, None)
    slave.enter_initialization_mode()
    slave.exit_initialization_mode()
    slave.do_step(0.0, 1e-3)
    state = slave._get_fmu_state()
    assert type(slave)._fmu_state_from_bytes(type(slave)._fmu_state_to_bytes(state)) == state or any(
        isinstance(v, float) and math.isnan(v) for v in state["values"]
    )


@pytest.mark.parametrize("data", RUBBISH, ids=lambda d: repr(d[:12]))
def test_reading_rubbish_never_raises(slave_class, data):
    """A raise there is not guarded: the binary would drop references that are not its own."""
    _, make = slave_class
    slave = make()
    state = type(slave)._fmu_state_from_bytes(data)
    assert isinstance(state, dict)
    with pytest.raises(pythonfmu_slave.SlaveError, match="damaged or belongs to another FMU"):
        slave._set_fmu_state(state)
