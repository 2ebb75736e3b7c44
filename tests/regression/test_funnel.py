"""Time shifts: the funnel of pyfunnel against its definition, and what surrounds it."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cosim.errors import MissingExtra
from cosim.regression import Tolerance, ToleranceError, Tolerances, compare, compare_signals
from cosim.regression.funnel import Curve, funnel
from cosim.results.results import Results

TIME = np.linspace(0.0, 2.0, 81)


def bounds(reference: Curve, time_shift: float, allowed: float, when: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The definition: extremes of the reference, a polygon, within the time shift of each time."""
    low, high = np.empty(len(when)), np.empty(len(when))
    for i, t in enumerate(when):
        near = reference.time[np.abs(reference.time - t) <= time_shift]
        ends = np.clip([t - time_shift, t + time_shift], reference.time[0], reference.time[-1])
        seen = np.interp([*ends, *near], reference.time, reference.values)
        low[i], high[i] = seen.min() - allowed, seen.max() + allowed
    return low, high


@settings(max_examples=30, deadline=None)
@example(430, 0.5, -12.0, 0.0, True)
@given(
    st.integers(0, 2**32 - 1), st.floats(1e-3, 0.5), st.floats(-12.0, 3.0), st.floats(-12.0, 9.0), st.booleans()
)  # fmt: skip
def test_the_funnel_is_what_it_should_be_at_any_scale(seed, time_shift, exponent, scale, jumps):
    """Also with tolerances far below and above those that the library was made for."""
    generator = np.random.default_rng(seed)
    values = (np.sign if jumps else np.asarray)(generator.standard_normal(81).cumsum()) * 10.0**scale
    reference, allowed = Curve(TIME, values), 10.0 ** (scale + min(exponent, 0.0))
    result = Curve(np.sort(np.append(generator.uniform(0.0, 2.0, 50), [0.0, 2.0])), np.zeros(52))
    low, high = bounds(reference, time_shift, allowed, result.time)
    rounding = 1e-9 * allowed + 1e-12 * np.ptp(values) + np.spacing(np.abs(values).max())  # those may all be one
    inside = Curve(result.time, low + generator.uniform(0.001, 0.999, 52) * (high - low))
    assert funnel(reference, inside, time_shift, allowed).beyond.max() <= rounding
    off = generator.uniform(0.01, 10.0, 52) * allowed
    for edge, sign in ((low, -1.0), (high, 1.0)):
        found = funnel(reference, Curve(result.time, edge + sign * off), time_shift, allowed)
        np.testing.assert_allclose(found.beyond, off, rtol=1e-3, atol=10.0 * rounding)


def shifted(by: float) -> tuple[Results, Results]:
    """A pulse of 1 from 0.5 s to 1.2 s, and the same so much later."""
    pulse = [((b <= TIME) & (b + 0.7 > TIME)).astype(float)[:, None] for b in (0.5, 0.5 + by)]
    return Results(TIME, ["pulse"], pulse[1]), Results(TIME, ["pulse"], pulse[0])


@pytest.mark.parametrize(("by", "within"), [(0.0, True), (0.1, True), (-0.1, True), (0.2, False), (-0.2, False)])
def test_a_shift_passes_up_to_its_tolerance(by, within):
    found = compare(*shifted(by), Tolerances(time_shift=0.12))
    assert (found == []) == within
    if not within:
        assert "'pulse' leaves the funnel at " in found[0]
        assert "time shift 0.12 s" in found[0]
    assert (compare(*shifted(by)) == []) == (by == 0.0)


