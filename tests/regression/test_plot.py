"""The figure of a signal, worked out on paper: where curves, ticks and marks stand in it.

The upper panel is 140 high from 20 on, the lower one 56 from 176 on; times run over 360 from 72 on.
"""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from cosim.regression import Outcome, Tolerance, Tolerances, compare_signals
from cosim.regression.comparison import SignalComparison
from cosim.regression.outcome import share
from cosim.regression.page import part, write_page
from cosim.regression.plot import plot
from cosim.results.results import Results

TIME = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
RAMP = 5.0 * TIME


def signal(result: np.ndarray, reference: np.ndarray = RAMP, unit: str = "m", **tolerance: float) -> SignalComparison:
    made = [Results(TIME, ["x"], np.array(values, dtype=float)[:, None]) for values in (result, reference)]
    made[0].info["units"] = {"x": unit}
    return compare_signals(*made, Tolerances(**{"absolute": 1.0, "relative": 0.0} | tolerance)).signals[0]


def paths(drawn: str, kind: str) -> list[list[tuple[float, float]]]:
    """Points of the paths of a kind."""
    found = re.findall(rf'class="{kind}" d="M([^"Z]*)Z?"', drawn)
    return [[(float(a), float(b)) for a, b in (word.split() for word in re.split("[ML]", text))] for text in found]


def texts(drawn: str) -> list[tuple[float, float, str]]:
    return [(float(x), float(y), t) for x, y, t in re.findall(r'<text x="([^"]*)" y="([^"]*)"[^>]*>([^<]*)<', drawn)]


def test_curves_band_and_ticks_of_a_signal_that_agrees() -> None:
    drawn = plot(signal(RAMP))
    # the band is from -1 to 11, and 6 % of 12 are left free on both sides
    low, high = -1.72, 11.72

    def y(value: float) -> float:
        return round(20 + 140 * (high - value) / (high - low), 1)

    x = [72.0, 162.0, 252.0, 342.0, 432.0]
    line = [(a, y(v)) for a, v in zip(x, RAMP, strict=True)]
    assert paths(drawn, "reference") == [line]
    assert paths(drawn, "result") == [line]
    upper = [(a, y(v + 1)) for a, v in zip(x, RAMP, strict=True)]
    lower = [(a, y(v - 1)) for a, v in zip(x, RAMP, strict=True)]
    # the lower panel shows 1.4 half widths of the band, in whose middle the result is
    assert paths(drawn, "band") == [upper + lower[::-1], [(72, 184), (432, 184), (432, 224), (72, 224)]]
    assert paths(drawn, "result whole") == [[(a, 204.0) for a in x]]
    assert 'class="outside"' not in drawn
    assert re.findall(r'class="tick" d="M72 ([^h]*)h360"', drawn) == [
        *(f"{y(v)}" for v in (0, 5, 10)),
        "224.0",
        "184.0",
    ]
    assert texts(drawn) == [
        *((67.0, round(y(v) + 4, 1), f"{v}") for v in (0, 5, 10)),
        (67.0, 228.0, "−1"),
        (67.0, 188.0, "1"),
        *((a, 248.0, t) for a, t in zip(x, ("0", "0.5", "1", "1.5", "2"), strict=True)),
        (252.0, 266.0, "t (s)"),
    ]
    frames = re.findall(r'class="frame" x="72" y="([^"]*)" width="360" height="([^"]*)"', drawn)
    assert frames == [("20", "140"), ("176", "56")]
    assert 'aria-label="x (m) over time: the result stays within the band of the reference"' in drawn


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
    drawn = plot(signal(result))
    y = 176 + 56 * (limit - shown) / (2 * limit)
    assert re.findall(r'class="outside" cx="([^"]*)" cy="([^"]*)"', drawn) == [("342.0", f"{y:.1f}")]
    (line,) = paths(drawn, "result whole")
    assert [round(b, 1) for _, b in line] == [204.0, 204.0, 204.0, round(y, 1), 204.0]
    band = 176 + 56 * (limit - 1) / (2 * limit)
    assert paths(drawn, "band")[-1][0] == (72.0, round(band, 1))


def test_a_result_at_the_edge_of_its_band_is_not_marked() -> None:
    drawn = plot(signal(RAMP + np.array([0.0, 1.0, 0.0, -1.0, 0.0])))
    assert 'class="outside"' not in drawn
    assert [b for _, b in paths(drawn, "result whole")[0]] == [204.0, 184.0, 204.0, 224.0, 204.0]


def test_a_value_that_is_no_number_leaves_a_gap() -> None:
    result = RAMP.copy()
    result[2] = math.nan
    (line,) = re.findall(r'class="result" d="([^"]*)"', plot(signal(result)))
    assert [word[0] for word in re.findall(r"[ML][^ML]*", line)] == ["M", "L", "M", "L"]


@pytest.mark.parametrize(("constant", "pad"), [(3.0, 3e-3), (-2000.0, 2.0), (0.0, 1.0)])
def test_a_constant_has_room_above_and_below(constant: float, pad: float) -> None:
    flat = np.full(5, constant)
    drawn = plot(signal(flat, flat, absolute=0.0))
    assert paths(drawn, "reference") == [[(a, 90.0) for a in (72, 162, 252, 342, 432)]]
    # ticks are at round parts of what is shown, which is pad on both sides
    ticks = [float(y) for y in re.findall(r'class="tick" d="M72 ([^h]*)h360"', drawn)][:-2]
    spacing = 140.0 * {3e-3: 2e-3, 2.0: 1.0, 1.0: 0.5}[pad] / (2 * pad)
    assert np.diff(ticks) == pytest.approx([-spacing] * (len(ticks) - 1), abs=0.11)
    assert len(ticks) > 2
    assert 90.0 in ticks


def test_a_flat_part_of_the_label_is_taken_out() -> None:
    """Ticks that differ in the seventh digit are differences from one of them."""
    values = 0.3 + 1e-7 * RAMP
    shown = [text for _, _, text in texts(plot(signal(values, values, absolute=1e-8)))]
    assert shown[0].endswith(" +")
    assert float(shown[0][:-2]) == pytest.approx(0.3, abs=2e-6)
    assert {float(text.replace("−", "-")) for text in shown[1:4]} >= {0.0}


def test_units_that_are_none_are_not_shown() -> None:
    assert 'aria-label="x over time' in plot(signal(RAMP, unit="1"))
    assert 'aria-label="x over time' in plot(signal(RAMP, unit=""))


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
    order = re.findall(r'<td><span class="verdict (passed|failed)">', text)
    assert order == sorted("passed" if passed else "failed" for passed in verdicts)


def test_the_row_of_a_run_has_its_farthest_signal() -> None:
    row = str(part(Outcome("case", "F.fmu", "CS", [], [signal(RAMP - 0.25, unit="m")], "", 0.125))["row"])
    assert re.findall(r"<td[^>]*>([^<]*)</td>", row) == ["x", "0.25 m", "1 m", "1", "0.12 s", "F.fmu"]
    empty = str(part(Outcome("case", "F.fmu", "CS", ["broken"], [], "", 3.0))["row"])
    assert re.findall(r"<td[^>]*>([^<]*)</td>", empty) == ["–", "–", "–", "0", "3 s", "F.fmu"]
