"""Figs. 4 to 17 of the paper, as SVG and PNG."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from parallel_robot.paper.reproduce.content import PaperFigure, Runs
from parallel_robot.paper.reproduce.figures import gains, open_loop, style, tracking

#: Of the figures, as in the paper.
NUMBERS = (4, 5, 6, 7, *tracking.TIME_FIGURES.values(), *tracking.ACCUMULATED_FIGURES.values())


def drawings(runs: Runs) -> list[style.Drawing]:
    """All figures, by number."""
    return [
        open_loop.fig_4(runs),
        gains.fig_5(runs),
        gains.fig_6(runs),
        tracking.fig_7(runs),
        *(tracking.error_over_time(runs, name) for name in tracking.TIME_FIGURES),
        *(tracking.accumulated_error(runs, name) for name in tracking.ACCUMULATED_FIGURES),
    ]


def write_figures(
    runs: Runs, folder: Path, progress: Callable[[str], None] = lambda what: None
) -> tuple[PaperFigure, ...]:
    """Draw all figures into a folder, which is made.

    Raises
    ------
    OSError
        A file can't be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for drawing in drawings(runs):
        svg, png = style.save(drawing, folder)
        written.append(PaperFigure(drawing.number, drawing.title, drawing.caption, drawing.alt, svg, png))
        progress(f"figure {drawing.number}")
    return tuple(written)
