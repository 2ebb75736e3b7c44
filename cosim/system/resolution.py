"""Check a system against the model descriptions of its FMUs, before anything runs."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, get_args

import numpy as np

from cosim.errors import ArgumentError, SetupError, nearest
from cosim.fmi.event_mode import has_settable_interval, is_time_based
from cosim.fmi.structure import is_structural
from cosim.fmi.types import CONVERSIONS
from cosim.system.levels import AlgebraicLoop, Node, levels
from cosim.system.system import AsWritten, Component, Connection, Signal, SignalFunction, System, Units
from cosim.system.units import UnitsDiffer, conversion
from cosim.system.variables import LARGE, Element, ElementArray, Ports, indices, is_alias


@dataclass(frozen=True)
class Link:
    """A connection between two scalar values: target = factor * source + offset."""

    source_component: str
    source: Element
    target_component: str
    target: Element
    factor: float
    offset: float
    extrapolation: str | None = None

    @property
    def is_scaled(self) -> bool:
        """Whether the value changes on the way by its factor or its offset."""
        return (self.factor, self.offset) != (1.0, 0.0)

    @property
    def converts(self) -> bool:
        """Whether the target has another type, which may not hold each value of the source."""
        source, target = self.source.type, self.target.type
        if source.is_text:
            return False
        if source.slot != target.slot or (target.kind == "enumeration" and self.source.items != self.target.items):
            return True
        (lower, upper), (smallest, largest) = self.target.bounds, self.source.bounds
        return smallest < lower or upper < largest

    def carries(self, value: Any) -> bool:
        """Whether a value of the source fits the target, exactly where both are not real."""
        if self.source.kind != "real" and self.target.kind == "real":
            return bool(self.target.type.rounded(value) == value)
        lower, upper = self.target.bounds
        return bool(lower <= (self.factor * value + self.offset if self.is_scaled else value) <= upper)


@dataclass(frozen=True)
class Drive:
    """A signal that feeds one or more scalar inputs of a component, or is added to what feeds them."""

    component: str
    targets: tuple[Element, ...]
    function: SignalFunction
    breakpoints: tuple[float, ...] = ()
    vectorized: bool = False
    every: int = 1  # of its component
    added: bool = False


@dataclass(frozen=True)
class StartValue:
    """Start values of the elements of one name; of a large array of real numbers there is one object for all."""

    component: str
    elements: Sequence[Element]
    values: Sequence[Any]

    @property
    def is_large(self) -> bool:
        """Whether it is one of a large array, and has no object for each element."""
        return isinstance(self.elements, ElementArray)

    @property
    def nodes(self) -> Iterable[Node]:
        """Component and name of each element, or of a large array."""
        elements = [self.elements.whole] if isinstance(self.elements, ElementArray) else self.elements
        return ((self.component, e.name) for e in elements)

    def is_replaced(self, given: Set[Node]) -> bool:
        """Whether all elements are among others that are given, by themselves or as a whole array."""
        variable = self.elements[0].variable
        if variable.shape and (self.component, variable.name) in given:
            return True
        return all((self.component, e.name) in given for e in self.elements)

    def feeds_none_of(self, fed: Iterable[Node]) -> bool:
        """Whether none of the elements is among those that are fed."""
        if not self.is_large:
            return not set(self.nodes) & set(fed)
        array = f"{self.elements[0].variable.name}["
        return not any(component == self.component and name.startswith(array) for component, name in fed)

    @property
    def is_whole(self) -> bool:
        """Whether it is one of whole variables, and not of a single element of an array."""
        return len(self.elements) > 1 or not self.elements[0].variable.shape

    @property
    def is_interval(self) -> bool:
        """Whether it is the interval of a clock."""
        return bool(self.elements[0].variable.type == "Clock")

    @property
    def is_structural(self) -> bool:
        """Whether it is one of a structural parameter, which is set in the configuration mode."""
        return is_structural(self.elements[0].variable)


@dataclass(frozen=True)
class ResolvedSystem:
    """A system whose names stand for elements of FMUs and which has passed all checks.

    `levels` is None where an algebraic loop forbids an order; only the parallel order can run such a system.
    `feedthrough` says for each output of a component what it depends on directly: inputs, and parameters that something
    feeds. `kept` are the inputs that nothing feeds and that have no start value here: they keep that of their FMU.
    `unticked` are the triggered clocks among the inputs that nothing feeds. `torn` are links of algebraic loops that
    the levels leave out, where such loops are solved.
    """

    components: Mapping[str, Component]
    ports: Mapping[str, Ports]
    links: tuple[Link, ...]
    drives: tuple[Drive, ...]
    starts: tuple[StartValue, ...]
    levels: Mapping[Node, int] | None
    feedthrough: Mapping[str, Mapping[str, Set[str]]]
    kept: tuple[str, ...]
    unticked: tuple[str, ...]
    torn: tuple[Link, ...] = ()

    @cached_property
    def fed(self) -> frozenset[Node]:
        """Component and name of each element that a connection or a signal feeds."""
        linked = {(k.target_component, k.target.name) for k in self.links}
        return frozenset(linked | {(d.component, e.name) for d in self.drives for e in d.targets})

    def couples_equations(self, link: Link) -> bool:
        """Whether both ends of a link are in model exchange: it carries values at any time, not at points only."""
        return all(self.ports[name].is_model_exchange for name in (link.source_component, link.target_component))


def resolve(
    system: System,
    ports: Mapping[str, Ports],
    *,
    needs_levels: bool,
    strict_inputs: bool = False,
    tears: bool = False,
) -> ResolvedSystem:
    """Resolve and check all names of a system.

    Parameters
    ----------
    system : System
    ports : mapping
        Component -> its variables.
    needs_levels : bool
        The order of exchange can't run a system with an algebraic loop.
    strict_inputs : bool
        Every input must be fed or have a start value of the system; else inputs keep the start value of their FMU.
    tears : bool
        Algebraic loops are solved: some of their links are torn.

    Raises
    ------
    SetupError
        Wrong names, causalities, types, sizes or units; an input that is fed twice, or not at all where that is an
        error; an algebraic loop where the order of exchange can't run it.
    """
    links = tuple(link for c in system.connections for link in _links(c, ports))
    _check_clocks(links, system)
    drives = tuple(_drive(s, ports, system) for s in system.signals)
    every_start = [
        resolve_start_value(ports[c.name], name, value)
        for c in system.components.values()
        for name, value in c.start.items()
    ]
    starts = tuple(s for s in every_start if not s.is_interval)  # which descriptions have
    strict = {name for name, component in system.components.items() if strict_inputs or component.fmu is None}
    unfed = _check_feeding(ports, links, drives, starts, strict)
    kept, unticked = (
        [f"{c}.{e.name}" for c, e in unfed if (e.variable.type == "Clock") == tick] for tick in (False, True)
    )
    feedthrough = _feedthrough(ports, links, drives)
    torn = torn_links(ports, feedthrough, links) if tears else ()
    order = levels_of(ports, feedthrough, [k for k in links if k not in torn], needs_levels=needs_levels)
    return ResolvedSystem(
        system.components, ports, links, drives, starts, order, feedthrough, tuple(kept), tuple(unticked), torn
    )


def split(path: str, ports: Mapping[str, Ports]) -> tuple[Ports, str]:
    """Component and variable name of `component.variable`.

    Raises
    ------
    SetupError
        The path has no dot, or no component has this name.
    """
    component, dot, name = path.partition(".")
    if not dot:
        having = [name for name, port in ports.items() if port.has(path)]
        hint = f", as {' or '.join(f'{name}.{path}' for name in having)}" if having else ""
        raise SetupError(f"'{path}' must be written as component.variable{hint}")
    if component not in ports:
        raise SetupError(f"'{path}': there is no component '{component}'; {nearest(component, ports)}")
    return ports[component], name


#: What else a connection can begin at: values that an FMU computes, though they are no outputs.
_COMPUTED = ("local", "calculatedParameter")


def _find(path: str, ports: Mapping[str, Ports], causality: str, role: str) -> tuple[str, list[Element]]:
    port, name = split(path, ports)
    elements = list(port.find(name))
    for element in elements:
        actual = element.variable.causality
        allowed = element.is_tunable if causality == "input" else actual in _COMPUTED
        if actual != causality and not allowed:
            article = "an" if actual[0] in "aeiou" else "a"
            raise SetupError(f"'{path}' is {article} {actual} and can't be the {role}, which must be an {causality}")
        if not element.is_exchanged:
            raise SetupError(
                f"'{path}' is of type {element.variable.type}, whose values can be exchanged in event mode only, which "
                "its FMU lacks (hasEventMode)"
            )
        if causality == "input" and is_time_based(element.variable):
            raise SetupError(
                f"'{path}' is a clock that ticks at times of its FMU ({element.variable.intervalVariability}); only "
                "triggered clocks can be fed"
            )
    if causality == "input":
        elements = [port.original(element) for element in elements]
    return port.component, elements


def _links(connection: Connection, ports: Mapping[str, Ports]) -> list[Link]:
    here = f"connection '{connection.source}' -> '{connection.target}'"
    source_component, sources = _find(connection.source, ports, "output", "source of a connection")
    target_component, targets = _find(connection.target, ports, "input", "target of a connection")
    if len(sources) != len(targets):
        raise SetupError(f"{here}: {len(sources)} values can't feed {len(targets)}; connect elements one by one")
    given, taken = _shape(sources), _shape(targets)
    if len(given) > 1 and len(taken) > 1 and given != taken:
        raise SetupError(
            f"{here}: an array of {_said(given)} can't feed one of {_said(taken)}; connect elements one by one"
        )
    links = []
    for source, target in zip(sources, targets, strict=True):
        if source.kind != target.kind and (source.kind, target.kind) not in CONVERSIONS:
            raise SetupError(f"{here}: {source.kind} and {target.kind} don't match; connect values of one type")
        factor, offset = _transformation(
            here, connection, ports[source_component], source, ports[target_component], target
        )
        links.append(Link(source_component, source, target_component, target, factor, offset, connection.extrapolation))
    return links


def _check_clocks(links: Iterable[Link], system: System) -> None:
    """Both ends of a connection between clocks take part in the same communication points; else ticks would be lost."""
    for link in links:
        source, target = (system.components[c] for c in (link.source_component, link.target_component))
        if link.target.kind == "clock" and source.every != target.every:
            raise SetupError(
                f"clock '{source.name}.{link.source.name}' can't feed '{target.name}.{link.target.name}': the "
                f"components communicate every {source.every} and every {target.every} steps; give both one `every`"
            )


def _transformation(
    here: str, connection: Connection, source_port: Ports, source: Element, target_port: Ports, target: Element
) -> tuple[float, float]:
    """Factor and offset of a connection, the conversion of units included."""
    if connection.units not in get_args(Units):
        raise SetupError(f"{here}: units = {connection.units!r}; {nearest(str(connection.units), get_args(Units))}")
    for name, value in (("factor", connection.factor), ("offset", connection.offset)):
        if not math.isfinite(value):
            raise SetupError(f"{here}: {name} {value} is not a finite number")
    if target.kind != "real" and (connection.factor, connection.offset) != (1.0, 0.0):
        raise SetupError(
            f"{here}: {target.kind} values can't be transformed; only real ones take a factor and an offset"
        )
    a, b = source_port.unit(source), target_port.unit(target)
    if connection.units == "ignore" or a is None or b is None:
        return connection.factor, connection.offset
    try:
        factor, offset = conversion(a, b, relative=target_port.is_relative(target))
    except UnitsDiffer:
        raise SetupError(
            f"{here}: units '{a.name}' and '{b.name}' don't match; give both ends one unit, "
            "or connect with units='ignore' and a factor and offset of your own"
        ) from None
    if connection.units == "equal" and (factor, offset) != (1.0, 0.0):
        raise SetupError(
            f"{here}: units '{a.name}' and '{b.name}' don't match; convert one of them in its FMU, "
            "or connect with units='convert'"
        )
    return connection.factor * factor, connection.factor * offset + connection.offset


def _drive(signal: Signal, ports: Mapping[str, Ports], system: System) -> Drive:
    component, targets = _find(signal.target, ports, "input", "target of a signal")
    if signal.added and targets[0].kind != "real":
        raise SetupError(f"'{signal.target}' is {targets[0].kind}; signals can be added to real inputs only")
    every = system.components[component].every
    function = signal.function_for(len(targets))
    return Drive(component, tuple(targets), function, signal.breakpoints, signal.vectorized, every, signal.added)


def _shape(elements: Sequence[Element]) -> tuple[int, ...]:
    """The sizes of an array of which these are the elements, without those that are 1; one size where none is known."""
    last = elements[-1].name
    shape = tuple(n for n in indices(last) if n > 1) if last.endswith("]") else ()
    return shape if math.prod(shape) == len(elements) else (len(elements),)


def _said(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))


def resolve_start_value(port: Ports, name: str, value: Any, what: str = "start value") -> StartValue:
    """Start values of the elements of one name; `what` is their name in messages.

    One value serves for all elements of a vector. Booleans and enumerations take their words as well, as "true" and the
    name of an item; so a text that a user has typed needs no type. Typed lists are written `1,2` or `[1, 2]`, matrices
    row by row. Binary values are bytes, or digits of base 16 where a user has typed them.

    Raises
    ------
    SetupError
        There is no such variable, it can't be set, or the value does not fit it.
    """
    found = port.find(name)
    here = f"{what} of '{port.component}.{name}'"
    is_large = isinstance(found, ElementArray) and len(found) > LARGE and found[0].kind == "real"
    if is_large and isinstance(found, ElementArray) and is_alias(found[0].variable):
        found = port.elements_of(found[0].variable.alias.name)
    elements = [found[0]] if is_large else [port.original(element) for element in found]
    for element in elements:
        variable = element.variable
        settable = variable.causality == "input" or variable.initial in ("exact", "approx")
        if has_settable_interval(variable) and element.is_exchanged:
            return StartValue(port.component, (element,), (_interval(here, value),))
        if variable.type == "Clock":
            raise SetupError(f"{here}: clocks have none; have a signal or a connection feed a triggered one")
        if not settable or variable.variability == "constant":
            raise SetupError(f"{here}: {variable.causality} variables can't be set; set parameters and inputs only")
    if isinstance(found, ElementArray) and is_large:
        return StartValue(port.component, found, _large_start(here, found, value))
    values = _flat(_typed_list(value) if len(elements) > 1 and not elements[0].type.is_text else value)
    if values is None:
        raise SetupError(f"{here}: {value!r} is not a number or a list of numbers")
    if len(values) == 1:
        values *= len(elements)
    if len(values) != len(elements):
        raise SetupError(f"{here}: {len(values)} values were given for {len(elements)}")
    given, taken = tuple(n for n in np.shape(value) if n > 1), _shape(elements)
    if len(given) > 1 and given != taken:
        raise SetupError(f"{here}: an array of {_said(given)} was given for one of {_said(taken)}")
    own = tuple(_start_value(here, e, v, value) for e, v in zip(elements, values, strict=True))
    return StartValue(port.component, tuple(elements), own)


def _large_start(here: str, elements: ElementArray, value: Any) -> array[float]:
    """Start values of a large array of real numbers."""
    problem = SetupError(f"{here}: a value of it is not a number, or its rows differ in size")
    try:
        given = np.asarray(_typed_list(value))
    except ValueError:  # rows
        raise problem from None
    if given.dtype.kind not in "iufU" or (given.dtype.kind == "U" and not isinstance(value, AsWritten)):
        raise problem
    try:
        values = given.astype(np.float64).ravel()
    except ValueError:  # a text that is no number
        raise problem from None
    if values.size not in (1, len(elements)):
        raise SetupError(f"{here}: {values.size} values were given for {len(elements)}")
    for k in (int(values.argmin()), int(values.argmax())):  # NaN is both
        _start_value(here, elements[k if values.size > 1 else 0], float(values[k]), value)
    return array("d", np.broadcast_to(values, len(elements)).tobytes())


def _interval(here: str, value: Any) -> float:
    """The interval (s) of a clock."""
    try:
        interval = float(value)
    except (TypeError, ValueError, OverflowError):
        interval = math.nan
    if not (math.isfinite(interval) and interval > 0.0):
        raise SetupError(f"{here}: {value!r} is not an interval of a clock; give a positive number of seconds")
    return interval


def _typed_list(value: Any) -> Any:
    """The parts of a list that a user has typed; anything else as it is."""
    if not isinstance(value, AsWritten):
        return value
    return [AsWritten(part.strip("[] ")) for part in value.split(",")]


def _flat(value: Any) -> list[Any] | None:
    """The scalars of a value, in the order of its elements; None where its rows differ in size."""
    if isinstance(value, (list, tuple)):
        rows = [_flat(row) for row in value]
        if any(row is None for row in rows) or len({len(row) for row in rows if row is not None}) > 1:
            return None
        return [scalar for row in rows if row is not None for scalar in row]
    if hasattr(value, "__array__") or isinstance(value, range):
        scalars: list[Any] = np.asarray(value).ravel().tolist()
        return scalars
    return [value]


def _start_value(here: str, element: Element, value: Any, given: Any) -> Any:
    """A start value of one element, in Python's own type; `given` is what it is part of."""
    if isinstance(value, str) and not element.type.is_text:
        value = _read(here, element, value)
    is_number = isinstance(value, (int, float)) and not (isinstance(value, bool) and element.kind == "real")
    if element.kind in ("real", "integer") and not is_number:
        raise SetupError(f"{here}: {given!r} is not a number or a list of numbers")
    if isinstance(value, float) and not math.isfinite(value):
        raise SetupError(f"{here}: {value} is not a finite number")
    try:
        if isinstance(value, AsWritten):
            value = bytes.fromhex(value) if element.kind == "binary" else str(value)
        known = element.value(value)
    except OverflowError:
        raise SetupError(f"{here}: {given!r} is not a number or a list of numbers") from None
    except (ArgumentError, ValueError) as error:  # of the type, or of digits of base 16
        raise SetupError(f"{here}: {error}") from None
    _check_bounds(here, element, known)
    return known


