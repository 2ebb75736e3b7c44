"""Start values are data inside an FMU: in the model description, and in a file that its instances read.

`resources/start_values.txt` holds one line `name = value` for every parameter and input. Both places always hold the
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
from xml.etree import ElementTree as ET
from xml.sax.saxutils import quoteattr

from fmu_export.errors import ModelError
from fmu_export.package.archive import replace_members
from fmu_export.package.interface import Interface

MEMBER = "resources/start_values.txt"
DESCRIPTION = "modelDescription.xml"


class StartValueError(ModelError, ValueError):
    """Start values can't be written into an FMU; the message says why, and the file is unchanged."""


def start_values_text(interface: Interface) -> bytes:
    """Content of `resources/start_values.txt` for a new FMU."""
    return _to_text({v.name: v.start for v in interface.variables if v.start is not None})


def write_start_values(fmu: str | PathLike[str], values: Mapping[str, float]) -> None:
    """Change start values of parameters in an FMU file, atomically.

    Parameters
    ----------
    fmu : path
        An FMU with `resources/start_values.txt` (every FMU of this project).
    values : mapping
        Parameter name -> new start value, in the unit of the parameter.

    Raises
    ------
    StartValueError
        Not an FMU of this kind, an unknown parameter, or a value that is not finite or outside [min, max].
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
        ET.fromstring(description)
    except (ValueError, ET.ParseError) as error:
        raise StartValueError(f"{path}: start values can't be read: {error}") from None
    for name, value in values.items():
        _check(path, description, starts, name, value)
        starts[name] = float(value)
        xml = _replace_start(xml, name, float(value))
    try:
        replace_members(path, {DESCRIPTION: xml.encode("utf-8"), MEMBER: _to_text(starts)})
    except (zipfile.BadZipFile, zlib.error) as error:
        raise StartValueError(f"{path}: a damaged archive: {error}") from None


def _to_text(values: Mapping[str, float]) -> bytes:
    return "".join(f"{name} = {value!r}\n" for name, value in values.items()).encode()


def _from_text(text: bytes) -> dict[str, float]:
    pairs = (line.split(" = ") for line in text.decode().splitlines())
    return {name: float(value) for name, value in pairs}


def _check(path: Path, description: bytes, starts: Mapping[str, float], name: str, value: float) -> None:
    parameters = {n: e for n, e in _parameters(description).items() if n in starts}
    if name not in parameters:
        raise StartValueError(f"{path}: no parameter '{name}'; its parameters are {', '.join(parameters)}")
    if not math.isfinite(value):
        raise StartValueError(f"{path}: start value {value!r} of '{name}' is not a finite number")
    attributes = parameters[name]
    lower, upper = float(attributes.get("min", -math.inf)), float(attributes.get("max", math.inf))
    if not lower <= value <= upper:
        raise StartValueError(f"{path}: start value {value!r} of '{name}' is outside [{lower!r}, {upper!r}]")


def _parameters(description: bytes) -> dict[str, ET.Element]:
    """Real parameters by name -> the element that holds min, max and start, in FMI 2.0 and 3.0."""
    found = {}
    for variable in ET.fromstring(description).iterfind("ModelVariables/*"):
        attributes = variable.find("Real") if variable.tag == "ScalarVariable" else variable
        if variable.get("causality") == "parameter" and attributes is not None:
            found[variable.get("name", "")] = attributes
    return found


def _replace_start(xml: str, name: str, value: float) -> str:
    """Change one start attribute and nothing else of the text."""
    named = rf"[^>]*\bname={re.escape(quoteattr(name))}[^>]*"
    fmi2 = rf"<ScalarVariable\b{named}>\s*<Real\b[^>]*"
    fmi3 = rf"<Float64\b{named}"
    pattern = rf'((?:{fmi2}|{fmi3})\bstart=")[^"]*(")'
    changed, count = re.subn(pattern, lambda m: f"{m[1]}{value!r}{m[2]}", xml)
    if count != 1:
        raise StartValueError(f"modelDescription.xml: found {count} start values of '{name}' where one was expected")
    return changed
