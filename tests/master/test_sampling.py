"""Signals sampled ahead of the stepping loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import cosim.master.sampling
from cosim import Simulation, SimulationError, System, simulate
from cosim.master.sampling import Samples, sample
from cosim.system.resolution import Drive
from cosim.system.variables import Element
from tests.support.clock import Clock
from tests.support.small_fmus import build
from tests.support.tiny_models import GAIN, INTEGRATOR


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(cosim.master.sampling, "clock", clock)
    return clock


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("sampling"), "fmi2", GAIN, INTEGRATOR)


def drive(
    function: Callable[[Any], Any], size: int = 1, component: str = "c", kind: str = "Real", **options: Any
) -> Drive:
    names = ["u"] if size == 1 else [f"u[{i + 1}]" for i in range(size)]
    variable = SimpleNamespace(type=kind, declaredType=None)
    return Drive(component, tuple(Element(n, variable, i) for i, n in enumerate(names)), function, **options)


def going_on() -> bool:
    return False


def all_of(samples: Samples, points: int, chunk: int = 64) -> int:
    """Cover chunk by chunk as the loop does; returns the end of what could be had."""
    first = 0
    while first < points:
        end = samples.cover(first, min(first + chunk, points), going_on)
        if end == first:
            break
        first = end
    return first


# Values


def test_each_target_has_its_column_and_each_point_its_row() -> None:
    drives = [drive(lambda t: [t, 10.0 * t], 2), drive(lambda t: -t), drive(lambda t: 7.0, 3)]
    samples = Samples(drives, 2.0, 0.25, 8, 1)
    assert samples.cover(0, 9, going_on) == 9
    t = 2.0 + 0.25 * np.arange(9)
    expected = np.column_stack([t, 10.0 * t, -t, *[np.full(9, 7.0)] * 3])
    assert samples.values.tolist() == expected.tolist()
    assert [c.tolist() for c in samples.columns] == [[0, 1], [2], [3, 4, 5]]


@pytest.mark.parametrize("every", [1, 2, 3])
@pytest.mark.parametrize("chunk", [1, 7, 64])
@pytest.mark.parametrize(
    ("scalar", "vectorized", "size"),
    [
        (lambda t: t * t, lambda t: t * t, 1),
        (lambda t: 3.0, lambda t: 3.0, 1),
        (lambda t: 3.0, lambda t: 3.0, 2),
        (lambda t: t, lambda t: t, 2),  # one value for all elements
        (lambda t: [t, 2.0 * t, 1.0], lambda t: np.stack([t, 2.0 * t, np.ones_like(t)], axis=1), 3),
        (lambda t: int(t), lambda t: t.astype(int), 1),
    ],
)
def test_vectorized_signals_give_what_scalar_ones_give(
    scalar: Callable, vectorized: Callable, size: int, chunk: int, every: int
) -> None:
    found = []
    for function, flag in ((scalar, False), (vectorized, True)):
        samples = Samples([drive(function, size, vectorized=flag, every=every)], 1.0, 0.1, 100, every)
        assert all_of(samples, 101, chunk) == 101
        found.append(samples.values[::every])
    assert found[0].tobytes() == found[1].tobytes()


def test_a_vectorized_signal_is_called_with_times_as_they_are_reported() -> None:
    calls: list[np.ndarray] = []
    samples = Samples([drive(lambda t: calls.append(t) or t, vectorized=True)], 3.7, 0.1, 333, 1)
    all_of(samples, 334, 50)
    assert np.concatenate(calls).tolist() == [3.7 + i * 0.1 for i in range(334)]
    assert len(calls) == 7


@pytest.mark.parametrize("vectorized", [False, True])
@pytest.mark.parametrize("every", [1, 2, 3, 5])
def test_a_signal_is_asked_at_the_points_of_its_component_only(every: int, vectorized: bool) -> None:
    asked: list[float] = []

    def function(t: float | np.ndarray) -> float | np.ndarray:
        asked.extend(np.atleast_1d(t).tolist())
        return 1.0 * t

    other = drive(lambda t: t)
    samples = Samples([drive(function, vectorized=vectorized, every=every), other], 0.0, 1.0, 100, every)
    all_of(samples, 101, 10)
    assert asked == list(range(0, 101, every))
    assert samples.values[::every, 0].tolist() == asked
    assert samples.values[:, 1].tolist() == list(range(101))


def test_samples_reach_beyond_the_chunk_but_not_beyond_the_run() -> None:
    asked: list[float] = []
    samples = Samples([drive(lambda t: asked.append(t) or t)], 0.0, 1.0, 20, 3)
    assert samples.cover(0, 10, going_on) == 10
    assert samples.end == 13
    assert samples.cover(10, 21, going_on) == 21
    assert samples.end == 21
    assert asked == list(range(21))


# Windows


@pytest.mark.parametrize("reach", [1, 2, 3])
@pytest.mark.parametrize("chunk", [1, 5, 64])
def test_samples_behind_the_loop_are_dropped(monkeypatch: pytest.MonkeyPatch, chunk: int, reach: int) -> None:
    monkeypatch.setattr(cosim.master.sampling, "_MOST_SAMPLES", 40)
    drives = [drive(lambda t: t, breakpoints=(50.0, 123.4)), drive(lambda t: -t, vectorized=True)]
    samples = Samples(drives, 0.0, 1.0, 300, reach)
    assert samples.values.shape == (20, 2)
    first = 0
    while first < 301:
        end = samples.cover(first, min(first + chunk, 301), going_on)
        assert end > first
        # all that the loop reads: back by `reach` for the jumps, and up to the end
        assert samples.first <= max(first - reach, 0)
        assert end <= samples.end <= samples.first + 20
        points = np.arange(samples.first, samples.end)
        rows = points - samples.first
        assert samples.values[rows].tolist() == [[p, -p] for p in points]
        assert set(points[samples.jumps[rows] > 0]) & {50, 124} == {50, 124} & set(points)
        first = end
    assert first == 301


@pytest.mark.parametrize("every", [1, 2, 3])
@pytest.mark.parametrize("coupling", ["hold", "linear"])
def test_a_run_through_many_windows_is_one_through_a_single_one(
    fmus: Path, monkeypatch: pytest.MonkeyPatch, coupling: str, every: int
) -> None:
    system = System()
    system.add("i", fmus / "Integrator.fmu", every=every)
    system.drive("i.u", np.cos, vectorized=True, breakpoints=(7.0, 11.15, 30.3))
    whole = simulate(system, 100.0, 0.1, extrapolation=coupling)
    monkeypatch.setattr(cosim.master.sampling, "_MOST_SAMPLES", 30)
    assert simulate(system, 100.0, 0.1, extrapolation=coupling).values.tobytes() == whole.values.tobytes()


def test_the_window_holds_what_a_slow_component_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cosim.master.sampling, "_MOST_SAMPLES", 1)
    samples = Samples([drive(lambda t: t, every=5)], 0.0, 1.0, 1000, 5)
    assert len(samples.values) == 21
    assert all_of(samples, 1001) == 1001


def test_a_run_without_signals_needs_no_values() -> None:
    samples = Samples([], 0.0, 1.0, 100, 1)
    assert all_of(samples, 101, 7) == 101
    assert samples.values.shape == (101, 0)
    assert not samples.jumps.any()


# Failures


def raising(at: float) -> Callable[[float], float]:
    def function(t: float) -> float:
        if t >= at:
            raise LookupError(f"nothing from {at:g} on")
        return t

    return function


def not_finite(at: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda t: np.where(t >= at, np.nan, t)


@pytest.mark.parametrize("chunk", [1, 7, 64, 1000])
@pytest.mark.parametrize("point", [1, 6, 7, 63, 64, 65, 99])
def test_a_failing_signal_gives_all_rows_up_to_its_failure(point: int, chunk: int) -> None:
    for function, vectorized in ((raising(point), False), (not_finite(point), True)):
        asked = drive(function, vectorized=vectorized)
        samples = Samples([drive(lambda t: -t), asked, drive(lambda t: t)], 0.0, 1.0, 100, 1)
        assert all_of(samples, 101, chunk) == point
        assert samples.end == point
        assert samples.failed is asked
        assert samples.values[:point].tolist() == [[-i, i, i] for i in range(point)]


@pytest.mark.parametrize("chunk", [1, 7, 64, 1000])
@pytest.mark.parametrize("vectorized", [False, True])
def test_the_earliest_of_several_failures_wins(chunk: int, vectorized: bool) -> None:
    for times in ((30, 20, 40), (20, 30, 40), (40, 30, 20), (20, 20, 20)):
        drives = [
            drive(not_finite(at) if vectorized else raising(at), component=f"c{k}", vectorized=vectorized)
            for k, at in enumerate(times)
        ]
        samples = Samples(drives, 0.0, 1.0, 100, 1)
        assert all_of(samples, 101, chunk) == 20
        assert samples.failed is drives[times.index(20)]
        assert f"'c{times.index(20)}.u'" in str(samples.failure)


@pytest.mark.parametrize("every", [2, 3])
def test_a_slow_component_s_signal_fails_at_a_point_of_its_own(every: int) -> None:
    samples = Samples([drive(raising(50.5), every=every), drive(lambda t: t)], 0.0, 1.0, 100, every)
    assert all_of(samples, 101, 10) == -(-51 // every) * every


def test_after_a_failure_no_signal_is_asked_again() -> None:
    asked: list[float] = []
    samples = Samples([drive(raising(5.0)), drive(lambda t: asked.append(t) or t)], 0.0, 1.0, 100, 1)
    for _ in range(3):
        assert all_of(samples, 101) == 5
    assert asked == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_run_goes_on_up_to_the_failure_and_names_it(fmus: Path) -> None:
    system = System()
    for name, at in (("a", 70.0), ("b", 67.0), ("c", 90.0)):
        system.add(name, fmus / "Gain.fmu")
        system.drive(f"{name}.u", raising(at))
    message = r"^b failed at t = 67 s: the signal that feeds 'b\.u\[1\]' failed: LookupError: nothing from 67 on$"
    with pytest.raises(SimulationError, match=message) as failed:
        simulate(system, 100.0, 1.0)
    assert failed.value.component == "b"
    assert failed.value.results.time.tolist() == list(range(67))
    assert failed.value.results["a.y[1]"].tolist() == [2.0 * i for i in range(67)]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (math.nan, r"gives \[nan\], which is not finite"),
        (-math.inf, r"gives \[-inf\], which is not finite"),
        ([1.0, math.nan], r"gives \[1\.0, nan\], which is not finite"),
        ([1.0, 2.0, 3.0], "gives 3 values, not 2"),
        ([], "gives 0 values, not 2"),
        ([[1.0, 2.0]], r"gives an array of shape \(1, 2\); make it flat"),
        ("much", "failed: ValueError: could not convert string to float"),
        (None, r"gives \[nan\], which is not finite"),
        ({"u": 1.0}, "failed: TypeError"),
    ],
)
def test_values_that_are_none_are_named(value: object, message: str) -> None:
    rows, failure = sample(drive(lambda t: value if t >= 2.0 else 0.0, 2), np.arange(5.0))
    assert rows.tolist() == [[0.0, 0.0]] * 2
    assert str(failure).startswith("the signal that feeds 'c.u[1]' ")
    with pytest.raises(type(failure), match=message):
        raise failure


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_vectorized_values_that_are_not_finite_end_the_rows(value: float) -> None:
    def function(t: np.ndarray) -> np.ndarray:
        values = np.zeros((len(t), 2))
        values[t >= 2.0, 1] = value
        return values

    rows, failure = sample(drive(function, 2, vectorized=True), np.arange(5.0))
    assert rows.tolist() == [[0.0, 0.0]] * 2
    assert str(failure) == f"the signal that feeds 'c.u[1]' gives [0.0, {value}], which is not finite"


@pytest.mark.parametrize("shape", [(4, 3), (2, 4), (3,), (4, 2, 1), (0,), (3, 2)])
def test_vectorized_values_of_a_wrong_shape_are_refused(shape: tuple[int, ...]) -> None:
    rows, failure = sample(drive(lambda t: np.zeros(shape), 2, vectorized=True), np.arange(4.0))
    assert rows.shape == (0, 2)
    assert str(failure).startswith("the signal that feeds 'c.u[1]' failed: ValueError: ")
    assert "\n" not in str(failure)


def test_a_vectorized_signal_that_raises_is_named() -> None:
    rows, failure = sample(drive(lambda t: t + None, vectorized=True), np.arange(4.0))
    assert rows.shape == (0, 1)
    assert str(failure).startswith("the signal that feeds 'c.u' failed: TypeError: ")


@pytest.mark.parametrize(
    ("kind", "values", "wrong"),
    [
        ("Int32", [0, -(2**31), 2**31 - 1, 2**31], 3),
        ("Int32", [0, 1, 0.5], 2),
        ("UInt8", [0, 255, -1], 2),
        ("UInt8", [0, 255, 256], 2),
        ("Boolean", [0, 1, True, False, 2], 4),
        ("Boolean", [0, 0.5], 1),
    ],
)
def test_values_outside_an_integer_type_are_refused(kind: str, values: Sequence[float], wrong: int) -> None:
    rows, failure = sample(drive(lambda t: values[int(t)], kind=kind), np.arange(len(values)))
    assert rows.view(np.int64).ravel().tolist() == list(values[:wrong])
    assert str(failure) == f"the signal that feeds 'c.u' gives [{values[wrong]}], no value of type {kind}"


@pytest.mark.parametrize(
    ("kind", "function"),
    [
        ("Int32", lambda t: np.where(t >= 5.0, 0.5, 1.0)),
        ("UInt8", lambda t: np.where(t >= 5.0, 256.0, 255.0)),
        ("Boolean", lambda t: np.where(t >= 5.0, 2.0, 1.0)),
    ],
)
def test_a_vectorized_signal_outside_an_integer_type_ends_at_its_failure(
    kind: str, function: Callable[[np.ndarray], np.ndarray]
) -> None:
    rows, failure = sample(drive(function, kind=kind, vectorized=True), np.arange(10.0))
    wrong = float(function(np.array([5.0]))[0])
    assert rows.view(np.int64).ravel().tolist() == [function(np.array([0.0]))[0]] * 5
    assert str(failure) == f"the signal that feeds 'c.u' gives [{wrong}], no value of type {kind}"


@pytest.mark.parametrize("chunk", [1, 3, 64, 1000])
def test_a_vectorized_signal_that_raises_ends_where_a_scalar_one_does(chunk: int) -> None:
    def function(t: np.ndarray) -> np.ndarray:
        if np.max(t) >= 50.0:
            raise LookupError("nothing from 50 on")
        return t

    samples = Samples([drive(function, vectorized=True), drive(lambda t: -t)], 0.0, 1.0, 100, 1)
    assert all_of(samples, 101, chunk) == 50
    assert samples.values[:50].tolist() == [[i, -i] for i in range(50)]
    assert str(samples.failure).endswith("LookupError: nothing from 50 on")


@pytest.mark.parametrize("at", [3.0, 5.0, 11.0])
def test_a_failure_behind_the_cut_of_a_slow_signal_is_none_yet(clock: Clock, at: float) -> None:
    def slow(t: float) -> float:
        clock.now += 0.02
        return t

    failing = drive(raising(at))
    samples = Samples([failing, drive(slow)], 0.0, 1.0, 100, 1)
    assert all_of(samples, 101) == at
    assert samples.failed is failing


# Jumps


def jumps(breakpoints: Sequence[float], h: float = 0.1, points: int = 101, start: float = 0.0) -> list[int]:
    samples = Samples([drive(lambda t: t, breakpoints=tuple(breakpoints))], start, h, points - 1, 1)
    all_of(samples, points, 13)
    return np.flatnonzero(samples.jumps).tolist()


@pytest.mark.parametrize(("breakpoint", "row"), [(0.35, 4), (0.31, 4), (0.39, 4), (0.05, 1), (9.95, 100)])
def test_a_jump_between_two_points_belongs_to_the_one_after(breakpoint: float, row: int) -> None:
    assert jumps([breakpoint]) == [row]


@pytest.mark.parametrize("row", range(1, 100))
def test_a_jump_at_a_point_belongs_to_it_however_its_time_is_rounded(row: int) -> None:
    """Rows are i * 0.1, breakpoints what people write: 0.3 is not 3 * 0.1."""
    written = float(f"{row / 10:.1f}")
    for breakpoint in (written, row * 0.1, math.nextafter(written, 0.0), math.nextafter(written, 100.0)):
        assert jumps([breakpoint]) == [row]


@pytest.mark.parametrize("start", [0.0, -3.7, 1e5])
def test_jumps_count_from_the_start_time(start: float) -> None:
    assert jumps([start + 0.55], start=start) == [6]


def test_a_signal_is_asked_at_a_breakpoint_not_just_before_it() -> None:
    """3 * 0.3 is less than 0.9 by rounding; other times are left alone, also those just after."""
    for vectorized in (False, True):
        asked: list[float] = []

        def function(t: float | np.ndarray, asked: list[float] = asked) -> float | np.ndarray:
            asked.extend(np.atleast_1d(t).tolist())
            return t

        samples = Samples([drive(function, breakpoints=(0.9, 1.5, 2.0), vectorized=vectorized)], 0.0, 0.3, 10, 1)
        all_of(samples, 11)
        expected = [i * 0.3 for i in range(11)]
        assert expected[3] < 0.9
        expected[3] = 0.9
        assert asked == expected


def test_several_jumps_of_several_signals() -> None:
    drives = [drive(lambda t: t, breakpoints=(0.15, 0.17, 0.75)), drive(lambda t: t, breakpoints=(0.17, 0.42))]
    samples = Samples(drives, 0.0, 0.1, 10, 1)
    samples.cover(0, 11, going_on)
    assert np.flatnonzero(samples.jumps).tolist() == [2, 5, 8]


@pytest.mark.parametrize("breakpoint", [-1.0, 10.05, 1e9])
def test_jumps_outside_the_run_are_none(breakpoint: float) -> None:
    assert jumps([breakpoint]) == []


# Signals that take long


def test_slow_signals_are_cut_and_asked_once_for_each_point(clock: Clock) -> None:
    asked: list[float] = []

    def slow(t: float) -> float:
        asked.append(t)
        clock.now += 0.02
        return t

    samples = Samples([drive(lambda t: -t, vectorized=True), drive(slow), drive(lambda t: t)], 0.0, 1.0, 20, 1)
    end = samples.cover(0, 21, going_on)
    assert len(asked) == 3  # 0.05 s are allowed, and the value at which they are over
    assert 1 <= end <= 3
    ends = [end]
    while ends[-1] < 21:
        ends.append(samples.cover(ends[-1], 21, going_on))
        assert ends[-1] > ends[-2]
    assert asked == list(range(21))
    assert samples.values.tolist() == [[-i, i, i] for i in range(21)]


def test_values_that_take_longer_than_allowed_are_had_all_the_same(clock: Clock) -> None:
    def slow(t: float) -> float:
        clock.now += 0.06
        return t

    samples = Samples([drive(slow)], 0.0, 1.0, 3, 0)
    assert [samples.cover(i, 4, going_on) for i in range(4)] == [1, 2, 3, 4]


@pytest.mark.parametrize("reach", [0, 1, 2])
def test_a_point_counts_once_the_loop_can_look_as_far_ahead_as_it_does(reach: int, clock: Clock) -> None:
    """However slow the signal: else the rate of a linear input would depend on it."""

    def slow(t: float) -> float:
        clock.now += 0.02
        return t

    samples = Samples([drive(slow)], 0.0, 1.0, 12, reach)
    first = 0
    while first < 13:
        end = samples.cover(first, 13, going_on)
        assert end > first
        assert samples.end == min(end + reach, 13)
        first = end


@pytest.mark.parametrize(("reach", "end"), [(0, 5), (1, 4), (5, 0)])
def test_sampling_stops_when_it_is_told_to(reach: int, end: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cosim.master.sampling, "_LONGEST", math.inf)  # a busy machine must not cut it too
    asked: list[float] = []
    samples = Samples([drive(lambda t: asked.append(t) or t)], 0.0, 1.0, 1000, reach)
    assert samples.cover(0, 1000, lambda: len(asked) == 5) == end
    assert asked == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert samples.failure is None
    assert samples.cover(end, 1001, going_on) == 1001
    assert asked == list(range(1001))


@pytest.mark.parametrize("coupling", ["hold", "linear"])
def test_a_slow_signal_changes_no_value(fmus: Path, clock: Clock, coupling: str) -> None:
    def slow(t: float) -> float:
        clock.now += 0.01
        return math.sin(t)

    def system(function: Callable[[float], float]) -> System:
        system = System()
        system.add("i", fmus / "Integrator.fmu")
        system.drive("i.u", function)
        return system

    expected = simulate(system(math.sin), 3.0, 0.1, extrapolation=coupling).values
    with Simulation(system(slow), extrapolation=coupling) as simulation:
        assert simulation.run(3.0, 0.1).values.tobytes() == expected.tobytes()
        assert simulation.run(3.0, 0.1).values.tobytes() == expected.tobytes()  # has all samples from the first
