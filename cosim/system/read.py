"""A system as a file of another tool describes it, and what was found while the file was read."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from fmpy.model_description import ModelDescription

from cosim.errors import CosimError
from cosim.system.system import System

#: Of one kind of notes this many are shown; a description with a thousand connectors may have a thousand of them.
_MOST_NOTES = 3

#: Communication steps where neither options nor files say how long one is.
STEPS = 500

#: How long a run is (s) where neither options nor files say when it stops: as in FMPy, OMSimulator and OSP's cosim.
DURATION = 1.0

#: This many problems are shown in one message.
_MOST_PROBLEMS = 20


@dataclass(frozen=True)
class ReadSystem:
    """What a description of a system holds.

    Attributes
    ----------
    name : str
    system : System
        Components of nested systems are named `system/component`.
    start_time : float
        In s; 0 where the description has none.
    stop_time, step_size : float, optional
        In s, if the description or its FMUs say.
    notes : tuple of str
        What was ignored, assumed or taken as it is, and the user should know.
    order, extrapolation : str
        How values are exchanged where the user does not say; see `cosim.master.coupling.algorithm`.
    places : mapping
        Component -> lower left and upper right corner (x1, y1, x2, y2) in the description's diagram, y upwards.
    """

    name: str
    system: System
    start_time: float
    stop_time: float | None
    step_size: float | None
    notes: tuple[str, ...]
    order: str = "sequential"
    extrapolation: str = "auto"
    places: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)


@dataclass
class Findings:
    """Notes and problems that a reader collects, so that a user learns of all of them at once.

    Attributes
    ----------
    error : type
        Of the error that names the problems.
    """

    error: type[CosimError] = CosimError
    _notes: dict[str, list[str]] = field(default_factory=dict)
    _problems: list[str] = field(default_factory=list)
    _kinds: Counter[str] = field(default_factory=Counter)

    def note(self, text: str, kind: str = "") -> None:
        """Note something once; of a kind that is named, the first few are shown and the others counted."""
        key = kind or text
        shown = self._notes.setdefault(key, [])
        if text not in shown:
            self._kinds[key] += 1
            if len(shown) < _MOST_NOTES:
                shown.append(text)

    def problem(self, text: str) -> None:
        """Remember a reason why the system can't be run."""
        if text not in self._problems:
            self._problems.append(text)

    @contextmanager
    def collecting(self) -> Iterator[None]:
        """Context in which an error becomes one of the problems."""
        try:
            yield
        except CosimError as error:
            self.problem(str(error))

    def raise_problems(self, where: str, *others: str) -> None:
        """End with all problems in one line, if there are any.

        Parameters
        ----------
        where, *others : str
            Names of the file and of what it is in; messages that begin with them need not repeat them.
        """
        if not self._problems:
            return
        if len(self._problems) == 1:
            raise self.error(self._problems[0])
        shown = self._problems[:_MOST_PROBLEMS]
        for known in (where, *others):
            shown = [text.removeprefix(f"{known}: ") for text in shown]
        listed = "; ".join(f"({k}) {text}" for k, text in enumerate(shown, 1))
        more = len(self._problems) - len(shown)
        rest = f"; and {more} more" if more else ""
        raise self.error(f"{where}: {len(self._problems)} things are wrong: {listed}{rest}")

    def notes(self) -> tuple[str, ...]:
        """All notes, in order."""
        found = []
        for key, shown in self._notes.items():
            found += shown
            more = self._kinds[key] - len(shown)
            if more:
                found[-1] += f" (and {more} more of this kind)"
        return tuple(found)


def longest_experiment(fmus: Iterable[ModelDescription], start_time: float) -> float | None:
    """The latest stop time (s) of default experiments that ends after a start time (s), if an FMU has one."""
    experiments = [fmu.defaultExperiment for fmu in fmus if fmu.defaultExperiment is not None]
    stops = [float(e.stopTime) for e in experiments if e.stopTime is not None]
    return max((stop for stop in stops if math.isfinite(stop) and stop > start_time), default=None)


def fitting_step(duration: float, step: float) -> float:
    """The longest step (s) that is not longer than another one and of which a duration (s) is a whole number."""
    number = duration / step
    if not (math.isfinite(number) and number > 0) or math.isclose(number, round(number), rel_tol=1e-9):
        return step
    return duration / math.ceil(number)


def assumed_stop_time(where: str, start_time: float, duration: float) -> str:
    """The note on a run (times in s) whose stop time nothing says."""
    return (
        f"{where}: neither it nor its FMUs say when to stop; {start_time + duration:g} s is taken, {duration:g} s "
        "after the start (--stop)"
    )


def multiple_of_step(step: float, communication_step: float | None, what: str, findings: Findings) -> int:
    """Of how many communication steps a step of a component is made; another one is rounded, with a note.

    Parameters
    ----------
    step, communication_step : float
        In s; a step of 0 is that of all.
    what : str
        What says so, for messages.
    findings : Findings
    """
    if not (math.isfinite(step) and step >= 0):
        findings.problem(f"{what} is {step!r}; it must be a positive number of seconds")
        return 1
    if communication_step is None or not communication_step > 0:
        return 1
    every = max(1, round(step / communication_step))
    if step > 0 and not math.isclose(every * communication_step, step, rel_tol=1e-9):
        findings.note(
            f"{what} {step!r} s is not a multiple of {communication_step!r} s; "
            f"{every * communication_step:g} s is taken, as libcosim does"
        )
    return every
