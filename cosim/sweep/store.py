"""The store of a sweep's results: a folder of Parquet files that can be added to, and read at any time.

    sweep.json              what was asked for, and its fingerprint
    plan.parquet            all points
    results/part-*.parquet  rows of finished runs: index, factors, metrics, curves, error

A part appears whole or not at all. It holds the batches of some seconds, not one: millions of runs would otherwise make
hundreds of thousands of files.
"""

from __future__ import annotations

import hashlib
import json
import time as clock
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from cosim.errors import nearest
from cosim.files.whole import write_whole
from cosim.results.output import SUMMARY, check_writable
from cosim.sweep.batch import Rows
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Factor, Points, Range

#: A part is written when this share of the time since the start has gone by since the last, within bounds (s): few
#: files for long sweeps, and little to lose for short ones.
_SHARE, _LEAST_TIME, _MOST_TIME = 0.02, 2.0, 60.0

#: Rows in a part at most.
_MOST_ROWS = 100_000


@dataclass(frozen=True)
class SweepSummary:
    """Progress of a sweep.

    Attributes
    ----------
    points, done, failed : int
    first_error : str
        Text of the failed run with the lowest index, empty if none failed.
    interrupted : bool
        Ctrl-C has ended it; the same command goes on.
    runs : int
        Rows that this start has added.
    seconds : float
        What they took (s), without starting the workers.
    workers : int
        Processes that ran them, at most.
    """

    points: int
    done: int
    failed: int
    first_error: str
    interrupted: bool = False
    runs: int = 0
    seconds: float = 0.0
    workers: int = 0


class Store:
    """The folder of one sweep, opened for adding rows.

    Parameters
    ----------
    folder : Path
        New, or that of the same sweep.
    points : Points
    metrics : sequence of str
        Columns of the rows that hold numbers.
    question : mapping
        All that decides a row besides the points, as JSON can write it.
    curves : sequence of str
        Columns of the rows that hold arrays.
    now : callable
        The clock (s).

    Raises
    ------
    SweepError
        The folder holds another sweep, or two columns have the same name.
    OutputError
        It can't be written.
    """

    def __init__(
        self,
        folder: Path,
        points: Points,
        metrics: Sequence[str],
        question: Mapping[str, Any],
        *,
        curves: Sequence[str] = (),
        now: Callable[[], float] = clock.monotonic,
    ) -> None:
        columns = Counter(["index", *points.names, *metrics, *curves, "error"])
        for name, times in columns.items():
            if times > 1:
                raise SweepError(f"two columns are named '{name}'; give the metric another name")
        self.folder = folder
        self._points = points
        self._types = dict.fromkeys(metrics, pa.float64()) | dict.fromkeys(curves, pa.list_(pa.float32()))
        self._now = now
        self._began = now()
        self._written = self._began - _LEAST_TIME  # the first batch is there to be seen at once
        self._rows: list[Rows] = []
        self._waiting = 0
        parts = folder / "results"
        check_writable(folder)
        question = {**question, "factors": points.names, "points": len(points), "points_sha256": points.sha256()}
        self._keep_plan(question, bool(_parts(folder)))
        check_writable(parts)

    def _keep_plan(self, question: dict[str, Any], has_parts: bool) -> None:
        path = self.folder / "sweep.json"
        if not path.is_file():
            if has_parts:
                raise SweepError(f"{self.folder} holds results without their sweep.json; choose another --out")
            if (self.folder / SUMMARY).exists():
                raise SweepError(f"{self.folder} holds the results of a run; choose another --out")
            _write_table(self._plan(), self.folder / "plan.parquet")
            text = json.dumps({"fingerprint": _fingerprint(question), **question}, indent=2) + "\n"
            write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))
            return
        known = _read_json(path)
        if known.get("fingerprint") != _fingerprint(question):
            differs = [key for key in question if known.get(key) != json.loads(json.dumps(question[key]))]
            raise SweepError(
                f"{self.folder} holds another sweep (other {', '.join(differs) or 'fingerprint'}); "
                "choose another --out, or delete the folder"
            )

    def _plan(self) -> pa.Table:
        everything = np.arange(len(self._points))
        return pa.table({"index": pa.array(everything), **_factor_columns(self._points, everything)})

    def missing(self) -> np.ndarray:
        """Numbers of the points that have no row yet, ascending."""
        left = np.ones(len(self._points), dtype=bool)
        left[_scan(self.folder, ["index"])["index"].to_numpy()] = False
        return np.flatnonzero(left)

    def kept(self) -> Rows:
        """The rows on the disk, without curves, in any order."""
        metrics = [name for name, kind in self._types.items() if kind == pa.float64()]
        if not _parts(self.folder):
            return Rows()
        table = _scan(self.folder, ["index", *metrics, "error"])
        numbers = {name: table[name].to_pylist() for name in metrics}
        return Rows(table["index"].to_pylist(), numbers, table["error"].to_pylist())

    def add(self, rows: Rows) -> None:
        """Take the rows of a finished batch; they are on disk at the latest after the next `flush`.

        Raises
        ------
        SweepError
            The folder can't be written.
        """
        self._rows.append(rows)
        self._waiting += len(rows.indices)
        pause = min(max(_SHARE * (self._now() - self._began), _LEAST_TIME), _MOST_TIME)
        if self._waiting >= _MOST_ROWS or self._now() - self._written >= pause:
            self.flush()

    def flush(self) -> None:
        """Write all rows that wait.

        Raises
        ------
        SweepError
            The folder can't be written.
        """
        if self._rows:
            name = f"part-{self._rows[0].indices[0]:09d}-{uuid4().hex[:12]}.parquet"
            try:
                _write_table(self._table(), self.folder / "results" / name)
            except OSError as error:
                raise SweepError(
                    f"can't write into {self.folder}: {error.strerror or error}; free some space and start again: "
                    "it goes on where it stopped"
                ) from error
        self._rows, self._waiting, self._written = [], 0, self._now()

    def _table(self) -> pa.Table:
        indices = np.array([i for rows in self._rows for i in rows.indices], dtype=np.int64)
        entries = {
            name: pa.array([v for rows in self._rows for v in rows.metrics[name]], kind)
            for name, kind in self._types.items()
        }
        errors = pa.array([e for rows in self._rows for e in rows.errors], pa.string())
        return pa.table(
            {"index": pa.array(indices), **_factor_columns(self._points, indices), **entries, "error": errors}
        )

    def summary(self) -> SweepSummary:
        """Progress of the sweep, by the rows on the disk."""
        done = len(self._points) - len(self.missing())
        errors = _without_repeats(_scan(self.folder, ["index", "error"], pc.field("error").is_valid()))
        first = f"point {errors['index'][0]}: {errors['error'][0]}" if len(errors) else ""
        return SweepSummary(len(self._points), done, len(errors), first)