def _read(here: str, element: Element, text: str) -> int | float | str:
    """The number that a person wrote, or a word of the type of an element."""
    if text in element.words:
        return str(text)
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    if element.kind in ("real", "integer") and not isinstance(text, AsWritten):
        raise SetupError(f"{here}: {text!r} is not a number or a list of numbers")
    hint = f"; {nearest(text, element.words)}" if element.words else ""
    raise SetupError(f"{here}: {str(text)!r} is not a value of type {element.variable.type}{hint}")


def _check_bounds(here: str, element: Element, value: Any) -> None:
    variable = element.variable
    if element.kind not in ("real", "integer"):
        return
    number = int if element.kind == "integer" else float
    lower = -math.inf if variable.min is None else number(variable.min)
    upper = math.inf if variable.max is None else number(variable.max)
    if not lower <= value <= upper:
        bounds = f"at least {lower!r}" if upper == math.inf else f"between {lower!r} and {upper!r}"
        raise SetupError(f"{here}: {value!r} is out of bounds; it must be {bounds}")


def _check_feeding(
    ports: Mapping[str, Ports],
    links: Iterable[Link],
    drives: Iterable[Drive],
    starts: Iterable[StartValue],
    strict: Set[str],
) -> list[tuple[str, Element]]:
    """No input has more than one connection or signal; returns those that have none, nor a start value.

    Those of the `strict` components must have one: functions have no start values of their own.
    """
    fed: dict[Node, str] = {}
    feeders = [
        *((k.target_component, k.target.name, f"'{k.source_component}.{k.source.name}'") for k in links),
        *((d.component, e.name, "a signal") for d in drives for e in d.targets if not d.added),
    ]
    for component, name, by in feeders:
        if (component, name) in fed:
            first = fed[component, name]
            raise SetupError(f"input '{component}.{name}' is fed twice, by {first} and by {by}; remove one of them")
        fed[component, name] = by
    _check_added(drives, {(k.target_component, k.target.name) for k in links})
    held = {node for s in starts for node in s.nodes}
    touched = {(s.component, e.variable.name) for s in starts if not s.is_large for e in s.elements[:1]}
    touched |= {(k.target_component, k.target.variable.name) for k in links}
    touched |= {(d.component, e.variable.name) for d in drives for e in d.targets}
    kept = [
        (component, e)
        for component, port in ports.items()
        for name in port.names_of("input")
        for e in _whole_or_elements(port.elements_of(name), component, touched)
        if (component, e.name) not in fed
        and not {(component, e.name), (component, e.variable.name)} & held
        and not (is_time_based(e.variable) or is_alias(e.variable))
    ]
    if missing := [f"'{component}.{e.name}'" for component, e in kept if component in strict]:
        raise SetupError(
            f"nothing feeds input {', '.join(missing)}; connect it, drive it with a signal, or hold it at a start value"
        )
    return kept


