"""What an importer sees of a model: a flat, ordered list of scalar variables and how they depend on each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import TYPE_CHECKING, Literal

import numpy as np

from fmu_export.errors import TraceError
from fmu_export.modelling.model import Model
from fmu_export.modelling.units import rate_unit
from fmu_export.modelling.variables import Layout, Type, Variable

if TYPE_CHECKING:
    from fmu_export.trace.trace import TracedModel

#: Every model with states integrates with steps no longer than this; it is numerics, so no model declares it.
MAX_STEP = Variable("max_step", "s", "Largest step of the internal Runge-Kutta method", start=1e-3, min=1e-9)

#: What methods have that choose their steps: a tolerance, and a limit that is none unless somebody sets it.
ADAPTIVE = (
    Variable(
        "rtol",
        "1",
        "Relative tolerance of the internal integration, where the importer gives none",
        start=1e-6,
        min=1e-11,
        max=0.1,
    ),
    Variable("max_step", "s", "Largest step of the internal integration", start=1e300, min=1e-9),
)

#: The same for a method that can do without.
ADAPTIVE_OR_FIXED = (
    replace(
        ADAPTIVE[0],
        description=f"{ADAPTIVE[0].description}; 0: steps are the communication step, or equal parts of it",
        start=1e-5,
        min=0.0,
    ),
    ADAPTIVE[1],
)


#: Names of items, or texts, and the numbers that stand for them.
Items = tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class ScalarVariable:
    """One scalar of the interface; its value reference is its position in `Interface.variables`."""

    name: str
    causality: Literal["parameter", "input", "output", "local"]
    variability: Literal["fixed", "tunable", "discrete", "continuous"]
    unit: str
    display_unit: str | None
    description: str
    start: float | None
    min: float | None
    max: float | None
    nominal: float | None
    type: Type
    items: Items

    @property
    def about(self) -> str:
        """Its description, or its name if there is none."""
        return self.description or self.name


def text_of(type_: Type, value: float, items: Items = ()) -> str:
    """A value of a type as text that reads back bit for bit: of an enumeration the item's value, a string itself."""
    if type_ == "real":
        return repr(value)
    if type_ == "boolean":
        return "true" if value else "false"
    if type_ == "string":
        return next(text for text, position in items if position == value)
    return str(int(value))


@dataclass(frozen=True)
class Entry:
    """A variable as a model description has it: a scalar, or an array whose elements follow each other."""

    name: str
    reference: int  # value reference, that of the first element
    shape: tuple[int, ...]
    description: str

    @property
    def elements(self) -> range:
        """Positions of the scalars."""
        return range(self.reference, self.reference + prod(self.shape))


@dataclass(frozen=True)
class StateDerivative:
    """The derivative of a state, for importers that integrate themselves (model exchange).

    Its value reference follows those of `Interface.variables`.
    """

    name: str
    unit: str
    state: int  # position of the state in `Interface.variables`
    state_start: float  # the state at the start, for the start values of the parameters
    dependencies: tuple[int, ...]  # positions of the states and inputs it depends on directly
    parameter_dependencies: tuple[int, ...]  # positions of the parameters it depends on directly
    initial_dependencies: tuple[int, ...]  # positions of parameters and inputs


