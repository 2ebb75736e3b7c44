"""The curves of a signal for its picture, worked out on paper, and what the page begins with."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

from cosim.regression import Outcome, Tolerance, Tolerances, compare_signals
from cosim.regression.comparison import SignalComparison
from cosim.regression.funnel import Curve
from cosim.regression.outcome import share
from cosim.regression.page import part, write_page
from cosim.regression.pictures import CURVES, _thinned, picture
from cosim.results.results import Results
from tests.support import some

TIME = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
RAMP = 5.0 * TIME


def signal(result: np.ndarray, reference: np.ndarray = RAMP, unit: str = "m", **tolerance: float) -> SignalComparison:
    made = [Results(TIME, ["x"], np.array(values, dtype=float)[:, None]) for values in (result, reference)]
    made[0].info["units"] = {"x": unit}
    return compare_signals(*made, Tolerances(**{"absolute": 1.0, "relative": 0.0} | tolerance)).signals[0]


def test_curves_and_band_of_a_signal_that_agrees() -> None:
    drawn = picture(signal(RAMP))
    expected = {"lower": RAMP - 1.0, "upper": RAMP + 1.0, "reference": RAMP, "result": RAMP, "place": np.zeros(5)}
    for name, values in expected.items():
        np.testing.assert_array_equal(drawn.curves[name].time, TIME)
        np.testing.assert_allclose(drawn.curves[name].values, values, rtol=0.0, atol=1e-12)
    assert len(drawn.curves["outside"].time) == 0
    assert drawn.limit == 1.4
    assert [c["rows"] for c in drawn.data["columns"]] == [5] * 10 + [0] * 2
    assert (drawn.data["name"], drawn.data["unit"], drawn.data["finding"]) == ("x", "m", "")
    assert set(CURVES) == {*expected, "outside"}


@pytest.mark.parametrize(
    ("off", "limit", "shown"),
    [
        (1.2, 1.4, 1.2),
        (2.0, 2.3, 2.0),  # 15 % more than the farthest
        (-3.0, 3.45, -3.0),
        (10.0, 4.0, 4.0),  # at most four half widths
        (-1e9, 4.0, -4.0),
        (math.nan, 1.4, 1.4),
        (math.inf, 1.4, 1.4),
    ],
)
def test_how_far_off_is_shown_and_marked(off: float, limit: float, shown: float) -> None:
    result = RAMP.copy()
    result[3] += off
    drawn = picture(signal(result))
    assert drawn.limit == pytest.approx(limit)
    assert drawn.curves["outside"].time.tolist() == [1.5]
    assert drawn.curves["outside"].values == pytest.approx([shown])
    assert drawn.curves["place"].values == pytest.approx([0.0, 0.0, 0.0, shown, 0.0])


def test_a_result_at_the_edge_of_its_band_is_not_marked() -> None:
    drawn = picture(signal(RAMP + np.array([0.0, 1.0, 0.0, -1.0, 0.0])))
    assert len(drawn.curves["outside"].time) == 0
    assert drawn.curves["place"].values == pytest.approx([0.0, 1.0, 0.0, -1.0, 0.0])


def test_a_value_that_is_no_number_stays_none() -> None:
    result = RAMP.copy()
    result[2] = math.nan
    assert np.isnan(picture(signal(result)).curves["result"].values).tolist() == [False, False, True, False, False]


def test_a_band_without_width_has_its_result_in_the_middle() -> None:
    flat = np.full(5, 3.0)
    assert picture(signal(flat, flat, absolute=0.0)).curves["place"].values.tolist() == [0.0] * 5


def test_a_long_curve_is_thinned_but_keeps_its_peaks() -> None:
    time = np.linspace(0.0, 1.0, 100_001)
    values = np.zeros((100_001, 1))
    spiked = values.copy()
    spiked[77_777, 0] = 1.0
    runs = [Results(time, ["x"], v) for v in (spiked, values)]
    for tolerance, most in ((0.1, 4000), (2.0, 1000)):
        (compared,) = compare_signals(*runs, Tolerances(absolute=tolerance)).signals
        drawn = picture(compared)
        assert max(len(curve.time) for curve in drawn.curves.values()) <= most
        assert (drawn.curves["result"].values.max(), drawn.curves["result"].values.min()) == (1.0, 0.0)
        assert len(drawn.curves["outside"].time) == (tolerance < 1.0)
        assert len(drawn.block) < 20_000


def test_of_each_piece_of_a_long_curve_the_ends_the_extremes_and_the_first_gap_are_kept() -> None:
    """By a search of its own in each piece, for values in which ends, extremes and gaps are different points."""
    time = np.arange(4001.0)
    values = np.random.default_rng(3).normal(size=4001)
    values[1000:1007] = np.nan
    values[2000:2600] = np.nan  # whole pieces
    thinned = _thinned(Curve(time, values), 100)
    expected = set()
    for piece in np.array_split(time.astype(int), 100):
        finite = [i for i in piece if np.isfinite(values[i])]
        gaps = [i for i in piece if not np.isfinite(values[i])]
        extremes = [min(finite, key=values.__getitem__), max(finite, key=values.__getitem__)] if finite else []
        expected |= {piece[0], piece[-1], *extremes, *gaps[:1]}
    np.testing.assert_array_equal(thinned.time, sorted(expected))
    np.testing.assert_array_equal(thinned.values, values[sorted(expected)])
    short = Curve(time[:400], values[:400])
    assert _thinned(short, 100) is short
    assert len(_thinned(Curve(time[:401], values[:401]), 100).time) < 401


def test_units_that_are_none_are_not_shown() -> None:
    assert [picture(signal(RAMP, unit=unit)).data["unit"] for unit in ("1", "", "m")] == ["", "", "m"]


# How much of a tolerance is used


@pytest.mark.parametrize(
    ("off", "absolute", "expected"),
    [
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 0.0),
        (0.5, 1.0, 0.5),
        (-3.0, 2.0, 1.5),
        (0.5, 0.0, math.inf),
        (math.nan, 1.0, math.inf),
        (math.inf, 1.0, math.inf),
    ],
)
def test_the_share_of_its_tolerance_that_a_signal_uses(off: float, absolute: float, expected: float) -> None:
    result = RAMP.copy()
    result[1] += off
    assert share(signal(result, absolute=absolute)) == expected


def test_the_worst_signal_is_that_of_the_largest_share_not_difference() -> None:
    reference = Results(TIME, ["fine", "coarse", "same"], np.column_stack([RAMP, RAMP, RAMP]))
    result = Results(TIME, reference.names, reference.values + np.array([0.02, 1.0, 0.0]), {"units": {"fine": "m"}})
    tolerances = Tolerances(signals={"fine": Tolerance(0.01, 0.0), "coarse": Tolerance(2.0, 0.0, 0.1)})
    compared = compare_signals(result, reference, tolerances)
    outcome = Outcome("case", "F.fmu", "CS", compared.findings, compared.signals, "", 0.1)
    assert outcome.worst is not None
    assert outcome.worst.name == "fine"
    assert Outcome("case", "F.fmu", "CS", [], [], "", 0.1).worst is None
    names = [name for name, _ in outcome.summary()]
    assert names == [
        "fmu",
        "case",
        "interface",
        "largest difference of fine (m)",
        "largest difference of coarse from its funnel",
        "largest difference of same",
    ]
    assert dict(outcome.summary())["largest difference of fine (m)"] == "0.02"


# What the page begins with


def run_of(passed: bool) -> dict[str, str | bool]:
    return part(Outcome("case", "F.fmu", "CS", [] if passed else ["off"], [signal(RAMP)], "", 0.1))


@pytest.mark.parametrize(
    ("verdicts", "head"),
    [
        ([], "No case was run"),
        ([True], "The run passed"),
        ([True, True], "All 2 runs passed"),
        ([False], "1 of 1 run failed"),
        ([True, False, True], "1 of 3 runs failed"),
    ],
)
def test_the_page_begins_with_the_verdict(tmp_path, verdicts: list[bool], head: str) -> None:
    write_page([run_of(passed) for passed in verdicts], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert f"<title>{head}: regression of FMUs</title>" in text
    assert f"<h1>Regression of FMUs: {head[:1].lower() + head[1:]}</h1>" in text
    order = re.findall(r"<h2 [^>]*>case .*?</span> (passed|failed)</span></h2>", text)
    assert order == sorted("passed" if passed else "failed" for passed in verdicts)


def test_the_row_of_a_run_has_its_farthest_signal() -> None:
    cells = json.loads(
        str(part(Outcome("case", "F.fmu", "CS", [], [signal(RAMP - 0.25, unit="m")], "", 0.125))["cells"])
    )
    assert "passed" in cells[0]
    assert cells[1:] == ["x", "0.25 m", "1 m", "1", "0.12 s", "F.fmu"]
    empty = json.loads(str(part(Outcome("case", "F.fmu", "CS", ["broken"], [], "", 3.0))["cells"]))
    assert empty[1:] == ["–", "–", "–", "0", "3 s", "F.fmu"]


@pytest.mark.parametrize(
    ("compared", "caption"),
    [
        (signal(RAMP - 0.25), "<b>x</b> at most off by 0.25 m; band ±1 m"),
        (signal(RAMP + 2.0, unit="1", absolute=0.5), "<b>x</b> at most off by 2; band ±0.5"),
        (
            signal(RAMP, time_shift=0.125),
            "<b>x</b> at most outside the funnel by 0 m; band ±1 m, 0.125 s earlier or later",
        ),
    ],
)
def test_the_caption_says_how_far_off_a_signal_is_and_may_be(compared: SignalComparison, caption: str) -> None:
    section = str(part(Outcome("case", "F.fmu", "CS", [], [compared], "", 0.1))["section"])
    assert f"<figcaption>{caption}</figcaption>" in section


def test_pictures_stand_before_findings_and_each_has_its_own_curves(tmp_path) -> None:
    bad = Outcome("case", "F.fmu", "CS", ["off"], [signal(RAMP + 2.0), signal(RAMP)], "", 0.1)
    write_page([part(bad), part(bad)], tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.index("<figure") < text.index("<li>off</li>") < text.index('<section id="all"')
    named = some(re.findall(r'data-picture="([^"]*)"', text))
    assert named == [f"run-{i}-{k}" for i in (1, 2) for k in (0, 1)]
    assert [f'id="{name}"' in text for name in named] == [True] * 4
    # curves travel once, in blocks of numbers, and not in the data beside them
    assert '"bytes"' not in text
    assert text.count('"block":') == 4
