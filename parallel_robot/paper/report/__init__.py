"""The reproduction of the paper as one HTML page: claims, figures, interactive errors, and the robot in motion."""

from __future__ import annotations

from pathlib import Path

from cosim.page.document import Section
from parallel_robot.paper.report.page import page
from parallel_robot.paper.reproduce.content import Reproduction
from parallel_robot.paper.robustness.content import Robustness

#: Name of the page in its folder.
REPORT = "report.html"


def write_report(
    content: Reproduction, folder: Path, study: tuple[Robustness, Path] | None = None, live: Section | None = None
) -> Path:
    """Write `report.html`, which needs no other file and no network; the same content gives the same bytes.

    Parameters
    ----------
    content : Reproduction
        What was found; the files of its figures must be there.
    folder : Path
    study : tuple of Robustness and Path, optional
        The robustness study and its folder, for a section of the page.
    live : Section, optional
        Of `parallel_robot.live.page.live_section`: gains to be turned.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    OSError
        A figure can't be read, or the page can't be written.
    """
    path = folder / REPORT
    path.write_text(page(content, study, live), encoding="utf-8", newline="\n")
    return path
