"""The table of operations that moves values between FMUs at a communication point.

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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cosim.instance import Batch, CallFailed, Instance
from cosim.ports import Element, fits, variables_of
from cosim.resolve import Drive, ResolvedSystem

Order = Literal["sequential", "parallel"]


@dataclass(frozen=True)
class Operation:
    """One entry of the table: something to do at the communication points of a component."""

    component: str
    every: int
    run: Callable[[float], None]


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

    Attributes
    ----------
    values : array (n,)
        Current values; those at `recorded_positions` are recorded.
    at_start, at_point : list of Operation
        What to do once in the initialisation mode, and at every communication point.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        instances: Mapping[str, Instance],
        order: Order,
        recorded: Sequence[tuple[str, Element]],
    ) -> None:
        self._system = system
        self._instances = instances
        self._positions: dict[tuple[str, str], int] = {}
        self._parts: list[tuple[str, list[Element], int]] = []  # component, elements, first position
        fed = {(k.target_component, k.target.variable.name) for k in system.links}
        fed |= {(d.component, e.variable.name) for d in system.drives for e in d.targets}
        read = {(k.source_component, k.source.variable.name) for k in system.links}
        read |= {(component, e.variable.name) for component, e in recorded}

        sets = self._group(fed)
        gets = self._group({key for key in read - fed if not self._is_constant(key)})
        constants = self._group({key for key in read - fed if self._is_constant(key)})
        size = sum(len(elements) for _, elements, _ in self._parts)
        self.values = np.zeros(size)
        self.recorded_positions = np.array([self._positions[c, e.name] for c, e in recorded], dtype=int)

        samples = [self._sample(drive) for drive in system.drives]
        set_operations = {level: [self._set(part) for part in parts] for level, parts in sets.items()}
        get_operations = {level: [self._get(part) for part in parts] for level, parts in gets.items()}
        by_level = [
            operation
            for level in sorted({*sets, *gets})
            for operation in (*set_operations.get(level, []), *get_operations.get(level, []))
        ]
        # arrays of which only some elements are fed keep the start values of the others
        start_values = [self._get(part) for parts in (*sets.values(), *constants.values()) for part in parts]
        all_gets = [operation for operations in get_operations.values() for operation in operations]
        all_sets = [operation for operations in set_operations.values() for operation in operations]
        simultaneous = [*all_gets, *all_sets]
        # around an algebraic loop the start values of the inputs are the first ones
        self.at_start = [*start_values, *samples, *(simultaneous if system.levels is None else by_level)]
        self.at_point = [*samples, *(by_level if order == "sequential" else simultaneous)]

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

    def _group(self, keys: set[tuple[str, str]]) -> dict[int, list[int]]:
        """Lay variables out in contiguous parts, one for each level, component and type; indices by level."""
        groups: dict[tuple[int, str, str], list[Element]] = {}
        for component, port in self._system.ports.items():
            for element in port.all_elements():
                key = (component, element.variable.name)
                if key in keys:
                    group = (self._level(*key), component, element.variable.type)
                    groups.setdefault(group, []).append(element)
        parts: dict[int, list[int]] = {}
        for (level, component, _), elements in groups.items():
            first = len(self._positions)
            for i, element in enumerate(elements):
                self._positions[component, element.name] = first + i
            parts.setdefault(level, []).append(len(self._parts))
            self._parts.append((component, elements, first))
        return parts

    def _batch(self, part: int) -> tuple[str, Batch]:
        component, elements, first = self._parts[part]
        return component, Batch(
            self._instances[component], variables_of(elements), self.values[first : first + len(elements)]
        )

    def _operation(self, component: str, run: Callable[[float], None]) -> Operation:
        return Operation(component, self._system.components[component].every, run)

    def _get(self, part: int) -> Operation:
        component, batch = self._batch(part)
        _, elements, first = self._parts[part]
        sources = {k.source.name for k in self._system.links if k.source_component == component}
        fed = [(e.name, first + i) for i, e in enumerate(elements) if e.name in sources]
        positions = np.array([position for _, position in fed], dtype=int)
        values = self.values

        def run(_: float) -> None:
            batch.get()
            if not np.isfinite(values[positions]).all():
                wrong = [f"'{name}'" for name, position in fed if not np.isfinite(values[position])]
                raise CallFailed(f"{len(wrong)} outputs are not finite, the first is {wrong[0]}")

        return self._operation(component, run)

    def _set(self, part: int) -> Operation:
        component, batch = self._batch(part)
        _, elements, first = self._parts[part]
        index = {e.name: first + i for i, e in enumerate(elements)}
        links = [k for k in self._system.links if k.target_component == component and k.target.name in index]
        targets = np.array([index[k.target.name] for k in links], dtype=int)
        sources = np.array([self._positions[k.source_component, k.source.name] for k in links], dtype=int)
        values = self.values

        def run(_: float) -> None:
            values[targets] = values[sources]
            batch.set()

        return self._operation(component, run)

    def _sample(self, drive: Drive) -> Operation:
        positions = np.array([self._positions[drive.component, e.name] for e in drive.targets], dtype=int)
        names = f"{drive.component}.{drive.targets[0].name}"
        values = self.values

        def run(time: float) -> None:
            values[positions] = sample(drive, time, names)

        return self._operation(drive.component, run)


def sample(drive: Drive, time: float, name: str) -> np.ndarray:
    """Value of a signal at a time (s), (n,).

    Raises
    ------
    CallFailed
        The function raises, gives a wrong number of values, or values that are not finite.
    """
    try:
        value = np.atleast_1d(np.asarray(drive.function(time), dtype=float))
    except Exception as error:
        raise CallFailed(f"the signal that feeds '{name}' failed: {type(error).__name__}: {error}") from error
    if value.ndim != 1:
        raise CallFailed(f"the signal that feeds '{name}' gives an array of shape {value.shape}; make it flat")
    if value.size not in (1, len(drive.targets)):
        raise CallFailed(f"the signal that feeds '{name}' gives {value.size} values, not {len(drive.targets)}")
    if not np.isfinite(value).all():
        raise CallFailed(f"the signal that feeds '{name}' gives {value.tolist()}, which is not finite")
    first = drive.targets[0]
    if first.kind != "real" and not all(fits(first, v) for v in value.tolist()):
        raise CallFailed(
            f"the signal that feeds '{name}' gives {value.tolist()}, no value of type {first.variable.type}"
        )
    return value
