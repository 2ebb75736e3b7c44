"""What can go wrong, in classes: each message is one line that names what was wrong, where, and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class CosimError(Exception):
    """Base of all errors that a user can mend."""


class SetupError(CosimError):
    """A system can't be simulated as described; found before anything runs."""


class ResultsError(CosimError):
    """A result file can't be read, or has no variable of a name."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Hint for a wrong name: the nearest known one, or all of them when none is near."""
    names = list(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    if not names:
        return "there are none"
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"known are {shown}"
