"""What a model is: declared variables and a few pure functions of (t, x, u, p).

A `Model` knows no FMI, no solver and no file. Its functions are written in plain numpy notation, take flat arrays
in the declared order and must stay free of branches on values, so that a back end can either call them with numbers
or trace them with symbols.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from fmu_export.errors import ArgumentError

#: A flat array of floats, or of symbols while a back end traces the model.
Array = Any
#: f(t, x, u, p): time (s), states (n_x,), inputs (n_u,), parameters (n_p,).
ModelFunction = Callable[[Any, Array, Array, Array], Array]


@dataclass(frozen=True)
class Variable:
    """A scalar or a vector that a model declares.

    Parameters
    ----------
    name : str
        The paper's symbol in ASCII, for example ``theta_a``.
    unit : str
        SI unit as defined in `fmu_export.modelling.units`; ``"1"`` for dimensionless.
    description : str
        One line for the users of other tools.
    size : int, optional
        Length of a vector, whose elements are named ``name[1]`` ...; None for a scalar.
    start : float or tuple of float
        Start value of a parameter or an input, one number for all elements or one an element.
    min, max : float, optional
        Smallest and largest admissible value (both inclusive).
    tunable : bool, optional
        Whether a parameter may change during a run, between two steps; the states go on from where they are.
    """

    name: str
    unit: str
    description: str
    size: int | None = None
    start: float | tuple[float, ...] = 0.0
    min: float | None = None
    max: float | None = None
    tunable: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the elements, as importers of an FMU see them."""
        return (self.name,) if self.size is None else tuple(f"{self.name}[{i + 1}]" for i in range(self.size))

    @property
    def starts(self) -> tuple[float, ...]:
        """Start values of the elements."""
        n = self.size or 1
        starts = self.start if isinstance(self.start, tuple) else (self.start,) * n
        if len(starts) != n:
            raise ArgumentError(f"variable '{self.name}' has {n} elements but {len(starts)} start values")
        return tuple(float(s) for s in starts)


class Layout:
    """The order of named variables in a flat array."""

    def __init__(self, variables: Sequence[Variable]) -> None:
        self.variables = tuple(variables)
        self.names = tuple(name for v in self.variables for name in v.names)
        if len(set(self.names)) != len(self.names):
            raise ArgumentError(f"variable names are not unique: {', '.join(self.names)}")
        self.starts = np.array([s for v in self.variables for s in v.starts])
        self._slices: dict[str, slice | int] = {}
        position = 0
        for v in self.variables:
            end = position + (v.size or 1)
            self._slices[v.name] = position if v.size is None else slice(position, end)
            position = end

    def __len__(self) -> int:
        return len(self.names)

    def unpack(self, flat: Array) -> SimpleNamespace:
        """Name the parts of a flat array: scalars and (size,) vectors."""
        return SimpleNamespace(**{name: flat[where] for name, where in self._slices.items()})

    def pack(self, **parts: Array) -> Array:
        """Join named parts to a flat array (n,).

        Raises
        ------
        TypeError
            A declared part is missing, or an undeclared one is given.
        """
        if parts.keys() != self._slices.keys():
            wrong = ", ".join(sorted(parts.keys() ^ self._slices.keys()))
            raise TypeError(f"parts and declared variables differ in: {wrong}")
        return np.concatenate([np.reshape(parts[v.name], (v.size or 1,)) for v in self.variables])


@dataclass(frozen=True)
class Requirement:
    """A quantity that must stay positive for the equations to make sense.

    Parameters
    ----------
    message : str
        What is wrong when it is not, and the remedy.
    margin : callable
        margin(t, x, u, p) -> scalar; the requirement holds while it is positive.
    at : {"start", "step"}
        "start": depends on parameters only, checked before the initial state is computed;
        "step": checked at the start and before every integration step. A model without states has none of these; its
        outputs must not be finite where a requirement is violated, which is then the reason given.
    """

    message: str
    margin: ModelFunction
    at: Literal["start", "step"] = "step"


@dataclass(frozen=True)
class DefaultExperiment:
    """What an importer proposes to its user, in seconds."""

    stop_time: float
    step_size: float
    start_time: float = 0.0


@dataclass(frozen=True)
class Model:
    """FMI-free physics.

    Parameters
    ----------
    name, description : str
        The name is also the FMI model identifier.
    parameters, inputs, outputs : Layout
        The declared variables. Every state is among the outputs, under its own name.
    states : tuple of str
        Names of the outputs that make up the state vector, in its order.
    initial_state : callable
        initial_state(p) -> (n_x,).
    derivatives : callable
        derivatives(t, x, u, p) -> (n_x,), per second.
    output_values : callable
        outputs(t, x, u, p) -> (n_y,), in the order of `outputs`.
    requirements : tuple of Requirement
        When the equations may be evaluated.
    default_experiment : DefaultExperiment
        Duration and step proposed to importers.

    Raises
    ------
    ArgumentError
        An input or an output is declared as tunable.
    """

    name: str
    description: str
    parameters: Layout
    inputs: Layout
    outputs: Layout
    states: tuple[str, ...]
    initial_state: Callable[[Array], Array]
    derivatives: ModelFunction
    output_values: ModelFunction
    default_experiment: DefaultExperiment
    requirements: tuple[Requirement, ...] = field(default=())

    def __post_init__(self) -> None:
        for v in (*self.inputs.variables, *self.outputs.variables):
            if v.tunable:
                raise ArgumentError(f"{self.name}: '{v.name}' is no parameter; only parameters can be tunable")

    @property
    def state_layout(self) -> Layout:
        """The declared variables of the states, in the order of the state vector."""
        declared = {v.name: v for v in self.outputs.variables}
        return Layout([declared[name] for name in self.states])
