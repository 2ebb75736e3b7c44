"""The XML files of an SSP: the description of the system with its diagram, and parameter sets."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import SubElement

from fmpy.model_description import BaseUnit, SimpleType, Unit

from cosim.ssp.errors import SSPError
from cosim.ssp.format.components import PackagedComponent, SystemContent
from cosim.ssp.format.diagram import Arrangement, Box, arrange
from cosim.ssp.format.schema import NAMESPACES
from cosim.system.resolution import resolve_start_value
from cosim.system.variables import Element, Ports
from cosim.versions import versions

#: Type of our own annotations.
TOOL = "closed-chain-cosim"

#: Annotations of libcosim and OMSimulator for the communication step, for which the standard has no element.
_ANNOTATIONS: dict[str, tuple[str, tuple[str, ...], Callable[[str], dict[str, str]]]] = {
    "com.opensimulationplatform": (
        "http://opensimulationplatform.com/SSP/OSPAnnotations",
        ("Algorithm", "FixedStepAlgorithm"),
        lambda step: {"baseStepSize": step},
    ),
    "org.openmodelica": (
        "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
        ("Annotations", "SimulationInformation", "FixedStepMaster"),
        lambda step: {"description": "oms-ma", "stepSize": step},
    ),
}

_BASE = {"kg": 0, "m": 0, "s": 0, "A": 0, "K": 0, "mol": 0, "cd": 0, "rad": 0, "factor": 1.0, "offset": 0.0}


def description_file(
    content: SystemContent,
    bindings: Mapping[str, Sequence[str]],
    name: str,
    description: str,
    times: tuple[float, float, float],
    version: str,
) -> bytes:
    """`SystemStructure.ssd`.

    Parameters
    ----------
    content : SystemContent
    bindings : mapping
        Component -> parameter sets in the archive that it takes, in order.
    name, description : str
    times : tuple
        Start time, stop time and communication step (s).
    version : {"1.0", "2.0"}
    """
    layout = arrange(
        {n: [e.name for e in m.inputs] for n, m in content.components.items()},
        {n: [e.name for e in m.outputs] for n, m in content.components.items()},
        content.wires,
    )
    definitions = _Definitions()
    root = _root("ssd:SystemStructureDescription", name, description, version)
    system = _sub(root, "ssd:System", name=_identifier(name))
    elements = _sub(system, "ssd:Elements")
    for component, packaged in content.components.items():
        _component(elements, component, packaged, bindings.get(component, ()), layout, definitions, version)
    if content.wires:
        _connections(_sub(system, "ssd:Connections"), content, layout)
    _sub(system, "ssd:SystemGeometry", **_corners(layout.canvas))
    start, stop, step = times
    _annotate(system, "org.openmodelica", step)
    definitions.write(root, "ssd")
    experiment = _sub(root, "ssd:DefaultExperiment", startTime=repr(start), stopTime=repr(stop))
    _annotate(experiment, "com.opensimulationplatform", step)
    return _text(root)


def parameter_file(name: str, description: str, values: Mapping[str, Any], ports: Ports, version: str) -> bytes:
    """A parameter set (SSV), in the units of an FMU.

    Parameters
    ----------
    name, description : str
    values : mapping
        Name of a variable -> value, as start values of a system.
    ports : Ports
        Of the component that they are for.
    version : {"1.0", "2.0"}
    """
    definitions = _Definitions()
    root = _root("ssv:ParameterSet", name, description, version)
    parameters = _sub(root, "ssv:Parameters")
    for label, value in values.items():
        start = resolve_start_value(ports, label, value)
        for element, own in zip(start.elements, start.values, strict=True):
            kind, attributes = _type(element, ports, definitions, version)
            parameter = _sub(parameters, "ssv:Parameter", name=element.name)
            _sub(parameter, f"ssv:{kind}", value=_value(element, own), **attributes)
    definitions.write(root, "ssv")
    return _text(root)


def _value(element: Element, value: Any) -> str:
    if element.variable.type == "Enumeration":  # SSP writes the name of the item
        return next(str(i.name) for i in element.variable.declaredType.items if int(i.value) == int(value))
    if element.kind == "real":
        return repr(float(value))
    if element.kind == "boolean":
        return str(bool(value)).lower()
    return str(int(value)) if element.kind == "integer" else str(value)


class _Definitions:
    """Units and enumerations that a file uses, and has to define."""

    def __init__(self) -> None:
        self._units: dict[str, Unit] = {}
        self._enumerations: dict[str, dict[str, str]] = {}

    def unit(self, unit: Unit | None) -> dict[str, str]:
        """Attribute for a unit, none where the FMU does not say what it measures: SSP has to."""
        if unit is None or unit.baseUnit is None:
            return {}
        known = self._units.setdefault(unit.name, unit)
        if _exponents(known.baseUnit) != _exponents(unit.baseUnit):
            raise SSPError(f"two FMUs have different units of the name '{unit.name}'; rename one of them")
        return {"unit": unit.name}

    def enumeration(self, declared: SimpleType) -> dict[str, str]:
        """Attribute for an enumeration."""
        items = {str(item.name): str(item.value) for item in declared.items}
        if self._enumerations.setdefault(declared.name, items) != items:
            raise SSPError(f"two FMUs have different enumerations of the name '{declared.name}'; rename one of them")
        return {"name": declared.name}

    def write(self, root: ElementTree.Element, prefix: str) -> None:
        if self._enumerations:
            enumerations = _sub(root, f"{prefix}:Enumerations")
            for name, items in self._enumerations.items():
                enumeration = _sub(enumerations, "ssc:Enumeration", name=name)
                for item, value in items.items():
                    _sub(enumeration, "ssc:Item", name=item, value=value)
        if self._units:
            units = _sub(root, f"{prefix}:Units")
            for name, unit in self._units.items():
                given = {k: repr(v) for k, v in _exponents(unit.baseUnit).items() if v != _BASE[k]}
                _sub(_sub(units, "ssc:Unit", name=name), "ssc:BaseUnit", **given)


def _exponents(base: BaseUnit) -> dict[str, float]:
    return {name: type(default)(getattr(base, name)) for name, default in _BASE.items()}


def _component(
    elements: ElementTree.Element,
    name: str,
    packaged: PackagedComponent,
    bindings: Iterable[str],
    layout: Arrangement,
    definitions: _Definitions,
    version: str,
) -> None:
    implementation = "ModelExchange" if packaged.ports.is_model_exchange else "CoSimulation"
    component = _sub(elements, "ssd:Component", name=name, source=packaged.source, implementation=implementation)
    if packaged.fmu.description.description:
        component.set("description", packaged.fmu.description.description)
    connectors = _sub(component, "ssd:Connectors")
    # no connectors of inputs that nothing feeds: fmpy 0.3 would feed them with what feeds the one before
    for element in (*packaged.inputs, *packaged.outputs):
        connector = _sub(connectors, "ssd:Connector", name=element.name, kind=element.variable.causality)
        if element.variable.description:
            connector.set("description", element.variable.description)
        kind, attributes = _type(element, packaged.ports, definitions, version)
        _sub(connector, f"ssc:{kind}", **attributes)
        x, y = layout.connectors[name, element.name]
        _sub(connector, "ssd:ConnectorGeometry", x=_number(x), y=_number(y))
    _sub(component, "ssd:ElementGeometry", **_corners(layout.boxes[name]))
    sources = list(bindings)
    holder = _sub(component, "ssd:ParameterBindings") if sources else None
    for source in sources:
        assert holder is not None
        _sub(holder, "ssd:ParameterBinding", source=source)
    said = {"isolate": "true"} if packaged.isolate else {}
    said |= {} if packaged.place is None else {"place": packaged.place}
    if said:
        annotation = _sub(_sub(component, "ssd:Annotations"), "ssc:Annotation", type=TOOL)
        SubElement(annotation, "Instance", said)


def _type(element: Element, ports: Ports, definitions: _Definitions, version: str) -> tuple[str, dict[str, str]]:
    """Type in SSP, and its attributes. libcosim wants one of every connector."""
    fmi_type = element.variable.type
    if fmi_type == "Enumeration":
        return fmi_type, definitions.enumeration(element.variable.declaredType)
    kinds = {"real": "Real", "integer": "Integer", "boolean": "Boolean", "string": "String", "binary": "Binary"}
    of_fmi_3 = version != "1.0" and ports.description.fmiMajorVersion == 3  # SSP 2.0 has the types of FMI 3.0
    kind = fmi_type if of_fmi_3 else kinds.get(element.kind, element.kind)
    return kind, definitions.unit(ports.unit(element)) if element.kind == "real" else {}


def _connections(parent: ElementTree.Element, content: SystemContent, layout: Arrangement) -> None:
    for (source, target), connection, line in zip(content.wires, content.connections, layout.lines, strict=True):
        names = ("startElement", "startConnector", "endElement", "endConnector")
        element = _sub(parent, "ssd:Connection", **dict(zip(names, (*source, *target), strict=True)))
        if connection.units == "ignore":
            element.set("suppressUnitConversion", "true")
        if (connection.factor, connection.offset) != (1.0, 0.0):
            transformation = {"factor": repr(connection.factor), "offset": repr(connection.offset)}
            _sub(element, "ssc:LinearTransformation", **transformation)
        points = {f"points{axis}": " ".join(_number(p[i]) for p in line) for i, axis in enumerate("XY")}
        _sub(element, "ssd:ConnectionGeometry", **points)


def _annotate(parent: ElementTree.Element, kind: str, step: float) -> None:
    namespace, path, attributes = _ANNOTATIONS[kind]
    element = _sub(_sub(parent, "ssd:Annotations"), "ssc:Annotation", type=kind)
    for name in path:
        element = SubElement(element, f"{{{namespace}}}{name}")
    element.attrib.update(attributes(repr(step)))


def _root(qualified: str, name: str, description: str, version: str) -> ElementTree.Element:
    root = ElementTree.Element(_tag(qualified), version=version, name=name)
    if description:
        root.set("description", description)
    root.set("generationTool", f"closed-chain-cosim {versions()['closed-chain-cosim']}")
    return root


def _sub(parent: ElementTree.Element, qualified: str, **attributes: str) -> ElementTree.Element:
    return SubElement(parent, _tag(qualified), attributes)


def _tag(qualified: str) -> str:
    prefix, _, name = qualified.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{name}"


def _corners(box: Box) -> dict[str, str]:
    return {name: _number(getattr(box, name)) for name in ("x1", "y1", "x2", "y2")}


def _number(value: float) -> str:
    return f"{value:.6g}"


def _identifier(name: str) -> str:
    """Name of the root system: OMSimulator takes letters, digits and underscores only."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in name)


def _text(root: ElementTree.Element) -> bytes:
    for prefix, namespace in NAMESPACES.items():
        ElementTree.register_namespace(prefix, namespace)
    ElementTree.register_namespace("osp", _ANNOTATIONS["com.opensimulationplatform"][0])
    ElementTree.register_namespace("oms", _ANNOTATIONS["org.openmodelica"][0])
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"
