"""Small models with closed-form behaviour, for the tests of the co-simulation core."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.modelling.model import DefaultExperiment, Model, Requirement
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.pythonfmu.backend import build_pythonfmu


def _model(
    name: str,
    parameters: Sequence[Variable],
    inputs: Sequence[Variable],
    outputs: Sequence[Variable],
    output_values: Callable[..., Any],
    states: tuple[str, ...] = (),
    initial_state: Callable[[Any], Any] = lambda p: p[:0],
    derivatives: Callable[..., Any] = lambda t, x, u, p: x,
    requirements: tuple[Requirement, ...] = (),
) -> Model:
    return Model(
        name=name,
        description=f"{name}, a model for tests",
        parameters=Layout(parameters),
        inputs=Layout(inputs),
        outputs=Layout(outputs),
        states=states,
        initial_state=initial_state,
        derivatives=derivatives,
        output_values=output_values,
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.1),
        requirements=requirements,
    )


def _number(name: str, unit: str = "1", **options: Any) -> Variable:
    return Variable(name, unit, f"Test quantity {name}", **options)


def _gain(name: str, size: int) -> Model:
    return _model(
        name,
        [_number("K", start=2.0, min=-10.0, max=10.0)],
        [_number("u", size=size)],
        [_number("y", size=size)],
        lambda t, x, u, p: p[0] * u,
    )


#: y = K u, each a vector of 2; direct feedthrough.
GAIN = _gain("Gain", 2)
#: The same with vectors of 3.
GAIN3 = _gain("Gain3", 3)

#: x' = u / T; no feedthrough.
INTEGRATOR = _model(
    "Integrator",
    [_number("x_start"), _number("T", "s", start=1.0, min=1e-6)],
    [_number("u")],
    [_number("x")],
    lambda t, x, u, p: x,
    states=("x",),
    initial_state=lambda p: p[:1],
    derivatives=lambda t, x, u, p: u / p[1],
)

#: x' = (u - x) / T; under a constant input x(t) = u + (x_start - u) exp(-t / T).
LAG = _model(
    "Lag",
    [_number("x_start"), _number("T", "s", start=1.0, min=1e-6)],
    [_number("u")],
    [_number("x")],
    lambda t, x, u, p: x,
    states=("x",),
    initial_state=lambda p: p[:1],
    derivatives=lambda t, x, u, p: (u - x) / p[1],
)

#: now = t: the time that the importer says it is.
CLOCK = _model("Clock", [], [], [_number("now", "s")], lambda t, x, u, p: np.reshape(t, (1,)))

FRAGILE_MESSAGE = "the input u is 0 or negative: keep it positive"

#: y = u, which must stay positive: fails in the step otherwise.
FRAGILE = _model(
    "Fragile",
    [],
    [_number("u", start=1.0)],
    [_number("y")],
    lambda t, x, u, p: u,
    requirements=(Requirement(FRAGILE_MESSAGE, lambda t, x, u, p: u[0]),),
)

#: y = sqrt(u): the output itself can't be computed for a negative input.
ROOT = _model("Root", [], [_number("u", start=1.0)], [_number("y")], lambda t, x, u, p: np.sqrt(u))

#: p = a + 1 and q = 2 b: two independent paths with feedthrough.
CROSS = _model(
    "Cross",
    [],
    [_number("a"), _number("b")],
    [_number("p"), _number("q")],
    lambda t, x, u, p: np.stack([u[0] + 1.0, 2.0 * u[1]]),
)

#: energy = torque and place = length: inputs and outputs with units.
UNITS = _model(
    "Units",
    [],
    [_number("torque", "N.m"), _number("length", "m")],
    [_number("energy", "J"), _number("place", "m")],
    lambda t, x, u, p: u,
)

#: y = u with the elements of both declared in the order 2, 1.
REVERSED = _model(
    "Reversed",
    [],
    [_number("u[2]"), _number("u[1]")],
    [_number("y[2]"), _number("y[1]")],
    lambda t, x, u, p: u,
)

#: x' = a + 10 b, p = a: whoever feeds b from p has to set the inputs one after the other.
TWO_LEVELS = _model(
    "TwoLevels",
    [],
    [_number("a"), _number("b")],
    [_number("p"), _number("x")],
    lambda t, x, u, p: np.stack([u[0], x[0]]),
    states=("x",),
    initial_state=lambda p: np.zeros(1),
    derivatives=lambda t, x, u, p: np.stack([u[0] + 10.0 * u[1]]),
)

ALL = (GAIN, GAIN3, INTEGRATOR, LAG, CLOCK, FRAGILE, ROOT, CROSS, UNITS, REVERSED, TWO_LEVELS)


def build(folder: Path, *models: Model) -> Path:
    """Write the FMUs of models, all of this module by default, to a folder and give it back."""
    for model in models or ALL:
        build_pythonfmu(model, folder)
    return folder
