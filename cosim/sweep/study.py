"""The study: the meaning of the points of a sweep, which each application defines."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from cosim.errors import SetupError
from cosim.master.simulation import Simulation
from cosim.results.results import Results
from cosim.sweep.batch import RowValue
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Factor, Range, Value
from cosim.system.system import Signal


@dataclass(frozen=True)
class PlannedRun:
    """One run.

    Attributes
    ----------
    variant : hashable
        Which simulation; one is kept open for all runs of the same variant.
    stop_time, step_size : float
        In s.
    start : mapping
        Start values `component.variable`.
    signals : sequence of Signal
        In place of those of the system with the same targets.
    start_time : float
        In s.
    record_every : int
        Record at every so many communication points.
    tolerance : float, optional
        Relative tolerance that the FMUs are told.
    """

    variant: Hashable
    stop_time: float
    step_size: float
    start: Mapping[str, Any] = field(default_factory=dict)
    signals: Sequence[Signal] = ()
    start_time: float = 0.0
    record_every: int = 1
    tolerance: float | None = None


class Study(Protocol):
    """From a point to a run, and from a run to a row.

    Travels to the workers by pickle, once: plain data, of classes of installed packages. FMU files travel by
    themselves and are known by the SHA-256 of their contents.
    """

    @property
    def metrics(self) -> Sequence[str]:
        """Names of the numbers of a row."""
        ...

    @property
    def curves(self) -> Sequence[str]:
        """Names of what else a row has: arrays (n,) of numbers, kept as 32-bit floats."""
        ...

    def simulation(self, variant: Hashable, fmu: Callable[[str], Path]) -> Simulation:
        """The simulation of a variant, not yet open; `fmu` gives the path of an FMU by its SHA-256."""
        ...

    def plan(self, point: Mapping[str, Value]) -> PlannedRun:
        """The run of a point; an error here makes the point an error row."""
        ...

    def row(self, planned: PlannedRun, results: Results) -> Mapping[str, RowValue]:
        """Metrics and curves of a run."""
        ...

    def fingerprint(self) -> Mapping[str, Any]:
        """All that decides a row besides the point, as JSON can write it."""
        ...


def check_start(simulation: Simulation, factor: Factor) -> None:
    """Whether a start value can be varied: at least one of its numbers must be accepted, for the others are error rows.

    Raises
    ------
    SweepError
        All are refused: there is no such variable, it can't be set, or something feeds it; or a text is refused.
    """
    refused = None
    for value in (factor.low, factor.high) if isinstance(factor, Range) else factor.values:
        try:
            simulation._extra_starts({factor.name: value})
        except SetupError as error:
            refused = error
            if isinstance(value, str):  # a misspelt word is no experiment
                break
        else:
            if not isinstance(value, str):
                return
    if refused is None:
        return
    raise SweepError(f"{factor.name}: {refused}") from refused
