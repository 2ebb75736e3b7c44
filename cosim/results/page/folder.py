"""A run as its folder has it: what it recorded, its summary, and the log of its FMUs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.errors import ResultsError
from cosim.files.whole import is_part, part_of
from cosim.results.output import SUMMARY
from cosim.results.recorded import Recorded
from cosim.results.results import Results
from cosim.results.stored import StoredResults

#: Endings of tables, those first that are read fastest.
_ENDINGS = (".parquet", ".npz", ".csv", ".mat", ".json")

#: Name of the log, unless the summary has another.
_LOG = "messages.log"


@dataclass(frozen=True)
class FoundRun:
    """A run that was found on the disk.

    Attributes
    ----------
    label : str
        Name of its folder or file.
    results : Recorded
    log : str
        What the FMUs said; empty if nobody asked for it.
    """

    label: str
    results: Recorded
    log: str = ""


def is_sweep(path: Path) -> bool:
    """Whether a folder holds a sweep."""
    return (path / "sweep.json").is_file()


def read_run(path: Path) -> FoundRun:
    """Read the run in a folder, or a table that another tool wrote.

    Raises
    ------
    ResultsError
        There is none; the message says what was looked for.
    """
    if not path.is_dir():
        if not path.exists():
            raise ResultsError(f"{path}: there is no such folder or file; give the folder of a run, or a table")
        return FoundRun(path.stem, _table(path, {}))
    whole = [path / f"results{ending}" for ending in _ENDINGS]
    for table in (*whole, *map(part_of, whole)):  # what a killed run has left is better than nothing
        if table.is_file():
            summary = path / SUMMARY
            info = _summary(part_of(summary) if is_part(table) else summary)
            log = path / _LOG
            text = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
            return FoundRun(path.resolve().name, _table(table, info), text)
    if is_sweep(path):
        raise ResultsError(f"{path} holds a sweep; name it alone, or the folders of single runs")
    raise ResultsError(
        f"{path} holds no results.parquet, .npz, .csv, .mat or .json; name the folder that `cosim run` has written"
    )


def _summary(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ResultsError(f"{path}: can't be read as JSON: {error}") from error
    return data if isinstance(data, dict) else {}


def _table(path: Path, info: dict[str, Any]) -> Recorded:
    if path.suffix.lower() == ".parquet" and info:
        return StoredResults(path, info)
    results = Results.read(path)
    results.info = {**results.info, **info}
    return results
