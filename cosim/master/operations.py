"""The table of operations that moves values between FMUs and steps them; the compiled loop walks it (cosim/loop).

All exchanged and recorded values stand in one array, each transfer in a contiguous part of it, so that an operation is
a copy inside this array or one call of an FMU. In which order the operations of a communication point come is the
algorithm's: see `cosim.master.coupling.algorithm`. At the start values are exchanged level by level in any order, so
that the first point has no delay.
"""

from __future__ import annotations

import ctypes
import dataclasses
import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Protocol, TypeVar

import numpy as np

from cosim.fmi.event_mode import CLOCK, EventBuffer, EventInstance
from cosim.fmi.instance import Instance
from cosim.fmi.model_exchange import ModelExchangeInstance
from cosim.fmi.types import FmiType, type_code
from cosim.fmi.variable_buffer import VariableBuffer
from cosim.loop.algebraic_loop import Direction
from cosim.loop.arena import Arena
from cosim.loop.binding import EXTRAPOLATED, NONE, Conversion, Extrapolated, Operation, OperationKind, Rates
from cosim.loop.current_calls import codes
from cosim.loop.iterated_step import Doing
from cosim.master.coupling.algebraic_loops import TornExchange, first_guesses
from cosim.master.coupling.algorithm import ORDERS, Extrapolation, spacing
from cosim.master.coupling.extrapolated_inputs import ExtrapolatedInputs
from cosim.master.coupling.iterated_steps import Iterated, IteratedSteps, Iteration
from cosim.master.coupling.starting_blocks import StartingBlocks
from cosim.master.events import Events, events_of
from cosim.master.function_instance import FunctionInstance
from cosim.master.value_layout import ExtrapolatedGroup, Transfer, ValueLayout
from cosim.system.resolution import Drive, Link, ResolvedSystem
from cosim.system.system import Component
from cosim.system.variables import Element, variables_of

_K = TypeVar("_K")

#: Level before those of all inputs.
_BEFORE_ALL = -1


@dataclass(frozen=True)
class NamedOperation:
    """An operation, and what messages about its failure need to know."""

    operation: Operation
    component: str
    function: str = ""
    finite: tuple[tuple[str, int], ...] = ()  # names and positions of values that must be finite
    converted: tuple[Link, ...] = ()  # whose values must fit their targets
    raised: Callable[[], BaseException | NamedOperation] | None = (
        None  # gives the error, or the row, that it failed with
    )
    torn: TornExchange | None = None  # what solves algebraic loops
    iterated: IteratedSteps | None = None  # what performs the steps of all components, again and again
    integrates: bool = False  # all components in model exchange
    transfer: Transfer | None = None  # GET: what is read; EXTRAPOLATE: what is set


class Group(Protocol):
    """Components in model exchange, see `cosim.master.coupling.model_exchange`, as an exchange needs to know them."""

    def around_exchange(self) -> tuple[NamedOperation, NamedOperation]:
        """What is to be done before and after an exchange at a communication point."""
        ...

    def advance(self) -> NamedOperation:
        """Goes on to the next communication point."""
        ...

    def set_in_event_mode(self, component: str, buffer: VariableBuffer, operation: Operation) -> None:
        """Let an operation set inputs in event mode, which their component enters if they change."""
        ...

    def numbers(self) -> list[float]:
        """What of it belongs to the state of a run."""
        ...

    def restore(self, numbers: list[float]) -> None:
        """Take what `numbers` gave, and more, from the front of a list."""
        ...


class OperationTable:
    """Operations in the order in which the loop performs them, and the codes of the calls that they make."""

    def __init__(self, rows: Sequence[NamedOperation], instances: Mapping[str, Instance]) -> None:
        self.rows = tuple(rows)
        calling = {
            OperationKind.SET,
            OperationKind.GET,
            OperationKind.EXTRAPOLATE,
            OperationKind.STEP,
            OperationKind.CALL,
            OperationKind.DIFFERENTIATE,
        }
        self.codes = codes(
            [
                instances[row.component].code_of_call(row.function)
                if row.component and row.operation.kind in calling
                else 0
                for row in self.rows
            ]
        )
        self.operations = (Operation * len(self.rows))(*(row.operation for row in self.rows))

    def __len__(self) -> int:
        return len(self.rows)

    def from_row(self, first: int) -> tuple[Any, Any]:
        """The operations and codes from a row on, as the loop takes them."""
        if first == 0:
            return self.operations, self.codes
        operations = ctypes.addressof(self.operations) + first * ctypes.sizeof(Operation)
        codes = ctypes.addressof(self.codes) + first * ctypes.sizeof(ctypes.c_uint32)
        return ctypes.cast(operations, ctypes.POINTER(Operation)), ctypes.cast(codes, ctypes.POINTER(ctypes.c_uint32))


