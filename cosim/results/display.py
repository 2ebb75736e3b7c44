"""Results as people see them: a few lines in a terminal, a table in a notebook."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded

#: Width of the lines in a terminal, and how many components are shown.
_WIDTH, _MOST_LINES = 100, 10

#: A notebook shows at most so many variables, and so many elements of a vector.
_MOST_ROWS, _MOST_ELEMENTS = 40, 6


def grouped(names: Sequence[str]) -> dict[str, list[int]]:
    """Scalars and vectors -> positions of their elements, in the order of their first ones.

    >>> grouped(["a.x", "a.v[1]", "a.v[2]", "b.y"])
    {'a.x': [0], 'a.v': [1, 2], 'b.y': [3]}
    """
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        stem = re.sub(r"\[\d+(,\d+)*\]$", "", name)
        groups.setdefault(name if stem in names else stem, []).append(i)
    return groups


def as_text(recorded: Recorded) -> str:
    """Rows, time span and status, then a line a component with its names, shortened."""
    components: dict[str, list[str]] = {}
    for label in _labels(recorded):
        component, _, name = label.partition(".") if "." in label else ("", "", label)
        components.setdefault(component, []).append(name)
    lines = [_shortened(f"  {c}: " if c else "  ", names) for c, names in list(components.items())[:_MOST_LINES]]
    if len(components) > len(lines):
        lines.append(f"  and {len(components) - len(lines)} more components")
    return "\n".join([_headline(recorded), *lines])


def _shortened(start: str, names: Sequence[str]) -> str:
    line = start + ", ".join(names)
    if len(line) <= _WIDTH:
        return line
    kept = line[: _WIDTH - len(", ...")].rpartition(", ")[0] or start + names[0]
    return kept + ", ..." if len(names) > 1 else kept


def as_html(recorded: Recorded) -> str:
    """The same as a table with units, first and last values."""
    rows = []
    ends = [recorded._row(0), recorded._row(-1)] if len(recorded.time) else []
    for label, positions in list(_labels(recorded).items())[:_MOST_ROWS]:
        unit = recorded.units.get(recorded.names[positions[0]], "")
        cells = [f"<code>{escape(label)}</code>", escape(unit), *(_numbers(end[positions]) for end in ends)]
        rows.append("<tr>" + "".join(f'<td style="text-align: left">{cell}</td>' for cell in cells) + "</tr>")
    more = len(_labels(recorded)) - len(rows)
    heads = ["name", "unit", *(f"at {recorded.time[i]:g} s" for i in (0, -1)[: len(ends)])]
    return (
        f"<p>{escape(_headline(recorded))}</p>\n<table>\n<thead><tr>"
        + "".join(f'<th style="text-align: left">{head}</th>' for head in heads)
        + "</tr></thead>\n<tbody>\n"
        + "\n".join(rows)
        + "\n</tbody>\n</table>"
        + (f"\n<p>and {more} more</p>" if more > 0 else "")
    )


def _headline(recorded: Recorded) -> str:
    n = len(recorded.time)
    span = f", {recorded.time[0]:g} to {recorded.time[-1]:g} s" if n else ""
    status = f", {recorded.info['status']}" if "status" in recorded.info else ""
    columns = len(recorded.names)
    return f"{type(recorded).__name__}: {n} row{'s' * (n != 1)}{span}, {columns} column{'s' * (columns != 1)}{status}"


def _labels(recorded: Recorded) -> dict[str, list[int]]:
    """`theta_a[1..3]` for a vector; positions of its elements."""
    labels = {}
    for name, positions in grouped(recorded.names).items():
        first, last = (recorded.names[positions[i]] for i in (0, -1))
        vector = len(positions) > 1
        labels[f"{first[:-1]}..{last.removeprefix(name + '[')}" if vector else first] = positions
    return labels


def _numbers(values: np.ndarray) -> str:
    shown = [f"{v:.5g}" for v in values[:_MOST_ELEMENTS]]
    return ", ".join([*shown, "..."] if len(values) > len(shown) else shown)
