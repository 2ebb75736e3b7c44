"""Results as people see them: a few lines in a terminal, a table in a notebook."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cosim.results.names import labels

#: Width of the lines in a terminal, and how many components are shown.
_WIDTH, _MOST_LINES = 100, 10

#: A notebook shows at most so many variables, and so many elements of a vector.
_MOST_ROWS, _MOST_ELEMENTS = 40, 6


def headline(kind: str, time: np.ndarray, columns: int, status: str) -> str:
    """Kind of the results, number of rows, time span (s), number of columns and, unless empty, status."""
    n = len(time)
    span = f", {time[0]:g} to {time[-1]:g} s" if n else ""
    ended = f", {status}" if status else ""
    return f"{kind}: {n} row{'s' * (n != 1)}{span}, {columns} column{'s' * (columns != 1)}{ended}"


def as_text(head: str, names: Sequence[str]) -> str:
    """A headline, then a line a component with the names of its variables, shortened."""
    components: dict[str, list[str]] = {}
    for label in labels(names):
        component, _, name = label.partition(".") if "." in label else ("", "", label)
        components.setdefault(component, []).append(name)
    lines = [_shortened(f"  {c}: " if c else "  ", found) for c, found in list(components.items())[:_MOST_LINES]]
    if len(components) > len(lines):
        lines.append(f"  and {len(components) - len(lines)} more components")
    return "\n".join([head, *lines])


def _shortened(start: str, names: Sequence[str]) -> str:
    line = start + ", ".join(names)
    if len(line) <= _WIDTH:
        return line
    kept = line[: _WIDTH - len(", ...")].rpartition(", ")[0] or start + names[0]
    return kept + ", ..." if len(names) > 1 else kept


def as_html(
    head: str, names: Sequence[str], units: Mapping[str, str], ends: Sequence[tuple[float, Sequence[Any]]]
) -> str:
    """A headline, then a table of variables with their units and values.

    Parameters
    ----------
    head : str
    names : sequence of str
    units : mapping
        Scalar name -> unit, as far as known.
    ends : sequence of (float, sequence)
        Times (s) and values, one a name, that are shown: the first and the last row, or none.
    """
    from html import escape  # a table of all entities comes with it

    found = labels(names)
    rows = []
    for label, positions in list(found.items())[:_MOST_ROWS]:
        unit = units.get(names[positions[0]], "")
        cells = [
            f"<code>{escape(label)}</code>",
            escape(unit),
            *(escape(_shown([values[i] for i in positions])) for _, values in ends),
        ]
        rows.append("<tr>" + "".join(f'<td style="text-align: left">{cell}</td>' for cell in cells) + "</tr>")
    more = len(found) - len(rows)
    heads = ["name", "unit", *(f"at {time:g} s" for time, _ in ends)]
    return (
        f"<p>{escape(head)}</p>\n<table>\n<thead><tr>"
        + "".join(f'<th style="text-align: left">{text}</th>' for text in heads)
        + "</tr></thead>\n<tbody>\n"
        + "\n".join(rows)
        + "\n</tbody>\n</table>"
        + (f"\n<p>and {more} more</p>" if more > 0 else "")
    )


def _shown(values: Sequence[Any]) -> str:
    shown = [f"{v:.5g}" if isinstance(v, float) else str(v) for v in values[:_MOST_ELEMENTS]]
    return ", ".join([*shown, "..."] if len(values) > len(shown) else shown)
