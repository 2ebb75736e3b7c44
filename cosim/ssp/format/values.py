"""Parameter sets (SSV) and mappings (SSM): names, values, units, and what is done to them on their way."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from fmpy.model_description import Unit

from cosim.errors import nearest
from cosim.files.xml_elements import child, children, local_name
from cosim.ssp.errors import SSPError
from cosim.ssp.format.document import Definitions, Document, read_definitions
from cosim.ssp.format.schema import parse
from cosim.system.read import Findings
from cosim.system.units import UnitsDiffer, conversion

if TYPE_CHECKING:
    from xmlschema import DataElement

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
        Numbers, texts or bytes, more than one for an array; or one text.
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
    items : mapping
        Numbers of the items of the enumeration that the text is of, where its file defines it.
    """

    name: str
    data: Sequence[Any] | str
    unit: Unit | None
    item: bool
    convert: bool
    factor: float
    offset: float
    origin: str
    items: Mapping[str, float] = field(default_factory=dict)

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

    def fit(
        self,
        target: str,
        unit: Unit | None,
        items: Mapping[str, float],
        *,
        relative: bool,
        findings: Findings | None = None,
    ) -> list[Any] | str:
        """The numbers, or texts, for a variable.

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
        findings : Findings, optional
            Takes a note of a unit that is not defined; without it such a unit is an error.

        Raises
        ------
        SSPError
            The units don't match, or the enumeration has no such item.
        """
        if self.item:
            texts = [self.data] if isinstance(self.data, str) else self.data
            return [self.number(text, target, items) for text in texts]
        if isinstance(self.data, str):
            return self.data
        if not self.has_numbers:
            return list(self.data)
        factor, offset = self._conversion(target, unit, relative, findings)
        if (factor, offset, self.factor, self.offset) == (1.0, 0.0, 1.0, 0.0):
            return list(self.data)
        numbers: Any = self.data
        return [self.factor * (factor * number + offset) + self.offset for number in numbers]

    @property
    def has_numbers(self) -> bool:
        """Whether it is of numbers or truth values."""
        return not isinstance(self.data, str) and not any(isinstance(v, (str, bytes)) for v in self.data)

    def number(self, text: str, target: str, items: Mapping[str, float]) -> float:
        """The number of an item of an enumeration: as the FMU has it, else as the file has that defines it.

        Raises
        ------
        SSPError
            Neither has such an item.
        """
        if text in items:
            return items[text]
        if text in self.items and (not items or self.items[text] in items.values()):
            return self.items[text]
        if items and re.fullmatch(r"[+-]?\d+", text) and float(text) in items.values():
            return float(text)
        why = f"known are: {', '.join(items)}" if items else "it is not an enumeration"
        raise SSPError(f"{self.origin}: '{target}' can't become '{text}'; {why}")

    def _conversion(
        self, target: str, unit: Unit | None, relative: bool, findings: Findings | None
    ) -> tuple[float, float]:
        if not self.convert or unit is None or self.unit is None or self.unit.name == unit.name:
            return 1.0, 0.0
        if findings is not None and (self.unit.baseUnit is None or unit.baseUnit is None):
            undefined = self.unit if self.unit.baseUnit is None else unit
            findings.note(
                f"{self.origin}: unit '{undefined.name}' of the value of '{target}' is not defined; "
                f"it is taken in '{unit.name}'",
                "units of values",
            )
            return 1.0, 0.0
        try:
            return conversion(self.unit, unit, relative=relative)
        except UnitsDiffer as error:
            raise SSPError(f"{self.origin}: value of '{target}': {error}, or ignore units (--units ignore)") from None


def values_of(
    binding: DataElement, document: Document, component: str | None, where: str, definitions: Definitions
) -> list[Value]:
    """All values that a parameter binding applies, in order.

    Parameters
    ----------
    binding : DataElement
        `ssd:ParameterBinding`.
    document : Document
        The description that has it.
    component : str, optional
        Name in the package of the FMU of the component that it belongs to, if it does.
    where : str
        For messages.
    definitions : Definitions
        Of that FMU: units that the file itself does not define.

    Raises
    ------
    SSPError
        A file is missing or malformed, or its type is not the standard's.
    """
    here, parameter_set = _content(binding, SET_TYPE, "ParameterValues", "ssv", document, component, where)
    values = set_values(parameter_set, binding.attrib["prefix"], here, document, definitions)
    mapping = child(binding, "ParameterMapping")
    if mapping is None:
        return values
    here, mapping = _content(mapping, MAPPING_TYPE, None, "ssm", document, component, where)
    by_name = {value.name: value for value in values}
    entries = list(children(mapping, "MappingEntry"))
    absent = [entry.attrib["source"] for entry in entries if entry.attrib["source"] not in by_name]
    for name in absent:
        document.findings.note(
            f"{here}: no parameter is named '{name}', whose mapping is ignored; {nearest(name, by_name)}", here
        )
    return [_mapped(by_name[e.attrib["source"]], e, here) for e in entries if e.attrib["source"] in by_name]


