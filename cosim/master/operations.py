"""The table of operations that moves values between FMUs and steps them; the compiled loop walks it (cosim/loop).

All exchanged and recorded values stand in one array, each batch in a contiguous part of it, so that an operation is a
copy inside this array or one call of an FMU. Two orders:

sequential
    Level by level (see `schedule`): what one FMU outputs at a communication point reaches the others at that very
    point, also through direct feedthrough. A controller then acts on the measurements of the same instant, and its
    output is held over the step: the delay of a zero-order hold, half a step on average.
parallel
    All outputs are read, then all inputs are set. An output with direct feedthrough still belongs to the inputs of the
    step before: one step more of delay for each FMU with direct feedthrough on the way.

At the start both exchange level by level, so that the first point has no delay in either.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal, TypeVar

import numpy as np

from cosim.fmi.instance import Batch, Instance
from cosim.loop.arena import Arena
from cosim.loop.binding import EXTRAPOLATED, NONE, TYPES, Kind, Operation, Rates
from cosim.master.value_layout import Layout, Part
from cosim.system.resolution import Drive, Link, ResolvedSystem
from cosim.system.variables import variables_of

Order = Literal["sequential", "parallel"]

_K = TypeVar("_K")


@dataclass(frozen=True)
class Entry:
    """An operation, and what messages about its failure need to know."""

    operation: Operation
    component: str
    function: str = ""
    finite: tuple[tuple[str, int], ...] = ()  # names and positions of values that must be finite


class Table:
    """Operations in the order in which the loop performs them."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        self.entries = tuple(entries)
        self.operations = (Operation * len(self.entries))(*(e.operation for e in self.entries))

    def __len__(self) -> int:
        return len(self.entries)


