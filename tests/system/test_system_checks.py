"""Every check before a run: what is wrong, where, and the remedy stand in one line; nothing has run by then."""

from __future__ import annotations

import gc
import math
import os
import re
import shutil
import zipfile
from pathlib import Path

import fmpy
import pytest

from cosim import CosimError, SetupError, SimulationError, System, simulate
from tests.support import some
from tests.support.changed_fmus import rewritten
from tests.support.tiny_models import build


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("tiny"))


@pytest.fixture
def system(tiny: Path) -> System:
    """Two gains, the first driven, the second fed by it."""
    system = System()
    system.add("first", tiny / "Gain.fmu")
    system.add("second", tiny / "Gain.fmu")
    system.drive("first.u", lambda t: t)
    system.connect("first.y", "second.u")
    return system


def refused(system: System, *parts: str, stop: float = 1.0, step: float = 0.5, **options) -> str:
    """Message of the SetupError, in which all parts must stand."""
    with pytest.raises(SetupError) as error:
        simulate(system, stop, step, **options)
    message = str(error.value)
    for part in parts:
        assert part in message
    assert "\n" not in message
    assert isinstance(error.value, CosimError)
    return message


def test_the_system_of_these_tests_runs(system):
    assert simulate(system, 1.0, 0.5)["second.y"].tolist() == [[4 * t, 4 * t] for t in (0.0, 0.5, 1.0)]


def test_the_fmus_of_these_tests_are_valid(tiny):
    for path in some(tiny.glob("*.fmu")):
        assert fmpy.validation.validate_fmu(str(path)) == []


# Names


@pytest.mark.parametrize("name", ["", "a.b", "."])
def test_component_names_without_text_or_with_dots_are_refused(system, tiny, name):
    with pytest.raises(SetupError, match=rf"{re.escape(repr(name))} must be a non-empty text without a dot"):
        system.add(name, tiny / "Gain.fmu")


def test_two_components_of_one_name_are_refused(system, tiny):
    with pytest.raises(SetupError, match="two components named 'first'; give each its own name"):
        system.add("first", tiny / "Lag.fmu")


@pytest.mark.parametrize("every", [0, -1, 1.0, 2.5, True, "2", None, math.nan])
def test_every_must_be_a_positive_integer(system, tiny, every):
    with pytest.raises(SetupError, match=r"'third': every = .* must be a positive whole number"):
        system.add("third", tiny / "Gain.fmu", every=every)
    assert "third" not in system.components


@pytest.mark.parametrize(
    ("source", "target", "parts"),
    [
        ("frist.y", "second.u", ["'frist.y'", "no component 'frist'", "did you mean 'first'?"]),
        ("first.y", "scond.u", ["'scond.u'", "no component 'scond'", "did you mean 'second'?"]),
        ("qqq.y", "second.u", ["no component 'qqq'", "known are first, second"]),
        ("first.yy", "second.u", ["component 'first' has no variable 'yy'", "did you mean 'y'?"]),
        ("first.y[3]", "second.u", ["component 'first' has no variable 'y[3]'", "did you mean 'y["]),
        ("first.Y", "second.u", ["no variable 'Y'", "known are u, y"]),
        ("first", "second.u", ["'first' must be written as component.variable"]),
        ("first.", "second.u", ["component 'first' has no variable ''"]),
        ("", "second.u", ["'' must be written as component.variable"]),
    ],
)
def test_wrong_names_in_connections(system, source, target, parts):
    system.connect(source, target)
    refused(system, *parts)


def test_wrong_names_in_signals_start_values_and_records(system, tiny):
    refused(system, "'second' has no variable 'yy'", "did you mean 'y'?", record=["second.yy"])
    refused(system, "no component 'secnd'", "'second'", record=["secnd.y"])
    refused(system, "must be written as component.variable", record=["y"])
    system.add("third", tiny / "Lag.fmu", start={"x_strat": 1.0, "u": 0.0})
    refused(system, "'third' has no variable 'x_strat'", "did you mean 'x_start'?")
    system.signals.clear()
    system.drive("first.uu", lambda t: t)
    refused(system, "'first' has no variable 'uu'")


