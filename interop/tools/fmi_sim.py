"""fmi-sim, in Rust: a command line that simulates one FMU.

Trap: it has no options for start values, so that they are written into a copy of the FMU; inputs come as a CSV file.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

import fmpy

from fmu_export.start_values import write_start_values
from interop.tools.case import Case, ToolRun, split
from interop.tools.results_file import read_columns

NAME = "fmi_sim"
TITLE = "fmi-sim, command line, co-simulation"
PACKAGE = "fmi-sim 0.7.0 (cargo)"


def unavailable() -> str | None:
    """A Rust crate, compiled in some minutes."""
    return None if shutil.which("fmi-sim") else "not on the path: cargo install fmi-sim"


def run(case: Case, folder: Path) -> ToolRun:
    """Simulate the one FMU of the case."""
    began = time.perf_counter()
    ((instance, original),) = case.fmus.items()
    fmu = folder / original.name
    shutil.copyfile(original, fmu)
    inputs = [v.name for v in fmpy.read_model_description(fmu).modelVariables if v.causality == "input"]
    start = case.start[instance]
    write_start_values(fmu, {name: value for name, value in start.items() if name not in inputs})
    signals, file = folder / "inputs.csv", folder / "results.csv"
    rows = [["time", *inputs], *([t, *(start.get(name, 0.0) for name in inputs)] for t in (0.0, case.stop_time))]
    signals.write_text("".join(",".join(map(str, row)) + "\n" for row in rows), encoding="utf-8")
    command = ["fmi-sim", "--model", str(fmu), "--input-file", str(signals), "--output-file", str(file)]
    command += ["co-simulation", "--stop-time", repr(case.stop_time), "--output-interval", repr(case.step_size)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1])
    columns = read_columns(file)
    x_E, y_E = (columns[split(name)[1]] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(total, total, columns["time"], x_E, y_E, "one FMU", len(columns) - 1, "time of the whole process")