def _whole_or_elements(elements: ElementArray, component: str, touched: Set[Node]) -> Sequence[Element]:
    """The elements of an input; one for all of a large array of which none is fed, or started by itself."""
    if len(elements) > LARGE and (component, elements[0].variable.name) not in touched:
        return [elements.whole]
    return elements


def _check_added(drives: Iterable[Drive], connected: Set[Node]) -> None:
    """What is added to an input finds a connection there, and nothing else that is added."""
    added: set[Node] = set()
    for drive in drives:
        for element in drive.targets if drive.added else ():
            path = f"{drive.component}.{element.name}"
            if (drive.component, element.name) not in connected:
                raise SetupError(f"no connection feeds '{path}', so nothing can be added; use System.drive")
            if (drive.component, element.name) in added:
                raise SetupError(f"two signals are added to input '{path}'; add their sum")
            added.add((drive.component, element.name))


def _feedthrough(
    ports: Mapping[str, Ports], links: Iterable[Link], drives: Iterable[Drive]
) -> dict[str, dict[str, Set[str]]]:
    """For each output of each component what it depends on directly, a parameter that something feeds included.

    FMUs say nothing of their local variables: where something is connected to one, it may depend on all inputs.
    """
    fed = [(k.target_component, k.target.variable) for k in links]
    fed += [(d.component, e.variable) for d in drives for e in d.targets]
    parameters: dict[str, set[str]] = {name: set() for name in ports}
    for component, variable in fed:
        if variable.causality == "parameter":
            parameters[component].add(variable.name)
    found: dict[str, dict[str, Set[str]]] = {
        name: {output: names | parameters[name] for output, names in port.feedthrough.items()}
        for name, port in ports.items()
    }
    for link in links:
        component, variable = link.source_component, link.source.variable
        if variable.name not in found[component]:
            changes = variable.causality == "local" and variable.variability not in ("constant", "fixed")
            inputs = set(ports[component].names_of("input"))
            found[component][variable.name] = inputs | parameters[component] if changes else set()
    return found


