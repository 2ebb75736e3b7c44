"""The recorded values of one or several runs as curves of a page, all of them or, where that is too much, extremes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.page.encoding import Column, block, column_of, extremes, times
from cosim.results.names import grouped

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded

#: So many bytes the curves of a page may have, in base64.
BUDGET = 5_600_000

#: A browser holds so many values without trouble.
_MOST_VALUES = 10_000_000

#: Bytes of a deflated value before any is measured, in base64.
_BYTES_PER_VALUE = 4.0

#: Buckets are made so many times finer than estimated, and then merged until they fit.
_FINER = 4

#: A larger share no page can write in percent.
_MOST_DIFFERENT = 1e300

#: Of texts over time, so many changes are listed.
_MOST_CHANGES = 200


@dataclass(frozen=True)
class Curves:
    """Curves for the scripts of a page: `data` goes into `DATA`, `blocks` into elements of their own."""

    data: dict[str, Any]
    blocks: dict[str, bytes]


@dataclass(frozen=True)
class Variable:
    """What is drawn in one plot: a scalar or a vector of one run, or a scalar of several.

    Attributes
    ----------
    name, unit : str
    curves : sequence of (str, int, str)
        Label, number of the run, and name of the scalar.
    stepped : bool
        Whether values stay until the next one.
    """

    name: str
    unit: str
    curves: Sequence[tuple[str, int, str]]
    stepped: bool


def curves_of(runs: Mapping[str, Recorded], budget: int = BUDGET) -> Curves:
    """Curves of all numbers that runs have recorded; variables that never change come last.

    Parameters
    ----------
    runs : mapping
        Label -> results. Of several runs, each scalar is one variable.
    budget : int
        Bytes that the blocks may take in base64. Curves that take more are reduced to the extremes of equal numbers of
        rows; the data say of how many.
    """
    every = dict.fromkeys(range(len(runs)), 1)
    results = list(runs.values())
    variables = _variables(results)
    found = _whole(variables, results, budget)
    if found is None:
        found, every = _reduced(variables, results, budget)
    blocks: dict[str, bytes] = {}
    described = []
    for k, (variable, (columns, content)) in enumerate(zip(variables, found, strict=True)):
        blocks[f"curves-{k}"] = content
        described.append(_described(variable, f"curves-{k}", columns))
        described[-1]["still"] = all(_is_still(column.numbers) for column in columns)
        if len(results) > 1:
            described[-1]["difference"] = _difference(variable, results)
    described.sort(key=lambda one: bool(one["still"]))
    shown = []
    for k, (label, run) in enumerate(runs.items()):
        time, irregular = times(run.time, every[k])
        if irregular is not None:
            time["block"] = f"times-{k}"
            blocks[f"times-{k}"] = irregular
        resolution = every[k] * float(run.time[-1] - run.time[0]) / (len(run.time) - 1) if every[k] > 1 else None
        ends = [float(run.time[0]), float(run.time[-1])] if len(run.time) else [0.0, 1.0]
        shown.append({"label": label, "time": time, "ends": ends, "recorded": len(run.time), "resolution": resolution})
    return Curves({"runs": shown, "variables": described, "texts": _texts(runs)}, blocks)


def _variables(runs: Sequence[Recorded]) -> list[Variable]:
    kinds = [run.types for run in runs]
    texts = {name for kind in kinds for name, type_ in kind.items() if type_ in ("string", "binary")}
    names = [n for n in dict.fromkeys(name for run in runs for name in run.names) if n not in texts]
    if len(runs) > 1:
        holders = {name: [k for k, run in enumerate(runs) if name in run.names] for name in names}
        groups = {name: [(str(k), k, name) for k in holders[name]] for name in names}
    else:
        groups = {
            group: [(names[i].removeprefix(group) or group, 0, names[i]) for i in positions]
            for group, positions in grouped(names).items()
        }
    found = []
    for group, curves in groups.items():
        units = {runs[k].units.get(scalar, "") for _, k, scalar in curves}
        stepped = all(scalar in kinds[k] for _, k, scalar in curves)
        found.append(Variable(group, units.pop() if len(units) == 1 else "", curves, stepped))
    return found


def _described(variable: Variable, block_id: str, columns: Sequence[Column]) -> dict[str, Any]:
    shown = []
    for (label, run, name), column in zip(variable.curves, columns, strict=True):
        one: dict[str, Any] = {"label": label, "run": run, "name": name, "rows": len(column.numbers)}
        if column.offset:
            one["offset"] = column.offset
        if column.scale != 1.0:
            one["scale"] = column.scale
        shown.append(one)
    return {
        "name": variable.name,
        "unit": "" if variable.unit == "1" else variable.unit,
        "stepped": variable.stepped,
        "block": block_id,
        "columns": shown,
    }


def _is_still(numbers: np.ndarray) -> bool:
    """Whether a column has one value only, or none."""
    return bool(len(numbers) == 0 or (numbers == numbers[0]).all() or np.isnan(numbers).all())


def _difference(variable: Variable, runs: Sequence[Recorded]) -> float | None:
    """How far curves are at most from the first one, as a share of its range; None where there is no other."""
    (_, first, name), *others = variable.curves
    values, time = _values(runs, first, name), runs[first].time
    if not others or not len(time):
        return None
    finite = values[np.isfinite(values)]
    unit = float(np.abs(finite).max(initial=0.0)) or 1.0  # so that no difference is too large for a number
    span = float(finite.max() / unit - finite.min() / unit) if len(finite) else 0.0
    largest = 0.0
    for _, run, other in others:
        at = runs[run].time
        inside = (at >= time[0]) & (at <= time[-1])
        own = _values(runs, run, other)
        there = np.interp(at[inside], time, values)
        with np.errstate(over="ignore", invalid="ignore"):
            off = np.abs(own[inside] / unit - there / unit)
        largest = max(largest, float(off.max(initial=0.0, where=np.isfinite(own[inside]) & np.isfinite(there))))
        lacking, expected = (np.where(np.isfinite(v), 0.0, v) for v in (own, values))
        if np.array_equal(at, time) and not np.array_equal(lacking, expected, equal_nan=True):
            largest = max(largest, span or 1.0)  # a number against none
    with np.errstate(over="ignore"):
        share = np.float64(largest) / span if span > 0.0 else np.float64(unit) * largest
    return min(float(share), _MOST_DIFFERENT)


_Found = list[tuple[list[Column], bytes]]


def _values(runs: Sequence[Recorded], run: int, name: str) -> np.ndarray:
    return np.asarray(runs[run][name], dtype=np.float64)


def _whole(variables: Sequence[Variable], runs: Sequence[Recorded], budget: int) -> _Found | None:
    """All rows of all variables, unless they are too many."""
    if sum(len(runs[run].time) for v in variables for _, run, _ in v.curves) > _MOST_VALUES:
        return None
    found, size = [], 0
    for variable in variables:
        columns = [column_of(_values(runs, run, name)) for _, run, name in variable.curves]
        content = block([column.numbers for column in columns])
        size += _in_base64(content)
        if size > budget:
            return None
        found.append((columns, content))
    return found


def _reduced(variables: Sequence[Variable], runs: Sequence[Recorded], budget: int) -> tuple[_Found, dict[int, int]]:
    """Extremes of all variables, and of how many rows they are in each run."""
    n_curves = sum(len(variable.curves) for variable in variables)
    wanted = max(1, int(_FINER * budget / (2 * n_curves * _BYTES_PER_VALUE)))  # buckets of a curve
    finest = [max(1, len(run.time) // wanted) for run in runs]
    fine = [
        [column_of(extremes(_values(runs, run, name), finest[run])) for _, run, name in variable.curves]
        for variable in variables
    ]
    merged = _FINER // 2
    while True:
        columns = [[_merged(column, merged) for column in each] for each in fine]
        contents = [block([column.numbers for column in each]) for each in columns]
        size = sum(map(_in_base64, contents))
        if size <= budget or merged > max(len(c.numbers) for each in fine for c in each):
            return list(zip(columns, contents, strict=True)), {k: merged * n for k, n in enumerate(finest)}
        merged = max(merged + 1, int(np.ceil(0.95 * merged * size / budget)))


def _merged(column: Column, buckets: int) -> Column:
    """Extremes of so many neighbouring buckets."""
    return Column(extremes(column.numbers, 2 * buckets), column.offset, column.scale)


def _in_base64(content: bytes) -> int:
    return -(-len(content) // 3) * 4


def _texts(runs: Mapping[str, Recorded]) -> list[dict[str, Any]]:
    """Texts over time: when each became what."""
    found = []
    for label, run in runs.items():
        for name, kind in run.types.items():
            if kind in ("string", "binary"):
                changes = list(_changes(run.time, run[name]))
                kept = [[time, _as_text(value)] for time, value in changes[:_MOST_CHANGES]]
                found.append({"run": label, "name": name, "changes": kept, "more": len(changes) - len(kept)})
    return found


def _as_text(value: Any) -> str:
    """A text, or digits of base 16 for a binary value."""
    return value.hex(" ") if isinstance(value, bytes) else str(value)


def _changes(time: np.ndarray, values: np.ndarray) -> Iterable[tuple[float, Any]]:
    last: object = None
    for i, value in enumerate(values.tolist()):
        if i == 0 or value != last:
            yield float(time[i]), value
        last = value
