"""Checkpoints: a run that ended early goes on, and comes to the same bits as one that nothing has stopped."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim.master.pacing
from cosim import Checkpoint, Results, SetupError, Signal, Simulation, SimulationError, SimulationInterrupted, System
from cosim.master import checkpoint as module
from cosim.master import chunks
from cosim.master.state import RunState
from parallel_robot.scenario import load_scenario
from tests.support.clock import Clock
from tests.support.descriptions import without_capability
from tests.support.small_fmus import compiled
from tests.support.tiny_models import INTEGRATOR
from tests.support.tiny_models import build as build_tiny

STEP = 1e-3


class Stopped(Exception):
    """A run is left in the middle, as good as killed: nothing is written after it."""


def stop_at(time: float) -> Callable[[float], None]:
    def progress(now: float) -> None:
        if now >= time:
            raise Stopped

    return progress


def bits(results: Results) -> tuple[bytes, bytes]:
    return results.time.tobytes(), results.values.tobytes()


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_tiny(tmp_path_factory.mktemp("checkpoint"), INTEGRATOR) / "Integrator.fmu"


@pytest.fixture(scope="module")
def all_flavours(robot_fmus: Path, native_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The robot's FMUs in all three flavours."""
    folder = tmp_path_factory.mktemp("fmus")
    for flavour, source in (("fmi2", native_fmus), ("fmi3", native_fmus), ("pythonfmu", robot_fmus)):
        shutil.copytree(source / flavour, folder / flavour)
    return folder


def integrator(path: Path, function: Any = math.sin, every: int = 1) -> System:
    system = System()
    system.add("i", path, every=every)
    system.drive("i.u", function)
    return system


@pytest.mark.parametrize("flavour", ["fmi2", "fmi3", "pythonfmu"])
@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_run_that_was_stopped_twice_comes_to_the_same_bits(
    tmp_path: Path, all_flavours: Path, flavour: str, order: str
) -> None:
    stop, every, stops = (4.2, 0.05, (3.98, 4.01)) if flavour != "pythonfmu" else (0.06, 0.007, (0.02, 0.04))
    system = load_scenario("tracking").system(all_flavours, flavour)  # a signal sets in at 4 s
    with Simulation(system, order=order) as simulation:
        expected = simulation.run(stop, STEP)
        for resume, time in zip((False, True), stops, strict=True):
            with pytest.raises(Stopped):
                simulation.run(
                    stop, STEP, checkpoint=Checkpoint(tmp_path, every, resume=resume), progress=stop_at(time)
                )
            kept = RunState.read(tmp_path / "run.state").point * STEP
            assert time - every - 2 * STEP < kept <= stop
    with Simulation(system, order=order) as simulation:  # as in another process: all FMUs are instantiated anew
        found = simulation.run(stop, STEP, checkpoint=Checkpoint(tmp_path, resume=True))
    assert bits(found) == bits(expected)
    assert set(found.info) == set(expected.info)


@pytest.mark.parametrize("record_every", [1, 3])
@pytest.mark.parametrize("component_every", [1, 4])
@pytest.mark.parametrize("every", [0.01, 0.025, 0.07])
def test_any_interval_at_any_rate(
    tiny: Path, tmp_path: Path, record_every: int, component_every: int, every: float
) -> None:
    with Simulation(integrator(tiny, every=component_every)) as simulation:
        expected = simulation.run(0.7, 0.01, record_every=record_every)
        with pytest.raises(Stopped):
            simulation.run(
                0.7, 0.01, record_every=record_every, checkpoint=Checkpoint(tmp_path, every), progress=stop_at(0.4)
            )
        point = RunState.read(tmp_path / "run.state").point
        assert 0 < point < 70
        assert point - 1 < math.floor((point + 1e-6) * 0.01 / every) * every / 0.01 + 1e-6 <= point + 2e-6
        checkpoint = Checkpoint(tmp_path, every, resume=True)
        assert bits(simulation.run(0.7, 0.01, record_every=record_every, checkpoint=checkpoint)) == bits(expected)


