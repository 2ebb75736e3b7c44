"""Start values are data inside an FMU: in the model description, and in a file that its instances read.

`resources/start_values.txt` holds one line `name = value` for every parameter and input, as in the model description:
true and false, the value of an enumeration's item, a string's text. Both places always hold the
same numbers; `write_start_values` changes them together, without a compiler.
"""

from __future__ import annotations

import math
import re
import zipfile
import zlib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET
from xml.sax.saxutils import escape, quoteattr

from fmu_export.errors import ArgumentError, ModelError
from fmu_export.modelling.variables import Type, Variable
from fmu_export.package.archive import replace_members
from fmu_export.package.interface import Interface, text_of

MEMBER = "resources/start_values.txt"
DESCRIPTION = "modelDescription.xml"


class StartValueError(ModelError, ValueError):
    """Start values can't be written into an FMU; the message says why, and the file is unchanged."""


def start_values_text(interface: Interface) -> bytes:
    """Content of `resources/start_values.txt` for a new FMU."""
    starts = {v.name: text_of(v.type, v.start, v.items) for v in interface.variables if v.start is not None}
    return _to_text(starts)


def write_start_values(fmu: str | PathLike[str], values: Mapping[str, float | bool | str]) -> None:
    """Change start values of parameters in an FMU file, atomically.

    Parameters
    ----------
    fmu : path
        An FMU with `resources/start_values.txt` (every FMU of this project).
    values : mapping
        Parameter name -> new start value, in the unit of the parameter; of an enumeration the name or the value of an
        item, of a string one of its texts.

    Raises
    ------
    StartValueError
        Not an FMU of this kind, an unknown parameter, or a value that is not finite, none of the parameter's type or
        outside [min, max].
    OSError
        The file can't be read or written; it is unchanged.
    """
    path = Path(fmu)
    try:
        with zipfile.ZipFile(path) as archive:
            description, text = archive.read(DESCRIPTION), archive.read(MEMBER)
    except (zipfile.BadZipFile, zlib.error):
        raise StartValueError(f"{path}: not an FMU (not a zip archive, or a damaged one)") from None
    except KeyError as error:
        raise StartValueError(
            f"{path}: no member {error.args[0]!r}; only FMUs that build_fmus.py wrote keep start values as data"
        ) from None
    try:
        starts, xml = _from_text(text), description.decode("utf-8")
        parameters = {
            name: (variable, i)
            for variable in _parameters(ET.fromstring(description))
            for i, name in enumerate(variable.names)
            if name in starts
        }
        for name, (variable, _) in parameters.items():
            if variable.type == "real":
                float(starts[name])
    except (ValueError, ET.ParseError) as error:
        raise StartValueError(f"{path}: start values can't be read: {error}") from None
    for name, value in values.items():
        starts[name] = _checked(path, parameters, name, value)
        variable, i = parameters[name]
        xml = _replace_start(xml, variable.name, i, starts[name])
    try:
        replace_members(path, {DESCRIPTION: xml.encode("utf-8"), MEMBER: _to_text(starts)})
    except (zipfile.BadZipFile, zlib.error) as error:
        raise StartValueError(f"{path}: a damaged archive: {error}") from None


def _to_text(values: Mapping[str, str]) -> bytes:
    return "".join(f"{name} = {value}\n" for name, value in values.items()).encode()


def _from_text(text: bytes) -> dict[str, str]:
    pairs = (line.split(" = ", 1) for line in text.decode().splitlines())
    return {name: value for name, value in pairs}  # noqa: C416, one that is no pair is an error


def _checked(path: Path, parameters: Mapping[str, tuple[Variable, int]], name: str, value: Any) -> str:
    """The text of a new start value."""
    if name not in parameters:
        raise StartValueError(f"{path}: no parameter '{name}'; its parameters are {', '.join(parameters)}")
    variable, _ = parameters[name]
    try:
        start = variable.number_of(value, f"start value of '{name}'")
    except ArgumentError as error:
        raise StartValueError(f"{path}: {error}") from None
    lower = -math.inf if variable.min is None else variable.min
    upper = math.inf if variable.max is None else variable.max
    if not lower <= start <= upper:
        raise StartValueError(f"{path}: start value {value!r} of '{name}' is outside [{lower!r}, {upper!r}]")
    return text_of(variable.type, start, variable.items)


#: Types of variables by the names of their elements in FMI 2.0 and 3.0.
_TYPES: dict[str, Type] = {
    "Real": "real",
    "Float64": "real",
    "Integer": "integer",
    "Int32": "integer",
    "Boolean": "boolean",
    "Enumeration": "enumeration",
    "String": "string",
}


def _parameters(description: ET.Element) -> list[Variable]:
    """Parameters, in FMI 2.0 and 3.0, without start values."""
    enumerations = {
        definition.get("name"): [(i.get("name", ""), int(i.get("value", ""))) for i in definition.iter("Item")]
        for definition in description.iterfind("TypeDefinitions/*")
    }
    found = []
    for variable in description.iterfind("ModelVariables/*"):
        of_fmi2 = [e for e in variable if e.tag in _TYPES] if variable.tag == "ScalarVariable" else [variable]
        if variable.get("causality") != "parameter" or not of_fmi2:
            continue
        attributes = of_fmi2[0]
        limits: dict[str, Any] = {n: float(attributes.get(n, "")) for n in ("min", "max") if n in attributes.attrib}
        texts = [(text.get("value", ""), i) for i, text in enumerate(variable.iterfind("Annotations/*/Texts/Text"))]
        name = variable.get("name", "")
        items = enumerations.get(attributes.get("declaredType"), texts)
        size = tuple(int(d.get("start", "")) for d in variable.iterfind("Dimension")) or None
        found.append(Variable(name, size=size, type=_TYPES[attributes.tag], items=tuple(items), **limits))
    return found


def _replace_start(xml: str, name: str, element: int, value: str) -> str:
    """Change one start value and nothing else of the text: of a scalar, or of an element of an array."""
    named = rf"[^>]*\bname={re.escape(quoteattr(name))}[^>]*"
    fmi2 = rf"<ScalarVariable\b{named}>\s*<(?:Real|Integer|Boolean|Enumeration|String)\b[^>]*\bstart"
    fmi3 = rf"<(?:Float64|Int32|Boolean|Enumeration)\b{named}\bstart"
    before = rf"(?:(?!</String>|<Start).)*(?:<Start[^>]*>\s*){{{element}}}"
    text = rf"<String\b{named}>{before}<Start value"
    pattern = re.compile(rf'((?:{fmi2}|{fmi3}|{text})=")([^"]*)(")', re.DOTALL)

    def changed(found: re.Match[str]) -> str:
        values = found[2].split(" ") if found[1].startswith("<") and "<S" not in found[1] else [""]
        values[element if len(values) > 1 else 0] = escape(value, {'"': "&quot;"})
        return found[1] + " ".join(values) + found[3]

    new, count = pattern.subn(changed, xml)
    if count != 1:
        raise StartValueError(f"modelDescription.xml: found {count} start values of '{name}' where one was expected")
    return new
