"""Which inputs change linearly between communication points, and which are held.

A held input is late by half a step on average, which makes the coupling first-order accurate. An FMU that can
interpolate its inputs takes a rate with them (`fmi2SetRealInputDerivatives`), or asks for them during its step (FMI
3.0, intermediate update). The rate of a connection is that between its last two values, the rate of a signal, which is
known beforehand, that to its next value; both make the coupling second-order accurate. After a jump nothing is known of
a connection's rate, and it is held for one step.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from cosim.errors import SetupError, nearest
from cosim.system.resolution import ResolvedSystem
from cosim.system.variables import Element

#: "auto": linear where the FMU can; "hold": all held; "linear": an error where an FMU can't.
Coupling = Literal["auto", "hold", "linear"]


@dataclass(frozen=True)
class LinearInputs:
    """What changes linearly.

    Attributes
    ----------
    elements : mapping
        Component -> all elements of the variables of which at least one element does.
    moving : frozenset
        (component, element) of those that do.
    held : tuple of str
        Names `component.variable` of fed inputs that don't.
    """

    elements: Mapping[str, tuple[Element, ...]]
    moving: frozenset[tuple[str, str]]
    held: tuple[str, ...]

    def summary(self, coupling: Coupling) -> dict[str, object]:
        """For people: the mode, and names of what is linear and what is held."""
        return {"mode": coupling, "linear": [".".join(key) for key in sorted(self.moving)], "held": list(self.held)}


def linear_inputs(system: ResolvedSystem, coupling: Coupling) -> LinearInputs:
    """Decide for every fed input.

    Raises
    ------
    SetupError
        The coupling is unknown, or "linear" where an input can only be held; the message says which and why.
    """
    if coupling not in get_args(Coupling):
        raise SetupError(f"coupling {coupling!r} is unknown; {nearest(str(coupling), get_args(Coupling))}")
    moving: set[tuple[str, str]] = set()
    held: list[str] = []
    added = {(d.component, e.name) for d in system.drives if d.added for e in d.targets}
    for component, element, every in _fed(system):
        name = f"{component}.{element.name}"
        disturbed = (component, element.name) in added
        obstacle = "a sampled signal is added to it" if disturbed else _obstacle(system, component, element, every)
        if coupling == "hold" or (obstacle and coupling == "auto"):
            held.append(name)
        elif obstacle:
            raise SetupError(f"coupling 'linear': input '{name}' can only be held, for {obstacle}; use 'auto'")
        else:
            moving.add((component, element.name))
    variables = {(c, e.variable.name) for c, e, _ in _fed(system) if (c, e.name) in moving}
    elements = {
        component: tuple(e for e in port.all_elements() if (component, e.variable.name) in variables)
        for component, port in system.ports.items()
    }
    return LinearInputs({c: e for c, e in elements.items() if e}, frozenset(moving), tuple(sorted(held)))


def _fed(system: ResolvedSystem) -> Iterable[tuple[str, Element, int]]:
    """Every fed input, with the number of communication steps between two values of what feeds it; 1 for a signal."""
    for link in system.links:
        yield link.target_component, link.target, system.components[link.source_component].every
    for drive in system.drives:
        for element in drive.targets if not drive.added else ():
            yield drive.component, element, 1


def _obstacle(system: ResolvedSystem, component: str, element: Element, every: int) -> str | None:
    """Why an input can only be held."""
    description = system.ports[component].description
    if element.variable.type not in ("Real", "Float64"):
        return f"it is of type {element.variable.type}"
    if element.variable.variability not in (None, "continuous"):
        return f"it is {element.variable.variability} and changes at communication points only"
    if description.fmiMajorVersion == 2 and not description.coSimulation.canInterpolateInputs:
        return "its FMU can't interpolate inputs (canInterpolateInputs)"
    if description.fmiMajorVersion == 3:
        if not description.coSimulation.providesIntermediateUpdate:
            return "its FMU doesn't ask for inputs during a step (providesIntermediateUpdate)"
        if not element.variable.intermediateUpdate:
            return "it can't be set during a step (intermediateUpdate)"
    own = system.components[component].every
    if own % every:
        return f"it gets a value every {every} steps only, and its component needs one every {own}"
    return None
