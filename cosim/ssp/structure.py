"""The elements of a system description as a tree: systems, their components, connectors and connections."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from fmpy.model_description import Unit

from cosim.errors import nearest
from cosim.fmi.fmu_file import load
from cosim.ssp.package import Package
from cosim.ssp.schema import SSPError, child, children, local_name
from cosim.system.units import UnitsDiffer, conversion
from cosim.system.variables import Element, Ports

if TYPE_CHECKING:
    from xmlschema import DataElement

#: Between the names of nested elements in the name of a component: the dot begins the name of the variable.
SEPARATOR = "/"

#: Arrays that are larger are refused, before names of their elements fill the memory.
_MOST_SCALARS = 1_000_000

_FMU_TYPE = "application/x-fmu-sharedlibrary"


@dataclass(frozen=True)
class Connector:
    """A connector with the names of its scalar values: one, or those of an array's elements."""

    name: str
    kind: str
    unit: Unit | None
    scalars: tuple[str, ...]


@dataclass
class Part:
    """A system or a component.

    Attributes
    ----------
    path : str
        Names of the elements from the root system on, which itself has none.
    element : DataElement
    connectors : mapping
    parts : mapping
        Elements of a system by name; empty for a component.
    ports : Ports, optional
        Variables of a component.
    fmu : Path, optional
        The FMU of a component.
    source : str, optional
        Its URI in the archive.
    """

    path: str
    element: DataElement
    connectors: dict[str, Connector] = field(default_factory=dict)
    parts: dict[str, Part] = field(default_factory=dict)
    ports: Ports | None = None
    fmu: Path | None = None
    source: str | None = None

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


def read_structure(root: DataElement, units: Mapping[str, Unit], package: Package, folder: Path) -> Part:
    """Read the tree of a system, and the model descriptions of its FMUs, which are unpacked into a folder.

    Raises
    ------
    SSPError
        An element is none that can be run, or differs from its FMU.
    """
    tree = _system(root, "", units, package, folder)
    for path, count in Counter(part.path for part in tree.all_parts()).items():
        if count > 1:
            raise SSPError(f"{package.path}: there are two elements named '{path}'; give each its own name")
    return tree


def _system(element: DataElement, path: str, units: Mapping[str, Unit], package: Package, folder: Path) -> Part:
    part = Part(path, element)
    for connector in children(element, "Connectors", "Connector"):
        part.connectors[connector.attrib["name"]] = _system_connector(connector, units, package.path)
    for inner in child(element, "Elements") or ():
        name = inner.attrib["name"]
        # a dot is allowed in SSP; to the standard B.C may be a component of that name, or C in the system B
        below = (path + SEPARATOR if path else "") + name.replace(".", SEPARATOR)
        if name in part.parts:
            raise SSPError(f"{package.path}: there are two elements named '{below}'; give each its own name")
        if local_name(inner) == "SignalDictionaryReference":
            raise SSPError(f"{package.path}: '{below}' refers to a signal dictionary, which is not supported")
        read = _system if local_name(inner) == "System" else _component
        part.parts[name] = read(inner, below, units, package, folder)
    return part


def _system_connector(connector: DataElement, units: Mapping[str, Unit], file: Path) -> Connector:
    name = connector.attrib["name"]
    sizes = [int(d.attrib["size"]) for d in children(connector, "Dimension") if "size" in d.attrib]
    if math.prod(sizes) > _MOST_SCALARS:
        raise SSPError(f"{file}: connector '{name}' has {math.prod(sizes)} values, more than any system needs")
    scalars = [f"{name}[{','.join(map(str, i))}]" for i in product(*(range(1, n + 1) for n in sizes))]
    return Connector(name, connector.attrib["kind"], _unit(connector, units), tuple(scalars) if sizes else (name,))


def _component(element: DataElement, path: str, units: Mapping[str, Unit], package: Package, folder: Path) -> Part:
    here = f"{package.path}: component '{path}'"
    source = element.attrib.get("source")
    if source is None:
        raise SSPError(f"{here} has no source; give it an FMU")
    if element.attrib["type"] != _FMU_TYPE:
        raise SSPError(f"{here} is of type {element.attrib['type']}, which is not supported; only FMUs are")
    if element.attrib["implementation"] not in ("any", "CoSimulation"):
        raise SSPError(f"{here} is meant for {element.attrib['implementation']}; only co-simulation is supported")
    fmu = package.extract(source, folder)
    ports = Ports(path, load(path, fmu).description)
    part = Part(path, element, ports=ports, fmu=fmu, source=source)
    for connector in children(element, "Connectors", "Connector"):
        part.connectors[connector.attrib["name"]] = _component_connector(connector, part, units, here)
    return part


def _component_connector(connector: DataElement, part: Part, units: Mapping[str, Unit], here: str) -> Connector:
    name, kind = connector.attrib["name"], connector.attrib["kind"]
    elements = part.variables.get(name)
    if elements is None:
        hint = nearest(name, part.variables)
        raise SSPError(f"{here}: the FMU has no variable for connector '{name}'; {hint}")
    causality = elements[0].variable.causality
    if causality != kind:
        raise SSPError(
            f"{here}: connector '{name}' is of kind {kind}, but the variable of the FMU is {causality}; mend it"
        )
    assert part.ports is not None
    own = part.ports.unit(elements[0])
    declared = _unit(connector, units)
    if declared is not None and own is not None:
        try:
            same = conversion(declared, own, relative=False) == (1.0, 0.0)
        except UnitsDiffer:
            same = False
        if not same:
            raise SSPError(f"{here}: connector '{name}' is in '{declared.name}', but the FMU in '{own.name}'; mend it")
    # the FMU's unit comes with a definition for sure
    return Connector(name, kind, own or declared, tuple(e.name for e in elements))


def _unit(connector: DataElement, units: Mapping[str, Unit]) -> Unit | None:
    name = next((typed.attrib["unit"] for typed in connector if "unit" in typed.attrib), None)
    return None if name is None else units.get(name, Unit(name))


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
    if name not in part.connectors:
        owner = f"element '{element}'" if element is not None else "the system"
        raise SSPError(f"{here}: {owner} has no connector '{name}'; {nearest(name, part.connectors)}")
    return part, part.connectors[name]


def variable_nodes(part: Part, name: str) -> list[tuple[Part, str]]:
    """What a hierarchical name stands for: connectors of systems and variables of components; there may be several."""
    if part.ports is not None:
        return [(part, name)] if name in part.variables else []
    found = [(part, name)] if name in part.connectors else []
    for inner_name, inner in part.parts.items():
        if name.startswith(f"{inner_name}."):
            found += variable_nodes(inner, name[len(inner_name) + 1 :])
    return found
