"""FMPy's command line: `fmpy simulate`, co-simulation of one FMU."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

from interop.tools.case import Case, ToolRun, split
from interop.tools.results_file import read_columns

NAME = "fmpy_cli"
TITLE = "FMPy, command line, co-simulation"
PACKAGE = "fmpy"


def unavailable() -> str | None:
    """FMPy is a dependency of the project."""
    return None


def run(case: Case, folder: Path, *options: str) -> ToolRun:
    """Simulate the one FMU of the case."""
    began = time.perf_counter()
    ((instance, fmu),) = case.fmus.items()
    file = folder / "results.csv"
    command = [sys.executable, "-m", "fmpy", "simulate", str(fmu), *(options or ("--interface-type", "CoSimulation"))]
    command += ["--stop-time", repr(case.stop_time), "--output-interval", repr(case.step_size)]
    command += ["--output-file", str(file), "--output-variables", *case.recorded_of(instance), "--start-values"]
    command += [word for name, value in case.start[instance].items() for word in (name, repr(value))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1])
    columns = read_columns(file)
    x_E, y_E = (columns[split(name)[1]] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(total, total, columns["time"], x_E, y_E, "one FMU", len(columns) - 1, "time of the whole process")