def torn_links(
    ports: Mapping[str, Ports], feedthrough: Mapping[str, Mapping[str, Set[str]]], links: Iterable[Link]
) -> tuple[Link, ...]:
    """Links without which there is no algebraic loop: of each loop the connection of the fewest real values."""
    rest, torn = list(links), []
    while True:
        feeds, inputs = _feeding(ports, feedthrough, rest)
        try:
            levels(feeds, inputs)
        except AlgebraicLoop as loop:
            candidates = []
            for source, target in pairwise(loop.path):
                between = [
                    k
                    for k in rest
                    if (k.source_component, k.source.variable.name) == source
                    and (k.target_component, k.target.variable.name) == target
                ]
                if between and all(k.source.kind == "real" and k.target.kind == "real" for k in between):
                    candidates.append(between)
            if not candidates:
                raise SetupError(
                    f"algebraic loop {loop}: only connections between real values can be iterated; break it by "
                    "order='parallel' (as an option: --order parallel)"
                ) from None
            chosen = min(candidates, key=len)
            torn += chosen
            rest = [k for k in rest if k not in chosen]
        else:
            return tuple(torn)


def levels_of(
    ports: Mapping[str, Ports],
    feedthrough: Mapping[str, Mapping[str, Set[str]]],
    links: Iterable[Link],
    *,
    needs_levels: bool,
) -> dict[Node, int] | None:
    """Levels of outputs and inputs, see `cosim.system.levels`; None where there is an algebraic loop.

    Raises
    ------
    SetupError
        There is one, and levels are needed.
    """
    feeds, inputs = _feeding(ports, feedthrough, links)
    try:
        return levels(feeds, inputs)
    except AlgebraicLoop as loop:
        if needs_levels:
            raise SetupError(
                f"algebraic loop {loop}: every output in it depends at once on the input before it; "
                "use iterations='auto' (as an option: --iterations auto), which solves it; order='parallel' (as an "
                "option: --order parallel), which breaks the loop by a delay of one step; or FMUs that declare which "
                "inputs their outputs depend on, or functions with direct_feedthrough=False"
            ) from None
        return None


def _feeding(
    ports: Mapping[str, Ports], feedthrough: Mapping[str, Mapping[str, Set[str]]], links: Iterable[Link]
) -> tuple[dict[Node, set[Node]], set[Node]]:
    """For each input and output what feeds it, and which nodes are inputs; see `cosim.system.levels`."""
    feeds: dict[Node, set[Node]] = {}
    inputs: set[Node] = set()
    for component, port in ports.items():
        for output, depends_on in feedthrough[component].items():
            feeds[component, output] = {(component, name) for name in depends_on}
            inputs.update(feeds[component, output])
        inputs.update((component, name) for name in port.names_of("input"))
        for name in port.names_of("input"):  # it is set while its clock is active
            if any(element.is_clocked for element in port.elements_of(name)[:1]):
                clocks = {(component, clock) for clock in port.clocked[name]}
                feeds.setdefault((component, name), set()).update(clocks & inputs)
    for node in inputs:
        feeds.setdefault(node, set())
    for link in links:
        target = (link.target_component, link.target.variable.name)
        feeds.setdefault(target, set()).add((link.source_component, link.source.variable.name))
        inputs.add(target)
    return feeds, inputs
