"""What can go wrong, in classes: each message is one line that names what was wrong, where, and the remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cosim.results import Results


class CosimError(Exception):
    """Base of all errors that a user can mend."""


class SetupError(CosimError):
    """A system can't be simulated as described; found before anything runs."""


class SimulationError(CosimError):
    """A run ended before its stop time.

    Attributes
    ----------
    component : str
        Name of the component that failed.
    time : float
        Communication point (s) at which it failed.
    log : str
        What the FMU said, empty if nothing.
    results : Results or None
        What had been recorded; None when the run failed before its first communication point.
    """

    def __init__(self, component: str, time: float, what: str, log: str) -> None:
        message = f"{component} failed at t = {time:.9g} s: {what}"
        super().__init__(f"{message}: {log}" if log else message)
        self.component = component
        self.time = time
        self.log = log
        self.results: Results | None = None


class SimulationInterrupted(KeyboardInterrupt):
    """Ctrl-C ended a run; `results` holds what had been recorded."""

    def __init__(self, time: float, results: Results) -> None:
        super().__init__(f"interrupted at t = {time:.9g} s")
        self.time = time
        self.results = results


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
