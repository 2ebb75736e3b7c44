"""What FMI 3.0 has in model descriptions and fmpy 0.3 does not read: clocks, and bounds of unsigned integers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

from fmpy.model_description import ModelDescription


def _is_true(text: str) -> bool:
    return text in ("true", "1")


#: Attribute of a variable -> what it is in Python.
_FURTHER: dict[str, Callable[[str], Any]] = {
    "intermediateUpdate": _is_true,
    "previous": int,
    "reinit": _is_true,
    "canBeDeactivated": _is_true,
    "priority": int,
    "intervalDecimal": float,
    "shiftDecimal": float,
    "supportsFraction": _is_true,
    "resolution": int,
    "intervalCounter": int,
    "shiftCounter": int,
}

#: Attributes of a clock's type that its variables take over.
_OF_CLOCKS = (
    "intervalVariability",
    *(name for name in _FURTHER if name not in ("intermediateUpdate", "previous", "reinit")),
)


def expand_clock_types(root: ElementTree.Element) -> bool:
    """Give clocks what their declared types say, and take the types away, which fmpy refuses; whether there are any."""
    types = {element.get("name"): element for element in root.iterfind("TypeDefinitions/ClockType")}
    for clock in root.iterfind("ModelVariables/Clock") if types else ():
        declared = types.get(clock.attrib.pop("declaredType", None))
        said = {} if declared is None else declared.attrib
        for name in _OF_CLOCKS:
            if name in said and name not in clock.attrib:
                clock.set(name, said[name])
    return bool(types)


def read_further_attributes(root: ElementTree.Element, description: ModelDescription) -> None:
    """Read them into the variables of a model description; an alias has those of its variable."""
    if description.fmiMajorVersion != 3:
        return
    for element in root.iterfind("CoSimulation"):  # in FMI 2.0 its name is in the singular
        directional = _is_true(element.get("providesDirectionalDerivatives", "false"))
        description.coSimulation.providesDirectionalDerivative = directional
    variables = {v.name: v for v in description.modelVariables}
    for element in root.iterfind("ModelVariables/*"):
        names = [element.get("name"), *(alias.get("name") for alias in element.iterfind("Alias"))]
        for variable in (variables[name] for name in names if name in variables):
            for name, convert in _FURTHER.items():
                if name in element.attrib:
                    setattr(variable, name, convert(element.attrib[name]))
            if element.tag.startswith("UInt"):
                variable.min, variable.max = element.get("min"), element.get("max")
