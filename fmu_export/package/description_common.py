"""What the model descriptions of FMI 2.0 and 3.0 have in common."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from xml.etree import ElementTree as ET

from fmu_export.modelling.model import Model
from fmu_export.modelling.units import conversion, unit
from fmu_export.package.interface import Interface, Items, ScalarVariable, text_of

#: Name of this project as a distribution, which FMUs carry as the tool that made them.
DISTRIBUTION = "closed-chain-cosim"


@cache  # it takes a while to look up
def package_version() -> str:
    """Version of the installed distribution; "0+unknown" in a checkout that was never installed."""
    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return "0+unknown"


def add_units(root: ET.Element, interface: Interface, *others: str) -> None:
    """Add the definitions of the units of variables, and of others by name, each once."""
    definitions = ET.SubElement(root, "UnitDefinitions")
    reals = [v for v in interface.variables if v.type == "real"]
    for name in dict.fromkeys([*(v.unit for v in reals), *others]):
        found = unit(name)
        element = ET.SubElement(definitions, "Unit", name=name)
        base = {k: str(n) for k, n in found.exponents.items()}
        ET.SubElement(element, "BaseUnit", base | _line(found.factor, found.offset))
        shown = [v.display_unit for v in interface.variables if v.unit == name and v.display_unit is not None]
        for display in dict.fromkeys([*found.display, *shown]):
            ET.SubElement(element, "DisplayUnit", {"name": display, **_line(*conversion(name, display))})


def _line(factor: float, offset: float) -> dict[str, str]:
    """Factor and offset where they are not what they are by default."""
    return {k: repr(v) for k, v, default in (("factor", factor, 1.0), ("offset", offset, 0.0)) if v != default}


def add_log_categories(root: ET.Element) -> None:
    """Add the names of the log categories."""
    categories = ET.SubElement(root, "LogCategories")
    for name in ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll"):
        ET.SubElement(categories, "Category", name=name)


def add_default_experiment(root: ET.Element, model: Model) -> None:
    """Add duration and step that the model proposes."""
    experiment = model.default_experiment
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime=repr(experiment.start_time),
        stopTime=repr(experiment.stop_time),
        stepSize=repr(experiment.step_size),
    )


def indicator_attributes(name: str, reference: int) -> dict[str, str]:
    """Attributes of the variable of an event indicator."""
    return {
        "name": name,
        "valueReference": str(reference),
        "description": f"Event indicator of: {name.rpartition('.')[0]}",
        "causality": "local",
        "variability": "continuous",
        "initial": "calculated",
    }


def instance_annotation() -> ET.Element:
    """What the standard has no attribute for: reset instances are as new ones, and the order of input derivatives."""
    return ET.Element("Instance", resetIsComplete="true", maxInputDerivativeOrder="3")


def type_attributes(v: ScalarVariable, types: Mapping[Items, str]) -> dict[str, str]:
    """What a variable says of its values but the start value: unit, limits, items; floats read back bit for bit."""
    attributes = {}
    if v.type == "enumeration":
        attributes["declaredType"] = types[v.items]
    if v.type == "real":
        attributes["unit"] = v.unit
        display = next(iter(unit(v.unit).display), None) if v.display_unit is None else v.display_unit
        if display is not None:
            attributes["displayUnit"] = display
    numbers = {"min": v.min, "max": v.max, "nominal": v.nominal}
    return attributes | {name: text_of(v.type, value) for name, value in numbers.items() if value is not None}


def enumeration_types(interface: Interface) -> dict[Items, str]:
    """Name of a type definition for each set of items of an enumeration."""
    names: dict[Items, str] = {}
    taken = {v.name for v in interface.variables}
    for v in interface.variables:
        if v.type == "enumeration" and v.items not in names:
            name = re.sub(r"\W", "_", re.sub(r"\[[0-9,]*\]", "", v.name)) + "_items"
            while name in taken:
                name += "_"
            names[v.items] = name
            taken.add(name)
    return names


def add_items(parent: ET.Element, items: Items) -> None:
    """Add the items of an enumeration."""
    for name, value in items:
        ET.SubElement(parent, "Item", name=name, value=str(value))


def add_texts(parent: ET.Element, v: ScalarVariable) -> None:
    """Add the texts that a string can be, which FMI can't declare."""
    texts = ET.SubElement(parent, "Texts")
    for text, _ in v.items:
        ET.SubElement(texts, "Text", value=text)


def to_bytes(root: ET.Element) -> bytes:
    """The finished document, UTF-8, indented."""
    ET.indent(root)
    if any("{" in name for element in root.iter() for name in (element.tag, *element.keys())):  # of a namespace
        text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
        return text + b"\n"
    # many variables are written several times faster so
    parts = ["<?xml version='1.0' encoding='utf-8'?>\n"]
    _add_text(parts, root)
    return ("".join(parts) + "\n").encode("utf-8", "xmlcharrefreplace")


#: What attributes and texts can't hold as it is, in the order of replacement.
_ESCAPED = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
_ESCAPED_IN_ATTRIBUTES = {**_ESCAPED, '"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#09;"}
_SPECIAL = re.compile(r"[&<>\"\r\n\t]")


def _add_text(parts: list[str], element: ET.Element) -> None:
    """Append an element without namespaces, with what is in it and what follows it, as ElementTree writes it."""
    parts.append(f"<{element.tag}")
    for name, value in element.items():
        parts.append(f' {name}="{_escaped(value, _ESCAPED_IN_ATTRIBUTES)}"')
    if element.text or len(element):
        parts.append(f">{_escaped(element.text or '', _ESCAPED)}")
        for child in element:
            _add_text(parts, child)
        parts.append(f"</{element.tag}>")
    else:
        parts.append(" />")
    parts.append(_escaped(element.tail or "", _ESCAPED))


def _escaped(text: str, escaped: Mapping[str, str]) -> str:
    if _SPECIAL.search(text):
        for character, written in escaped.items():
            text = text.replace(character, written)
    return text
