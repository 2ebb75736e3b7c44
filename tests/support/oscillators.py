"""Two masses with a spring between them, in two FMUs: one gets a force, the other has the spring and gives it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from cosim import System
from cosim.analysis import LinearComponent, LinearSystem
from fmu_export import Layout, Model, Variable


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


def oscillator(damping: float, spring: float, mass: float) -> Oscillator:
    """The first mass and its spring are 1; the dampings are those of each spring with its mass alone."""
    own, between = 2.0 * damping * math.sqrt(mass), 2.0 * damping * math.sqrt(spring)
    return 1.0, 1.0, 2.0 * damping, mass, 1.0, own, spring, between


def splits() -> list[Oscillator]:
    """24 oscillators of a light and a heavy mass, 1 to 20: the force on either, springs, dampings."""
    return [
        oscillator_of(masses, spring, damping)
        for masses in ((0.05, 1.0), (1.0, 0.05))
        for spring in (0.1, 1.0, 10.0, 100.0)
        for damping in (0.0, 0.02, 0.1)
    ]


def oscillator_of(masses: tuple[float, float], spring: float, damping: float) -> Oscillator:
    """Both masses on springs of 1; the dampings are those of each spring with its mass, or the lighter one, alone."""
    own = [2.0 * damping * math.sqrt(m) for m in masses]
    return masses[0], 1.0, own[0], masses[1], 1.0, own[1], spring, 2.0 * damping * math.sqrt(spring * min(masses))


def fastest_period(o: Oscillator) -> float:
    """In s."""
    return float(2.0 * np.pi / np.abs(np.linalg.eigvals(linear(o).closed_loop())).max())


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
