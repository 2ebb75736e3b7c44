"""Layout of the values of a system in the one array that the loop works on, and the points of their exchange.

Values stand component by component, each component's in contiguous transfers: what one call of an FMU sets or gets.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from itertools import groupby

import numpy as np

from cosim.loop.binding import EXTRAPOLATED, HELD
from cosim.master.coupling.algorithm import Extrapolation
from cosim.master.coupling.extrapolated_inputs import ExtrapolatedInputs
from cosim.system.resolution import ResolvedSystem
from cosim.system.variables import Element, is_alias

#: A variable or an element, by component and name.
Key = tuple[str, str]


@dataclass(frozen=True)
class Transfer:
    """Variables of one type and timing that a component gets or sets in one call, on one level of the exchange.

    Levels: see `cosim.system.levels`. The value of `elements[i]` is at position `first + i`.
    """

    component: str
    level: int
    elements: tuple[Element, ...]
    first: int


@dataclass(frozen=True)
class ExtrapolatedGroup:
    """Inputs of a transfer that are extrapolated in one way; `first` is the position of the first one."""

    component: str
    elements: tuple[Element, ...]
    first: int
    extrapolation: Extrapolation


class ValueLayout:
    """Positions of all values that are exchanged or recorded.

    Parameters
    ----------
    system : ResolvedSystem
    recorded : sequence of (component, element)
        What to record.
    extrapolated : ExtrapolatedInputs
        Which inputs are extrapolated over a step.

    Attributes
    ----------
    positions : mapping
        Element -> its position.
    added : mapping
        Element -> position of the signal that is added to it.
    torn : mapping
        Output of which a connection is torn -> position of the value that is assumed for it.
    size : int
        Number of values.
    sets, gets, constants : list of Transfer
        Inputs that something feeds, variables that are read at the communication points, and those that are read once.
    recorded_runs : array (runs, 2) of int32
        What is recorded: position of the first value and number of each contiguous run.
    columns : mapping
        Element -> its column in the samples of the signals.
    rates : mapping
        Element, an output or an input -> position of its derivative by time, where that is used.
    rated : list of Transfer
        Elements whose rates are exchanged after the values, in this order: outputs of components, and inputs, whose
        rates are those of the outputs that feed them.
    """

    def __init__(
        self, system: ResolvedSystem, recorded: Sequence[tuple[str, Element]], extrapolated: ExtrapolatedInputs
    ) -> None:
        self._system = system
        self._moving = extrapolated.moving
        self._extrapolated = extrapolated
        self.columns = _numbered((d.component, e.name) for d in system.drives for e in d.targets)
        self._rank = self._ranks(extrapolated)

        fed = {(k.target_component, k.target.variable.name) for k in system.links}
        fed |= {(d.component, e.variable.name) for d in system.drives for e in d.targets}
        feeding = {(k.source_component, k.source.variable.name) for k in system.links}
        read = (feeding | {(component, e.variable.name) for component, e in recorded}) - fed
        constant = {key for key in read if self._is_constant(key, fed)}
        levels_of_gets = self._levels_of_gets(read - constant, feeding, fed)
        kinds = (
            self._levels_of_sets(fed, levels_of_gets),
            levels_of_gets,
            {key: self._level(key) for key in constant},
        )
        self.positions: dict[Key, int] = {}
        self.sets, self.gets, self.constants = self._transfers(kinds)
        added = ((d.component, e.name) for d in system.drives if d.added for e in d.targets)
        self.added = _numbered(added, first=len(self.positions))
        self.size = len(self.positions) + len(self.added)
        torn = dict.fromkeys((k.source_component, k.source.name) for k in system.torn)
        self.torn = _numbered(torn, first=self.size)
        self.size += len(self.torn)
        self.rates: dict[Key, int] = {}
        self.rated = self._lay_out_rates()
        self.recorded_runs = _runs([self.positions[c, e.name] for c, e in recorded])

    def extrapolated_groups(self, transfer: Transfer) -> list[ExtrapolatedGroup]:
        """The last ones of a transfer of the inputs, those that are extrapolated over a step, by how that is done."""
        groups: list[ExtrapolatedGroup] = []
        by = self._extrapolated.by_variable
        component = transfer.component
        for name, elements in groupby(transfer.elements, lambda e: self._name_of_extrapolation(component, e)):
            if name:
                own = tuple(elements)
                first = transfer.first + transfer.elements.index(own[0])
                groups.append(ExtrapolatedGroup(component, own, first, by[component, own[0].variable.name]))
        return groups

    def _name_of_extrapolation(self, component: str, element: Element) -> str:
        extrapolation = self._extrapolated.by_variable.get((component, element.variable.name))
        return "" if extrapolation is None else extrapolation.name

    def fed_through(self, transfer: Transfer) -> tuple[Element, ...]:
        """Inputs with a rate on which outputs depend directly."""
        component = transfer.component
        through = self._system.feedthrough[component]
        names = {name for e in transfer.elements for name in through.get(e.variable.name, ())}
        port = self._system.ports[component]
        return tuple(e for e in port.elements_in(names) if (component, e.name) in self.rates)

    def _lay_out_rates(self) -> list[Transfer]:
        """Give rates their positions, behind all values: those of the groups of inputs, and those of the outputs."""
        for transfer in self.sets:
            for group in self.extrapolated_groups(transfer):
                if group.extrapolation.uses_rates:
                    self._add_rates(group.component, group.elements)
        levels = self._system.levels or {}
        groups: dict[tuple[int, int, str], list[Element]] = {}
        for kind, keys in enumerate((self._extrapolated.rated_inputs, self._extrapolated.rated_outputs)):
            for component, element in keys:
                level = levels.get((component, element.variable.name), 0)
                groups.setdefault((level, kind, component), []).append(element)
        transfers = []
        for (level, _, component), elements in sorted(groups.items(), key=lambda item: item[0]):
            new = tuple(e for e in elements if (component, e.name) not in self.rates)
            first = self._add_rates(component, new)
            transfers.append(Transfer(component, level, tuple(elements), first))
        return transfers

    def _add_rates(self, component: str, elements: Sequence[Element]) -> int:
        first = self.size
        self.rates |= _numbered(((component, e.name) for e in elements), first)
        self.size += len(elements)
        return first

    def source_of_derivatives(self, component: str, element: Element) -> int:
        """Source of the derivatives of an extrapolated input: a column of the samples, EXTRAPOLATED or HELD."""
        key = (component, element.name)
        return self.columns.get(key, EXTRAPOLATED) if key in self._moving else HELD

    # When

    def _is_constant(self, key: Key, fed: Set[Key]) -> bool:
        """Whether a variable that nothing feeds keeps its value during the run."""
        variable = self._system.ports[key[0]].description_of(key[1])
        if variable.type == "Clock" or (is_alias(variable) and (key[0], variable.alias.name) in fed):
            return False
        return variable.causality == "input" or variable.variability in ("constant", "fixed", "tunable")

    def _level(self, key: Key) -> int:
        levels = self._system.levels
        if levels is None:
            return 0
        if key in levels:
            return levels[key]
        # a local variable may depend on every input
        return max((level for (component, _), level in levels.items() if component == key[0]), default=0)

    def _levels_of_gets(self, keys: set[Key], feeding: set[Key], fed: set[Key]) -> dict[Key, int]:
        """When to read outputs: what feeds others on its level, the rest after all inputs, in as few calls as possible.

        Else an FMU would compute its outputs twice at a point: before and after its inputs are set.
        """
        level = {key: self._level(key) for key in keys}
        last: dict[str, int] = {}
        for key in fed:
            last[key[0]] = max(last.get(key[0], 0), self._level(key))
        levels_of_feeding: dict[str, list[int]] = {}
        for key in keys & feeding:
            levels_of_feeding.setdefault(key[0], []).append(level[key])
        for key in keys - feeding:
            last[key[0]] = max(last.get(key[0], 0), level[key])
        together = {
            component: min((f for f in levels_of_feeding.get(component, ()) if f >= at), default=at)
            for component, at in last.items()
        }
        return level | {key: together[key[0]] for key in keys - feeding}

    def _levels_of_sets(self, keys: set[Key], levels_of_gets: Mapping[Key, int]) -> dict[Key, int]:
        """When to set inputs: as late as what is read allows, so that the inputs of an FMU take few calls."""
        level = {key: self._level(key) for key in keys}
        own: dict[str, list[int]] = {}
        for (component, _), at in level.items():
            own.setdefault(component, []).append(at)
        latest: dict[Key, int] = {}  # of inputs that something read depends on
        for (component, name), at in levels_of_gets.items():
            feedthrough = self._system.feedthrough[component]
            inputs = feedthrough[name] if name in feedthrough else {n for c, n in keys if c == component}
            for key in ((component, n) for n in inputs):
                latest[key] = min(latest.get(key, at), at)
        among = {component: sorted(set(levels), reverse=True) for component, levels in own.items()}
        return {key: _latest(among[key[0]], at, latest.get(key)) for key, at in level.items()}

    # Where

    def _transfers(self, kinds: Sequence[Mapping[Key, int]]) -> list[list[Transfer]]:
        """Give each variable its position; each kind, which maps variables to levels, gets its own transfers."""
        transfers: list[list[Transfer]] = [[] for _ in kinds]
        of_components = [_by_component(level_of) for level_of in kinds]
        for component, port in self._system.ports.items():
            for by_component, transfers_of_kind in zip(of_components, transfers, strict=True):
                level_of = by_component.get(component)
                if level_of is None:
                    continue
                groups: dict[tuple[int, str, str], list[Element]] = {}
                for name, variable in port.variables.items():
                    for element in port.elements_of(name) if name in level_of else ():
                        groups.setdefault((level_of[name], variable.type, element.timing), []).append(element)
                for (level, *_), group in sorted(groups.items(), key=_clocks_first):
                    elements = tuple(sorted(group, key=partial(self._rank_of, component)))
                    transfer = Transfer(component, level, elements, first=len(self.positions))
                    self.positions |= _numbered(((component, e.name) for e in elements), transfer.first)
                    transfers_of_kind.append(transfer)
        return transfers

    def _ranks(self, extrapolated: ExtrapolatedInputs) -> dict[Key, int]:
        """Rank of inputs in their transfer: held ones first, then those of each extrapolation.

        Last among these come those of which a signal gives the derivatives. So each operation that sets derivatives has
        contiguous values.
        """
        ranks: dict[Key, int] = {}
        names = sorted({each.name for each in extrapolated.by_variable.values()})
        for component, elements in extrapolated.elements.items():
            for element in elements:
                rank = 1 if self.source_of_derivatives(component, element) == EXTRAPOLATED else 2
                rank += 2 * names.index(extrapolated.by_variable[component, element.variable.name].name)
                key = (component, element.variable.name)
                ranks[key] = max(rank, ranks.get(key, rank))
        return ranks

    def _rank_of(self, component: str, element: Element) -> int:
        return self._rank.get((component, element.variable.name), 0)


def _latest(levels: Sequence[int], at: int, end: int | None) -> int:
    """The greatest of some levels, which descend and have `at` among them, that is not before `at` nor after `end`."""
    if len(levels) == 1:
        return at
    return levels[0] if end is None else next(level for level in levels if level <= max(at, end))


def _by_component(level_of: Mapping[Key, int]) -> dict[str, dict[str, int]]:
    found: dict[str, dict[str, int]] = {}
    for (component, name), level in level_of.items():
        found.setdefault(component, {})[name] = level
    return found


def _numbered(keys: Iterable[Key], first: int = 0) -> dict[Key, int]:
    return {key: number for number, key in enumerate(keys, start=first)}


def _clocks_first(group: tuple[tuple[int, str, str], list[Element]]) -> tuple[int, bool, str, str]:
    """Order of transfers: by level, and clocks before what they let through."""
    level, kind, timing = group[0]
    return level, kind != "Clock", kind, timing


def _runs(positions: Sequence[int]) -> np.ndarray:
    """First position and number (runs, 2) of each run of consecutive positions."""
    all_positions = np.array(positions, dtype=np.int32)
    firsts = np.flatnonzero(np.diff(all_positions, prepend=-2) != 1)
    numbers = np.diff(firsts, append=len(all_positions))
    return np.column_stack([all_positions[firsts], numbers]).astype(np.int32)
