"""The longest step that keeps a coupling tolerance, against exact solutions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Results, SetupError, SimulationError, System, simulate
from tests.support.small_fmus import build
from tests.support.tiny_models import INTEGRATOR
from tests.support.tiny_models import build as build_tiny


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("tolerance"), "fmi2", INTEGRATOR)


def oscillator(fmus: Path) -> System:
    """Two tanks, x' = v and v' = -x: x = cos t."""
    system = System()
    system.add("x", fmus / "Integrator.fmu", start={"x_start": 1.0})
    system.add("v", fmus / "Integrator.fmu", start={"x_start": 0.0})
    system.connect("v.x", "x.u")
    system.connect("x.x", "v.u", factor=-1.0)
    return system


def true_error(results: Results) -> float:
    exact = {"x.x": np.cos(results.time), "v.x": -np.sin(results.time)}
    return max(float(np.abs(results[name] - values).max() / np.abs(values).max()) for name, values in exact.items())


@pytest.mark.parametrize("extrapolation", ["hold", "linear", "cubic"])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
@pytest.mark.parametrize("first", [0.1, 0.01])
def test_the_estimate_is_true_within_a_factor_of_2(
    fmus: Path, extrapolation: str, tolerance: float, first: float
) -> None:
    if extrapolation == "hold" and tolerance < 1e-2:
        tolerance = 1e-3  # or there would be a million steps
    options: dict[str, Any] = {"order": "parallel", "extrapolation": extrapolation}
    results = simulate(oscillator(fmus), 6.0, first, coupling_tolerance=tolerance, **options)
    found = results.info["coupling"]
    error = true_error(results)
    assert found["error"] <= tolerance
    assert error / 2.0 < found["error"] < 2.0 * error
    assert found["variable"] in ("x.x", "v.x")
    assert found["step_size"] == results.info["step_size"] == pytest.approx(results.time[1], rel=1e-15)
    if extrapolation != "cubic":  # whose start is that of an extrapolation with fewer points
        assert found["order"] == pytest.approx({"hold": 1, "linear": 2}[extrapolation], abs=0.3)
    # the longest: with a step that is longer by a half the error is greater than the tolerance
    n = round(6.0 / found["step_size"] / 1.5)
    longer = simulate(oscillator(fmus), 6.0, 6.0 / n, **options)
    assert true_error(longer) > 0.9 * tolerance
    assert len(found["tried"]) < found["runs"] <= 25


def test_an_exact_coupling_takes_the_longest_step(fmus: Path) -> None:
    system = System()
    system.add("a", fmus / "Integrator.fmu", start={"x_start": 1.0, "u": 2.0})
    system.add("b", fmus / "Integrator.fmu", start={"x_start": 0.0})
    system.connect("a.x", "b.u")  # linear in time, and so is the extrapolation, once it has begun
    results = simulate(system, 8.0, 0.5, extrapolation="hold", coupling_tolerance=0.3)
    assert results.info["coupling"]["error"] <= 0.3
    assert results.info["step_size"] >= 0.5


def test_what_was_chosen_to_be_recorded_counts(fmus: Path) -> None:
    results = simulate(
        oscillator(fmus), 6.0, 0.1, record=["v.x"], order="parallel", extrapolation="linear", coupling_tolerance=1e-3
    )
    assert results.info["coupling"]["variable"] == "v.x"


def test_a_step_that_diverges_is_too_long(fmus: Path) -> None:
    system = System()
    system.add("a", fmus / "Integrator.fmu", start={"x_start": 1.0})
    system.connect("a.x", "a.u", factor=-100.0)  # with held inputs h < 0.02 s is stable
    results = simulate(system, 1.0, 0.05, extrapolation="hold", order="parallel", coupling_tolerance=0.05)
    assert results.info["step_size"] < 0.02
    assert float(np.abs(results["a.x"] - np.exp(-100.0 * results.time)).max()) < 0.1


def test_a_tolerance_that_no_step_keeps_is_said(fmus: Path) -> None:
    with pytest.raises(
        SetupError, match=r"^coupling tolerance 1e-12: no step keeps it; with .* s '.*' has an estimated"
    ):
        simulate(oscillator(fmus), 1.0, 0.1, extrapolation="hold", coupling_tolerance=1e-12)


def test_a_run_that_fails_whatever_the_step_says_so(tmp_path: Path) -> None:
    fmus = build_tiny(tmp_path)
    system = System()
    system.add("tank", fmus / "Integrator.fmu", start={"x_start": 1.0, "u": -1.0})
    system.add("fragile", fmus / "Fragile.fmu")
    system.connect("tank.x", "fragile.u")
    with pytest.raises(SimulationError, match="fragile failed at t = "):
        simulate(system, 4.0, 0.25, coupling_tolerance=1e-3)


@pytest.mark.parametrize("wrong", [0.0, -1.0, 1.0, math.nan, "much"])
def test_a_tolerance_that_makes_no_sense(fmus: Path, wrong: Any) -> None:
    with pytest.raises(SetupError, match="must be a number between 0 and 1"):
        simulate(oscillator(fmus), 1.0, 0.1, coupling_tolerance=wrong)


def test_what_is_for_one_run_is_refused(fmus: Path) -> None:
    with pytest.raises(SetupError, match="takes several runs, and realtime is for one"):
        simulate(oscillator(fmus), 1.0, 0.1, coupling_tolerance=1e-3, realtime=1.0)
    system = System()
    system.add("alone", fmus / "Integrator.fmu", start={"u": 1.0})
    with pytest.raises(SetupError, match="no real output is connected"):
        simulate(system, 1.0, 0.1, coupling_tolerance=1e-3)


def test_what_is_no_real_number_does_not_count(fmus: Path) -> None:
    system = oscillator(fmus)
    system.add_function("counts", lambda t: int(10 * t), outputs={"n": int})
    system.add_function("takes", lambda t, n: None, inputs={"n": int})
    system.connect("counts.n", "takes.n")
    results = simulate(system, 6.0, 0.1, extrapolation="auto", coupling_tolerance=1e-3)
    assert results.info["coupling"]["variable"] in ("x.x", "v.x")