def test_curves_with_other_times_can_be_compared_with_a_time_shift_only():
    coarse = Results(TIME[::4], ["ramp", "other"], np.column_stack([TIME[::4], TIME[::4]]))
    fine = Results(TIME, ["ramp", "other"], np.column_stack([TIME, TIME]))
    assert compare(fine, coarse, Tolerances(time_shift=0.01)) == []
    (found,) = compare(fine, coarse, Tolerances(signals={"ramp": Tolerance(time_shift=0.01)}))
    assert found.startswith("'other' has no time_shift, and the result has 81 rows, the reference 21")
    short = Results(TIME[:-1], fine.names, fine.values[:-1])
    assert compare(short, coarse, Tolerances(time_shift=10.0)) == [
        "the result ends at t = 1.975 s, the reference at 2.0 s"
    ]
    late = Results(TIME[1:], fine.names, fine.values[1:])
    assert compare(late, coarse, Tolerances(time_shift=10.0)) == [
        "the result begins at t = 0.025 s, the reference at 0.0 s"
    ]
    for time in (TIME[::-1], np.where(TIME[3] == TIME, np.nan, TIME)):
        lines = compare(Results(time, fine.names, fine.values), coarse, Tolerances(time_shift=10.0))
        assert lines == ["the times of the result must increase"]
    empty = Results(np.empty(0), fine.names, np.empty((0, 2)))
    assert compare(empty, coarse, Tolerances(time_shift=10.0)) == ["the result has no rows"]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_no_time_shift_lets_a_value_pass_that_is_no_number(value):
    result, reference = shifted(0.0)
    result.values[7, 0] = value
    (found,) = compare(result, reference, Tolerances(absolute=1e300, time_shift=1.0))
    assert found == f"'pulse' is {value:.9g} at t = 0.175 s in the result; a time_shift needs finite values"
    (found,) = compare(reference, result, Tolerances(absolute=1e300, time_shift=1.0))
    assert "in the reference" in found


def test_a_constant_reference_has_no_funnel_but_its_tolerance():
    constant = Results(TIME, ["c"], np.full((81, 1), 3.0))
    above = Results(TIME, ["c"], np.full((81, 1), 3.0 + 1e-9))
    assert compare(constant, constant, Tolerances(time_shift=0.1)) == []
    assert len(compare(above, constant, Tolerances(time_shift=0.1))) == 1
    assert compare(above, constant, Tolerances(absolute=1e-8, time_shift=0.1)) == []


def test_the_band_of_a_signal_is_that_of_its_verdict():
    (signal,) = compare_signals(*shifted(0.2), Tolerances(time_shift=0.12)).signals
    upper = np.interp(signal.result.time, signal.upper.time, signal.upper.values)
    lower = np.interp(signal.result.time, signal.lower.time, signal.lower.values)
    outside = (signal.result.values > upper + 1e-12) | (signal.result.values < lower - 1e-12)
    np.testing.assert_array_equal(outside, signal.distance > 1e-12)
    assert outside.any()


def test_without_the_library_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyfunnel", None)
    with pytest.raises(
        MissingExtra, match=r'pyfunnel is not installed; .* pip install "closed-chain-cosim\[regression\]"'
    ):
        compare(*shifted(0.1), Tolerances(time_shift=0.2))
    assert len(compare(*shifted(0.1))) == 1  # which needs none


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("relative = 0\ntime_shift = 0.1", "a time_shift needs an absolute or a relative tolerance"),
        ("time_shift = -0.1", "time_shift = -0.1 must be a finite number"),
        ("[signals]\nx = { unit = 3 }", "x: unit = 3 must be a text"),
        ("[model_exchange]\nrelativ = 3", "model_exchange has an unknown key 'relativ'; did you mean 'relative'?"),
        ("model_exchange = 3", "model_exchange = 3 must be a table"),
        ("[co_simulation.signals.x]\nabsolut = 3", "x has an unknown key 'absolut'"),
    ],
)
def test_wrong_tolerances_are_refused(tmp_path, text, expected):
    path = tmp_path / "tolerances.toml"
    path.write_text(text)
    with pytest.raises(ToleranceError) as refused:
        Tolerances.from_toml(path, "co_simulation")
    assert expected in str(refused.value)


def test_an_interface_has_its_own_tolerances(tmp_path):
    path = tmp_path / "tolerances.toml"
    path.write_text(
        "relative = 1e-9\n[signals]\nx = { unit = 'm', absolute = 1.0 }\n"
        "[model_exchange]\nrelative = 1e-4\ntime_shift = 0.1\nsignals.x.absolute = 2.0\n"
    )
    common, model_exchange = Tolerances.from_toml(path), Tolerances.from_toml(path, "model_exchange")
    assert common == Tolerances.from_toml(path, "co_simulation")
    assert common.of("x") == Tolerance(1.0, 1e-9, 0.0, "m")
    assert model_exchange.of("x") == Tolerance(2.0, 1e-4, 0.1, "m")
    assert model_exchange.of("y") == Tolerance(0.0, 1e-4, 0.1)
