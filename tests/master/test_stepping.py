"""Runs that are stepped by hand: the same numbers as a run in one go, values read and set between two steps."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest

from cosim import SetupError, Simulation, SimulationError, SimulationInterrupted, System
from cosim.master import chunks, sampling
from parallel_robot.scenario import load_scenario
from tests.support.fmi3_gain import HELD
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.tiny_models import FRAGILE, FRAGILE_MESSAGE, GAIN, INTEGRATOR, build

STEP = 0.1


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("stepping"), GAIN, INTEGRATOR, FRAGILE)


@pytest.fixture(scope="module")
def robot(robot_fmus: Path):
    system = load_scenario("tracking").system(robot_fmus, DEFAULT_FLAVOUR)
    with Simulation(system) as simulation:
        yield simulation


def same(found, expected) -> None:
    assert found.names == expected.names
    assert found.time.tobytes() == expected.time.tobytes()
    assert found.values.tobytes() == expected.values.tobytes()


@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize("record_every", [1, 3])
def test_it_gives_the_numbers_of_a_run_in_one_go(robot_fmus: Path, order: str, record_every: int) -> None:
    system = load_scenario("tracking").system(robot_fmus, DEFAULT_FLAVOUR)
    with Simulation(system, order=order) as simulation:
        expected = simulation.run(4.5, 1e-3, record_every=record_every)
        with simulation.start(step_size=1e-3, record_every=record_every) as run:
            for n in (1, 2, 7, 90, 900, 3000):
                run.step(n)
            run.advance_to(4.5)
            assert run.time == 4.5
            same(run.results, expected)
            assert run.results.info["status"] == "running"
        same(run.results, expected)
        assert run.results.info["status"] == "completed"
        same(simulation.run(4.5, 1e-3, record_every=record_every), expected)


def test_values_are_those_of_the_communication_point(robot: Simulation) -> None:
    expected = robot.run(0.05, 1e-3)
    with robot.start(step_size=1e-3) as run:
        for i in range(51):
            assert run.time == expected.time[i]
            assert run["plant.x_E"] == expected["plant.x_E"][i]
            assert run["plant.theta_a"].tolist() == expected["plant.theta_a"][i].tolist()
            assert run["controller.tau_a[2]"] == expected["controller.tau_a"][i, 1]
            if i < 50:
                run.step()


def test_a_controller_in_plain_python_closes_the_loop(tiny: Path) -> None:
    """X' = u, u = -2 x held over the step: x is multiplied by 1 - 2 h each step."""
    system = System()
    system.add("i", tiny / "Integrator.fmu", start={"u": 0.0, "x_start": 1.0})
    with Simulation(system) as simulation, simulation.start(step_size=STEP) as run:
        for n in range(30):
            assert run["i.x"] == pytest.approx((1.0 - 2.0 * STEP) ** n, rel=1e-12)
            run["i.u"] = -2.0 * run["i.x"]
            assert run["i.u"] == -2.0 * run["i.x"]
            run.step()
    recorded = run.results["i.u"]
    assert recorded[:-1] == pytest.approx(-2.0 * run.results["i.x"][:-1], rel=1e-15)


def test_what_is_set_reaches_outputs_with_direct_feedthrough_at_once(tiny: Path) -> None:
    system = System()
    system.add("a", tiny / "Gain.fmu", start={"u": 1.0})
    system.add("b", tiny / "Gain.fmu")
    system.connect("a.y", "b.u")
    with Simulation(system) as simulation, simulation.start(step_size=STEP) as run:
        gain = run["a.y[1]"]
        run["a.u[1]"] = 3.0
        assert run["a.y[1]"] == gain * 3.0
        assert run["b.y[1]"] == gain**2 * 3.0
        run.step()
    assert run.results["b.y[1]"].tolist() == [gain**2 * 3.0] * 2


