"""Diagram of a system: places of its elements, and paths of its connections, left to right, in right angles.

Lengths are in mm, x to the right and y up, as SSP has them. Components stand in columns by their distance from those
that need nothing from others. A connection to the next column runs between the two; others run above all components.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_PITCH = 5.0  # between connectors of a component
_WIDTH = 60.0  # of a component
_LANE = 3.0  # between parallel lines
_MARGIN = 12.0  # between lines and components, and around all

Point = tuple[float, float]
#: Component and connector.
End = tuple[str, str]
#: Source and target.
Wire = tuple[End, End]


@dataclass(frozen=True)
class Box:
    """Lower left and upper right corner."""

    x1: float
    y1: float
    x2: float
    y2: float

    def place(self, x: float, y: float) -> Point:
        """A point relative to the box: lower left is 0, 0 and upper right 1, 1."""
        return (x - self.x1) / (self.x2 - self.x1), (y - self.y1) / (self.y2 - self.y1)


@dataclass(frozen=True)
class Arrangement:
    """A diagram: its extent, component -> box, connector -> point on its box, points between the ends of each wire."""

    canvas: Box
    boxes: Mapping[str, Box]
    connectors: Mapping[End, Point]
    lines: Sequence[Sequence[Point]]


def arrange(
    inputs: Mapping[str, Sequence[str]], outputs: Mapping[str, Sequence[str]], wires: Sequence[Wire]
) -> Arrangement:
    """Arrange a system.

    Parameters
    ----------
    inputs, outputs : mapping
        Names of connectors by component, from top to bottom; the same components in both.
    wires : sequence of (source, target)
        Connections from outputs to inputs.
    """
    columns = _columns(list(inputs), wires)
    rows = {c: max(len(inputs[c]), len(outputs[c])) + 1 for c in inputs}
    tops = _tops(columns, rows)
    height: dict[End, float] = {
        (component, name): tops[component] - _PITCH * (k + 1)
        for names in (inputs, outputs)
        for component in names
        for k, name in enumerate(names[component])
    }
    onward = [columns[target] == columns[source] + 1 for (source, _), (target, _) in wires]
    lanes = _lanes(wires, onward, columns, height)
    starts = _starts(max(columns.values()) + 1, lanes)  # x at which the gap before a column begins
    boxes = {
        c: Box(starts[k + 1] - _WIDTH, tops[c] - _PITCH * rows[c], starts[k + 1], tops[c]) for c, k in columns.items()
    }
    around = sorted((k for k in range(len(wires)) if not onward[k]), key=lambda k: -height[wires[k][0]])
    levels = {k: _MARGIN + _LANE * i for i, k in enumerate(around)}
    canvas = Box(
        -_MARGIN,
        min(box.y1 for box in boxes.values()) - _MARGIN,
        starts[-1] + _gap(lanes.get(len(starts) - 1, [])),
        max(levels.values(), default=0.0) + _MARGIN,
    )
    points: dict[End, Point] = {
        (c, n): boxes[c].place(boxes[c].x1, height[c, n]) for c, names in inputs.items() for n in names
    }
    points |= {(c, n): boxes[c].place(boxes[c].x2, height[c, n]) for c, names in outputs.items() for n in names}
    x = {lane: starts[gap] + _MARGIN + _LANE * k for gap, inside in lanes.items() for k, lane in enumerate(inside)}
    lines = []
    for k, (source, target) in enumerate(wires):
        end = (x[k, "in"], height[target])
        if onward[k]:
            lines.append([(x[k, "in"], height[source]), end])
        else:
            lines.append([(x[k, "out"], height[source]), (x[k, "out"], levels[k]), (x[k, "in"], levels[k]), end])
    return Arrangement(canvas, boxes, points, lines)


def _columns(components: Sequence[str], wires: Sequence[Wire]) -> dict[str, int]:
    """Column of each component: its distance from those that no other feeds."""
    feeds = {(source[0], target[0]) for source, target in wires if source[0] != target[0]}
    fed = {target for _, target in feeds}
    columns = {c: 0 for c in components if c not in fed} or {components[0]: 0}
    edge = list(columns)
    while edge:
        following = [c for c in components if c not in columns and any((e, c) in feeds for e in edge)]
        columns |= dict.fromkeys(following, columns[edge[0]] + 1)
        edge = following
    return columns | {c: 0 for c in components if c not in columns}


def _tops(columns: Mapping[str, int], rows: Mapping[str, int]) -> dict[str, float]:
    """Upper edges (mm): the components of a column one below the other, from 0 down."""
    tops: dict[str, float] = {}
    bottoms: dict[int, float] = {}
    for component, column in columns.items():
        tops[component] = bottoms.get(column, _MARGIN) - _MARGIN
        bottoms[column] = tops[component] - _PITCH * rows[component]
    return tops


def _lanes(
    wires: Sequence[Wire], onward: Sequence[bool], columns: Mapping[str, int], height: Mapping[End, float]
) -> dict[int, list[tuple[int, str]]]:
    """The vertical parts of wires by the gap that they are in, left to right so that few of them cross."""
    keyed: dict[int, list[tuple[tuple[int, float], tuple[int, str]]]] = {}
    for k, (source, target) in enumerate(wires):
        start, gap = height[source], columns[target[0]]
        if onward[k]:
            falls = height[target] < start
            keyed.setdefault(gap, []).append(((1, start if falls else -start), (k, "in")))
        else:
            keyed.setdefault(columns[source[0]] + 1, []).append(((0, -start), (k, "out")))
            keyed.setdefault(gap, []).append(((2, start), (k, "in")))
    return {gap: [lane for _, lane in sorted(lanes)] for gap, lanes in keyed.items()}


def _gap(lanes: Sequence[object]) -> float:
    return 2 * _MARGIN + _LANE * max(len(lanes) - 1, 0)


def _starts(n_columns: int, lanes: Mapping[int, Sequence[object]]) -> list[float]:
    """Where (mm) the gap before each column begins, and the one after the last."""
    starts = [0.0]
    for column in range(n_columns):
        starts.append(starts[-1] + _gap(lanes.get(column, [])) + _WIDTH)
    return starts
