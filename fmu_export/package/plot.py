"""The curves of a run as an SVG element: a panel for each variable, the elements of a vector in one.

It is written here and not drawn by matplotlib, which takes longer for it than for all else that a build does in Python;
its texts stay texts.
"""

from __future__ import annotations

import math
from html import escape

import numpy as np

from fmu_export.modelling.variables import Array, Layout, Variable

#: Colours of the elements of a vector, in turns: those that tell most apart, also for the colour-blind.
_COLOURS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f")

#: Panels: how many in a row, size of a cell and of the panel in it, and where it begins there (px).
_COLUMNS, _CELL, _PANEL, _CORNER = 2, (360.0, 118.0), (246.0, 92.0), (66.0, 8.0)
#: Room for the labels of the time below the last row (px).
_BELOW = 34.0

#: An axis has no more steps between labels, each of them so often a power of ten.
_MOST_STEPS, _STEPS = 4, (1.0, 2.0, 2.5, 5.0, 10.0)

_STYLE = (
    "text{font:10px system-ui,sans-serif;fill:#222}"
    "path,rect,line{fill:none}"
    "path{stroke-width:1.3;stroke-linejoin:round}"
    "rect{stroke:#222;stroke-width:.8}"
    "line{stroke:#b0b0b0;stroke-width:.5}"
    ".y{text-anchor:end}.x,.v{text-anchor:middle}"
)


def curves(outputs: Layout, time: Array, values: Array) -> str:
    """The SVG element.

    Parameters
    ----------
    outputs : Layout
    time : (rows,) array
        In s; at least two rows.
    values : (rows, n_y) array
        Finite.
    """
    variables, first = outputs.variables, 0
    n_rows = -(-len(variables) // _COLUMNS)
    width, height = _COLUMNS * _CELL[0], n_rows * _CELL[1] + _BELOW
    parts = []
    for k, variable in enumerate(variables):
        corner = (k % _COLUMNS * _CELL[0] + _CORNER[0], k // _COLUMNS * _CELL[1] + _CORNER[1])
        is_last = k + _COLUMNS >= len(variables)
        parts.append(_panel(corner, variable, time, values[:, first : first + variable.n_elements], is_last))
        first += variable.n_elements
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
        f'viewBox="0 0 {width:g} {height:g}" role="img">\n<style>{_STYLE}</style>\n' + "".join(parts) + "</svg>\n"
    )


def _panel(corner: tuple[float, float], variable: Variable, time: Array, values: Array, with_time: bool) -> str:
    """One panel, whose upper left corner is there."""
    (left, top), (width, height) = corner, _PANEL
    low, high = _with_margins(float(values.min()), float(values.max()))

    def across(t: Array | float) -> Array:
        return np.asarray(left + width * (t - time[0]) / (time[-1] - time[0]))

    def up(value: Array | float) -> Array:
        return np.asarray(top + height * (high - value) / (high - low))

    parts = []
    for tick, text in _ticks(low, high):
        y = f"{up(tick):.1f}"
        parts.append(f'<line x1="{left:g}" x2="{left + width:g}" y1="{y}" y2="{y}"/>')
        parts.append(f'<text class="y" x="{left - 4:g}" y="{up(tick) + 3.5:.1f}">{text}</text>')
    for tick, text in _ticks(float(time[0]), float(time[-1])):
        x = f"{across(tick):.1f}"
        parts.append(f'<line x1="{x}" x2="{x}" y1="{top:g}" y2="{top + height:g}"/>')
        if with_time:
            parts.append(f'<text class="x" x="{x}" y="{top + height + 13:g}">{text}</text>')
    for k, (name, column) in enumerate(zip(variable.names, values.T, strict=True)):
        colour = _COLOURS[k % len(_COLOURS)]
        places = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across(time), up(column), strict=True))
        parts.append(f'<path stroke="{colour}" d="M{places}"/>')
        if variable.size and k < len(_COLOURS):
            line = top + height / 2 + 12 * (k - 0.5 * min(variable.n_elements, len(_COLOURS)) + 0.5)
            parts.append(f'<path stroke="{colour}" d="M{left + width + 6:g},{line:g}h12"/>')
            label = escape(name.removeprefix(variable.name))
            parts.append(f'<text x="{left + width + 21:g}" y="{line + 3.5:g}">{label}</text>')
    parts.append(f'<rect x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}"/>')
    label = escape(f"{variable.name} ({variable.unit})" if variable.unit != "1" else variable.name)
    at = f"{left - 52:g} {top + height / 2:g}"
    parts.append(f'<text class="v" transform="translate({at}) rotate(-90)">{label}</text>')
    if with_time:
        parts.append(f'<text class="x" x="{left + width / 2:g}" y="{top + height + 27:g}">time (s)</text>')
    return "\n".join(parts) + "\n"


def _with_margins(low: float, high: float) -> tuple[float, float]:
    """The extent of a panel for values from `low` to `high`."""
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def _ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Round numbers between two numbers, with their texts."""
    least = (high - low) / _MOST_STEPS
    if not 1e-300 < least < math.inf:
        return []
    decade = 10.0 ** math.floor(math.log10(least))
    step = next(factor * decade for factor in _STEPS if factor * decade >= least * (1.0 - 1e-9))
    ticks = (k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1))
    return [(tick, f"{tick:.10g}") for tick in ticks if low <= tick <= high]
