"""The claims of the paper, read from `claims.toml`, with computed verdicts."""

from __future__ import annotations

import operator
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cosim.errors import ArgumentError
from parallel_robot.paper.reproduce import gains, model, proof, tracking  # noqa: F401 -- they register their measures
from parallel_robot.paper.reproduce.content import Claim, Measured, Verdict
from parallel_robot.paper.reproduce.material import MEASURES, Material

FILE = Path(__file__).with_name("claims.toml")

RELATIONS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


@dataclass(frozen=True)
class Row:
    """A row of `claims.toml`; either `metric`, `relation` and `threshold`, or `reason`.

    Raises
    ------
    ArgumentError
        The row has neither or both, or names a measure or relation that is not there.
    """

    id: str
    where: str
    claim: str
    runs: tuple[str, ...] = ()
    metric: str = ""
    relation: str = ""
    threshold: float | None = None
    reason: str = ""

    def __post_init__(self) -> None:
        if bool(self.metric) == bool(self.reason):
            raise ArgumentError(f"claim {self.id!r}: give either a metric or the reason why it can't be judged")
        if self.metric and (self.metric not in MEASURES or self.relation not in RELATIONS or self.threshold is None):
            raise ArgumentError(f"claim {self.id!r}: metric, relation or threshold is missing or unknown")


def rows(file: Path = FILE) -> tuple[Row, ...]:
    """Rows of `claims.toml`, in its order.

    Raises
    ------
    ArgumentError
        A row is malformed, or an id is there twice.
    """
    data = tomllib.loads(file.read_text(encoding="utf-8"))
    found = tuple(Row(**{**row, "runs": tuple(row.get("runs", ()))}) for row in data["claim"])
    if len({row.id for row in found}) < len(found):
        raise ArgumentError(f"{file.name}: an id is there twice")
    return found


def verdict(met: int, total: int) -> Verdict:
    """Verdict for how many of the values meet the threshold."""
    if met == total > 0:
        return "holds"
    return "holds in part" if met else "does not hold"


def judge(row: Row, material: Material) -> Claim:
    """Compute the measure of a claim, and compare its values with the threshold."""
    if row.threshold is None:
        measured, met, why = Measured({}), 0, row.reason
        found: Verdict = "cannot be judged"
    else:
        measured = MEASURES[row.metric](material)
        threshold, relation = row.threshold, RELATIONS[row.relation]
        met = sum(relation(value, threshold) for value in measured.values.values())
        found, why = verdict(met, len(measured.values)), _in_words(row, measured, met)
    return Claim(
        id=row.id,
        where=row.where,
        claim=row.claim,
        runs=row.runs,
        metric=row.metric,
        relation=row.relation,
        threshold=row.threshold,
        unit=measured.unit,
        values=measured.values,
        met=met,
        total=len(measured.values),
        verdict=found,
        why=why,
    )


def _in_words(row: Row, measured: Measured, met: int) -> str:
    unit = "" if measured.unit == "1" else f" {measured.unit}"
    low, high = (pick(measured.values, key=lambda label: measured.values[label]) for pick in (min, max))
    limits = f"{row.relation} {row.threshold:.3g}{unit}"
    if len(measured.values) == 1:
        text = f"{low}: {measured.values[low]:.3g}{unit}, to be {limits}"
    else:
        text = (
            f"{met} of {len(measured.values)} values are {limits}; least {measured.values[low]:.3g}{unit} ({low}), "
            f"largest {measured.values[high]:.3g}{unit} ({high})"
        )
    return text + (f"; {measured.note}" if measured.note else "")


def judge_all(material: Material) -> tuple[Claim, ...]:
    """All claims with their verdicts."""
    return tuple(judge(row, material) for row in rows())
