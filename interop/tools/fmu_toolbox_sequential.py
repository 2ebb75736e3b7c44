"""The container of the FMU Manipulation Toolbox in its sequential mode: more accurate, and slower."""

from __future__ import annotations

from pathlib import Path

from interop.tools import fmu_toolbox
from interop.tools.case import Case, ToolRun

NAME = "fmu_toolbox_sequential"
TITLE = "FMU Manipulation Toolbox, container, sequential"
PACKAGE = fmu_toolbox.PACKAGE

unavailable = fmu_toolbox.unavailable


def run(case: Case, folder: Path) -> ToolRun:
    """As `fmu_toolbox`, each FMU stepping after those that feed it."""
    return fmu_toolbox.run(case, folder, sequential=True)
