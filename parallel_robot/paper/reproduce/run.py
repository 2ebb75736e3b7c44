"""The whole reproduction: runs, figures, claims, errata, and the files that hold them."""

from __future__ import annotations

import csv
import dataclasses
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cosim.files.whole import write_json
from cosim.versions import versions
from parallel_robot.metrics import metrics
from parallel_robot.paper.reproduce.claims import judge, rows
from parallel_robot.paper.reproduce.content import Reproduction, Runs
from parallel_robot.paper.reproduce.errata import ERRATA, show
from parallel_robot.paper.reproduce.figures import NUMBERS, write_figures
from parallel_robot.paper.reproduce.material import Material
from parallel_robot.paper.reproduce.runs import Plan

Progress = Callable[[str], None]

#: Files of the reproduction, besides its figures, its page and its summary.
TABLES = ("table1.csv", "claims.json", "errata.json")


def number_of_steps() -> int:
    """How often `run_all` and `reproduce` together report progress."""
    return Plan().number_of_runs + len(NUMBERS) + len(rows()) + len(ERRATA)


def reproduce(runs: Runs, folder: Path, progress: Progress = lambda what: None) -> Reproduction:
    """Judge the claims, show the errata, draw the figures into `<folder>/figures`, and write the tables beside it.

    Raises
    ------
    OSError
        A file can't be written.
    """
    material = Material(runs)
    claims, errata = [], []
    for row in rows():
        claims.append(judge(row, material))
        progress(row.id)
    for find in ERRATA:
        errata.append(show(find, material))
        progress(errata[-1].id)
    content = Reproduction(
        runs=runs,
        table1=material.table1,
        figures=write_figures(runs, folder / "figures", progress),
        claims=tuple(claims),
        errata=tuple(errata),
        theorem1=material.theorem1,
        versions=versions(),
    )
    write_tables(content, folder)
    return content


def write_tables(content: Reproduction, folder: Path) -> None:
    """Write `table1.csv`, `claims.json`, `errata.json` and `summary.json`: the same bytes each time, on one machine.

    Raises
    ------
    OSError
        A file can't be written.
    """
    with (folder / "table1.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([f.name for f in dataclasses.fields(content.table1[0])])
        writer.writerows(dataclasses.astuple(row) for row in content.table1)
    write_json(folder / "claims.json", {"claims": [dataclasses.asdict(claim) for claim in content.claims]})
    write_json(
        folder / "errata.json",
        {
            "errata": [dataclasses.asdict(erratum) for erratum in content.errata],
            "theorem1": [dataclasses.asdict(check) for check in content.theorem1],
        },
    )
    write_json(folder / "summary.json", summary(content))


def summary(content: Reproduction) -> dict[str, Any]:
    """What was run and what came of it, in numbers."""
    runs = content.runs
    return {
        "runs": dict(runs.info),
        "controllers": [dataclasses.asdict(controller) for controller in runs.controllers],
        "verdicts": dict(sorted(Counter(claim.verdict for claim in content.claims).items())),
        "table1_agrees": all(row.agrees for row in content.table1),
        "errata_shown": sum(erratum.shown for erratum in content.errata),
        "errata": len(content.errata),
        "metrics": {
            f"{key}, {condition}": metrics(results, runs.steady_after)
            for (key, condition), results in runs.closed_loop.items()
        },
        "readings": [dataclasses.asdict(reading) for reading in runs.readings],
        "figures": [
            {"number": f.number, "title": f.title, "caption": f.caption, "alt": f.alt, "svg": f"figures/{f.svg.name}"}
            for f in content.figures
        ],
        "versions": dict(content.versions),
    }