class Exchange:
    """Values of a system and the operations that exchange them.

    Parameters
    ----------
    system : ResolvedSystem
    instances : mapping
        Component name -> instance.
    order : {"sequential", "parallel"}
    layout : Layout
        Where the values of the system stand.

    Attributes
    ----------
    values : array (n,)
        Current values.
    recorded_runs : array (runs, 2) of int32
        What is recorded: position of the first value and number of each contiguous run.
    at_start, at_point, at_step : Table
        What to do once in the initialisation mode, at every communication point, and to go on to the next one.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        instances: Mapping[str, Instance],
        order: Order,
        layout: Layout,
    ) -> None:
        self._system = system
        self._instances = instances
        self._layout = layout
        self._arena = Arena()
        self._batches: list[Batch] = []  # whose buffers operations point into
        self._links_from: dict[str, list[Link]] = {}
        self._links_to: dict[str, list[Link]] = {}
        for link in system.links:
            self._links_from.setdefault(link.source_component, []).append(link)
            self._links_to.setdefault(link.target_component, []).append(link)
        self.values = np.zeros(layout.size)
        self.recorded_runs = layout.recorded_runs

        samples = self._samples(system.drives)
        sets = {
            k: [e for part in parts for e in self._set(part)]
            for k, parts in _grouped(layout.sets, attrgetter("level")).items()
        }
        gets = {
            k: [self._get(part) for part in parts] for k, parts in _grouped(layout.gets, attrgetter("level")).items()
        }
        by_level = [e for level in sorted({*sets, *gets}) for e in (*sets.get(level, ()), *gets.get(level, ()))]
        simultaneous = [e for entries in (*gets.values(), *sets.values()) for e in entries]
        # arrays of which only some elements are fed keep the start values of the others
        start_values = [self._get(part) for part in (*layout.sets, *layout.constants)]
        # around an algebraic loop the start values of the inputs are the first ones
        self.at_start = Table([*start_values, *samples, *(simultaneous if system.levels is None else by_level)])
        self.at_point = Table([*samples, *(by_level if order == "sequential" else simultaneous)])
        sets_of = _grouped(layout.sets, attrgetter("component"))
        self.at_step = Table([e for c in system.components for e in self._rates_and_step(c, sets_of.get(c, ()))])
        self._let_fmus_ask_for_inputs()

    def _let_fmus_ask_for_inputs(self) -> None:
        """FMI 3.0: the first operation of each FMU's rates answers, and finds the others behind it."""
        asking: set[str] = set()
        for entry, operation in zip(self.at_step.entries, self.at_step.operations, strict=True):
            if operation.kind == Kind.RATES and operation.version == 3 and entry.component not in asking:
                self._instances[entry.component].let_ask_for_inputs(operation)
                asking.add(entry.component)

    def _operation(self, kind: Kind, component: str, **fields: Any) -> Operation:
        instance = self._instances[component]
        return Operation(
            kind=kind,
            every=self._system.components[component].every,
            version=instance.version,
            instance=instance.address,
            **fields,
        )

    # At a communication point

    def _samples(self, drives: Sequence[Drive]) -> list[Entry]:
        """One operation for all signals of a component."""
        pairs: dict[str, list[tuple[int, int]]] = {}
        for drive in drives:
            positions = self._layout.added if drive.added else self._layout.positions
            keys = [(drive.component, e.name) for e in drive.targets]
            pairs.setdefault(drive.component, []).extend((positions[key], self._layout.columns[key]) for key in keys)
        return [self._sample(component, *zip(*of_component, strict=True)) for component, of_component in pairs.items()]

    def _sample(self, component: str, positions: Sequence[int], columns: Sequence[int]) -> Entry:
        targets = self._arena.integers([*positions, *columns])
        return Entry(self._operation(Kind.SAMPLE, component, targets=targets, n_targets=len(positions)), component)

    def _exchange(self, kind: Kind, part: Part, **fields: Any) -> tuple[Operation, str]:
        instance, n = self._instances[part.component], len(part.elements)
        batch = Batch(instance, variables_of(part.elements), self.values[part.first : part.first + n])
        self._batches.append(batch)
        name = batch.setter_name if kind is Kind.SET else batch.getter_name
        operation = self._operation(
            kind,
            part.component,
            type=TYPES[batch.c_type],
            function=instance.function_address(name),
            references=self._arena.references(list(batch.references)),
            n_references=len(batch.references),
            data=batch.buffer_address,
            first=part.first,
            n=n,
            **fields,
        )
        return operation, name

    def _get(self, part: Part) -> Entry:
        feeding = {k.source.name for k in self._links_from.get(part.component, ())}
        finite = tuple((e.name, part.first + i) for i, e in enumerate(part.elements) if e.name in feeding)
        positions = self._arena.integers([position for _, position in finite])
        operation, name = self._exchange(Kind.GET, part, targets=positions, n_targets=len(finite))
        return Entry(operation, part.component, name, finite)

    def _set(self, part: Part) -> list[Entry]:
        """A component's inputs, after those that are no copy of an output have been computed."""
        own = {e.name for e in part.elements}
        links = [k for k in self._links_to.get(part.component, ()) if k.target.name in own]
        transformed = [k for k in links if self._is_transformed(k)]
        copied = [k for k in links if not self._is_transformed(k)]
        targets = self._arena.integers([*self._targets(copied), *self._sources(copied)])
        operation, name = self._exchange(Kind.SET, part, targets=targets, n_targets=len(copied))
        entry = Entry(operation, part.component, name)
        return [self._transform(part.component, transformed), entry] if transformed else [entry]

    def _is_transformed(self, link: Link) -> bool:
        added_to = (link.target_component, link.target.name) in self._layout.added
        return added_to or (link.factor, link.offset) != (1.0, 0.0)

    def _transform(self, component: str, links: Sequence[Link]) -> Entry:
        added = [self._layout.added.get((component, k.target.name), NONE) for k in links]
        numbers = self._arena.array(ctypes.c_double, [*(k.factor for k in links), *(k.offset for k in links)])
        operation = self._operation(
            Kind.TRANSFORM,
            component,
            targets=self._arena.integers([*self._targets(links), *self._sources(links), *added]),
            data=ctypes.addressof(numbers),
            n_targets=len(links),
        )
        return Entry(operation, component)

    def _targets(self, links: Sequence[Link]) -> list[int]:
        return [self._layout.positions[k.target_component, k.target.name] for k in links]

    def _sources(self, links: Sequence[Link]) -> list[int]:
        return [self._layout.positions[k.source_component, k.source.name] for k in links]

    # To the next point

    def _rates_and_step(self, component: str, sets: Sequence[Part]) -> list[Entry]:
        rates = [self._rates(part) for part in sets if self._layout.linear_elements(part)]
        for entry in rates[:-1]:
            entry.operation.more = 1
        return [*rates, self._step(component)]

    def _rates(self, part: Part) -> Entry:
        """The rates of the linear inputs of a part."""
        instance, elements = self._instances[part.component], self._layout.linear_elements(part)
        n = len(elements)
        references = [v.valueReference for v in variables_of(elements)]
        sources = [self._layout.source_of_rate(part.component, e) for e in elements]
        extrapolated = next((i for i, source in enumerate(sources) if source != EXTRAPOLATED), n)
        rates = self._arena.structure(Rates)
        rates.values, rates.per_second, rates.buffer = (self._arena.zeros(n) for _ in range(3))
        rates.orders = self._arena.integers([1] * n)
        name = "fmi2SetRealInputDerivatives" if instance.version == 2 else "fmi3SetFloat64"
        operation = self._operation(
            Kind.RATES,
            part.component,
            function=instance.function_address(name),
            references=self._arena.references(references),
            n_references=len(references),
            first=part.first + len(part.elements) - n,
            n=n,
            targets=self._arena.integers(sources[extrapolated:]),
            n_targets=n - extrapolated,
            data=ctypes.addressof(rates),
        )
        return Entry(operation, part.component, name)

    def _step(self, component: str) -> Entry:
        instance = self._instances[component]
        name = f"fmi{instance.version}DoStep"
        operation = self._operation(
            Kind.STEP,
            component,
            function=instance.function_address(name),
            data=ctypes.addressof(self._arena.structure(Rates)),
        )
        return Entry(operation, component, name)


def _grouped(parts: Iterable[Part], key: Callable[[Part], _K]) -> dict[_K, list[Part]]:
    groups: dict[_K, list[Part]] = {}
    for part in parts:
        groups.setdefault(key(part), []).append(part)
    return groups
