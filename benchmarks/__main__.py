"""All measurements in one go: `python -m benchmarks [--out DIR] [--only NAME]`; takes about fifteen minutes.

Writes benchmarks.txt and benchmarks.json, of single parts only where --out says. Other masters are the project's extra
`peers`; one that is not installed is named with the reason.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from tqdm import tqdm

from benchmarks.coupling import measure_coupling, measure_iterated, measure_other_systems
from benchmarks.equations import measure_equations
from benchmarks.exporters import measure_exporters
from benchmarks.isolation import measure_isolation
from benchmarks.loop import measure_loop, measure_pythonfmu, measure_stepping
from benchmarks.masters import measure_masters
from benchmarks.measure import Section
from benchmarks.packed import measure_packed
from benchmarks.pages import measure_pages
from benchmarks.placement import measure_placement
from benchmarks.plant_step import measure_plant_step
from benchmarks.scaling import measure_chain, measure_many, measure_program
from benchmarks.solvers import measure_solvers
from benchmarks.sweeps import measure_sweeps
from benchmarks.threads import measure_threads
from cosim.versions import versions
from parallel_robot.fmus import FLAVOURS, build

RESULTS = Path("benchmarks/results")

PARTS: dict[str, Callable[[Path], Section | list[Section]]] = {
    "plant-step": measure_plant_step,
    "loop": measure_loop,
    "equations": measure_equations,
    "stepping": measure_stepping,
    "pythonfmu": measure_pythonfmu,
    "coupling": measure_coupling,
    "couplings_of_others": measure_other_systems,
    "iterated": lambda _: measure_iterated(),
    "chain": lambda _: measure_chain(),
    "many": measure_many,
    "program": measure_program,
    "sweeps": measure_sweeps,
    "threads": measure_threads,
    "isolation": measure_isolation,
    "placement": measure_placement,
    "masters": measure_masters,
    "solvers": lambda _: measure_solvers(),
    "packed": measure_packed,
    "exporters": lambda _: measure_exporters(),
    "pages": measure_pages,
}


def main() -> int:
    """Measure and write; returns 0 when all that must hold does."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--out", type=Path, metavar="DIR", help=f"default {RESULTS}, if all parts are run")
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), metavar="DIR", help="built when missing or outdated")
    parser.add_argument("--only", choices=PARTS, action="append", help="part to run (default all)")
    options = parser.parse_args()
    for flavour in FLAVOURS:
        build(options.fmus, flavour)
    sections: list[Section] = []
    for name in tqdm(options.only or PARTS, desc="measuring", disable=None):
        found = PARTS[name](options.fmus)
        sections += found if isinstance(found, list) else [found]
        print(text_of(sections[-1]) if not isinstance(found, list) else "\n".join(map(text_of, found)), flush=True)
    out = options.out or (None if options.only else RESULTS)
    if out is not None:
        write(sections, out)
    return int(not all(holds for s in sections for _, holds in s.verdicts))


def write(sections: list[Section], out: Path) -> None:
    """Write the report as text and as JSON."""
    machine = {
        **versions(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "date": datetime.now(UTC).isoformat("T", "minutes"),
    }
    out.mkdir(parents=True, exist_ok=True)
    head = "\n".join(f"{key}: {value}" for key, value in machine.items())
    (out / "benchmarks.txt").write_text(head + "\n\n" + "\n".join(map(text_of, sections)), encoding="utf-8")
    data = {"machine": machine, "sections": {s.title: {"data": s.data, "verdicts": s.verdicts} for s in sections}}
    (out / "benchmarks.json").write_text(json.dumps(data, indent=1, default=str) + "\n", encoding="utf-8")
    print(f"written: {out / 'benchmarks.txt'}, {out / 'benchmarks.json'}")


def text_of(section: Section) -> str:
    """A section as Markdown, readable as text."""
    widths = [max(len(row[i]) for row in (section.header, *section.rows)) for i in range(len(section.header))]
    lines = [
        "| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |"
        for row in (section.header, tuple("-" * w for w in widths), *section.rows)
    ]
    verdicts = [f"- {'holds' if holds else 'DOES NOT HOLD'}: {text}" for text, holds in section.verdicts]
    return "\n".join([f"## {section.title}", "", section.method, "", *lines, "", *verdicts, ""])


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.partition(": ")[2] for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


if __name__ == "__main__":
    sys.exit(main())