def test_in_parallel_order_it_reaches_others_one_step_later(tiny: Path) -> None:
    system = System()
    system.add("a", tiny / "Gain.fmu", start={"u": 1.0})
    system.add("b", tiny / "Gain.fmu")
    system.connect("a.y", "b.u")
    with Simulation(system, order="parallel") as simulation, simulation.start(step_size=STEP) as run:
        run.step(3)
        gain = run["a.y[1]"]
        run["a.u[1]"] = 3.0
        assert run["a.y[1]"] == 3.0 * gain
        assert run["b.y[1]"] == gain**2
        run.step()  # here b is given what a now has, and b's output is that of before
        assert run["b.y[1]"] == gain**2
        run.step()
        assert run["b.y[1]"] == 3.0 * gain**2


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("plant.tau_a", [0, 0, 0], "'plant.tau_a' can't be set during a run: a connection or a signal feeds it"),
        ("plant.m_a", 1.0, "it is a fixed parameter; FMI allows inputs and tunable parameters only"),
        ("plant.x_E", 1.0, "it is a continuous output; FMI allows"),
        ("plant.x_F", 1.0, "did you mean"),
        ("plnt.x_E", 1.0, "there is no component 'plnt'"),
        ("x_E", 1.0, "must be written as component.variable"),
    ],
)
def test_what_can_not_be_set_is_refused(robot: Simulation, name: str, value: object, message: str) -> None:
    with robot.start(step_size=1e-3) as run, pytest.raises(SetupError) as error:
        run[name] = value
    assert message in str(error.value)


@pytest.mark.parametrize("value", [float("nan"), "fast", [1.0, 2.0, 3.0, 4.0], True, None])
def test_a_value_that_does_not_fit_is_refused_and_the_run_goes_on(tiny: Path, value: object) -> None:
    system = System()
    system.add("i", tiny / "Integrator.fmu", start={"u": 1.0})
    with Simulation(system) as simulation, simulation.start(step_size=STEP) as run:
        with pytest.raises(SetupError, match=r"'i\.u'"):
            run["i.u"] = value
        run.step()
        assert run["i.x"] == pytest.approx(STEP, rel=1e-12)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda run: run.step(0), "positive whole number"),
        (lambda run: run.step(1.5), "positive whole number"),
        (lambda run: run.step(True), "positive whole number"),
        (lambda run: run.step(4), "beyond the stop time 0.3 s"),
        (lambda run: run.advance_to(0.15), r"around it are at 0.1 s and 0.2 s"),
        (lambda run: run.advance_to(-0.1), "restore a saved state to go back"),
        (lambda run: run.advance_to(float("nan")), "must be a finite time"),
        (lambda run: run.advance_to("0.1"), "must be a finite time"),
        (lambda run: run.advance_to(0.4), r"advance_to\(0.4\): lies beyond the stop time 0.3 s"),
        (lambda run: run.restore(None), r"restore\(NoneType\): give a RunState"),
        (lambda run: run[3], "3 is not the name of a variable"),
    ],
)
def test_steps_that_make_no_sense_are_refused(tiny: Path, act, message: str) -> None:
    system = System()
    system.add("i", tiny / "Integrator.fmu", start={"u": 1.0})
    with Simulation(system) as simulation, simulation.start(step_size=STEP, stop_time=3 * STEP) as run:
        with pytest.raises(SetupError, match=message):
            act(run)
        run.advance_to(3 * STEP)
        run.advance_to(run.time)


def test_a_time_just_before_this_point_by_rounding_is_this_point(tiny: Path) -> None:
    system = System()
    system.add("a", tiny / "Gain.fmu", start={"u": 1.0})
    with Simulation(system) as simulation, simulation.start(step_size=0.1) as run:
        run.step(3)
        assert run.time > 0.3
        run.advance_to(0.3)
        assert run.time == 3 * 0.1


def test_an_element_of_an_array_is_set_and_the_others_stay(gain3c: Path) -> None:
    system = System()
    system.add("c", gain3c, start=HELD)
    with Simulation(system) as simulation, simulation.start(step_size=STEP) as run:
        run["c.u[2]"] = 20.0
        assert run["c.u"].tolist() == [1.0, 20.0, 100.0]
        assert run["c.y"].tolist() == [2.0, 40.0, 200.0]  # what the FMU makes of the inputs that it has


def test_what_is_neither_exchanged_nor_recorded_is_read_from_the_fmu(tiny: Path) -> None:
    system = System()
    system.add("a", tiny / "Gain.fmu", start={"u": [3.0, 5.0], "K": 4.0})
    with Simulation(system, record=["a.y[2]"]) as simulation, simulation.start(step_size=STEP) as run:
        assert (run["a.K"], run["a.u[2]"], run["a.y[2]"]) == (4.0, 5.0, 20.0)
        assert run["a.u"].tolist() == [3.0, 5.0]
        assert run["a.y"].tolist() == [12.0, 20.0]
        run["a.u[1]"] = -1.0
        assert run["a.u"].tolist() == [-1.0, 5.0]
        assert run["a.y"].tolist() == [-4.0, 20.0]


