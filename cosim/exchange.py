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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from cosim.coupling import LinearInputs
from cosim.instance import Batch, Instance
from cosim.loop.arena import Arena
from cosim.loop.binding import EXTRAPOLATED, HELD, NONE, TYPES, Kind, Operation, Rates
from cosim.ports import Element, variables_of
from cosim.resolve import Drive, Link, ResolvedSystem

Order = Literal["sequential", "parallel"]


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
    recorded : sequence of (component, element)
        What to record.
    linear : LinearInputs
        Which inputs change linearly over a step.

    Attributes
    ----------
    values : array (n,)
        Current values, component by component.
    recorded_runs : array (runs, 2) of int32
        What is recorded: position of the first value and number of each contiguous run.
    n_recorded : int
        How many values are recorded.
    at_start, at_point, at_step : Table
        What to do once in the initialisation mode, at every communication point, and to go on to the next one.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        instances: Mapping[str, Instance],
        order: Order,
        recorded: Sequence[tuple[str, Element]],
        linear: LinearInputs,
    ) -> None:
        self._system = system
        self._instances = instances
        self._positions: dict[tuple[str, str], int] = {}
        self._parts: list[tuple[str, list[Element], int]] = []  # component, elements, first position
        self._arena = Arena()
        self._batches: list[Batch] = []  # whose buffers operations point into
        fed = {(k.target_component, k.target.variable.name) for k in system.links}
        fed |= {(d.component, e.variable.name) for d in system.drives for e in d.targets}
        self._sources = {(k.source_component, k.source.variable.name) for k in system.links}
        self._links_from: dict[str, list[Link]] = {}
        self._links_to: dict[str, list[Link]] = {}
        for link in system.links:
            self._links_from.setdefault(link.source_component, []).append(link)
            self._links_to.setdefault(link.target_component, []).append(link)
        read = self._sources | {(component, e.variable.name) for component, e in recorded}
        constant = {key for key in read - fed if self._is_constant(key)}
        varying = read - fed - constant

        levels_of_gets = self._levels_of_gets(varying, fed)
        self._columns = self._columns_of(system.drives)
        self._moving = linear.moving
        self._rank = self._ranks(linear)
        levels_of_constants = {key: self._level(*key) for key in constant}
        sets, gets, constants = self._lay_out(
            self._levels_of_sets(fed, levels_of_gets), levels_of_gets, levels_of_constants
        )
        added = [(d.component, e.name) for d in system.drives if d.added for e in d.targets]
        self._added = {key: len(self._positions) + i for i, key in enumerate(added)}
        self.values = np.zeros(len(self._positions) + len(added))
        self.recorded_runs = _runs([self._positions[c, e.name] for c, e in recorded])
        self.n_recorded = len(recorded)

        samples = self._samples(system.drives)
        set_entries = {level: [e for part in parts for e in self._set(part)] for level, parts in sets.items()}
        get_entries = {level: [self._get(part) for part in parts] for level, parts in gets.items()}
        by_level = [
            entry
            for level in sorted({*sets, *gets})
            for entry in (*set_entries.get(level, []), *get_entries.get(level, []))
        ]
        # arrays of which only some elements are fed keep the start values of the others
        start_values = [self._get(part) for parts in (*sets.values(), *constants.values()) for part in parts]
        simultaneous = [entry for entries in (*get_entries.values(), *set_entries.values()) for entry in entries]
        # around an algebraic loop the start values of the inputs are the first ones
        self.at_start = Table([*start_values, *samples, *(simultaneous if system.levels is None else by_level)])
        self.at_point = Table([*samples, *(by_level if order == "sequential" else simultaneous)])
        self.at_step = Table([entry for name in system.components for entry in self._rates_and_step(name, sets)])
        first = {
            e.component: op for e, op in reversed([*zip(self.at_step.entries, self.at_step.operations, strict=True)])
        }
        for component, operation in first.items():
            if operation.kind == Kind.RATES and operation.version == 3:
                instances[component].let_ask_for_inputs(operation)

    # Layout of the values

    def _is_constant(self, key: tuple[str, str]) -> bool:
        """Whether a variable that nothing feeds keeps its value during the run."""
        variable = self._system.ports[key[0]].description_of(key[1])
        return variable.causality == "input" or variable.variability in ("constant", "fixed", "tunable")

    def _level(self, component: str, name: str) -> int:
        levels = self._system.levels
        if levels is None:
            return 0
        if (component, name) in levels:
            return levels[component, name]
        # a local variable may depend on every input
        return max((level for (c, _), level in levels.items() if c == component), default=0)

    def _levels_of_gets(self, keys: set[tuple[str, str]], fed: set[tuple[str, str]]) -> dict[tuple[str, str], int]:
        """When to read outputs: what feeds others on its level, the rest after all inputs, in as few calls as possible.

        Else an FMU would compute its outputs twice at a point: before and after its inputs are set.
        """
        level = {key: self._level(*key) for key in keys}
        last: dict[str, int] = {}
        for key in fed:
            last[key[0]] = max(last.get(key[0], 0), self._level(*key))
        feeding: dict[str, list[int]] = {}
        for key in keys & self._sources:
            feeding.setdefault(key[0], []).append(level[key])
        for key in keys - self._sources:
            last[key[0]] = max(last.get(key[0], 0), level[key])
        together = {c: min((f for f in feeding.get(c, ()) if f >= at), default=at) for c, at in last.items()}
        return level | {key: together[key[0]] for key in keys - self._sources}

    def _levels_of_sets(
        self, keys: set[tuple[str, str]], levels_of_gets: Mapping[tuple[str, str], int]
    ) -> dict[tuple[str, str], int]:
        """When to set inputs: as late as what is read allows, so that the inputs of an FMU take few calls."""
        level = {key: self._level(*key) for key in keys}
        own: dict[str, list[int]] = {}
        for (component, _), at in level.items():
            own.setdefault(component, []).append(at)
        latest: dict[tuple[str, str], int] = {}  # of inputs that something read depends on
        for (component, name), at in levels_of_gets.items():
            feedthrough = self._system.ports[component].feedthrough
            inputs = feedthrough[name] if name in feedthrough else {n for c, n in keys if c == component}
            for key in ((component, n) for n in inputs):
                latest[key] = min(latest.get(key, at), at)
        return {
            key: max(other for other in own[key[0]] if at <= other <= max(at, latest.get(key, other)))
            for key, at in level.items()
        }

    def _lay_out(self, *kinds: Mapping[tuple[str, str], int]) -> list[dict[int, list[int]]]:
        """Lay variables out, component by component, in contiguous parts: one for each kind, level and type.

        Each kind maps variables to their levels; returns its parts by level.
        """
        parts: list[dict[int, list[int]]] = [{} for _ in kinds]
        for component, port in self._system.ports.items():
            for level_of, parts_of in zip(kinds, parts, strict=True):
                groups: dict[tuple[int, str], list[Element]] = {}
                for element in port.all_elements():
                    key = (component, element.variable.name)
                    if key in level_of:
                        groups.setdefault((level_of[key], element.variable.type), []).append(element)
                for (level, _), elements in sorted(groups.items()):
                    first = len(self._positions)
                    elements = sorted(elements, key=partial(self._rank_of, component))
                    for i, element in enumerate(elements):
                        self._positions[component, element.name] = first + i
                    parts_of.setdefault(level, []).append(len(self._parts))
                    self._parts.append((component, elements, first))
        return parts

    def _ranks(self, linear: LinearInputs) -> dict[tuple[str, str], int]:
        """Rank of inputs in their part: held ones first, last those of which a signal gives the rate.

        So each operation that sets rates has contiguous values.
        """
        ranks = {(c, e.variable.name): 1 for c, elements in linear.elements.items() for e in elements}
        sampled = [
            (c, e.variable.name)
            for c, elements in linear.elements.items()
            for e in elements
            if self._column(c, e) != EXTRAPOLATED
        ]
        return ranks | dict.fromkeys(sampled, 2)

    def _rank_of(self, component: str, element: Element) -> int:
        return self._rank.get((component, element.variable.name), 0)

    def _columns_of(self, drives: Sequence[Drive]) -> dict[tuple[str, str], int]:
        """Column of the samples for each target of the signals, in their order."""
        targets = [(drive.component, element.name) for drive in drives for element in drive.targets]
        return {key: column for column, key in enumerate(targets)}

    # Operations

    def _operation(self, kind: Kind, component: str, **fields: Any) -> Operation:
        instance = self._instances[component]
        return Operation(
            kind=kind,
            every=self._system.components[component].every,
            version=instance.version,
            instance=instance.address,
            **fields,
        )

    def _exchange(self, kind: Kind, part: int, **fields: Any) -> tuple[Operation, str]:
        component, elements, first = self._parts[part]
        batch = Batch(self._instances[component], variables_of(elements), self.values[first : first + len(elements)])
        self._batches.append(batch)
        name = batch.setter_name if kind is Kind.SET else batch.getter_name
        operation = self._operation(
            kind,
            component,
            type=TYPES[batch.c_type],
            function=self._instances[component].function_address(name),
            references=self._arena.references(list(batch.references)),
            n_references=len(batch.references),
            data=batch.buffer_address,
            first=first,
            n=len(elements),
            **fields,
        )
        return operation, name

    def _get(self, part: int) -> Entry:
        component, elements, first = self._parts[part]
        feeding = {k.source.name for k in self._links_from.get(component, ())}
        finite = tuple((e.name, first + i) for i, e in enumerate(elements) if e.name in feeding)
        positions = self._arena.integers([position for _, position in finite])
        operation, name = self._exchange(Kind.GET, part, targets=positions, n_targets=len(finite))
        return Entry(operation, component, name, finite)

    def _set(self, part: int) -> list[Entry]:
        component, elements, first = self._parts[part]
        index = {e.name: first + i for i, e in enumerate(elements)}
        fed = [k for k in self._links_to.get(component, ()) if k.target.name in index]
        transformed = [k for k in fed if self._is_transformed(k)]
        links = [k for k in fed if not self._is_transformed(k)]
        operation, name = self._exchange(
            Kind.SET,
            part,
            targets=self._arena.integers(
                [
                    *(index[k.target.name] for k in links),
                    *(self._positions[k.source_component, k.source.name] for k in links),
                ]
            ),
            n_targets=len(links),
        )
        entry = Entry(operation, component, name)
        return [self._transform(component, transformed, index), entry] if transformed else [entry]

    def _is_transformed(self, link: Link) -> bool:
        return (link.factor, link.offset) != (1.0, 0.0) or (link.target_component, link.target.name) in self._added

    def _transform(self, component: str, links: Sequence[Link], position: Mapping[str, int]) -> Entry:
        targets = [position[k.target.name] for k in links]
        sources = [self._positions[k.source_component, k.source.name] for k in links]
        added = [self._added.get((component, k.target.name), NONE) for k in links]
        numbers = self._arena.array(ctypes.c_double, [*(k.factor for k in links), *(k.offset for k in links)])
        operation = self._operation(
            Kind.TRANSFORM,
            component,
            targets=self._arena.integers([*targets, *sources, *added]),
            data=ctypes.addressof(numbers),
            n_targets=len(links),
        )
        return Entry(operation, component)

    def _samples(self, drives: Sequence[Drive]) -> list[Entry]:
        """One operation for all signals of a component."""
        pairs: dict[str, list[tuple[int, int]]] = {}
        for drive in drives:
            positions = self._added if drive.added else self._positions
            keys = [(drive.component, e.name) for e in drive.targets]
            pairs.setdefault(drive.component, []).extend((positions[key], self._columns[key]) for key in keys)
        return [self._sample(component, *zip(*of_component, strict=True)) for component, of_component in pairs.items()]

    def _sample(self, component: str, positions: Sequence[int], columns: Sequence[int]) -> Entry:
        targets = self._arena.integers([*positions, *columns])
        return Entry(self._operation(Kind.SAMPLE, component, targets=targets, n_targets=len(positions)), component)

    def _rates_and_step(self, component: str, sets: Mapping[int, Sequence[int]]) -> list[Entry]:
        parts = [part for _, parts in sorted(sets.items()) for part in parts if self._parts[part][0] == component]
        rates = [entry for part in parts for entry in self._rates(part)]
        for entry in rates[:-1]:
            entry.operation.more = 1
        return [*rates, self._step(component)]

    def _rates(self, part: int) -> list[Entry]:
        """The rates of a part of the inputs, if any of them is linear."""
        component, all_elements, first_of_all = self._parts[part]
        elements = [e for e in all_elements if self._rank_of(component, e)]
        if not elements:
            return []
        instance = self._instances[component]
        n = len(elements)
        references = [v.valueReference for v in variables_of(elements)]
        columns = [self._column(component, e) for e in elements]
        extrapolated = next((i for i, column in enumerate(columns) if column != EXTRAPOLATED), n)
        rates = self._arena.structure(Rates)
        rates.values, rates.per_second, rates.buffer = (self._arena.zeros(n) for _ in range(3))
        rates.orders = self._arena.integers([1] * n)
        name = "fmi2SetRealInputDerivatives" if instance.version == 2 else "fmi3SetFloat64"
        operation = self._operation(
            Kind.RATES,
            component,
            function=instance.function_address(name),
            references=self._arena.references(references),
            n_references=len(references),
            first=first_of_all + len(all_elements) - n,
            n=n,
            targets=self._arena.integers(columns[extrapolated:]),
            n_targets=n - extrapolated,
            data=ctypes.addressof(rates),
        )
        return [Entry(operation, component, name)]

    def _column(self, component: str, element: Element) -> int:
        """Where the rate of a linear input comes from."""
        key = (component, element.name)
        return self._columns.get(key, EXTRAPOLATED) if key in self._moving else HELD

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


def _runs(positions: Sequence[int]) -> np.ndarray:
    """First position and number (runs, 2) of each run of consecutive positions."""
    all_positions = np.array(positions, dtype=np.int32)
    firsts = np.flatnonzero(np.diff(all_positions, prepend=-2) != 1)
    numbers = np.diff(firsts, append=len(all_positions))
    return np.column_stack([all_positions[firsts], numbers]).astype(np.int32)
