"""What feeds the inputs of components, through the connectors of the systems on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fmpy.model_description import Unit

from cosim.ssp.schema import SSPError, children, local_name
from cosim.ssp.structure import Connector, Part, find_connector
from cosim.ssp.values import transformation_of
from cosim.system.units import UnitsDiffer, conversion

if TYPE_CHECKING:
    from xmlschema import DataElement

#: Path of a system or component, and name of a scalar value of it.
Node = tuple[str, str]

#: Kinds of connectors out of which values come, for an element of a system; those of the system itself are the others.
_SOURCES = ("output", "calculatedParameter", "local", "constant")
_TARGETS = ("input", "parameter", "structuralParameter")


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


@dataclass(frozen=True)
class Feed:
    """Where the value of an input comes from, and the hops from there on."""

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
                    raise SSPError(f"{hop.here}: {error}, or set suppressUnitConversion") from None
                factor, offset = scale * factor, scale * offset + shift
            factor, offset = hop.factor * factor, hop.factor * offset + hop.offset
            unit = hop.target_unit or (unit if hop.convert else None)
        return factor, offset


class Flow:
    """All connections of a system and the systems in it.

    Raises
    ------
    SSPError
        A connection names what does not exist, is not allowed, or can't be run.
    """

    def __init__(self, root: Part, file: str) -> None:
        self._hops: dict[Node, Hop] = {}
        for system in root.all_parts():
            for connection in children(system.element, "Connections", "Connection"):
                self._add(system, connection.attrib, transformation_of(connection), file)

    def into(self, node: Node) -> Feed | None:
        """What feeds a value: an output of a component, or a connector of a system which nothing feeds.

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

    def _add(self, system: Part, attributes: Mapping[str, Any], transformation: DataElement | None, file: str) -> None:
        ends = [(attributes.get(f"{end}Element"), attributes[f"{end}Connector"]) for end in ("start", "end")]
        shown = [f"{element}.{name}" if element else name for element, name in ends]
        where = f" of system '{system.path}'" if system.path else ""
        here = f"{file}: connection '{shown[0]}' -> '{shown[1]}'{where}"
        if "startIndices" in attributes or "endIndices" in attributes:
            raise SSPError(f"{here} takes elements of an array by indices, which is not supported")
        found = [find_connector(system, element, name, here) for element, name in ends]
        gives = [_gives(connector, part is system, here) for part, connector in found]
        if gives[0] == gives[1]:
            kinds = " and ".join(f"{'its own ' if part is system else ''}{c.kind}" for part, c in found)
            raise SSPError(f"{here}: the system can't connect {kinds}; one end must give values, the other take them")
        (source_part, source), (target_part, target) = found if gives[0] else found[::-1]
        factor, offset = _linear(transformation, here)
        if len(source.scalars) != len(target.scalars):
            raise SSPError(f"{here}: {len(source.scalars)} values can't feed {len(target.scalars)}; mend their sizes")
        convert = not attributes["suppressUnitConversion"]
        for from_name, to_name in zip(source.scalars, target.scalars, strict=True):
            node = (target_part.path, to_name)
            if node in self._hops:
                raise SSPError(f"{here}: '{to_name}' is fed by another connection too; remove one of them")
            self._hops[node] = Hop(
                (source_part.path, from_name), source.unit, target.unit, convert, factor, offset, here
            )


def _gives(connector: Connector, of_the_system: bool, here: str) -> bool:
    """Whether values come out of a connector, as seen from inside the system."""
    if connector.kind not in (*_SOURCES, *_TARGETS):
        raise SSPError(f"{here}: connector '{connector.name}' is of kind {connector.kind}, which is not supported")
    return (connector.kind in _SOURCES) != of_the_system


def _linear(transformation: DataElement | None, here: str) -> tuple[float, float]:
    if transformation is None:
        return 1.0, 0.0
    name = local_name(transformation)
    if name != "LinearTransformation":
        raise SSPError(f"{here} has a {name}, which is not supported; a LinearTransformation is")
    return transformation.attrib["factor"], transformation.attrib["offset"]
