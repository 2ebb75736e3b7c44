"""The elements of a system description as a tree: systems, their components, connectors and connections."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from fmpy.model_description import Unit

from cosim.errors import nearest
from cosim.files.xml_elements import child, children, local_name
from cosim.fmi.fmu_file import load
from cosim.fmi.interfaces import AUTO_INTERFACE, CO_SIMULATION, MODEL_EXCHANGE
from cosim.ssp.errors import SSPError
from cosim.ssp.format.document import Definitions, Document, open_document, read_definitions
from cosim.ssp.format.package import DESCRIPTION, Archive
from cosim.ssp.format.schema import parse
from cosim.system.read import Findings
from cosim.system.units import UnitsDiffer, conversion
from cosim.system.variables import Element, Ports

if TYPE_CHECKING:
    from xmlschema import DataElement

#: Between the names of nested elements in the name of a component: the dot begins the name of the variable.
SEPARATOR = "/"

#: Arrays that are larger are refused, before names of their elements fill the memory.
_MOST_SCALARS = 1_000_000

#: Systems that are nested deeper than this are refused; no person made them.
_MOST_NESTED = 30

_FMU_TYPES = ("application/x-fmu-sharedlibrary", "application/x-fmu")
_PACKAGE_TYPE = "application/x-ssp-package"
_DESCRIPTION_TYPE = "application/x-ssp-definition"

#: Kinds of connectors out of which values come, for an element of a system; those of the system itself are the others.
GIVING = ("output", "calculatedParameter", "local", "constant")
TAKING = ("input", "parameter", "structuralParameter")

DICTIONARY_TYPE = "application/x-ssp-signal-dictionary"


@dataclass(frozen=True)
class Connector:
    """A connector with the names of its scalar values: one, or those of an array's elements."""

    name: str
    kind: str
    unit: Unit | None
    scalars: tuple[str, ...]


@dataclass(frozen=True)
class Dictionary:
    """A signal dictionary: the path under which its signals are known, and their connectors."""

    path: str
    signals: dict[str, Connector]


#: Implementation of a component in an SSP -> interface of its FMU, None for whichever it has.
IMPLEMENTATIONS = {"any": None, "CoSimulation": CO_SIMULATION, "ModelExchange": MODEL_EXCHANGE}


@dataclass
class Part:
    """A system, a component, or a reference to a signal dictionary.

    Attributes
    ----------
    path : str
        Names of the elements from the root system on, which itself has none.
    element : DataElement
        With the elements and connections of a system.
    document : Document
        The description that the element is of.
    bindings : list of (element, document)
        Holders of parameter bindings, in order.
    connectors : mapping
    parts : mapping
        Elements of a system by name; empty for a component.
    dictionaries : mapping
        Signal dictionaries of a system.
    dictionary : Dictionary, optional
        What a reference refers to.
    ports : Ports, optional
        Variables of a component.
    fmu : Path, optional
        The FMU of a component.
    interface : str, optional
        Interface of the FMU that is meant, if one is.
    source : str, optional
        Its name in the package.
    broken : set of str
        Elements and connectors that could not be read; what refers to them is no problem of its own.
    """

    path: str
    element: DataElement
    document: Document
    bindings: list[tuple[DataElement, Document]] = field(default_factory=list)
    connectors: dict[str, Connector] = field(default_factory=dict)
    parts: dict[str, Part] = field(default_factory=dict)
    dictionaries: dict[str, Dictionary] = field(default_factory=dict)
    dictionary: Dictionary | None = None
    ports: Ports | None = None
    fmu: Path | None = None
    interface: str | None = None
    source: str | None = None
    broken: set[str] = field(default_factory=set)

    def all_parts(self) -> Iterator[Part]:
        """Itself and all parts below it."""
        yield self
        for part in self.parts.values():
            yield from part.all_parts()

    @cached_property
    def variables(self) -> dict[str, list[Element]]:
        """Elements of the variables of a component, by the names that the standard has for them."""
        assert self.ports is not None
        found = {e.name: [e] for e in self.ports.all_elements()}
        for element in self.ports.all_elements():
            if element.variable.name != element.name:
                found.setdefault(element.variable.name, []).append(element)
        return found

    @cached_property
    def units(self) -> Definitions:
        """The units that the FMU of a component defines."""
        assert self.ports is not None
        return Definitions({u.name: u for u in self.ports.description.unitDefinitions})


