"""PyFMI: no driver, for it can't be installed by pip; the module gives the reason."""

from __future__ import annotations

from pathlib import Path

from interop.tools.case import Case, ToolRun

NAME = "pyfmi"
TITLE = "PyFMI"
PACKAGE = "PyFMI"


def unavailable() -> str | None:
    """Seen with pip's newest, 2.5."""
    return "no driver: pip has only its source (2.5), which needs FMI Library and Assimulo; conda-forge has binaries"


def run(case: Case, folder: Path) -> ToolRun:
    """Never called."""
    raise NotImplementedError(unavailable())
