"""What FMI allows in which state of an instance; copied into archives, so it needs the standard library only."""

from __future__ import annotations

from enum import Flag, auto
from math import inf, isfinite, isnan

#: Relative precision of a float.
_EPSILON = 2.0**-52


class Phase(Flag):
    """States of the standard's state machine of co-simulation; elsewhere here "state" is that of the model."""

    INSTANTIATED = auto()
    INITIALIZATION = auto()
    STEP = auto()
    DISCARDED = auto()  # after a step that was discarded, until a saved state is restored
    TERMINATED = auto()
    FAILED = auto()  # after an error, until a saved state is restored or the instance reset


OVER = Phase.DISCARDED | Phase.TERMINATED | Phase.FAILED
ANY = Phase.INSTANTIATED | Phase.INITIALIZATION | Phase.STEP | OVER

_WHEN = dict.fromkeys(Phase, "in this state; see the state machine of the FMI standard") | {
    Phase.INSTANTIATED: "before the initialisation mode",
    Phase.DISCARDED: "after a discarded step; restore the FMU state from before the step, or reset the instance",
    Phase.FAILED: "after an error; restore a saved FMU state, or reset the instance",
}


class LifeCycle:
    """What an instance knows of its life: the phase, and the times that its steps must keep to.

    Methods say why something can't be, or nothing.
    """

    def __init__(self) -> None:
        self._phase = Phase.INSTANTIATED
        self._time = 0.0
        self._stop = inf  # of the experiment, and so of no saved state
        self._set_up = False  # the importer has said when the experiment starts

    def _not_in_this_phase(self, function: str) -> str:
        return f"{function} can't be called {_WHEN[self._phase]}"

    def _begin_at(self, start: float, stop: float | None) -> str:
        """Take the times of the experiment (s)."""
        if not isfinite(start):
            return f"start time {start} is not a finite number"
        if stop is not None and isnan(stop):
            return f"stop time {stop} is not a number"
        self._time, self._stop, self._set_up = start, inf if stop is None else stop, True
        return ""

    def _begin_initialization(self) -> str:
        if not self._set_up:
            return "setup_experiment (fmi2SetupExperiment) must be called before enter_initialization_mode"
        self._phase = Phase.INITIALIZATION
        return ""

    def _why_no_step(self, time: float, h: float) -> str:
        """A step (s) that begins elsewhere or ends too late; importers' times differ by rounding from those here."""
        size = 1.0 + abs(time)
        if not (isfinite(time) and isfinite(time + h) and h > 0.0):
            return f"communication step {h!r} s at {time!r} s is not positive and finite"
        if abs(time - self._time) > min(1e-9 * size, 1e-2 * h) + 4.0 * _EPSILON * size:
            return (
                f"communication step from {time!r} s: this FMU is at {self._time!r} s; go on there, or restore an FMU "
                "state"
            )
        if time + h > self._stop + 1e-9 * size + 1e-3 * h:
            return (
                f"communication step {h!r} s from {time!r} s goes past {self._stop!r} s, which is the stop time of the "
                "experiment; define a later one, or none"
            )
        return ""
