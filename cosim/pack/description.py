"""Model descriptions of packed FMUs, of FMI 2.0 and 3.0."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any
from xml.etree import ElementTree as ET

from fmpy.model_description import SimpleType, Unit

from cosim.pack.interface import PackedVariable
from cosim.system.variables import Ports
from cosim.versions import package_version

#: The tool that made them, and whose annotations master and FMUs know.
_TOOL = "closed-chain-cosim"

#: Exponents of base units.
_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class About:
    """What a packed FMU says of itself.

    Attributes
    ----------
    name, identifier, token : str
        Of the model, of its library, and what ties description and plan together.
    description : str
    start_time, stop_time, step_size, tolerance : float or None
        Default experiment (s).
    saves_states, serializes_states, takes_any_step, resets_completely, only_once : bool
        Whether all components can get and set their states and serialise them, take steps of any length, reset
        completely; whether one of them can have but one instance in a process.
    author, version, copyright, license : str
        Empty where nothing is said.
    """

    name: str
    identifier: str
    token: str
    description: str = ""
    start_time: float = 0.0
    stop_time: float | None = None
    step_size: float | None = None
    tolerance: float | None = None
    saves_states: bool = False
    serializes_states: bool = False
    takes_any_step: bool = False
    resets_completely: bool = False
    only_once: bool = False
    further: Mapping[str, str] = field(default_factory=dict)


def model_description(
    about: About, variables: Iterable[PackedVariable], ports: Mapping[str, Ports], version: int
) -> bytes:
    """The model description of a packed FMU; value references are the positions of its variables.

    Parameters
    ----------
    about : About
    variables : iterable of PackedVariable
    ports : mapping
        Component -> its variables.
    version : {2, 3}
        Of FMI.

    Returns
    -------
    bytes
        UTF-8, the same for the same arguments.
    """
    return _Writer(about, list(variables), ports, version).bytes()


class _Writer:
    def __init__(self, about: About, variables: list[PackedVariable], ports: Mapping[str, Ports], version: int) -> None:
        self._about, self._variables, self._ports, self._version = about, variables, ports, version
        self._units: dict[str, tuple[str, Unit]] = {}  # what tells it apart -> name here
        self._types: dict[str, tuple[str, SimpleType]] = {}

    def bytes(self) -> bytes:
        about = self._about
        token = "guid" if self._version == 2 else "instantiationToken"
        root = ET.Element(
            "fmiModelDescription",
            {
                "fmiVersion": f"{self._version}.0",
                "modelName": about.name,
                token: about.token,
                **({"description": about.description} if about.description else {}),
                **about.further,
                "generationTool": f"{_TOOL} {package_version()} (packed system)",
                "variableNamingConvention": "flat",
            },
        )
        root.append(self._interface())
        elements = [self._variable(i, v) for i, v in enumerate(self._variables)]
        if self._units:
            root.append(self._unit_definitions())
        if self._types:
            root.append(self._type_definitions())
        categories = ET.SubElement(root, "LogCategories")
        for name in ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll"):
            ET.SubElement(categories, "Category", name=name)
        times = {
            "startTime": about.start_time,
            "stopTime": about.stop_time,
            "tolerance": about.tolerance,
            "stepSize": about.step_size,
        }
        ET.SubElement(root, "DefaultExperiment", {k: repr(v) for k, v in times.items() if v is not None})
        if about.resets_completely and self._version == 2:
            root.append(self._annotation("VendorAnnotations", "Tool", "name"))
        of_model = ET.SubElement(root, "ModelVariables")
        if self._version == 3:
            ET.SubElement(
                of_model,
                "Float64",
                name="time",
                valueReference=str(len(elements)),
                causality="independent",
                variability="continuous",
            )
        of_model.extend(elements)
        root.append(self._structure())
        if about.resets_completely and self._version == 3:
            root.append(self._annotation("Annotations", "Annotation", "type"))
        ET.indent(root)
        text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
        return text + b"\n"

    @staticmethod
    def _annotation(outer: str, inner: str, key: str) -> ET.Element:
        annotations = ET.Element(outer)
        ET.SubElement(ET.SubElement(annotations, inner, {key: _TOOL}), "Instance", resetIsComplete="true")
        return annotations

    def _interface(self) -> ET.Element:
        about = self._about
        says = {
            "canHandleVariableCommunicationStepSize": about.takes_any_step,
            "canBeInstantiatedOnlyOncePerProcess": about.only_once,
        }
        if self._version == 2:
            says |= {
                "canInterpolateInputs": True,
                "canNotUseMemoryManagementFunctions": True,
                "canGetAndSetFMUstate": about.saves_states,
                "canSerializeFMUstate": about.serializes_states,
            }
        else:
            says |= {
                "providesIntermediateUpdate": True,
                "canGetAndSetFMUState": about.saves_states,
                "canSerializeFMUState": about.serializes_states,
            }
        attributes = {key: "true" for key, value in says.items() if value}
        return ET.Element("CoSimulation", {"modelIdentifier": about.identifier, **attributes})

    # Variables

    def _variable(self, reference: int, variable: PackedVariable) -> ET.Element:
        attributes = {"name": variable.name, "valueReference": str(reference)}
        if description := self._description_of(variable):
            attributes["description"] = description
        attributes |= {"causality": variable.causality, "variability": variable.variability}
        if variable.causality == "parameter":
            attributes["initial"] = "exact"
        elif variable.causality == "output":
            attributes["initial"] = "calculated"
        further = self._further(variable)
        start = None if variable.start is None else _written(variable.start)
        if self._version == 2:
            element = ET.Element("ScalarVariable", attributes)
            ET.SubElement(element, variable.type, further | ({} if start is None else {"start": start}))
            return element
        if variable.causality == "input" and variable.type == "Float64" and variable.variability == "continuous":
            attributes["intermediateUpdate"] = "true"
        element = ET.Element(variable.type, attributes | further)
        if start is not None and variable.type == "String":
            ET.SubElement(element, "Start", value=start)
        elif start is not None:
            element.set("start", start)
        return element

    @staticmethod
    def _description_of(variable: PackedVariable) -> str:
        if variable.element is None:
            return "Longest internal communication step; communication steps are split into equal ones"
        return str(variable.element.variable.description or "")

    def _further(self, variable: PackedVariable) -> dict[str, str]:
        """Unit, bounds and declared type of a variable."""
        element = variable.element
        if element is None:
            return {"unit": self._unit(Unit(name="s", baseUnit=_second()))}
        own, declared = element.variable, element.variable.declaredType
        found: dict[str, str] = {}
        if variable.type == "Enumeration" and declared is not None:
            found["declaredType"] = self._type(declared)
        if variable.type in ("Boolean", "String"):
            return found
        if element.kind == "real" and (unit := self._ports[variable.component].unit(element)) is not None:
            found["unit"] = self._unit(unit)
            display = own.displayUnit or (declared.displayUnit if declared is not None else None)
            if display and display in {d.name for d in unit.displayUnits}:
                found["displayUnit"] = display
        for key in ("quantity", "min", "max", "nominal"):
            value = getattr(own, key, None)
            if value is None and declared is not None and variable.type != "Enumeration":
                value = getattr(declared, key, None)
            if value not in (None, "") and (key != "nominal" or element.kind == "real"):
                found[key] = str(value)
        if element.kind == "real" and self._ports[variable.component].is_relative(element):
            found["relativeQuantity"] = "true"
        return found

    def _unit(self, unit: Unit) -> str:
        """Name of a unit here: that of its FMU, unless another FMU has another unit of that name."""
        key = _unit_key(unit)
        if key not in self._units:
            taken = {name for name, _ in self._units.values()}
            names = (unit.name, *(f"{unit.name} ({k})" for k in range(2, len(taken) + 3)))
            self._units[key] = next(n for n in names if n not in taken), unit
        return self._units[key][0]

    def _type(self, declared: SimpleType) -> str:
        key = repr((declared.name, [(i.name, i.value) for i in declared.items]))
        if key not in self._types:
            taken = {name for name, _ in self._types.values()} | {v.name for v in self._variables}
            names = (declared.name, *(f"{declared.name} ({k})" for k in range(2, len(taken) + 3)))
            self._types[key] = next(n for n in names if n not in taken), declared
        return self._types[key][0]

    def _unit_definitions(self) -> ET.Element:
        definitions = ET.Element("UnitDefinitions")
        for name, unit in self._units.values():
            element = ET.SubElement(definitions, "Unit", name=name)
            if unit.baseUnit is not None:
                base = unit.baseUnit
                exponents = {k: str(int(getattr(base, k))) for k in _BASE if getattr(base, k)}
                scale = {k: repr(float(getattr(base, k))) for k in ("factor", "offset")}
                scale = {k: v for k, v in scale.items() if v != {"factor": "1.0", "offset": "0.0"}[k]}
                ET.SubElement(element, "BaseUnit", exponents | scale)
            for display in unit.displayUnits:
                scale = {k: repr(float(getattr(display, k))) for k in ("factor", "offset")}
                ET.SubElement(element, "DisplayUnit", {"name": display.name, **scale})
        return definitions

    def _type_definitions(self) -> ET.Element:
        definitions = ET.Element("TypeDefinitions")
        for name, declared in self._types.values():
            if self._version == 2:
                outer = ET.SubElement(definitions, "SimpleType", name=name)
                element = ET.SubElement(outer, "Enumeration")
            else:
                element = ET.SubElement(definitions, "EnumerationType", name=name)
            for item in declared.items:
                more = {"description": str(item.description)} if item.description else {}
                ET.SubElement(element, "Item", {"name": str(item.name), "value": str(item.value), **more})
        return definitions

    # Structure

    def _structure(self) -> ET.Element:
        structure = ET.Element("ModelStructure")
        places = {variable.name: i for i, variable in enumerate(self._variables)}
        outputs = [(i, v) for i, v in enumerate(self._variables) if v.causality == "output"]
        if self._version == 3:
            for i, v in outputs:
                dependencies = " ".join(str(k) for k in sorted(places[n] for n in v.dependencies))
                ET.SubElement(structure, "Output", valueReference=str(i), dependencies=dependencies)
            for i, _ in outputs:
                ET.SubElement(structure, "InitialUnknown", valueReference=str(i))
            return structure
        if not outputs:
            return structure
        known = ET.SubElement(structure, "Outputs")
        for i, v in outputs:
            dependencies = " ".join(str(k + 1) for k in sorted(places[n] for n in v.dependencies))
            ET.SubElement(known, "Unknown", index=str(i + 1), dependencies=dependencies)
        initial = ET.SubElement(structure, "InitialUnknowns")
        for i, _ in outputs:
            ET.SubElement(initial, "Unknown", index=str(i + 1))
        return structure


def _second() -> Any:
    from fmpy.model_description import BaseUnit

    return BaseUnit(s=1)


def _unit_key(unit: Unit) -> str:
    base = unit.baseUnit
    numbers = None if base is None else [float(getattr(base, k)) for k in (*_BASE, "factor", "offset")]
    return repr((unit.name, numbers))


def _written(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)
