"""Communication steps as long as the coupling error allows, against exact solutions."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from cosim import Results, SetupError, Simulation, SimulationError, System, simulate
from tests.support.small_fmus import build, redescribed
from tests.support.tiny_models import INTEGRATOR, LAG


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("variable"), "fmi2", INTEGRATOR, LAG)


def decaying(fmus: Path, fast: float = 0.01) -> System:
    """Two lags in a loop, x' = (y - x) / T and y' = -x - y: one is fast, and is over soon."""
    system = System()
    system.add("x", fmus / "Lag.fmu", start={"x_start": 1.0, "T": fast})
    system.add("y", fmus / "Lag.fmu", start={"x_start": 0.5, "T": 1.0})
    system.connect("y.x", "x.u")
    system.connect("x.x", "y.u", factor=-1.0)
    return system


def exact(time: np.ndarray, fast: float = 0.01) -> np.ndarray:
    matrix = np.array([[-1.0 / fast, 1.0 / fast], [-1.0, -1.0]])
    values, vectors = np.linalg.eig(matrix)
    weights = np.linalg.solve(vectors, np.array([1.0, 0.5]))
    return np.real((vectors * weights) @ np.exp(np.outer(values, time)))


def error(results: Results) -> float:
    x, y = exact(results.time)
    return float(max(np.abs(results["x.x"] - x).max(), np.abs(results["y.x"] - y).max()))


@pytest.mark.parametrize("extrapolation", ["hold", "linear", "hermite", "quadratic-least-squares"])
def test_the_tolerance_is_kept_by_steps_of_many_lengths(fmus: Path, extrapolation: str) -> None:
    tolerance = 0.1 if extrapolation == "hold" else 1e-2
    with Simulation(decaying(fmus), extrapolation=extrapolation) as simulation:
        results = simulation.run(4.0, "variable", coupling_tolerance=tolerance)
        again = simulation.run(4.0, "variable", coupling_tolerance=tolerance)
        found = results.info["variable_steps"]
        assert error(results) < tolerance
        assert found["longest"] > 3.0 * found["shortest"]
        assert found["tolerance"] == tolerance
        assert results.info["step_size"] == "variable"
        assert results.time[0] == 0.0
        assert results.time[-1] == pytest.approx(4.0, abs=1e-12)
        assert np.all(np.diff(results.time) > 0.0)
        assert len(results.time) == 2 * found["steps"] + 1  # halves, too
        assert sum(found["limited_by"].values()) > 0
        np.testing.assert_array_equal(results.time, again.time)
        np.testing.assert_array_equal(results.values, again.values)


def test_a_smaller_tolerance_takes_more_steps_and_gives_a_smaller_error(fmus: Path) -> None:
    def run(**options: float) -> Results:
        return simulate(decaying(fmus), 0.5, "variable", extrapolation="linear", **options)

    coarse, fine = (run(coupling_tolerance=tolerance) for tolerance in (1e-2, 1e-4))
    assert error(fine) < 0.1 * error(coarse)
    assert fine.info["variable_steps"]["steps"] > 2 * coarse.info["variable_steps"]["steps"]
    default = run()
    np.testing.assert_array_equal(default.time, fine.time)


def test_no_step_goes_over_a_jump_of_a_signal(fmus: Path) -> None:
    """A jump at 1 / 3, which no halving of the run meets."""
    system = decaying(fmus)
    jump = 1.0 / 3.0
    system.add_function("d", lambda t, u, d: u + d, inputs=["u", "d"], outputs=["y"])
    system.connect("x.x", "d.u")
    system.add("z", fmus / "Lag.fmu")
    system.connect("d.y", "z.u")
    system.drive("d.d", lambda t: 1.0 if t >= jump else 0.0, breakpoints=[jump])
    results = simulate(system, 1.0, "variable", coupling_tolerance=1e-3)
    assert np.abs(results.time - jump).min() < 1e-12
    found = results.info["variable_steps"]
    assert found["shortest"] > 1e-6
    at = int(np.argmin(np.abs(results.time - jump)))
    assert results["d.d"][at] == 1.0
    assert results["d.d"][at - 1] == 0.0


def test_points_are_recorded_now_and_then_and_go_to_a_sink(fmus: Path) -> None:
    rows: list[np.ndarray] = []
    all_ = simulate(decaying(fmus), 1.0, "variable", coupling_tolerance=1e-2)
    third = simulate(decaying(fmus), 1.0, "variable", coupling_tolerance=1e-2, record_every=3)
    np.testing.assert_array_equal(third.time, all_.time[::3])
    simulate(
        decaying(fmus), 1.0, "variable", coupling_tolerance=1e-2, sink=lambda times, values: rows.append(values.copy())
    )
    np.testing.assert_array_equal(np.vstack(rows), all_.values)


def test_iterated_steps_are_longer(fmus: Path) -> None:
    plain, iterated = (
        simulate(decaying(fmus), 0.5, "variable", coupling_tolerance=1e-2, extrapolation="hold", iterations=iterations)
        for iterations in (None, "auto")
    )
    assert error(iterated) < 1e-2
    steps = [r.info["variable_steps"]["steps"] for r in (plain, iterated)]
    assert steps[1] < 0.5 * steps[0]


def test_what_makes_no_sense_is_refused(fmus: Path, tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="step_size = 'often' must be a number"):
        simulate(decaying(fmus), 1.0, "often")
    with pytest.raises(SetupError, match="step_size = 'variable': realtime needs a fixed step"):
        simulate(decaying(fmus), 1.0, "variable", realtime=1.0)
    with pytest.raises(SetupError, match="coupling tolerance 2 must be a number between 0 and 1"):
        simulate(decaying(fmus), 1.0, "variable", coupling_tolerance=2)
    alone = System()
    alone.add("x", fmus / "Lag.fmu")
    with pytest.raises(SetupError, match="nothing real is connected"):
        simulate(alone, 1.0, "variable")
    for attribute, what in (
        ("canGetAndSetFMUstate", "component 'x': its FMU can't save its state"),
        ("canHandleVariableCommunicationStepSize", "component 'x' takes steps of one length only"),
    ):
        changed = redescribed(fmus / "Lag.fmu", tmp_path / f"{attribute}.fmu", {f'{attribute}="true"': ""})
        system = decaying(fmus)
        system.components["x"] = dataclasses.replace(system.components["x"], fmu=changed)
        with pytest.raises(SetupError, match=what):
            simulate(system, 1.0, "variable")


class Counter:
    """An object that can't go back."""

    def __call__(self, t: float, u: float) -> float:
        return t * u

    def reset(self) -> None:
        """Nothing is kept."""


