"""Metrics that scenarios name: one number for a run, from what it recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from cosim.errors import ArgumentError, nearest
from cosim.results.results import Results
from cosim.results.stored import StoredResults


def _rms(values: np.ndarray, _time: np.ndarray) -> float:
    return float(np.sqrt(np.dot(values, values) / len(values)))


#: Name -> function of values (n,) and times (n,) in s. Integrals are over time, by trapezoids.
MEASURES: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
    "max": lambda values, _: float(values.max()),
    "min": lambda values, _: float(values.min()),
    "max_abs": lambda values, _: float(np.abs(values).max()),
    "mean": lambda values, _: float(values.mean()),
    "rms": _rms,
    "std": lambda values, _: float(values.std()),
    "initial": lambda values, _: float(values[0]),
    "final": lambda values, _: float(values[-1]),
    "integral": lambda values, time: float(np.trapezoid(values, time)),
    "integral_abs": lambda values, time: float(np.trapezoid(np.abs(values), time)),
    "integral_squared": lambda values, time: float(np.trapezoid(values * values, time)),
}


@dataclass(frozen=True)
class Metric:
    """One number for a run.

    Parameters
    ----------
    of : str
        Recorded scalar `component.variable`.
    measure : str
        One of `MEASURES`.
    minus : str, optional
        Another recorded scalar, whose values are subtracted.
    after : float, optional
        Only points from this time (s) on count.
    """

    of: str
    measure: str
    minus: str | None = None
    after: float | None = None

    def __post_init__(self) -> None:
        if self.measure not in MEASURES:
            raise ArgumentError(f"measure = {self.measure!r} is unknown; {nearest(self.measure, MEASURES)}")

    @property
    def variables(self) -> tuple[str, ...]:
        """Variables that must be recorded for it."""
        return (self.of,) if self.minus is None else (self.of, self.minus)

    def value(self, results: Results | StoredResults) -> float | None:
        """The number; None where the run recorded no points that count, or not all variables, or it is not finite."""
        if not set(self.variables) <= set(results.names):
            return None
        first = 0 if self.after is None else int(np.searchsorted(results.time, self.after))
        if first >= len(results.time):
            return None
        values, *other = (np.asarray(results[name], dtype=float) for name in self.variables)
        values = values - other[0] if other else values
        with np.errstate(over="ignore", invalid="ignore"):  # values of a run that failed
            number = MEASURES[self.measure](values[first:], results.time[first:])
        return number if np.isfinite(number) else None


def measured(metrics: Mapping[str, Metric], results: Results | StoredResults) -> dict[str, float | None]:
    """All metrics of a run by name."""
    return {name: metric.value(results) for name, metric in metrics.items()}
