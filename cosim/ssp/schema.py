"""The XML files of an SSP, checked against the standard's schemas and decoded by them.

`xmlschema` validates and gives typed attributes with the schemas' defaults; the schemas come with `pyssp-standard`. Its
own object model is not used: like fmpy's, it loses what connections do to values (transformations, units).
"""

from __future__ import annotations

import importlib.util
import io
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, Literal

from cosim.errors import CosimError, MissingExtra, needs

with needs("ssp"):
    import xmlschema
    from xmlschema import DataElement

#: Description of the system, parameter set, parameter mapping.
Kind = Literal["ssd", "ssv", "ssm"]

NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
}

#: The variant of the description's schema in XML Schema 1.1 reaches into parameter sets and mappings that are inline.
_FILES = {
    "ssd": "SystemStructureDescription11.xsd",
    "ssv": "SystemStructureParameterValues.xsd",
    "ssm": "SystemStructureParameterMapping.xsd",
}


class SSPError(CosimError):
    """An SSP can't be read, run or written."""


def parse(data: bytes, kind: Kind, where: str) -> DataElement:
    """Validate an XML file and decode it.

    Parameters
    ----------
    data : bytes
    kind : {"ssd", "ssv", "ssm"}
    where : str
        Name of the file, for messages.

    Raises
    ------
    SSPError
        It is no XML, has entities or violates the schema; the message gives the first violation.
    MissingExtra
        The package with the schemas is not installed.
    """
    # a later version in the same namespace: the root element tells
    version = re.search(rb"<[^?!][^>]*\sversion\s*=\s*[\"']2[.]", data[:65536])
    try:
        source = xmlschema.XMLResource(io.BytesIO(data), defuse="always", allow="none")
        schema = _schema(kind, 2 if version else 1)
        result: Any = schema.to_objects(source, validation="lax", use_location_hints=False)
    except xmlschema.XMLSchemaException as problem:
        raise SSPError(f"{where}: not readable as XML: {' '.join(str(problem).split())}") from None
    decoded, errors = result
    if errors:
        error = errors[0]
        steps = re.sub(r"\w+:", "", (error.path or "").strip("/"))
        reason = " ".join(str(error.reason).split())
        raise SSPError(f"{where}: violates the SSP schema at {steps}: {reason}; mend it in the tool that wrote it")
    assert isinstance(decoded, DataElement)
    return decoded


def children(element: DataElement | None, *steps: str) -> Iterator[DataElement]:
    """Elements below one, by the local names on the way: `children(system, "Elements", "Component")`."""
    for child in element if element is not None else ():
        if local_name(child) == steps[0]:
            if len(steps) == 1:
                yield child
            else:
                yield from children(child, *steps[1:])


def child(element: DataElement | None, *steps: str) -> DataElement | None:
    """The first of `children`, if there is any."""
    return next(children(element, *steps), None)


def local_name(element: DataElement) -> str:
    """Name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


@cache
def _schema(kind: Kind, version: int) -> xmlschema.XMLSchemaBase:
    spec = importlib.util.find_spec("pyssp_standard")  # not imported, which takes most of a second
    if spec is None:
        raise MissingExtra("ssp", "pyssp-standard")
    assert spec.origin is not None
    resources = Path(spec.origin).parent / "resources"
    folder = resources / "ssp2" if version == 2 else resources
    return xmlschema.XMLSchema11(folder / _FILES[kind])
