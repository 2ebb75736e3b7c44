"""FMI++: no driver, for its source no longer compiles; the module gives the reason."""

from __future__ import annotations

from pathlib import Path

from interop.tools.case import Case, ToolRun

NAME = "fmipp"
TITLE = "FMI++"
PACKAGE = "fmipp"


def unavailable() -> str | None:
    """Seen with fmipp 2.1.0 and SUNDIALS 6.4."""
    return "no driver: pip has only its source (2.1.0), which needs patches to compile against today's SUNDIALS"


def run(case: Case, folder: Path) -> ToolRun:
    """Never called."""
    raise NotImplementedError(unavailable())
