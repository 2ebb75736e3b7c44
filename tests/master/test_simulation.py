"""Many runs of one `Simulation`: each is what a first run would be, and nothing piles up."""

from __future__ import annotations

import gc
import math
import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import cosim.fmi.isolation.library
import cosim.master.loaded_components
from cosim import (
    Results,
    SetupError,
    Signal,
    Simulation,
    SimulationError,
    SimulationInterrupted,
    System,
    simulate,
)
from cosim.fmi.instance import CallFailed, Instance
from tests.support.fmi3_gain import HELD
from tests.support.small_fmus import FLAVOURS, build, compiled
from tests.support.tiny_models import GAIN, INTEGRATOR, ROOT

RUNS, STOP, STEP = 1000, 1.0, 0.02

#: Pages and files are counted in /proc.
requires_proc = pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="no /proc to count memory and files in"
)


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulation")
    for flavour in FLAVOURS:
        build(folder / flavour, flavour, GAIN, INTEGRATOR, ROOT)
    return folder


@pytest.fixture(scope="module")
def opened(fmus: Path) -> Iterator[tuple[Simulation, Results]]:
    """`study` ready to run, and what its first run gives."""
    with Simulation(study(fmus / "fmi2")) as simulation:
        yield simulation, run(simulation)


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("probe"), "fmi2_probe")


