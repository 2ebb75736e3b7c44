"""The variables of a packed FMU: inputs that nothing feeds, outputs, and parameters of the components."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any, Literal

from fmpy.model_description import ModelVariable

from cosim.errors import SetupError
from cosim.fmi.structure import is_structural
from cosim.system.levels import Node
from cosim.system.resolution import ResolvedSystem, split
from cosim.system.variables import Element, is_alias

#: Types of variables of a packed FMU and their numbers in packed.h.
TYPES = {
    name: number
    for number, name in enumerate(
        (
            *("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
            *("Boolean", "String"),
        )
    )
}

#: Name of the parameter for the longest internal communication step.
MAX_STEP = "max_step"

_TO_FMI3 = {"Real": "Float64", "Integer": "Int32"}
_TO_FMI2 = {
    "Float64": "Real",
    "Float32": "Real",
    **dict.fromkeys(("Int8", "UInt8", "Int16", "UInt16", "Int32"), "Integer"),
}


@dataclass(frozen=True)
class PackedVariable:
    """A scalar variable of a packed FMU.

    Attributes
    ----------
    name : str
    component : str
        Component that it belongs to; empty for `max_step`.
    element : Element or None
        What it is there.
    type : str
        As the model description of the packed FMU has it.
    causality : {"parameter", "input", "output"}
    variability : str
    start : Any
        In Python's own type; None for outputs.
    dependencies : frozenset of str
        Inputs of the packed FMU that an output depends on directly.
    """

    name: str
    component: str
    element: Element | None
    type: str
    causality: Literal["parameter", "input", "output"]
    variability: str
    start: Any = None
    dependencies: frozenset[str] = frozenset()

    def number_of_type(self, version: int) -> int:
        """Number of the type in packed.h, in a packed FMU of a version of FMI."""
        if self.type == "Enumeration":
            return TYPES["Int32" if version == 2 else "Int64"]
        return TYPES[_TO_FMI3.get(self.type, self.type)]


@dataclass(frozen=True)
class Interface:
    """Variables of a packed FMU by causality, and what could not be one of them."""

    parameters: tuple[PackedVariable, ...]
    inputs: tuple[PackedVariable, ...]
    outputs: tuple[PackedVariable, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def variables(self) -> tuple[PackedVariable, ...]:
        """All of them, in the order of their value references."""
        return (*self.parameters, *self.inputs, *self.outputs)


def open_inputs(resolved: ResolvedSystem) -> list[tuple[str, Element]]:
    """Inputs of components that neither a connection nor a signal feeds, and that can be set."""
    return [
        (component, element)
        for component, port in resolved.ports.items()
        for element in port.of_causality("input")
        if element.is_exchanged and not is_alias(element.variable) and (component, element.name) not in resolved.fed
    ]


def chosen_inputs(resolved: ResolvedSystem, names: Sequence[str] | None, version: int) -> list[tuple[str, Element]]:
    """Inputs of the packed FMU: those of these names, or all that nothing feeds and its version of FMI has a type for.

    Raises
    ------
    SetupError
        A name is unknown, or something feeds it.
    """
    candidates = {(c, e.name): (c, e) for c, e in open_inputs(resolved) if e.kind not in ("binary", "clock")}
    if names is None:
        return [(c, e) for c, e in candidates.values() if type_in(version, e) is not None]
    found: dict[tuple[str, str], tuple[str, Element]] = {}
    for path in names:
        port, name = split(path, resolved.ports)
        for element in port.find(name):
            key = (port.component, element.name)
            if key not in candidates:
                raise SetupError(
                    f"'{port.component}.{element.name}' can't be an input of the packed FMU: it must be an input "
                    "of its component, a number, a Boolean or a text, that no connection and no signal feeds"
                )
            if type_in(version, element) is None:
                raise SetupError(_too_large(port.component, element))
            found[key] = candidates[key]
    return list(found.values())


def chosen_outputs(
    resolved: ResolvedSystem, names: Sequence[str] | None, version: int
) -> tuple[list[tuple[str, Element]], list[str]]:
    """Outputs of the packed FMU: those of these names, or all outputs; and notes about those that it can't have.

    Raises
    ------
    SetupError
        A name is unknown, or no output, local variable or calculated parameter.
    """
    notes: list[str] = []
    if names is None:
        found = []
        for component, port in resolved.ports.items():
            for element in port.of_causality("output"):
                if element.is_exchanged and element.kind != "binary" and type_in(version, element) is not None:
                    found.append((component, element))
                else:
                    notes.append(f"output '{component}.{element.name}' is left out: {_no_type(version, element)}")
        return found, notes
    chosen: dict[tuple[str, str], tuple[str, Element]] = {}
    for path in names:
        port, name = split(path, resolved.ports)
        for element in port.find(name):
            causality = element.variable.causality
            if causality not in ("output", "local", "calculatedParameter") or element.kind in ("binary", "clock"):
                raise SetupError(
                    f"'{path}' is of causality {causality} and type {element.variable.type}, and can't be an output "
                    "of the packed FMU; choose outputs and local variables of components"
                )
            if type_in(version, element) is None:
                raise SetupError(_too_large(port.component, element))
            chosen[port.component, element.name] = (port.component, element)
    return list(chosen.values()), notes


def _too_large(component: str, element: Element) -> str:
    return (
        f"'{component}.{element.name}' is of type {element.variable.type}, for which FMI 2.0 has none; "
        "pack into an FMU of FMI 3.0 (--fmi 3)"
    )


def _no_type(version: int, element: Element) -> str:
    if element.kind in ("binary", "clock"):
        return f"packed FMUs have no variables of type {element.variable.type}"
    return f"FMI {version}.0 has no type for {element.variable.type}"


def type_in(version: int, element: Element) -> str | None:
    """Type of a variable in a packed FMU of a version of FMI; None where it has none."""
    own = str(element.variable.type)
    if own in ("Boolean", "String", "Enumeration"):
        return own
    if own in ("Binary", "Clock"):
        return None
    if version == 3:
        return _TO_FMI3.get(own, own)
    return own if own in _TO_FMI3 else _TO_FMI2.get(own)


def variability_of(element: Element) -> str:
    """Variability of a variable, with the standard's defaults."""
    said = element.variable.variability
    if said:
        return str(said)
    return "continuous" if element.kind == "real" else "discrete"


