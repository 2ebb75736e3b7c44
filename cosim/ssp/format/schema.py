"""The XML files of an SSP, checked against the standard's schemas and decoded by them.

`xmlschema` validates and gives typed attributes with the schemas' defaults; the schemas come with `pyssp-standard`. Its
own object model is not used: like fmpy's, it loses what connections do to values (transformations, units).
"""

from __future__ import annotations

import importlib.util
import io
import re
from functools import cache
from pathlib import Path
from typing import Any, Literal

from cosim.errors import MissingExtra, needs
from cosim.ssp.errors import SSPError
from cosim.system.read import Findings

with needs("ssp"):
    import xmlschema
    from xmlschema import DataElement

#: Description of the system, parameter set, parameter mapping, signal dictionary.
DocumentKind = Literal["ssd", "ssv", "ssm", "ssb"]

NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
    "ssb": "http://ssp-standard.org/SSP1/SystemStructureSignalDictionary",
}

#: The variant of the description's schema in XML Schema 1.1 reaches into parameter sets and mappings that are inline.
_FILES = {
    "ssd": "SystemStructureDescription11.xsd",
    "ssv": "SystemStructureParameterValues.xsd",
    "ssm": "SystemStructureParameterMapping.xsd",
    "ssb": "SystemStructureSignalDictionary.xsd",
}

#: Elements that say nothing of what is run; what is wrong in them does no harm.
_HARMLESS = ("Annotations", "Geometry", "GraphicalElements", "MetaData", "Signature")

#: Root element of each kind of file.
_ROOTS = {
    "ssd": "SystemStructureDescription",
    "ssv": "ParameterSet",
    "ssm": "ParameterMapping",
    "ssb": "SignalDictionary",
}

#: The prefix of an attribute in a tag.
_PREFIXED = rb"\s([A-Za-z_][\w.-]*):[\w.-]+\s*=\s*[\"']"

#: Elements that the reader finds wherever among their siblings they are.
_KNOWN = (
    "Connectors",
    "ParameterBindings",
    "Elements",
    "Connections",
    "SignalDictionaries",
    "Units",
    "Enumerations",
    "DefaultExperiment",
    "System",
    "Component",
    "SignalDictionaryReference",
    "ParameterValues",
    "ParameterMapping",
    "Parameters",
    "Annotations",
    "ElementGeometry",
    "SystemGeometry",
    "ConnectorGeometry",
    "ConnectionGeometry",
    "GraphicalElements",
    "DictionaryEntry",
)

#: Elements that are in the common namespace of SSP only.
_COMMON = (
    "LinearTransformation",
    "BooleanMappingTransformation",
    "IntegerMappingTransformation",
    "EnumerationMappingTransformation",
    "MapEntry",
    "Unit",
    "BaseUnit",
    "Item",
)


def parse(data: bytes, kind: DocumentKind, where: str, findings: Findings | None = None) -> DataElement:
    """Validate an XML file and decode it.

    Parameters
    ----------
    data : bytes
    kind : {"ssd", "ssv", "ssm", "ssb"}
    where : str
        Name of the file, for messages.
    findings : Findings, optional
        Takes notes of violations that leave no doubt of what is meant: elements and attributes that the schema does
        not know, or in another order, or lists of nothing. Without it these are errors, too.

    Raises
    ------
    SSPError
        It is not XML, has entities or violates the schema; the message gives the violations.
    MissingExtra
        The package with the schemas is not installed.
    """
    if findings is not None:
        data = _with_namespaces(data, where, findings)
    # a later version in the same namespace: the root element tells
    said = re.search(rb"<[^?!][^>]*\sversion\s*=\s*[\"']([^\"']*)", data[:65536])
    version = b"" if said is None else said[1].strip()
    if re.match(rb"[03-9]|[12]\d", version):
        raise SSPError(f"{where}: is of version {version.decode(errors='replace')} of SSP; 1.0 and 2.0 can be read")
    later = version.startswith(b"2.")
    decoded, refused, notes = _decoded(data, kind, 2 if later else 1, where, findings)
    if refused and findings is not None and not later:
        as_later = _decoded(data, kind, 2, where, findings)
        if not as_later[1]:
            decoded, refused, notes = as_later
            findings.note(f"{where}: is of version 1.0 by its own words, but has what 2.0 brought; it is read as 2.0")
    if refused:
        more = f" (and {len(refused) - 3} more)" if len(refused) > 3 else ""
        listed = "; ".join(refused[:3])
        raise SSPError(f"{where}: violates the SSP schema {listed}{more}; correct it in the tool that wrote it")
    for text, sort in notes:
        assert findings is not None
        findings.note(text, sort)
    assert isinstance(decoded, DataElement)
    return decoded


