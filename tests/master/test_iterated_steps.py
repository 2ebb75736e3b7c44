"""Steps that are repeated until inputs go to what comes out, on two masses with a spring between, solved exactly."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from cosim import Results, RunState, SetupError, Simulation, SimulationError, System, simulate
from cosim.analysis import largest_stable_step, spectral_radius
from tests.support.oscillators import (
    FORCED,
    FORCING,
    Oscillator,
    coupled,
    fastest_period,
    linear,
    oscillator_of,
)
from tests.support.small_fmus import build, redescribed

#: The force on a light mass, and on a heavy one: two ways to split two masses. Without damping, so that nothing hides
#: what a coupling adds.
LIGHT = (0.05, 1.0, 0.0, 1.0, 1.0, 0.0, 20.0, 0.0)
HEAVY = (1.0, 1.0, 0.0, 0.05, 1.0, 0.0, 20.0, 0.0)
SPLITS = pytest.mark.parametrize("split", [LIGHT, HEAVY], ids=["light", "heavy"])


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("iterated"), "fmi2", FORCED, FORCING)


def system(folder: Path, o: Oscillator, step: float) -> System:
    made = coupled(folder, o)
    for component in made.components.values():
        component.start["max_step"] = step
    return made


def error(results: Results, o: Oscillator) -> float:
    """Largest distance of the first mass from the exact solution, which begins at 1."""
    start = np.array([1.0, 0.0, -0.5, 0.0])
    exact = np.array([(scipy.linalg.expm(linear(o).closed_loop() * t) @ start)[0] for t in results.time])
    return float(np.abs(results["a.x"] - exact).max())


def run(
    folder: Path, o: Oscillator, part: float, extrapolation: str, iterations: int | str | None, periods: int = 20
) -> Results:
    """A run of some of the fastest periods with steps of a part of that period."""
    step = part * fastest_period(o)
    with Simulation(
        system(folder, o, 0.01 * fastest_period(o)), extrapolation=extrapolation, iterations=iterations
    ) as simulation:
        return simulation.run(round(periods / part) * step, step)


@pytest.mark.parametrize("extrapolation", ["hold", "linear", "hermite"])
def test_steps_that_are_iterated_stay_where_extrapolation_grows(fmus: Path, extrapolation: str) -> None:
    """With steps of 0.45 of the fastest period, which no extrapolation stands if the force is that on a light mass."""
    assert np.abs(run(fmus, LIGHT, 0.45, extrapolation, None, 100)["a.x"]).max() > 1e6
    results = run(fmus, LIGHT, 0.45, extrapolation, "auto", 100)
    assert np.abs(results["a.x"]).max() < 2.0
    found = results.info["iterated_steps"]
    assert found["not_converged"] == 0
    assert found["largest_residual"] <= found["tolerance"] == 1e-8
    assert found["iterations"] < 1.5 * found["steps"]  # what one step has taught serves the next one


@SPLITS
@pytest.mark.parametrize("part", [0.7, 2.3])
def test_held_inputs_that_are_iterated_stay_however_long_the_step_is(
    fmus: Path, split: Oscillator, part: float
) -> None:
    assert np.abs(run(fmus, split, part, "hold", "auto", 200)["a.x"]).max() < 4.0


@pytest.mark.parametrize("name", ["linear", "quadratic", "hermite", "adaptive"])
def test_runs_grow_and_decay_as_the_transition_matrix_says(fmus: Path, name: str) -> None:
    """By its largest eigenvalue, on both sides of the largest stable step, which is unstable without iteration."""
    o = oscillator_of((0.05, 1.0), 10.0, 0.02)
    limit = largest_stable_step(linear(o), extrapolation=name, iterated=True, longest=20.0)
    assert spectral_radius(linear(o), 0.96 * limit, extrapolation=name) > 1.0
    made = system(fmus, o, 0.01 * fastest_period(o))
    with Simulation(made, extrapolation=name, iterations="auto") as simulation:
        for h in (0.96 * limit, 1.04 * limit):
            radius = spectral_radius(linear(o), h, extrapolation=name, iterated=True)
            x = np.abs(simulation.run(300 * h, h)["a.x"])
            growth = (x[-50:].max() / x[-200:-150].max()) ** (1.0 / 150.0)
            assert growth == pytest.approx(radius, abs=3e-3), h
            assert (growth < 1.0) == (h < limit)


@SPLITS
def test_iteration_gives_stability_and_not_accuracy(fmus: Path, split: Oscillator) -> None:
    """Linear inputs keep their order; held ones gain one, by the means of both ends."""
    runs = [("hold", "auto"), ("linear", None), ("linear", "auto"), ("hermite", "auto")]
    errors = {
        (name, iterations): [error(run(fmus, split, part, name, iterations, 4), split) for part in (0.08, 0.04)]
        for name, iterations in runs
    }
    falls = {key: coarse / fine for key, (coarse, fine) in errors.items()}
    assert 0.1 < errors["linear", "auto"][1] / errors["linear", None][1] < 5.0
    assert 3.5 < falls["linear", "auto"] < 4.5
    assert 3.5 < falls["hold", "auto"] < 4.5
    assert 13.0 < falls["hermite", "auto"] < 19.0


def test_a_run_that_goes_on_from_a_state_counts_on(fmus: Path) -> None:
    made = system(fmus, LIGHT, 0.01)
    with Simulation(made, extrapolation="quadratic", iterations=2) as simulation:
        expected = simulation.run(1.0, 0.1)
        with simulation.start(0.1) as begun:
            begun.step(4)
            state = begun.save()
    with Simulation(made, extrapolation="quadratic", iterations=2) as simulation, simulation.start(0.1) as resumed:
        resumed.restore(state)
        resumed.step(6)
        assert resumed.results.info["iterated_steps"] == expected.info["iterated_steps"]
        np.testing.assert_array_equal(resumed.results.values[-1], expected.values[-1])


def test_one_iteration_does_nearly_all(fmus: Path) -> None:
    one, all_ = (error(run(fmus, HEAVY, 0.1, "linear", iterations, 10), HEAVY) for iterations in (1, "auto"))
    assert one == pytest.approx(all_, rel=0.3)
    found = run(fmus, HEAVY, 0.1, "linear", 1, 10).info["iterated_steps"]
    assert found["most_iterations"] == 1
    assert 0 < found["not_converged"] <= found["steps"]


def test_runs_again_by_hand_and_restored_have_the_same_bits(fmus: Path) -> None:
    step = 0.2 * fastest_period(LIGHT)
    with Simulation(system(fmus, LIGHT, 0.02), extrapolation="hermite", iterations="auto") as simulation:
        first, again = simulation.run(30 * step, step), simulation.run(30 * step, step)
        np.testing.assert_array_equal(first.values, again.values)
        with simulation.start(step, stop_time=30 * step) as stepped:
            stepped.step(10)
            state: RunState = stepped.save()
            stepped.step(20)
            by_hand = stepped.results.values
            stepped.restore(state)
            stepped.step(20)
            np.testing.assert_array_equal(stepped.results.values, by_hand)
        np.testing.assert_array_equal(by_hand, first.values)


def test_a_jump_is_no_value_that_inputs_go_to(fmus: Path) -> None:
    """A sudden force at a communication point: what was linear before it goes on so behind it, with second order."""
    errors = []
    for step in (0.1, 0.05):
        made = System()
        made.add("a", fmus / "Forced.fmu", start={"m": 1.0, "k": 1.0, "c": 0.0, "x_start": 0.0, "max_step": 0.01})
        made.add_function("p", lambda t, x, f: f - 3.0 * x, inputs=["x", "f"], outputs=["y"])
        made.connect("a.x", "p.x")
        made.connect("p.y", "a.f")
        made.drive("p.f", lambda t: 1.0 if t >= 1.0 else 0.0, breakpoints=[1.0])
        results = simulate(made, 4.0, step, iterations="auto")
        exact = np.where(results.time >= 1.0, (1.0 - np.cos(2.0 * (results.time - 1.0))) / 4.0, 0.0)
        errors.append(np.abs(results["a.x"] - exact).max())
    assert errors[0] < 3e-3
    assert 3.0 < errors[0] / errors[1] < 5.0


def test_fmus_that_cannot_go_back_are_refused_by_name(fmus: Path, tmp_path: Path) -> None:
    forgetful = redescribed(fmus / "Forced.fmu", tmp_path / "F.fmu", {'canGetAndSetFMUstate="true"': ""})
    made = system(fmus, HEAVY, 0.05)
    made.components["a"] = dataclasses.replace(made.components["a"], fmu=forgetful)
    with pytest.raises(
        SetupError, match="iterations = 'auto': steps can't be repeated: component 'a': its FMU can't save its state"
    ):
        simulate(made, 1.0, 0.1, iterations="auto")
    simulate(made, 1.0, 0.1, iterations="loops")
    # where it has an algebraic loop, that is solved
    made.add_function("p", lambda t, u: 0.5 * u, inputs=["u"], outputs=["y"])
    made.add_function("q", lambda t, u: 1.0 - u, inputs=["u"], outputs=["y"])
    made.connect("p.y", "q.u")
    made.connect("q.y", "p.u")
    results = simulate(made, 1.0, 0.1, iterations="auto")
    assert results.info["steps_not_iterated"].startswith("component 'a': its FMU can't save its state")
    assert "iterated_steps" not in results.info
    np.testing.assert_allclose(results["p.y"], 1.0 / 3.0)


def test_components_with_longer_steps_are_refused(fmus: Path) -> None:
    made = System()
    made.add("a", fmus / "Forced.fmu", every=2)
    made.add("b", fmus / "Forced.fmu")
    made.connect("a.x", "b.f")
    with pytest.raises(SetupError, match=r"component 'a' has a communication step of its own \(2 steps\)"):
        simulate(made, 1.0, 0.1, iterations=3)


def test_a_step_without_a_solution_is_an_error_with_its_residual(fmus: Path) -> None:
    """A relay against the motion: near the switch there is no force that the mass goes on with."""
    made = System()
    made.add("a", fmus / "Forced.fmu", start={"x_start": 0.14, "k": 0.0, "c": 0.0})
    made.add_function("relay", lambda t, x: -10.0 if x > 0.0 else 10.0, inputs=["x"], outputs=["f"])
    made.connect("a.x", "relay.x")
    made.connect("relay.f", "a.f")
    with pytest.raises(SimulationError, match=r"50 iterations in which inputs 'a\.f' go to what comes out: the resid"):
        simulate(made, 2.0, 0.2, iterations="auto")
    assert simulate(made, 2.0, 0.2, iterations=2).info["iterated_steps"]["not_converged"] > 0


def test_what_is_held_on_purpose_is_not_iterated(fmus: Path) -> None:
    def made(extrapolation: str | None) -> System:
        own = System()
        own.add("a", fmus / "Forced.fmu", start={"x_start": 1.0})
        own.add_function("controller", lambda t, x: -x, inputs=["x"], outputs=["f"])
        own.connect("a.x", "controller.x")
        own.connect("controller.f", "a.f", extrapolation=extrapolation)
        return own

    sampled = simulate(made("hold"), 2.0, 0.1, iterations="auto")
    np.testing.assert_array_equal(sampled.values, simulate(made("hold"), 2.0, 0.1).values)
    assert "iterated_steps" not in sampled.info
    assert simulate(made(None), 2.0, 0.1, iterations="auto").info["iterated_steps"]["inputs"] == ["a.f"]


def test_small_values_are_iterated_as_large_ones_are(fmus: Path) -> None:
    """The tolerance is relative to what inputs were in this run: the system is linear, so all is a part of it."""
    step = 0.2 * fastest_period(HEAVY)
    made, small = system(fmus, HEAVY, 0.05), system(fmus, HEAVY, 0.05)
    for component in small.components.values():
        component.start["x_start"] *= 2.0**-24
    runs = [simulate(each, 20 * step, step, iterations="auto") for each in (made, small)]
    largest = np.abs(runs[0].values).max()
    np.testing.assert_allclose(runs[1].values * 2.0**24, runs[0].values, rtol=0.0, atol=1e-7 * largest)
