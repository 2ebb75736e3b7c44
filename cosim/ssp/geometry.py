"""Where an SSP has placed its components, in the coordinates of the whole system."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from cosim.files.xml_elements import child
from cosim.ssp.format.structure import Part

#: Lower left and upper right corner; y points up.
Corners = tuple[float, float, float, float]

_Place = Callable[[float, float], tuple[float, float]]


def places(root: Part) -> dict[str, Corners]:
    """Component -> its corners, of all components that have a place; those of nested systems stand inside theirs."""
    return dict(_places(root, lambda x, y: (x, y)))


def _places(system: Part, place: _Place) -> Iterator[tuple[str, Corners]]:
    for part in system.parts.values():
        corners = _corners(part, "ElementGeometry")
        if corners is None:
            continue
        (x1, y1), (x2, y2) = place(*corners[:2]), place(*corners[2:])
        if part.ports is not None:
            yield part.path, (x1, y1, x2, y2)
        elif (own := _corners(part, "SystemGeometry")) is not None and own[0] != own[2] and own[1] != own[3]:
            yield from _places(part, _into((x1, y1, x2, y2), own))


def _into(box: Corners, own: Corners) -> _Place:
    """From a nested system's own coordinates into the box that it has outside."""

    def place(x: float, y: float) -> tuple[float, float]:
        across, up = (x - own[0]) / (own[2] - own[0]), (y - own[1]) / (own[3] - own[1])
        return box[0] + across * (box[2] - box[0]), box[1] + up * (box[3] - box[1])

    return place


def _corners(part: Part, name: str) -> Corners | None:
    geometry = child(part.element, name)
    if geometry is None:
        return None
    try:
        x1, y1, x2, y2 = (float(geometry.attrib[key]) for key in ("x1", "y1", "x2", "y2"))
    except (KeyError, ValueError):  # a place that is none is said by the schema, and does not matter for a run
        return None
    return x1, y1, x2, y2
