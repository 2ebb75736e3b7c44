"""Model descriptions as fmpy reads and validates them, from XML that has been checked before.

What fmpy 0.3 stumbles over is taken out first: types of clocks, and attributes of types that it does not know.
"""

from __future__ import annotations

import io
import zipfile
from typing import TYPE_CHECKING

from fmpy.model_description import ModelDescription, ValidationError, read_model_description

from cosim.fmi.fmi3_description import expand_clock_types

if TYPE_CHECKING:
    from lxml.etree import _Element

DESCRIPTION = "modelDescription.xml"
SOURCES = "sources/buildDescription.xml"

#: Attributes of types and of items of enumerations that fmpy has a place for.
_OF_TYPES = frozenset(
    {"name", "description", "quantity", "unit", "displayUnit", "relativeQuantity", "min", "max", "nominal", "unbounded"}
)
_OF_ITEMS = frozenset({"name", "value", "description"})


def readable_by_fmpy(root: _Element, xml: bytes, sources: bytes | None) -> bytes:
    """An archive from which fmpy reads a model description.

    Parameters
    ----------
    root : Element
        Of the model description; what fmpy does not know is taken out of it.
    xml : bytes
        The file.
    sources : bytes, optional
        The build description.
    """
    from lxml import etree

    changed = expand_clock_types(root)
    changed |= _take_out(root)
    changed |= _put_in_order(root)
    if changed or b"<!--" in xml or b"<?" in xml[5:]:  # comments count as elements to fmpy
        xml = etree.tostring(root, encoding="UTF-8")
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as target:
        target.writestr(DESCRIPTION, xml)
        if sources is not None:
            target.writestr(SOURCES, sources)
    return archive.getvalue()


def _take_out(root: _Element) -> bool:
    """Take out attributes of types that fmpy has no place for; whether there were any."""
    below = "/*" if root.get("fmiVersion", "").startswith("3") else "/*/*"
    typed = [(e, _OF_TYPES) for e in root.iterfind(f"TypeDefinitions{below}") if e.tag not in ("Item", "ClockType")]
    typed += [(e, _OF_ITEMS) for e in root.iterfind("TypeDefinitions//Item")]
    further = [(element, name) for element, known in typed for name in element.attrib if name not in known]
    for element, name in further:
        del element.attrib[name]
    return bool(further)


def _put_in_order(root: _Element) -> bool:
    """Separate the numbers of lists by one space, as fmpy wants them; whether there were others."""
    changed = False
    for element in (*root.iterfind("ModelStructure//*"), *root.iterfind("ModelVariables/*[@clocks]")):
        for name in ("dependencies", "dependenciesKind", "clocks"):
            text = element.get(name)
            if text is None or (text and text == " ".join(text.split())):
                continue
            if text.strip() or name != "clocks":
                element.set(name, " ".join(text.split()))
            else:
                del element.attrib[name]
            changed |= element.get(name) != text
    return changed


def described(readable: bytes) -> ModelDescription:
    """The model description in an archive of `readable_by_fmpy`; fmpy raises bare exceptions."""
    return read_model_description(io.BytesIO(readable), validate=False)


def violations(readable: bytes) -> list[str]:
    """What fmpy finds: violations of the standard's schema, and of its rules for variables and the model structure.

    Its check of names is left out, which takes minutes for some of them; `check_description` has one.
    """
    try:
        read_model_description(io.BytesIO(readable), validate=True, validate_model_structure=True)
    except ValidationError as error:
        return [str(problem) for problem in error.problems]
    except Exception as error:  # fmpy raises bare exceptions
        return [str(error)]
    return []
