"""A run that ended before its stop time, with what it had recorded."""

from __future__ import annotations

from cosim.errors import CosimError
from cosim.fmi.instance import CallFailed, CallInterrupted, Instance
from cosim.results.results import Results
from cosim.results.stored import StoredResults


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

    Where a function in Python raised, its exception is the `__cause__`.
    """

    def __init__(self, component: str, time: float, what: str, log: str) -> None:
        message = f"{component} failed at t = {time:.9g} s: {what}"
        super().__init__(f"{message}: {log}" if log else message)
        self.component = component
        self.time = time
        self.log = log
        self.results: Results | StoredResults | None = None


class SimulationInterrupted(KeyboardInterrupt):
    """Ctrl-C ended a run; `results` holds what had been recorded."""

    def __init__(self, time: float, results: Results | StoredResults) -> None:
        super().__init__(f"interrupted at t = {time:.9g} s")
        self.time = time
        self.results: Results | StoredResults = results


class InterruptedInCall(KeyboardInterrupt):
    """Ctrl-C came while a component computed by way of Python; the run makes a `SimulationInterrupted` of it."""

    def __init__(self, time: float) -> None:
        super().__init__(f"interrupted at t = {time:.9g} s")
        self.time = time


#: What to do where an FMU refuses what its inputs do during a step.
HOLD_INSTEAD = ", though it says that it interpolates inputs; use extrapolation='hold' (option --extrapolation hold)"


def reason_of(error: CallFailed) -> str:
    """A failed call in words, with the remedy if it was that for derivatives of inputs, alone or with a step."""
    return f"{error}{HOLD_INSTEAD if 'InputDerivatives' in error.function else ''}"


class Failing:
    """Context that turns a failed call into the error of a component at a time; a class, for it is entered often."""

    __slots__ = ("component", "instance", "time")

    def __init__(self, component: str, time: float, instance: Instance) -> None:
        self.component, self.time, self.instance = component, time, instance

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, CallInterrupted):
            raise InterruptedInCall(self.time) from error
        if isinstance(error, CallFailed):
            raise SimulationError(self.component, self.time, reason_of(error), self.instance.log()) from error