# Causality, types, units, sizes


@pytest.mark.parametrize(
    ("source", "target", "parts"),
    [
        ("first.u", "second.u", ["'first.u' is an input", "source of a connection", "an output"]),
        ("first.K", "second.u[1]", ["'first.K' is a parameter", "source of a connection"]),
        ("first.y", "second.y", ["'second.y' is an output", "target of a connection", "an input"]),
        ("first.y[1]", "second.K", ["'second.K' is a parameter", "target of a connection"]),
        ("first.y", "second.u[1]", ["'first.y' -> 'second.u[1]'", "2 values can't feed 1", "one by one"]),
        ("first.y[1]", "second.u", ["1 values can't feed 2"]),
    ],
)
def test_wrong_causality_and_size_in_connections(system, source, target, parts):
    system.connections[:] = []
    system.connect(source, target)
    refused(system, *parts)


def test_signals_feed_inputs_only(system):
    system.drive("second.y", lambda t: t)
    refused(system, "'second.y' is an output", "target of a signal", "an input")
    system.signals[-1:] = []
    system.drive("second.K", lambda t: t)
    refused(system, "'second.K' is a parameter")


def test_types_must_match(system, tiny, tmp_path):
    integer = rewritten(
        tiny / "Fragile.fmu",
        tmp_path / "Integer.fmu",
        description='<Real unit="1" start="1.0" /> => <Integer start="1"/>',
    )
    system.add("third", integer)
    system.connect("second.y[1]", "third.u")
    # variability="continuous" is left over from the real; the kinds are compared all the same
    refused(system, "'second.y[1]' -> 'third.u'", "real and integer don't match")


def test_units_must_match(system, tiny):
    system.add("a", tiny / "Units.fmu", start={"torque": 1.0, "length": 2.0})
    system.add("b", tiny / "Units.fmu", start={"torque": 1.0})
    system.connect("a.energy", "b.length")
    refused(system, "'a.energy' -> 'b.length'", "units 'J' and 'm' don't match", "units='ignore'")
    system.connections[-1:] = []
    system.connect("first.y[1]", "b.length")
    refused(system, "units '1' and 'm' don't match")


def test_units_of_equal_base_units_match(tiny):
    system = System()
    system.add("a", tiny / "Units.fmu", start={"torque": 3.0, "length": 2.0})
    system.add("b", tiny / "Units.fmu")
    system.connect("a.energy", "b.torque")  # J and N.m: both kg.m2/s2
    system.connect("a.place", "b.length")
    assert simulate(system, 1.0, 0.5)["b.energy"].tolist() == [3.0] * 3


@pytest.mark.parametrize("attribute", ["factor", "offset"])
def test_units_of_another_factor_or_offset_do_not_match(tiny, tmp_path, attribute):
    change = f'<Unit name="m"><BaseUnit m="1" => <Unit name="mm"><BaseUnit m="1" {attribute}="0.001"'
    with zipfile.ZipFile(tiny / "Units.fmu") as archive:
        text = re.sub(r">\s+<", "><", archive.read("modelDescription.xml").decode()).replace('unit="m"', 'unit="mm"')
    before, after = change.split(" => ")
    assert before in text
    other = rewritten(tiny / "Units.fmu", tmp_path / "mm.fmu", **{"modelDescription.xml": text.replace(before, after)})
    system = System()
    system.add("a", tiny / "Units.fmu", start={"torque": 3.0, "length": 2.0})
    system.add("b", other, start={"torque": 0.0})
    system.connect("a.place", "b.length")
    refused(system, "units 'm' and 'mm' don't match")


