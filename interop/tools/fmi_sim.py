"""fmi-sim, in Rust: a command line that simulates one FMU."""

from __future__ import annotations

import shutil
import subprocess
import time
from pathlib import Path

from interop.tools.case import Case, ToolRun, split
from interop.tools.results_file import read_columns

NAME = "fmi_sim"
TITLE = "fmi-sim, command line, co-simulation"
PACKAGE = "fmi-sim 0.7.0 (cargo)"


def unavailable() -> str | None:
    """A Rust crate, compiled in some minutes."""
    return None if shutil.which("fmi-sim") else "not on the path: cargo install fmi-sim (needs libclang)"


def run(case: Case, folder: Path) -> ToolRun:
    """Simulate the one FMU of the case."""
    began = time.perf_counter()
    ((instance, fmu),) = case.fmus.items()
    file = folder / "results.csv"
    command = ["fmi-sim", "--model", str(fmu), "--output-file", str(file), "co-simulation", "-f", repr(case.stop_time)]
    command += ["--output-interval", repr(case.step_size)]
    for name, value in case.start[instance].items():
        command += ["--init-values", f"{name}={value!r}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if line.startswith("Error")]
        raise RuntimeError(errors[0] if errors else f"exit code {done.returncode}")
    columns = read_columns(file)
    x_E, y_E = (columns[split(name)[1]] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(total, total, columns["time"], x_E, y_E, "one FMU", len(columns) - 1, "time of the whole process")
