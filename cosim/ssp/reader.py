"""Read an SSP into a `System`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.errors import nearest
from cosim.ssp.flow import Feed, Flow, Node
from cosim.ssp.package import Package
from cosim.ssp.schema import SSPError, child, children, parse
from cosim.ssp.structure import Part, read_structure, variable_nodes
from cosim.ssp.values import Value, read_units, values_of
from cosim.system.system import System
from cosim.system.variables import Element

if TYPE_CHECKING:
    from xmlschema import DataElement

DESCRIPTION = "SystemStructure.ssd"

#: Attributes by which other tools note the communication step, in annotations: libcosim, OMSimulator.
_STEP_SIZES = {"FixedStepAlgorithm": "baseStepSize", "FixedStepMaster": "stepSize"}


@dataclass(frozen=True)
class ReadSystem:
    """What an SSP holds.

    Attributes
    ----------
    name : str
    system : System
        Components of nested systems are named `system/component`.
    start_time : float
        In s; 0 where the SSP has none.
    stop_time, step_size : float, optional
        In s, if the SSP or its FMUs say.
    notes : tuple of str
        What the standard wants ignored, but the user should know.
    """

    name: str
    system: System
    start_time: float
    stop_time: float | None
    step_size: float | None
    notes: tuple[str, ...]


def read_ssp(path: Path, folder: Path) -> ReadSystem:
    """Read an SSP.

    Parameters
    ----------
    path : Path
    folder : Path
        Its FMUs are unpacked into this folder, which must live as long as the system.

    Raises
    ------
    SSPError, SetupError
        The SSP is malformed, or has what can't be run; the message names it.
    """
    with Package(path) as package:
        where = f"{path}: {DESCRIPTION}"
        description = parse(package.read_xml(DESCRIPTION), "ssd", where)
        units = read_units(child(description, "Units"))
        root = read_structure(next(children(description, "System")), units, package, folder)
        notes: list[str] = []
        values: dict[Node, Value] = {}
        _bind(root, package, where, values, notes)
    system = _system(root, Flow(root, where), values)
    experiment = child(description, "DefaultExperiment")
    times = {} if experiment is None else experiment.attrib
    return ReadSystem(
        description.attrib["name"],
        system,
        float(times.get("startTime", 0.0)),
        times.get("stopTime"),
        _step_size(description, root, where),
        tuple(notes),
    )


def _bind(part: Part, package: Package, where: str, values: dict[Node, Value], notes: list[str]) -> None:
    """Values by what they are for. Those of a system override those of its elements, later ones earlier ones."""
    for inner in part.parts.values():
        _bind(inner, package, where, values, notes)
    here = f"{where}: " + (f"'{part.path}'" if part.path else "the system")
    for binding in children(part.element, "ParameterBindings", "ParameterBinding"):
        for value in values_of(binding, package, part.source, here):
            found = variable_nodes(part, value.name)
            if not found:
                known = part.variables if part.ports is not None else _hierarchical_names(part)
                hint = nearest(value.name, known)
                notes.append(f"{value.origin}: nothing is named '{value.name}', which is ignored; {hint}")
            for target, name in found:
                scalars = (name,) if target.ports is not None else target.connectors[name].scalars
                for scalar, part_of_value in zip(scalars, value.split(len(scalars)), strict=True):
                    values[target.path, scalar] = part_of_value


def _hierarchical_names(part: Part) -> list[str]:
    if part.ports is not None:
        return list(part.variables)
    names = list(part.connectors)
    for name, inner in part.parts.items():
        names += [f"{name}.{n}" for n in _hierarchical_names(inner)]
    return names


def _system(root: Part, flow: Flow, values: dict[Node, Value]) -> System:
    system = System()
    components = [part for part in root.all_parts() if part.ports is not None]
    connectors = {part.path: part for part in root.all_parts()}
    connections = []
    for part in components:
        assert part.ports is not None
        assert part.fmu is not None
        start: dict[str, Any] = {}
        fed = set()
        for name, elements in part.variables.items():
            if (part.path, name) in values:
                start[name] = _plain(_fit(values[part.path, name], part, elements))
        for element in part.ports.all_elements():
            feed = flow.into((part.path, element.name))
            if feed is None:
                continue
            source_part, source_name = feed.source
            relative = part.ports.is_relative(element)
            if connectors[source_part].ports is not None:
                factor, offset = feed.transformation(relative=relative)
                connections.append((f"{source_part}.{source_name}", f"{part.path}.{element.name}", factor, offset))
                fed.add(element.name)
            elif feed.source in values:
                start[element.name] = _plain(_through(values[feed.source], feed, part, element))
        _add_defaults(part, start, fed)
        system.add(part.path, part.fmu, start=start)
    for source, target, factor, offset in connections:
        system.connect(source, target, factor=factor, offset=offset, units="ignore")  # converted already
    return system


def _fit(value: Value, part: Part, elements: list[Element]) -> list[float] | str:
    """A value for a variable of a component."""
    assert part.ports is not None
    name = f"{part.path}.{value.name}"
    relative = part.ports.is_relative(elements[0])
    return value.fit(name, part.ports.unit(elements[0]), elements[0].items, relative=relative)


def _through(value: Value, feed: Feed, part: Part, element: Element) -> list[float] | str:
    """A value that a connector of a system has, for the input or parameter that it is connected to."""
    assert part.ports is not None
    relative = part.ports.is_relative(element)
    name = f"{part.path}.{element.name}"
    data = value.fit(name, feed.unit, element.items, relative=relative)
    factor, offset = feed.transformation(relative=relative)
    if (factor, offset) == (1.0, 0.0):
        return data
    if isinstance(data, str):
        raise SSPError(f"{value.origin}: '{value.name}' is a text and can't be transformed on its way to '{name}'")
    return [factor * number + offset for number in data]


def _plain(value: list[float] | str) -> Any:
    return value[0] if len(value) == 1 and not isinstance(value, str) else value


def _add_defaults(part: Part, start: dict[str, Any], fed: set[str]) -> None:
    """Inputs that nothing feeds keep the value that the FMU gives them."""
    assert part.ports is not None
    for element in part.ports.of_causality("input"):
        if not {element.name, element.variable.name} & (fed | set(start)):
            start[element.name] = _start_value(element)


def _start_value(element: Element) -> Any:
    text = element.variable.start
    if element.kind == "String":
        return text or ""
    parts = str(text).split() if text is not None else ["0"]
    part = parts[element.offset] if len(parts) > 1 else parts[0]
    return {"true": 1.0, "false": 0.0}[part] if part in ("true", "false") else float(part)


def _step_size(description: DataElement, root: Part, where: str) -> float | None:
    """The communication step: from annotations, else the smallest that an FMU asks for."""
    for holder in (child(description, "DefaultExperiment"), root.element, description):
        for annotation in children(holder, "Annotations", "Annotation"):
            for element in annotation.iter():
                text = element.attrib.get(_STEP_SIZES.get(str(element.tag).rpartition("}")[2], ""))
                if text is None:
                    continue
                try:
                    return float(text)
                except ValueError:
                    raise SSPError(f"{where}: the step size '{text}' in an annotation is not a number") from None
    experiments = [p.ports.description.defaultExperiment for p in root.all_parts() if p.ports is not None]
    steps = [float(e.stepSize) for e in experiments if e is not None and e.stepSize is not None]
    return min((s for s in steps if s > 0 and math.isfinite(s)), default=None)
