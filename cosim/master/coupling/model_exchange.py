"""Components in model exchange: their equations are coupled, and one method integrates all their states together.

Inside each stage of the method the outputs of one component reach the inputs of the others, level by level, so that the
coupling is exact: nothing is extrapolated between them. Inputs from outside of the group, from co-simulation, functions
and signals, are extrapolated over the step as those of any other component. The compiled loop does the work, see
cosim/loop/model_exchange.c; here its tables are made.
"""

from __future__ import annotations

import ctypes
import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from cosim.errors import SetupError, nearest
from cosim.fmi.event_mode import MOST_UPDATES
from cosim.fmi.instance import ExperimentSetup, Instance
from cosim.fmi.model_exchange import ModelExchangeInstance
from cosim.fmi.variable_buffer import VariableBuffer
from cosim.loop.arena import Arena
from cosim.loop.binding import NONE, NOT_FINITE, Operation, OperationKind
from cosim.loop.model_exchange import (
    AT_POINT,
    CVODE_FAILED,
    ENDLESS_EVENTS,
    ENDLESS_UPDATES,
    FUNCTIONS,
    IN_EVENT,
    IN_STAGE_AGAIN,
    METHODS,
    STATES_NOT_FINITE,
    STEP_TOO_SHORT,
    ContinuousComponent,
    DiscreteInputs,
    Group,
    GroupExchange,
    OutsideInputs,
    group_library,
)
from cosim.master.coupling.algorithm import AUTO, SOLVERS, algorithm
from cosim.master.coupling.extrapolated_inputs import ExtrapolatedInputs
from cosim.master.failures import Failing, SimulationError
from cosim.master.operations import Exchange, NamedOperation, OperationTable
from cosim.master.unfinished_steps import EndedBy
from cosim.master.value_layout import ValueLayout
from cosim.system.resolution import Drive, Link, ResolvedSystem, levels_of, torn_links

#: By how much a communication step may miss a whole number of steps of a method, in these, for rounding.
_STEP_TOLERANCE = 1e-6

#: Relative tolerance of an adaptive method where neither the run nor an FMU has one.
_TOLERANCE = 1e-6

#: Methods with a fixed step.
_FIXED = ("rk4",)


@dataclasses.dataclass(frozen=True)
class Solver:
    """The method that integrates components in model exchange.

    Attributes
    ----------
    method : str
        "rk4", the classical method of Runge and Kutta with a fixed step; "dopri5", that of Dormand and Prince with
        error control; or "cvode", CVode of SUNDIALS, which is implicit, for stiff equations. "auto" is rk4 where
        somebody has chosen model exchange, and dopri5 where an FMU has nothing else: then nobody has chosen a step for
        it.
    step : float, optional
        Longest step of a fixed method, in s, which divides the communication step; that itself by default.

    Raises
    ------
    SetupError
        There is no such method, or the step makes no sense.
    """

    method: str = AUTO
    step: float | None = None

    def __post_init__(self) -> None:
        if self.method not in SOLVERS:
            raise SetupError(f"solver {self.method!r} is unknown; {nearest(str(self.method), SOLVERS)}")
        if self.step is None:
            return
        if self.method not in (AUTO, *_FIXED):
            raise SetupError(f"solver '{self.method}' chooses its steps itself; leave out the solver step")
        if not (math.isfinite(self.step) and self.step > 0.0):
            raise SetupError(f"solver step {self.step!r} s must be a positive number")

    def chosen(self, *, interface_chosen: bool) -> Solver:
        """The method that "auto" stands for; `interface_chosen` where somebody has chosen model exchange."""
        if self.method != AUTO:
            return self
        return Solver("rk4" if interface_chosen or self.step is not None else "dopri5", self.step)

    def check_states(self) -> None:
        """Whether a run with it can be saved.

        Raises
        ------
        SetupError
            It can't.
        """
        if self.method == "cvode":
            raise SetupError("solver 'cvode' keeps earlier steps, which can't be saved; use solver 'rk4' or 'dopri5'")

    def steps_in(self, step_size: float) -> int:
        """Number of steps in a communication step (s).

        Raises
        ------
        SetupError
            It is not a whole number.
        """
        if self.step is None:
            return 1
        exact = step_size / self.step
        steps = round(exact)
        if steps < 1 or abs(exact - steps) > _STEP_TOLERANCE:
            raise SetupError(
                f"solver step {self.step!r} s does not divide the communication step {step_size!r} s; "
                f"take {step_size / max(1, math.ceil(exact)):.9g} s"
            )
        return steps