class Exchange:
    """Values of a system and the operations that exchange them.

    Parameters
    ----------
    system : ResolvedSystem
    instances : mapping
        Component name -> instance.
    extrapolated : ExtrapolatedInputs
        Which inputs are extrapolated, and the algorithm.
    layout : ValueLayout
        Where the values of the system stand.
    group : Group, optional
        The components in model exchange.
    most_iterations : int
        At a communication point, to solve algebraic loops.
    iterated : Iteration
        Whether steps are repeated until inputs go to what comes out.
    steps_of_block : int
        Steps of a starting block; 0 without.

    Attributes
    ----------
    values : array (n,)
        Current values.
    recorded_runs : array (runs, 2) of int32
        What is recorded: position of the first value and number of each contiguous run.
    at_start, at_point, at_step : OperationTable
        What to do once in the initialisation mode, at every communication point, and to go on to the next one.
    steps : OperationTable
        The steps of components that `at_step` performs, itself or by iteration.
    events : Events or None
        Events of components that have some.
    demanded : bool
        An FMU that refuses what its inputs do during a step is an error; else they are held.
    exchanged_again : (int, int)
        Which operations at a communication point are performed again after an event: first, end.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        instances: Mapping[str, Instance],
        extrapolated: ExtrapolatedInputs,
        layout: ValueLayout,
        group: Group | None = None,
        most_iterations: int = 0,
        iterated: Iteration = Iteration(),  # noqa: B008 (frozen)
        steps_of_block: int = 0,
    ) -> None:
        self._steps_of_block = steps_of_block
        self._starting: StartingBlocks | None = None
        self._system = system
        self._group = group
        self._instances = instances
        self._layout = layout
        self.demanded = extrapolated.algorithm.demanded
        self._extrapolated_inputs = extrapolated
        self._arena = Arena()
        self._buffers: list[VariableBuffer] = []  # that operations point into
        self._extrapolated: list[tuple[Extrapolated, int]] = []  # with the number of inputs
        self._torn_links = set(system.torn)
        self._links_from: dict[str, list[Link]] = {}
        self._links_to: dict[str, list[Link]] = {}
        for link in system.links:
            self._links_from.setdefault(link.source_component, []).append(link)
            self._links_to.setdefault(link.target_component, []).append(link)
        self.values = np.zeros(layout.size)
        self.recorded_runs = layout.recorded_runs
        self.events = self._events(layout, reads_again=not extrapolated.algorithm.order.needs_levels)

        samples = self._samples(system.drives)
        sets = {
            level: [row for transfer in transfers for row in self._set(transfer)]
            for level, transfers in _grouped(layout.sets, attrgetter("level")).items()
        }
        gets = self._calls(layout)
        for level, transfers in _grouped(layout.gets, attrgetter("level")).items():
            gets.setdefault(level, []).extend(self._get(transfer) for transfer in transfers)
        # arrays of which only some elements are fed keep the start values of the others
        start_values = [self._get(transfer) for transfer in (*layout.sets, *layout.constants)]
        # around an algebraic loop the start values of the inputs are the first ones
        first = ORDERS["parallel" if system.levels is None else "sequential"]
        # FMI 1.0 lets nothing be read before an instance is initialised, and inputs should be set before that
        self._torn = self._torn_exchanges(most_iterations)
        exchange_at_start = first.arrange(sets, gets)
        at_start = [*start_values, *samples, *exchange_at_start, *self._solving(self._torn[:1])]
        self.at_start = OperationTable(sorted(at_start, key=self._can_be_read_last), instances)
        if self.events is not None:  # a clock is set before what it lets through, whatever the order
            sets = dict(sorted(sets.items()))
        exchange = extrapolated.algorithm.order.arrange(sets, gets)
        n_exchange = len(exchange)
        exchange += self._solving(self._torn[1:])
        begin, finish = self._around_exchange()
        rates = self._exchange_rates()
        self.at_point = OperationTable([*samples, *begin, *exchange, *finish, *rates], instances)
        self.exchanged_again = (len(samples) + len(begin), len(samples) + len(begin) + len(exchange))
        for torn, table, first_row, n in zip(
            self._torn,
            (self.at_start, self.at_point),
            (len(start_values) + len(samples), self.exchanged_again[0]),
            (len(exchange_at_start), n_exchange),
            strict=False,
        ):
            torn.attach(table.operations, table.codes, first_row, n)
            if directions := self._directions(table.rows[first_row : first_row + n]):
                torn.direct(directions, self._arena)
        sets_of = _grouped(layout.sets, attrgetter("component"))
        steps = {c: self._extrapolate_and_step(c, sets_of.get(c, ())) for c in system.components}
        alone = [row for c, rows in steps.items() if not self._is_in_group(c) for row in rows]
        together = [row for c, rows in steps.items() if self._is_in_group(c) for row in rows]
        together += [] if group is None else [group.advance()]
        self.steps = self.at_step = OperationTable([*alone, *together], instances)
        self._let_fmus_ask_for_inputs()
        self._iterated = self._iterated_steps(iterated, [row for rows in sets.values() for row in rows])
        if self._iterated is not None:
            repeated = NamedOperation(self._iterated.operation(), "", iterated=self._iterated)
            self.at_step = OperationTable([repeated], instances)

    @property
    def components(self) -> Mapping[str, Component]:
        """The components of the system by name."""
        return self._system.components

    def units_at_step(self) -> tuple[list[int], list[bool]]:
        """For what is stepped by itself: where its operations end, and whether they stay in the thread of Python.

        That is a component, or all those in model exchange together.
        """
        ends: dict[str, int] = {}
        for i, row in enumerate(self.at_step.rows):
            ends["" if self._is_in_group(row.component) else row.component] = i + 1
        return list(ends.values()), [not unit or self._instances[unit].runs_python for unit in ends]

    def _is_in_group(self, component: str) -> bool:
        return not component or isinstance(self._instances[component], ModelExchangeInstance)

    def value(self, component: str, element: Element) -> Any:
        """Current value of an element."""
        position = self._layout.positions[component, element.name]
        slots = self.values[position : position + 1]
        return element.type.from_slots(slots, self._instances[component].texts).tolist()[0]

    def _can_be_read_last(self, row: NamedOperation) -> bool:
        """Whether an operation reads outputs that feed nothing, from an FMU of FMI 1.0."""
        if row.operation.kind != OperationKind.GET or self._instances[row.component].version != 1:
            return False
        feeding = self._sources(self._links_from.get(row.component, ()))
        return not any(0 <= position - row.operation.first < row.operation.n for position in feeding)

    def history(self) -> np.ndarray:
        """Values of extrapolated inputs at earlier communication points, as numbers (n,)."""
        numbers = [number for inputs, n in self._extrapolated for number in self._history_of(inputs, n)]
        numbers += self.numbers_of_loops()
        numbers += [] if self._iterated is None else self._iterated.numbers()
        numbers += [] if self._starting is None else self._starting.numbers()
        return np.array(numbers if self._group is None else [*numbers, *self._group.numbers()])

    def _history_of(self, inputs: Extrapolated, n: int) -> list[float]:
        arrays = _arrays_of(inputs, n, self._steps_of_block)
        return [inputs.known, inputs.left, inputs.time, *(p[i] for p, count in arrays for i in range(count))]

    def forget_history(self) -> None:
        """Hold extrapolated inputs over their next step, as after a jump; the values after it count again."""
        for inputs, _ in self._extrapolated:
            inputs.known = inputs.left = 0

    def space_history(self, ratio: float, last_step: float) -> None:
        """Have extrapolated inputs know values at another distance, so many times that of the last step (s).

        They are those of the polynomial that an extrapolation of this degree goes on with.
        """
        for (inputs, n), row in zip(self._extrapolated, self._rows_of_extrapolated(), strict=True):
            known = min(inputs.known, inputs.points - 1, inputs.degree, 1 if inputs.rates else inputs.degree)
            if known < 1:
                continue
            inputs.known = known
            history = np.ctypeslib.as_array(inputs.history, (known, n))
            now = self.values[row.operation.first : row.operation.first + n]
            if not inputs.rates:
                history[:] = spacing(ratio, known) @ np.vstack([now, history])
                continue
            rates = np.ctypeslib.as_array(inputs.rates, (2, n))
            rate = last_step * self.values[inputs.first_rate : inputs.first_rate + n]
            change = history[0] - now  # the cubic through both values and rates, one step ago and now
            cubic = rates[1] + rate + 2.0 * change
            square = change + rate + cubic
            history[0] = now - ratio * (rate - ratio * (square - ratio * cubic))
            rates[1] = ratio * (rate - ratio * (2.0 * square - 3.0 * ratio * cubic))

    def _rows_of_extrapolated(self) -> list[NamedOperation]:
        return [row for row in self.steps.rows if row.operation.kind == OperationKind.EXTRAPOLATE]

    def restore_history(self, numbers: np.ndarray) -> None:
        """Give extrapolated inputs what `history` gave."""
        rest = numbers.tolist()
        for inputs, n in self._extrapolated:
            inputs.known, inputs.left, inputs.time = int(rest.pop(0)), int(rest.pop(0)), rest.pop(0)
            for pointer, count in _arrays_of(inputs, n, self._steps_of_block):
                for i in range(count):
                    pointer[i] = rest.pop(0)
        self.restore_loops(rest)
        if self._iterated is not None:
            self._iterated.restore(rest)
        if self._starting is not None:
            self._starting.restore(rest)
        if self._group is not None:
            self._group.restore(rest)

    def refusing(self) -> set[str]:
        """Components whose FMUs have refused inputs during a step, which were held then (FMI 3.0)."""
        return {
            row.component
            for row in self._rows_of_extrapolated()
            if Extrapolated.from_address(row.operation.data).refused
        }

    def _events(self, layout: ValueLayout, *, reads_again: bool) -> Events | None:
        clocks: dict[tuple[str, int], list[int]] = {}
        for transfer in (*layout.sets, *layout.gets):
            for i, element in enumerate(transfer.elements if transfer.elements[0].timing == CLOCK else ()):
                reference = int(element.variable.valueReference)
                clocks.setdefault((transfer.component, reference), []).append(transfer.first + i)
        for instance in self._instances.values():
            if isinstance(instance, EventInstance):
                instance.forget_buffers()
        every = {name: component.every for name, component in self._system.components.items()}
        return events_of(self._instances, every, self.values, clocks, reads_again=reads_again)

    def _torn_exchanges(self, most: int) -> list[TornExchange]:
        """What solves the algebraic loops of the system, at the start and at communication points."""
        keys = list(self._layout.torn)
        if not keys:
            return []
        links = {(k.source_component, k.source.name): k for k in self._system.torn}
        torn, assumed = [links[key] for key in keys], [self._layout.torn[key] for key in keys]
        sources = [self._layout.positions[key] for key in keys]
        return [TornExchange(torn, assumed, sources, self.values, most, self._arena) for _ in range(2)]

    def _directions(self, rows: Sequence[NamedOperation]) -> list[Direction]:
        """How changes of what is assumed go through an exchange; nothing where a component does not say."""
        moved = set(self._layout.torn.values())
        found: list[Direction] = []
        for row in rows:
            operation, component = row.operation, row.component
            if operation.kind == OperationKind.SET:
                links = self._links_to.get(component, ())
                ends = zip(links, self._targets(links), self._origins(links), strict=True)
                for link, to, origin in ends:
                    if origin in moved and operation.first <= to < operation.first + operation.n:
                        found.append(self._through_link(link.factor, to, origin))
                        moved.add(to)
            elif operation.kind == OperationKind.GET and row.transfer is not None:
                inputs = self._moved_inputs(component, moved)
                outputs = self._moved_outputs(row.transfer, inputs)
                if outputs and not self._gives_directions(component, [e for e, _ in (*inputs, *outputs)]):
                    return []
                found += [self._through_fmu(component, inputs, outputs)] if outputs else []
                moved.update(position for _, position in outputs)
        return found

    def _moved_inputs(self, component: str, moved: Container[int]) -> list[tuple[Element, int]]:
        positions = self._layout.positions
        own = [(k.target, positions[component, k.target.name]) for k in self._links_to.get(component, ())]
        return [(element, position) for element, position in own if position in moved]

    def _moved_outputs(self, transfer: Transfer, inputs: Sequence[tuple[Element, int]]) -> list[tuple[Element, int]]:
        """Outputs that feed others and depend directly on inputs, with their positions."""
        through = self._system.feedthrough[transfer.component]
        names = {element.variable.name for element, _ in inputs}
        feeding = {k.source.name for k in self._links_from.get(transfer.component, ())}
        return [
            (element, transfer.first + i)
            for i, element in enumerate(transfer.elements)
            if element.name in feeding and names & set(through.get(element.variable.name, ()))
        ]

    def _gives_directions(self, component: str, elements: Iterable[Element]) -> bool:
        instance = self._instances[component]
        if isinstance(instance, FunctionInstance | ModelExchangeInstance) or instance.version < 2:
            return False
        kind = self._system.ports[component].description.coSimulation
        says = getattr(kind, "providesDirectionalDerivative", False)
        scalars = all(not e.variable.shape and e.variable.type in ("Real", "Float64") for e in elements)
        return bool(says) and scalars and not instance.lacks(f"fmi{instance.version}GetDirectionalDerivative")

    def _through_link(self, factor: float, to: int, origin: int) -> Direction:
        ends = {"to": self._arena.integers([to]), "from": self._arena.integers([origin])}
        return Direction(factor=factor, n_to=1, n_from=1, **ends)

    def _through_fmu(
        self, component: str, inputs: Sequence[tuple[Element, int]], outputs: Sequence[tuple[Element, int]]
    ) -> Direction:
        instance = self._instances[component]
        function = f"fmi{instance.version}GetDirectionalDerivative"
        ends = {
            "to": self._arena.integers([position for _, position in outputs]),
            "from": self._arena.integers([position for _, position in inputs]),
        }
        return Direction(
            function=instance.function_address(function),
            instance=instance.address,
            unknowns=self._arena.references([e.variable.valueReference for e, _ in outputs]),
            knowns=self._arena.references([e.variable.valueReference for e, _ in inputs]),
            seed=self._arena.zeros(len(inputs)),
            change=self._arena.zeros(len(outputs)),
            n_to=len(outputs),
            n_from=len(inputs),
            version=instance.version,
            code=instance.code_of_call(function),
            **ends,
        )

    def _solving(self, torn: Iterable[TornExchange]) -> list[NamedOperation]:
        return [NamedOperation(t.operation(), "", torn=t) for t in torn]

    def begin(self) -> None:
        """Begin a run: all values are zero (the first text is the empty one), but for what is assumed in loops."""
        self.values[:] = 0.0
        for position, value in first_guesses(self._system.torn, self._layout.torn).items():
            self.values[position] = value
        for torn in self._torn:
            torn.begin()
        if self._iterated is not None:
            self._iterated.begin()
        if self._starting is not None:
            self._starting.begin()
        for inputs, _ in self._extrapolated:
            inputs.left = 0

    def start_in_blocks(self) -> None:
        """Have starting blocks, of instances that keep their states, where inputs lack steps.

        Raises
        ------
        CallFailed
            One can't.
        """
        if self._steps_of_block:
            inputs = [each for each, _ in self._extrapolated]
            self._starting = StartingBlocks(
                self._instances, inputs, self._steps_of_block, self._layout.size, self._arena
            )

    @property
    def starting(self) -> StartingBlocks | None:
        """The starting blocks, where there are some."""
        return self._starting

    def numbers_of_loops(self) -> list[float]:
        """What of its algebraic loops belongs to the state of a run."""
        return [number for torn in self._torn for number in torn.numbers()]

    def restore_loops(self, numbers: list[float]) -> None:
        """Take what `numbers_of_loops` gave, and more, from the front of a list."""
        for torn in self._torn:
            torn.restore(numbers)

    def iterations(self) -> dict[str, Any] | None:
        """For people: what solving algebraic loops took; None where there are none."""
        if not self._torn:
            return None
        at_start, at_points = (torn.summary() for torn in self._torn)
        both = {name: at_start[name] + at_points[name] for name in ("points", "iterations", "exchanges")}
        residual = max(at_start["largest_residual"], at_points["largest_residual"])
        return {**at_points, **both, "largest_residual": residual}

    def _iterated_steps(self, asked: Iteration, sets: Iterable[NamedOperation]) -> IteratedSteps | None:
        """What repeats steps; None where that is not asked for, or nothing goes on during a step."""
        if not asked.most:
            return None
        iterated = Iterated(self._system, self._extrapolated_inputs, self._layout)
        if not iterated.positions:
            return None
        held = [row for row in sets if row.operation.kind == OperationKind.SET and _sets(row.operation, iterated.held)]
        tables = {
            Doing.STEPPING: self.steps,
            Doing.EXCHANGING: self.at_point,
            Doing.SETTING: OperationTable([_without_copying(row) for row in held], self._instances),
        }
        return IteratedSteps(
            iterated, self._instances, tables, self._layout.size, asked, self._arena, demanded=self.demanded
        )

    def predicted_links(self) -> list[tuple[Link, int]]:
        """Links that go on during a step of one communication step, and positions of their inputs; none if iterated."""
        if self._iterated is not None:
            return []
        links = Iterated(self._system, self._extrapolated_inputs, self._layout).links
        return [
            (k, self._layout.positions[k.target_component, k.target.name])
            for k in links
            if self.components[k.target_component].every == self.components[k.source_component].every == 1
        ]

    def iterated_steps(self) -> dict[str, Any] | None:
        """For people: what repeating steps took; None where they are not."""
        return None if self._iterated is None else self._iterated.summary()

    def _around_exchange(self) -> tuple[list[NamedOperation], list[NamedOperation]]:
        """What is to be done before and after the exchange at a communication point."""
        before: list[NamedOperation] = []
        after: list[NamedOperation] = []
        if self.events is not None:
            for rows, operation in zip((before, after), self.events.operations, strict=True):
                rows.append(NamedOperation(operation, "", raised=self.events.raised))
        if self._group is not None:
            begin, finish = self._group.around_exchange()
            before, after = [begin, *before], [*after, finish]
        return before, after

    def _let_fmus_ask_for_inputs(self) -> None:
        """FMI 3.0: the first operation that extrapolates an FMU's inputs answers, and finds the others behind it."""
        asking: set[str] = set()
        for row, operation in zip(self.steps.rows, self.steps.operations, strict=True):
            extrapolates = operation.kind == OperationKind.EXTRAPOLATE and operation.function
            if extrapolates and operation.version == 3 and row.component not in asking:
                self._instances[row.component].let_ask_for_inputs(operation)
                asking.add(row.component)

    def _operation(self, kind: OperationKind, component: str, **fields: Any) -> Operation:
        instance = self._instances[component]
        return Operation(
            kind=kind,
            every=self._system.components[component].every,
            version=instance.version,
            instance=instance.address,
            **fields,
        )

    # At a communication point

    def _calls(self, layout: ValueLayout) -> dict[int, list[NamedOperation]]:
        """Calls of functions in Python, by level: after all inputs, or before them without direct feedthrough."""
        calls: dict[int, list[NamedOperation]] = {}
        for component, instance in self._instances.items():
            if not isinstance(instance, FunctionInstance):
                continue
            level = max((t.level for t in layout.sets if t.component == component), default=0)
            operation = self._operation(OperationKind.CALL, component, function=instance.call_address)
            row = NamedOperation(operation, component)
            calls.setdefault(level if instance.function.direct_feedthrough else _BEFORE_ALL, []).append(row)
        return calls

    def _samples(self, drives: Sequence[Drive]) -> list[NamedOperation]:
        """One operation for all signals of a component."""
        pairs: dict[str, list[tuple[int, int]]] = {}
        for drive in drives:
            positions = self._layout.added if drive.added else self._layout.positions
            keys = [(drive.component, e.name) for e in drive.targets]
            pairs.setdefault(drive.component, []).extend((positions[key], self._layout.columns[key]) for key in keys)
        return [self._sample(component, *zip(*of_component, strict=True)) for component, of_component in pairs.items()]

    def _sample(self, component: str, positions: Sequence[int], columns: Sequence[int]) -> NamedOperation:
        targets = self._arena.integers([*positions, *columns])
        return NamedOperation(
            self._operation(OperationKind.SAMPLE, component, targets=targets, n_targets=len(positions)), component
        )

    def _exchange(self, kind: OperationKind, transfer: Transfer, **fields: Any) -> tuple[Operation, str]:
        instance, n = self._instances[transfer.component], len(transfer.elements)
        of_group = self._group if isinstance(instance, ModelExchangeInstance) else None
        variables, slots = variables_of(transfer.elements), self.values[transfer.first : transfer.first + n]
        timing, buffer = transfer.elements[0].timing, VariableBuffer(instance, variables, slots)
        if isinstance(instance, EventInstance) and timing:
            reads = kind is OperationKind.GET
            buffer = EventBuffer(instance, variables, slots, timing, reads=reads)
            if not reads or transfer in self._layout.gets:  # and not what is read once
                instance.keep_buffer(buffer)
        self._buffers.append(buffer)
        name = buffer.setter_name if kind is OperationKind.SET else buffer.getter_name
        operation = self._operation(
            kind,
            transfer.component,
            type=buffer.code,
            function=buffer.function_address(name),
            references=self._arena.references(list(buffer.references)),
            n_references=len(buffer.references),
            data=buffer.address,
            first=transfer.first,
            n=n,
            **fields,
        )
        if of_group is not None and timing and kind is OperationKind.SET:
            of_group.set_in_event_mode(transfer.component, buffer, operation)
        return operation, name

    def _get(self, transfer: Transfer) -> NamedOperation:
        feeding = {k.source.name for k in self._links_from.get(transfer.component, ())}
        finite = tuple(
            (e.name, transfer.first + i)
            for i, e in enumerate(transfer.elements)
            if e.name in feeding and e.kind == "real"
        )
        positions = self._arena.integers([position for _, position in finite])
        operation, name = self._exchange(OperationKind.GET, transfer, targets=positions, n_targets=len(finite))
        return NamedOperation(operation, transfer.component, name, finite, transfer=transfer)

    def _set(self, transfer: Transfer) -> list[NamedOperation]:
        """A component's inputs, after those that are no copy of an output have been computed."""
        own = {e.name for e in transfer.elements}
        links = [k for k in self._links_to.get(transfer.component, ()) if k.target.name in own]
        converted = [k for k in links if k.converts]
        transformed = [k for k in links if self._is_transformed(k)]
        copied = [k for k in links if not k.converts and not self._is_transformed(k)]
        targets = self._arena.integers([*self._targets(copied), *self._origins(copied)])
        operation, name = self._exchange(OperationKind.SET, transfer, targets=targets, n_targets=len(copied))
        row = NamedOperation(operation, transfer.component, name)
        # whole numbers become real ones before they are scaled, and real ones are scaled before they become shorter
        scaled_after = [k for k in converted if k.source.kind != "real"]
        scaled_before = [k for k in converted if k.source.kind == "real"]
        return [
            *self._convert(transfer.component, scaled_after, self._origins(scaled_after)),
            *self._transform(transfer.component, transformed),
            *self._convert(transfer.component, scaled_before, self._scaled(scaled_before)),
            row,
        ]

    def _is_transformed(self, link: Link) -> bool:
        return (link.target_component, link.target.name) in self._layout.added or link.is_scaled

    def _scaled(self, links: Sequence[Link]) -> list[int]:
        """Positions of the values that links carry once they are scaled."""
        pairs = zip(links, self._targets(links), self._origins(links), strict=True)
        return [target if self._is_transformed(k) else source for k, target, source in pairs]

    def _transform(self, component: str, links: Sequence[Link]) -> list[NamedOperation]:
        if not links:
            return []
        added = [self._layout.added.get((component, k.target.name), NONE) for k in links]
        numbers = self._arena.array(ctypes.c_double, [*(k.factor for k in links), *(k.offset for k in links)])
        pairs = zip(links, self._targets(links), self._origins(links), strict=True)
        # a whole number stands in its target as a real one already
        sources = [target if k.source.kind != "real" else source for k, target, source in pairs]
        operation = self._operation(
            OperationKind.TRANSFORM,
            component,
            targets=self._arena.integers([*self._targets(links), *sources, *added]),
            data=ctypes.addressof(numbers),
            n_targets=len(links),
        )
        return [NamedOperation(operation, component)]

    def _convert(self, component: str, links: Sequence[Link], sources: Sequence[int]) -> list[NamedOperation]:
        """Values of links between different types, from where they stand to their targets."""
        if not links:
            return []
        conversions = self._arena.structure(Conversion * len(links))
        for link, conversion in zip(links, conversions, strict=True):
            version = self._instances[component].version
            _describe(conversion, link.source.type, link.target.type.code(version), link.target.bounds)
        operation = self._operation(
            OperationKind.CONVERT,
            component,
            targets=self._arena.integers([*self._targets(links), *sources]),
            data=ctypes.addressof(conversions),
            n_targets=len(links),
        )
        return [NamedOperation(operation, component, converted=tuple(links))]

    def _targets(self, links: Sequence[Link]) -> list[int]:
        return [self._layout.positions[k.target_component, k.target.name] for k in links]

    def _origins(self, links: Sequence[Link]) -> list[int]:
        """Positions of what links carry: their sources, or what is assumed for them where they are torn."""
        assumed = self._layout.torn
        return [
            assumed[k.source_component, k.source.name] if k in self._torn_links else source
            for k, source in zip(links, self._sources(links), strict=True)
        ]

    def _sources(self, links: Sequence[Link]) -> list[int]:
        return [self._layout.positions[k.source_component, k.source.name] for k in links]

    # To the next point

    def _extrapolate_and_step(self, component: str, sets: Sequence[Transfer]) -> list[NamedOperation]:
        moving = [self._extrapolate(group) for transfer in sets for group in self._layout.extrapolated_groups(transfer)]
        for row in moving[:-1]:
            row.operation.more = 1
        # nothing happens to functions between communication points, and what is in model exchange steps together
        if isinstance(self._instances[component], FunctionInstance | ModelExchangeInstance):
            return moving
        return [*moving, self._step(component)]

    def _extrapolate(self, group: ExtrapolatedGroup) -> NamedOperation:
        """Inputs of an FMU that are extrapolated in one way."""
        instance, elements, extrapolation = self._instances[group.component], group.elements, group.extrapolation
        n, degree, points = len(elements), extrapolation.degree, extrapolation.points
        # FMI 1.0 and 2.0 take all derivatives of all inputs in one call
        orders = range(1, degree + 1) if instance.version < 3 else range(1)
        references = [v.valueReference for _ in orders for v in variables_of(elements)]
        sources = [self._layout.source_of_derivatives(group.component, e) for e in elements]
        by_extrapolation = next((i for i, source in enumerate(sources) if source != EXTRAPOLATED), n)
        inputs = self._arena.structure(Extrapolated)
        inputs.history = self._arena.zeros(max(1, points - 1) * n)
        if extrapolation.uses_rates:
            inputs.rates = self._arena.zeros(points * n)
            inputs.first_rate = self._layout.rates[group.component, elements[0].name]
        inputs.derivatives = self._arena.zeros(degree * n)
        if extrapolation.is_watched:
            inputs.watched = self._arena.zeros(4 * n)
        inputs.buffer = self._arena.zeros((degree + 1) * n)  # values, and in steps of other lengths derivatives
        if self._steps_of_block and extrapolation.starting_steps and EXTRAPOLATED in sources:
            inputs.ahead = self._arena.zeros(self._steps_of_block * degree * n)
        inputs.orders = self._arena.integers([order for order in orders for _ in range(n)])
        inputs.weights = self._arena.array(ctypes.c_double, _weights(extrapolation))
        inputs.degree, inputs.points = degree, points
        self._extrapolated.append((inputs, n))
        name = f"fmi{instance.version}SetRealInputDerivatives" if instance.version < 3 else "fmi3SetFloat64"
        in_stages = isinstance(instance, ModelExchangeInstance)
        set_ = Transfer(group.component, 0, elements, group.first)
        operation = self._operation(
            OperationKind.EXTRAPOLATE,
            group.component,
            function=None if in_stages else instance.function_address(name),
            references=self._arena.references(references),
            n_references=len(references),
            first=group.first,
            n=n,
            targets=self._arena.integers(sources[by_extrapolation:]),
            n_targets=n - by_extrapolation,
            data=ctypes.addressof(inputs),
        )
        if in_stages:  # which ask for inputs as FMUs of FMI 3.0 do
            operation.version = 3
        return NamedOperation(operation, group.component, name, transfer=set_)

    def _exchange_rates(self) -> list[NamedOperation]:
        """Rates of outputs, level by level, and those of the inputs that they feed."""
        rows: list[NamedOperation] = []
        for transfer in self._layout.rated:
            links = [k for k in self._links_to.get(transfer.component, ()) if k.target in transfer.elements]
            if links:
                rows += self._carry_rates(transfer.component, links)
            else:
                rows.append(self._differentiate(transfer))
        return rows

    def _carry_rates(self, component: str, links: Sequence[Link]) -> list[NamedOperation]:
        rates = self._layout.rates
        factors = self._arena.array(ctypes.c_double, [*(k.factor for k in links), *(0.0 for _ in links)])
        targets = [rates[k.target_component, k.target.name] for k in links]
        sources = [rates[k.source_component, k.source.name] for k in links]
        operation = self._operation(
            OperationKind.TRANSFORM,
            component,
            targets=self._arena.integers([*targets, *sources, *(NONE for _ in links)]),
            data=ctypes.addressof(factors),
            n_targets=len(links),
        )
        return [NamedOperation(operation, component)]

    def _differentiate(self, transfer: Transfer) -> NamedOperation:
        """Rates of outputs, those of the inputs with direct feedthrough included."""
        component, instance = transfer.component, self._instances[transfer.component]
        n, version = len(transfer.elements), instance.version
        through = self._layout.fed_through(transfer)
        rates = self._arena.structure(Rates)
        rates.orders = self._arena.integers([1] * n)
        if through:
            directional = f"fmi{version}GetDirectionalDerivative"
            rates.function = instance.function_address(directional)
            rates.knowns = self._arena.references([e.variable.valueReference for e in through])
            rates.positions = self._arena.integers([self._layout.rates[component, e.name] for e in through])
            rates.seed, rates.change = self._arena.zeros(len(through)), self._arena.zeros(n)
            rates.n = len(through)
        name = "fmi2GetRealOutputDerivatives" if version < 3 else "fmi3GetOutputDerivatives"
        finite = tuple((f"der({e.name})", transfer.first + i) for i, e in enumerate(transfer.elements))
        operation = self._operation(
            OperationKind.DIFFERENTIATE,
            component,
            function=instance.function_address(name),
            references=self._arena.references([e.variable.valueReference for e in transfer.elements]),
            n_references=n,
            first=transfer.first,
            n=n,
            targets=self._arena.integers([position for _, position in finite]),
            n_targets=n,
            data=ctypes.addressof(rates),
        )
        return NamedOperation(operation, component, name, finite)

    def _step(self, component: str) -> NamedOperation:
        instance = self._instances[component]
        name = f"fmi{instance.version}DoStep"
        by_events = instance.step_address if isinstance(instance, EventInstance) else 0
        operation = self._operation(
            OperationKind.STEP,
            component,
            function=by_events or instance.function_address(name),
            data=ctypes.addressof(self._arena.zeros(1)),
        )
        return NamedOperation(operation, component, name)