def test_no_unit_matches_every_unit(tiny, tmp_path):
    other = rewritten(tiny / "Units.fmu", tmp_path / "none.fmu", description='unit="m" => ')
    system = System()
    system.add("a", tiny / "Units.fmu", start={"torque": 3.0, "length": 2.0})
    system.add("b", other, start={"length": 0.0})
    system.connect("a.place", "b.torque")
    refused(system, "'m' and 'N.m'")
    system.connections[:] = []
    system.components["b"].start["torque"] = 0.0
    system.connect("a.place", "b.length")
    assert simulate(system, 1.0, 0.5)["b.place"].tolist() == [2.0] * 3


# Feeding


def test_an_input_fed_by_two_connections_is_refused(system, tiny):
    system.add("third", tiny / "Gain.fmu", start={"u": 0.0})
    system.connect("third.y[2]", "second.u[2]")
    refused(system, "'second.u[2]' is fed twice, by 'first.y[2]' and by 'third.y[2]'", "remove one")


def test_one_connection_made_twice_is_refused(system):
    system.connect("first.y", "second.u")
    refused(system, "'second.u[1]' is fed twice")


def test_an_input_fed_by_a_connection_and_a_signal_is_refused(system):
    system.drive("second.u[1]", lambda t: t)
    refused(system, "'second.u[1]' is fed twice, by 'first.y[1]' and by a signal", "remove one")


def test_an_input_fed_by_two_signals_is_refused(system):
    system.drive("first.u[2]", lambda t: -t)
    refused(system, "'first.u[2]' is fed twice", "remove one")


def test_undriven_inputs_are_all_named_with_the_remedies_where_they_are_an_error(system):
    system.connections[:] = []
    refused(system, "'second.u[1]', 'second.u[2]'", "connect", "signal", "start value", strict_inputs=True)
    system.connect("first.y[1]", "second.u[1]")
    message = refused(system, "'second.u[2]'", strict_inputs=True)
    assert "second.u[1]" not in message


def test_undriven_inputs_keep_the_start_values_of_their_fmu_and_the_summary_names_them(system):
    system.connections[:] = []
    system.connect("first.y[1]", "second.u[1]")
    results = simulate(system, 1.0, 0.5)
    assert results.info["inputs_kept"] == ["second.u[2]"]
    assert results["second.u[2]"].tolist() == [0.0] * 3
    assert results["second.u[1]"].tolist() == results["first.y[1]"].tolist()


def test_an_input_with_a_start_value_needs_no_connection(system, tiny):
    system.add("third", tiny / "Gain.fmu", start={"u": [1.0, 2.0]})
    assert simulate(system, 1.0, 0.5)["third.y"].tolist() == [[2.0, 4.0]] * 3


# Start values


@pytest.mark.parametrize(
    ("model", "start", "parts"),
    [
        ("Gain", {"y": 1.0}, ["'c.y'", "output variables can't be set", "parameters and inputs only"]),
        ("Gain", {"u": [1.0, 2.0, 3.0]}, ["'c.u'", "3 values were given for 2"]),
        ("Gain", {"u": []}, ["'c.u'", "0 values were given for 2"]),
        ("Gain", {"K": [1.0, 2.0]}, ["'c.K'", "2 values were given for 1"]),
        ("Gain", {"K": math.nan}, ["'c.K'", "nan is not a finite number"]),
        ("Gain", {"u": [1.0, math.inf]}, ["'c.u'", "inf is not a finite number"]),
        ("Gain", {"K": None}, ["'c.K'", "None is not a number"]),
        ("Gain", {"K": "two"}, ["'c.K'", "'two' is not a number"]),
        ("Gain", {"K": {}}, ["'c.K'", "{} is not a number"]),
        ("Gain", {"K": 1j}, ["'c.K'", "1j is not a number"]),
        ("Gain", {"u": [[1.0], [2.0, 3.0]]}, ["'c.u'", "is not a number"]),
        ("Gain", {"K": 10.5}, ["'c.K'", "10.5 is out of bounds", "between -10.0 and 10.0"]),
        ("Gain", {"K": -10.5}, ["'c.K'", "-10.5 is out of bounds", "between -10.0 and 10.0"]),
        ("Lag", {"T": 0.0}, ["'c.T'", "0.0 is out of bounds", "at least 1e-06"]),
    ],
)
def test_wrong_start_values(tiny, model, start, parts):
    system = System()
    system.add("c", tiny / f"{model}.fmu", start={"u": 0.0, **start})
    refused(system, *parts)