def test_a_signal_that_comes_bit_by_bit_is_known_again(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a machine that has other work."""
    with Simulation(integrator(tiny)) as simulation:
        expected = simulation.run(0.7, 0.01)
        with pytest.raises(Stopped):
            simulation.run(0.7, 0.01, checkpoint=Checkpoint(tmp_path, 0.1), progress=stop_at(0.4))
        monkeypatch.setattr("cosim.master.sampling._LONGEST", 0.0)
        resumed = simulation.run(0.7, 0.01, checkpoint=Checkpoint(tmp_path, 0.1, resume=True))
    assert bits(resumed) == bits(expected)


def test_a_sink_gets_all_rows_once(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_VALUES", 100)
    chunks: list[tuple[np.ndarray, np.ndarray]] = []

    def sink(times: np.ndarray, values: np.ndarray) -> None:
        chunks.append((times.copy(), values.copy()))

    with Simulation(integrator(tiny)) as simulation:
        expected = simulation.run(2.0, 0.01)
        with pytest.raises(Stopped):
            simulation.run(2.0, 0.01, checkpoint=Checkpoint(tmp_path, 0.5), progress=stop_at(1.2), sink=sink)
        chunks.clear()
        nothing = simulation.run(2.0, 0.01, checkpoint=Checkpoint(tmp_path, resume=True), sink=sink)
    assert len(nothing.time) == 0
    times, values = (np.concatenate(parts) for parts in zip(*chunks, strict=True))
    assert (times.tobytes(), values.tobytes()) == bits(expected)
    assert len(chunks) > 2


def test_the_stop_time_may_be_another_one(tiny: Path, tmp_path: Path) -> None:
    with Simulation(integrator(tiny)) as simulation:
        expected = simulation.run(3.0, 0.01)
        with pytest.raises(Stopped):
            simulation.run(2.0, 0.01, checkpoint=Checkpoint(tmp_path, 0.5), progress=stop_at(1.9))
        with pytest.raises(SetupError, match="beyond the stop time"):
            simulation.run(1.0, 0.01, checkpoint=Checkpoint(tmp_path, resume=True))
        assert bits(simulation.run(3.0, 0.01, checkpoint=Checkpoint(tmp_path, resume=True))) == bits(expected)


def test_ctrl_c_writes_a_last_checkpoint(tiny: Path, tmp_path: Path) -> None:
    pressed: list[float] = []

    def interrupt(now: float) -> None:
        if now > 0.3 and not pressed:
            pressed.append(now)
            signal.raise_signal(signal.SIGINT)

    with Simulation(integrator(tiny)) as simulation:
        expected = simulation.run(50.0, 0.01)
        with pytest.raises(SimulationInterrupted) as stopped:
            simulation.run(50.0, 0.01, checkpoint=Checkpoint(tmp_path, 1000.0), progress=interrupt)
        rows = len(stopped.value.results.time)
        assert stopped.value.results.values.tobytes() == expected.values[:rows].tobytes()
        assert [stopped.value.results.time[-1]] == [stopped.value.time] == pressed
        assert RunState.read(tmp_path / "run.state").point * 0.01 == stopped.value.time
        assert bits(simulation.run(50.0, 0.01, checkpoint=Checkpoint(tmp_path, resume=True))) == bits(expected)


def test_a_failed_run_has_all_its_rows(tiny: Path, tmp_path: Path) -> None:
    def fails(time: float) -> float:
        if time > 1.0:
            raise ValueError("no more")
        return time

    with Simulation(integrator(tiny, fails)) as simulation:
        with pytest.raises(SimulationError) as expected:
            simulation.run(2.0, 0.01)
        with pytest.raises(SimulationError) as failed:
            simulation.run(2.0, 0.01, checkpoint=Checkpoint(tmp_path, 0.2))
    assert str(failed.value) == str(expected.value)
    assert isinstance(failed.value.results, Results)
    assert isinstance(expected.value.results, Results)
    assert bits(failed.value.results) == bits(expected.value.results)
    assert failed.value.results.info["status"] == "failed"


SCRIPT = """
import sys
from cosim import Checkpoint, Simulation, System
fmu, folder, resume, result = sys.argv[1:]
system = System()
system.add("i", fmu, start={"u": 1.0})
with Simulation(system) as simulation:
    results = simulation.run(40.0, 1e-3, checkpoint=Checkpoint(folder, 0.002, resume=resume == "resume"))
results.save(result)
"""


@pytest.mark.slow
def test_a_kill_at_any_moment_leaves_a_checkpoint_that_goes_on(tiny: Path, tmp_path: Path) -> None:
    """Checkpoints come so often that most of the time one is being written."""
    system = System()
    system.add("i", tiny, start={"u": 1.0})
    with Simulation(system) as simulation:
        expected = simulation.run(40.0, 1e-3)
    folder, known = tmp_path / "checkpoint", -1
    for i in range(4):
        command = [sys.executable, "-c", SCRIPT, tiny, folder, "resume" if i else "start", tmp_path / "end.npz"]
        process = subprocess.Popen(command)
        try:
            while process.poll() is None and _point(folder) < known + 20:
                pass
            os.kill(process.pid, signal.SIGKILL)
        finally:
            process.kill()
            assert process.wait() == -signal.SIGKILL
        known = _point(folder)
        assert known > 0
    with Simulation(system) as simulation:
        assert bits(simulation.run(40.0, 1e-3, checkpoint=Checkpoint(folder, 10.0, resume=True))) == bits(expected)


def _point(folder: Path) -> int:
    return RunState.read(folder / "run.state").point if (folder / "run.state").exists() else -1


@pytest.mark.parametrize("capability", ["canGetAndSetFMUstate", "canSerializeFMUstate"])
def test_an_fmu_without_states_is_refused_before_the_run(tiny: Path, tmp_path: Path, capability: str) -> None:
    path = without_capability(tiny, tmp_path / "Poor.fmu", capability)
    with (
        Simulation(integrator(path)) as simulation,
        pytest.raises(SetupError, match=rf"component 'i': .*Poor\.fmu can't save its state \({capability} is not set"),
    ):
        simulation.run(1.0, 0.1, checkpoint=Checkpoint(tmp_path / "c", 0.1), progress=lambda _: pytest.fail("it ran"))
    assert not (tmp_path / "c").exists()


def resumed(
    path: Path,
    folder: Path,
    function: Callable[[float], float] = math.sin,
    every: int = 1,
    start: dict[str, Any] | None = None,
    step: float = 0.1,
    order: str = "sequential",
    record: list[str] | None = None,
    resume: bool = True,
    **options: Any,
) -> Results:
    system = System()
    system.add("i", path, every=every, start=start)
    system.drive("i.u", function)
    with Simulation(system, order=order, record=record) as simulation:
        return simulation.run(2.0, step, checkpoint=Checkpoint(folder, 0.5, resume=resume), **options)


@pytest.mark.parametrize(
    ("other", "says"),
    [
        ({"step": 0.2}, r"other communication step: 0\.1 then, 0\.2 now"),
        ({"order": "parallel"}, "other order: sequential then, parallel now"),
        ({"start_time": 1.0}, r"other start time: 0\.0 then, 1\.0 now"),
        ({"start": {"T": 2.0}}, r"other start value of i\.T: none then, 2\.0 now"),
        ({"record": ["i.x"]}, "other recorded variables"),
        ({"record_every": 2}, "other record_every: 1 then, 2 now"),
        ({"every": 2}, "other interval of i: 1 then, 2 now"),
        ({"function": math.cos}, r"other signal of i\.u"),
        ({"function": lambda t: math.sin(t) if t < 1.95 else 0.0}, r"other signal of i\.u"),
    ],
)
def test_another_run_is_refused_by_what_differs(tiny: Path, tmp_path: Path, other: dict[str, Any], says: str) -> None:
    with pytest.raises(Stopped):
        resumed(tiny, tmp_path, resume=False, progress=stop_at(1.0))
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    with pytest.raises(SetupError, match=says) as error:
        resumed(tiny, tmp_path, **other)
    assert "\n" not in str(error.value)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert len(resumed(tiny, tmp_path).time) == 21


def test_another_fmu_file_is_refused_by_its_component(tiny: Path, tmp_path: Path) -> None:
    other = without_capability(tiny, tmp_path / "Other.fmu", "canHandleVariableCommunicationStepSize")
    with pytest.raises(Stopped):
        resumed(tiny, tmp_path / "c", resume=False, progress=stop_at(1.0))
    with pytest.raises(SetupError, match="another run \\(other FMU file of i\\)"):
        resumed(other, tmp_path / "c")


def test_what_makes_no_sense_is_one_line(tiny: Path, tmp_path: Path) -> None:
    for every in (0.0, -1.0, math.nan, math.inf, True, "1"):
        with pytest.raises(SetupError, match="must be a positive number"):
            Checkpoint(tmp_path, every)  # type: ignore[arg-type]
    with pytest.raises(SetupError, match="the interval at which they are written, in simulated seconds"):
        Checkpoint(tmp_path)
    with pytest.raises(SetupError, match="no checkpoint to resume"):
        Checkpoint(tmp_path, resume=True)
    with pytest.raises(Stopped):
        resumed(tiny, tmp_path, resume=False, progress=stop_at(1.0))
    with pytest.raises(SetupError, match="of a run that has not ended; resume that run, or remove the folder"):
        Checkpoint(tmp_path, 1.0)


@pytest.mark.parametrize("damage", ["state", "rows", "shorter", "missing"])
def test_a_damaged_checkpoint_is_one_line(tiny: Path, tmp_path: Path, damage: str) -> None:
    with pytest.raises(Stopped):
        resumed(tiny, tmp_path, resume=False, progress=stop_at(1.0))
    path = tmp_path / ("run.state" if damage == "state" else "run.rows")
    data = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes({"state": data[:100], "rows": data[:8] + b"x" + data[9:], "shorter": data[:-8]}[damage])
    with pytest.raises(SetupError, match=path.name.replace(".", r"\.")) as error:
        resumed(tiny, tmp_path)
    assert "\n" not in str(error.value)


def test_a_full_disk_costs_a_checkpoint_and_no_more(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = False
    failing = RunState.write

    def write(state: RunState, path: Path) -> None:
        if full:
            raise OSError(28, "No space left on device")
        failing(state, path)

    def progress(now: float) -> None:
        nonlocal full
        full = 0.705 < now < 1.405

    monkeypatch.setattr(RunState, "write", write)
    monkeypatch.setattr(chunks, "FIRST", 1)
    monkeypatch.setattr(chunks, "GROWTH", 1)
    said: list[str] = []
    with Simulation(integrator(tiny)) as simulation:
        expected = simulation.run(2.0, 0.01)
        checkpoint = Checkpoint(tmp_path, 0.1, warn=said.append)
        assert bits(simulation.run(2.0, 0.01, checkpoint=checkpoint, progress=progress)) == bits(expected)
    assert len(said) == 1
    assert said[0].startswith("no checkpoint at t = 0.8 s: ")
    assert said[0].endswith("No space left on device; the run goes on, and the checkpoint at t = 0.7 s stays")
    assert RunState.read(tmp_path / "run.state").point == 200


LIMITED = """
import resource, sys
from cosim import Checkpoint, Simulation, System
fmu, folder, result = sys.argv[1:]
system = System()
system.add("i", fmu, start={"u": 1.0})
with Simulation(system) as simulation:
    def limit(now):
        if now > 0.5:
            resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))
    results = simulation.run(40.0, 1e-3, checkpoint=Checkpoint(folder, 0.02), progress=limit)
