"""One look for all figures: colours for the colour-blind, dashes and markers for greyscale."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib import style
from matplotlib.figure import Figure

STYLE = Path(__file__).with_name("style.mplstyle")

BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION = "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00"

#: Line of each controller by its key: colour, dashes and marker each tell it apart alone.
CONTROLLER_LINES: dict[str, dict[str, Any]] = {
    "pd": {"color": BLACK, "linestyle": (0, (1, 1.2)), "marker": "x"},
    "0.1": {"color": ORANGE, "linestyle": (0, (6, 1.5)), "marker": "o"},
    "0.2": {"color": SKY, "linestyle": (0, (4, 1.2, 1, 1.2)), "marker": "s"},
    "1": {"color": GREEN, "linestyle": "-", "marker": "^"},
    "5": {"color": BLUE, "linestyle": (0, (3, 1.2)), "marker": "D"},
    "10": {"color": VERMILION, "linestyle": (0, (8, 1.5, 1, 1.5, 1, 1.5)), "marker": "v"},
}

#: A curve is drawn with at most about this many points; more are not seen and make files large.
MOST_POINTS = 1500

ERROR_NAMES = {"x": "x", "y": "y", **{f"theta_a[{i}]": rf"$\theta_{{a{i}}}$" for i in (1, 2, 3)}}

ERROR_WORDS = {"x": "x", "y": "y", **{f"theta_a[{i}]": f"active joint {i}" for i in (1, 2, 3)}}


def error_unit(name: str) -> str:
    """Unit of a tracking error, times 1e-3."""
    return "mm" if name in ("x", "y") else "mrad"


@dataclass(frozen=True)
class Drawing:
    """A figure before it is drawn; the texts are as in `content.PaperFigure`, sizes in inches."""

    number: int
    title: str
    caption: str
    alt: str
    draw: Callable[[Figure], None]
    size: tuple[float, float] = (7.5, 3.6)


def save(drawing: Drawing, folder: Path) -> tuple[Path, Path]:
    """Draw and write `fig_<number>.svg` and `.png`; and files that stay the same.

    Raises
    ------
    OSError
        A file can't be written.
    """
    paths = tuple(folder / f"fig_{drawing.number:02d}.{ending}" for ending in ("svg", "png"))
    with style.context(STYLE), mpl.rc_context():
        figure = Figure(figsize=drawing.size, layout="constrained")
        drawing.draw(figure)
        no_time: Mapping[str, Any] = {"Date": None}
        figure.savefig(paths[0], metadata=no_time)
        figure.set_layout_engine("none")  # the layout is done, and costs as much as the drawing
        figure.savefig(paths[1])
    return paths[0], paths[1]