@pytest.mark.parametrize("K", [-10.0, 10.0, 3])
def test_bounds_are_inclusive_and_whole_numbers_will_do(tiny, K):
    system = System()
    system.add("c", tiny / "Gain.fmu", start={"u": 1.0, "K": K})
    assert simulate(system, 1.0, 1.0)["c.y"].tolist() == [[float(K)] * 2] * 2


# Algebraic loops


def loop(tiny: Path) -> System:
    system = System()
    system.add("a", tiny / "Gain.fmu", start={"u[2]": 0.0})
    system.add("b", tiny / "Gain.fmu", start={"u[2]": 0.0})
    system.connect("a.y[1]", "b.u[1]")
    system.connect("b.y[1]", "a.u[1]")
    return system


def test_an_algebraic_loop_is_named_with_the_remedy(tiny):
    message = refused(loop(tiny), "algebraic loop", "order='parallel'")
    path = re.search(r"algebraic loop (.*?):", message)[1].split(" -> ")
    assert path[0] == path[-1]
    assert set(path) == {"a.u[1]", "a.y[1]", "b.u[1]", "b.y[1]"}
    assert path[path.index("a.y[1]") + 1 if path.index("a.y[1]") + 1 < len(path) else 1] == "b.u[1]"


def test_a_component_in_a_loop_with_itself(tiny):
    system = System()
    system.add("a", tiny / "Gain.fmu")
    system.connect("a.y[1]", "a.u[1]")
    system.drive("a.u[2]", lambda t: t)
    refused(system, "algebraic loop", "a.y[1]", "a.u[1]")
    system.connections[:] = []
    system.connect("a.y[1]", "a.u[2]")  # y[2] depends on u[2] only: no loop
    system.signals[:] = []
    system.drive("a.u[1]", lambda t: t)
    assert simulate(system, 1.0, 1.0)["a.y"].tolist() == [[0.0, 0.0], [2.0, 4.0]]


def test_undeclared_dependencies_count_as_direct_feedthrough(tiny, tmp_path):
    with zipfile.ZipFile(tiny / "Integrator.fmu") as archive:
        text = archive.read("modelDescription.xml").decode()
    assert ' dependencies=""' in text
    text = re.sub(r' dependencies(Kind)?="[^"]*"', "", text)
    unsure = rewritten(tiny / "Integrator.fmu", tmp_path / "Unsure.fmu", **{"modelDescription.xml": text})
    for fmu, is_loop in ((tiny / "Integrator.fmu", False), (unsure, True)):
        system = System()
        system.add("a", fmu)
        system.connect("a.x", "a.u")
        if is_loop:
            refused(system, "algebraic loop", "declare which inputs")
        else:
            simulate(system, 1.0, 0.5)
        simulate(system, 1.0, 0.5, order="parallel")


# FMU files


def broken(tiny: Path, folder: Path, kind: str) -> Path:
    source, target = tiny / "Gain.fmu", folder / "broken.fmu"
    if kind == "folder":
        target.mkdir()
    elif kind == "not a zip":
        target.write_bytes(b"not a zip archive")
    elif kind == "empty":
        target.write_bytes(b"")
    elif kind == "truncated":
        target.write_bytes(source.read_bytes()[:-1000])
    elif kind == "damaged binary":
        with zipfile.ZipFile(source) as archive:
            info = archive.getinfo("binaries/linux64/Gain.so")
        data = bytearray(source.read_bytes())
        middle = info.header_offset + info.compress_size // 2
        data[middle : middle + 16] = bytes(16)
        target.write_bytes(bytes(data))
    elif kind == "no description":
        rewritten(source, target, **{"modelDescription.xml": None})
    elif kind == "bad xml":
        rewritten(source, target, **{"modelDescription.xml": "<fmiModelDescription"})
    elif kind == "other xml":
        rewritten(source, target, **{"modelDescription.xml": "<html/>"})
    elif kind == "FMI 4.0":
        rewritten(source, target, description='fmiVersion="2.0" => fmiVersion="4.0"')
    elif kind == "model exchange":
        rewritten(source, target, description="<CoSimulation => <ModelExchange")
    elif kind == "no binary":
        rewritten(source, target, **{f"binaries/{fmpy.platform}/": None})
    elif kind == "other library":
        rewritten(source, target, **{f"binaries/{fmpy.platform}/": b"not a library"})
    elif kind == "other identifier":
        rewritten(source, target, description='modelIdentifier="Gain" => modelIdentifier="Other"')
    elif kind == "path with drive":
        shutil.copy(source, target)
        with zipfile.ZipFile(target, "a") as archive:
            archive.writestr("C:/file", "")
    return target