@dataclass(frozen=True)
class Interface:
    """The scalar variables of a model, parameters first, then inputs, then outputs, then locals.

    `dependencies` and `initial_dependencies` hold for each output and local (in order) the positions of the variables
    that its value depends on directly: inputs during the simulation, parameters and inputs at initialisation;
    `state_dependencies` and `parameter_dependencies` those of the states and of the parameters during the simulation.
    What an output depends on through events and samplers, which see the inputs of the same instant, is among these.
    `indicators` are the names of the event indicators, whose value references follow that of the time. `declared` are
    the variables as the model declares them, arrays as arrays; with `arrays` the model description has these.
    """

    variables: tuple[ScalarVariable, ...]
    n_parameters: int
    n_inputs: int
    dependencies: tuple[tuple[int, ...], ...]
    initial_dependencies: tuple[tuple[int, ...], ...]
    state_dependencies: tuple[tuple[int, ...], ...]
    parameter_dependencies: tuple[tuple[int, ...], ...]
    derivatives: tuple[StateDerivative, ...]
    indicators: tuple[str, ...] = ()
    declared: tuple[Entry, ...] = ()
    arrays: bool = False

    @property
    def nominals(self) -> tuple[float, ...]:
        """Nominal values of the states."""
        return tuple(self.variables[i].nominal or 1.0 for i in self.states)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The variables of the model description without state derivatives, time and indicators."""
        if self.arrays:
            return self.declared
        return tuple(Entry(v.name, i, (), v.description) for i, v in enumerate(self.variables))

    @property
    def derivative_entries(self) -> tuple[Entry, ...]:
        """The state derivatives of the model description."""
        shown = {entry.reference: entry for entry in self.entries}
        found = []
        for reference, d in enumerate(self.derivatives, start=len(self.variables)):
            if d.state in shown:
                state = shown[d.state]
                about = f"Time derivative of: {state.description or state.name}"
                found.append(Entry(f"der({state.name})", reference, state.shape, about))
        return tuple(found)

    @property
    def references(self) -> dict[int, int]:
        """Value reference of each scalar: its own position, or that of the array that it belongs to."""
        entries = (*self.entries, *self.derivative_entries)
        return {i: entry.reference for entry in entries for i in entry.elements}

    @property
    def states(self) -> tuple[int, ...]:
        """Positions of the states in `variables`, in the order of the state vector."""
        return tuple(d.state for d in self.derivatives)

    @property
    def n_computed(self) -> int:
        """Number of scalar outputs and locals."""
        return len(self.variables) - self.n_parameters - self.n_inputs

    @property
    def n_outputs(self) -> int:
        """Number of scalar outputs."""
        return sum(v.causality == "output" for v in self.variables)


def _numerics(model: Model) -> tuple[Variable, ...]:
    """The parameters that its solver adds to a model."""
    if not model.states:
        return (MAX_STEP,) if model.events else ()
    return {"rk4": (MAX_STEP,), "rk43": ADAPTIVE_OR_FIXED}.get(model.solver, ADAPTIVE)


def interface_of(traced: TracedModel) -> Interface:
    """Flatten the declared variables of a model and find the structure of its outputs in its expression graphs.

    Raises
    ------
    TraceError
        A parameter is declared as tunable though a change during a run has no effect, or could break a requirement
        that is checked at the start only.
    """
    model = traced.model
    _check_tunables(traced)
    parameters = Layout((*model.parameters.variables, *_numerics(model)))
    variables = [
        *_flatten(parameters, "parameter"),
        *_flatten(model.inputs, "input"),
        *_flatten(model.outputs, "output"),
        *_flatten(Layout(model.computed.variables[len(model.outputs.variables) :]), "local"),
    ]
    first_input = len(parameters)
    first_output = first_input + len(model.inputs)
    places = {name: first_output + i for i, name in enumerate(model.computed.names)}
    states = [places[name] for name in model.state_layout.names]
    for i in traced.discrete_outputs():
        variables[first_output + i] = replace(variables[first_output + i], variability="discrete")
    on_parameters, on_inputs = traced.initial_output_dependencies()
    later_on_inputs, later_on_parameters = traced.output_dependencies(), traced.output_parameter_dependencies()
    if not model.is_continuous:
        read = traced.output_states()
        then, at_start = traced.influence(), traced.influence(at_start=True)
        later_on_inputs = _united(later_on_inputs, read, then.inputs)
        later_on_parameters = _united(later_on_parameters, read, then.parameters)
        on_inputs = _united(on_inputs, read, at_start.inputs)
        on_parameters = _united(on_parameters, read, at_start.parameters)
    return Interface(
        variables=tuple(variables),
        n_parameters=len(parameters),
        n_inputs=len(model.inputs),
        dependencies=tuple(tuple(first_input + i for i in row) for row in later_on_inputs),
        initial_dependencies=tuple(
            (*ps, *(first_input + i for i in us)) for ps, us in zip(on_parameters, on_inputs, strict=True)
        ),
        state_dependencies=tuple(tuple(states[i] for i in row) for row in traced.output_state_dependencies()),
        parameter_dependencies=tuple(tuple(row) for row in later_on_parameters),
        derivatives=tuple(
            StateDerivative(
                name=f"der({variables[state].name})",
                unit=rate_unit(variables[state].unit),
                state=state,
                state_start=start,
                dependencies=(*(states[j] for j in xs), *(first_input + i for i in us)),
                parameter_dependencies=tuple(later),
                initial_dependencies=(*ps, *(first_input + i for i in us)),
            )
            for state, start, xs, us, ps, later in zip(
                states,
                _state_starts(traced),
                *traced.derivative_dependencies(),
                traced.derivative_parameter_dependencies(),
                strict=True,
            )
        ),
        indicators=tuple(f"{event.name}.indicator" for event in model.events),
        declared=_entries(parameters, model.inputs, model.computed),
    )


def _entries(*layouts: Layout) -> tuple[Entry, ...]:
    entries: list[Entry] = []
    for v in (v for layout in layouts for v in layout.variables):
        entries.append(Entry(v.name, entries[-1].elements.stop if entries else 0, v.shape, _description(v)))
    return tuple(entries)


def _description(v: Variable, element: str = "") -> str:
    texts = f" (one of {', '.join(repr(text) for text, _ in v.items)})" if v.type == "string" else ""
    return (v.description + element + texts).strip()


def _united(
    direct: Sequence[Sequence[int]], states: Sequence[Sequence[int]], influence: Sequence[Iterable[int]]
) -> list[list[int]]:
    """What values depend on directly, and through the states that they read."""
    return [sorted({*row, *(k for j in read for k in influence[j])}) for row, read in zip(direct, states, strict=True)]


def _state_starts(traced: TracedModel) -> list[float]:
    """The states for the start values of the parameters; as guesses, without digits that differ between machines."""
    computed = traced.initial_state(list(traced.model.parameters.starts)).full().ravel().tolist()
    return [float(f"{value:.15g}") for value in computed]


def _check_tunables(traced: TracedModel) -> None:
    model = traced.model
    during = {i for row in traced.output_parameter_dependencies() for i in row}
    during |= {i for row in traced.derivative_parameter_dependencies() for i in row}
    during |= traced.change_parameter_dependencies()
    at_start = {i for row in traced.start_requirement_dependencies() for i in row}
    first = 0
    for v in model.parameters.variables:
        own = set(range(first, first + v.n_elements))
        first += len(own)
        if v.tunable and not own & during:
            raise TraceError(
                f"{model.name}: parameter '{v.name}' is declared as tunable, but neither outputs nor derivatives "
                "depend on it: a change during a run would have no effect; leave out tunable=True"
            )
        if v.tunable and own & at_start:
            raise TraceError(
                f"{model.name}: parameter '{v.name}' is declared as tunable, but a requirement that is checked at the "
                'start only depends on it; give that requirement at="step", or leave out tunable=True'
            )


def _flatten(layout: Layout, causality: Literal["parameter", "input", "output", "local"]) -> list[ScalarVariable]:
    scalars = []
    for v in layout.variables:
        changes: Literal["continuous", "discrete"] = "continuous" if v.type == "real" else "discrete"
        indices = [", ".join(str(i + 1) for i in where) for where in np.ndindex(v.shape)]
        for index, name, start in zip(indices, v.names, v.starts, strict=True):
            element = f" (element {index})" if v.size else ""
            scalars.append(
                ScalarVariable(
                    name=name,
                    causality=causality,
                    variability=changes if causality != "parameter" else "tunable" if v.tunable else "fixed",
                    unit=v.unit,
                    display_unit=v.display_unit,
                    description=_description(v, element),
                    start=None if causality in ("output", "local") else start,
                    min=v.min,
                    max=v.max,
                    nominal=v.nominal,
                    type=v.type,
                    items=v.items,
                )
            )
    return scalars
