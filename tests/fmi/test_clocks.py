"""Clocks of FMI 3.0 in co-simulation: when they tick, what is exchanged then, and events on the way.

The FMU refuses whatever the standard forbids in a mode, so each run tests the order of calls, too.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Checkpoint, RunState, SetupError, Simulation, SimulationError, System, simulate
from cosim.__main__ import main
from cosim.results.results import Results
from tests.support import some
from tests.support.fmi3_events import clocks

H = 0.125
TIMES = np.arange(17) * H


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clocks(tmp_path_factory.mktemp("clocks"))


def one(fmu: Path, **start: Any) -> System:
    system = System()
    system.add("c", fmu, start=start)
    return system


def ticks(results: Results, name: str) -> list[float]:
    """Times (s) of the points at which a clock was recorded as ticking."""
    return results.time[results.typed[name].numbers.astype(bool)].tolist()


def on(*times: float):
    """A signal that ticks at some times (s)."""
    return lambda t: t in times


def test_clocks_of_all_kinds_tick_when_their_fmu_says(fmu):
    results = simulate(one(fmu, delay=0.25, period=0.375), 2.0, H)
    # the second tick of the periodic clock, at 0.375 s, starts the countdown
    expected = {
        "periodic": [0.125 + 0.25 * i for i in range(8)],
        "countdown": [0.625],
        "changing": [0.25, 0.75, 1.5],
        "fixed": [0.375 * i for i in range(6)],
        "tunable": [0.0, 0.5, 1.0, 1.5, 2.0],
        "trigger": [],
    }
    for name, times in expected.items():
        assert ticks(results, f"c.{name}") == times, name
        counted = [sum(other <= t for other in times) for t in TIMES]
        assert results[f"c.n_{name}"].tolist() == counted, name
    assert results.info["fmus"]["c"]["event_mode"] is True
    assert "events_between_points" not in results.info
    assert results.typed["c.periodic"].type == "bool"


def test_the_fmu_is_valid(fmu, capsys):
    assert main(["validate", str(fmu)]) == 0
    assert capsys.readouterr().out == f"{fmu}: ok\n"


def test_the_fmu_is_told_the_interval_that_its_description_gives(fmu):
    results = simulate(one(fmu), 0.25, H, record=["c.told"])
    assert results["c.told"].all()


def test_intervals_are_fractions_where_the_fmu_has_them(tmp_path):
    fixed = ('intervalVariability="fixed"', 'intervalVariability="fixed" supportsFraction="true"')
    results = simulate(one(clocks(tmp_path, fixed), period=0.375), 2.0, H)
    assert ticks(results, "c.fixed") == [0.125 + 0.375 * i for i in range(6)]
    fraction = 'supportsFraction="true" resolution="8" intervalCounter="3" shiftCounter="0"'
    told = ('intervalVariability="tunable"', f'intervalVariability="tunable" {fraction}')
    results = simulate(one(clocks(tmp_path, told)), 2.0, H, record=["c.tunable", "c.told"])
    assert ticks(results, "c.tunable") == [0.375 * i for i in range(6)]
    assert results["c.told"].all()


def test_a_new_tunable_interval_begins_at_the_event_that_changed_it(tmp_path):
    system = one(clocks(tmp_path, (' intervalDecimal="0.5"', "")))
    system.drive("c.gain", lambda t: 1.0 if t < 1.0 else 3.0)
    results = simulate(system, 3.0, H)
    assert ticks(results, "c.tunable") == [0.0, 0.25, 0.5, 0.75, 1.0, 1.75, 2.5]


@pytest.mark.parametrize("alarm", [0.5, 0.3])
def test_the_time_of_the_next_event_is_kept(fmu, alarm):
    results = simulate(one(fmu, alarm=alarm, period=4.0), 1.0, H)
    assert results["c.changes"].tolist() == np.where(alarm <= results.time, 100, 0).tolist()
    assert ("events_between_points" in results.info) == (alarm == 0.3)


def test_a_clock_without_a_usable_interval_is_named(fmu):
    with pytest.raises(SimulationError, match="c failed at t = 0 s: clock 'fixed' has no usable interval: 0 s"):
        simulate(one(fmu, period=0.0), 1.0, H)


@pytest.mark.usefixtures("no_figures")
def test_the_interval_of_a_clock_can_be_given(fmu, tmp_path, monkeypatch, capsys):
    results = simulate(one(fmu, period=0.0, fixed=0.375, tunable=0.25), 2.0, H)
    assert ticks(results, "c.fixed") == [0.375 * i for i in range(6)]
    assert ticks(results, "c.tunable") == [0.25 * i for i in range(9)]
    message = r"clock 'fixed' has no usable interval: .*; give it one: System\.add\(.*'fixed': 0\.1.*--set fixed=0\.1$"
    with pytest.raises(SimulationError, match=message):
        simulate(one(fmu, period=0.0), 1.0, H)
    for wrong in (0.0, -1.0, "often", math.inf, [0.1, 0.2]):
        with pytest.raises(SetupError, match=r"value of 'c\.fixed': .* is not an interval of a clock; give a positive"):
            simulate(one(fmu, fixed=wrong), 1.0, H)
    for name in ("periodic", "changing", "countdown"):
        with pytest.raises(SetupError, match=rf"'c\.{name}': clocks have none"):
            simulate(one(fmu, **{name: 0.25}), 1.0, H)
    with (
        Simulation(one(fmu)) as simulation,
        pytest.raises(SetupError, match=r"'c\.fixed': a simulation keeps the intervals of clocks; give it in S"),
    ):
        simulation.run(1.0, H, start={"c.fixed": 0.25})
    command = ["run", str(fmu), "--stop", "2", "--step", str(H), "--set", "period=0", "--out", str(tmp_path / "o")]
    assert main([*command, "--set", "fixed=0.5"]) == 0, capsys.readouterr().err
    assert ticks(Results.read(tmp_path / "o" / "results.csv"), f"{fmu.stem}.fixed") == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert f"note: nothing ticks these clocks, which need a connection or a signal: {fmu.stem}.trigger" in (
        capsys.readouterr().out
    )


def test_clocks_that_nothing_ticks_are_named(fmu):
    system = one(fmu)
    info = simulate(system, 0.25, H).info
    assert (info["clocks_without_source"], "c.trigger" in info["inputs_kept"]) == (["c.trigger"], False)
    system.drive("c.trigger", on(0.0))
    assert "clocks_without_source" not in simulate(system, 0.25, H).info


def test_a_triggered_clock_ticks_where_its_signal_is_true_and_takes_values_then(fmu):
    system = one(fmu)
    system.drive("c.trigger", on(0.0, 0.5, 0.625))
    system.drive("c.u", lambda t: 10.0 + t)
    results = simulate(system, 2.0, H)
    assert ticks(results, "c.trigger") == [0.0, 0.5, 0.625]
    sums = np.cumsum([10.0 + t if t in (0.0, 0.5, 0.625) else 0.0 for t in TIMES])
    assert results["c.sum"].tolist() == sums.tolist()


def test_a_clocked_output_keeps_the_value_of_its_last_tick(fmu):
    results = simulate(one(fmu), 2.0, H)
    sampled = [max((0.125 + 0.25 * i for i in range(8) if 0.125 + 0.25 * i <= t), default=0.0) for t in TIMES]
    assert results["c.sample"].tolist() == sampled


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_an_output_clock_triggers_another_fmu_at_the_same_point(fmu, order):
    system = one(fmu)
    system.add("d", fmu)
    system.connect("c.out", "d.trigger")
    system.connect("c.x", "d.u")
    results = simulate(system, 2.0, H, order=order)
    assert len(ticks(results, "c.out")) > 3
    assert ticks(results, "d.trigger") == ticks(results, "c.out")
    assert results["d.n_trigger"].tolist() == results["c.n_out"].tolist()
    sums = np.cumsum(np.where(np.isin(TIMES, ticks(results, "c.out")), results["c.x"], 0.0))
    assert results["d.sum"].tolist() == sums.tolist()


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_chain_of_clocks_ticks_at_one_point(fmu, order):
    """A tick of the first trigger makes three in all, so that its output clock ticks, too, and so on."""
    system = System()
    for name in "abc":
        system.add(name, fmu)
    system.drive("a.trigger", on(0.0))
    system.connect("a.out", "b.trigger")
    system.connect("b.out", "c.trigger")
    results = simulate(system, 0.0625, 0.0625, order=order)
    for name in "abc":  # with `fixed` and `tunable`
        assert results[f"{name}.total"][0] == 3
        assert ticks(results, f"{name}.out") == [0.0]


def test_ticks_between_points_are_handled_with_inputs_held(fmu):
    system = one(fmu, delay=0.3)
    system.drive("c.level", lambda t: t)
    results = simulate(system, 2.0, H)
    assert ticks(results, "c.countdown") == [0.75]  # at 0.675 s
    assert results["c.n_countdown"].tolist() == (TIMES >= 0.675).tolist()
    assert results["c.x"].tolist() == TIMES.tolist()
    assert results.info["events_between_points"] == {"c": 1}


def test_values_are_the_same_however_long_the_communication_step_is(fmu):
    """With nothing fed, a long step has all events of the short ones."""
    short, long = (simulate(one(fmu, delay=0.3, jump_at=0.9), 2.0, h) for h in (H, 0.5))
    for name in ("n_periodic", "n_changing", "n_fixed", "n_out", "total", "sample"):
        assert long[f"c.{name}"].tolist() == short[f"c.{name}"][::4].tolist(), name
    np.testing.assert_allclose(long["c.x"], short["c.x"][::4], rtol=1e-14)
    assert long.info["events_between_points"]["c"] > short.info["events_between_points"]["c"]


@pytest.mark.parametrize("jump_at", [0.5, 0.3])
def test_an_event_of_the_fmu_is_handled_where_it_happens(fmu, jump_at):
    results = simulate(one(fmu, jump_at=jump_at), 2.0, H)
    np.testing.assert_allclose(results["c.x"], np.where(jump_at > TIMES, TIMES, TIMES - jump_at), rtol=1e-14)


def test_ticks_of_output_clocks_between_points_reach_others_at_the_next(fmu):
    system = one(
        fmu, delay=0.3
    )  # total: 11 after 0.625 s without a trigger, or so; the countdown may make it a multiple
    system.add("d", fmu)
    system.connect("c.out", "d.trigger")
    results = simulate(system, 2.0, 0.5)
    times = np.array(ticks(results, "c.out"))
    assert ticks(results, "d.trigger") == times.tolist()
    assert set(times) <= {0.0, 0.5, 1.0, 1.5, 2.0}
    assert len(times) > 2


def test_an_fmu_with_steps_of_one_length_says_so_where_a_tick_lies_between_points(tmp_path):
    fixed = clocks(tmp_path, ('canHandleVariableCommunicationStepSize="true"', ""))
    simulate(one(fixed), 2.0, H)
    with pytest.raises(
        SimulationError, match=r"event at t = 0\.675 s, between .*choose a communication step"
    ) as caught:
        simulate(one(fixed, delay=0.3), 2.0, H)
    assert caught.value.component == "c"
    assert len(caught.value.results.time) == 6


def test_discrete_inputs_and_tunable_parameters_change_in_event_mode(fmu):
    system = one(fmu)
    system.drive("c.level", lambda t: np.floor(2.0 * t))
    system.drive("c.gain", lambda t: 1.0 if t < 1.0 else 3.0, breakpoints=[1.0])
    results = simulate(system, 2.0, H)
    assert results["c.changes"].tolist() == np.floor(2.0 * TIMES).tolist()
    np.testing.assert_allclose(results["c.x"], np.where(TIMES <= 1.0, TIMES, 3.0 * TIMES - 2.0), rtol=1e-14)


def test_where_nothing_happens_the_event_mode_is_not_entered(fmu):
    results = simulate(one(fmu, period=4.0), 0.1, 0.005, record=["c.iterations"])
    assert set(results["c.iterations"]) == {1}  # that after the initialisation, with the ticks at 0 s


def test_an_fmu_ends_the_simulation_at_an_event(fmu):
    results = simulate(one(fmu, end_at=0.5), 2.0, H)
    assert results.info["ended_by"] == {"component": "c", "time": 0.5}
    assert results.time[-1] == 0.5


def test_discrete_states_without_an_end_are_an_error(fmu):
    with pytest.raises(SimulationError, match=r"c failed at t = 0 s: its discrete states still need an update"):
        simulate(one(fmu, endless=1.0), 2.0, H)


def everything(fmu: Path) -> System:
    system = one(fmu, delay=0.3, jump_at=0.9)
    system.add("d", fmu, start={"delay": 0.31})
    system.connect("c.out", "d.trigger")
    system.connect("c.x", "d.u")
    system.drive("c.trigger", on(0.25, 1.0))
    system.drive("c.level", lambda t: float(t > 1.1))
    system.drive("d.gain", lambda t: 1.0 + t)
    return system


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_runs_steps_and_restored_runs_are_equal(fmu, tmp_path, order):
    with Simulation(everything(fmu), order=order) as simulation:
        expected = simulation.run(2.0, H)
        assert (simulation.run(2.0, H).values == expected.values).all()
        with simulation.start(H, stop_time=2.0) as run:
            run.step(5)
            run.save().write(tmp_path / "run.state")
            run.step(11)
        assert (run.results.values == expected.values).all()
        with simulation.start(H, stop_time=2.0) as run:
            run.restore(RunState.read(tmp_path / "run.state"))
            run.step(11)
            assert (run.results.values == expected.values).all()
            run.restore(RunState.read(tmp_path / "run.state"))
            run.step(11)
        assert (run.results.values == expected.values).all()
        checkpointed = simulation.run(2.0, H, checkpoint=Checkpoint(tmp_path / "checkpoints", every=0.5))
    assert (checkpointed.values == expected.values).all()


def test_by_hand_inputs_and_parameters_are_set_in_event_mode(fmu):
    system = one(fmu)
    with Simulation(system) as simulation, simulation.start(H) as run:
        run.step(2)
        run["c.level"] = 4.0
        assert run["c.changes"] == 1
        run["c.gain"] = 0.0
        run.step(2)
        assert run["c.x"] == 0.25
        assert run["c.periodic"] is False
        run.step()
        assert run["c.periodic"] is True
        for name in ("trigger", "u"):
            with pytest.raises(SetupError, match=f"'c.{name}' can't be set during a run: clocks"):
                run[f"c.{name}"] = 1


def test_a_function_is_called_with_what_holds_after_the_event(fmu):
    system = one(fmu)
    system.add_function("twice", lambda t, n: 2.0 * n, inputs={"n": int}, outputs=["y"])
    system.drive("c.level", lambda t: np.floor(2.0 * t))
    system.connect("c.changes", "twice.n")
    results = simulate(system, 2.0, H)
    assert results["twice.y"].tolist() == (2.0 * np.floor(2.0 * TIMES)).tolist()


def test_fmus_without_clocks_beside_are_as_without(fmu, gain3c):
    def gain(system: System) -> System:
        system.add("g", gain3c, start={"u": [1.0, 2.0, 3.0]})
        system.drive("g.v", np.sin)
        return system

    alone, beside = (simulate(gain(system), 2.0, H) for system in (System(), one(fmu)))
    assert (beside["g.x"] == alone["g.x"]).all()
    assert "event_mode" not in beside.info["fmus"]["g"]


WRONG = [
    (lambda s: s.drive("c.periodic", on(1.0)), r"ticks at times of its FMU \(constant\); only triggered clocks"),
    (lambda s: s.connect("d.out", "c.level"), "clock and real don't match"),
    (lambda s: s.connect("slow.out", "c.trigger"), "every 2 and every 1 steps; give both one `every`"),
    (lambda s: s.add("e", s.components["c"].fmu, start={"trigger": True}), "'e.trigger': clocks have none"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_what_clocks_cannot_is_refused(fmu, change, message):
    system = one(fmu)
    system.add("d", fmu)
    system.add("slow", fmu, every=2)
    change(system)
    with pytest.raises(SetupError, match=message):
        simulate(system, 1.0, H)


def test_components_that_take_part_now_and_then_have_their_ticks(fmu):
    system = System()
    system.add("c", fmu, every=4)
    results = simulate(system, 2.0, H)
    expected = simulate(one(fmu), 2.0, 4 * H)
    for name in some(["n_periodic", "n_changing", "total", "sample"]):
        assert results[f"c.{name}"][::4].tolist() == expected[f"c.{name}"].tolist()


def test_clocks_without_event_mode_are_neither_fed_nor_recorded(tmp_path):
    system = one(clocks(tmp_path, (' hasEventMode="true"', "")))
    system.drive("c.trigger", on(1.0))
    with pytest.raises(SetupError, match=r"event mode only, which its FMU lacks \(hasEventMode\)"):
        simulate(system, 1.0, H)
    names = Simulation(one(system.components["c"].fmu)).names
    assert "c.total" in names
    assert not {"c.periodic", "c.trigger", "c.out"} & set(names)
