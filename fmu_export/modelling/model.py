"""What a model is: declared variables and a few pure functions of (t, x, u, p), with discrete states (t, x, z, u, p).

A `Model` knows no FMI, no solver and no file. Its functions are written in plain numpy notation, take flat arrays
in the declared order and must stay free of branches on values, so that a back end can either call them with numbers
or trace them with symbols.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from fmu_export.errors import ArgumentError
from fmu_export.modelling.names import check_identifier, check_text, check_variable_name
from fmu_export.modelling.variables import Array, Layout, check_unique, number

#: f(t, x, u, p): time (s), states (n_x,), inputs (n_u,), parameters (n_p,); of a model with discrete states z (n_z,)
#: f(t, x, z, u, p).
ModelFunction = Callable[..., Array]

#: How the states are integrated in co-simulation: by the classical Runge-Kutta method with a fixed step, by the same
#: or that of Dormand and Prince with steps that a tolerance allows, or by RODAS, which is implicit, for stiff models.
Solver = Literal["rk4", "rk43", "dopri5", "rodas4"]

#: Parameters that the exporter adds to models with states, by their solver.
RESERVED: dict[Solver, tuple[str, ...]] = {
    "rk4": ("max_step",),
    "rk43": ("rtol", "max_step"),
    "dopri5": ("rtol", "max_step"),
    "rodas4": ("rtol", "max_step"),
}


@dataclass(frozen=True)
class Requirement:
    """A quantity that must stay positive for the equations to make sense.

    Parameters
    ----------
    message : str
        What is wrong when it is not, and the remedy.
    margin : callable
        margin(t, x, u, p) -> scalar, or margin(t, x, z, u, p); the requirement holds while it is positive.
    at : {"start", "step"}
        "start": depends on parameters only, checked before the initial state is computed;
        "step": checked at the start and before every integration step. A model without states has none of these; its
        outputs must not be finite where a requirement is violated, which is then the reason given.
    of_integration : bool, optional
        It says that the FMU's own integration is good enough. In model exchange, where the importer integrates and may
        ask for derivatives anywhere, it does not count.
    """

    message: str
    margin: ModelFunction
    at: Literal["start", "step"] = "step"
    of_integration: bool = False

    def __post_init__(self) -> None:
        check_text("the message of a requirement", self.message)
        if self.at not in ("start", "step"):
            raise ArgumentError(f"requirement '{self.message}': at is {self.at!r}; it must be 'start' or 'step'")


@dataclass(frozen=True)
class Event:
    """What happens when an indicator crosses zero: states change at once.

    An event happens at the instant at which its indicator, from above zero, becomes zero or less (falling), from below
    zero becomes zero or more (rising), or either. An indicator that begins on the other side has not crossed. After an
    event that leaves the indicator at zero, and rising from there, the next fall is an event again.

    Parameters
    ----------
    name : str
        An identifier, unique in the model.
    indicator : callable
        indicator(t, x, u, p) -> scalar; with discrete states, indicator(t, x, z, u, p).
    reset : callable
        Of the same arguments -> the states (n_x,) after the event; with discrete states a pair, (n_x,) and (n_z,).
    direction : {"falling", "rising", "both"}, optional

    Raises
    ------
    ArgumentError
        The name is not an identifier, a function can't be called, or the direction is another.
    """

    name: str
    indicator: ModelFunction
    reset: Callable[..., Array | tuple[Array, Array]]
    direction: Literal["falling", "rising", "both"] = "falling"

    def __post_init__(self) -> None:
        _check_part("event", self.name, indicator=self.indicator, reset=self.reset)
        if self.direction not in ("falling", "rising", "both"):
            raise ArgumentError(
                f"event '{self.name}': direction is {self.direction!r}; it must be 'falling', 'rising' or 'both'"
            )


@dataclass(frozen=True)
class Sampled:
    """A change of the discrete states at the instants offset, offset + period, offset + 2 period, ...

    At an instant the continuous states have arrived; all updates whose instant it is see the discrete states before
    any of them, and each changes the elements for which it returns other values. Events follow.

    Parameters
    ----------
    name : str
        An identifier, unique in the model.
    update : callable
        update(t, x, z, u, p) -> discrete states (n_z,) from this instant on.
    period, offset : float or str, optional
        In seconds, or the name of a scalar parameter that holds it; the period is positive. Instants are those of the
        time itself: with offset 0 there is one at t = 0, and none before it.

    Raises
    ------
    ArgumentError
        The name is not an identifier, the update can't be called, or period or offset can't be taken.
    """

    name: str
    update: ModelFunction
    period: float | str
    offset: float | str = 0.0

    def __post_init__(self) -> None:
        _check_part("sampled", self.name, update=self.update)
        for what in ("period", "offset"):
            value = getattr(self, what)
            if not isinstance(value, str):
                object.__setattr__(self, what, number(f"sampled '{self.name}'", what, value))
        if not isinstance(self.period, str) and not self.period > 0.0:
            raise ArgumentError(f"sampled '{self.name}': period {self.period!r} is not positive")


def _check_part(kind: str, name: object, **functions: object) -> None:
    try:
        check_variable_name(name)
    except ArgumentError as error:
        raise ArgumentError(str(error).replace("variable", kind, 1)) from None
    for what, function in functions.items():
        if not callable(function):
            raise ArgumentError(f"{kind} '{name}': {what} is not a function")


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


@dataclass(frozen=True)
class _SomeStates:
    """Outputs that are states, by their positions."""

    where: tuple[int, ...]

    def __call__(self, t: Any, x: Array, *_: Array) -> Array:  # noqa: ARG002
        return x[list(self.where)]


@dataclass(frozen=True, kw_only=True)
class Model:
    """FMI-free physics: a model as flat arrays and functions; `ModelClass` is the layer above, with names.

    All functions take z, the discrete states, between x and u exactly if the model declares some.

    Parameters
    ----------
    name, description : str
        The name is also the FMI model identifier; the description is optional.
    parameters, inputs, outputs : Layout, optional
        The declared variables.
    states : tuple of str, optional
        Names of the outputs and locals that make up the state vector, in its order.
    initial_state : callable
        initial_state(p) -> (n_x,); optional without states, as are the derivatives.
    derivatives : callable
        derivatives(t, x, u, p) -> (n_x,), per second.
    output_values : callable
        outputs(t, x, u, p) -> the outputs, in their order, then the locals that are not states; optional where all of
        these are states.
    requirements : tuple of Requirement
        When the equations may be evaluated.
    default_experiment : DefaultExperiment, optional
        Duration and step proposed to importers; 1 s in steps of 10 ms by default.
    locals : Layout, optional
        Variables that can be seen, but not connected: states that are no outputs, and what is computed beside them.
    discrete : Layout, optional
        The declared discrete states, which change at events and sampling instants only. One with the name of an output
        is that output; the others are local variables of an FMU.
    initial_discrete : callable, optional
        initial_discrete(p) -> (n_z,); by default the start values of `discrete`.
    events : tuple of Event, optional
    sampled : tuple of Sampled, optional
    solver : {"rk4", "rk43", "dopri5", "rodas4"}, optional
        What integrates the states in co-simulation: the classical Runge-Kutta method with fixed steps; the same, or
        that of Dormand and Prince, with steps that a tolerance determines; or RODAS, implicit, with a tolerance too,
        for stiff models.

    Raises
    ------
    ArgumentError
        A name can't be taken or is there twice, a start value is outside its limits, a state is neither output nor
        local, an input or an output is declared as tunable, a period is that of no fixed scalar parameter, nothing
        changes the discrete states, or an argument is of another kind.
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
    locals: Layout = _NONE
    discrete: Layout = _NONE
    initial_discrete: Callable[[Array], Array] | None = None
    events: tuple[Event, ...] = ()
    sampled: tuple[Sampled, ...] = ()
    solver: Solver = "rk4"

    def __post_init__(self) -> None:
        check_identifier("model", self.name)
        check_text(f"{self.name}: the description", self.description)
        for group in ("parameters", "inputs", "outputs", "locals", "discrete"):
            object.__setattr__(self, group, self._layout(group))
        object.__setattr__(self, "states", self._sequence("states", str, "names of outputs or locals"))
        object.__setattr__(self, "requirements", self._sequence("requirements", Requirement, "Requirements"))
        object.__setattr__(self, "events", self._sequence("events", Event, "Events"))
        object.__setattr__(self, "sampled", self._sequence("sampled", Sampled, "Sampled"))
        if not isinstance(self.default_experiment, DefaultExperiment):
            raise ArgumentError(f"{self.name}: default_experiment is {self.default_experiment!r}, no DefaultExperiment")
        for function in ("initial_state", "derivatives", "output_values"):
            if not callable(getattr(self, function)):
                raise ArgumentError(f"{self.name}: {function} is not a function")
        self._check_solver()
        self._check_variables()
        self._check_functions()
        self._check_discrete()
        self._check_sampled()
        self._check_names_of_parts()

    def _check_solver(self) -> None:
        if self.solver not in RESERVED:
            raise ArgumentError(f"{self.name}: solver is {self.solver!r}; known are {', '.join(RESERVED)}")
        if self.solver != "rk4" and not self.states:
            raise ArgumentError(
                f"{self.name}: a model without states has nothing to integrate; leave out solver={self.solver!r}"
            )

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
        groups = {"parameter": self.parameters, "input": self.inputs, "output": self.outputs, "local": self.locals}
        outputs = [v.name for v in self.outputs.variables]
        declared = [v for layout in groups.values() for v in layout.variables]
        declared += [v for v in self.discrete.variables if v.name not in outputs]
        groups["discrete state"] = self.discrete
        check_unique([v.name for v in declared], f"{self.name}: ")
        check_unique([name for v in declared for name in v.names], f"{self.name}: ")
        for what, layout in groups.items():
            for v in layout.variables:
                if what not in ("output", "local"):  # these have no start values
                    v.check_starts(f"{self.name}: {what}")
                if v.tunable and what != "parameter":
                    raise ArgumentError(f"{self.name}: '{v.name}' is not a parameter; only parameters can be tunable")
                if (self.states or self.events) and v.name in RESERVED[self.solver]:
                    raise ArgumentError(
                        f"{self.name}: {what} '{v.name}': every FMU with states has a parameter of this name"
                    )
        known = [v.name for v in self.computed.variables]
        for state in self.states:
            if state not in known:
                raise ArgumentError(
                    f"{self.name}: state '{state}' is neither an output nor a local; declare one of this name, "
                    f"known are {', '.join(known) or 'none'}"
                )
        check_unique(self.states, f"{self.name}: states: ")
        for v in self.state_layout.variables:
            if v.type != "real":
                raise ArgumentError(
                    f"{self.name}: state '{v.name}' is of type {v.type}; continuous states are real, others discrete"
                )

    def _check_functions(self) -> None:
        """Refuse functions that are left out though there is something to compute."""
        for name, left_out in (("initial_state", _no_state), ("derivatives", _the_state)):
            if self.states and getattr(self, name) is left_out:
                raise ArgumentError(f"{self.name}: there are states, but no {name}; give the function")
        if self.output_values is _the_state or isinstance(self.output_values, _SomeStates):
            if computed := [v.name for v in self.returned.variables if v.name not in self.states]:
                raise ArgumentError(f"{self.name}: '{', '.join(computed)}' has no value; give output_values")
            where = tuple(self.state_layout.names.index(name) for name in self.returned.names)
            object.__setattr__(self, "output_values", _SomeStates(where))

    def _check_discrete(self) -> None:
        outputs = {v.name: v for v in self.outputs.variables}
        for v in self.discrete.variables:
            here = f"{self.name}: discrete state '{v.name}'"
            if v.name in self.states:
                raise ArgumentError(f"{here}: a state has this name too; a state is continuous or discrete")
            same = outputs.get(v.name, v)
            if (same.size, same.unit, same.type, same.items) != (v.size, v.unit, v.type, v.items):
                raise ArgumentError(f"{here}: the output of this name has another size, unit or type")
        if self.initial_discrete is not None and not callable(self.initial_discrete):
            raise ArgumentError(f"{self.name}: initial_discrete is not a function")
        if self.initial_discrete is not None and not len(self.discrete):
            raise ArgumentError(f"{self.name}: initial_discrete is given, but there are no discrete states")
        if len(self.discrete) and not self.events and not self.sampled:
            raise ArgumentError(
                f"{self.name}: nothing changes the discrete states {', '.join(self.discrete.names)}; give events or "
                "sampled, or make them parameters"
            )

    def _check_sampled(self) -> None:
        fixed = {v.name: v.starts[0] for v in self.parameters.variables if v.size is None and not v.tunable}
        for part in self.sampled:
            here = f"{self.name}: sampled '{part.name}'"
            if not len(self.discrete):
                raise ArgumentError(f"{here}: there are no discrete states that it could change; declare them")
            for what, value in (("period", part.period), ("offset", part.offset)):
                if isinstance(value, str) and value not in fixed:
                    raise ArgumentError(
                        f"{here}: {what} {value!r} is not a scalar parameter that is fixed during a run; known are "
                        f"{', '.join(fixed) or 'none'}"
                    )
            if isinstance(part.period, str) and not fixed[part.period] > 0.0:
                raise ArgumentError(
                    f"{here}: its period '{part.period}' starts at {fixed[part.period]!r}; it must be positive"
                )

    def _check_names_of_parts(self) -> None:
        names = [*(e.name for e in self.events), *(s.name for s in self.sampled)]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ArgumentError(f"{self.name}: names of events and sampled are not unique: {', '.join(twice)}")
        known = {*self.parameters.names, *self.inputs.names, *self.computed.names}
        for event in self.events:
            if f"{event.name}.indicator" in known:
                raise ArgumentError(
                    f"{self.name}: variable '{event.name}.indicator' has the name of the indicator of that event"
                )

    @property
    def is_continuous(self) -> bool:
        """Whether nothing but time changes the states: there are no discrete states and no events."""
        return not (len(self.discrete) or self.events)

    def initial_discrete_state(self, p: Array) -> Array:
        """The discrete states (n_z,) at the start, for parameters (n_p,)."""
        return self.discrete.starts if self.initial_discrete is None else self.initial_discrete(p)

    @cached_property
    def state_layout(self) -> Layout:
        """The declared variables of the states, in the order of the state vector."""
        declared = {v.name: v for v in self.computed.variables}
        return Layout([declared[name] for name in self.states])

    def arguments(self, t: Any, x: Array, z: Array, u: Array, p: Array) -> tuple[Any, ...]:
        """What the functions of this model take: (t, x, z, u, p), or (t, x, u, p) without discrete states."""
        return (t, x, z, u, p) if len(self.discrete) else (t, x, u, p)

    @cached_property
    def computed(self) -> Layout:
        """The variables of an FMU that are computed: outputs, locals, then discrete states that are no outputs."""
        outputs = [v.name for v in self.outputs.variables]
        others = [v for v in self.discrete.variables if v.name not in outputs]
        return Layout([*self.outputs.variables, *self.locals.variables, *others])

    @cached_property
    def returned(self) -> Layout:
        """What `output_values` returns: outputs, then locals that are not states."""
        return Layout([*self.outputs.variables, *(v for v in self.locals.variables if v.name not in self.states)])
