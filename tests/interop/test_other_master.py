"""The FMUs in a co-simulation master that is not ours and not fmpy: libcosim (through libcosimpy)."""

import numpy as np
import pytest

from cosim import System, simulate
from tests.support.bare_host import fresh

STEP = 1e-3
N_STEPS = 2000
RECORDED = {
    "plant": ["x_E", "y_E", *(f"theta_a[{i}]" for i in (1, 2, 3))],
    "controller": ["psi[1]", "psi[2]", *(f"tau_a[{i}]" for i in (1, 2, 3))],
    "trajectory": ["x_ref", "y_ref"],
}
CONNECTIONS = [
    *((f"plant.{v}_a", f"controller.{v}_a") for v in ("theta", "omega")),
    *((f"trajectory.{v}_ref", f"controller.{v}_ref") for v in ("theta", "omega", "tau")),
    ("controller.tau_a", "plant.tau_a"),
]

#: libcosim's default algorithm at a fixed step. Names come from the model descriptions, as libcosim itself reads them.
SCRIPT = """
from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

log_output_level(CosimLogLevel.WARNING)
execution = CosimExecution.from_step_size(step_size=round(A.step * 1e9))
slaves, references, keep = {}, {}, []
for name, fmu in A.fmus.items():
    slave = CosimLocalSlave(fmu_path=fmu, instance_name=name)
    keep.append(slave)
    slaves[name] = execution.add_local_slave(local_slave=slave)
    for v in execution.slave_variables(slave_index=slaves[name]):
        references[name, v.name.decode()] = v.reference


def connect(source, target):
    (a, va), (b, vb) = source.split("."), target.split(".")
    status = execution.connect_real_variables(
        output_slave_index=slaves[a],
        output_variable_reference=references[a, va],
        input_slave_index=slaves[b],
        input_variable_reference=references[b, vb],
    )
    assert status == 0


for source, target in A.connections:
    for i in (1, 2, 3):
        connect(f"{source}[{i}]", f"{target}[{i}]")

observer = CosimObserver.create_time_series(buffer_size=A.n + 1)
assert execution.add_observer(observer=observer)
for name, variables in A.recorded.items():
    for variable in variables:
        assert observer.start_time_series(
            slave_index=slaves[name], value_reference=references[name, variable], variable_type=CosimVariableType.REAL
        )
assert execution.step(step_count=A.n)
assert execution.status().current_time == round(A.n * A.step * 1e9)
result = {}
for name, variables in A.recorded.items():
    for variable in variables:
        times, steps, values = observer.time_series_real_samples(
            slave_index=slaves[name], value_reference=references[name, variable], from_step=1, sample_count=A.n
        )
        assert list(steps) == list(range(1, A.n + 1))
        result[f"{name}.{variable}"] = list(values)
result["time"] = [t * 1e-9 for t in times]
report(result)
"""


@pytest.fixture(scope="module")
def other(fmus, tmp_path_factory):
    """What libcosim records at the communication points after the start."""
    paths = {"plant": "RobotPlant", "controller": "RobotController", "trajectory": "RobotTrajectory"}
    result = fresh(
        tmp_path_factory.mktemp("libcosim"),
        SCRIPT,
        fmus={name: str(fmus / f"{fmu}.fmu") for name, fmu in paths.items()},
        connections=CONNECTIONS,
        recorded=RECORDED,
        step=STEP,
        n=N_STEPS,
    )
    return {name: np.array(values) for name, values in result.items()}


@pytest.fixture(scope="module")
def ours(fmus):
    """Results of our own master, by order of exchange and step."""
    runs = {}

    def run(order, step=STEP):
        if (order, step) not in runs:
            system = System()
            system.add("plant", fmus / "RobotPlant.fmu", start={"tau_d": [0.0, 0.0, 0.0], "dm": 0.0})
            system.add("controller", fmus / "RobotController.fmu")
            system.add("trajectory", fmus / "RobotTrajectory.fmu")
            for source, target in CONNECTIONS:
                system.connect(source, target)
            runs[order, step] = simulate(
                system, stop_time=N_STEPS * STEP, step_size=step, order=order, extrapolation="hold"
            )
        return runs[order, step]

    return run


def test_libcosim_runs_the_loop_and_the_robot_moves(other):
    np.testing.assert_allclose(other["time"], STEP * np.arange(1, N_STEPS + 1), rtol=0, atol=1e-9)
    for name, values in other.items():
        assert values.shape == (N_STEPS,)
        assert np.all(np.isfinite(values)), name
    assert np.ptp(other["plant.x_E"]) > 0.02
    error = np.hypot(other["plant.x_E"] - other["trajectory.x_ref"], other["plant.y_E"] - other["trajectory.y_ref"])
    assert error[-1] < error[0]


@pytest.mark.parametrize("name", [f"{c}.{v}" for c, variables in RECORDED.items() for v in variables])
def test_the_parallel_order_is_that_of_libcosim(other, ours, name):
    """Both read all outputs, then set all inputs; only the rounding of the times differs (integer nanoseconds)."""
    expected = ours("parallel")[name][1:]
    np.testing.assert_allclose(other[name], expected, rtol=0, atol=1e-12 * max(1.0, np.max(np.abs(expected))))


def test_the_sequential_order_differs_by_one_step_of_delay(other, ours):
    """First-order coupling: the masters differ by a delay of one step in the torque.

    So the end effector may differ by no more than a few times the difference that halving the step makes to the
    parallel order itself (which is half of its first-order error), and must differ by more than rounding.
    """
    for name in ("plant.x_E", "plant.y_E"):
        difference = np.max(np.abs(other[name] - ours("sequential")[name][1:]))
        halving = np.max(np.abs(ours("parallel")[name][1:] - ours("parallel", STEP / 2)[name][2::2]))
        assert 1e-9 < difference < 3 * halving
