"""FMI4j on the Java virtual machine: a loop in Java (`java/Fmi4jLoop.java`), in a process of its own."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np

from interop.tools import maven
from interop.tools.case import Case, ToolRun, split

NAME = "fmi4j"
TITLE = "FMI4j, loop in Java"
PACKAGE = "info.laht.fmi4j:fmi-import:0.38.0"

_PROGRAM = Path(__file__).with_name("java") / "Fmi4jLoop.java"


def unavailable() -> str | None:
    """It takes a JDK and Maven."""
    return maven.unavailable("fmi4j")


def run(case: Case, folder: Path) -> ToolRun:
    """Run the case twice in one virtual machine; the second run is measured, the first warms its compiler up."""
    fields: list[tuple[object, ...]] = [("steps", case.steps, case.step_size)]
    fields += [("fmu", instance, Path(fmu).resolve()) for instance, fmu in case.fmus.items()]
    fields += [("start", i, name, value) for i, values in case.start.items() for name, value in values.items()]
    fields += [("connect", *split(source), *split(target)) for source, target in case.connections]
    fields += [("record", *split(name)) for name in case.recorded] + [("path", *split(name)) for name in case.path]
    description, result = folder / "case.txt", folder / "result.bin"
    description.write_text("\n".join("\t".join(map(str, line)) for line in fields), encoding="utf-8")

    command = ["java", "-cp", os.pathsep.join(maven.class_path("fmi4j")), str(_PROGRAM), str(description), str(result)]
    java = subprocess.run(command, check=False, capture_output=True, text=True)
    if java.returncode:
        reasons = [line for line in java.stderr.splitlines() if "Exception" in line or "error:" in line]
        raise RuntimeError(reasons[0] if reasons else f"java ended with exit code {java.returncode}")
    (loop_time, total), path = np.split(np.fromfile(result, dtype=">f8").astype(float), [2])
    x_E, y_E = path.reshape(-1, len(case.path)).T
    note = "second run in one virtual machine, after the compiler's first"
    return ToolRun(loop_time, total, case.times, x_E, y_E, "sequential", len(case.recorded), note)