print(results.values.sum().hex(), len(results.time))
"""


@pytest.mark.slow
def test_rows_that_find_no_room_stay_in_memory(tiny: Path, tmp_path: Path) -> None:
    """The limit on the size of a file is the system's own."""
    system = System()
    system.add("i", tiny, start={"u": 1.0})
    with Simulation(system) as simulation:
        expected = simulation.run(40.0, 1e-3)
    folder = tmp_path / "c"
    command = [sys.executable, "-c", LIMITED, tiny, folder, tmp_path / "end.npz"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [expected.values.sum().hex(), "40001"]
    assert done.stderr.count("RuntimeWarning: no checkpoint at t = ") == 1
    with Simulation(system) as simulation:
        assert bits(simulation.run(40.0, 1e-3, checkpoint=Checkpoint(folder, 5.0, resume=True))) == bits(expected)


def test_a_warning_is_python_s_by_default(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Simulation(integrator(tiny)) as simulation:
        checkpoint = Checkpoint(tmp_path, 0.5)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            simulation.run(
                1.0,
                0.1,
                checkpoint=checkpoint,
                progress=lambda _: monkeypatch.setattr(
                    "os.fsync", lambda _: (_ for _ in ()).throw(OSError(28, "full"))
                ),
            )
    assert [w.category for w in caught] == [RuntimeWarning]


def test_a_checkpoint_is_removed_without_what_is_not_its_own(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "c"
    with Simulation(integrator(tiny)) as simulation:
        checkpoint = Checkpoint(folder, 0.5)
        simulation.run(1.0, 0.1, checkpoint=checkpoint)
        assert sorted(p.name for p in folder.iterdir()) == ["run.rows", "run.state"]
        (folder / "run.state.part").write_bytes(b"half")  # as a kill leaves it
        checkpoint.remove()
        assert not folder.exists()
        folder.mkdir()
        (folder / "notes.txt").write_text("mine")
        checkpoint = Checkpoint(folder, 0.5)
        simulation.run(1.0, 0.1, checkpoint=checkpoint)
        checkpoint.remove()
    assert [p.name for p in folder.iterdir()] == ["notes.txt"]


def test_signals_of_the_run_are_part_of_it(tiny: Path, tmp_path: Path) -> None:
    with Simulation(integrator(tiny)) as simulation:
        other = [Signal("i.u", math.cos)]
        with pytest.raises(Stopped):
            simulation.run(2.0, 0.1, signals=other, checkpoint=Checkpoint(tmp_path, 0.5), progress=stop_at(1.0))
        with pytest.raises(SetupError, match=r"other signal of i\.u"):
            simulation.run(2.0, 0.1, checkpoint=Checkpoint(tmp_path, resume=True))
        expected = simulation.run(2.0, 0.1, signals=other)
        found = simulation.run(2.0, 0.1, signals=other, checkpoint=Checkpoint(tmp_path, resume=True))
    assert bits(found) == bits(expected)


def test_a_resumed_run_is_paced_from_where_it_goes_on(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(cosim.master.pacing, "clock", clock)
    with Simulation(integrator(tiny)) as simulation:
        expected = simulation.run(1000.0, 0.5)
        with pytest.raises(Stopped):
            simulation.run(1000.0, 0.5, checkpoint=Checkpoint(tmp_path, 100.0), progress=stop_at(900.0))
        left = 1000.0 - 0.5 * RunState.read(tmp_path / "run.state").point
        found = simulation.run(1000.0, 0.5, checkpoint=Checkpoint(tmp_path, resume=True), realtime=10.0)
    assert bits(found) == bits(expected)
    assert clock.now - 100.0 == pytest.approx(left / 10.0, abs=1e-9)
    assert found.info["realtime"]["factor"] == 10.0


WORDS = ["", "first", "zwölf", "a, b", "zwölf", "last", "b"]


def words(time: float) -> str:
    return WORDS[int(10.0 * time + 0.5) % len(WORDS)]


def of_all_types(path: Path) -> System:
    system = System()
    system.add("a", path)
    system.add("b", path)
    system.drive("a.String", words)
    system.drive("a.Binary", lambda t: words(t).encode())
    system.drive("a.Int64[1]", lambda t: 2**53 + round(10.0 * t))
    system.drive("a.UInt64[2]", lambda t: 2**64 - 1 - round(10.0 * t))
    for name in ("String", "Binary", "Int64[1]", "UInt64[2]"):
        output = name.replace("[", "_out[") if "[" in name else f"{name}_out"
        system.connect(f"a.{output}", f"b.{name}")
    return system


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_texts_and_whole_numbers_go_on_in_another_process(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, order: str
) -> None:
    """Where they have been met in another order."""
    system = of_all_types(compiled(tmp_path_factory.mktemp("types"), "fmi3_types"))
    with Simulation(system, order=order) as simulation:
        expected = simulation.run(3.0, 0.1)
        with pytest.raises(Stopped):
            simulation.run(3.0, 0.1, checkpoint=Checkpoint(tmp_path, 0.3), progress=stop_at(1.7))
    rows: list[list[Any]] = []
    with Simulation(system, order=order) as simulation:
        simulation.run(0.5, 0.1, signals=[Signal("a.String", lambda t: f"other {t:g}")])
        found = simulation.run(3.0, 0.1, checkpoint=Checkpoint(tmp_path, resume=True))
    assert set(found.typed) == set(expected.typed)
    for name, column in expected.typed.items():
        assert found.typed[name].type == column.type
        assert found.typed[name].values.tolist() == column.values.tolist(), name
    assert found.values.tobytes() == expected.values.tobytes()
    assert len(set(expected.typed["b.String_out"].values.tolist())) == 6
    with pytest.raises(Stopped), Simulation(system, order=order) as simulation:
        simulation.run(3.0, 0.1, checkpoint=Checkpoint(tmp_path / "again", 0.3), progress=stop_at(1.7))
    with Simulation(system, order=order) as simulation:
        checkpoint = Checkpoint(tmp_path / "again", resume=True)
        simulation.run(3.0, 0.1, checkpoint=checkpoint, sink=lambda _, values: rows.extend(values.tolist()))
    texts = [row[expected.names.index("b.String_out")] for row in rows]
    assert texts == expected.typed["b.String_out"].values.tolist()


class Counter:
    """A controller with a state, in Python."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, _time: float, x: float) -> float:
        self.calls += 1
        return math.cos(self.calls / 7.0) - 0.3 * x

    def reset(self) -> None:
        self.calls = 0

    def save(self) -> bytes:
        return str(self.calls).encode()

    def restore(self, state: bytes) -> None:
        self.calls = int(state)


def with_function(path: Path, function: Callable[..., Any]) -> System:
    system = System()
    system.add("i", path)
    system.add_function("c", function, inputs=["x"], outputs=["u"])
    system.connect("i.x", "c.x")
    system.connect("c.u", "i.u")
    return system


def test_a_function_in_the_system_goes_on_where_it_was(tiny: Path, tmp_path: Path) -> None:
    with Simulation(with_function(tiny, Counter())) as simulation:
        expected = simulation.run(2.0, 0.01)
        with pytest.raises(Stopped):
            simulation.run(2.0, 0.01, checkpoint=Checkpoint(tmp_path, 0.13), progress=stop_at(1.0))
    with Simulation(with_function(tiny, Counter())) as simulation:
        assert bits(simulation.run(2.0, 0.01, checkpoint=Checkpoint(tmp_path, resume=True))) == bits(expected)


def test_a_function_that_can_not_be_saved_is_refused_by_name(tiny: Path, tmp_path: Path) -> None:
    class Forgetful:
        def __call__(self, _time: float, x: float) -> float:
            return x

    with (
        Simulation(with_function(tiny, Forgetful())) as simulation,
        pytest.raises(SetupError, match=r"component 'c': its function can't save its state"),
    ):
        simulation.run(1.0, 0.1, checkpoint=Checkpoint(tmp_path / "c", 0.1))
    assert not (tmp_path / "c").exists()


def test_ctrl_c_within_a_call_leaves_the_checkpoint_before(tiny: Path, tmp_path: Path) -> None:
    class Interrupting(Counter):
        def __call__(self, time: float, x: float) -> float:
            if self.calls == 100 and not pressed:
                pressed.append(time)
                signal.raise_signal(signal.SIGINT)
            return super().__call__(time, x)

    pressed: list[float] = []
    with Simulation(with_function(tiny, Counter())) as simulation:
        expected = simulation.run(2.0, 0.01)
    with Simulation(with_function(tiny, Interrupting())) as simulation:
        with pytest.raises(SimulationInterrupted):
            simulation.run(2.0, 0.01, checkpoint=Checkpoint(tmp_path, 0.3))
        assert pressed
        assert RunState.read(tmp_path / "run.state").point in (90, 99, 100)
        assert bits(simulation.run(2.0, 0.01, checkpoint=Checkpoint(tmp_path, resume=True))) == bits(expected)
