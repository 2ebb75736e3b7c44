"""The compiled stepping loop: its library, values of all types, and where it stops."""

from __future__ import annotations

import ctypes
import itertools
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cosim.loop.binding
from cosim import Results, SetupError, Simulation, SimulationError, System, simulate
from cosim.loop.binding import LoopLibraryError, loop_library
from cosim.master import chunks
from tests.support.small_fmus import FLAVOURS, FMI3_TYPES, build, compiled
from tests.support.tiny_models import GAIN, INTEGRATOR

#: Statuses of FMI 2.0 and 3.0.
WARNING, DISCARD, ERROR, FATAL = 1, 2, 3, 4

#: Functions of the probe that can fail.
DO_STEP, SET_REAL, GET_REAL = 0, 1, 2

#: s; times of communication points are exact with it.
H = 2.0**-10


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loop")
    for flavour in FLAVOURS:
        build(folder / flavour, flavour, GAIN, INTEGRATOR)
    return folder


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("probe"), "fmi2_probe")


@pytest.fixture(scope="module")
def types(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(tmp_path_factory.mktemp("types"), "fmi3_types")


# The library


@pytest.fixture
def reloaded() -> Iterator[None]:
    """The library is loaded anew in the test, and again after it."""
    loop_library.cache_clear()
    yield
    loop_library.cache_clear()


def integrator(fmus: Path) -> System:
    system = System()
    system.add("i", fmus / "fmi2" / "Integrator.fmu")
    system.drive("i.u", lambda t: 1.0)
    return system


REMEDY = r"install the package again \(pip install \.\), or in a checkout: python hatch_build\.py"


def test_a_library_of_another_source_is_one_line_with_the_remedy(
    reloaded: None, fmus: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cosim.loop.binding, "source_hash", lambda: "0123456789abcdef")
    message = rf"^the compiled loop .*_loop\.\w+ belongs to another version of its source; {REMEDY}$"
    with pytest.raises(LoopLibraryError, match=message):
        Simulation(integrator(fmus))


def test_a_missing_library_is_one_line_with_the_remedy(
    reloaded: None, fmus: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(cosim.loop.binding, "LIBRARY", tmp_path / "_loop.so")
    with pytest.raises(LoopLibraryError, match=rf"^the compiled loop .*_loop\.so can't be loaded: .*; {REMEDY}$"):
        Simulation(integrator(fmus))


def test_a_file_that_is_no_library_is_one_line_with_the_remedy(
    reloaded: None, fmus: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "_loop.so").write_bytes(b"not a library")
    monkeypatch.setattr(cosim.loop.binding, "LIBRARY", tmp_path / "_loop.so")
    with pytest.raises(LoopLibraryError, match=rf"can't be loaded: .*; {REMEDY}$"):
        Simulation(integrator(fmus))


def swapped(fields: list[tuple[str, Any]], first: str, second: str) -> list[tuple[str, Any]]:
    names = [name for name, _ in fields]
    i, k = names.index(first), names.index(second)
    fields[i], fields[k] = fields[k], fields[i]
    return fields


@pytest.mark.parametrize(
    ("struct", "change", "named"),
    [
        ("Operation", lambda fields: [*fields, ("further", ctypes.c_double)], "Operation"),
        ("Operation", lambda fields: swapped(fields, "function", "instance"), r"Operation\.function"),
        ("Operation", lambda fields: swapped(fields, "first", "n"), r"Operation\.first"),
        ("Extrapolated", lambda fields: swapped(fields, "derivatives", "history"), r"Extrapolated\.derivatives"),
        ("Loop", lambda fields: swapped(fields, "n_samples", "first_sample"), r"Loop\.first_sample"),
        ("Loop", lambda fields: [(f"{n}s" if n == "point" else n, c) for n, c in fields], r"Loop\.point"),
    ],
    ids=["longer", "pointers", "integers", "rates", "loop", "renamed"],
)
def test_a_library_with_another_layout_is_refused(
    reloaded: None, fmus: Path, monkeypatch: pytest.MonkeyPatch, struct: str, change: Any, named: str
) -> None:
    fields = change(list(getattr(cosim.loop.binding, struct)._fields_))
    other = type(struct, (ctypes.Structure,), {"_fields_": fields})
    monkeypatch.setattr(cosim.loop.binding, struct, other)
    with pytest.raises(LoopLibraryError, match=rf"lays out its data in another way than Python: {named}$"):
        Simulation(integrator(fmus))


def test_after_a_refused_library_the_right_one_is_loaded(reloaded: None, fmus: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cosim.loop.binding, "source_hash", lambda: "other")
        with pytest.raises(LoopLibraryError):
            simulate(integrator(fmus), 1.0, 0.5)
    assert simulate(integrator(fmus), 1.0, 0.5)["i.x"] == pytest.approx([0.0, 0.5, 1.0], rel=1e-12)


# Where it stops


def journal(path: Path) -> list[float]:
    """Start times of the steps that a probe has done."""
    return [float(line) for line in path.read_text().split()] if path.exists() else []


@pytest.fixture(scope="module")
def three(probe: Path) -> Iterator[dict[str, Simulation]]:
    """Three probes in a row, in both orders."""
    system = System()
    for name in ("before", "middle", "after"):
        system.add(name, probe, start={"n": 0, "e": 1, "b": False})
    system.drive("before.u", lambda t: 1.0 + t)
    system.connect("before.y", "middle.u")
    system.connect("middle.y", "after.u")
    with ExitStack() as stack:
        yield {order: stack.enter_context(Simulation(system, order=order)) for order in ("sequential", "parallel")}


def start(folder: Path, **middle: float) -> dict[str, object]:
    """Start values of the three: each keeps a journal, and the middle one fails."""
    journals = {f"{name}.journal": str(folder / name) for name in ("before", "middle", "after")}
    return journals | {f"middle.{name}": value for name, value in middle.items()}


def failing(
    simulation: Simulation, folder: Path, points: int, record_every: int = 1, **middle: float
) -> SimulationError:
    with pytest.raises(SimulationError) as failed:
        simulation.run(points * H, H, start=start(folder, **middle), record_every=record_every)
    return failed.value


@pytest.mark.parametrize("chunk", [1, 7, 64, 1 << 16])
@pytest.mark.parametrize("point", [0, 1, 63, 64, 65, 1000])
def test_a_step_that_fails_ends_the_run_at_this_very_step(
    three: dict[str, Simulation], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, point: int, chunk: int
) -> None:
    monkeypatch.setattr(chunks, "FIRST", chunk)
    error = failing(three["sequential"], tmp_path, 1100, fail_at=point * H, status=ERROR, where=DO_STEP)
    assert str(error) == f"middle failed at t = {point * H:.9g} s: fmi2DoStep returned error"
    assert (error.component, error.time) == ("middle", point * H)
    # the step follows its point, which is recorded
    assert error.results.time.tolist() == [i * H for i in range(point + 1)]
    assert (error.results["after.y"] == 1.0 + error.results.time).all()
    assert error.results.info["status"] == "failed"
    times = [i * H for i in range(point + 1)]
    assert journal(tmp_path / "before") == times
    assert journal(tmp_path / "middle") == times
    assert journal(tmp_path / "after") == times[:-1]  # nobody goes on after a failure


@pytest.mark.parametrize("order", ["sequential", "parallel"])
@pytest.mark.parametrize(("where", "function"), [(SET_REAL, "fmi2SetReal"), (GET_REAL, "fmi2GetReal")])
@pytest.mark.parametrize("point", [0, 1, 63, 64, 65, 1000])
def test_an_exchange_that_fails_ends_the_run_at_this_very_point(
    three: dict[str, Simulation], tmp_path: Path, point: int, where: int, function: str, order: str
) -> None:
    error = failing(three[order], tmp_path, 1100, fail_at=point * H, status=ERROR, where=where)
    assert str(error) == f"middle failed at t = {point * H:.9g} s: {function} returned error"
    assert error.results.time.tolist() == [i * H for i in range(point)]  # this point is not complete
    for name in ("before", "middle", "after"):
        assert journal(tmp_path / name) == [i * H for i in range(point)]


def test_an_exchange_may_fail_at_the_last_point_where_no_step_follows(
    three: dict[str, Simulation], tmp_path: Path
) -> None:
    error = failing(three["sequential"], tmp_path, 100, fail_at=100 * H, status=ERROR, where=GET_REAL)
    assert error.time == 100 * H
    assert len(error.results.time) == 100
    in_a_step = start(tmp_path, fail_at=100 * H, status=ERROR, where=DO_STEP)
    assert len(three["sequential"].run(100 * H, H, start=in_a_step).time) == 101


@pytest.mark.parametrize(("status", "name"), [(ERROR, "error"), (FATAL, "fatal")])
def test_the_status_of_a_failure_is_named(three: dict[str, Simulation], tmp_path: Path, status: int, name: str) -> None:
    error = failing(three["sequential"], tmp_path, 10, fail_at=3 * H, status=status)
    assert str(error) == f"middle failed at t = {3 * H:.9g} s: fmi2DoStep returned {name}"


def test_an_fmu_that_discards_any_step_or_never_says_that_it_is_ready_fails(
    three: dict[str, Simulation], tmp_path: Path
) -> None:
    error = failing(three["sequential"], tmp_path, 10, fail_at=3 * H, status=DISCARD)
    assert str(error).startswith(f"middle failed at t = {3 * H:.9g} s: fmi2DoStep did not finish the step of {H:.9g} s")
    error = failing(three["sequential"], tmp_path, 10, fail_at=3 * H, status=5)
    pending = "fmi2DoStep returned pending, and then fmi2GetStatus returned error"
    assert str(error) == f"middle failed at t = {3 * H:.9g} s: {pending}"


@pytest.mark.parametrize("status", [6, -1])
def test_a_status_that_fmi_does_not_know_is_a_failure_too(
    three: dict[str, Simulation], tmp_path: Path, status: int
) -> None:
    error = failing(three["sequential"], tmp_path, 10, fail_at=3 * H, status=status)
    assert str(error).endswith(f"fmi2DoStep returned {status}")


@pytest.mark.parametrize("where", [DO_STEP, SET_REAL, GET_REAL])
def test_a_warning_is_no_failure(three: dict[str, Simulation], tmp_path: Path, where: int) -> None:
    r = three["sequential"].run(10 * H, H, start=start(tmp_path, fail_at=0.0, status=WARNING, where=where))
    assert r["after.y"].tolist() == [1.0 + i * H for i in range(11)]


@pytest.mark.parametrize("every", [2, 3])
def test_a_slow_component_fails_at_its_own_points_only(probe: Path, every: int) -> None:
    system = System()
    start = {"n": 0, "e": 1, "b": False, "fail_at": 7 * H, "status": ERROR}
    system.add("slow", probe, start=start, every=every)
    system.drive("slow.u", lambda t: t)
    with pytest.raises(SimulationError, match="slow failed") as failed:
        simulate(system, 20 * H, H)
    own = -(-7 // every) * every
    assert failed.value.time == own * H
    assert len(failed.value.results.time) == own + 1


# What it records


@pytest.mark.parametrize("record_every", [2, 3, 7, 64, 100, 1000, 5000])
def test_record_every_takes_every_so_many_rows(three: dict[str, Simulation], record_every: int) -> None:
    every = three["sequential"].run(1000 * H, H)
    some = three["sequential"].run(1000 * H, H, record_every=record_every)
    assert some.info["record_every"] == record_every
    assert some.time.tobytes() == every.time[::record_every].tobytes()
    assert some.values.tobytes() == every.values[::record_every].tobytes()


@pytest.mark.parametrize("record_every", [0, -1, 1.0, True, "2", None])
def test_record_every_must_be_a_positive_whole_number(three: dict[str, Simulation], record_every: object) -> None:
    with pytest.raises(SetupError, match=r"record_every = .* must be a positive whole number of steps"):
        three["sequential"].run(1.0, 0.5, record_every=record_every)


@pytest.mark.parametrize("exponent", [31, 32, 63, 64, 4000])
def test_numbers_of_steps_that_the_loop_can_not_count_are_refused(three: dict[str, Simulation], exponent: int) -> None:
    with pytest.raises(SetupError, match="component 'a': every must be at most 2147483647"):
        System().add("a", "a.fmu", every=2**exponent)
    if exponent > 60:
        with pytest.raises(SetupError, match=r"record_every must be below 1e\+10 steps"):
            three["sequential"].run(1.0, 0.5, record_every=2**exponent)


@pytest.mark.parametrize("record_every", [1, 2, 3, 64])
@pytest.mark.parametrize("point", [0, 1, 63, 64, 65, 192])
def test_a_failed_run_has_the_rows_up_to_its_failure(
    three: dict[str, Simulation], tmp_path: Path, record_every: int, point: int
) -> None:
    for where, last in ((DO_STEP, point), (GET_REAL, point - 1)):
        failure = {"fail_at": point * H, "status": ERROR, "where": where}
        error = failing(three["sequential"], tmp_path, 200, record_every, **failure)
        assert error.results.time.tolist() == [i * H for i in range(0, last + 1, record_every)]
        assert (error.results["after.y"] == 1.0 + error.results.time).all()


# Values of all types

EXTREMES = {
    "Float64": (math.pi, -1.7976931348623157e308, 5e-324, -0.0),
    "Float32": (float(np.float32(0.1)), -3.4028234663852886e38, 2.0**-149, -0.0),
    "Boolean": (1, 0, 0, 1),
    **{f"Int{n}": (-(2 ** (n - 1)), 2 ** (n - 1) - 1, -1, 0) for n in (8, 16, 32)},
    **{f"UInt{n}": (0, 2**n - 1, 2 ** (n - 1), 1) for n in (8, 16, 32)},
    # values that no double holds
    "Int64": (-(2**63), 2**63 - 1, 2**53 + 1, 0),
    "UInt64": (0, 2**64 - 1, 2**63 + 1, 1),
}


def recorded_type(kind: str) -> type:
    """Type of NumPy in which results have values of a type."""
    if kind.startswith("Float"):
        return np.float64
    return np.bool_ if kind == "Boolean" else np.uint64 if kind == "UInt64" else np.int64


@pytest.mark.parametrize(("order", "delay"), [("sequential", 0), ("parallel", 3)])
def test_arrays_of_all_types_of_fmi_3_pass_unchanged(types: Path, order: str, delay: int) -> None:
    """Whole from the first to the second FMU, and with their elements exchanged to the third."""

    def signal(values: tuple[float, ...]) -> Callable[[float], list[float]]:
        return lambda t: [values[min(int(t), 3)], values[3 - min(int(t), 3)]]

    system = System()
    for name in "abc":
        system.add(name, types)
    for kind in FMI3_TYPES:
        system.drive(f"a.{kind}", signal(EXTREMES[kind]))
        system.connect(f"a.{kind}_out", f"b.{kind}")
        system.connect(f"b.{kind}_out[2]", f"c.{kind}[1]")
        system.connect(f"b.{kind}_out[1]", f"c.{kind}[2]")
    r = simulate(system, 3.0 + delay, 1.0, order=order)
    for kind in FMI3_TYPES:
        expected = np.array([[EXTREMES[kind][3 - i], EXTREMES[kind][i]] for i in range(4)], dtype=recorded_type(kind))
        found = r[f"c.{kind}_out"][delay:]
        assert (found.dtype, found.tobytes()) == (expected.dtype, expected.tobytes()), kind  # also the sign of a zero


def test_the_largest_integers_of_64_bits_stay_the_largest(types: Path) -> None:
    """The nearest double is one more than they are."""
    system = System()
    others = {kind: 0 for kind in FMI3_TYPES if kind not in ("Int64", "UInt64")}
    system.add("a", types, start=others | {"Int64": 0, "UInt64": 0})
    system.add("b", types, start=others)
    for kind in ("Int64", "UInt64"):
        system.connect(f"a.largest_{kind}", f"b.{kind}")
    r = simulate(system, 1.0, 1.0)
    assert r["b.Int64_out"].tolist() == [[2**63 - 1] * 2] * 2
    assert r["b.UInt64_out"].tolist() == [[2**64 - 1] * 2] * 2


def test_all_types_of_fmi_2_pass_unchanged(probe: Path) -> None:
    values = {
        "u": EXTREMES["Float64"],
        "n": EXTREMES["Int32"],
        "e": (1, 2, 1, 2),
        "b": (0, 1, 1, 0),
    }
    system = System()
    for name in "ab":
        system.add(name, probe)
    for variable, of_variable in values.items():
        system.drive(f"a.{variable}", lambda t, of_variable=of_variable: of_variable[int(t)])
        system.connect("a.y" if variable == "u" else f"a.{variable}_out", f"b.{variable}")
    r = simulate(system, 3.0, 1.0)
    for variable, of_variable in values.items():
        found = r["b.y" if variable == "u" else f"b.{variable}_out"]
        kind = {"u": "Float64", "n": "Int64", "e": "Int64", "b": "Boolean"}[variable]
        assert found.tobytes() == np.array(of_variable, dtype=recorded_type(kind)).tobytes(), variable


def test_integers_pass_between_both_versions(probe: Path, types: Path) -> None:
    values = EXTREMES["Int32"]
    system = System()
    system.add("old", probe, start={"u": 0.0, "e": 1})
    system.add("new", types, start={name: 0 for name in FMI3_TYPES if name not in ("Int32", "Boolean")})
    system.add("last", probe, start={"u": 0.0, "e": 1})
    system.drive("old.n", lambda t: values[int(t)])
    system.drive("old.b", lambda t: int(t) % 2)
    for name, kind in (("n", "Int32"), ("b", "Boolean")):
        for i in (1, 2):
            system.connect(f"old.{name}_out", f"new.{kind}[{i}]")
        system.connect(f"new.{kind}_out[2]", f"last.{name}")
    r = simulate(system, 3.0, 1.0)
    assert r["last.n_out"].tolist() == list(values)
    assert r["last.b_out"].tolist() == [0, 1, 0, 1]


# All kinds of FMUs in one system

MIXED = [*((f, f, f) for f in FLAVOURS), *itertools.permutations(FLAVOURS)]


def test_fmus_of_all_flavours_in_one_system_are_as_those_of_one_flavour(fmus: Path) -> None:
    """The models are the same to the last bit, and so are the runs; inputs are held, since pythonfmu's can't but be."""

    def run(flavours: tuple[str, ...], order: str) -> Results:
        first, gain, second = flavours
        system = System()
        system.add("i", fmus / first / "Integrator.fmu", start={"x_start": 1.0, "T": 0.7})
        system.add("g", fmus / gain / "Gain.fmu", start={"K": -1.3})
        system.add("j", fmus / second / "Integrator.fmu", start={"x_start": -0.2}, every=2)
        system.connect("i.x", "g.u[1]")
        system.connect("j.x", "g.u[2]")
        system.connect("g.y[1]", "j.u")
        system.connect("g.y[2]", "i.u")
        return simulate(system, 2.0, 0.05, order=order, extrapolation="hold")

    for order in ("sequential", "parallel"):
        runs = [run(flavours, order) for flavours in MIXED]
        assert np.ptp(runs[0]["i.x"]) > 0.1
        assert len({r.values.tobytes() for r in runs}) == 1
