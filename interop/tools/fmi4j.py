"""FMI4j on the Java virtual machine: a loop in Java (`java/Fmi4jLoop.java`), in a process of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np

from interop.tools.case import Case, ToolRun, split

NAME = "fmi4j"
TITLE = "FMI4j, loop in Java"
PACKAGE = "info.laht.fmi4j:fmi-import:0.38.0"

_JAVA = Path(__file__).with_name("java")
_CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "closed-chain-cosim"


def unavailable() -> str | None:
    """It takes a JDK, and Maven, which fetches the packages once."""
    if shutil.which("javac") is None or shutil.which("mvn") is None:
        return "needs a JDK (17 or newer) and Maven: apt-get install default-jdk-headless maven"
    try:
        _class_path()
    except subprocess.CalledProcessError:
        return f"Maven can't get {PACKAGE}"
    return None


def run(case: Case, folder: Path) -> ToolRun:
    """Run the case twice in one virtual machine; the second run is measured, the first warms its compiler up."""
    fields: list[tuple[object, ...]] = [("steps", case.steps, case.step_size)]
    fields += [("fmu", instance, Path(fmu).resolve()) for instance, fmu in case.fmus.items()]
    fields += [("start", i, name, value) for i, values in case.start.items() for name, value in values.items()]
    fields += [("connect", *split(source), *split(target)) for source, target in case.connections]
    fields += [("record", *split(name)) for name in case.recorded] + [("path", *split(name)) for name in case.path]
    description, result = folder / "case.txt", folder / "result.bin"
    description.write_text("\n".join("\t".join(map(str, line)) for line in fields), encoding="utf-8")

    command = ["java", "-cp", _class_path(), str(_JAVA / "Fmi4jLoop.java"), str(description), str(result)]
    java = subprocess.run(command, check=False, capture_output=True, text=True)
    if java.returncode:
        reasons = [line for line in java.stderr.splitlines() if "Exception" in line or "error:" in line]
        raise RuntimeError(reasons[0] if reasons else f"java ended with exit code {java.returncode}")
    (loop_time, total), path = np.split(np.fromfile(result, dtype=">f8").astype(float), [2])
    x_E, y_E = path.reshape(-1, len(case.path)).T
    note = "second run in one virtual machine, after the compiler's first"
    return ToolRun(loop_time, total, case.times, x_E, y_E, "sequential", len(case.recorded), note)


@cache
def _class_path() -> str:
    """Class path of the Java program; Maven takes seconds to say it, so that a file keeps it."""
    kept = _CACHE / f"fmi4j-{PACKAGE.rpartition(':')[2]}-classpath"
    if kept.is_file() and all(Path(jar).is_file() for jar in kept.read_text(encoding="utf-8").split(os.pathsep)):
        return kept.read_text(encoding="utf-8")
    _CACHE.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        [
            *("mvn", "--quiet", "--batch-mode", "--file", str(_JAVA / "pom.xml")),
            *("dependency:build-classpath", f"-Dmdep.outputFile={kept}"),
        ],
        check=True,
        capture_output=True,
    )
    return kept.read_text(encoding="utf-8")
