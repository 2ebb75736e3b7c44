"""A description with its context: its package of files, its units, its enumerations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from fmpy.model_description import BaseUnit, Unit

from cosim.files.xml_elements import child, children
from cosim.ssp.format.package import Package
from cosim.ssp.format.schema import parse
from cosim.system.read import Findings

if TYPE_CHECKING:
    from xmlschema import DataElement

_BASE_UNIT = ("kg", "m", "s", "A", "K", "mol", "cd", "rad", "factor", "offset")


@dataclass(frozen=True)
class Definitions:
    """Units and enumerations by name that a file defines; of an enumeration the numbers of its items."""

    units: Mapping[str, Unit] = field(default_factory=dict)
    enumerations: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Document:
    """A description of a system (SSD) in a package.

    Attributes
    ----------
    package : Package
    name : str
        Of the file in the package.
    content : DataElement
    definitions : Definitions
    folder : Path
        Where files of the package are unpacked to.
    findings : Findings
    ignore_units : bool
        Numbers are taken as they are, whatever units say.
    above : tuple of str
        The descriptions that have this one as a component, from the outermost on.
    """

    package: Package
    name: str
    content: DataElement
    definitions: Definitions
    folder: Path
    findings: Findings
    ignore_units: bool = False
    above: tuple[str, ...] = ()

    @property
    def where(self) -> str:
        """For messages."""
        return self.package.where(self.name)

    def unit(self, name: str | None, definitions: Definitions | None = None) -> Unit | None:
        """A unit by its name in a file; that of nothing, or an empty one, is None.

        Parameters
        ----------
        name : str, optional
        definitions : Definitions, optional
            Of the file, if it is not this one.
        """
        if not name:
            return None
        for known in (definitions, self.definitions):
            if known is not None and name in known.units:
                return known.units[name]
        return Unit(name)


def open_document(package: Package, name: str, folder: Path, ignore_units: bool) -> Document:
    """Read a description of a package.

    Raises
    ------
    SSPError
        It is missing or malformed.
    """
    where = package.where(name)
    content = parse(package.read_xml(name), "ssd", where, package.findings)
    if child(content, "System") is None:
        raise package.findings.error(f"{where}: has no System; correct it in the tool that wrote it")
    return Document(package, name, content, read_definitions(content), folder, package.findings, ignore_units)


def read_definitions(content: DataElement) -> Definitions:
    """Units and enumerations that a file defines."""
    units = {}
    for unit in children(content, "Units", "Unit"):
        base = child(unit, "BaseUnit")
        if base is not None:
            exponents = {name: base.attrib[name] for name in _BASE_UNIT}
            units[unit.attrib["name"]] = Unit(unit.attrib["name"], BaseUnit(**exponents))
    enumerations = {
        enumeration.attrib["name"]: {i.attrib["name"]: float(i.attrib["value"]) for i in children(enumeration, "Item")}
        for enumeration in children(content, "Enumerations", "Enumeration")
    }
    return Definitions(units, enumerations)
