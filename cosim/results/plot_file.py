"""The plot of a run as a file."""

from __future__ import annotations

import warnings
from pathlib import Path

from cosim.errors import needs
from cosim.results.plotting import MOST_PANELS, draw, shortened
from cosim.results.results import Results

with needs("plot"):
    from matplotlib.figure import Figure


def write_plot(results: Results, title: str, folder: Path) -> list[Path]:
    """Draw all that a run recorded, as far as it fits, into a file `results.png`.

    Parameters
    ----------
    results : Results
    title : str
        Stands above the figure, with a note on variables that did not fit.
    folder : Path

    Returns
    -------
    list of Path
        The file that was written; none where nothing was recorded that can be drawn.

    Raises
    ------
    OSError
        The file can't be written.
    """
    groups = results.drawable()
    chosen = dict(list(groups.items())[:MOST_PANELS])
    if not chosen:
        return []
    if len(chosen) < len(groups):
        title += f" (the first {len(chosen)} of {len(groups)} variables)"
    figure = Figure()
    figure.suptitle(shortened(title), fontsize=10, parse_math=False)
    draw(results.time, results.panels(chosen), figure)
    path = folder / "results.png"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # a name in letters that the font lacks
        warnings.filterwarnings("ignore", category=RuntimeWarning)  # values near the largest ones that there are
        figure.savefig(path)
    return [path]