FILES = [
    ("missing", "there is no such FMU file"),
    ("folder", "there is no such FMU file"),
    ("not a zip", "not an FMU (not a zip archive)"),
    ("empty", "not an FMU (not a zip archive)"),
    ("truncated", "not an FMU (not a zip archive)"),
    ("damaged binary", "can't be unpacked"),
    ("no description", "modelDescription.xml"),
    ("bad xml", "not a readable FMU"),
    ("other xml", "not a readable FMU"),
    ("FMI 4.0", "is of FMI '4.0'"),
    ("model exchange", "lacks the function fmi2SetTime"),
    ("no binary", f"has no binary for {fmpy.platform}"),
    ("other library", "can't be loaded"),
    ("other identifier", f"has no binaries/{fmpy.platform}/Other"),
    ("path with drive", "can't be unpacked"),
]


@pytest.mark.parametrize(("kind", "part"), FILES, ids=[k for k, _ in FILES])
def test_files_that_are_no_fmus_are_named_with_their_component(system, tiny, tmp_path, kind, part):
    if kind == "damaged binary" and not fmpy.platform.startswith("linux64"):
        pytest.skip("the damaged member is the Linux binary")
    before = Path.cwd()
    path = broken(tiny, tmp_path, kind)
    system.add("third", path, start={"u": 0.0})
    try:
        refused(system, "component 'third'", str(path), part)
        assert Path.cwd() == before, "the working directory must not change"
    finally:
        os.chdir(before)
    gc.collect()  # a file left open would warn here, which is an error


def test_binaries_of_other_platforms_are_listed(system, tiny, tmp_path):
    system.add("third", broken(tiny, tmp_path, "no binary"), start={"u": 0.0})
    assert re.search(r"\(it has: (win64|linux64)\)", refused(system, "get one built for this platform"))


def test_an_archive_that_unpacks_to_too_much_is_not_opened(system, monkeypatch):
    monkeypatch.setattr("cosim.fmi.archive.members.MOST_UNPACKED_BYTES", 1000)
    refused(system, "component 'first'", "unpacks to", "not opened")


# Times and options


@pytest.mark.parametrize(
    ("stop", "step", "start", "parts"),
    [
        (1.0, 0.0, 0.0, ["step 0.0 s must be positive"]),
        (1.0, -0.1, 0.0, ["step -0.1 s must be positive"]),
        (1.0, math.nan, 0.0, ["step nan s is not a finite number"]),
        (1.0, math.inf, 0.0, ["step inf s is not a finite number"]),
        (math.nan, 0.1, 0.0, ["stop time nan s is not a finite number"]),
        (math.inf, 0.1, 0.0, ["stop time inf s is not a finite number"]),
        (1.0, 0.1, -math.inf, ["start time -inf s is not a finite number"]),
        (0.0, 0.1, 0.0, ["stop time 0.0 s must be later than the start time 0.0 s"]),
        (-1.0, 0.1, 0.0, ["stop time -1.0 s must be later"]),
        (1.0, 0.1, 2.0, ["stop time 1.0 s must be later than the start time 2.0 s"]),
        (1.0, 0.3, 0.0, ["1 s is not a whole number of steps of 0.3 s", "stop at 0.9 s or 1.2 s"]),
        (3.0, 0.3, 2.0, ["1 s is not a whole number of steps of 0.3 s", "stop at 2.9 s or 3.2 s"]),
        (1.0, 3.0, 0.0, ["1 s is not a whole number of steps of 3.0 s", "stop at 3 s"]),
        (1e300, 1e-300, 0.0, ["step"]),  # no count of steps is so large
        (1.0, 1e-17, 0.0, ["step"]),  # no memory holds so many rows
        (2.0**53 + 2.0, 0.5, 2.0**53, ["step"]),  # communication points that can't be told apart
    ],
)
def test_wrong_times(system, stop, step, start, parts):
    refused(system, *parts, stop=stop, step=step, start_time=start)


