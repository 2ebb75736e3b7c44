"""Elements of XML files by their local names, whichever library has parsed them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

#: An element of ElementTree, or a data element of xmlschema.
_Element = TypeVar("_Element", bound=Any)


def local_name(element: Any) -> str:
    """Name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def children(element: _Element | None, *steps: str) -> Iterator[_Element]:
    """Elements below one, by the local names on the way: `children(system, "Elements", "Component")`."""
    for below in element if element is not None else ():
        if local_name(below) == steps[0]:
            if len(steps) == 1:
                yield below
            else:
                yield from children(below, *steps[1:])


def child(element: _Element | None, *steps: str) -> _Element | None:
    """The first of `children`, if there is any."""
    return next(children(element, *steps), None)