@pytest.fixture
def temporary(plain_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A fresh folder for temporary files, which must be empty again after the test."""
    folder = plain_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def study(folder: Path) -> System:
    """An integrator and a gain, x' = K x / T; beside them the root of a signal, which must not get negative."""
    system = System()
    system.add("i", folder / "Integrator.fmu", start={"x_start": 0.4, "T": 0.7})
    system.add("g", folder / "Gain.fmu", start={"K": -1.3})
    system.add("root", folder / "Root.fmu")
    system.connect("i.x", "g.u[1]")
    system.connect("root.y", "g.u[2]")
    system.connect("g.y[1]", "i.u")
    system.drive("root.u", lambda t: 1.5 + math.sin(3.0 * t))
    return system


#: A signal for `study` that is negative, and so fails, from t = 0.5 s on.
FAILS = Signal("root.u", lambda t: 0.49 - t)


def run(simulation: Simulation, **options: object) -> Results:
    return simulation.run(STOP, STEP, **options)


def assert_equal(a: Results, b: Results) -> None:
    assert a.names == b.names
    assert a.time.tobytes() == b.time.tobytes()
    assert a.values.tobytes() == b.values.tobytes()


# Every run is a first run


@pytest.mark.parametrize("coupling", ["auto", "hold"])
@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize("flavour", FLAVOURS)
def test_every_run_is_what_a_first_run_is(fmus: Path, temporary: Path, flavour: str, order: str, coupling: str) -> None:
    system = study(fmus / flavour)
    first = simulate(system, STOP, STEP, order=order, extrapolation=coupling)
    with pytest.raises(SimulationError) as failed_first:
        simulate(study_that_fails(fmus / flavour), STOP, STEP, order=order, extrapolation=coupling)
    with Simulation(system, order=order, extrapolation=coupling) as simulation:
        assert_equal(run(simulation), first)
        assert_equal(run(simulation), first)

        other = run(simulation, start={"g.K": 1.7, "i.x_start": -3.0})
        assert other.values.tobytes() != first.values.tobytes()
        assert_equal(run(simulation), first)

        assert_equal(
            simulation.run(2.5, 0.1, start_time=1.0),
            simulate(system, 2.5, 0.1, start_time=1.0, order=order, extrapolation=coupling),
        )
        assert_equal(run(simulation), first)

        with pytest.raises(SimulationError, match="root failed") as failed:
            run(simulation, signals=[FAILS])
        assert_equal(failed.value.results, failed_first.value.results)
        assert str(failed.value) == str(failed_first.value)
        assert_equal(run(simulation), first)


def study_that_fails(folder: Path) -> System:
    system = study(folder)
    system.signals = [FAILS]
    return system


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_run_after_an_interrupted_one_is_a_first_run(fmus: Path, temporary: Path, flavour: str) -> None:
    def interrupts(t: float) -> float:
        if t == 0.5:
            signal.raise_signal(signal.SIGINT)
        return 1.0

    system = study(fmus / flavour)
    first = simulate(system, STOP, STEP)
    with Simulation(system) as simulation:
        with pytest.raises(SimulationInterrupted):
            run(simulation, signals=[Signal("root.u", interrupts)])
        assert_equal(run(simulation), first)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_run_after_an_error_of_the_caller_is_a_first_run(fmus: Path, temporary: Path, flavour: str) -> None:
    def progress(t: float) -> None:
        if t > 0.0:
            raise LookupError("of the caller")

    system = study(fmus / flavour)
    first = simulate(system, STOP, STEP)
    with Simulation(system) as simulation:
        with pytest.raises(LookupError, match="of the caller"):
            run(simulation, progress=progress)
        assert_equal(run(simulation), first)


def test_results_of_a_run_are_left_alone_by_later_runs(fmus: Path) -> None:
    with Simulation(study(fmus / "fmi2")) as simulation:
        first = run(simulation)
        kept = first.values.copy(), dict(first.info)
        run(simulation, start={"g.K": 2.0})
    assert (first.values == kept[0]).all()
    assert first.info == kept[1]


def test_info_is_that_of_each_run(fmus: Path) -> None:
    with Simulation(study(fmus / "fmi2")) as simulation:
        a, b = run(simulation), simulation.run(0.5, 0.05, start={"g.K": 2.0})
    assert (a.info["step_size"], a.info["stop_time"], a.info["parameters"]["g.K"]) == (STEP, STOP, -1.3)
    assert (b.info["step_size"], b.info["stop_time"], b.info["parameters"]["g.K"]) == (0.05, 0.5, 2.0)


# FMUs that can't be reset


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_fmus_whose_reset_fails_are_made_anew(
    fmus: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch, flavour: str
) -> None:
    system = study(fmus / flavour)
    first = simulate(system, STOP, STEP)
    freed: list[str] = []

    def reset(self: Instance) -> None:
        if self.name == "i":
            raise CallFailed(f"fmi{self.version}Reset returned error")
        whole(self)

    def close(self: Instance) -> None:
        freed.append(self.name)
        closed(self)

    whole, closed = Instance.reset, Instance.close
    monkeypatch.setattr(Instance, "reset", reset)
    monkeypatch.setattr(Instance, "close", close)
    with Simulation(system) as simulation:
        for _ in range(3):
            assert_equal(run(simulation), first)
        with pytest.raises(SimulationError):
            run(simulation, signals=[FAILS])
        assert_equal(run(simulation), first)
        others = ["root"] if flavour == "pythonfmu" else []  # a fatal error, its only one, leaves nothing to reset
        assert sorted(freed) == ["i"] * 4 + others
    assert sorted(freed) == ["g", *["i"] * 5, "root", *others]


def test_an_fmu_without_reset_is_made_anew_and_terminated_each_time(gain3c: Path, tmp_path: Path) -> None:
    """FMI 3.0; its fmi3Reset returns an error."""
    start = {**HELD, "v": 2.0}
    system = System()
    system.add("c", gain3c, start={**start, "journal": str(tmp_path / "journal")})
    with Simulation(system) as simulation:
        runs = [run(simulation) for _ in range(3)]
    assert runs[0]["c.x"] == pytest.approx(2.0 * runs[0].time, rel=1e-12)
    assert_equal(runs[1], runs[0])
    assert_equal(runs[2], runs[0])
    assert (tmp_path / "journal").read_text().split() == ["initialize", "terminate", "free"] * 3


def test_after_a_fatal_error_the_instance_is_left_and_made_anew(
    probe: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = System()
    system.add("p", probe, start={"n": 0, "e": 1, "b": False})
    system.drive("p.u", lambda t: t)
    calls: list[str] = []

    def call(self: Instance, function: str, *arguments: object) -> None:
        calls.append(function)
        original_call(self, function, *arguments)

    def free(self: Instance) -> None:
        calls.append("fmi2FreeInstance")
        original_free(self)

    original_call, original_free = Instance.call, Instance.free
    with Simulation(system) as simulation:
        first = run(simulation)
        monkeypatch.setattr(Instance, "call", call)
        monkeypatch.setattr(Instance, "free", free)
        with pytest.raises(SimulationError, match=r"p failed at t = 0\.5 s: fmi2DoStep returned fatal$"):
            run(simulation, start={"p.fail_at": 0.5, "p.status": 4})
        # the instance of the first run; its FMU does not say that a reset is complete
        assert calls.count("fmi2FreeInstance") == 1
        calls.clear()
        assert_equal(run(simulation), first)
        # both standards forbid any call after a fatal error, also these two
        assert not {"fmi2Reset", "fmi2FreeInstance"} & set(calls)
        assert_equal(run(simulation), first)
        assert calls.count("fmi2FreeInstance") == 1
    assert calls.count("fmi2FreeInstance") == 2
    assert "fmi2Reset" not in calls


def test_an_instance_that_cannot_be_made_anew_closes_the_simulation_and_is_freed_once(
    fmus: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    freed: list[object] = []

    def free(self: Instance) -> None:
        if self not in freed:  # a second time would crash
            original_free(self)
        freed.append(self)

    def reset(self: Instance) -> None:
        raise CallFailed("fmi2Reset returned error")

    original_free = Instance.free
    monkeypatch.setattr(Instance, "free", free)
    monkeypatch.setattr(Instance, "reset", reset)
    simulation = Simulation(study(fmus / "fmi2"))
    with simulation:
        first = run(simulation)
        with monkeypatch.context() as patch:
            patch.setattr(cosim.master.loaded_components, "Instance", no_instance)
            with pytest.raises(SetupError, match=r"component 'i': .*Integrator\.fmu .*no licence left"):
                run(simulation)
        assert len(freed) == len(set(map(id, freed))) == 3
        with pytest.raises(SetupError, match="the simulation is not open"):
            run(simulation)
    assert len(freed) == 3
    with simulation:
        assert_equal(run(simulation), first)


def no_instance(*_: object) -> Instance:
    raise CallFailed("can't be instantiated: no licence left")


def test_a_simulation_that_could_not_be_opened_can_be_opened_later(
    fmus: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation = Simulation(study(fmus / "fmi2"))
    with monkeypatch.context() as patch:
        patch.setattr(cosim.master.loaded_components, "Instance", no_instance)
        with pytest.raises(SetupError, match="no licence left"):
            simulation.__enter__()
    assert list(temporary.iterdir()) == []
    with simulation:
        assert_equal(run(simulation), simulate(study(fmus / "fmi2"), STOP, STEP))


# What is refused


def test_a_run_outside_with_is_one_clear_error(fmus: Path, temporary: Path) -> None:
    simulation = Simulation(study(fmus / "fmi2"))
    message = r"^the simulation is not open; use it in a with statement$"
    with pytest.raises(SetupError, match=message):
        run(simulation)
    with simulation:
        first = run(simulation)
    with pytest.raises(SetupError, match=message):
        run(simulation)
    with simulation:  # open again
        assert_equal(run(simulation), first)
    simulation.close()  # harmless where nothing is open


def test_a_simulation_that_is_open_cannot_be_opened_again(fmus: Path, temporary: Path) -> None:
    with Simulation(study(fmus / "fmi2")) as simulation:
        first = run(simulation)
        with pytest.raises(SetupError, match="the simulation is open already"):
            simulation.__enter__()
        assert_equal(run(simulation), first)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"g.L": 1.0}, r"component 'g' has no variable 'L'; .*known are .*K"),
        ({"G.K": 1.0}, r"'G\.K': there is no component 'G'; known are i, g, root"),
        ({"K": 1.0}, r"'K' must be written as component\.variable"),
        ({"i.u": 1.0}, r"start value of 'i\.u' would have no effect: a connection or a signal feeds it"),
        ({"root.u": 1.0}, r"start value of 'root\.u' would have no effect: a connection or a signal feeds it"),
        ({"g.u": [1.0, 2.0]}, r"start value of 'g\.u' would have no effect"),
        ({"g.K": math.nan}, r"start value of 'g\.K': nan is not a finite number"),
        ({"g.K": math.inf}, r"start value of 'g\.K': inf is not a finite number"),
        ({"g.K": 10.5}, r"start value of 'g\.K': 10\.5 is out of bounds; it must be between -10\.0 and 10\.0"),
        ({"g.K": [1.0, 2.0]}, r"start value of 'g\.K': 2 values were given for 1"),
        ({"g.K": "two"}, r"start value of 'g\.K': 'two' is not a number or a list of numbers"),
        ({"g.y": 1.0}, r"start value of 'g\.y': output variables can't be set"),
    ],
)
def test_start_values_of_a_run_are_checked_before_it(
    opened: tuple[Simulation, Results], start: dict[str, object], message: str
) -> None:
    simulation, first = opened
    with pytest.raises(SetupError, match=message) as refused:
        run(simulation, start=start)
    assert "\n" not in str(refused.value)
    assert_equal(run(simulation), first)


