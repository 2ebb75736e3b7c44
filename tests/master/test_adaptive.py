"""Adaptive extrapolation: stable where linear is, accurate where Hermite is, on two masses with a spring between."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from cosim import Simulation, System, simulate
from cosim.analysis import LinearComponent, LinearSystem, largest_stable_step, spectral_radius
from fmu_export import Layout, Model, Variable
from tests.support.small_fmus import build


def _mass(
    name: str, inputs: list[str], outputs: list[str], states: tuple[str, str], derivatives, output_values
) -> Model:  # type: ignore[no-untyped-def]
    """A mass m on a spring k with damping c to the ground, and another one, kc and cc, between both masses."""
    numbers = [Variable(n, "1", f"Number {n}", start=1.0) for n in ("m", "k", "c", "kc", "cc", "x_start")]
    return Model(
        name=name,
        description=f"{name}, half of an oscillator",
        parameters=Layout(numbers),
        inputs=Layout([Variable(n, "1", n) for n in inputs]),
        outputs=Layout([Variable(n, "1", n) for n in outputs]),
        states=states,
        initial_state=lambda p: np.stack([p[5], 0.0 * p[5]]),
        derivatives=derivatives,
        output_values=output_values,
    )


#: Gets a force, gives where it is.
FORCED = _mass(
    "Forced",
    ["f"],
    ["x", "v"],
    ("x", "v"),
    lambda t, x, u, p: np.stack([x[1], (u[0] - p[1] * x[0] - p[2] * x[1]) / p[0]]),
    lambda t, x, u, p: x,
)
#: Has the spring, gets where the other one is, gives the force on it.
FORCING = _mass(
    "Forcing",
    ["x", "v"],
    ["f", "y", "w"],
    ("y", "w"),
    lambda t, x, u, p: np.stack(
        [x[1], (p[3] * (u[0] - x[0]) + p[4] * (u[1] - x[1]) - p[1] * x[0] - p[2] * x[1]) / p[0]]
    ),
    lambda t, x, u, p: np.stack([p[3] * (x[0] - u[0]) + p[4] * (x[1] - u[1]), x[0], x[1]]),
)

#: Mass, spring, damping of both, and the spring and damper between them.
Oscillator = tuple[float, float, float, float, float, float, float, float]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("adaptive")
    return build(folder, "fmi2", FORCED, FORCING)


def oscillator(damping: float, spring: float, mass: float) -> Oscillator:
    """The first mass and its spring are 1; the dampings are those of each spring with its mass alone."""
    own, between = 2.0 * damping * math.sqrt(mass), 2.0 * damping * math.sqrt(spring)
    return 1.0, 1.0, 2.0 * damping, mass, 1.0, own, spring, between


def linear(o: Oscillator) -> LinearSystem:
    m1, k1, c1, m2, k2, c2, kc, cc = o
    a = LinearComponent([[0, 1], [-k1 / m1, -c1 / m1]], [[0], [1 / m1]], np.eye(2), np.zeros((2, 1)), ["f"], ["x", "v"])
    b = LinearComponent(
        [[0, 1], [-(k2 + kc) / m2, -(c2 + cc) / m2]],
        [[0, 0], [kc / m2, cc / m2]],
        [[kc, cc]],
        [[-kc, -cc]],
        ["x", "v"],
        ["f"],
    )
    return LinearSystem({"a": a, "b": b}, [("a.x", "b.x"), ("a.v", "b.v"), ("b.f", "a.f")])


def coupled(folder: Path, o: Oscillator) -> System:
    m1, k1, c1, m2, k2, c2, kc, cc = o
    system = System()
    system.add("a", folder / "Forced.fmu", start={"m": m1, "k": k1, "c": c1, "x_start": 1.0, "max_step": 0.05})
    system.add(
        "b",
        folder / "Forcing.fmu",
        start={"m": m2, "k": k2, "c": c2, "kc": kc, "cc": cc, "x_start": -0.5, "max_step": 0.05},
    )
    system.connect("a.x", "b.x")
    system.connect("a.v", "b.v")
    system.connect("b.f", "a.f")
    return system


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
