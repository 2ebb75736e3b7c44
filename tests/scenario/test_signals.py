"""Input signals of scenarios: the sine in closed form, the multisine by its statistics."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import SetupError
from cosim.scenario import signals as signals_module
from cosim.scenario.family import ScenarioFamily
from cosim.scenario.reading import scenario_from
from cosim.scenario.signals import (
    SHAPES,
    Constant,
    CsvColumn,
    Multisine,
    Noise,
    PulseTrain,
    Ramp,
    Shape,
    ShapedSignal,
    Sine,
    Step,
)

SEED = 1
BAND = (0.5, 10.0)  # Hz


def multisine(**changes) -> Multisine:
    return Multisine(**{"rms": 0.01, "lowest": BAND[0], "highest": BAND[1], "components": 20} | changes)


def sampled(function, times) -> np.ndarray:
    return np.array([function(t) for t in np.asarray(times).tolist()])


def test_shapes_are_the_names_that_scenarios_write():
    assert {
        "constant": Constant,
        "step": Step,
        "ramp": Ramp,
        "pulses": PulseTrain,
        "sine": Sine,
        "multisine": Multisine,
        "noise": Noise,
        "table": CsvColumn,
    } == SHAPES


@pytest.mark.parametrize("t", [0.0, 0.125, 0.5, 1.0, 7.3])
@pytest.mark.parametrize("phase", [0.0, math.pi / 2, -1.0])
def test_sine_is_its_closed_form(t, phase):
    value = Sine(amplitude=0.25, frequency=0.5, phase=phase).function(3, SEED, "plant.dm")(t)
    assert value.shape == (3,)
    # math, not numpy, and the angle put together in another order
    assert value == pytest.approx([0.25 * math.sin(math.pi * t + phase)] * 3, abs=1e-15)


def test_sine_without_a_phase_starts_at_zero_and_rises():
    function = Sine(amplitude=2.0, frequency=3.0).function(1, SEED, "a.b")
    assert function(0.0) == 0.0
    assert function(1.0 / 12.0) == pytest.approx(2.0, abs=1e-14)
    assert function(3.0 / 12.0) == pytest.approx(-2.0, abs=1e-14)


def test_sine_has_nothing_random():
    a = Sine(1.0, 1.0).function(2, 1, "a.b")
    b = Sine(1.0, 1.0).function(2, 2, "c.d")
    assert a(0.3).tolist() == b(0.3).tolist()


def test_multisine_is_zero_before_its_start_and_not_after():
    function = multisine(start_time=4.0).function(3, SEED, "plant.tau_d")
    before = sampled(function, [*np.linspace(0.0, 3.999, 100), math.nextafter(4.0, 0.0)])
    assert before.shape == (101, 3)
    assert not before.any()
    after = sampled(function, np.linspace(4.0, 8.0, 100))
    assert (after != 0.0).all()


def test_start_time_shifts_the_signal_and_nothing_else():
    early = multisine().function(2, SEED, "a.b")
    late = multisine(start_time=4.0).function(2, SEED, "a.b")
    for t in (0.0, 0.25, 3.5):
        assert late(4.0 + t) == pytest.approx(early(t), abs=1e-14)


def relative_power_error(function, rms: float, duration: float, rate: float) -> np.ndarray:
    """Deviation of the mean square from rms**2, for each element."""
    values = function(np.arange(0.0, duration, 1.0 / rate))
    return np.mean(values**2, axis=0) / rms**2 - 1.0


@pytest.mark.parametrize("components", [1, 2, 20, 100])
def test_multisine_has_the_rms_it_names(components):
    # Mean square over T: N sines of power rms^2 / N each, and N (N - 1) / 2 pairs that leave 2 rms^2 / N sinc(T df)
    # cos(.) each. The difference df of two frequencies is spread over the band B: a pair's square averages to at most
    # (2 rms^2 / N)^2 / (2 T B): together a relative standard deviation of 1 / sqrt(T B). Six of these.
    duration, rate = 500.0, 50.0
    function = multisine(rms=0.3, components=components).function(3, SEED, "a.b")
    tolerance = 6.0 / math.sqrt(duration * (BAND[1] - BAND[0]))
    assert tolerance < 0.1
    assert np.abs(relative_power_error(function, 0.3, duration, rate)).max() < tolerance
    # the comparison can fail: amplitudes 5 % too large
    assert np.abs(relative_power_error(lambda t: 1.05 * function(t), 0.3, duration, rate)).min() > tolerance / 2
    assert np.abs(relative_power_error(lambda t: 1.1 * function(t), 0.3, duration, rate)).min() > tolerance


def test_many_times_at_once_give_what_single_times_do():
    function, times = multisine(start_time=1.0).function(3, SEED, "a.b"), np.linspace(0.0, 5.0, 101)
    assert function(times).tolist() == sampled(function, times).tolist()


def power_outside(function, margin: float) -> float:
    """Share of the power outside the band, by an FFT under a Hann window."""
    rate, duration = 100.0, 100.0
    values = function(np.arange(0.0, duration, 1.0 / rate))
    spectrum = np.abs(np.fft.rfft(values * np.hanning(len(values))[:, None], axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(values), 1.0 / rate)
    outside = (frequency < BAND[0] - margin) | (frequency > BAND[1] + margin)
    return float(spectrum[outside].sum() / spectrum.sum())


def test_multisine_stays_in_its_band():
    # a Hann window of 100 s leaks below 1e-10 of the power further away than 0.1 Hz, ten bins
    assert power_outside(multisine().function(3, SEED, "a.b"), margin=0.1) < 1e-6
    assert power_outside(multisine(highest=11.0).function(3, SEED, "a.b"), margin=0.1) > 1e-3


def test_multisine_fills_its_band():
    rate, duration = 50.0, 100.0
    values = multisine(components=200).function(1, SEED, "a.b")(np.arange(0.0, duration, 1.0 / rate))[:, 0]
    power = np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2
    frequency = np.fft.rfftfreq(len(values), 1.0 / rate)
    edges = np.linspace(*BAND, 6)
    shares = [power[(frequency >= a) & (frequency < b)].sum() / power.sum() for a, b in pairwise(edges)]
    # 200 frequencies at random over five parts: 40 +- 5.7 in each
    assert min(shares) > 0.05
    assert sum(shares) > 0.98


def test_seed_and_target_fix_the_function():
    times = [0.0, 0.1, 2.0, 9.99]

    def values(seed, target):
        return sampled(multisine().function(3, seed, target), times).tolist()

    assert values(1, "plant.tau_d") == values(1, "plant.tau_d")
    assert values(1, "plant.tau_d") != values(2, "plant.tau_d")
    assert values(1, "plant.tau_d") != values(1, "plant.tau_a")
    # targets that hold the same letters in another order are other targets
    assert values(1, "plant.ab") != values(1, "plant.ba")


def test_elements_are_independent():
    values = multisine().function(3, SEED, "a.b")(np.arange(0.0, 200.0, 0.02))
    correlation = np.corrcoef(values.T)
    off_diagonal = correlation[~np.eye(3, dtype=bool)]
    # as for the power: 1 / sqrt(T B) = 0.023 for independent elements, 1 for equal ones
    assert np.abs(off_diagonal).max() < 6.0 / math.sqrt(200.0 * (BAND[1] - BAND[0]))


@given(st.permutations([0.0, 0.5, 4.0, 4.001, 7.0, 14.999]))
def test_values_do_not_depend_on_the_order_of_evaluation(times):
    signal = multisine(start_time=4.0)
    in_order = {t: signal.function(2, SEED, "a.b")(t).tolist() for t in sorted(times)}
    function = signal.function(2, SEED, "a.b")
    assert {t: function(t).tolist() for t in times} == in_order
    assert {t: function(t).tolist() for t in times} == in_order  # and asking twice changes nothing


def test_a_value_belongs_to_who_asked_for_it():
    function = multisine().function(2, SEED, "a.b")
    first = function(1.0)
    kept = first.tolist()
    first[:] = 99.0
    assert function(1.0).tolist() == kept


@pytest.mark.parametrize("band", [(-0.1, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.nan)])
def test_bad_bands_are_refused_by_their_numbers(band):
    with pytest.raises(ValueError, match="band") as refused:
        Multisine(rms=1.0, lowest=band[0], highest=band[1])
    assert repr(band[0]) in str(refused.value)
    assert repr(band[1]) in str(refused.value)


@pytest.mark.parametrize("components", [0, -3])
def test_fewer_than_one_component_is_refused(components):
    with pytest.raises(ValueError, match=f"components = {components} must be between 1 and 10000"):
        multisine(components=components)


def test_a_band_of_one_frequency_is_a_sine_of_the_right_size():
    function = Multisine(rms=1.0, lowest=2.0, highest=2.0, components=1).function(1, SEED, "a.b")
    values = sampled(function, np.arange(0.0, 0.5, 0.5 / 200))  # one period
    assert float(np.sqrt(np.mean(values**2))) == pytest.approx(1.0, abs=1e-12)
    assert function(0.3) == pytest.approx(function(0.8), abs=1e-12)


def noise(**changes) -> Noise:
    return Noise(**{"rms": 0.3, "period": 1e-3} | changes)


@pytest.mark.parametrize("period", [1e-3, 4e-3])
def test_noise_is_held_for_its_period_and_then_another_value(period):
    function = noise(period=period).function(3, SEED, "controller.theta_a")
    starts = np.arange(1000) * period  # as communication points are: not always at or above the exact time
    values = function(starts)
    assert values.shape == (1000, 3)
    for share in (0.25, 0.5, 0.999):
        assert (function(starts + share * period) == values).all()
    assert (np.diff(values, axis=0) != 0.0).all()


@pytest.mark.parametrize("step", [0.5e-3, 1e-3, 2e-3])
def test_steps_that_fit_into_the_period_see_the_same_noise(step):
    function = noise(period=4e-3).function(2, SEED, "a.b")
    coarse = function(np.arange(2000) * 4e-3)
    ratio = round(4e-3 / step)
    fine = function(np.arange(2000 * ratio) * step)
    assert (fine == np.repeat(coarse, ratio, axis=0)).all()


def test_noise_is_normal_white_and_of_the_rms_it_names():
    n = 40_000
    values = noise().function(3, SEED, "a.b")(np.arange(n) * 1e-3) / 0.3
    # mean 0 +- 1/sqrt(n), mean square 1 +- sqrt(2/n), fourth moment 3 +- sqrt(96/n): six of these
    assert np.abs(values.mean(axis=0)).max() < 6.0 / math.sqrt(n)
    assert np.abs(np.mean(values**2, axis=0) - 1.0).max() < 6.0 * math.sqrt(2.0 / n)
    assert np.abs(np.mean(values**4, axis=0) - 3.0).max() < 6.0 * math.sqrt(96.0 / n)
    # white, also over the end of what is drawn at once: no value says anything about those after it
    lags = [np.mean(values[:-k] * values[k:], axis=0) for k in (1, 2, 10, 4096)]
    assert np.abs(lags).max() < 6.0 / math.sqrt(n - 4096)
    elements = np.corrcoef(values.T)[~np.eye(3, dtype=bool)]
    assert np.abs(elements).max() < 6.0 / math.sqrt(n)
    # the comparison can fail: each value held for two periods
    held = np.repeat(values[::2], 2, axis=0)
    assert np.abs(np.mean(held[:-1] * held[1:], axis=0)).min() > 0.4


@given(st.permutations([0.0, 4.095, 4.096, 8.2, 0.5, 400.0, 14.999]))
def test_noise_depends_on_the_time_alone(times):
    function = noise().function(2, SEED, "a.b")
    one_by_one = {t: function(t).tolist() for t in times}
    at_once = noise().function(2, SEED, "a.b")(np.array(times))
    assert [one_by_one[t] for t in times] == at_once.tolist()


def test_seed_and_target_fix_the_noise():
    def values(seed, target):
        return noise().function(3, seed, target)(0.1).tolist()

    assert values(1, "a.b") == values(1, "a.b")
    assert values(1, "a.b") != values(2, "a.b")
    assert values(1, "a.b") != values(1, "b.a")


@pytest.mark.parametrize(("change", "says"), [({"rms": -0.1}, "rms = -0.1"), ({"period": 0.0}, "period = 0.0")])
def test_noise_that_makes_no_sense_is_refused(change, says):
    with pytest.raises(ValueError, match=says):
        noise(**change)


# Shapes with jumps, and tables

T = np.array([-1.0, 0.0, 0.999, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 10.0])


@pytest.mark.parametrize(
    ("shape", "expected", "breakpoints"),
    [
        (Constant(2.5), [2.5] * 10, ()),
        (Step(1.0, 3.0), [0, 0, 0, 3, 3, 3, 3, 3, 3, 3], (1.0,)),
        (Step(time=1.0, after=3.0, before=-1.0), [-1, -1, -1, 3, 3, 3, 3, 3, 3, 3], (1.0,)),
        (Ramp(1.0, 3.0, 4.0), [0, 0, 0, 0, 1, 2, 3, 4, 4, 4], ()),
        (Ramp(1.0, 3.0, after=-1.0, before=1.0), [1, 1, 1, 1, 0.5, 0, -0.5, -1, -1, -1], ()),
        (PulseTrain(5.0, 2.0, 1.0, 2), [0, 5, 5, 0, 0, 5, 5, 0, 0, 0], (0.0, 1.0, 2.0, 3.0)),
        (PulseTrain(5.0, 2.0, 0.5, 1, 1.0, 1.0), [1, 1, 1, 5, 1, 1, 1, 1, 1, 1], (1.0, 1.5)),
    ],
)
def test_shapes_on_paper(shape, expected, breakpoints):
    function = shape.function(2, SEED, "a.b")
    assert function(T).tolist() == [[value, value] for value in expected]
    assert sampled(function, T).tolist() == function(T).tolist()
    assert shape.breakpoints == breakpoints


def test_a_pulse_train_is_behind_each_of_its_breakpoints():
    train = PulseTrain(1.0, 0.1, 0.03, 1000, start_time=0.7)
    edges = np.array(train.breakpoints)
    assert len(edges) == 2000
    assert (train.function(1, SEED, "a.b")(edges)[:, 0] == np.tile([1.0, 0.0], 1000)).all()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Ramp(1.0, 1.0, 2.0), "end_time = 1.0 s must be later than start_time = 1.0 s"),
        (lambda: PulseTrain(1.0, 1.0, 1.0, 1), "width = 1.0 s must be positive and less than the period"),
        (lambda: PulseTrain(1.0, 1.0, 0.0, 1), "width = 0.0 s must be positive"),
        (lambda: PulseTrain(1.0, 1.0, 0.5, 0), "pulses = 0 must be between 1 and"),
        (lambda: PulseTrain(1.0, 1.0, 0.5, 10**9), "must be between 1 and"),
    ],
)
def test_shapes_that_make_no_sense_are_refused(make, says):
    with pytest.raises(ValueError, match=says):
        make()


@pytest.fixture
def csv(tmp_path):
    path = tmp_path / "in.csv"
    path.write_text("time,u,v[1],v[2]\n0,1,0,0\n1,3,0,0\n1,5,7,8\n3,1,7,8\n", encoding="utf-8")
    return str(path)


def test_a_table_is_linear_between_its_rows_and_jumps_at_equal_times(csv):
    shape = CsvColumn(csv, "u")
    times = np.array([-1.0, 0.0, 0.5, 0.9999, 1.0, 2.0, 3.0, 9.0])
    values = shape.function(1, SEED, "a.b")(times)
    assert values[:, 0] == pytest.approx([1.0, 1.0, 2.0, 2.9998, 5.0, 3.0, 1.0, 1.0], rel=1e-14)
    assert sampled(shape.function(1, SEED, "a.b"), times).tolist() == values.tolist()
    assert shape.breakpoints == (1.0,)


def test_rows_of_a_table_may_be_further_apart_than_there_are_numbers(tmp_path):
    path = tmp_path / "far.csv"
    path.write_text("time,u\n0,1.6e308\n1,-1.6e308\n", encoding="utf-8")
    values = CsvColumn(str(path), "u").function(1, SEED, "a.b")(np.array([0.0, 0.25, 0.5, 1.0]))
    assert values[:, 0] == pytest.approx([1.6e308, 0.8e308, 0.0, -1.6e308], rel=1e-15)


def test_a_table_holds_its_rows_if_told(csv):
    shape = CsvColumn(csv, "u", "hold")
    values = shape.function(1, SEED, "a.b")(np.array([-1.0, 0.0, 0.9999, 1.0, 2.9999, 3.0, 9.0]))
    assert values[:, 0].tolist() == [1.0, 1.0, 1.0, 5.0, 5.0, 1.0, 1.0]
    assert shape.breakpoints == (1.0, 3.0)


def test_a_table_feeds_vectors_by_element_or_all_alike(csv):
    assert CsvColumn(csv, "v").function(2, SEED, "a.b")(2.0).tolist() == [7.0, 8.0]
    assert CsvColumn(csv, "v").breakpoints == (1.0,)
    assert CsvColumn(csv, "u").function(3, SEED, "a.b")(2.0).tolist() == [3.0, 3.0, 3.0]
    with pytest.raises(SetupError, match=r"'v' has 2 columns for the 3 of 'a\.b'"):
        CsvColumn(csv, "v").function(3, SEED, "a.b")


def test_a_table_goes_where_its_file_does_not_and_knows_its_content(csv):
    shape = CsvColumn(csv, "u")
    Path(csv).write_text("time,u\n0,0\n", encoding="utf-8")
    other = CsvColumn(csv, "u")
    Path(csv).unlink()
    assert pickle.loads(pickle.dumps(shape)).function(1, SEED, "a.b")(2.0).tolist() == [3.0]
    assert other != shape
    assert set(shape.as_data()) == {"shape", "file", "column", "between", "sha256"}
    assert json.loads(json.dumps(shape.as_data()))["shape"] == "table"


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        ("time,u\n0,0\n", ("w",), "there is no column 'w'"),
        ("time,u\n0,0\n", ("u", "cubic"), "between = 'cubic' is unknown"),
        ("time,u\n", ("u",), "needs rows of finite numbers"),
        ("time,u\n0,nan\n", ("u",), "needs rows of finite numbers"),
        ("time,u\n1,0\n0,0\n", ("u",), "the times must not descend"),
        ("u,time\n1,0\n", ("u",), "the first column must be 'time'"),
        (None, ("u",), "can't be read: No such file"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(tmp_path, text, options, says):
    path = tmp_path / "in.csv"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=says):
        CsvColumn(str(path), *options)


@pytest.mark.parametrize("shape", [Sine(1.0, 1.0), multisine(), noise(), Step(0.5, 1.0)])
def test_a_signal_of_a_shape_waits_for_the_size_of_its_input(shape):
    signal = ShapedSignal(shape, SEED, "a.b")
    assert signal.for_size(3)(0.7).tolist() == shape.function(3, SEED, "a.b")(0.7).tolist()
    # runs of equal signals share samples, which are compared by their functions
    assert ShapedSignal(shape, SEED, "a.b").for_size(3) is signal.for_size(3)
    assert signal.for_size(2) is not signal.for_size(3)


def test_a_shape_of_one_s_own_is_one_class(monkeypatch):
    monkeypatch.setattr("cosim.scenario.signals.SHAPES", dict(SHAPES))

    @dataclass(frozen=True)
    class Parabola(Shape, name="parabola"):
        height: float

        def function(self, size, seed, target):  # noqa: ARG002 -- nothing random
            return lambda times: np.repeat(self.height * np.square(times)[..., np.newaxis], size, axis=-1)

    data = {
        "components": {"a": {"fmu": "a.fmu"}},
        "run": {"stop_time": 1.0, "step_size": 0.1},
        "signals": {"a.u": {"shape": "parabola", "height": 2}},
    }
    monkeypatch.setattr("cosim.scenario.reading.SHAPES", signals_module.SHAPES)
    scenario = scenario_from(data, "mine", Path(), ScenarioFamily())
    assert scenario.signals == {"a.u": Parabola(2.0)}
    assert scenario.system().signals[0].function_for(1)(3.0).tolist() == [18.0]
