"""What a model is: declared variables and a few pure functions of (t, x, u, p).

A `Model` knows no FMI, no solver and no file. Its functions are written in plain numpy notation, take flat arrays
in the declared order and must stay free of branches on values, so that a back end can either call them with numbers
or trace them with symbols.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from fmu_export.errors import ArgumentError
from fmu_export.modelling.names import check_identifier, check_text
from fmu_export.modelling.variables import Array, Layout, check_unique, number

#: f(t, x, u, p): time (s), states (n_x,), inputs (n_u,), parameters (n_p,).
ModelFunction = Callable[[Any, Array, Array, Array], Array]

#: Parameters that the exporter adds to models with states.
RESERVED = ("max_step",)


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

    def __post_init__(self) -> None:
        check_text("the message of a requirement", self.message)
        if self.at not in ("start", "step"):
            raise ArgumentError(f"requirement '{self.message}': at is {self.at!r}; it must be 'start' or 'step'")


@dataclass(frozen=True)
class DefaultExperiment:
    """What an importer proposes to its user, in seconds.

    Raises
    ------
    ArgumentError
        The stop is not after the start, the step is not positive, or a number is not finite.
    """

    stop_time: float
    step_size: float
    start_time: float = 0.0

    def __post_init__(self) -> None:
        for name in ("stop_time", "step_size", "start_time"):
            object.__setattr__(self, name, number("default experiment", name, getattr(self, name)))
        if not self.stop_time > self.start_time:
            raise ArgumentError(
                f"default experiment: stop_time {self.stop_time!r} is not after start_time {self.start_time!r}"
            )
        if not self.step_size > 0.0:
            raise ArgumentError(f"default experiment: step_size {self.step_size!r} is not positive")


#: The experiment of a model that gives none.
DEFAULT_EXPERIMENT = DefaultExperiment(stop_time=1.0, step_size=0.01)

_NONE = Layout()


def _no_state(p: Array) -> Array:  # noqa: ARG001
    """State of a model without states."""
    return np.zeros(0)


def _the_state(t: Any, x: Array, *_: Array) -> Array:  # noqa: ARG001
    """Derivatives of no states; outputs that are the states."""
    return x


@dataclass(frozen=True, kw_only=True)
class Model:
    """FMI-free physics: a model as flat arrays and functions; `ModelClass` is the layer above, with names.

    Parameters
    ----------
    name, description : str
        The name is also the FMI model identifier; the description is optional.
    parameters, inputs, outputs : Layout, optional
        The declared variables. Every state is among the outputs, under its own name.
    states : tuple of str, optional
        Names of the outputs that make up the state vector, in its order.
    initial_state : callable
        initial_state(p) -> (n_x,); optional without states, as are the derivatives.
    derivatives : callable
        derivatives(t, x, u, p) -> (n_x,), per second.
    output_values : callable
        outputs(t, x, u, p) -> (n_y,), in the order of `outputs`; optional where those are the states, in their order.
    requirements : tuple of Requirement
        When the equations may be evaluated.
    default_experiment : DefaultExperiment, optional
        Duration and step proposed to importers; 1 s in steps of 10 ms by default.

    Raises
    ------
    ArgumentError
        A name can't be taken or is there twice, a start value is outside its limits, a state is no output, an input or
        an output is declared as tunable, or an argument is of another kind.
    """

    name: str
    description: str = ""
    parameters: Layout = _NONE
    inputs: Layout = _NONE
    outputs: Layout = _NONE
    states: tuple[str, ...] = ()
    initial_state: Callable[[Array], Array] = _no_state
    derivatives: ModelFunction = _the_state
    output_values: ModelFunction = _the_state
    default_experiment: DefaultExperiment = DEFAULT_EXPERIMENT
    requirements: tuple[Requirement, ...] = field(default=())

    def __post_init__(self) -> None:
        check_identifier("model", self.name)
        check_text(f"{self.name}: the description", self.description)
        for group in ("parameters", "inputs", "outputs"):
            object.__setattr__(self, group, self._layout(group))
        object.__setattr__(self, "states", self._sequence("states", str, "names of outputs"))
        object.__setattr__(self, "requirements", self._sequence("requirements", Requirement, "Requirements"))
        if not isinstance(self.default_experiment, DefaultExperiment):
            raise ArgumentError(f"{self.name}: default_experiment is {self.default_experiment!r}, no DefaultExperiment")
        for function in ("initial_state", "derivatives", "output_values"):
            if not callable(getattr(self, function)):
                raise ArgumentError(f"{self.name}: {function} is no function")
        self._check_variables()
        self._check_functions()

    def _layout(self, group: str) -> Layout:
        value = getattr(self, group)
        try:
            return value if isinstance(value, Layout) else Layout(value)
        except ArgumentError as error:
            raise ArgumentError(f"{self.name}: {group}: {error}") from None
        except TypeError:
            raise ArgumentError(f"{self.name}: {group} is {value!r}; give a Layout or a list of Variables") from None

    def _sequence(self, name: str, kind: type, kinds: str) -> tuple[Any, ...]:
        value = getattr(self, name)
        try:
            parts = () if isinstance(value, str) else tuple(value)
        except TypeError:
            parts = (None,)
        if isinstance(value, str) or not all(isinstance(part, kind) for part in parts):
            raise ArgumentError(f"{self.name}: {name} is {value!r}; give a tuple of {kinds}")
        return parts

    def _check_variables(self) -> None:
        groups = {"parameter": self.parameters, "input": self.inputs, "output": self.outputs}
        declared = [v for layout in groups.values() for v in layout.variables]
        check_unique([v.name for v in declared], f"{self.name}: ")
        check_unique([name for v in declared for name in v.names], f"{self.name}: ")
        for what, layout in groups.items():
            for v in layout.variables:
                if what != "output":  # outputs have no start values
                    v.check_starts(f"{self.name}: {what}")
                if v.tunable and what != "parameter":
                    raise ArgumentError(f"{self.name}: '{v.name}' is no parameter; only parameters can be tunable")
                if self.states and v.name in RESERVED:
                    raise ArgumentError(
                        f"{self.name}: {what} '{v.name}': every FMU with states has a parameter of this name"
                    )
        outputs = [v.name for v in self.outputs.variables]
        for state in self.states:
            if state not in outputs:
                raise ArgumentError(
                    f"{self.name}: state '{state}' is no output; declare an output of this name, known are "
                    f"{', '.join(outputs) or 'none'}"
                )
        check_unique(self.states, f"{self.name}: states: ")

    def _check_functions(self) -> None:
        """Refuse functions that are left out though there is something to compute."""
        for name, left_out in (("initial_state", _no_state), ("derivatives", _the_state)):
            if self.states and getattr(self, name) is left_out:
                raise ArgumentError(f"{self.name}: there are states, but no {name}; give the function")
        outputs = tuple(v.name for v in self.outputs.variables)
        if self.output_values is _the_state and outputs != self.states:
            computed = ", ".join(name for name in outputs if name not in self.states)
            what = f"'{computed}' has no value" if computed else "the outputs are the states in another order"
            raise ArgumentError(f"{self.name}: {what}; give output_values")

    @property
    def state_layout(self) -> Layout:
        """The declared variables of the states, in the order of the state vector."""
        declared = {v.name: v for v in self.outputs.variables}
        return Layout([declared[name] for name in self.states])
