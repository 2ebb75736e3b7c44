"""Check a system against the model descriptions of its FMUs, before anything runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from cosim.errors import SetupError, nearest
from cosim.system.levels import AlgebraicLoop, Node, levels
from cosim.system.system import AsWritten, Component, Connection, Signal, SignalFunction, System, Units
from cosim.system.units import UnitsDiffer, conversion
from cosim.system.variables import KINDS, Element, Ports, fits


@dataclass(frozen=True)
class Link:
    """A connection between two scalar values: target = factor * source + offset."""

    source_component: str
    source: Element
    target_component: str
    target: Element
    factor: float
    offset: float


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
    """Start values of the elements of one name."""

    component: str
    elements: tuple[Element, ...]
    values: tuple[Any, ...]


@dataclass(frozen=True)
class ResolvedSystem:
    """A system whose names stand for elements of FMUs and which has passed all checks.

    `levels` is None where an algebraic loop forbids an order; only the parallel order can run such a system.
    """

    components: Mapping[str, Component]
    ports: Mapping[str, Ports]
    links: tuple[Link, ...]
    drives: tuple[Drive, ...]
    starts: tuple[StartValue, ...]
    levels: Mapping[Node, int] | None


def resolve(system: System, ports: Mapping[str, Ports], *, needs_levels: bool) -> ResolvedSystem:
    """Resolve and check all names of a system.

    Parameters
    ----------
    system : System
    ports : mapping
        Component -> its variables.
    needs_levels : bool
        The order of exchange can't run a system with an algebraic loop.

    Raises
    ------
    SetupError
        Wrong names, causalities, types, sizes or units; an input that is fed twice or not at all; an algebraic loop
        where the order of exchange can't run it.
    """
    links = tuple(link for c in system.connections for link in _links(c, ports))
    drives = tuple(_drive(s, ports, system) for s in system.signals)
    starts = tuple(
        resolve_start_value(ports[c.name], name, value)
        for c in system.components.values()
        for name, value in c.start.items()
    )
    _check_feeding(ports, links, drives, starts)
    return ResolvedSystem(system.components, ports, links, drives, starts, _levels(ports, links, needs_levels))


def split(path: str, ports: Mapping[str, Ports]) -> tuple[Ports, str]:
    """Component and variable name of `component.variable`.

    Raises
    ------
    SetupError
        The path has no dot, or no component has this name.
    """
    component, dot, name = path.partition(".")
    if not dot:
        raise SetupError(f"'{path}' must be written as component.variable")
    if component not in ports:
        raise SetupError(f"'{path}': there is no component '{component}'; {nearest(component, ports)}")
    return ports[component], name


def _find(path: str, ports: Mapping[str, Ports], causality: str, role: str) -> tuple[str, list[Element]]:
    port, name = split(path, ports)
    elements = port.find(name)
    for element in elements:
        actual = element.variable.causality
        if actual != causality:
            article = "an" if actual[0] in "aeiou" else "a"
            raise SetupError(f"'{path}' is {article} {actual} and can't be the {role}, which must be an {causality}")
        if element.kind not in KINDS.values():
            raise SetupError(f"'{path}' is of type {element.kind}, whose values can't be exchanged")
    return port.component, elements


def _links(connection: Connection, ports: Mapping[str, Ports]) -> list[Link]:
    here = f"connection '{connection.source}' -> '{connection.target}'"
    source_component, sources = _find(connection.source, ports, "output", "source of a connection")
    target_component, targets = _find(connection.target, ports, "input", "target of a connection")
    if len(sources) != len(targets):
        raise SetupError(f"{here}: {len(sources)} values can't feed {len(targets)}; connect elements one by one")
    links = []
    for source, target in zip(sources, targets, strict=True):
        if source.kind != target.kind:
            raise SetupError(f"{here}: {source.kind} and {target.kind} don't match; connect values of one type")
        factor, offset = _transformation(
            here, connection, ports[source_component], source, ports[target_component], target
        )
        links.append(Link(source_component, source, target_component, target, factor, offset))
    return links


def _transformation(
    here: str, connection: Connection, source_port: Ports, source: Element, target_port: Ports, target: Element
) -> tuple[float, float]:
    """Factor and offset of a connection, the conversion of units included."""
    if connection.units not in get_args(Units):
        raise SetupError(f"{here}: units = {connection.units!r}; {nearest(str(connection.units), get_args(Units))}")
    for name, value in (("factor", connection.factor), ("offset", connection.offset)):
        if not math.isfinite(value):
            raise SetupError(f"{here}: {name} {value} is not a finite number")
    if source.kind != "real" and (connection.factor, connection.offset) != (1.0, 0.0):
        raise SetupError(
            f"{here}: {source.kind} values can't be transformed; only real ones take a factor and an offset"
        )
    a, b = source_port.unit(source), target_port.unit(target)
    if connection.units == "ignore" or a is None or b is None:
        return connection.factor, connection.offset
    try:
        factor, offset = conversion(a, b, relative=target_port.is_relative(target))
    except UnitsDiffer as error:
        raise SetupError(f"{here}: {error}") from None
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


def resolve_start_value(port: Ports, name: str, value: Any) -> StartValue:
    """Start values of the elements of one name.

    Booleans and enumerations take their words as well, as "true" and the name of an item; so a text that a user has
    typed needs no type.

    Raises
    ------
    SetupError
        There is no such variable, it can't be set, or the value does not fit it.
    """
    elements = port.find(name)
    here = f"start value of '{port.component}.{name}'"
    for element in elements:
        variable = element.variable
        settable = variable.causality == "input" or variable.initial in ("exact", "approx")
        if not settable or variable.variability == "constant":
            raise SetupError(f"{here}: {variable.causality} variables can't be set; set parameters and inputs only")
    if elements[0].kind == "String":
        if not isinstance(value, str):
            raise SetupError(f"{here}: {value!r} is not a text")
        return StartValue(port.component, tuple(elements), (str(value),) * len(elements))
    value = _as_number(here, elements[0], value)
    try:
        array = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    except (TypeError, ValueError, OverflowError):
        raise SetupError(f"{here}: {value!r} is not a number or a list of numbers") from None
    if elements[0].kind == "real" and np.asarray(value).dtype == bool:
        raise SetupError(f"{here}: {value!r} is not a number or a list of numbers")
    if array.size == 1:
        array = np.full(len(elements), array[0])
    if array.size != len(elements):
        raise SetupError(f"{here}: {array.size} values were given for {len(elements)}")
    for element, number in zip(elements, array, strict=True):
        _check_number(here, element, float(number))
    return StartValue(port.component, tuple(elements), tuple(map(float, array)))


def _as_number(here: str, element: Element, value: Any) -> Any:
    """The number that a word stands for, or a text that a person wrote; other values as they are."""
    if isinstance(value, (list, tuple)):
        return [_as_number(here, element, v) for v in value]
    words = {"false": 0.0, "true": 1.0} if element.kind == "boolean" else element.items
    if not isinstance(value, str) or not (words or isinstance(value, AsWritten)):
        return value
    if value in words:
        return words[value]
    try:
        return float(value)
    except ValueError:
        hint = f"; {nearest(value, words)}" if words else ""
        raise SetupError(f"{here}: {str(value)!r} is no value of type {element.variable.type}{hint}") from None


def _check_number(here: str, element: Element, number: float) -> None:
    if not math.isfinite(number):
        raise SetupError(f"{here}: {number} is not a finite number")
    if not fits(element, number):
        raise SetupError(f"{here}: {number!r} is not a value of type {element.variable.type}")
    variable = element.variable
    lower = -math.inf if variable.min is None else float(variable.min)
    upper = math.inf if variable.max is None else float(variable.max)
    if not lower <= number <= upper:
        bounds = f"at least {lower!r}" if upper == math.inf else f"between {lower!r} and {upper!r}"
        raise SetupError(f"{here}: {number!r} is out of bounds; it must be {bounds}")


def _check_feeding(
    ports: Mapping[str, Ports],
    links: Iterable[Link],
    drives: Iterable[Drive],
    starts: Iterable[StartValue],
) -> None:
    """Every input has exactly one connection or signal, or else a start value."""
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
    held = {(s.component, e.name) for s in starts for e in s.elements}
    for component, port in ports.items():
        missing = [
            e.name
            for e in port.of_causality("input")
            if (component, e.name) not in fed and (component, e.name) not in held
        ]
        if missing:
            names = ", ".join(f"'{component}.{n}'" for n in missing)
            raise SetupError(
                f"nothing feeds input {names}; connect it, drive it with a signal, or hold it at a start value"
            )


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


def _levels(ports: Mapping[str, Ports], links: Iterable[Link], needs_levels: bool) -> dict[Node, int] | None:
    feeds: dict[Node, set[Node]] = {}
    inputs: set[Node] = set()
    for component, port in ports.items():
        for output, depends_on in port.feedthrough.items():
            feeds[component, output] = {(component, name) for name in depends_on}
        for element in port.of_causality("input"):
            inputs.add((component, element.variable.name))
            feeds.setdefault((component, element.variable.name), set())
    for link in links:
        target = (link.target_component, link.target.variable.name)
        feeds[target].add((link.source_component, link.source.variable.name))
    try:
        return levels(feeds, inputs)
    except AlgebraicLoop as loop:
        if needs_levels:
            raise SetupError(
                f"algebraic loop {loop}: every output in it depends at once on the input before it; "
                "use order='parallel' (as an option: --order parallel), which breaks the loop by a delay of one step, "
                "or FMUs that declare which inputs their outputs depend on, or functions with direct_feedthrough=False"
            ) from None
        return None