def _sets(operation: Operation, positions: Iterable[int]) -> bool:
    return any(operation.first <= position < operation.first + operation.n for position in positions)


def _without_copying(row: NamedOperation) -> NamedOperation:
    """An operation that sets inputs as they stand, whatever feeds them."""
    operation = Operation.from_buffer_copy(row.operation)
    operation.n_targets = 0
    return dataclasses.replace(row, operation=operation)


def _describe(conversion: Conversion, source: FmiType, code: int, bounds: tuple[float, float]) -> None:
    """Fill in what the loop needs to know of a link between two types."""
    setattr(conversion, "from", type_code(source.slot) & ~0xF)
    conversion.to = code
    if source.kind != "real" and not math.isinf(bounds[0]):
        conversion.smallest, conversion.largest = int(bounds[0]), max(0, int(bounds[1]))


def _arrays_of(inputs: Extrapolated, n: int, steps_of_block: int) -> list[tuple[Any, int]]:
    arrays = [(inputs.ahead, steps_of_block * inputs.degree * n)] if inputs.ahead else []
    arrays += [(inputs.history, max(1, inputs.points - 1) * n), (inputs.derivatives, inputs.degree * n)]
    arrays += [(inputs.rates, inputs.points * n)] if inputs.rates else []
    return [*arrays, (inputs.watched, 4 * n)] if inputs.watched else arrays


def _weights(extrapolation: Extrapolation) -> list[float]:
    """Weights for 1, 2, ... known values, as loop.c wants them: for each, `degree` rows of `points`; then of rates."""
    used = [extrapolation.used(known) for known in range(1, extrapolation.points + 1)]
    tables = [each.weights for each in used]
    if extrapolation.uses_rates:
        tables += [each.rate_weights for each in used]
    numbers = []
    for rows in tables:
        for d in range(extrapolation.degree):
            row = rows[d] if d < len(rows) else ()
            numbers += [*row, *[0.0] * (extrapolation.points - len(row))]
    return numbers


def _grouped(transfers: Iterable[Transfer], key: Callable[[Transfer], _K]) -> dict[_K, list[Transfer]]:
    groups: dict[_K, list[Transfer]] = {}
    for transfer in transfers:
        groups.setdefault(key(transfer), []).append(transfer)
    return groups
