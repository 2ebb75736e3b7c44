"""Parameter sets (SSV) and mappings (SSM): names, values, units, and what is done to them on their way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from fmpy.model_description import BaseUnit, Unit

from cosim.ssp.package import Package
from cosim.ssp.schema import SSPError, child, children, local_name, parse
from cosim.system.units import UnitsDiffer, conversion

if TYPE_CHECKING:
    from xmlschema import DataElement

_BASE_UNIT = ("kg", "m", "s", "A", "K", "mol", "cd", "rad", "factor", "offset")

SET_TYPE = "application/x-ssp-parameter-set"
MAPPING_TYPE = "application/x-ssp-parameter-mapping"


@dataclass(frozen=True)
class Value:
    """A value of a parameter set on its way to a variable.

    Attributes
    ----------
    name : str
        Where it goes, relative to the element that it is bound to.
    data : sequence or str
        Numbers, more than one for an array; or a text.
    unit : Unit, optional
        Of the numbers, if known.
    item : bool
        The text is the name of an item of an enumeration.
    convert : bool
        Numbers are converted to the unit of the variable.
    factor, offset : float
        Then they become factor * number + offset.
    origin : str
        For messages.
    """

    name: str
    data: Sequence[float] | str
    unit: Unit | None
    item: bool
    convert: bool
    factor: float
    offset: float
    origin: str

    def split(self, size: int) -> list[Value]:
        """The values of the elements of an array; a single one is that of all.

        Raises
        ------
        SSPError
            There are more or fewer.
        """
        if size == 1:
            return [self]
        parts = [self.data] if isinstance(self.data, str) else [[number] for number in self.data]
        if len(parts) not in (1, size):
            raise SSPError(f"{self.origin}: {len(parts)} values were given for '{self.name}', which has {size}")
        return [replace(self, data=part) for part in (parts * size if len(parts) == 1 else parts)]

    def fit(self, target: str, unit: Unit | None, items: Mapping[str, float], *, relative: bool) -> list[float] | str:
        """The numbers, or the text, for a variable.

        Parameters
        ----------
        target : str
            Name of the variable, for messages.
        unit : Unit, optional
            Of the variable.
        items : mapping
            Values of its enumeration by name, empty where it has none.
        relative : bool
            The variable is a difference, to which offsets of units don't apply.

        Raises
        ------
        SSPError
            The units don't match, or the enumeration has no such item.
        """
        if self.item:
            if self.data not in items:
                known = ", ".join(items) or "it is no enumeration"
                raise SSPError(f"{self.origin}: '{target}' can't become '{self.data}'; known are: {known}")
            return [items[str(self.data)]]
        if isinstance(self.data, str):
            return self.data
        factor, offset = 1.0, 0.0
        if self.convert and unit is not None and self.unit is not None:
            try:
                factor, offset = conversion(self.unit, unit, relative=relative)
            except UnitsDiffer as error:
                raise SSPError(f"{self.origin}: value of '{target}': {error}") from None
        if (factor, offset, self.factor, self.offset) == (1.0, 0.0, 1.0, 0.0):
            return list(self.data)
        return [self.factor * (factor * number + offset) + self.offset for number in self.data]


def values_of(binding: DataElement, package: Package, component: str | None, where: str) -> list[Value]:
    """All values that a parameter binding applies, in order.

    Parameters
    ----------
    binding : DataElement
        `ssd:ParameterBinding`.
    package : Package
    component : str, optional
        URI of the FMU of the component that it belongs to, if it does.
    where : str
        For messages.

    Raises
    ------
    SSPError
        A file is missing or malformed, or its type is not the standard's.
    """
    here, parameter_set = _content(binding, SET_TYPE, "ParameterValues", "ssv", package, component, where)
    units = read_units(child(parameter_set, "Units"))
    prefix = binding.attrib["prefix"]
    values = [_value(p, prefix, units, here) for p in children(parameter_set, "Parameters", "Parameter")]
    mapping = child(binding, "ParameterMapping")
    if mapping is None:
        return values
    here, mapping = _content(mapping, MAPPING_TYPE, None, "ssm", package, component, where)
    by_name = {value.name: value for value in values}
    entries = [entry for entry in children(mapping, "MappingEntry") if entry.attrib["source"] in by_name]
    return [_mapped(by_name[entry.attrib["source"]], entry, here) for entry in entries]


def read_units(units: DataElement | None) -> dict[str, Unit]:
    """Unit definitions by name."""
    found = {}
    for unit in children(units, "Unit"):
        base = next(children(unit, "BaseUnit"))
        found[unit.attrib["name"]] = Unit(
            unit.attrib["name"], BaseUnit(**{name: base.attrib[name] for name in _BASE_UNIT})
        )
    return found


def transformation_of(element: DataElement) -> DataElement | None:
    """The transformation of a connection or of a mapping entry."""
    return next((c for c in element if local_name(c).endswith("Transformation")), None)


def _content(
    element: DataElement,
    expected: str,
    holder: str | None,
    kind: Any,
    package: Package,
    component: str | None,
    where: str,
) -> tuple[str, DataElement]:
    """Name and content of a parameter set or mapping, which is inline or in a file."""
    if element.attrib["type"] != expected:
        raise SSPError(f"{where}: parameters of type {element.attrib['type']} are not supported; use {expected}")
    source = element.attrib.get("source")
    if source is not None:
        inside = component if element.attrib["sourceBase"] == "component" else None
        if element.attrib["sourceBase"] == "component" and inside is None:
            raise SSPError(f"{where}: '{source}' is looked for in a component, but a system has it; use sourceBase SSD")
        here = f"{package.path}: {source}"
        return here, parse(package.read_xml(source, inside), kind, here)
    name = "ParameterSet" if kind == "ssv" else "ParameterMapping"
    content = child(element, holder, name) if holder else child(element, name)
    if content is None:
        raise SSPError(f"{where}: a {local_name(element)} has neither a source nor a {name}; give it one")
    return where, content


def _value(parameter: DataElement, prefix: str, units: Mapping[str, Unit], here: str) -> Value:
    typed = next(iter(parameter))
    kind, raw = local_name(typed), typed.attrib["value"]
    name = prefix + parameter.attrib["name"]
    if kind == "Binary":
        raise SSPError(f"{here}: '{name}' is binary, which is not supported")
    unit_name = typed.attrib.get("unit")
    unit = None if unit_name is None else units.get(unit_name, Unit(unit_name))
    data: Any = raw if kind in ("String", "Enumeration") else raw if isinstance(raw, list) else [raw]
    if isinstance(data, list) and kind in ("String", "Enumeration"):  # SSP 2.0 has arrays of them
        if len(data) != 1:
            raise SSPError(f"{here}: '{name}' is an array of texts, which is not supported")
        data = data[0]
    return Value(name, data, unit, kind == "Enumeration", True, 1.0, 0.0, here)


def _mapped(value: Value, entry: DataElement, here: str) -> Value:
    convert = not entry.attrib["suppressUnitConversion"]
    data, factor, offset = value.data, 1.0, 0.0
    transformation = transformation_of(entry)
    if transformation is not None and local_name(transformation) == "LinearTransformation":
        if isinstance(data, str) or any(isinstance(number, bool) for number in data):
            raise SSPError(f"{here}: '{value.name}' is not a number and can't be transformed linearly")
        factor, offset = transformation.attrib["factor"], transformation.attrib["offset"]
    elif transformation is not None:
        data = _replaced(data, transformation)
    return Value(entry.attrib["target"], data, value.unit, value.item, convert, factor, offset, value.origin)


def _replaced(data: Sequence[float] | str, transformation: DataElement) -> Sequence[float] | str:
    """Values that the table of a mapping transformation does not name stay as they are."""
    table = {e.attrib["source"]: e.attrib["target"] for e in children(transformation, "MapEntry")}
    return table.get(data, data) if isinstance(data, str) else [table.get(number, number) for number in data]
