"""Why a Python package can't be used here."""

from __future__ import annotations

from importlib.util import find_spec


def missing(module: str, remedy: str) -> str | None:
    """One line that names the remedy where a module isn't installed, else None."""
    return None if find_spec(module) else f"not installed: {remedy}"
