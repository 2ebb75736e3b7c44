"""The choice of inputs that are extrapolated between communication points; the others are held.

A held input is late by half a step on average, which makes the coupling first-order accurate. An FMU that can
interpolate its inputs takes their derivatives with them (`fmi2SetRealInputDerivatives`), or asks for its inputs during
a step (FMI 3.0, intermediate update). The derivatives of a connection come from its last values, see
`cosim.master.coupling.algorithm`, and, for some extrapolations, from their rates, which the FMU gives whose outputs
they are.
Those of a signal, which is known beforehand, come from its values on both sides of the step. After a jump nothing is
known of a connection's derivatives, and they are found anew.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from cosim.errors import SetupError
from cosim.master.coupling.algorithm import (
    AUTO,
    EXTRAPOLATIONS,
    MOST_DEGREE,
    Algorithm,
    Extrapolation,
    can_be_extrapolated,
    extrapolation_named,
)
from cosim.system.resolution import Link, ResolvedSystem
from cosim.system.variables import Element

#: An element, by component and name.
Key = tuple[str, str]


@dataclass(frozen=True)
class ExtrapolatedInputs:
    """Links whose inputs are extrapolated.

    Attributes
    ----------
    algorithm : Algorithm
    elements : mapping
        Component -> all elements of the variables of which at least one element is extrapolated.
    moving : mapping
        (component, element) -> how it is extrapolated, of those that are.
    by_variable : mapping
        (component, variable) -> how those of its elements are extrapolated that are.
    held : tuple of str
        Names `component.variable` of fed inputs that are not.
    exact : tuple of str
        Names of inputs that are neither: both ends of their connection are in model exchange.
    rated_inputs, rated_outputs : tuple of (component, element)
        Elements whose derivatives by time are exchanged.
    assumed : tuple of str
        Components that get derivatives of their inputs of an order of which it isn't known whether they take it.
    """

    algorithm: Algorithm
    elements: Mapping[str, tuple[Element, ...]]
    moving: Mapping[Key, Extrapolation]
    by_variable: Mapping[Key, Extrapolation]
    held: tuple[str, ...]
    exact: tuple[str, ...] = ()
    rated_inputs: tuple[tuple[str, Element], ...] = ()
    rated_outputs: tuple[tuple[str, Element], ...] = ()
    assumed: tuple[str, ...] = ()

    def summary(self) -> dict[str, object]:
        """For people: what was asked for, and the names of what is extrapolated, and how, and of what is held."""
        extrapolation = self.algorithm.extrapolation
        asked_for = extrapolation.name if self.algorithm.demanded else "linear"
        names: dict[str, list[str]] = {}
        if extrapolation.degree and (self.algorithm.demanded or not self.moving):
            names[asked_for] = []
        for key in sorted(self.moving):
            names.setdefault(self.moving[key].name, []).append(".".join(key))
        if self.exact:
            names["model_exchange"] = list(self.exact)
        mode = extrapolation.name if self.algorithm.demanded else AUTO
        assumed = {"order_assumed": list(self.assumed)} if self.assumed else {}
        return {"mode": mode, **names, "hold": list(self.held), **assumed}


def extrapolated_inputs(
    system: ResolvedSystem,
    algorithm: Algorithm,
    refusing: Collection[str] = (),
    orders: Mapping[str, int] | None = None,
    outside: Collection[Key] = (),
) -> ExtrapolatedInputs:
    """Decide for every fed input.

    What a component is fed by signals is followed by lines unless an extrapolation is demanded, or its connections are
    followed by polynomials of higher degree.

    Parameters
    ----------
    system : ResolvedSystem
    algorithm : Algorithm
    refusing : collection of str
        Components whose FMUs were found to refuse derivatives of their inputs, whatever their descriptions say.
    orders : mapping, optional
        Component -> up to which order its FMU is known to take derivatives of its inputs, of FMI 1.0 and 2.0; where an
        extrapolation is not demanded, others are extrapolated linearly.
    outside : collection of Key
        Inputs that stand open, and will be set from outside: those that can only be held are held, and what depends on
        them directly goes straight where its derivative would be needed, also if an extrapolation is demanded.

    Raises
    ------
    SetupError
        The extrapolation is demanded where an input can only be held; the message says which and why.
    """
    moving: dict[Key, Extrapolation] = {}
    held: list[str] = []
    curved: set[str] = set()
    chosen: list[tuple[Key, Key]] = []  # elements and their variables whose extrapolation may be another one
    added = {(d.component, e.name) for d in system.drives if d.added for e in d.targets}
    rated = _Rated(system)
    for component, element, every, link in _fed(system):
        name, key = f"{component}.{element.name}", (component, element.name)
        extrapolation, demanded = _wanted(algorithm, link)
        obstacle = "a sampled signal is added to it" if key in added else _obstacle(system, component, element, every)
        if component in refusing:
            obstacle = "its FMU refuses derivatives of inputs"
        is_held = (obstacle or _jumps(system, link)) and not demanded
        if extrapolation.degree == 0 or is_held or (obstacle and key in outside):
            held.append(name)
            continue
        if not demanded and extrapolation.degree > _order_of(system, component, orders or {}):
            extrapolation = EXTRAPOLATIONS["linear"]
        if link is None and not demanded and component not in curved:  # connections come first
            extrapolation = min(extrapolation, EXTRAPOLATIONS["linear"], key=lambda e: e.degree)
        if obstacle:
            raise SetupError(
                f"extrapolation '{extrapolation.name}': input '{name}' can only be held, because {obstacle}; use "
                f"'{AUTO}'"
            )
        unknown = rated.obstacle(link) if extrapolation.uses_rates and link is not None else None
        if unknown and (outside or not demanded):
            extrapolation = EXTRAPOLATIONS["linear"]
        elif unknown:
            raise SetupError(
                f"extrapolation '{extrapolation.name}': the derivative of '{name}' is not known, because {unknown}; "
                "use 'cubic' or one of lower degree"
            )
        moving[key] = extrapolation
        if extrapolation.degree > 1:
            curved.add(component)
        if outside or not demanded:
            chosen.append((key, (component, element.variable.name)))
    _agree(moving, chosen)
    by_variable: dict[Key, Extrapolation] = {}
    for component, element, *_ in _fed(system):
        if (component, element.name) in moving:
            extrapolation = moving[component, element.name]
            other = by_variable.setdefault((component, element.variable.name), extrapolation)
            if other is not extrapolation:
                raise SetupError(
                    f"input '{component}.{element.variable.name}': its elements are set together and can't be "
                    f"extrapolated by '{other.name}' and '{extrapolation.name}'; use one of them"
                )
    elements = {
        component: tuple(
            e for name in port.variables if (component, name) in by_variable for e in port.elements_of(name)
        )
        for component, port in system.ports.items()
    }
    by_rates = [k for k in system.links if _uses_rates(moving, k)]
    inputs, outputs = rated.needed(by_rates)
    exact = sorted(f"{k.target_component}.{k.target.name}" for k in system.links if system.couples_equations(k))
    return ExtrapolatedInputs(
        algorithm,
        {c: e for c, e in elements.items() if e},
        moving,
        by_variable,
        tuple(sorted(held)),
        tuple(exact),
        inputs,
        outputs,
        tuple(sorted({c for (c, _), each in moving.items() if each.degree > _order_of(system, c, orders or {})})),
    )


def _agree(moving: dict[Key, Extrapolation], chosen: Iterable[tuple[Key, Key]]) -> None:
    """Let elements go straight whose variable has others that don't follow the same polynomial: they are set as one."""
    by_variable: dict[Key, set[str]] = {}
    for key, variable in chosen:
        by_variable.setdefault(variable, set()).add(moving[key].name)
    for key, variable in chosen:
        if len(by_variable[variable]) > 1:
            moving[key] = EXTRAPOLATIONS["linear"]


