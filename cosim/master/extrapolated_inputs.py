"""The choice of inputs that are extrapolated between communication points; the others are held.

A held input is late by half a step on average, which makes the coupling first-order accurate. An FMU that can
interpolate its inputs takes their derivatives with them (`fmi2SetRealInputDerivatives`), or asks for its inputs during
a step (FMI 3.0, intermediate update). The derivatives of a connection come from its last values, see
`cosim.master.algorithm`; the rate of a signal, which is known beforehand, is that to its next value. After a jump
nothing is known of a connection's derivatives, and it is held for one step.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from cosim.errors import SetupError
from cosim.master.algorithm import AUTO, Algorithm, can_be_extrapolated
from cosim.system.resolution import ResolvedSystem
from cosim.system.variables import Element


@dataclass(frozen=True)
class ExtrapolatedInputs:
    """Links whose inputs are extrapolated.

    Attributes
    ----------
    algorithm : Algorithm
    elements : mapping
        Component -> all elements of the variables of which at least one element is extrapolated.
    moving : frozenset
        (component, element) of those that are.
    held : tuple of str
        Names `component.variable` of fed inputs that are not.
    exact : tuple of str
        Names of inputs that are neither: both ends of their connection are in model exchange.
    """

    algorithm: Algorithm
    elements: Mapping[str, tuple[Element, ...]]
    moving: frozenset[tuple[str, str]]
    held: tuple[str, ...]
    exact: tuple[str, ...] = ()

    def summary(self) -> dict[str, object]:
        """For people: what was asked for, and the names of what is extrapolated and of what is held."""
        extrapolation = self.algorithm.extrapolation
        moving = {extrapolation.name: [".".join(key) for key in sorted(self.moving)]} if extrapolation.degree else {}
        if self.exact:
            moving["model_exchange"] = list(self.exact)
        return {"mode": extrapolation.name if self.algorithm.demanded else AUTO, **moving, "hold": list(self.held)}


def extrapolated_inputs(
    system: ResolvedSystem, algorithm: Algorithm, refusing: Collection[str] = ()
) -> ExtrapolatedInputs:
    """Decide for every fed input.

    Parameters
    ----------
    system : ResolvedSystem
    algorithm : Algorithm
    refusing : collection of str
        Components whose FMUs were found to refuse derivatives of their inputs, whatever their descriptions say.

    Raises
    ------
    SetupError
        The extrapolation is demanded where an input can only be held; the message says which and why.
    """
    extrapolation = algorithm.extrapolation
    moving: set[tuple[str, str]] = set()
    held: list[str] = []
    added = {(d.component, e.name) for d in system.drives if d.added for e in d.targets}
    for component, element, every, jumps in _fed(system):
        name = f"{component}.{element.name}"
        disturbed = (component, element.name) in added
        obstacle = "a sampled signal is added to it" if disturbed else _obstacle(system, component, element, every)
        if component in refusing:
            obstacle = "its FMU refuses derivatives of inputs"
        if extrapolation.degree == 0 or ((obstacle or jumps) and not algorithm.demanded):
            held.append(name)
        elif obstacle:
            raise SetupError(
                f"extrapolation '{extrapolation.name}': input '{name}' can only be held, for {obstacle}; use '{AUTO}'"
            )
        else:
            moving.add((component, element.name))
    variables = {(c, e.variable.name) for c, e, *_ in _fed(system) if (c, e.name) in moving}
    elements = {
        component: tuple(e for e in port.all_elements() if (component, e.variable.name) in variables)
        for component, port in system.ports.items()
    }
    exact = sorted(f"{k.target_component}.{k.target.name}" for k in system.links if system.couples_equations(k))
    return ExtrapolatedInputs(
        algorithm, {c: e for c, e in elements.items() if e}, frozenset(moving), tuple(sorted(held)), tuple(exact)
    )


def _fed(system: ResolvedSystem) -> Iterable[tuple[str, Element, int, bool]]:
    """Every input that is fed at communication points, with the number of steps between two values; 1 for a signal.

    And whether that is an FMU's output that keeps its value from event to event, which a slope would miss.
    """
    for link in system.links:
        if system.couples_equations(link):
            continue
        source = system.components[link.source_component]
        jumps = source.function is None and link.source.variable.variability == "discrete"
        yield link.target_component, link.target, source.every, jumps
    for drive in system.drives:
        for element in drive.targets if not drive.added else ():
            yield drive.component, element, 1, False


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