def _decoded(
    data: bytes, kind: DocumentKind, version: int, where: str, findings: Findings | None
) -> tuple[Any, list[str], list[tuple[str, str]]]:
    """Content of a file, violations that can't be forgiven, and notes of those that are, with their kinds."""
    try:
        try:
            source = xmlschema.XMLResource(io.BytesIO(data), defuse="always", allow="none")
        except (LookupError, ValueError) as unknown:  # an encoding that there is not, or that the parser does not take
            raise SSPError(f"{where}: not readable as XML: {' '.join(str(unknown).split())}") from None
        _check_namespace(source.root.tag, kind, where)
        moved = [] if findings is None else _with_common_names(source.root)
        schema = _schema(kind, version)
        result: Any = schema.to_objects(source, validation="lax", use_location_hints=False)
    except (xmlschema.XMLSchemaException, RecursionError) as problem:
        raise SSPError(f"{where}: not readable as XML: {' '.join(str(problem).split())}") from None
    decoded, errors = result
    refused, notes = [], []
    if moved:
        said = f"{where}: {', '.join(moved)}: taken as of the common namespace of SSP (ssc)"
        notes.append((said, f"{where}: common"))
    for error in errors:
        note = None if findings is None else _forgiven(error, where)
        if note is None:
            refused.append(f"at {_path(error)}: {_reason(error)}")
        elif note[0]:
            notes.append(note)
    return decoded, refused, notes


def _with_namespaces(data: bytes, where: str, findings: Findings) -> bytes:
    """The file with namespaces for prefixes that it uses and declares none for."""
    plain = re.sub(rb"<!--.*?-->|<!\[CDATA\[.*?\]\]>", lambda text: b" " * len(text[0]), data, flags=re.DOTALL)
    root = re.search(rb"<[A-Za-z_][^\s/>]*", plain)
    if root is None:
        return data
    used = re.findall(rb"<([A-Za-z_][\w.-]*):", plain)
    used += [prefix for tag in re.findall(rb"<[A-Za-z_][^<>]*>", plain) for prefix in re.findall(_PREFIXED, tag)]
    declared = {b"xml", b"xmlns", *re.findall(rb"xmlns:([\w.-]+)\s*=", plain)}
    added = ""
    for name in (prefix.decode() for prefix in dict.fromkeys(used) if prefix not in declared):
        added += f' xmlns:{name}="{NAMESPACES.get(name, f"urn:undeclared:{name}")}"'
        meant = "it is taken as that of SSP" if name in NAMESPACES else "what has it is ignored"
        findings.note(f"{where}: the prefix '{name}' has no namespace; {meant}")
    return data[: root.end()] + added.encode() + data[root.end() :]


def _with_common_names(root: Any) -> list[str]:
    """Give elements that SSP has in its common namespace only, but stand in another one of SSP, that namespace."""
    moved: dict[str, None] = {}
    for element in root.iter():
        namespace, _, name = str(element.tag).rpartition("}")
        if name in _COMMON and namespace[1:] in NAMESPACES.values() and namespace[1:] != NAMESPACES["ssc"]:
            element.tag = f"{{{NAMESPACES['ssc']}}}{name}"
            moved[name] = None
    return list(moved)


def _check_namespace(tag: str, kind: DocumentKind, where: str) -> None:
    namespace, _, name = tag.rpartition("}")
    if name != _ROOTS[kind]:
        raise SSPError(f"{where}: is a {name}, not a {_ROOTS[kind]} of SSP; check what names it")
    if namespace[1:] != NAMESPACES[kind]:
        what = f"the namespace '{namespace[1:]}'" if namespace else "no namespace"
        raise SSPError(
            f"{where}: its root element has {what}, as in drafts of SSP, and not '{NAMESPACES[kind]}', that of SSP 1.0 "
            "and 2.0; export it again with a tool that writes one of these"
        )


def _path(error: Any) -> str:
    return re.sub(r"\w+:", "", (error.path or "").strip("/"))


def _reason(error: Any) -> str:
    return " ".join(str(error.reason).split())


def _forgiven(error: Any, where: str) -> tuple[str, str] | None:
    """A note, and its kind, of a violation that leaves no doubt of what is meant; an empty note of a harmless one."""
    path, reason = _path(error), _reason(error)
    if any(name in path for name in _HARMLESS):
        return "", ""
    if isinstance(error, xmlschema.XMLSchemaChildrenValidationError):
        if "is not complete" in reason:
            return ("", "") if error.elem is not None and len(error.elem) == 0 else None  # a list of nothing
        known = error.invalid_tag is not None and error.invalid_tag.rpartition("}")[2] in _KNOWN
        what = "is not where the schema has it" if known else "is not of the standard and ignored"
        return f"{where}: at {path}: {reason.rstrip('.')}: it {what}", f"{where}: order {known}"
    unknown = re.match(r"'([^']*)' attribute not allowed", reason)
    if unknown is None:
        return None
    text = f"{where}: at {path}: attribute '{unknown[1]}' is not of the standard and ignored"
    return text, f"{where}: attribute"


@cache
def _schema(kind: DocumentKind, version: int) -> xmlschema.XMLSchemaBase:
    spec = importlib.util.find_spec("pyssp_standard")  # not imported, which takes most of a second
    if spec is None:
        raise MissingExtra("ssp", "pyssp-standard")
    assert spec.origin is not None
    resources = Path(spec.origin).parent / "resources"
    folder = resources / "ssp2" if version == 2 else resources
    return xmlschema.XMLSchema11(folder / _FILES[kind])
