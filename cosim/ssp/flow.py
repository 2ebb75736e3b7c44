"""Sources of the inputs of components, through the connectors of the systems and signal dictionaries on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from fmpy.model_description import Unit

from cosim.files.xml_elements import children, local_name
from cosim.ssp.errors import SSPError
from cosim.ssp.format.structure import GIVING, TAKING, Connector, Part, find_connector
from cosim.ssp.format.values import Value, table_of, transformation_of
from cosim.system.units import UnitsDiffer, conversion

if TYPE_CHECKING:
    from xmlschema import DataElement

#: Path of a system, component or signal dictionary, and name of a scalar value of it.
Node = tuple[str, str]


@dataclass(frozen=True)
class ValueMap:
    """A mapping transformation: values that it does not name stay as they are.

    Attributes
    ----------
    kind : str
        Name of the transformation in SSP.
    entries : mapping
        Source -> target: truth values, numbers, or names of items.
    """

    kind: str
    entries: Mapping[Any, Any]


@dataclass(frozen=True)
class Hop:
    """A connection between two scalar values, the units included that are known of them."""

    source: Node
    source_unit: Unit | None
    target_unit: Unit | None
    convert: bool
    factor: float
    offset: float
    here: str
    table: ValueMap | None = None


@dataclass(frozen=True)
class Feed:
    """Source of the value of an input, and the hops from there on."""

    source: Node
    hops: tuple[Hop, ...]

    @property
    def unit(self) -> Unit | None:
        """Unit of the source; where it has none, that of what it feeds, if they are not told apart."""
        for hop in self.hops:
            if hop.source_unit is not None:
                return hop.source_unit
            if not hop.convert:
                return None
            if hop.target_unit is not None:
                return hop.target_unit
        return None

    @property
    def tables(self) -> list[Hop]:
        """The hops with mapping transformations."""
        return [hop for hop in self.hops if hop.table is not None]

    def transformation(self, *, relative: bool) -> tuple[float, float]:
        """Factor and offset from source to input.

        Parameters
        ----------
        relative : bool
            The input is a difference, to which offsets of units don't apply.

        Raises
        ------
        SSPError
            Units on the way don't match.
        """
        factor, offset, unit = 1.0, 0.0, self.unit
        for hop in self.hops:
            unit = hop.source_unit or unit
            if hop.convert and unit is not None and hop.target_unit is not None:
                try:
                    scale, shift = conversion(unit, hop.target_unit, relative=relative)
                except UnitsDiffer as error:
                    raise SSPError(
                        f"{hop.here}: {error}, or set suppressUnitConversion, or ignore units (--units ignore)"
                    ) from None
                factor, offset = scale * factor, scale * offset + shift
            factor, offset = hop.factor * factor, hop.factor * offset + hop.offset
            unit = hop.target_unit or (unit if hop.convert else None)
        return factor, offset

    def handed_on(self, value: Value, name: str, items: Mapping[str, float], *, relative: bool) -> list[Any] | str:
        """A value of the source as it comes to the input.

        Parameters
        ----------
        value : Value
        name : str
            Of the input, for messages.
        items : mapping
            Values of its enumeration by name.
        relative : bool
            As in `transformation`.

        Raises
        ------
        SSPError
            The value can't go this way.
        """
        factor, offset = self.transformation(relative=relative)
        if not self.tables:
            data = value.fit(name, self.unit, items, relative=relative)
            if (factor, offset) == (1.0, 0.0):
                return data
            if not value.has_numbers and not value.item:
                raise SSPError(
                    f"{value.origin}: '{value.name}' is a text and can't be transformed on its way to '{name}'"
                )
            numbers: Any = data
            return [factor * number + offset for number in numbers]
        if (factor, offset) != (1.0, 0.0):
            raise SSPError(f"{self.hops[0].here}: '{name}' is both mapped and transformed linearly; do one of them")
        texts = [value.data] if isinstance(value.data, str) else list(value.data)
        mapped: list[Any] | None = None if value.item else texts
        for hop in self.tables:
            assert hop.table is not None
            if hop.table.kind == "EnumerationMappingTransformation":
                if mapped is not None:
                    raise SSPError(f"{hop.here}: maps names of items, but '{value.name}' is not an enumeration")
                texts = [hop.table.entries.get(text, text) for text in texts]
                continue
            if mapped is None:
                mapped = [value.number(text, name, items) for text in texts]
            mapped = [hop.table.entries.get(number, number) for number in mapped]
        return mapped if mapped is not None else [value.number(text, name, items) for text in texts]


@dataclass
class Flow:
    """All connections of a system and the systems in it.

    What a connection names and does not exist, is not allowed, or can't be run, becomes a problem of the findings.
    """

    root: Part
    _hops: dict[Node, Hop] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for system in self.root.all_parts():
            for connection in children(system.element, "Connections", "Connection") if system.ports is None else ():
                with system.document.findings.collecting():
                    self._add(system, connection.attrib, transformation_of(connection))
        for part in self.root.all_parts():
            if part.dictionary is not None:
                with part.document.findings.collecting():
                    self._join(part)

    def into(self, node: Node) -> Feed | None:
        """Source of a value: an output of a component, or a connector of a system which nothing feeds.

        Raises
        ------
        SSPError
            The connections lead back to where they came from.
        """
        hops: list[Hop] = []
        seen = {node}
        while node in self._hops:
            hops.insert(0, self._hops[node])
            node = hops[0].source
            if node in seen:
                raise SSPError(f"{hops[0].here}: connections of systems lead back to '{node[1]}'; cut this circle")
            seen.add(node)
        return Feed(node, tuple(hops)) if hops else None

    def _add(self, system: Part, attributes: Mapping[str, Any], transformation: DataElement | None) -> None:
        document = system.document
        ends = [(attributes.get(f"{end}Element"), attributes[f"{end}Connector"]) for end in ("start", "end")]
        shown = [f"{element}.{name}" if element else name for element, name in ends]
        where = f" of system '{system.path}'" if system.path else ""
        here = f"{document.where}: connection '{shown[0]}' -> '{shown[1]}'{where}"
        if any(element == "" for element, _ in ends):
            document.findings.note(f"{document.where}: an empty startElement or endElement means the system itself")
        if "startIndices" in attributes or "endIndices" in attributes:
            raise SSPError(f"{here} takes elements of an array by indices, which is not supported")
        if any(_is_broken(system, element, name) for element, name in ends):
            return  # which is a problem that has been found already
        found = [find_connector(system, element or None, name, here) for element, name in ends]
        gives = _directions([(connector, part is system) for part, connector in found], here)
        if gives[0] == gives[1]:
            kinds = " and ".join(f"{'its own ' if part is system else ''}{c.kind}" for part, c in found)
            raise SSPError(f"{here}: the system can't connect {kinds}; one end must give values, the other take them")
        (source_part, source), (target_part, target) = found if gives[0] else found[::-1]
        factor, offset, table = _transformation(transformation, here)
        if len(source.scalars) != len(target.scalars):
            raise SSPError(
                f"{here}: {len(source.scalars)} values can't feed {len(target.scalars)}; correct their sizes"
            )
        convert = not (attributes["suppressUnitConversion"] or document.ignore_units)
        for from_name, to_name in zip(source.scalars, target.scalars, strict=True):
            hop = Hop((source_part.path, from_name), source.unit, target.unit, convert, factor, offset, here, table)
            self._set((target_part.path, to_name), hop)

    def _join(self, part: Part) -> None:
        """Connect the connectors of a reference with the signals of its dictionary."""
        assert part.dictionary is not None
        for name, connector in part.connectors.items():
            signal = part.dictionary.signals[name]
            here = f"{part.document.where}: signal '{name}' of '{part.path}'"
            convert = not part.document.ignore_units
            for scalar in connector.scalars:
                node, shared = (part.path, scalar), (part.dictionary.path, scalar)
                fed = node in self._hops
                if (connector.kind in TAKING and not fed) or (connector.kind in GIVING and fed):
                    continue  # nothing comes in; or what a connection has found to be wrong
                if fed:
                    self._set(shared, Hop(node, connector.unit, signal.unit, convert, 1.0, 0.0, here))
                else:
                    self._set(node, Hop(shared, signal.unit, connector.unit, convert, 1.0, 0.0, here))

    def _set(self, target: Node, hop: Hop) -> None:
        if target in self._hops:
            raise SSPError(f"{hop.here}: '{target[1]}' is fed by another connection too; remove one of them")
        self._hops[target] = hop


def _is_broken(system: Part, element: str | None, name: str) -> bool:
    """Whether an end of a connection could not be read."""
    if not element:
        return False
    return element in system.broken or (element in system.parts and name in system.parts[element].broken)


def _directions(ends: list[tuple[Connector, bool]], here: str) -> list[bool]:
    """Whether values come out of each of two connectors, as seen from inside the system.

    One that may do both does what the other leaves to it.
    """
    gives: list[bool | None] = []
    for connector, of_the_system in ends:
        if connector.kind in ("inout", "unspecified"):
            gives.append(None)
        elif connector.kind in (*GIVING, *TAKING):
            gives.append((connector.kind in GIVING) != of_the_system)
        else:
            raise SSPError(f"{here}: connector '{connector.name}' is of kind {connector.kind}, which is not supported")
    if gives == [None, None]:
        return [True, False]  # from start to end
    return [(not gives[1 - k]) if g is None else g for k, g in enumerate(gives)]


def _transformation(transformation: DataElement | None, here: str) -> tuple[float, float, ValueMap | None]:
    if transformation is None:
        return 1.0, 0.0, None
    name = local_name(transformation)
    if name == "LinearTransformation":
        return transformation.attrib["factor"], transformation.attrib["offset"], None
    entries = {a: b for a, b in table_of(transformation, here).items() if a != b}
    return 1.0, 0.0, ValueMap(name, entries) if entries else None
