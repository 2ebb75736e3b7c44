"""FMUs of FMI 1.0, alone and coupled with those of 2.0 and 3.0, by a small one in C."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from cosim import Results, SetupError, Simulation, SimulationError, System, simulate
from tests.support.fmi1_fmu import DESCRIPTION, build_fmi1_tank
from tests.support.tiny_models import GAIN, INTEGRATOR, build


@pytest.fixture(scope="module")
def tank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_fmi1_tank(tmp_path_factory.mktemp("fmi1") / "tank.fmu")


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("others"), GAIN, INTEGRATOR)


#: Start values of the inputs that a test does not feed.
HELD = {"u": 0.0, "direct": 0.0, "n": 0, "b": False, "mode": 1}


def held(*fed: str, **values: object) -> dict[str, object]:
    return {name: value for name, value in (HELD | values).items() if name not in fed}


def alone(tank: Path, **values: object) -> System:
    system = System()
    system.add("tank", tank, start=held(**values))
    return system


def final(results: Results, name: str) -> object:
    return results[f"tank.{name}"][-1]


def test_values_of_all_types_pass(tank: Path) -> None:
    system = alone(tank, u=2.0, direct=0.25, n=-(2**31), b=True, mode="on", text="four", x_start=1.0)
    results = simulate(system, 2.0, 0.5)
    np.testing.assert_array_equal(results["tank.y"], 1.25 + 2.0 * results.time)
    names = ("n_out", "b_out", "mode_out", "length", "u_at_start")
    assert [final(results, name) for name in names] == [-(2**31), True, 2, 4, 2.0]


def test_the_result_is_that_of_fmpy(tank: Path, tmp_path: Path) -> None:
    complete = build_fmi1_tank(tmp_path / "complete.fmu", DESCRIPTION, "COMPLETE")
    time = np.arange(0.0, 2.125, 0.125)
    u = np.where(time < 0.75, 1.5, -1.0)
    inputs = np.array(list(zip(time, u, strict=True)), dtype=[("time", float), ("u", float)])
    expected = simulate_fmu(
        str(complete), stop_time=2.0, output_interval=0.125, step_size=0.125, input=inputs, output=["y", "u_at_start"]
    )
    system = System()
    system.add("tank", tank, start=held("u"))
    system.drive("tank.u", lambda t: 1.5 if t < 0.75 else -1.0)
    results = simulate(system, 2.0, 0.125)
    np.testing.assert_array_equal(results["tank.y"], expected["y"])
    np.testing.assert_array_equal(results["tank.u_at_start"], expected["u_at_start"])
    assert expected["u_at_start"][-1] == 1.5


def test_every_run_is_a_first_run(tank: Path) -> None:
    with Simulation(alone(tank, u=1.0)) as simulation:
        first = simulation.run(2.0, 0.5)
        for _ in range(2):
            np.testing.assert_array_equal(simulation.run(2.0, 0.5).values, first.values)
        assert final(simulation.run(2.0, 0.5, start={"tank.x_start": 3.0}), "y") == 5.0


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_it_is_coupled_with_fmi_2_in_both_directions(tank: Path, others: Path, order: str) -> None:
    """A loop, x' = K x, with a gain of FMI 2.0, stepped by explicit Euler."""
    system = System()
    system.add("tank", tank, start=held("u", x_start=2.0))
    system.add("gain", others / "Gain.fmu", start={"K": -0.5, "u[2]": 0.0})
    system.connect("tank.y", "gain.u[1]", units="ignore")
    system.connect("gain.y[1]", "tank.u")
    results = simulate(system, 2.0, 0.125, order=order)
    y = [2.0]
    u = [-1.0]
    for _ in range(16):
        y.append(y[-1] + 0.125 * u[-1])
        u.append(-0.5 * y[-1 if order == "sequential" else -2])
    np.testing.assert_allclose(results["tank.y"], y, rtol=1e-15)


def test_connected_inputs_are_there_when_it_is_initialised(tank: Path, others: Path) -> None:
    """By way of other components of FMI 1.0 and 2.0, in whichever order they were added."""
    system = System()
    system.add("last", tank, start=held("u"))
    system.add("between", others / "Gain.fmu", start={"K": 3.0, "u[2]": 0.0})
    system.add("first", tank, start=held("direct", x_start=1.0))
    system.drive("first.direct", lambda t: 4.0 + t)
    system.connect("first.y", "between.u[1]", units="ignore")
    system.connect("between.y[1]", "last.u")
    results = simulate(system, 1.0, 0.5)
    assert results["last.u_at_start"].tolist() == [15.0] * 3