def read_structure(document: Document) -> Part:
    """Read the tree of a system, and the model descriptions of its FMUs, which are unpacked.

    Elements that can't be run, or differ from their FMUs, become problems of the document's findings.
    """
    root = next(children(document.content, "System"))
    tree = _system(root, "", document, {})
    for path, count in Counter(part.path for part in tree.all_parts()).items():
        if count > 1:
            document.findings.problem(
                f"{document.package.path}: there are two elements named '{path}'; give each its own name"
            )
    return tree


def _system(element: DataElement, path: str, document: Document, dictionaries: dict[str, Dictionary]) -> Part:
    part = Part(path, element, document, [(element, document)])
    findings = document.findings
    if path.count(SEPARATOR) > _MOST_NESTED:
        findings.problem(f"{document.where}: systems are nested more than {_MOST_NESTED} times; no system needs that")
        return part
    for connector in children(element, "Connectors", "Connector"):
        with findings.collecting():
            part.connectors[connector.attrib["name"]] = _system_connector(connector, document)
    for dictionary in children(element, "SignalDictionaries", "SignalDictionary"):
        with findings.collecting():
            part.dictionaries[dictionary.attrib["name"]] = _dictionary(dictionary, path, document)
    known = dictionaries | part.dictionaries
    for inner in child(element, "Elements") or ():
        name = inner.attrib["name"]
        # a dot is allowed in SSP; to the standard B.C may be a component of that name, or C in the system B
        below = (path + SEPARATOR if path else "") + name.replace(".", SEPARATOR)
        part.broken.add(name)
        with findings.collecting():
            if name in part.parts:
                raise SSPError(
                    f"{document.package.path}: there are two elements named '{below}'; give each its own name"
                )
            kind = local_name(inner)
            if kind == "System":
                part.parts[name] = _system(inner, below, document, known)
            elif kind == "SignalDictionaryReference":
                part.parts[name] = _reference(inner, below, document, known)
            else:
                part.parts[name] = _component(inner, below, document)
            part.broken.remove(name)
    return part


def _system_connector(connector: DataElement, document: Document) -> Connector:
    name = connector.attrib["name"]
    here = f"{document.where}: connector '{name}'"
    unit = _defined(_unit(connector, document), here, document.findings)
    return Connector(name, connector.attrib["kind"], unit, _scalars(connector, document))


def _scalars(element: DataElement, document: Document) -> tuple[str, ...]:
    """Names of the values of a connector or a signal, which may be an array."""
    name = element.attrib["name"]
    sizes = [int(d.attrib["size"]) for d in children(element, "Dimension") if "size" in d.attrib]
    if not sizes:
        return (name,)
    if math.prod(sizes) > _MOST_SCALARS:
        raise SSPError(
            f"{document.package.path}: connector '{name}' has {math.prod(sizes)} values, more than any system needs"
        )
    return tuple(f"{name}[{','.join(map(str, i))}]" for i in product(*(range(1, n + 1) for n in sizes)))


# Signal dictionaries


def _dictionary(element: DataElement, path: str, document: Document) -> Dictionary:
    name = element.attrib["name"]
    here = f"{document.where}: signal dictionary '{name}'"
    kind = element.attrib.get("type", DICTIONARY_TYPE)
    if kind != DICTIONARY_TYPE:
        raise SSPError(f"{here} is of type {kind}, which is not supported; use {DICTIONARY_TYPE}")
    source = element.attrib.get("source")
    content: DataElement | None
    if source is not None:
        file = document.package.name_of(source, document.name)
        where = document.package.where(file)
        content = parse(document.package.read_xml(file), "ssb", where, document.findings)
    else:
        content = child(element, "SignalDictionary")
    if content is None:
        raise SSPError(f"{here} has neither a source nor a SignalDictionary; give it one")
    definitions = read_definitions(content)
    signals = {
        entry.attrib["name"]: Connector(
            entry.attrib["name"],
            "inout",
            _defined(_unit(entry, document, definitions), here, document.findings),
            _scalars(entry, document),
        )
        for entry in children(content, "DictionaryEntry")
    }
    return Dictionary(f"{path}{SEPARATOR}{SEPARATOR}{name}", signals)


