"""OMSimulator: no driver, for its package can't be installed from PyPI alone; the module gives the reason."""

from __future__ import annotations

from pathlib import Path

from interop.tools.case import Case, ToolRun

NAME = "omsimulator"
TITLE = "OMSimulator"
PACKAGE = "OMSimulator"


def unavailable() -> str | None:
    """Seen with OMSimulator 3.0.0.post198."""
    return "no driver: its pip package holds no binary but fetches one from a build server; build it from source"


def run(case: Case, folder: Path) -> ToolRun:
    """Never called."""
    raise NotImplementedError(unavailable())