def read(folder: str | PathLike[str], columns: Sequence[str] | None = None) -> pa.Table:
    """All rows of a sweep so far, in the order of the plan: index, factors, metrics, curves, error.

    Parameters
    ----------
    folder : path
    columns : sequence of str, optional
        Only these, after the index: ten million rows with all columns need gigabytes.

    Raises
    ------
    SweepError
        There is no sweep in this folder, it has no such column, or a file is damaged.
    """
    where = Path(folder)
    sweep_question(where)
    return _without_repeats(_scan(where, None if columns is None else ["index", *columns]))


def sweep_question(folder: Path) -> dict[str, Any]:
    """What a sweep was asked for: its factors, the number of points, and all that decides a row.

    Raises
    ------
    SweepError
        There is no sweep in this folder, or the file about it is damaged.
    """
    path = folder / "sweep.json"
    if not path.is_file():
        raise SweepError(f"{folder} holds no sweep: it has no sweep.json")
    return _read_json(path)


def _scan(folder: Path, columns: Sequence[str] | None = None, condition: pc.Expression | None = None) -> pa.Table:
    """Columns of all parts, in any order."""
    parts = _parts(folder)
    if not parts:
        plan = pq.read_table(folder / "plan.parquet").slice(0, 0)
        table = plan.append_column("error", pa.array([], pa.string()))
        return table if columns is None else table.select(columns)
    try:
        rows = ds.dataset([str(p) for p in parts], format="parquet")
        for name in columns or ():
            if name not in rows.schema.names:
                raise SweepError(f"{folder}: rows have no column '{name}'; {nearest(name, rows.schema.names)}")
        return rows.to_table(columns=columns, filter=condition)
    except (pa.ArrowException, OSError) as error:
        line = " ".join(str(error).split())
        raise SweepError(f"{folder}: a file is damaged: {line}; delete it, and start the sweep again") from error


def _without_repeats(table: pa.Table) -> pa.Table:
    """Sorted by index; a point that two sweeps at once have run comes once."""
    table = table.unify_dictionaries().sort_by("index")
    index = table["index"].to_numpy()
    first = np.ones(len(index), dtype=bool)
    first[1:] = index[1:] != index[:-1]
    return table if first.all() else table.filter(pa.array(first))


def _parts(folder: Path) -> list[Path]:
    return sorted((folder / "results").glob("part-*.parquet"))


def _factor_columns(points: Points, indices: np.ndarray) -> dict[str, pa.Array]:
    return {f.name: _column(f, c[indices]) for f, c in zip(points.factors, points.columns, strict=True)}


def _column(factor: Factor, values: np.ndarray) -> pa.Array:
    if isinstance(factor, Range):
        return pa.array(values)
    levels = pa.array(factor.values)
    if pa.types.is_string(levels.type):
        return pa.DictionaryArray.from_arrays(pa.array(values), levels)
    return levels.take(pa.array(values))


def _fingerprint(question: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(question, sort_keys=True).encode()).hexdigest()


def _read_json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SweepError(f"{path}: can't be read: {error}; choose another --out, or delete the folder") from error
    return data if isinstance(data, dict) else {}


def _write_table(table: pa.Table, path: Path) -> None:
    # a dictionary of floats, which hardly repeat, would cost half the time and a fifth of the space
    repeating = [field.name for field in table.schema if not _is_floating(field.type)]
    write_whole(path, lambda part: pq.write_table(table, part, compression="zstd", use_dictionary=repeating))


def _is_floating(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind.value_type if pa.types.is_list(kind) else kind))
