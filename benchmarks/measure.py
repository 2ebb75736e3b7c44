"""Interleaved timing: the machine drifts, so what is compared is measured in turn, and the medians are compared."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Section:
    """A part of the report.

    Attributes
    ----------
    title, method : str
        For people: what is measured, and how.
    header : tuple of str
        Heads of the table.
    rows : list of tuple
        Cells, as they are shown.
    data : dict
        The same as numbers, for machines.
    verdicts : list of (str, bool)
        What must hold, with the figure, and whether it does.
    """

    title: str
    method: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]
    data: dict[str, object]
    verdicts: list[tuple[str, bool]] = field(default_factory=list)


def interleaved(calls: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, list[float]]:
    """Seconds of each call, all called once a round; the first round warms up and does not count."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for i in range(rounds + 1):
        for name, call in calls.items():
            value = call()
            if i:
                seconds[name].append(value)
    return seconds


def ratio(slow: list[float], fast: list[float]) -> float:
    """Median of the ratios within the rounds."""
    return statistics.median(a / b for a, b in zip(slow, fast, strict=True))