def _reference(element: DataElement, path: str, document: Document, known: dict[str, Dictionary]) -> Part:
    """A reference, whose connectors are signals of the nearest dictionary of that name."""
    wanted = element.attrib["dictionary"]
    if wanted not in known:
        raise SSPError(
            f"{document.where}: '{path}' refers to a signal dictionary '{wanted}', which does not exist; "
            f"{nearest(wanted, known)}"
        )
    dictionary = known[wanted]
    part = Part(path, element, document, dictionary=dictionary)
    for connector in children(element, "Connectors", "Connector"):
        name = connector.attrib["name"]
        part.broken.add(name)
        with document.findings.collecting():
            if name not in dictionary.signals:
                hint = nearest(name, dictionary.signals)
                raise SSPError(f"{document.where}: '{path}': dictionary '{wanted}' has no signal '{name}'; {hint}")
            signal = dictionary.signals[name]
            here = f"{document.where}: '{path}': connector '{name}'"
            unit = _defined(_unit(connector, document), here, document.findings) or signal.unit
            part.connectors[name] = Connector(name, connector.attrib["kind"], unit, signal.scalars)
            part.broken.remove(name)
    return part


# Components


def _component(element: DataElement, path: str, document: Document) -> Part:
    here = f"{document.package.path}: component '{path}'"
    source = element.attrib.get("source")
    if not source:
        raise SSPError(f"{here} has no source; give it an FMU")
    kind = element.attrib.get("type", _FMU_TYPES[0]).partition(";")[0].strip()
    if kind in (_PACKAGE_TYPE, _DESCRIPTION_TYPE):
        return _nested(element, path, document, kind, source)
    if kind not in _FMU_TYPES:
        raise SSPError(f"{here} is of type {kind}, which is not supported; use an FMU, an SSP or an SSD")
    if source.partition("#")[0].lower().endswith((".ssp", ".ssd")):
        raise SSPError(f"{here} is an FMU by its type, but '{source}' is not one; set type to {_PACKAGE_TYPE}")
    implementation = element.attrib.get("implementation", "any")
    if implementation not in IMPLEMENTATIONS:
        raise SSPError(
            f"{here} is meant for {implementation}; only co-simulation and model exchange are supported, "
            "export the FMU for one of them and set implementation to it"
        )
    interface = IMPLEMENTATIONS[implementation]
    name = _located(document, source, here)
    fmu = document.package.unpack(name, document.folder)
    ports = Ports(path, load(path, fmu, interface or AUTO_INTERFACE).description)
    part = Part(path, element, document, [(element, document)], ports=ports, fmu=fmu, source=name, interface=interface)
    for connector in children(element, "Connectors", "Connector"):
        name = connector.attrib["name"]
        part.broken.add(name)
        with document.findings.collecting():
            part.connectors[name] = _component_connector(connector, part, here)
            part.broken.remove(name)
    return part


def _located(document: Document, source: str, here: str) -> str:
    """Name of the file of a component in its package."""
    try:
        return document.package.name_of(source, document.name)
    except SSPError as error:
        raise SSPError(f"{here}: {str(error).removeprefix(f'{document.package.path}: ')}") from None


def _nested(element: DataElement, path: str, document: Document, kind: str, source: str) -> Part:
    """A component that is a system of another description, or of this one."""
    here = f"{document.package.path}: component '{path}'"
    inner, root = _description_of(document, kind, source, here, path)
    part = _system(root, path, inner, {})
    part.bindings.append((element, document))
    for connector in children(element, "Connectors", "Connector"):
        name, outer_kind = connector.attrib["name"], connector.attrib["kind"]
        if name not in part.connectors:
            hint = nearest(name, part.connectors)
            document.findings.problem(f"{here}: system '{source}' has no connector '{name}'; {hint}")
        elif part.connectors[name].kind != outer_kind:
            document.findings.problem(
                f"{here}: connector '{name}' is of kind {outer_kind}, but {part.connectors[name].kind} "
                f"in '{source}'; correct it"
            )
    return part


def _description_of(document: Document, kind: str, source: str, here: str, path: str) -> tuple[Document, DataElement]:
    """The description that a component is of, and the system in it."""
    address, _, fragment = source.partition("#")
    if not address:
        inner = _below(document, document, f"{document.where}#{fragment}", here)
        for part in document.content.iter():
            if local_name(part) == "System" and part.attrib.get("id") == fragment:
                return inner, part
        raise SSPError(f"{here}: no system of this description has the id '{fragment}'; correct the source")
    name = _located(document, address, here)
    if kind == _DESCRIPTION_TYPE:
        opened = open_document(document.package, name, document.folder, document.ignore_units)
        inner = _below(opened, document, opened.where, here)
    else:
        said = f"{document.package.path}: {name}"
        package = Archive(document.package.unpack(name, document.folder), document.findings, Path(said))
        document.package.close_with_it(package)
        folder = document.folder / f"{path}.unpacked"
        opened = open_document(package, fragment or DESCRIPTION, folder, document.ignore_units)
        inner = _below(opened, document, f"{said}#{fragment}", here)
    return inner, next(children(inner.content, "System"))