def start_of(component: str, element: Element, given: Mapping[Node, Any]) -> Any:
    """Start value of an element: that of the system, or else of its FMU; in Python's own type."""
    key = (component, element.name)
    if key in given:
        return given[key]
    return start_in_description(element.variable)[element.offset]


def start_in_description(variable: ModelVariable) -> list[Any]:
    """Start values of all elements of a variable, as its model description has them; 0, or an empty text, without."""
    element = Element(variable.name, variable, 0)
    n = math.prod(variable.shape or ())
    default: Any = "" if element.kind == "string" else b"" if element.kind == "binary" else 0
    if variable.start is None:
        return [element.type.value(default)] * n
    if element.type.is_text:
        return [variable.start if element.kind == "string" else bytes.fromhex(variable.start)] * n
    words = str(variable.start).split()
    values = [_number(element, word) for word in words]
    if len(values) != 1:  # arrays of another size than in the description begin with its values
        return (values + [element.type.value(0)] * n)[:n]
    return values * n


def _number(element: Element, word: str) -> Any:
    if element.kind == "boolean":
        return word in ("true", "1")
    return float(word) if element.kind == "real" else int(word)


def interface_of(
    resolved: ResolvedSystem,
    inputs: Sequence[tuple[str, Element]],
    outputs: Sequence[tuple[str, Element]],
    version: int,
    *,
    max_step: float,
    sequential: bool,
) -> Interface:
    """All variables of a packed FMU.

    Parameters
    ----------
    resolved : ResolvedSystem
    inputs, outputs : sequence of (component, element)
        Chosen ones.
    version : {2, 3}
        Of FMI.
    max_step : float
        Longest internal communication step (s).
    sequential : bool
        Outputs depend at once on inputs, as far as the components do.
    """
    given: dict[Node, Any] = {
        (s.component, e.name): v for s in resolved.starts for e, v in zip(s.elements, s.values, strict=True)
    }
    notes: list[str] = []
    parameters = [
        PackedVariable(MAX_STEP, "", None, "Real" if version == 2 else "Float64", "parameter", "tunable", max_step)
    ]
    for component, port in resolved.ports.items():
        for element in port.of_causality("parameter"):
            variable = element.variable
            if is_structural(variable) or is_alias(variable) or (component, element.name) in resolved.fed:
                continue
            if variable.initial not in (None, "exact", "approx"):
                continue
            type_name = type_in(version, element)
            if type_name is None or (element.kind == "string" and element.variable.shape):
                notes.append(f"parameter '{component}.{element.name}' is left out: {_no_type(version, element)}")
                continue
            variability = "tunable" if element.is_tunable else "fixed"
            start = start_of(component, element, given)
            parameters.append(
                PackedVariable(
                    f"{component}.{element.name}", component, element, type_name, "parameter", variability, start
                )
            )
    own_inputs = [
        PackedVariable(
            f"{component}.{element.name}",
            component,
            element,
            type_in(version, element) or "",
            "input",
            "continuous" if variability_of(element) == "continuous" else "discrete",
            start_of(component, element, given),
        )
        for component, element in inputs
    ]
    dependencies = _Dependencies(resolved, {(v.component, v.element.variable.name) for v in own_inputs if v.element})
    by_variable: dict[Node, list[str]] = {}
    for packed in own_inputs:
        if packed.element is not None:
            by_variable.setdefault((packed.component, packed.element.variable.name), []).append(packed.name)
    own_outputs = []
    for component, element in outputs:
        nodes = dependencies.of(component, element.variable.name) if sequential else frozenset()
        feeding = frozenset(name for node in nodes for name in by_variable[node])
        variability = "continuous" if variability_of(element) == "continuous" else "discrete"
        own_outputs.append(
            PackedVariable(
                f"{component}.{element.name}",
                component,
                element,
                type_in(version, element) or "",
                "output",
                variability,
                dependencies=feeding,
            )
        )
    names = [v.name for v in (*parameters, *own_inputs, *own_outputs)]
    assert len(set(names)) == len(names)
    return Interface(tuple(parameters), tuple(own_inputs), tuple(own_outputs), tuple(notes))


class _Dependencies:
    """On which inputs of the packed FMU a value of a component depends at the same communication point."""

    def __init__(self, resolved: ResolvedSystem, external: Set[Node]) -> None:
        self._resolved = resolved
        self._external = external
        self._feeders: dict[Node, set[Node]] = {}
        for link in resolved.links:
            target = (link.target_component, link.target.variable.name)
            self._feeders.setdefault(target, set()).add((link.source_component, link.source.variable.name))

    def of(self, component: str, name: str) -> frozenset[Node]:
        """Inputs, as (component, variable)."""
        found: set[Node] = set()
        seen: set[Node] = set()
        waiting = [(component, name)]
        while waiting:
            output = waiting.pop()
            if output in seen:
                continue
            seen.add(output)
            feedthrough = self._resolved.feedthrough[output[0]]
            port = self._resolved.ports[output[0]]
            # FMUs say nothing of their local variables, which may depend on all inputs
            inputs = feedthrough.get(output[1], {e.variable.name for e in port.of_causality("input")})
            for own in ((output[0], each) for each in inputs):
                if own in self._external:
                    found.add(own)
                waiting.extend(self._feeders.get(own, ()))
        return frozenset(found)