def test_booleans_and_enumerations_take_their_words(probe: Path) -> None:
    system = System()
    system.add("p", probe, start={"u": "0.5", "n": "3", "e": "off", "b": "false"})
    with Simulation(system) as simulation:

        def outputs(**start: object) -> list[float]:
            results = simulation.run(0.1, 0.1, start={f"p.{name}": value for name, value in start.items()})
            return [results[f"p.{name}"][-1] for name in ("y", "n_out", "e_out", "b_out")]

        assert outputs() == [0.5, 3.0, 1.0, 0.0]
        assert outputs(e="on", b="true") == outputs(e=2, b=True) == outputs(e="2", b="1") == [0.5, 3.0, 2.0, 1.0]
        for start, message in (
            ({"e": "om"}, r"start value of 'p\.e': 'om' is not a value of type Enumeration; did you mean 'on'\?"),
            ({"b": "yes"}, r"'yes' is not a value of type Boolean; known are false, true"),
            ({"n": "3.5"}, r"3\.5 is not a value of type Integer"),
            ({"u": "true"}, r"'true' is not a number or a list of numbers"),
            ({"journal": 3.0}, r"3\.0 is not a value of type String"),
        ):
            with pytest.raises(SetupError, match=message):
                outputs(**start)


def test_start_values_of_a_run_go_before_those_of_the_system_and_hold_for_it_alone(fmus: Path) -> None:
    system = study(fmus / "fmi2")
    with Simulation(system) as simulation:
        first = run(simulation)
        other = run(simulation, start={"g.K": 0.5})
        assert_equal(run(simulation), first)
    system.components["g"].start["K"] = 0.5
    assert_equal(other, simulate(system, STOP, STEP))


