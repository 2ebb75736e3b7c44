"""FMPy's command line: `fmpy simulate`, model exchange of one FMU, integrated by CVode."""

from __future__ import annotations

from pathlib import Path

from interop.tools import fmpy_cli
from interop.tools.case import Case, ToolRun

NAME = "fmpy_me"
TITLE = "FMPy, command line, model exchange by CVode"
PACKAGE = fmpy_cli.PACKAGE

RELATIVE_TOLERANCE = 1e-9

unavailable = fmpy_cli.unavailable


def run(case: Case, folder: Path) -> ToolRun:
    """As `fmpy_cli`, with the solver of FMPy in place of the FMU's own."""
    tolerance = ("--relative-tolerance", repr(RELATIVE_TOLERANCE))
    return fmpy_cli.run(case, folder, "--interface-type", "ModelExchange", "--solver", "CVode", *tolerance)