def test_whole_numbers_may_be_those_of_numpy(tiny: Path) -> None:
    def recorded(whole: type) -> list[float]:
        system = System()
        system.add("i", tiny / "Integrator.fmu", start={"u": 1.0}, every=whole(2))
        with (
            Simulation(system, threads=whole(1)) as simulation,
            simulation.start(step_size=STEP, record_every=whole(2)) as run,
        ):
            run.step(whole(4))
            assert json.dumps(run.results.info)
            times: list[float] = run.results.time.tolist()
            return times + run.results["i.x"].tolist()

    assert recorded(np.int64) == recorded(int) == pytest.approx([0.0, 2 * STEP, 4 * STEP, 0.0, 2 * STEP, 4 * STEP])


def test_a_time_may_be_rounded_by_a_millionth_for_each_step(tiny: Path) -> None:
    system = System()
    system.add("a", tiny / "Gain.fmu", start={"u": 1.0})
    with Simulation(system) as simulation, simulation.start(step_size=1 / 3) as run:
        run.advance_to(np.float32(33.33333))
        assert run.time == pytest.approx(100 / 3, rel=1e-15)
        with pytest.raises(SetupError, match="no communication point"):
            run.advance_to(66.666)


def test_a_run_that_has_ended_or_goes_on_elsewhere_is_refused(tiny: Path) -> None:
    system = System()
    system.add("i", tiny / "Integrator.fmu", start={"u": 1.0})
    with Simulation(system) as simulation:
        with simulation.start(step_size=STEP) as run:
            run.step(5)
            with pytest.raises(SetupError, match="is being stepped"):
                simulation.run(1.0, STEP)
        for act in (run.step, lambda: run.__setitem__("i.u", 1.0)):
            with pytest.raises(SetupError, match="the run has ended"):
                act()
        assert len(run.results.time) == 6
        assert len(simulation.run(1.0, STEP).time) == 11
    with pytest.raises(SetupError, match="not open"), simulation.start(step_size=STEP):
        pass


def test_an_fmu_that_fails_ends_it_with_what_was_recorded(tiny: Path) -> None:
    system = System()
    system.add("f", tiny / "Fragile.fmu", start={"u": 1.0})
    with Simulation(system) as simulation:
        with simulation.start(step_size=STEP) as run:
            run.step(2)
            run["f.u"] = -1.0
            with pytest.raises(SimulationError, match=FRAGILE_MESSAGE) as error:
                run.step(3)
            assert error.value.results is not None
            assert error.value.results.time.tolist() == [0.0, STEP, 2 * STEP]
            with pytest.raises(SetupError, match="has ended"):
                run.step()
        assert len(simulation.run(0.5, STEP).time) == 6


def test_a_signal_that_fails_ends_it_where_it_fails_and_not_before(tiny: Path) -> None:
    """Signals are sampled ahead of the step."""
    system = System()
    system.add("i", tiny / "Integrator.fmu")
    system.drive("i.u", lambda t: 1.0 / (t < 0.55))
    with Simulation(system) as simulation, simulation.start(step_size=STEP) as run:
        run.advance_to(0.5)
        assert run["i.x"] == pytest.approx(0.5, rel=1e-12)
        with pytest.raises(
            SimulationError, match=r"t = 0.6 s: the signal that feeds 'i.u' failed: ZeroDivisionError"
        ) as e:
            run.step(3)
    assert e.value.results is not None
    assert e.value.results.time == pytest.approx(np.arange(6) * STEP)


def test_a_step_longer_than_what_is_sampled_at_once(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    system = System()
    system.add("i", tiny / "Integrator.fmu")
    system.drive("i.u", np.cos, vectorized=True)
    with Simulation(system) as simulation:
        expected = simulation.run(50.0, STEP)
        monkeypatch.setattr(sampling, "_MOST_SAMPLES", 20)
        monkeypatch.setattr(chunks, "MOST", 64)
        with simulation.start(step_size=STEP) as run:
            run.step(500)
        same(run.results, expected)


def test_ctrl_c_ends_a_long_step(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    system = System()
    system.add("i", tiny / "Integrator.fmu")

    def signal_of(t: float) -> float:
        if t > 20.0 and not run_ended:
            run_ended.append(True)
            signal.raise_signal(signal.SIGINT)
        return 1.0

    run_ended: list[bool] = []
    system.drive("i.u", signal_of)
    monkeypatch.setattr(chunks, "MOST", 64)
    with Simulation(system) as simulation:
        with pytest.raises(SimulationInterrupted) as error, simulation.start(step_size=STEP) as run:
            run.step(10**8)
        assert 0 < len(error.value.results.time) < 10_000
        assert len(simulation.run(0.5, STEP).time) == 6