def test_start_values_of_vectors_and_of_elements_go_before_those_of_the_system(gain3c: Path) -> None:
    """FMI 3.0, where elements of arrays are set in the initialisation mode, after whole arrays."""
    elements, whole = {"u[1]": 1.0, "u[2]": 5.0, "u[3]": 3.0}, {"u": [1.0, 5.0, 3.0]}
    for given in (elements, whole):
        system = System()
        system.add("c", gain3c, start={**HELD, **given} if given is whole else {**_without("u"), **given})
        with Simulation(system) as simulation:
            for start, expected in (
                ({"c.u": [7.0, 8.0, 9.0]}, [7.0, 8.0, 9.0]),
                ({"c.u[2]": 8.0}, [1.0, 8.0, 3.0]),
                ({"c.u": 7.0, "c.u[1]": 6.0}, [6.0, 7.0, 7.0]),
                ({}, [1.0, 5.0, 3.0]),
            ):
                assert run(simulation, start=start)["c.u"][-1].tolist() == expected, (given, start)


def _without(name: str) -> dict[str, object]:
    return {k: v for k, v in HELD.items() if k != name}


def test_signals_of_a_run_replace_those_of_the_system_for_it_alone(fmus: Path) -> None:
    system = study(fmus / "fmi2")
    with Simulation(system) as simulation:
        first = run(simulation)
        replaced = run(simulation, signals=[Signal("root.u", lambda t: 4.0 + 0.0 * t, vectorized=True)])
        assert (replaced["root.u"] == 4.0).all()
        assert (replaced["root.y"] == 2.0).all()
        assert_equal(run(simulation), first)
        same_function = run(simulation, signals=system.signals)
        assert_equal(same_function, first)