def _wanted(algorithm: Algorithm, link: Link | None) -> tuple[Extrapolation, bool]:
    """The extrapolation of a connection or a signal, and whether it is demanded."""
    if link is None or link.extrapolation is None:
        return algorithm.extrapolation, algorithm.demanded
    return extrapolation_named(link.extrapolation, algorithm.order)


def _order_of(system: ResolvedSystem, component: str, orders: Mapping[str, int]) -> int:
    """Up to which order a component is known to take derivatives of its inputs; who asks for inputs takes any."""
    port = system.ports[component]
    if port.is_model_exchange or port.description.fmiMajorVersion == 3:
        return MOST_DEGREE
    return max(1, orders.get(component, 0))


def _uses_rates(moving: Mapping[Key, Extrapolation], link: Link) -> bool:
    extrapolation = moving.get((link.target_component, link.target.name))
    return extrapolation is not None and extrapolation.uses_rates


def _jumps(system: ResolvedSystem, link: Link | None) -> bool:
    """Whether a link carries an FMU's output that keeps its value from event to event, which a slope would miss."""
    return (
        link is not None
        and system.components[link.source_component].function is None
        and link.source.variable.variability == "discrete"
    )


def _source(link: Link) -> Key:
    return link.source_component, link.source.name


class _Rated:
    """Outputs whose derivatives by time are known: the FMU gives them, and what is fed through has such ones, too."""

    def __init__(self, system: ResolvedSystem) -> None:
        self._system = system
        self._link_to = {(k.target_component, k.target.name): k for k in system.links}
        self._driven = {(d.component, e.name) for d in system.drives for e in d.targets}
        # by output: links to what it depends on directly that have not been looked at, and what has been found
        self._feeding: dict[Key, list[Link]] = {}
        self._found: dict[Key, str | None] = {}

    def obstacle(self, link: Link) -> str | None:
        """Why the derivative of what a link carries is not known."""
        path = [link]  # each depends directly on the next one; chains may be longer than Python's calls are deep
        while path:
            key = _source(path[-1])
            if key not in self._feeding:
                own = self._own_obstacle(path[-1])
                through = [] if own else [self._link_to[key[0], e.name] for e in self._through(path[-1])]
                self._feeding[key] = through
                self._found[key] = f"'{'.'.join(key)}' is a part of an algebraic loop" if through else own
            feeding = self._feeding[key]
            if not feeding:
                path.pop()
                continue
            before = _source(feeding[-1])
            if before not in self._feeding:
                path.append(feeding[-1])
                continue
            feeding.pop()
            if self._found[before] is not None:
                self._found[key] = self._found[before]
                feeding.clear()
            elif not feeding:
                self._found[key] = None
        return self._found[_source(link)]

    def _own_obstacle(self, link: Link) -> str | None:
        """The same, as far as it is not what feeds the component."""
        name, source = link.source_component, link.source
        port = self._system.ports[name]
        if self._system.components[name].function is not None:
            return f"component '{name}' is a function"
        if port.is_model_exchange:
            return f"component '{name}' is in model exchange"
        kind = port.description.coSimulation
        if port.description.fmiMajorVersion < 2 or (kind.maxOutputDerivativeOrder or 0) < 1:
            return f"the FMU of component '{name}' gives no derivatives of outputs (maxOutputDerivativeOrder)"
        if source.variable.shape or source.variable.type not in ("Real", "Float64"):
            return f"'{name}.{source.name}' is not a real scalar"
        through = self._through(link)
        if not through:
            return None
        if self._system.levels is None:
            return f"'{name}.{source.name}' is a part of an algebraic loop"
        if not (getattr(kind, "providesDirectionalDerivative", False)):
            return f"the FMU of component '{name}' has direct feedthrough, and gives no directional derivatives"
        driven = [e.name for e in through if (name, e.name) in self._driven]
        if driven:
            return f"'{name}.{source.name}' depends directly on '{name}.{driven[0]}', which a signal feeds"
        return None

    def needed(self, links: Iterable[Link]) -> tuple[tuple[tuple[str, Element], ...], tuple[tuple[str, Element], ...]]:
        """Inputs and outputs whose derivatives are needed for those of links."""
        inputs: dict[Key, tuple[str, Element]] = {}
        outputs: dict[Key, tuple[str, Element]] = {}
        waiting = list(links)
        while waiting:
            link = waiting.pop()
            key = (link.target_component, link.target.name)
            if key in inputs:
                continue
            inputs[key] = (link.target_component, link.target)
            outputs[link.source_component, link.source.name] = (link.source_component, link.source)
            waiting += [self._link_to[link.source_component, e.name] for e in self._through(link)]
        return tuple(inputs[key] for key in sorted(inputs)), tuple(outputs[key] for key in sorted(outputs))

    def _through(self, link: Link) -> list[Element]:
        """Fed inputs on which what a link carries depends directly."""
        name = link.source_component
        names = self._system.feedthrough[name].get(link.source.variable.name, ())
        elements = self._system.ports[name].elements_in(names)
        return [e for e in elements if (name, e.name) in self._link_to or (name, e.name) in self._driven]


