"""Results of the robustness study as plain data: written to JSON, read back for the report."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cosim.errors import ArgumentError, CosimError
from cosim.sweep.sensitivity import Index

#: Files of the study in its folder.
DATA, TEXT, BANDS, FIGURES = "robustness.json", "robustness.md", "bands.csv", "figures"

#: Where a controller is, seen from the Pareto front.
Place = Literal["on the front", "near the front", "away from the front"]


class RobustnessError(CosimError):
    """There is no finished study in a folder."""


@dataclass(frozen=True)
class SourceRow:
    """An uncertain factor: group in which it is judged, unit, distribution in words."""

    name: str
    group: str
    unit: str
    distribution: str


@dataclass(frozen=True)
class Spread:
    """One result over all runs.

    Attributes
    ----------
    name, unit : str
    nominal : float
        Without noise, in the case that the paper simulates (scenario `tracking`).
    low, median, high : float
        5 %, 50 % and 95 % of the runs lie below.
    largest : float
    """

    name: str
    unit: str
    nominal: float
    low: float
    median: float
    high: float
    largest: float


@dataclass(frozen=True)
class Sensitivity:
    """Sobol' indices of one result.

    Attributes
    ----------
    result : str
    indices : tuple of Index
    trends : mapping
        Group of one factor that has an order -> its rank correlation with the result.
    """

    result: str
    indices: tuple[Index, ...]
    trends: Mapping[str, float]


@dataclass(frozen=True)
class Placed:
    """One of the paper's controllers among all gains of the grid.

    Attributes
    ----------
    controller : str
        Key as in `parallel_robot.paper.reproduce.content.Controller`.
    alpha, beta : float
    error : float
        Steady error (mm).
    effort : float
        Control effort (N m).
    dominated_by : int
        Gains of the grid that are better in both.
    error_alone, effort_alone : float
        Largest factor by which one can be lowered without raising the other.
    error_for_more : float
        Factor by which the error can be lowered for 5 % more effort.
    place : Place
    """

    controller: str
    alpha: float
    beta: float
    error: float
    effort: float
    dominated_by: int
    error_alone: float
    effort_alone: float
    error_for_more: float
    place: Place


@dataclass(frozen=True)
class FrontPoint:
    """Gains that no other gains of the grid better in both error (mm) and effort (N m)."""

    alpha: float
    beta: float
    error: float
    effort: float


@dataclass(frozen=True)
class Front:
    """Steady error against control effort in one condition, a scenario.

    Attributes
    ----------
    condition : str
    gains : int
        How many gains the grid has.
    near : int
        How many of them are on the front or near it.
    at_edge : int
        How many points of the front have the largest alpha or beta of the grid.
    beyond_proof : int
        How many points of the front have a beta that the proof's k >= 2 beta max(S_ii) excludes.
    points : tuple of FrontPoint
        The Pareto front, by rising effort.
    placed : tuple of Placed
        PD, then the optima of Table 1 by rising mu/nu.
    """

    condition: str
    gains: int
    near: int
    at_edge: int
    beyond_proof: int
    points: tuple[FrontPoint, ...]
    placed: tuple[Placed, ...]


@dataclass(frozen=True)
class Finding:
    """A question, and the answer that the numbers give."""

    question: str
    answer: str


@dataclass(frozen=True)
class StudyFigure:
    """A figure as files in `figures`, and its texts."""

    name: str
    title: str
    caption: str
    alt: str


@dataclass(frozen=True)
class Robustness:
    """The whole study.

    Attributes
    ----------
    runs, failed : int
        Of the Monte Carlo sweep.
    seed, levels : int
        What the command was asked for: seed of the design, levels of each gain.
    sources : tuple of SourceRow
    spreads : tuple of Spread
    sensitivities : tuple of Sensitivity
    fronts : tuple of Front
    findings : tuple of Finding
    figures : tuple of StudyFigure
    versions : mapping
    """

    runs: int
    failed: int
    seed: int
    levels: int
    sources: tuple[SourceRow, ...]
    spreads: tuple[Spread, ...]
    sensitivities: tuple[Sensitivity, ...]
    fronts: tuple[Front, ...]
    findings: tuple[Finding, ...]
    figures: tuple[StudyFigure, ...]
    versions: Mapping[str, str]


def load(folder: Path) -> Robustness:
    """Read a study from its folder.

    Raises
    ------
    RobustnessError
        There is none, it is not finished, or it is of another version of this program.
    """
    path = folder / DATA
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        study = _study(data)
        files = [folder / FIGURES / f"{figure.name}.{ending}" for figure in study.figures for ending in ("svg", "png")]
        missing = [file for file in files if not file.is_file()]
    except OSError as error:
        raise RobustnessError(f"{path}: {error.strerror or error}; run: cosim robustness --out {folder}") from error
    except (ValueError, TypeError, KeyError) as error:
        raise RobustnessError(f"{path}: no study of this version; run: cosim robustness --out {folder}") from error
    if missing:
        raise RobustnessError(f"{missing[0]} is missing; run: cosim robustness --out {folder}")
    return study


def _study(data: Mapping[str, Any]) -> Robustness:
    fields = {f.name for f in dataclasses.fields(Robustness)}
    if set(data) != fields:
        raise ArgumentError("other fields")
    return Robustness(
        **{
            **data,
            "sources": tuple(SourceRow(**row) for row in data["sources"]),
            "spreads": tuple(Spread(**row) for row in data["spreads"]),
            "sensitivities": tuple(
                Sensitivity(**{**row, "indices": tuple(_index(index) for index in row["indices"])})
                for row in data["sensitivities"]
            ),
            "fronts": tuple(
                Front(
                    **{
                        **row,
                        "points": tuple(FrontPoint(**point) for point in row["points"]),
                        "placed": tuple(Placed(**placed) for placed in row["placed"]),
                    }
                )
                for row in data["fronts"]
            ),
            "findings": tuple(Finding(**row) for row in data["findings"]),
            "figures": tuple(StudyFigure(**row) for row in data["figures"]),
        }
    )


def _index(data: Mapping[str, Any]) -> Index:
    intervals = {name: tuple(data[name]) for name in ("first_interval", "total_interval")}
    return Index(**{**data, **intervals})