def test_breakpoints_of_a_run_come_with_its_signal(fmus: Path) -> None:
    system = System()
    system.add("i", fmus / "fmi2" / "Integrator.fmu")
    system.drive("i.u", lambda t: float(t >= 0.5))
    with Simulation(system) as simulation:
        across = simulation.run(1.0, 0.125)["i.x"][-1]
        declared = simulation.run(1.0, 0.125, signals=[Signal("i.u", lambda t: float(t >= 0.5), (0.5,))])["i.x"][-1]
    assert across == pytest.approx(0.5 + 0.125 / 2, rel=1e-12)  # a line from 0 to 1 over the step before the jump
    assert declared == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("target", ["root.v", "i.u", "g.u", "nobody.u"])
def test_signals_of_a_run_need_one_of_the_system_that_feeds_the_same_target(
    opened: tuple[Simulation, Results], target: str
) -> None:
    simulation, first = opened
    with pytest.raises(SetupError, match=rf"signals: no signal of the system feeds '{target}'; .*root\.u"):
        run(simulation, signals=[Signal(target, lambda t: t)])
    assert_equal(run(simulation), first)


def test_a_signal_of_a_run_that_fails_at_the_start_is_an_error_of_the_set_up(
    opened: tuple[Simulation, Results],
) -> None:
    simulation, first = opened
    message = r"signal that feeds 'root\.u' gives \[nan\].*\(at t = 0\.0 s\)"
    with pytest.raises(SetupError, match=message):
        run(simulation, signals=[Signal("root.u", lambda t: math.nan)])
    assert_equal(run(simulation), first)


def test_later_changes_of_the_systems_signals_do_not_reach_an_open_simulation(fmus: Path) -> None:
    system = study(fmus / "fmi2")
    with Simulation(system) as simulation:
        first = run(simulation)
        system.signals.clear()
        assert_equal(run(simulation), first)


# Nothing piles up


@requires_proc
@pytest.mark.parametrize("flavour", ["fmi2", "fmi3", pytest.param("pythonfmu", marks=pytest.mark.slow)])
def test_memory_and_files_do_not_grow_over_1000_runs(fmus: Path, temporary: Path, flavour: str) -> None:
    def resident() -> int:
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    def opened() -> int:
        return len(os.listdir("/proc/self/fd"))  # noqa: PTH208

    with Simulation(study(fmus / flavour)) as simulation:
        columns = len(run(simulation).names)
        for i in range(RUNS):
            if i == RUNS // 2:
                memory, files = resident(), opened()
            if i % 10 == 9:  # failures come by with their results
                with pytest.raises(SimulationError):
                    run(simulation, signals=[FAILS])
            else:
                run(simulation, start={"g.K": -1.0 - 1e-3 * i})
        # 512 B a run: less than a quarter of the results of one run; what does grow is Python's own allocator, by a few
        # pages
        assert 8 * columns * (round(STOP / STEP) + 1) > 4 * 512
        assert resident() - memory < 512 * RUNS // 2
        assert opened() <= files
        assert len(list(temporary.iterdir())) == 3  # three FMU files, unpacked once


