"""What a run records, in memory or passed on to a sink chunk by chunk."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import cosim.master.recording
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
from cosim.master.recording import InMemory, PassedOn
from tests.support.small_fmus import build
from tests.support.tiny_models import GAIN, INTEGRATOR, ROOT


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> System:
    """An integrator behind a gain, which a root of a signal feeds."""
    folder = build(tmp_path_factory.mktemp("recording"), "fmi2", GAIN, INTEGRATOR, ROOT)
    system = System()
    system.add("root", folder / "Root.fmu")
    system.add("g", folder / "Gain.fmu", start={"K": -1.1, "u[2]": 0.3})
    system.add("i", folder / "Integrator.fmu", start={"x_start": 0.1})
    system.drive("root.u", lambda t: 2.0 + np.sin(t))
    system.connect("root.y", "g.u[1]")
    system.connect("g.y[1]", "i.u")
    return system


@pytest.fixture(scope="module")
def simulation(system: System) -> Iterator[Simulation]:
    with Simulation(system) as simulation:
        yield simulation


COLUMNS = 8  # of this system


class Kept:
    """A sink that keeps what it gets."""

    def __init__(self) -> None:
        self.times: list[np.ndarray] = []
        self.values: list[np.ndarray] = []

    def __call__(self, times: np.ndarray, values: np.ndarray) -> None:
        assert len(times) == len(values) > 0
        self.times.append(times.copy())
        self.values.append(values.copy())

    @property
    def chunks(self) -> list[int]:
        return [len(t) for t in self.times]

    def assert_equal(self, results: Results) -> None:
        """Every row once, in order, bit for bit."""
        assert np.concatenate(self.times).tobytes() == results.time.tobytes()
        values = np.concatenate(self.values)
        assert values.shape == results.values.shape
        assert values.tobytes() == results.values.tobytes()


def buffer(monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    """Let the buffer of a sink hold so many rows."""
    monkeypatch.setattr(cosim.master.recording, "_BUFFERED_VALUES", COLUMNS * rows + COLUMNS - 1)


def driven_by(function: Callable[[float], float]) -> list[Signal]:
    return [Signal("root.u", function)]


@pytest.mark.parametrize("steps", [1, 2, 63, 64, 65, 1000, 3000])
def test_a_sink_gets_what_a_run_in_memory_gives(simulation: Simulation, steps: int) -> None:
    expected = simulation.run(steps * 0.01, 0.01)
    assert expected.values.shape == (steps + 1, COLUMNS)
    sink = Kept()
    results = simulation.run(steps * 0.01, 0.01, sink=sink)
    sink.assert_equal(expected)
    assert sink.chunks == [steps + 1]  # the buffer is not full before the end
    assert results.names == expected.names
    assert results.time.shape == (0,)
    assert results.values.shape == (0, COLUMNS)
    assert results.info["status"] == "completed"
    assert results.info["parameters"] == expected.info["parameters"]


@pytest.mark.parametrize("record_every", [1, 2, 3, 10, 1000])
@pytest.mark.parametrize("rows", [1, 7, 64, 100])
def test_a_sink_gets_every_row_once_where_the_run_is_longer_than_the_buffer(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch, rows: int, record_every: int
) -> None:
    buffer(monkeypatch, rows)
    expected = simulation.run(20.0, 0.01, record_every=record_every)
    assert len(expected.time) == 2000 // record_every + 1
    sink = Kept()
    simulation.run(20.0, 0.01, record_every=record_every, sink=sink)
    sink.assert_equal(expected)
    assert max(sink.chunks) <= rows
    assert sum(sink.chunks) == len(expected.time)


def test_a_sink_gets_rows_without_columns_where_nothing_is_recorded(system: System) -> None:
    sink = Kept()
    simulate(system, 1.0, 0.01, record=[], sink=sink)
    assert np.concatenate(sink.times).shape == (101,)
    assert np.concatenate(sink.values).shape == (101, 0)


@pytest.mark.parametrize(("start", "h", "n"), [(0.0, 0.1, 1000), (3.7, 0.1, 333), (-1.3, 1e-3, 2000)])
@pytest.mark.parametrize("record_every", [1, 3, 7])
def test_times_are_start_plus_i_times_h_exactly(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch, start: float, h: float, n: int, record_every: int
) -> None:
    buffer(monkeypatch, 50)
    exact = [start + i * h for i in range(0, n + 1, record_every)]
    options = {"start_time": start, "record_every": record_every}
    assert simulation.run(start + n * h, h, **options).time.tolist() == exact
    sink = Kept()
    simulation.run(start + n * h, h, sink=sink, **options)
    assert np.concatenate(sink.times).tolist() == exact


@pytest.mark.parametrize("record_every", [1, 3])
@pytest.mark.parametrize("rows", [1, 7, 1000])
@pytest.mark.parametrize("point", [1, 63, 64, 65, 200])
def test_a_failure_still_passes_on_everything_recorded(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch, point: int, rows: int, record_every: int
) -> None:
    buffer(monkeypatch, rows)

    def fails(t: float) -> float:
        return -1.0 if t >= point else 1.0 + t  # the root of -1 is none

    def run(**options: object) -> SimulationError:
        with pytest.raises(SimulationError, match=rf"^root failed at t = {point} s") as failed:
            simulation.run(300.0, 1.0, signals=driven_by(fails), record_every=record_every, **options)
        return failed.value

    expected = run().results
    assert expected.time.tolist() == list(range(0, point, record_every))
    sink = Kept()
    results = run(sink=sink).results
    sink.assert_equal(expected)
    assert results.values.shape == (0, COLUMNS)
    assert results.info["status"] == "failed"


@pytest.mark.parametrize("rows", [1, 7, 1000])
@pytest.mark.parametrize("point", [1, 64, 200])
def test_a_signal_that_fails_still_passes_on_everything_recorded(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch, point: int, rows: int
) -> None:
    buffer(monkeypatch, rows)
    sink = Kept()
    with pytest.raises(SimulationError, match=rf"root failed at t = {point} s: .*ZeroDivisionError"):
        simulation.run(300.0, 1.0, signals=driven_by(lambda t: 1.0 / (t - point) + 2.0), sink=sink)
    assert np.concatenate(sink.times).tolist() == list(range(point))


@pytest.mark.parametrize("rows", [1, 7, 1000])
@pytest.mark.parametrize("point", [2, 64, 200])
def test_ctrl_c_still_passes_on_everything_recorded(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch, point: int, rows: int
) -> None:
    buffer(monkeypatch, rows)

    def interrupts(t: float) -> float:
        if t == point and armed:
            armed.clear()
            signal.raise_signal(signal.SIGINT)
        return 1.0 + t

    armed = [True]
    sink = Kept()
    with pytest.raises(SimulationInterrupted) as interrupted:
        simulation.run(300.0, 1.0, signals=driven_by(interrupts), sink=sink)
    times = np.concatenate(sink.times)
    assert point - 1 <= len(times) <= point + 1  # the signal is asked ahead, by a point
    assert interrupted.value.time == len(times)  # the point that was next
    assert interrupted.value.results.values.shape == (0, COLUMNS)
    assert interrupted.value.results.info["status"] == "interrupted"
    expected = simulation.run(300.0, 1.0, signals=driven_by(interrupts))
    sink.assert_equal(Results(expected.time[: len(times)], expected.names, expected.values[: len(times)]))


def test_an_error_of_the_sink_ends_the_run(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    buffer(monkeypatch, 10)
    calls: list[int] = []

    def sink(times: np.ndarray, values: np.ndarray) -> None:
        calls.append(len(times))
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="the disk is full"):
        simulation.run(10.0, 0.01, sink=sink)
    assert len(calls) == 1


def test_more_than_memory_holds_is_one_line_with_the_remedy(simulation: Simulation) -> None:
    message = r"^8 values at 1000000001 communication points need 64 GB of memory; .*record_every.*sink$"
    with pytest.raises(SetupError, match=message), limited_memory():
        simulation.run(1e6, 1e-3)


class limited_memory:  # noqa: N801 -- a context
    """numpy has no memory for arrays of more than 1 GB, whatever the machine would promise."""

    def __enter__(self) -> None:
        self._empty = np.empty

        def empty(shape: object, *arguments: object, **options: object) -> np.ndarray:
            if isinstance(shape, tuple) and np.prod(shape, dtype=float) * 8 > 1e9:
                raise MemoryError
            return self._empty(shape, *arguments, **options)

        np.empty = empty

    def __exit__(self, *_: object) -> None:
        np.empty = self._empty


# The recorders by themselves


def times(first: int, end: int) -> np.ndarray:
    return 0.5 * np.arange(first, end)


def fill(recorder: InMemory | PassedOn, chunks: list[int]) -> None:
    """As the loop does: row i holds i, and 10 i."""
    first = 0
    for n in chunks:
        rows, number = recorder.room(first, first + n)
        for i in range(first, first + n):
            rows[i - number] = i, 10 * i
        recorder.recorded(first + n)
        first += n


CHUNKS = [1, 3, 5, 2, 5, 4, 4, 1]


def test_rows_in_memory_come_back_as_far_as_they_were_recorded() -> None:
    recorder = InMemory(times, 100, 2)
    fill(recorder, CHUNKS)
    found_times, values = recorder.result()
    assert found_times.tolist() == [0.5 * i for i in range(25)]
    assert values.tolist() == [[i, 10 * i] for i in range(25)]


def test_the_buffer_goes_to_the_sink_before_it_overflows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cosim.master.recording, "_BUFFERED_VALUES", 10)
    sink = Kept()
    recorder = PassedOn(times, 100, 2, sink)
    assert recorder.capacity == 5
    fill(recorder, CHUNKS)
    assert sink.chunks == [4, 5, 2, 5, 4]
    assert recorder.result()[1].shape == (0, 2)
    assert sink.chunks == [4, 5, 2, 5, 4, 5]
    sink.assert_equal(Results(times(0, 25), [], np.array([[i, 10.0 * i] for i in range(25)])))
    recorder.result()  # a second time nothing is left
    assert sum(sink.chunks) == 25


def test_the_buffer_is_no_larger_than_the_run_and_holds_a_row_at_least(monkeypatch: pytest.MonkeyPatch) -> None:
    assert PassedOn(times, 7, 2, Kept()).capacity == 7
    monkeypatch.setattr(cosim.master.recording, "_BUFFERED_VALUES", 10)
    assert PassedOn(times, 7, 11, Kept()).capacity == 1
    assert PassedOn(times, 7, 0, Kept()).capacity == 7