def test_values_of_other_types_pass_between_fmus_of_fmi_1(tank: Path) -> None:
    system = System()
    system.add("second", tank, start=held("n", "b", "mode"))
    system.add("first", tank, start=held(n=7, b=True, mode=2))
    for name in ("n", "b", "mode"):
        system.connect(f"first.{name}_out", f"second.{name}")
    results = simulate(system, 1.0, 0.5)
    assert [results[f"second.{name}_out"].tolist() for name in ("n", "b", "mode")] == [[7] * 3, [True] * 3, [2] * 3]


def test_inputs_are_extrapolated_where_it_interpolates_them(tmp_path: Path) -> None:
    """The integral of a ramp is exact then."""
    able = DESCRIPTION.replace("<Capabilities ", '<Capabilities canInterpolateInputs="true" ')
    system = System()
    system.add("tank", build_fmi1_tank(tmp_path / "tank.fmu", able), start=held("u", x_start=0.0))
    system.drive("tank.u", lambda t: 2.0 * t)
    results = simulate(system, 2.0, 0.125)
    np.testing.assert_array_equal(results["tank.y"], results.time**2)


def test_it_is_told_when_the_run_ends(tank: Path) -> None:
    """None where the run has no end."""
    assert final(simulate(alone(tank), 2.0, 0.5), "stop") == 2.0
    with Simulation(alone(tank)) as simulation, simulation.start(0.5) as run:
        assert run["tank.stop"] == -1.0


def test_a_failure_says_what_the_fmu_says(tank: Path) -> None:
    message = r"^tank failed at t = 1\.5 s: fmiDoStep returned error: the level is too high, at 1\.5 s$"
    with pytest.raises(SimulationError, match=message):
        simulate(alone(tank, u=60.0, x_start=0.0), 4.0, 0.5)
    with pytest.raises(SimulationError, match=r"fmiInitializeSlave returned error: a level of -1 is too low$"):
        simulate(alone(tank, x_start=-1.0), 1.0, 0.5)


def test_an_fmu_that_refuses_to_be_made_says_why(tmp_path: Path) -> None:
    fmu = build_fmi1_tank(tmp_path / "tank.fmu", DESCRIPTION.replace("{fmi1-tank}", "{other}"))
    with pytest.raises(SetupError, match=r"can't be instantiated: wrong identity \{other\}$"):
        simulate(alone(fmu), 1.0, 0.5)


def test_a_negated_alias_is_no_variable_to_read(tank: Path) -> None:
    """Its value is the negative of what the FMU gives, which FMPy does not know."""
    results = simulate(alone(tank), 1.0, 0.5)
    assert "tank.minus_u" not in results.names
    with pytest.raises(SetupError, match=r"'tank\.minus_u' is of type negated alias and can't be recorded"):
        simulate(alone(tank), 1.0, 0.5, record=["tank.minus_u"])


def test_dependencies_are_those_of_its_description(tank: Path) -> None:
    """`y` depends on `direct`, but not on `u`."""
    system = System()
    system.add("tank", tank, start=held("u"))
    system.connect("tank.y", "tank.u")
    results = simulate(system, 1.0, 0.5)
    np.testing.assert_array_equal(results["tank.y"], [0.5, 0.75, 1.125])
    system = System()
    system.add("tank", tank, start=held("direct"))
    system.connect("tank.y", "tank.direct")
    with pytest.raises(SetupError, match="algebraic loop"):
        simulate(system, 1.0, 0.5)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("CoSimulation_StandAlone", "CoSimulation_Tool", "is a connection to a tool, which would have to run beside"),
        ("Implementation>", "VendorAnnotations>", "has no co-simulation interface"),
    ],
)
def test_what_is_not_for_co_simulation_alone_is_refused(tmp_path: Path, before: str, after: str, message: str) -> None:
    fmu = build_fmi1_tank(tmp_path / "tank.fmu", DESCRIPTION.replace(before, after))
    with pytest.raises(SetupError, match=message):
        simulate(alone(fmu), 1.0, 0.5)


def test_its_state_cannot_be_saved(tank: Path) -> None:
    with Simulation(alone(tank)) as simulation, simulation.start(0.5) as run:
        run.step()
        with pytest.raises(SetupError, match="can't save its state"):
            run.save()