@requires_proc
def test_files_and_libraries_do_not_grow_where_fmus_are_made_anew(
    fmus: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def reset(self: Instance) -> None:
        raise CallFailed("fmi2Reset returned error")

    def counted() -> tuple[int, int]:
        gc.collect()
        maps = Path("/proc/self/maps").read_text()
        return len(os.listdir("/proc/self/fd")), maps.count(str(temporary))  # noqa: PTH208

    monkeypatch.setattr(Instance, "reset", reset)
    with Simulation(study(fmus / "fmi2")) as simulation:
        run(simulation)
        before, folders = counted(), len(list(temporary.iterdir()))
        assert before[1] > 0
        for _ in range(50):
            run(simulation)
        assert counted() == before
    assert counted() == (before[0] - folders, 0)  # each folder is held open


def test_a_file_is_unpacked_once_however_many_components_it_has(fmus: Path, temporary: Path) -> None:
    system = System()
    for name in "abc":
        system.add(name, fmus / "fmi2" / "Integrator.fmu", start={"u": 1.0})
    with Simulation(system) as simulation:
        run(simulation)
        assert len(list(temporary.iterdir())) == 1


def test_signals_are_asked_again_only_where_they_or_the_points_are_others(fmus: Path) -> None:
    asked: list[float] = []

    def signal(t: float) -> float:
        asked.append(t)
        return 1.0 + t

    system = study(fmus / "fmi2")
    system.signals = [Signal("root.u", signal)]
    with Simulation(system, extrapolation="linear") as simulation:
        run(simulation)
        assert len(asked) == 52  # once at the start, to see whether it works, and at 51 points
        run(simulation)
        assert len(asked) == 53
        simulation.run(STOP / 2, STEP)
        assert len(asked) == 53 + 27


# Several at once


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_two_simulations_on_the_same_files_do_not_disturb_each_other(fmus: Path, temporary: Path, flavour: str) -> None:
    starts = [{"g.K": -1.0}, {"g.K": 2.0}]
    alone = []
    for start in starts:
        with Simulation(study(fmus / flavour)) as simulation:
            alone.append(run(simulation, start=start))
    assert alone[0].values.tobytes() != alone[1].values.tobytes()
    with Simulation(study(fmus / flavour)) as a, Simulation(study(fmus / flavour)) as b:
        for _ in range(3):
            assert_equal(run(a, start=starts[0]), alone[0])
            assert_equal(run(b, start=starts[1]), alone[1])
        b.close()
        assert_equal(run(a, start=starts[0]), alone[0])


def test_a_run_inside_a_run_of_another_simulation(fmus: Path, temporary: Path) -> None:
    system = study(fmus / "fmi2")
    first = simulate(system, STOP, STEP)
    with Simulation(system) as outer, Simulation(system) as inner:

        def sink(_time: np.ndarray, values: np.ndarray) -> None:
            assert_equal(run(inner), first)
            rows.extend(values.copy())

        rows: list[np.ndarray] = []
        run(outer, sink=sink)
    assert (np.array(rows) == first.values).all()


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_two_threads_run_a_simulation_each(fmus: Path, temporary: Path, flavour: str) -> None:
    starts = [{"g.K": -1.0}, {"g.K": 2.0}]
    expected, found, errors = [], [[], []], []

    def work(which: int, simulation: Simulation) -> None:
        try:
            together.wait(30)
            for _ in range(20):
                found[which].append(run(simulation, start=starts[which]))
        except BaseException as error:
            errors.append(error)

    together = threading.Barrier(2)
    with Simulation(study(fmus / flavour)) as a, Simulation(study(fmus / flavour)) as b:
        expected = [run(a, start=starts[0]), run(b, start=starts[1])]
        threads = [threading.Thread(target=work, args=(k, s)) for k, s in enumerate((a, b))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60)
            assert not thread.is_alive()
    assert errors == []
    for which in (0, 1):
        assert len(found[which]) == 20
        for results in found[which]:
            assert_equal(results, expected[which])


@pytest.mark.parametrize(
    ("start", "stop"),
    [
        (2.0**53 - 4.0, 2.0**53 + 8.0),  # the numbers around the stop time are 2 apart, around the start time 1
        (-(2.0**53) - 8.0, 4.0 - 2.0**53),  # and the other way round
    ],
)
def test_a_step_that_either_end_can_not_tell_apart_is_refused(fmus: Path, start: float, stop: float) -> None:
    system = System()
    system.add("i", fmus / "fmi2" / "Integrator.fmu", start={"u": 1.0})
    with Simulation(system) as simulation, pytest.raises(SetupError, match=r"a step of 0\.75 s is too short"):
        simulation.run(stop, 0.75, start_time=start)


@pytest.mark.parametrize(
    ("threads", "n_cores", "shared"), [(1, 3, False), (1, 2, True), (2, 2, False), (2, 1, True), ("auto", 2, False)]
)
def test_processes_share_a_core_where_more_take_turns_than_there_are_cores(
    fmus: Path, monkeypatch: pytest.MonkeyPatch, threads: int | str, n_cores: int, shared: bool
) -> None:
    """One thread and two FMUs; where there are more threads, one waits for each FMU."""
    monkeypatch.setattr(cosim.fmi.isolation.library, "cores", lambda: n_cores)
    system = System()
    for name in "ij":
        system.add(name, fmus / "fmi2" / "Integrator.fmu")
    with Simulation(system, isolate=True, threads=threads) as simulation:
        instances = simulation._components.instances
        assert [instances[name].shares_core for name in "ij"] == [shared, shared]
