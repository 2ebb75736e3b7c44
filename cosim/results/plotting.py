"""Values over time in panels; the plot behind `Results.plot`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from cosim.errors import ResultsError
from cosim.results.display import grouped

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded

#: Okabe and Ito's colours, which colour-blind readers can tell apart; dashes tell them apart in greyscale.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
_DASHES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 3)))

#: Rows of panels before another column is begun, and columns.
_ROWS, _COLUMNS = 6, 6

#: A curve shows at most about this many points.
_MOST_POINTS = 100_000


def plot(recorded: Recorded, names: Sequence[str]) -> list[Axes]:
    """Draw; see `Recorded.plot`."""
    chosen = {name: recorded._find(name) for name in names} or grouped(recorded.names)
    n = len(chosen)
    if not chosen:
        raise ResultsError("nothing was recorded; there is nothing to plot")
    if n > _ROWS * _COLUMNS:
        raise ResultsError(
            f"{n} variables are too many for one figure; name some, as results.plot('{next(iter(chosen))}')"
        )
    columns = -(-n // _ROWS)
    rows = -(-n // columns)
    size = (max(7.0, 4.2 * columns), 0.7 + 1.8 * rows)
    _, grid = plt.subplots(rows, columns, sharex=True, squeeze=False, figsize=size, layout="constrained")
    panels = list(grid.T.flat)  # down the columns, as the names are read
    every = max(1, len(recorded.time) // _MOST_POINTS)
    for axes, (name, positions) in zip(panels, chosen.items(), strict=False):
        _panel(axes, recorded, name, positions, every)
    for axes in panels[n:]:
        axes.remove()
    for column in range(columns):  # below the last panel of each column
        last = panels[min((column + 1) * rows, n) - 1]
        last.tick_params(labelbottom=True)
        last.set_xlabel("time (s)")
    return panels[:n]


def _panel(axes: Axes, recorded: Recorded, name: str, positions: int | list[int], every: int) -> None:
    elements = [positions] if isinstance(positions, int) else positions
    values = recorded._values(elements, every)
    for i, position in enumerate(elements):
        style: dict[str, Any] = {"color": _COLOURS[i % len(_COLOURS)], "linestyle": _DASHES[i % len(_DASHES)]}
        label = recorded.names[position].removeprefix(name)
        axes.plot(recorded.time[::every], values[:, i], linewidth=1.3, label=label, **style)
    axes.set_title(name, fontsize=10, loc="left", parse_math=False)
    axes.set_ylabel(_unit(recorded, elements), parse_math=False)
    axes.grid(alpha=0.3)
    axes.margins(x=0.0)
    if np.size(elements) > 1:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8, handlelength=2.5)


def _unit(recorded: Recorded, elements: Sequence[int]) -> str:
    """The unit that the elements have in common, if any."""
    units = {recorded.units.get(recorded.names[i], "") for i in elements}
    return units.pop() if len(units) == 1 else ""