@dataclasses.dataclass(frozen=True)
class _Inner:
    """An exchange among the components of a group, over some links."""

    exchange: Exchange
    layout: ValueLayout
    links: tuple[Link, ...]


class ModelExchangeGroup:
    """The components of a system that are in model exchange.

    Parameters
    ----------
    system : ResolvedSystem
    instances : mapping
        Component -> instance, of the whole system.
    extrapolated : ExtrapolatedInputs
        What inputs from outside of the group do over a step.
    solver : Solver
    most_iterations : int
        In a stage, to solve algebraic loops.

    Raises
    ------
    SetupError
        The components can't be integrated together.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        instances: Mapping[str, Instance],
        extrapolated: ExtrapolatedInputs,
        solver: Solver,
        most_iterations: int = 0,
    ) -> None:
        self._most_iterations = most_iterations
        self._instances = {
            name: instance for name, instance in instances.items() if isinstance(instance, ModelExchangeInstance)
        }
        self._names = list(self._instances)
        self._solver = solver
        self._library = group_library()
        self._arena = Arena()
        self._discrete: list[tuple[DiscreteInputs, Any]] = []
        self._sizes: list[tuple[int, int]] = []
        self._arrays: list[np.ndarray] = []
        outside = [Drive(d.component, d.targets, d.function, added=d.added) for d in system.drives if d.added]
        outside += [
            Drive(component, (element,), _no_signal)
            for component, elements in extrapolated.elements.items()
            for element in elements
            if component in self._instances and (component, element.name) in extrapolated.moving
        ]
        inside = [link for link in system.links if system.couples_equations(link)]
        self._stage = self._exchange_of(system, outside, [link for link in inside if _is_continuous(link)])
        self._event = self._exchange_of(system, outside, inside)
        self._rows_again = self._that_move(self._stage.exchange.at_point, inside)
        self._parallel = not extrapolated.algorithm.order.needs_levels
        fed = {k.target_component for k in system.links if k not in inside} | {d.component for d in system.drives}
        for name, instance in self._instances.items():
            instance.continuous.is_fed = name in fed
        self._group = Group(
            components=(ctypes.POINTER(ContinuousComponent) * len(self._names))(
                *(ctypes.pointer(instance.continuous) for instance in self._instances.values())
            ),
            n_components=len(self._names),
            method=METHODS[solver.method],
        )

    def _exchange_of(self, system: ResolvedSystem, outside: Iterable[Drive], links: Iterable[Link]) -> _Inner:
        """The exchange over some links between the components."""
        links = tuple(links)
        fed = {(k.target_component, k.target.name) for k in links}
        drives = tuple(
            d
            for d in outside
            if d.component in self._instances and (not d.added or (d.component, d.targets[0].name) in fed)
        )
        ports = {name: system.ports[name] for name in self._names}
        feedthrough = {name: system.feedthrough[name] for name in self._names}
        torn = torn_links(ports, feedthrough, links) if self._most_iterations else ()
        rest = [link for link in links if link not in torn]
        try:
            levels = levels_of(ports, feedthrough, rest, needs_levels=True)
        except SetupError as error:
            what = str(error).partition(";")[0]
            raise SetupError(
                f"model exchange: {what}; use iterations='auto' (as an option: --iterations auto), which solves it, in "
                "sequential order, or co-simulation for a component in it (interface='co-simulation')"
            ) from None
        components = {name: system.components[name] for name in self._names}
        own = ResolvedSystem(components, ports, links, drives, (), levels, feedthrough, (), (), torn)
        nothing = ExtrapolatedInputs(algorithm("sequential", "hold"), {}, {}, {}, ())
        layout = ValueLayout(own, [], nothing)
        own = dataclasses.replace(own, drives=())
        exchange = Exchange(own, self._instances, nothing, layout, most_iterations=self._most_iterations)
        return _Inner(exchange, layout, links)

    def _that_move(self, table: OperationTable, links: Iterable[Link]) -> OperationTable:
        """What is to be exchanged once more at the same time: not what depends on nothing else."""
        sources: dict[str, set[str]] = {name: set() for name in self._names}
        for link in links:
            sources[link.target_component].add(link.source_component)
        still: set[str] = set()
        has_states = {name for name, instance in self._instances.items() if instance.has_states}
        while True:
            more = {n for n in self._names if n not in still and n not in has_states and sources[n] <= still}
            if not more:
                break
            still |= more

        def moves(row: NamedOperation) -> bool:
            if row.torn is not None:
                return True
            if row.operation.kind == OperationKind.GET:
                return row.component not in still
            return not sources[row.component] <= still

        rows = [row for row in table.rows if moves(row)]
        return OperationTable(rows, self._instances)

    # As operations of the loop

    def _operation(self, function: str, n_values: int = 0) -> NamedOperation:
        operation = Operation(
            kind=OperationKind.GROUP,
            every=1,
            version=3,
            function=ctypes.cast(getattr(self._library, function), ctypes.c_void_p).value,
            data=ctypes.addressof(self._group),
            n=n_values,
        )
        return NamedOperation(operation, "", raised=self._raised)

    def around_exchange(self) -> tuple[NamedOperation, NamedOperation]:
        """What is to be done before and after an exchange at a communication point."""
        return self._operation("group_begin"), self._operation("group_finish")

    def advance(self) -> NamedOperation:
        """Goes on to the next communication point."""
        return dataclasses.replace(self._operation("group_advance"), integrates=True)

    def set_in_event_mode(self, component: str, buffer: VariableBuffer, operation: Operation) -> None:
        """Let an operation set inputs in event mode, which their component enters if they change."""
        size = buffer.size
        last = (ctypes.c_char * max(1, size))()
        inputs = self._arena.structure(DiscreteInputs)
        inputs.component = ctypes.pointer(self._instances[component].continuous)
        inputs.function, inputs.last, inputs.size = operation.function, ctypes.addressof(last), size
        self._discrete.append((inputs, last))
        function = getattr(self._library, f"set_discrete_fmi{operation.version}")
        operation.function = ctypes.cast(function, ctypes.c_void_p).value
        operation.instance = ctypes.addressof(inputs)

    @property
    def addresses(self) -> dict[int, str]:
        """What operations have in place of an instance -> its component."""
        of = {ctypes.addressof(i.continuous): name for name, i in self._instances.items()}
        return {ctypes.addressof(d): of[ctypes.addressof(d.component.contents)] for d, _ in self._discrete}

    # Runs

    def attach(self, exchange: Exchange, layout: ValueLayout) -> None:
        """Have the exchange of the whole system that the group is in."""
        self._exchange = exchange
        first, end = exchange.exchanged_again
        group = self._group
        group.first_again, group.n_again = first, end - first
        for row, operation in zip(exchange.at_point.rows, exchange.at_point.operations, strict=True):
            if row.operation.kind == OperationKind.GROUP:
                operation.n = len(exchange.values)
        self._before = np.zeros(max(len(exchange.values), len(self._event.exchange.values), 1))
        group.values_before = _doubles(self._before)
        self._connect(group.stage, self._stage, self._rows_again, layout)
        self._connect(group.event, self._event, self._event.exchange.at_point, layout)

    def _connect(self, own: GroupExchange, inner: _Inner, again: OperationTable, layout: ValueLayout) -> None:
        """What an exchange of the group takes from outside."""
        linked = {(k.target_component, k.target.name) for k in inner.links}
        keys = [(t.component, e.name) for t in inner.layout.sets for e in t.elements]
        here = [inner.layout.positions[key] for key in keys if key not in linked]
        there = [layout.positions[key] for key in keys if key not in linked]
        here += inner.layout.added.values()
        there += [layout.added[key] for key in inner.layout.added]
        own.copied, own.n_copied = self._arena.integers([*here, *there]), len(here)
        inputs = []
        at_step = self._exchange.at_step
        for row, operation in zip(at_step.rows, at_step.operations, strict=True):
            if operation.kind != OperationKind.EXTRAPOLATE or row.component not in self._instances:
                continue
            assert row.transfer is not None
            elements = row.transfer.elements[-operation.n :]
            taken = [(row.component, e.name) for e in elements]
            targets = [NONE if key in linked else inner.layout.positions.get(key, NONE) for key in taken]
            inputs.append(OutsideInputs(ctypes.pointer(operation), self._arena.integers(targets)))
        own.n_inputs = len(inputs)
        own.inputs = (OutsideInputs * max(1, len(inputs)))(*inputs)
        values, table = inner.exchange.values, inner.exchange.at_point
        own.n_values, own.loop.values = len(values), _doubles(values)
        own.loop.at_point, own.loop.codes_at_point, own.loop.n_at_point = table.operations, table.codes, len(table)
        own.again, own.codes_again, own.n_again = again.operations, again.codes, len(again)

    def begin(self, experiments: Mapping[str, ExperimentSetup], step_size: float) -> None:
        """Begin a run, after the initialisation mode.

        Raises
        ------
        SetupError
            The step of the method does not divide the communication step (s).
        SimulationError
            A component does not say how many states it has.
        """
        group = self._group
        sizes = []
        for name, instance in self._instances.items():
            with Failing(name, experiments[name].start_time, instance):
                sizes.append(instance.sizes())
        if sizes != self._sizes:
            self._allocate(sizes)
        group.steps = self._solver.steps_in(step_size)
        told = [t for name in self._names if (t := experiments[name].tolerance) is not None]
        group.tolerance = min(told, default=_TOLERANCE)
        group.time = group.exchanged_at = math.nan
        group.last_event, group.last_error, group.proposed = -math.inf, 1.0, 0.0
        group.n_steps = group.n_rejected = group.n_events = group.at_once = 0
        group.ended_by = NONE
        group.begins = 1
        group.is_exchanged = group.rates_known = group.indicators_known = group.states_known = 0
        for inputs, _ in self._discrete:
            inputs.known = 0
        for inner in (self._stage, self._event):
            inner.exchange.begin()
        needs = any(instance.continuous.needs_completed_step for instance in self._instances.values())
        group.exchanges_at_end = needs or group.n_indicators > 0 or self._parallel
        group.exchanges_at_start = self._parallel

    def _allocate(self, sizes: list[tuple[int, int]]) -> None:
        group = self._group
        self._sizes = sizes
        group.n_states = group.n_indicators = 0
        for instance, (n_states, n_indicators) in zip(self._instances.values(), sizes, strict=True):
            known = instance.continuous
            known.n_states, known.first_state = n_states, group.n_states
            known.n_indicators, known.first_indicator = n_indicators, group.n_indicators
            group.n_states += n_states
            group.n_indicators += n_indicators
        self._arrays = []
        for name, rows in (("states", 1), ("next", 1), ("trial", 1), ("rates", 7), ("nominals", 1), ("allowed", 1)):
            self._arrays.append(np.zeros(max(1, rows * group.n_states)))
            setattr(group, name, _doubles(self._arrays[-1]))
        if self._solver.method == "cvode" and group.n_states:
            from cosim.master.coupling.cvode import CVode  # loads SUNDIALS

            _, next_states, trial, *_, allowed = self._arrays
            self._cvode = CVode(group, next_states, trial, allowed)
        for name, rows in (("indicators", 1), ("later", 1), ("tried", 2)):
            self._arrays.append(np.zeros(max(1, rows * group.n_indicators)))
            setattr(group, name, _doubles(self._arrays[-1]))

    def numbers(self) -> list[float]:
        """What of it belongs to the state of a run.

        Raises
        ------
        SetupError
            Its method keeps something that can't be saved.
        """
        self._solver.check_states()
        group = self._group
        last = [float(byte) for inputs, last in self._discrete for byte in (inputs.known, *last.raw)]
        indicators = [group.indicators[i] for i in range(group.n_indicators)]
        names = self._kept
        loops = [*self._stage.exchange.numbers_of_loops(), *self._event.exchange.numbers_of_loops()]
        return [*(float(getattr(group, name)) for name in names), *indicators, *last, *loops]

    def restore(self, numbers: list[float]) -> None:
        """Take what `numbers` gave, and more, from the front of a list."""
        group = self._group
        for name in self._kept:
            value = numbers.pop(0)
            setattr(group, name, int(value) if name in _WHOLE else value)
        for i in range(group.n_indicators):
            group.indicators[i] = numbers.pop(0)
        for inputs, last in self._discrete:
            inputs.known = int(numbers.pop(0))
            last.raw = bytes(int(numbers.pop(0)) for _ in range(len(last)))
        for inner in (self._stage, self._event):
            inner.exchange.restore_loops(numbers)
        group.time = group.exchanged_at = math.nan
        group.states_known, group.ended_by = 0, NONE

    _kept = ("proposed", "last_error", "last_event", "at_once", "indicators_known", "n_steps", "n_rejected", "n_events")

    # Ends

    def ended(self) -> EndedBy:
        """The component that ended the simulation."""
        return EndedBy(self._names[self._group.ended_by], self._group.ended_at)

    def summary(self) -> dict[str, Any]:
        """For people: components, method, and what it took."""
        group = self._group
        return {
            "components": list(self._names),
            "solver": self._solver.method,
            **({"tolerance": group.tolerance} if self._solver.method not in _FIXED else {}),
            "steps": group.n_steps,
            **({"rejected_steps": group.n_rejected} if self._solver.method not in _FIXED else {}),
            "events": group.n_events,
        }

    def _raised(self) -> BaseException | NamedOperation:
        """The error that the group has ended with, or the row at a communication point that failed."""
        group = self._group
        if group.failed_exchange == AT_POINT:
            row: NamedOperation = self._exchange.at_point.rows[group.failed_operation]
            return row
        if group.failed_exchange:
            return self._of_exchange()
        if group.failed_component == NONE:
            return SimulationError(", ".join(self._names), group.failed_at, _REASONS[group.status], "")
        component = self._names[group.failed_component]
        instance = self._instances[component]
        function = FUNCTIONS[instance.version][group.failed_function]
        error = instance.failure(function, group.status)
        found = SimulationError(component, group.failed_at, str(error), instance.log())
        found.__cause__ = error
        return found

    def _of_exchange(self) -> SimulationError:
        group = self._group
        inner = (self._event if group.failed_exchange == IN_EVENT else self._stage).exchange
        table = self._rows_again if group.failed_exchange == IN_STAGE_AGAIN else inner.at_point
        row = table.rows[group.failed_operation]
        if row.torn is not None:
            if what := row.torn.failure(group.status):
                return SimulationError(", ".join(row.torn.components), group.failed_at, f"{what}, within a step", "")
            row = inner.at_point.rows[row.torn.failed_row]
        instance = self._instances[row.component]
        if group.status == NOT_FINITE:
            wrong = [f"'{name}'" for name, position in row.finite if not math.isfinite(inner.values[position])]
            hint = f"; {_SHORTER}" if self._solver.method in _FIXED else ""
            what = f"{len(wrong)} outputs are not finite within a step, the first is {wrong[0]}{hint}"
            return SimulationError(row.component, group.failed_at, what, instance.log())
        error = instance.failure(row.function, group.status)
        hint = f"; where states grow without bound, {_SHORTER}" if self._solver.method in _FIXED else ""
        found = SimulationError(row.component, group.failed_at, f"{error} within a step{hint}", instance.log())
        found.__cause__ = error
        return found


#: Numbers of a group that are whole.
_WHOLE = ("at_once", "indicators_known", "n_steps", "n_rejected", "n_events")

#: What to do about states that grow by a step that is too long.
_SHORTER = "take a shorter step (solver_step, as an option --solver-step), or solver 'dopri5'"

#: Why a group has failed.
_REASONS = {
    ENDLESS_UPDATES: f"an event asks for more than {MOST_UPDATES} updates of the discrete states of the components in "
    "model exchange; one of them never comes to rest",
    ENDLESS_EVENTS: "events of the components in model exchange follow each other without time passing; one of them "
    "chatters",
    CVODE_FAILED: "CVode can't integrate the components in model exchange from there on: their states change too fast, "
    "or jump without an event",
    STEP_TOO_SHORT: "the components in model exchange need a step that is too short to be taken; their states change "
    "too fast, or jump without an event",
    STATES_NOT_FINITE: f"states of the components in model exchange are not finite; {_SHORTER}",
}


def group_of(
    system: ResolvedSystem,
    instances: Mapping[str, Instance],
    extrapolated: ExtrapolatedInputs,
    solver: Solver,
    most_iterations: int,
) -> ModelExchangeGroup | None:
    """The components of a system in model exchange; None where there are none."""
    if not any(isinstance(instance, ModelExchangeInstance) for instance in instances.values()):
        return None
    return ModelExchangeGroup(system, instances, extrapolated, solver, most_iterations)


def _no_signal(time: float) -> float:
    """In place of a signal, where only its target counts."""
    return 0.0 * time


def _is_continuous(link: Link) -> bool:
    """Whether a value may change between events at both ends."""
    return all(
        end.kind == "real" and not end.timing and end.variable.variability in (None, "continuous")
        for end in (link.source, link.target)
    )


def _doubles(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def check_components(system: ResolvedSystem, asked: Solver) -> None:
    """Whether components in model exchange communicate at each communication point, and are there if a solver is.

    Raises
    ------
    SetupError
        One does not, or there are none for the solver that was asked for.
    """
    if asked != Solver() and not any(port.is_model_exchange for port in system.ports.values()):
        raise SetupError(
            f"no component is in model exchange, so the solver '{asked.method}' has nothing to integrate; choose it "
            "(interface='model-exchange', as an option --interface model-exchange), or leave the solver out"
        )
    for name, component in system.components.items():
        if component.every != 1 and system.ports[name].is_model_exchange:
            raise SetupError(
                f"component '{name}': in model exchange it is integrated together with the others, and every = "
                f"{component.every} makes no sense; leave it out, or use co-simulation"
            )
