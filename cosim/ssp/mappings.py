"""Mapping transformations of connections: each becomes a component, a function that looks values up in tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from cosim.ssp.errors import SSPError
from cosim.ssp.flow import Feed, Hop
from cosim.system.read import Findings
from cosim.system.system import System
from cosim.system.variables import Element

_ENUMERATION = "EnumerationMappingTransformation"


def add_mapping(
    system: System, name: str, feed: Feed, source: Element, target: Element, findings: Findings
) -> tuple[str, str]:
    """Add the component that maps what a source gives; returns its input and output.

    Parameters
    ----------
    system : System
    name : str
        Of the component, if it is not taken.
    feed : Feed
        The way from the source, with tables.
    source, target : Element
    findings : Findings
        Takes a note of the component.

    Raises
    ------
    SSPError
        The tables are not for values of this type, or give what the target can't have.
    """
    here = feed.tables[0].here
    if feed.transformation(relative=False) != (1.0, 0.0):
        raise SSPError(f"{here}: a value is both mapped and transformed linearly on its way; do one of them")
    kind: type = bool if source.kind == "boolean" else int
    wanted = "BooleanMappingTransformation" if kind is bool else "IntegerMappingTransformation"
    if source.kind not in ("boolean", "integer", "enumeration"):
        raise SSPError(f"{here} maps values of type {source.variable.type}; only truth values and whole numbers can be")
    tables: Sequence[Mapping[Any, Any]]
    if any(hop.table is not None and hop.table.kind == _ENUMERATION for hop in feed.tables):
        tables = [_by_number(feed.tables, source, target)]
    else:
        for hop in feed.tables:
            if hop.table is not None and hop.table.kind != wanted:
                raise SSPError(f"{hop.here} has a {hop.table.kind}, but values of type {source.variable.type}")
        tables = [hop.table.entries for hop in feed.tables if hop.table is not None]
    while name in system.components:
        name += "_"
    system.add_function(name, partial(_looked_up, tables), inputs={"in": kind}, outputs={"out": kind})
    findings.note(f"{here}: its mapping is a component, '{name}', which in parallel order takes a step", "mappings")
    return f"{name}.in", f"{name}.out"


def _by_number(hops: Sequence[Hop], source: Element, target: Element) -> dict[int, int]:
    """Number of an item of the target for that of each item of the source, by the names of items."""
    if not source.items or not target.items:
        raise SSPError(f"{hops[0].here} maps names of items, but not both ends are enumerations")
    found = {}
    for item, number in source.items.items():
        text = item
        for hop in hops:
            assert hop.table is not None
            if hop.table.kind != _ENUMERATION:
                raise SSPError(f"{hop.here} maps numbers, and another connection on the way names; do one of them")
            text = hop.table.entries.get(text, text)
        if text not in target.items:
            known = ", ".join(target.items)
            raise SSPError(f"{hops[-1].here}: '{item}' would become '{text}', which '{target.name}' can't: {known}")
        found[int(number)] = int(target.items[text])
    return found


def _looked_up(tables: Sequence[Mapping[Any, Any]], time: float, value: Any) -> Any:  # noqa: ARG001
    for table in tables:
        value = table.get(value, value)
    return value