def test_objects_that_cannot_go_back_are_refused(fmus: Path) -> None:
    system = decaying(fmus)
    system.add_function("c", Counter(), inputs=["u"], outputs=["y"])
    system.connect("x.x", "c.u")
    with pytest.raises(SetupError, match=r"component 'c': a Counter has no save\(\) and restore\(\)"):
        simulate(system, 1.0, "variable")


def test_an_error_that_no_step_keeps_ends_the_run(fmus: Path) -> None:
    """A function of time that is nowhere smooth."""
    system = System()
    system.add_function("noise", lambda t: float(np.sin(1e13 * t)), inputs=[], outputs=["y"])
    system.add("x", fmus / "Integrator.fmu")
    system.connect("noise.y", "x.u")
    system.add_function("far", lambda t, u: 1e6 * u, inputs=["u"], outputs=["y"])
    system.connect("x.x", "far.u")
    with pytest.raises(SimulationError, match="no communication step keeps a coupling error of 1e-06"):
        simulate(system, 1.0, "variable", coupling_tolerance=1e-6, record=["far.y"])


def test_a_signal_is_not_asked_beyond_the_step_that_is_tried(fmus: Path) -> None:
    """None is rejected, so what is asked for the first time after all times before is the end of a step."""
    asked: list[float] = []

    def signal(time: float) -> float:
        asked.append(time)
        return 1.0

    system = decaying(fmus, fast=1.0)
    system.add("driven", fmus / "Lag.fmu")
    system.drive("driven.u", signal)
    results = simulate(system, 1.0, "variable", extrapolation="hold", coupling_tolerance=2e-2)
    found = results.info["variable_steps"]
    assert found["rejected"] == 0
    assert found["longest"] > found["shortest"]
    np.testing.assert_array_equal(np.unique(np.maximum.accumulate(asked)), results.time[::2])