def _fed(system: ResolvedSystem) -> Iterable[tuple[str, Element, int, Link | None]]:
    """Every input that is fed at communication points, with the number of steps between two values; 1 for a signal.

    And the link that feeds it, None for a signal.
    """
    for link in system.links:
        if not system.couples_equations(link):
            yield link.target_component, link.target, system.components[link.source_component].every, link
    for drive in system.drives:
        for element in drive.targets if not drive.added else ():
            yield drive.component, element, 1, None


def _obstacle(system: ResolvedSystem, component: str, element: Element, every: int) -> str | None:
    """Why an input can only be held."""
    description = system.ports[component].description
    if element.variable.type not in ("Real", "Float64"):
        return f"it is of type {element.variable.type}"
    if element.variable.variability not in (None, "continuous"):
        return f"it is {element.variable.variability} and changes at communication points only"
    if system.ports[component].is_model_exchange:
        return None
    if description.fmiMajorVersion < 3 and not description.coSimulation.canInterpolateInputs:
        return "its FMU can't interpolate inputs (canInterpolateInputs)"
    if description.fmiMajorVersion == 3:
        if not description.coSimulation.providesIntermediateUpdate:
            return "its FMU doesn't ask for inputs during a step (providesIntermediateUpdate)"
        if not element.variable.intermediateUpdate:
            return "it can't be set during a step (intermediateUpdate)"
    own = system.components[component].every
    if not can_be_extrapolated(own, every):
        return f"it gets a value every {every} steps only, and its component needs one every {own}"
    return None
