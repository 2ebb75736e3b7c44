"""Connections that scale, convert units, or have a signal added to them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmpy.model_description import BaseUnit, Unit
from hypothesis import given
from hypothesis import strategies as st

from cosim import Results, SetupError, Signal, Simulation, SimulationError, System, simulate
from cosim.system.units import conversion
from tests.support.changed_fmus import in_millimetres, rewritten
from tests.support.small_fmus import FLAVOURS, build
from tests.support.tiny_models import CLOCK, FRAGILE, GAIN, INTEGRATOR, UNITS
from tests.support.tiny_models import build as build_tiny

NATIVE = ("fmi2", "fmi3")


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("connections")
    for flavour in FLAVOURS:
        build(folder / flavour, flavour, GAIN, INTEGRATOR, CLOCK)
    return folder


def chain(folder: Path, **connection: float) -> System:
    """An integrator of the time, whose value goes through a gain of 2 (a vector, of which one element is held)."""
    system = System()
    system.add("clock", folder / "Clock.fmu")
    system.add("gain", folder / "Gain.fmu", start={"u[2]": 1.0})
    system.add("integrator", folder / "Integrator.fmu")
    system.connect("clock.now", "gain.u[1]", units="ignore", **connection)
    system.connect("gain.y[1]", "integrator.u")
    return system


# Factor and offset


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_factor_and_offset(fmus: Path, flavour: str, order: str) -> None:
    results = simulate(chain(fmus / flavour, factor=-3.0, offset=0.5), 1.0, 0.1, order=order)
    assert results["gain.u[1]"] == pytest.approx(-3.0 * results["clock.now"] + 0.5, abs=1e-15)
    assert results["gain.u[2]"].tolist() == [1.0] * 11  # the element beside it keeps its start value


@pytest.mark.parametrize("flavour", NATIVE)
def test_linear_coupling_through_a_factor(fmus: Path, flavour: str) -> None:
    """X' = 2 (3 t - 1) comes out exactly where the inputs are linear: the integrator's input lags by no step."""
    results = simulate(chain(fmus / flavour, factor=3.0, offset=-1.0), 1.0, 0.1, extrapolation="linear")
    assert results.info["extrapolation"]["hold"] == []
    # the rate of a connection is known from the second point on: one step is held
    held = 2.0 * (3.0 * 0.1**2 / 2)
    exact = 3.0 * results.time**2 - 2.0 * results.time
    assert results["integrator.x"][1:] == pytest.approx(exact[1:] - held, abs=1e-12)


def test_neutral_factor_and_offset_change_no_bit(fmus: Path) -> None:
    plain, neutral = (simulate(chain(fmus / "fmi2", **c), 1.0, 0.1) for c in ({}, {"factor": 1.0, "offset": 0.0}))
    assert neutral.values.tobytes() == plain.values.tobytes()


@pytest.mark.parametrize("what", ["factor", "offset"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_factor_and_offset_must_be_finite(fmus: Path, what: str, value: float) -> None:
    message = rf"^connection 'clock.now' -> 'gain.u\[1\]': {what} {value} is not a finite number$"
    with pytest.raises(SetupError, match=message):
        Simulation(chain(fmus / "fmi2", **{what: value}))


# Units


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_tiny(tmp_path_factory.mktemp("tiny"), FRAGILE, UNITS)


def lengths(tiny: Path, other: Path, **connection: object) -> System:
    system = System()
    system.add("a", tiny / "Units.fmu", start={"torque": 3.0, "length": 2.0})
    system.add("b", other, start={"torque": 0.0})
    system.connect("a.place", "b.length", **connection)
    return system


def test_units_are_converted_on_request(tiny: Path, tmp_path: Path) -> None:
    other = in_millimetres(tiny / "Units.fmu", tmp_path / "mm.fmu", 'factor="0.001"')
    with pytest.raises(SetupError, match=r"units 'm' and 'mm' don't match; .* or connect with units='convert'$"):
        Simulation(lengths(tiny, other))
    converted = simulate(lengths(tiny, other, units="convert"), 1.0, 0.5)
    assert converted["b.length"] == pytest.approx(1e3 * converted["a.place"])
    then = simulate(lengths(tiny, other, units="convert", factor=2.0, offset=5.0), 1.0, 0.5)
    assert then["b.length"] == pytest.approx(2e3 * then["a.place"] + 5.0)  # 5 mm
    ignored = simulate(lengths(tiny, other, units="ignore"), 1.0, 0.5)
    assert ignored["b.length"].tolist() == ignored["a.place"].tolist()


def test_a_difference_has_no_offset(tiny: Path, tmp_path: Path) -> None:
    unit = ('factor="0.001"', 'offset="0.25"')
    absolute = in_millimetres(tiny / "Units.fmu", tmp_path / "absolute.fmu", *unit)
    relative = in_millimetres(tiny / "Units.fmu", tmp_path / "relative.fmu", *unit, relative=True)
    first, second = (simulate(lengths(tiny, o, units="convert"), 1.0, 0.5) for o in (absolute, relative))
    assert first["b.length"] == pytest.approx((first["a.place"] - 0.25) / 0.001)
    assert second["b.length"] == pytest.approx(second["a.place"] / 0.001)


@pytest.mark.parametrize("units", ["equal", "convert"])
def test_other_base_units_are_never_converted(tiny: Path, units: str) -> None:
    system = System()
    system.add("a", tiny / "Units.fmu", start={"torque": 1.0, "length": 2.0})
    system.add("b", tiny / "Units.fmu", start={"torque": 1.0})
    system.connect("a.energy", "b.length", units=units)
    with pytest.raises(
        SetupError, match=r"units 'J' and 'm' don't match; .*units='ignore' and a factor and offset of your own$"
    ):
        Simulation(system)


def test_unknown_treatment_of_units(fmus: Path) -> None:
    system = chain(fmus / "fmi2")
    system.connect("gain.y[2]", "gain.u[2]", units="convrt")
    with pytest.raises(SetupError, match="units = 'convrt'; did you mean 'convert'"):
        Simulation(system)


@given(st.floats(0.01, 100), st.floats(-300, 300), st.floats(0.01, 100), st.floats(-300, 300), st.floats(-1e3, 1e3))
def test_both_units_mean_the_same_in_the_base_unit(
    factor_a: float, offset_a: float, factor_b: float, offset_b: float, value: float
) -> None:
    a = Unit("a", BaseUnit(K=1, factor=factor_a, offset=offset_a))
    b = Unit("b", BaseUnit(K=1, factor=factor_b, offset=offset_b))
    factor, offset = conversion(a, b, relative=False)
    base = factor_b * (factor * value + offset) + offset_b
    assert base == pytest.approx(factor_a * value + offset_a, rel=1e-9, abs=1e-9)


# Added signals


def disturbed(folder: Path, function: Callable, **options: object) -> System:
    system = chain(folder, factor=2.0)
    system.disturb("gain.u[1]", function, **options)
    return system


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_a_signal_is_added_to_a_connection(fmus: Path, flavour: str, order: str) -> None:
    results = simulate(disturbed(fmus / flavour, lambda t: np.sin(9.0 * t), vectorized=True), 1.0, 0.1, order=order)
    expected = 2.0 * results["clock.now"] + np.sin(9.0 * results.time)
    assert results["gain.u[1]"] == pytest.approx(expected, abs=1e-15)
    assert "gain.u[1]" in results.info["extrapolation"]["hold"]  # as samples are
    assert ("integrator.u" in results.info["extrapolation"]["linear"]) == (flavour != "pythonfmu")


def test_an_added_zero_is_the_held_connection(fmus: Path) -> None:
    added = simulate(disturbed(fmus / "fmi2", lambda _: 0.0), 1.0, 0.1)
    held = simulate(chain(fmus / "fmi2", factor=2.0), 1.0, 0.1, extrapolation="hold")
    assert added["gain.y[1]"].tolist() == held["gain.y[1]"].tolist()


def test_added_signals_of_vectors_and_of_slow_components(fmus: Path) -> None:
    system = System()
    system.add("source", fmus / "fmi3" / "Gain.fmu")
    system.add("slow", fmus / "fmi3" / "Gain.fmu", every=2)
    system.drive("source.u", lambda t: [t, -t])
    system.connect("source.y", "slow.u")
    system.disturb("slow.u", lambda t: [100.0 * t, 0.5])
    results = simulate(system, 0.6, 0.1)
    points = np.array([0.0, 0.0, 0.2, 0.2, 0.4, 0.4, 0.6])
    assert results["slow.u"] == pytest.approx(np.column_stack([102.0 * points, 0.5 - 2.0 * points]), abs=1e-12)


def test_added_signals_change_from_run_to_run(fmus: Path) -> None:
    def gain_input(results: Results) -> list[float]:
        return (results["gain.u[1]"] - 2.0 * results["clock.now"]).round(12).tolist()

    with Simulation(disturbed(fmus / "fmi2", lambda _: 1.0)) as simulation:
        first = simulation.run(0.3, 0.1)
        other = simulation.run(0.3, 0.1, signals=[Signal("gain.u[1]", lambda _: 5.0)])
        again = simulation.run(0.3, 0.1)
    assert gain_input(first) == gain_input(again) == [1.0] * 4
    assert gain_input(other) == [5.0] * 4


def refused(system: System, message: str) -> None:
    with pytest.raises(SetupError, match=message):
        Simulation(system)


def test_what_can_not_be_added(fmus: Path, tiny: Path, tmp_path: Path) -> None:
    system = chain(fmus / "fmi2")
    system.disturb("gain.u[2]", lambda _: 1.0)
    refused(system, r"^no connection feeds 'gain.u\[2\]', so nothing can be added; use System.drive$")
    system = disturbed(fmus / "fmi2", lambda _: 1.0)
    system.disturb("gain.u[1]", lambda _: 1.0)
    refused(system, r"^two signals are added to input 'gain.u\[1\]'; add their sum$")
    system = chain(fmus / "fmi2")
    system.disturb("gain.y[1]", lambda _: 1.0)
    refused(system, r"^'gain.y\[1\]' is an output and can't be the target of a signal, which must be an input$")
    integer = rewritten(
        tiny / "Fragile.fmu", tmp_path / "I.fmu", description='<Real unit="1" start="1.0" /> => <Integer start="1"/>'
    )
    system = System()
    system.add("a", integer)
    system.disturb("a.u", lambda _: 1)
    refused(system, r"^'a.u' is integer; signals can be added to real inputs only$")


def test_an_added_signal_that_is_not_finite_ends_the_run_there(fmus: Path) -> None:
    system = disturbed(fmus / "fmi2", lambda t: np.nan if t > 0.45 else 0.0)
    with pytest.raises(SimulationError, match=r"gain.*t = 0.5.*not finite") as caught:
        simulate(system, 1.0, 0.1)
    assert len(caught.value.results.time) == 5