def set_values(
    parameter_set: DataElement, prefix: str, here: str, document: Document, definitions: Definitions | None = None
) -> list[Value]:
    """The values of a parameter set, in order.

    Parameters
    ----------
    parameter_set : DataElement
    prefix : str
        Goes before all names.
    here : str
        Name of the file, for messages.
    document : Document
        The description that takes it.
    definitions : Definitions, optional
        Units that neither of the two defines.

    Raises
    ------
    SSPError
        A value is of a type that is not supported.
    """
    own = read_definitions(parameter_set)
    known = Definitions(
        {**(definitions.units if definitions else {}), **document.definitions.units, **own.units},
        {**document.definitions.enumerations, **own.enumerations},
    )
    found: dict[str, Value] = {}
    for parameter in children(parameter_set, "Parameters", "Parameter"):
        with document.findings.collecting():
            value = _value(parameter, prefix, known, here, document)
            if value.name in found:
                document.findings.note(f"{here}: parameter '{value.name}' is there twice; the last one holds", here)
            found[value.name] = value
    return list(found.values())


def transformation_of(element: DataElement) -> DataElement | None:
    """The transformation of a connection or of a mapping entry."""
    return next((c for c in element if local_name(c).endswith("Transformation")), None)


def table_of(transformation: DataElement, here: str) -> dict[Any, Any]:
    """Values that a mapping transformation replaces, and by what; other values stay as they are.

    Raises
    ------
    SSPError
        One value has two targets.
    """
    table: dict[Any, Any] = {}
    for entry in children(transformation, "MapEntry"):
        source, target = entry.attrib["source"], entry.attrib["target"]
        if table.setdefault(source, target) != target:
            raise SSPError(f"{here}: a {local_name(transformation)} maps {source!r} to two values; remove one of them")
    return table


def _content(
    element: DataElement,
    expected: str,
    holder: str | None,
    kind: Any,
    document: Document,
    component: str | None,
    where: str,
) -> tuple[str, DataElement]:
    """Name and content of a parameter set or mapping, which is inline or in a file."""
    if element.attrib["type"] != expected:
        raise SSPError(f"{where}: parameters of type {element.attrib['type']} are not supported; use {expected}")
    source = element.attrib.get("source")
    package = document.package
    if source:
        if element.attrib["sourceBase"] == "component":
            if component is None:
                raise SSPError(
                    f"{where}: '{source}' is looked for in a component, but a system has it; use sourceBase SSD"
                )
            here = f"{package.path}: {component}: {source}"
            return here, parse(package.read_xml(source, component), kind, here, document.findings)
        name = package.name_of(source, document.name)
        here = package.where(name)
        return here, parse(package.read_xml(name), kind, here, document.findings)
    inline = "ParameterSet" if kind == "ssv" else "ParameterMapping"
    content = child(element, holder, inline) if holder else child(element, inline)
    if content is None:
        raise SSPError(f"{where}: a {local_name(element)} has neither a source nor a {inline}; give it one")
    return where, content


def _value(parameter: DataElement, prefix: str, definitions: Definitions, here: str, document: Document) -> Value:
    name = prefix + parameter.attrib["name"]
    typed = next((t for t in parameter if "value" in t.attrib or child(t, "Value") is not None), None)
    if typed is None:
        raise SSPError(f"{here}: parameter '{name}' has no value; give it one")
    kind = local_name(typed)
    if typed.attrib.get("unit") == "":
        document.findings.note(f"{here}: units that are empty are taken for none")
    unit = None if document.ignore_units else document.unit(typed.attrib.get("unit"), definitions)
    raw = typed.attrib["value"] if "value" in typed.attrib else [v.attrib["value"] for v in children(typed, "Value")]
    data: Any = raw if isinstance(raw, list) else [raw]
    if kind == "Binary":
        data = [bytes.fromhex(str(digits)) for digits in data]
    elif kind in ("String", "Enumeration") and len(data) == 1:  # SSP 2.0 has arrays of them
        data = data[0]
    items = definitions.enumerations.get(typed.attrib.get("name") or "", {}) if kind == "Enumeration" else {}
    return Value(name, data, unit, kind == "Enumeration", True, 1.0, 0.0, here, items)


def _mapped(value: Value, entry: DataElement, here: str) -> Value:
    convert = not entry.attrib["suppressUnitConversion"]
    data, factor, offset = value.data, 1.0, 0.0
    transformation = transformation_of(entry)
    if transformation is not None and local_name(transformation) == "LinearTransformation":
        if not value.has_numbers or any(isinstance(number, bool) for number in data):
            raise SSPError(f"{here}: '{value.name}' is not a number and can't be transformed linearly")
        factor, offset = transformation.attrib["factor"], transformation.attrib["offset"]
    elif transformation is not None:
        if value.item and local_name(transformation) == "IntegerMappingTransformation":
            texts = [data] if isinstance(data, str) else data
            value = replace(value, data=[value.number(text, value.name, {}) for text in texts], item=False)
        data = _replaced(value.data, table_of(transformation, here))
    return replace(value, name=entry.attrib["target"], data=data, convert=convert, factor=factor, offset=offset)


def _replaced(data: Sequence[Any] | str, table: Mapping[Any, Any]) -> Sequence[Any] | str:
    return table.get(data, data) if isinstance(data, str) else [table.get(number, number) for number in data]
