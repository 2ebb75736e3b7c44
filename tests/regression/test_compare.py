"""Comparison of results with a reference: what differs is found and named, what agrees is not."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.__main__ import main
from cosim.regression import Tolerance, ToleranceError, Tolerances, compare, compare_signals
from cosim.results.results import Results

TIME = np.arange(11) * 0.1
NAMES = ["plant.x_E", "plant.y_E", "controller.tau_a[1]"]


def made(time=TIME, names=None, **changes) -> Results:
    """x_E runs from 0 to 1 m, y_E from 0 to 2 m, the torque stays at 3 N.m."""
    names = NAMES if names is None else names
    columns = {"plant.x_E": time, "plant.y_E": 2.0 * time, "controller.tau_a[1]": np.full(len(time), 3.0)}
    values = (
        np.column_stack([columns.get(n, np.zeros(len(time))) for n in names]) if names else np.empty((len(time), 0))
    )
    for key, (row, value) in changes.items():
        values[row, [n.replace(".", "_") for n in names].index(key)] = value
    return Results(time=np.array(time), names=list(names), values=values)


# The function


def test_equal_results_agree_bit_for_bit():
    assert compare(made(), made()) == []
    assert compare(made(), made(), Tolerances(0.0, 0.0)) == []


@pytest.mark.parametrize("row", [0, 4, 10])
@pytest.mark.parametrize("sign", [1, -1])
def test_one_value_off_by_twice_the_tolerance_is_named_with_its_time(row, sign):
    result = made(plant_y_E=(row, 2.0 * TIME[row] + sign * 2e-3))
    findings = compare(result, made(), Tolerances(absolute=1e-3))
    assert len(findings) == 1
    assert "'plant.y_E'" in findings[0]
    assert f"at 1 of 11 times, most at t = {TIME[row]:.9g} s" in findings[0]
    assert "tolerance 0.001" in findings[0]
    assert f"{2.0 * TIME[row] + sign * 2e-3:.9g} instead of {2.0 * TIME[row]:.9g}" in findings[0]
    # half the tolerance is no finding
    assert compare(made(plant_y_E=(row, 2.0 * TIME[row] + sign * 5e-4)), made(), Tolerances(absolute=1e-3)) == []


def test_the_worst_time_is_named():
    result = made(plant_y_E=(3, 99.0))
    result.values[7, 1] = -500.0
    (finding,) = compare(result, made())
    assert "at 2 of 11 times, most at t = 0.7 s: -500 instead of 1.4" in finding


def test_relative_tolerance_is_of_the_range_of_the_reference_signal():
    tolerances = Tolerances(relative=1e-2)  # 0.01 m of x_E, 0.02 m of y_E
    assert compare(made(plant_x_E=(5, 0.5 + 0.009)), made(), tolerances) == []
    assert len(compare(made(plant_x_E=(5, 0.5 + 0.011)), made(), tolerances)) == 1
    assert compare(made(plant_y_E=(5, 1.0 + 0.019)), made(), tolerances) == []
    assert len(compare(made(plant_y_E=(5, 1.0 + 0.021)), made(), tolerances)) == 1


def test_a_wild_result_does_not_widen_its_own_tolerance():
    assert len(compare(made(plant_x_E=(5, 1e9)), made(), Tolerances(relative=0.1))) == 1


def test_a_constant_reference_has_no_range_and_needs_an_absolute_tolerance():
    result = made(**{"controller_tau_a[1]": (5, math.nextafter(3.0, 4.0))})
    assert len(compare(result, made(), Tolerances(relative=0.1))) == 1
    assert compare(result, made(), Tolerances(absolute=1e-12)) == []


def test_the_larger_of_both_tolerances_holds():
    result = made(plant_x_E=(5, 0.6))
    assert compare(result, made(), Tolerances(absolute=0.2, relative=0.0)) == []
    assert compare(result, made(), Tolerances(absolute=0.0, relative=0.2)) == []
    assert len(compare(result, made(), Tolerances(absolute=0.05, relative=0.05))) == 1


def test_all_signals_that_differ_are_named():
    findings = compare(made(plant_x_E=(1, 7.0), plant_y_E=(2, 7.0)), made())
    assert ["x_E" in f for f in findings] == [True, False]
    assert ["y_E" in f for f in findings] == [False, True]


def test_a_missing_signal_is_named_with_the_nearest():
    (finding,) = compare(made(names=["plant.x_E", "plant.y_e", "controller.tau_a[1]"]), made())
    assert finding == "'plant.y_E' is missing in the result; did you mean 'plant.y_e'?"


def test_a_result_with_no_signals_misses_them_all():
    assert [f.split()[0] for f in compare(made(names=[]), made())] == [f"'{n}'" for n in NAMES]


def test_further_signals_and_another_order_are_no_difference():
    assert compare(made(names=["new.signal", *reversed(NAMES)]), made()) == []


@pytest.mark.parametrize("rows", [0, 1, 10, 12])
def test_another_number_of_rows_is_one_finding(rows):
    findings = compare(made(time=np.arange(rows) * 0.1), made())
    assert findings == [f"the result has {rows} rows, the reference 11; run both with the same step and duration"]


def test_shifted_times_are_named_by_row():
    time = TIME.copy()
    time[3] += 1e-6
    (finding,) = compare(made(time=time), made())
    assert finding.startswith("row 4: time 0.3")
    assert f"{TIME[3]}" in finding
    (finding,) = compare(made(time=TIME + 0.05), made())
    assert finding.startswith("row 1: time 0.05")
    assert "np.float64" not in finding


def test_times_that_differ_by_rounding_agree():
    summed = np.cumsum([0.0, *[0.1] * 10])
    assert summed.tolist() != TIME.tolist()
    result = made()
    result.time[:] = summed
    assert compare(result, made()) == []


@pytest.mark.parametrize(
    ("start", "off", "agrees"),
    [
        (0.0, 9e-13, True),  # 1e-12 s and as much of the time
        (0.0, 1e-11, False),
        (0.0, 1e-9, False),
        (1e6, 5e-7, True),
        (1e6, 2e-6, False),
        (1e6, 1e-3, False),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_how_far_times_may_differ(start, off, agrees, sign):
    reference, result = made(), made()
    reference.time[:] = TIME + start
    result.time[:] = reference.time
    result.time[1] += sign * off
    findings = compare(result, reference)
    assert (findings == []) == agrees
    if not agrees:
        assert findings == [
            f"row 2: time {result.time[1].item()!r} s in the result, {reference.time[1].item()!r} s in the reference"
        ]


@pytest.mark.parametrize(
    ("row", "off", "agrees"),
    [
        (0, 9e-13, True),  # 1e-12 s and 1e-9 of the time
        (0, 1e-11, False),
        (0, 1e-6, False),
        (-1, 9e-7, True),  # of 1000 s
        (-1, 2e-6, False),
        (-1, 1e-3, False),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_how_far_the_ends_of_shifted_curves_may_differ(row, off, agrees, sign):
    time = np.linspace(0.0, 1000.0, 11)
    other = time.copy()
    other[row] += sign * off
    reference, result = (Results(t, ["x"], time[:, None] * 1.0) for t in (time, other))
    findings = compare(result, reference, Tolerances(absolute=1.0, time_shift=1.0))
    assert (findings == []) == agrees
    if not agrees:
        verb = "begins" if row == 0 else "ends"
        assert findings == [
            f"the result {verb} at t = {other[row].item()!r} s, the reference at {time[row].item()!r} s"
        ]


def test_times_may_stand_twice_in_shifted_curves():
    """As at an event of a model exchange: the value before and the value after."""
    time, values = np.array([0.0, 0.5, 0.5, 1.0]), np.array([[0.0], [0.0], [1.0], [1.0]])
    step, shift = Results(time, ["x"], values), Tolerances(relative=1e-3, time_shift=0.1)
    assert compare(step, step, shift) == []
    late = Results(np.array([0.0, 0.55, 0.55, 1.0]), ["x"], values)
    assert compare(late, step, shift) == []
    assert len(compare(Results(np.array([0.0, 0.65, 0.65, 1.0]), ["x"], values), step, shift)) == 1
    for name, pair in (("result", (made(time=TIME[::-1]), made())), ("reference", (made(), made(time=TIME[::-1])))):
        assert compare(*pair, Tolerances(time_shift=0.1)) == [f"the times of the {name} must increase"]


def test_a_time_shift_of_one_signal_leaves_the_others_at_their_times():
    """With the same times in both, a signal without a shift is compared at each."""
    tolerances = Tolerances(signals={"plant.x_E": Tolerance(relative=1e-3, time_shift=0.05)})
    moved = made(plant_y_E=(5, 1.1))
    moved.values[:, 0] = np.minimum(TIME + 0.04, 1.0)  # a ramp of 1 m/s: 40 ms early
    (finding,) = compare(moved, made(), tolerances)
    assert finding.startswith("'plant.y_E' differs at 1 of 11 times, most at t = 0.5 s: 1.1 instead of 1")
    moved.values[:, 0] = np.minimum(TIME + 0.07, 1.0)
    assert [f.split()[0] for f in compare(moved, made(), tolerances)] == ["'plant.x_E'", "'plant.y_E'"]


@pytest.mark.parametrize(
    ("known", "wanted", "finding"),
    [
        ("m", "m", ""),
        ("m", None, ""),
        ("mm", "m", "'plant.x_E' has the unit 'mm' in the result, 'm' in the tolerances"),
        ("", "m", "'plant.x_E' has the unit '' in the result, 'm' in the tolerances"),
        ("m", "", "'plant.x_E' has the unit 'm' in the result, '' in the tolerances"),
        ("", "", ""),
        (None, "m", ""),  # a file of results knows no units
    ],
)
def test_units_of_the_result_are_those_of_the_tolerances(known, wanted, finding):
    result = made()
    if known is not None:
        result.info["units"] = {"plant.x_E": known, "plant.y_E": "furlong"}
    tolerances = Tolerances(signals={"plant.x_E": Tolerance(unit=wanted)})
    assert compare(result, made(), tolerances) == ([finding] if finding else [])
    found = compare_signals(result, made(), tolerances).signals
    assert [signal.unit for signal in found] == [known or "", "" if known is None else "furlong", ""]


def test_a_tolerance_may_be_that_of_a_vector():
    result = made(**{"controller_tau_a[1]": (5, 3.5)})
    assert compare(result, made(), Tolerances(signals={"controller.tau_a": Tolerance(absolute=1.0)})) == []
    (finding,) = compare(result, made(), Tolerances(signals={"controller.tau": Tolerance(absolute=1.0)}))
    assert finding == (
        "there is a tolerance for 'controller.tau', which the reference lacks; did you mean 'controller.tau_a[1]'?"
    )


def test_what_is_told_of_a_signal_that_differs():
    found = compare_signals(made(plant_y_E=(4, 0.9)), made(), Tolerances(absolute=0.05, relative=0.0))
    x, y, _ = found.signals
    assert (x.finding, x.allowed, x.distance.max()) == ("", 0.05, 0.0)
    assert (y.name, y.worst, y.finding) == ("plant.y_E", 4, found.findings[0])
    assert y.distance == pytest.approx([0, 0, 0, 0, 0.1, 0, 0, 0, 0, 0, 0])
    assert y.lower.values == pytest.approx(2.0 * TIME - 0.05)
    assert y.upper.values == pytest.approx(2.0 * TIME + 0.05)
    assert (y.lower.time.tolist(), y.upper.time.tolist()) == (TIME.tolist(), TIME.tolist())


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("tolerances", [Tolerances(), Tolerances(absolute=1e300, relative=1e6)])
def test_a_value_that_is_no_number_is_never_within_a_tolerance(value, tolerances):
    (finding,) = compare(made(plant_x_E=(5, value)), made(), tolerances)
    assert f"'plant.x_E' differs at 1 of 11 times, most at t = 0.5 s: {value:.9g} instead of 0.5" in finding
    (finding,) = compare(made(), made(plant_x_E=(5, value)), tolerances)
    assert f"most at t = 0.5 s: 0.5 instead of {value:.9g}" in finding


def test_a_value_that_is_no_number_is_named_before_large_differences():
    result = made(plant_x_E=(5, math.nan))
    result.values[7, 0] = 1e200
    (finding,) = compare(result, made())
    assert "at 2 of 11 times, most at t = 0.5 s: nan" in finding


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_the_same_non_number_on_both_sides_agrees(value):
    both = made(plant_x_E=(5, value))
    assert compare(both, made(plant_x_E=(5, value))) == []
    assert len(compare(both, made(plant_x_E=(5, 1e300)))) == 1


def test_opposite_infinities_differ():
    assert len(compare(made(plant_x_E=(5, math.inf)), made(plant_x_E=(5, -math.inf)), Tolerances(1e300))) == 1


TOLERANCE = st.floats(1e-9, 1e3)
ROW = st.integers(0, 10)
FACTOR = st.floats(1.001, 1e6)


@given(ROW, st.integers(0, 2), TOLERANCE, FACTOR, st.sampled_from([-1.0, 1.0]))
def test_a_perturbation_beyond_the_tolerance_is_always_found(row, column, tolerance, factor, sign):
    result = made()
    result.values[row, column] += sign * tolerance * factor
    findings = compare(result, made(), Tolerances(absolute=tolerance, relative=0.0))
    assert len(findings) == 1
    assert f"'{NAMES[column]}' differs at 1 of 11 times, most at t = {TIME[row]:.9g} s" in findings[0]


@given(st.lists(st.floats(-0.999, 0.999), min_size=33, max_size=33), TOLERANCE)
def test_perturbations_within_the_tolerance_are_never_found(shares, tolerance):
    result = made()
    result.values += tolerance * np.array(shares).reshape(11, 3)
    assert compare(result, made(), Tolerances(absolute=tolerance, relative=0.0)) == []


# Files of tolerances


def toml(tmp_path: Path, text: str, name: str = "tolerances.toml") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_tolerances_of_an_empty_file_are_the_default(tmp_path):
    assert Tolerances.from_toml(toml(tmp_path, "")).of("any") == Tolerances().of("any") == Tolerance(0.0, 1e-9)


def test_tolerances_per_signal_fall_back_to_those_of_the_file(tmp_path):
    text = "absolute = 1\nrelative = 0.5\n[signals.'plant.x_E']\nabsolute = 0.25\n[signals.'plant.y_E']\nrelative = 0"
    tolerances = Tolerances.from_toml(toml(tmp_path, text))
    assert tolerances.of("plant.x_E") == Tolerance(0.25, 0.5)
    assert tolerances.of("plant.y_E") == Tolerance(1.0, 0.0)
    assert tolerances.of("other") == Tolerance(1.0, 0.5)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("absolut = 1", ["'absolut'", "did you mean 'absolute'?"]),
        ("absolute = -1.0", ["absolute", "-1.0"]),
        ("relative = -1e-9", ["relative", "-1e-09"]),
        ("absolute = nan", ["absolute", "nan"]),
        ("relative = inf", ["relative", "inf"]),
        ("absolute = '1'", ["absolute", "'1'"]),
        ("absolute = true", ["absolute", "True"]),
        ("absolute = [1.0]", ["absolute", "[1.0]"]),
        ("absolute = 1" + "0" * 400, ["absolute"]),
        ("absolute", ["can't be read as TOML"]),
        ("signals = 3", ["signals", "table"]),
        ("[signals]\n'plant.x_E' = 3", ["plant.x_E"]),
        ("[signals.'plant.x_E']\nabsolut = 1", ["plant.x_E", "'absolut'"]),
        ("[signals.'plant.x_E']\nabsolute = -1", ["plant.x_E", "absolute", "-1"]),
        ("[signals.'plant.x_E']\nrelative = nan", ["plant.x_E", "relative", "nan"]),
    ],
)
def test_a_bad_file_of_tolerances_is_refused_by_file_and_key(tmp_path, text, expected):
    path = toml(tmp_path, text)
    with pytest.raises(ToleranceError) as refused:
        Tolerances.from_toml(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for part in expected:
        assert part in message


def test_unreadable_files_of_tolerances_are_refused(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b"# \xfc")
    for name in ("missing.toml", "latin.toml", "."):
        with pytest.raises(ToleranceError, match="can't be read as TOML"):
            Tolerances.from_toml(tmp_path / name)


# The command


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made().to_csv("reference.csv")
    made(plant_y_E=(4, 0.801)).to_csv("result.csv")
    return tmp_path


def one_line(capsys) -> str:
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("cosim: ")
    assert shown.err.count("\n") == 1
    return shown.err


def test_the_command_says_that_all_agrees(files, capsys):
    assert main(["compare", "reference.csv", "reference.csv"]) == 0
    shown = capsys.readouterr()
    assert shown.out == "reference.csv: all 3 signals agree with reference.csv\n"
    assert shown.err == ""


def test_the_command_prints_one_line_a_finding(files, capsys):
    made(plant_y_E=(4, 9.0), plant_x_E=(5, math.inf)).to_csv("result.csv")
    assert main(["compare", "result.csv", "reference.csv"]) == 1
    shown = capsys.readouterr()
    assert re.fullmatch(r"'plant\.x_E' differs .*t = 0\.5 s.*\n'plant\.y_E' differs .*t = 0\.4 s.*\n", shown.out)
    assert shown.err == ""


def test_tolerances_beside_the_reference_are_used(files, capsys):
    assert main(["compare", "result.csv", "reference.csv"]) == 1
    toml(files, "absolute = 2e-3", "reference.toml")
    assert main(["compare", "result.csv", "reference.csv"]) == 0
    # not those beside the result
    toml(files, "absolute = 0", "reference.toml")
    toml(files, "absolute = 2e-3", "result.toml")
    assert main(["compare", "result.csv", "reference.csv"]) == 1


def test_tolerances_of_the_option_take_the_place_of_those_beside(files):
    toml(files, "absolute = 2e-3", "reference.toml")
    toml(files, "absolute = 1e-6", "strict.toml")
    assert main(["compare", "result.csv", "reference.csv", "--tolerances", "strict.toml"]) == 1
    toml(files, "[signals.'plant.y_E']\nabsolute = 2e-3", "loose.toml")
    assert main(["compare", "result.csv", "reference.csv", "--tolerances", "loose.toml"]) == 0


def test_a_tolerance_of_a_signal_that_the_reference_lacks_is_refused(files, capsys):
    # a misspelled name would leave its signal to the default without a word
    toml(files, "absolute = 1\n[signals.'plant.y_e']\nabsolute = 1e-6", "typo.toml")
    assert main(["compare", "result.csv", "reference.csv", "--tolerances", "typo.toml"]) == 1
    shown = capsys.readouterr()
    text = shown.out + shown.err
    assert text.count("\n") == 1
    for part in ("'plant.y_e'", "did you mean 'plant.y_E'?"):
        assert part in text


def test_a_missing_file_of_tolerances_is_refused(files, capsys):
    assert main(["compare", "result.csv", "reference.csv", "--tolerances", "nowhere.toml"]) == 1
    assert "nowhere.toml" in one_line(capsys)


@pytest.mark.parametrize(("result", "reference"), [("nowhere.csv", "reference.csv"), ("result.csv", "nowhere.csv")])
def test_a_missing_file_is_named(files, capsys, result, reference):
    assert main(["compare", result, reference]) == 1
    assert "nowhere.csv: can't be read: No such file" in one_line(capsys)


@pytest.mark.parametrize("text", ["", "\n", '"x"\n1.0\n', '"time","a"\n0.0\n', '"time","a"\n0.0,x\n1.0,2\n'])
def test_a_reference_that_is_no_table_is_refused(files, capsys, text):
    Path("bad.csv").write_text(text, encoding="utf-8")
    assert main(["compare", "result.csv", "bad.csv"]) == 1
    assert "bad.csv" in one_line(capsys)


def test_a_reference_without_rows_is_not_agreed_with(files, capsys):
    Path("empty.csv").write_text('"time","plant.x_E"\n', encoding="utf-8")
    assert main(["compare", "result.csv", "empty.csv"]) == 1
    assert "the result has 11 rows, the reference 0" in capsys.readouterr().out


@pytest.mark.parametrize("text", ['"time"\n0.0\n0.1\n', '"time","plant.x_E"\n'], ids=["no signals", "no rows"])
def test_a_reference_that_holds_nothing_to_compare_is_no_agreement(files, capsys, text):
    Path("empty.csv").write_text(text, encoding="utf-8")
    assert main(["compare", "empty.csv", "empty.csv"]) == 1
    shown = capsys.readouterr()
    assert (shown.out + shown.err).count("\n") == 1


def test_equal_infinities_print_no_warning(files, capsys):
    made(plant_x_E=(5, math.inf)).to_csv("infinite.csv")
    assert main(["compare", "infinite.csv", "infinite.csv"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("name", ["reference.parquet", "reference.mat", "reference.npz", "reference.json"])
def test_references_of_any_format(files, capsys, name):
    made().save(name)
    made().save("same.mat")
    assert main(["compare", "same.mat", name]) == 0
    assert main(["compare", "result.csv", name]) == 1
    assert "'plant.y_E' differs" in capsys.readouterr().out


def test_tolerances_of_the_command_line(files, capsys):
    assert main(["compare", "result.csv", "reference.csv", "--atol", "2e-3"]) == 0
    assert main(["compare", "result.csv", "reference.csv", "--rtol", "1e-3"]) == 0
    assert main(["compare", "result.csv", "reference.csv", "--rtol", "1e-4", "--atol", "1e-4"]) == 1
    toml(files, "absolute = 2e-3", "reference.toml")
    assert main(["compare", "result.csv", "reference.csv", "--atol", "1e-6"]) == 1
    toml(files, "[signals.'plant.y_E']\nabsolute = 2e-3", "reference.toml")  # what a signal has of its own stays
    assert main(["compare", "result.csv", "reference.csv", "--atol", "1e-6"]) == 0
    capsys.readouterr()
    assert main(["compare", "result.csv", "reference.csv", "--rtol", "-1"]) == 1
    assert "--rtol -1.0: must be a finite number, 0 or greater" in one_line(capsys)


def test_texts_units_and_flat_arrays_are_compared(files, capsys):
    Path("a.csv").write_text("time,mode,M [m]\n0,idle,1 2 3 4\n1,on,5 6 7 8\n", encoding="utf-8")
    shaped = 'time,mode,"M[1,1]","M[1,2]","M[2,1]","M[2,2]"\n0,idle,1,2,3,4\n1,on,5,6,7,8\n'
    Path("b.csv").write_text(shaped, encoding="utf-8")
    assert main(["compare", "a.csv", "b.csv"]) == 0
    assert main(["compare", "b.csv", "a.csv"]) == 0
    Path("b.csv").write_text(shaped.replace("on", "off"), encoding="utf-8")
    capsys.readouterr()
    assert main(["compare", "b.csv", "a.csv"]) == 1
    assert capsys.readouterr().out == "'mode' differs at 1 of 2 times, first at t = 1 s: 'off' instead of 'on'\n"
    Path("c.csv").write_text("time,mode,M [mm]\n0,1,1 2 3 4\n1,2,5 6 7 8\n", encoding="utf-8")
    assert main(["compare", "c.csv", "a.csv"]) == 1
    shown = capsys.readouterr().out
    assert "'mode' is text in the reference, a number in the result" in shown
    assert "'M[1]' has the unit 'mm' in the result, 'm' in the reference" in shown


def test_the_command_names_signals_that_the_reference_lacks(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("ref.csv").write_text("time,a\n0,0\n1,1\n")
    Path("more.csv").write_text("time,b1,a,b2,b3,b4,b5,b6,b7\n0,1,0,1,1,1,1,1,true\n1,1,1,1,1,1,1,1,false\n")
    assert main(["compare", "more.csv", "ref.csv"]) == 0
    said = "more.csv: all 1 signals agree with ref.csv, which lacks b1, b2, b3, b4, b5 and 2 more\n"
    assert capsys.readouterr().out == said
