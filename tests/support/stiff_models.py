"""Models for the tests of the solvers: stiff ones of the literature, and small ones with closed solutions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fmu_export.modelling.model import DefaultExperiment, Model, Requirement, Solver
from fmu_export.modelling.variables import Layout, Variable


def model(
    name: str,
    states: tuple[str, ...],
    start: tuple[float, ...],
    derivatives: Callable[..., Any],
    solver: Solver,
    parameters: dict[str, float] | None = None,
    inputs: dict[str, float] | None = None,
    requirements: tuple[Requirement, ...] = (),
) -> Model:
    """A model whose outputs are its states."""

    def variables(starts: dict[str, float]) -> Layout:
        return Layout([Variable(n, "1", f"Test quantity {n}", start=s) for n, s in starts.items()])

    return Model(
        name=name,
        description=f"{name}, a model for tests",
        parameters=variables(parameters or {}),
        inputs=variables(inputs or {}),
        outputs=variables(dict.fromkeys(states, 0.0)),
        states=states,
        initial_state=lambda p: np.array(start),
        derivatives=derivatives,
        output_values=lambda t, x, u, p: x,
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.1),
        requirements=requirements,
        solver=solver,
    )


def robertson(solver: Solver = "rodas4") -> Model:
    """Robertson's reaction, 1966: rates from 0.04 to 3e7."""

    def derivatives(t: Any, x: Any, u: Any, p: Any) -> Any:
        slow, fast, fastest = 0.04 * x[0], 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
        return np.stack([fast - slow, slow - fast - fastest, fastest])

    return model("Robertson", ("a", "b", "c"), (1.0, 0.0, 0.0), derivatives, solver)


def van_der_pol(solver: Solver = "rodas4") -> Model:
    """Van der Pol's oscillator, mu = 1000."""

    def derivatives(t: Any, x: Any, u: Any, p: Any) -> Any:
        return np.stack([x[1], p[0] * (1.0 - x[0] ** 2) * x[1] - x[0]])

    return model("VanDerPol", ("x", "v"), (2.0, 0.0), derivatives, solver, {"mu": 1000.0})


def smooth(solver: Solver) -> Model:
    """The system x' = -x u + cos t, y' = x - y / 2: depends on time, on an input and on itself, all smoothly."""

    def derivatives(t: Any, x: Any, u: Any, p: Any) -> Any:
        return np.stack([np.cos(t) - x[0] * u[0], x[0] - 0.5 * x[1]])

    return model("Smooth", ("x", "y"), (1.0, -1.0), derivatives, solver, inputs={"u": 0.5})


def diffusion(solver: Solver, rows: int = 10, columns: int = 20) -> Model:
    """Heat in a plate of 1 m by 2 m whose edge is at 0, on a grid of 200 points; one corner is hot at the start."""
    step = 1.0 / (rows + 1)

    def derivatives(t: Any, x: Any, u: Any, p: Any) -> Any:
        grid = np.reshape(x, (rows, columns))
        row, column = np.zeros((1, columns)), np.zeros((rows, 1))
        above, below = np.concatenate([row, grid[:-1]]), np.concatenate([grid[1:], row])
        left, right = np.concatenate([column, grid[:, :-1]], axis=1), np.concatenate([grid[:, 1:], column], axis=1)
        return np.reshape((above + below + left + right - 4.0 * grid) / step**2, (-1,))

    hot = tuple(float(i % columns < 5 and i // columns < 3) for i in range(rows * columns))
    return model("Diffusion", tuple(f"x{i}" for i in range(rows * columns)), hot, derivatives, solver)