def _below(inner: Document, outer: Document, identity: str, here: str) -> Document:
    """A description below another; one that has itself as a component has no end."""
    above = (*outer.above, outer.where)
    if identity in outer.above or len(above) > _MOST_NESTED:
        raise SSPError(f"{here}: the system has itself as a component; cut this circle")
    return dataclasses.replace(inner, above=(*above, identity))


def _component_connector(connector: DataElement, part: Part, here: str) -> Connector:
    name, kind = connector.attrib["name"], connector.attrib["kind"]
    elements = part.variables.get(name)
    if elements is None:
        hint = nearest(name, part.variables)
        raise SSPError(f"{here}: the FMU has no variable for connector '{name}'; {hint}")
    own = _variable_connector(part, name)
    findings = part.document.findings
    if kind not in (own.kind, "inout", "unspecified"):
        if (kind in GIVING) != (own.kind in GIVING):
            raise SSPError(
                f"{here}: connector '{name}' is of kind {kind}, but the variable of the FMU is {own.kind}; correct it"
            )
        if elements[0].variable.variability != "constant":
            findings.note(
                f"{here}: connector '{name}' is of kind {kind}, but the variable of the FMU is {own.kind}, which holds",
                "kinds of connectors",
            )
    declared = _unit(connector, part.document)
    if declared is None or part.document.ignore_units:
        return own
    if own.unit is None:
        return dataclasses.replace(own, unit=_defined(declared, here, findings))
    if declared.baseUnit is None:
        if declared.name != own.unit.name:
            findings.note(
                f"{here}: unit '{declared.name}' of connector '{name}' is not defined; "
                f"it is taken in the FMU's, '{own.unit.name}'",
                "units of connectors",
            )
        return own
    try:
        same = conversion(declared, own.unit, relative=False) == (1.0, 0.0)
    except UnitsDiffer:
        same = False
    if not same:
        raise SSPError(
            f"{here}: connector '{name}' is in '{declared.name}', but the FMU in '{own.unit.name}'; correct it, "
            "or ignore units (--units ignore)"
        )
    return own  # the FMU's unit comes with a definition for sure


def _variable_connector(part: Part, name: str) -> Connector:
    """A connector for a variable of a component, as the FMU has it."""
    assert part.ports is not None
    elements = part.variables[name]
    unit = part.ports.unit(elements[0])
    return Connector(name, str(elements[0].variable.causality), unit, tuple(e.name for e in elements))


def _unit(typed: DataElement, document: Document, definitions: Definitions | None = None) -> Unit | None:
    name = next((t.attrib["unit"] for t in typed if "unit" in t.attrib), None)
    if name == "":
        document.findings.note(f"{document.where}: units that are empty are taken for none")
    return document.unit(name, definitions)


def _defined(unit: Unit | None, here: str, findings: Findings) -> Unit | None:
    """A unit with a definition; others are none."""
    if unit is None or unit.baseUnit is not None:
        return unit
    findings.note(f"{here}: unit '{unit.name}' is not defined, so nothing is converted by it", "undefined units")
    return None


def find_connector(system: Part, element: str | None, name: str, here: str) -> tuple[Part, Connector]:
    """A connector of a system, or of one of its elements.

    Raises
    ------
    SSPError
        There is none; the message offers the nearest one.
    """
    part = system
    if element is not None:
        if element not in system.parts:
            raise SSPError(f"{here}: there is no element '{element}'; {nearest(element, system.parts)}")
        part = system.parts[element]
    if name in part.connectors:
        return part, part.connectors[name]
    if part.ports is not None and name in part.variables:
        system.document.findings.note(
            f"{here}: element '{element}' declares no connector '{name}'; the variable of its FMU is taken",
            "connectors that are not declared",
        )
        return part, _variable_connector(part, name)
    owner = f"element '{element}'" if element is not None else "the system"
    raise SSPError(f"{here}: {owner} has no connector '{name}'; {nearest(name, part.connectors)}")


def variable_nodes(part: Part, name: str) -> list[tuple[Part, str]]:
    """Connectors of systems and variables of components that have a hierarchical name; there may be several."""
    if part.ports is not None:
        return [(part, name)] if name in part.variables else []
    found = [(part, name)] if name in part.connectors and part.dictionary is None else []
    for inner_name, inner in part.parts.items():
        if name.startswith(f"{inner_name}."):
            found += variable_nodes(inner, name[len(inner_name) + 1 :])
    return found