@pytest.mark.parametrize(("stop", "step", "n"), [(0.3, 0.1, 3), (0.7, 0.1, 7), (15.0, 1e-3, 15000), (1.0, 1 / 3, 3)])
def test_durations_that_are_whole_but_for_rounding_are_accepted(tiny, stop, step, n):
    system = System()
    system.add("c", tiny / "Fragile.fmu", start={"u": 1.0})
    assert len(simulate(system, stop, step, record=[]).time) == n + 1


def test_an_unknown_order_is_refused(system):
    refused(system, "order 'jacobi' is unknown; use 'sequential' (Gauss-Seidel) or 'parallel' (Jacobi)", order="jacobi")


def test_an_empty_system_is_refused():
    refused(System(), "the system has no components", "System.add")


# Signals


def raising(t: float) -> float:
    raise KeyError("no table")


@pytest.mark.parametrize(
    ("value", "parts"),
    [
        (raising, ["failed: KeyError: 'no table'"]),
        (lambda t: [1.0, 2.0, 3.0], ["gives 3 values, not 2"]),
        (lambda t: [], ["gives 0 values, not 2"]),
        (lambda t: [[1.0, 2.0]], ["shape"]),
        (lambda t: math.nan, ["nan", "not finite"]),
        (lambda t: [0.0, math.inf], ["inf", "not finite"]),
        (lambda t: [math.inf, -math.inf], ["inf", "not finite"]),
        (lambda t: None, ["not finite"]),
        (lambda t: "one", ["failed: ValueError"]),
    ],
)
def test_signals_are_tried_at_set_up_and_watched_during_the_run(system, value, parts):
    system.signals[:] = []
    system.drive("first.u", value)
    refused(system, "signal that feeds 'first.u", "at t = 0.0 s", *parts)
    system.signals[:] = []
    system.drive("first.u", lambda t: value(t) if t == 1.0 else 0.0)
    with pytest.raises(SimulationError) as failed:
        simulate(system, 1.5, 0.5)
    assert (failed.value.component, failed.value.time) == ("first", 1.0)
    assert failed.value.results.time.tolist() == [0.0, 0.5]
    for part in parts:
        assert part in str(failed.value)


def test_large_finite_signals_are_finite(system):
    system.signals[:] = []
    system.drive("first.u", lambda t: [1.5e308, 1.5e308])
    system.components["first"].start["K"] = 1.0
    system.components["second"].start["K"] = 1.0
    assert simulate(system, 1.0, 0.5)["second.y"].tolist() == [[1.5e308, 1.5e308]] * 3


def test_a_signal_of_one_number_feeds_a_whole_vector(system):
    assert simulate(system, 1.0, 0.5)["first.u"].tolist() == [[t, t] for t in (0.0, 0.5, 1.0)]


def test_nothing_is_instantiated_before_all_checks_have_passed(system, monkeypatch):
    def instantiated(*_: object) -> None:
        raise AssertionError("an FMU was instantiated")

    monkeypatch.setattr("cosim.master.loaded_components.Instance", instantiated)
    system.connect("first.y", "second.u")
    refused(system, "fed twice")
    system.connections.pop()
    with pytest.raises(AssertionError, match="an FMU was instantiated"):
        simulate(system, 1.0, 0.5)
