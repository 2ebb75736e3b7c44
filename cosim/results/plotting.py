"""Values over time in panels; what `Results.plot` draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.errors import needs

with needs("plot"):
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Okabe and Ito's colours, which colour-blind readers can tell apart; dashes tell them apart in greyscale.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
_DASHES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 3)))

#: Rows of panels before another column is begun, and columns.
_ROWS, _COLUMNS = 6, 6

#: One figure has room for this many panels.
MOST_PANELS = _ROWS * _COLUMNS

#: Characters of a text in a figure, at most.
_LONGEST_TEXT = 120

#: A curve shows at most about this many points.
MOST_POINTS = 100_000


@dataclass(frozen=True)
class Panel:
    """A variable over time: its values (n, elements), the labels of the elements, and the unit they have in common."""

    title: str
    unit: str
    labels: Sequence[str]
    values: np.ndarray


def draw(time: np.ndarray, panels: Sequence[Panel], figure: Figure | None = None) -> list[Axes]:
    """Draw one to `MOST_PANELS` panels over the same times (n,) in s; returns their axes.

    By default the figure is one of pyplot's, which `matplotlib.pyplot.show` shows.
    """
    n = len(panels)
    columns = -(-n // _ROWS)
    rows = -(-n // columns)
    size = (max(7.0, 4.2 * columns), 0.7 + 1.8 * rows)
    if figure is None:
        with needs("plot"):
            from matplotlib import pyplot as plt  # takes a while to import, and files need none of it

        figure = plt.figure()
    figure.set_size_inches(size)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    places = list(grid.T.flat)  # down the columns, as the names are read
    for axes, panel in zip(places, panels, strict=False):
        _draw_panel(axes, time, panel)
    for axes in places[n:]:
        axes.remove()
    for column in range(columns):  # below the last panel of each column
        last = places[min((column + 1) * rows, n) - 1]
        last.tick_params(labelbottom=True)
        last.set_xlabel("time (s)")
    return places[:n]


def shortened(text: str) -> str:
    """A text that a figure has room for; a name of a megabyte would be laid out for minutes, and not be seen."""
    return text if len(text) <= _LONGEST_TEXT else f"{text[: _LONGEST_TEXT - 23]} … {text[-20:]}"


def _draw_panel(axes: Axes, time: np.ndarray, panel: Panel) -> None:
    for i, label in enumerate(panel.labels):
        style: dict[str, Any] = {"color": _COLOURS[i % len(_COLOURS)], "linestyle": _DASHES[i % len(_DASHES)]}
        axes.plot(time, panel.values[:, i], linewidth=1.3, label=shortened(label), **style)
    axes.set_title(shortened(panel.title), fontsize=10, loc="left", parse_math=False)
    axes.set_ylabel(shortened(panel.unit), parse_math=False)
    axes.grid(alpha=0.3)
    axes.margins(x=0.0)
    if len(panel.labels) > 1:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8, handlelength=2.5)
