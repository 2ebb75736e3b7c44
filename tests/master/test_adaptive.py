"""Adaptive extrapolation: stable where linear is, accurate where Hermite is, on two masses with a spring between."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from cosim import Simulation, simulate
from cosim.analysis import largest_stable_step, spectral_radius
from tests.support.oscillators import FORCED, FORCING, Oscillator, coupled, linear, oscillator
from tests.support.small_fmus import build


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("adaptive")
    return build(folder, "fmi2", FORCED, FORCING)


def growth(folder: Path, o: Oscillator, step: float, name: str, n: int = 600) -> float:
    """By what factor a run grows from step to step, of its latter half."""
    x = np.abs(simulate(coupled(folder, o), n * step, step, extrapolation=name)["a.x"])
    return float((x[-n // 6 :].max() / x[n // 3 : n // 2].max()) ** (2.0 / n))


#: Damping, spring and mass; where Hermite extrapolation is unstable at steps at which linear extrapolation is stable.
WITHOUT_CHOICE = [(0.02, 1.0, 0.1), (0.1, 0.1, 1.0)]


@pytest.mark.parametrize("which", WITHOUT_CHOICE)
def test_it_is_stable_where_linear_is_and_hermite_is_not(fmus: Path, which: tuple[float, float, float]) -> None:
    o = oscillator(*which)
    step = 0.95 * largest_stable_step(linear(o), extrapolation="linear", longest=20.0)
    assert spectral_radius(linear(o), step, extrapolation="hermite-least-squares") > 1.0
    assert growth(fmus, o, step, "linear") < 1.0
    assert growth(fmus, o, step, "adaptive") < 1.0


@pytest.mark.slow  # two of them run always
@pytest.mark.parametrize("damping", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("spring", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("mass", [0.1, 1.0, 10.0])
def test_it_is_stable_up_to_the_limit_of_linear(fmus: Path, damping: float, spring: float, mass: float) -> None:
    o = oscillator(damping, spring, mass)
    limit = min(20.0, largest_stable_step(linear(o), extrapolation="linear", longest=20.0))
    for part in (0.95, 0.8, 0.6, 0.4, 0.2):
        assert growth(fmus, o, part * limit, "adaptive") < 1.0, part


def test_it_is_as_accurate_as_hermite_where_steps_are_short(fmus: Path) -> None:
    """The exact solution is a matrix exponential; linear extrapolation is hundreds of times further away."""
    o, stop, errors = oscillator(0.1, 1.0, 1.0), 8.0, {}
    for name in ("linear", "hermite-least-squares", "adaptive"):
        with Simulation(coupled(fmus, o), extrapolation=name) as simulation:
            r = simulation.run(stop, 0.02)
        exact = [scipy.linalg.expm(linear(o).closed_loop() * t) @ [1.0, 0.0, -0.5, 0.0] for t in r.time]
        errors[name] = float(np.abs(r["a.x"] - np.array(exact)[:, 0]).max())
    print(errors)
    assert errors["adaptive"] < 2.0 * errors["hermite-least-squares"]
    assert errors["adaptive"] < 0.05 * errors["linear"]
