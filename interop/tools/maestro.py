"""Maestro (INTO-CPS), its fixed-step algorithm: a system in JSON, run by its command line on the Java virtual machine.

Traps: it sets parameters only, and passes start values of inputs over without a word, so that they come from an FMU of
constants here; where an FMU can interpolate inputs and the source has no derivatives, it sets none of them by a call
that its own library refuses ("Orders must not be null or empty"), so that it gets copies of the FMUs which can't.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
import zipfile
from collections.abc import Iterable
from pathlib import Path

import fmpy

from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.native.backend import build_native
from fmu_export.package.archive import write_archive
from interop.tools import maven
from interop.tools.case import Case, ToolRun, split
from interop.tools.results_file import read_columns

NAME = "maestro"
TITLE = "Maestro, fixed step"
PACKAGE = "org.into-cps.maestro:maestro:3.1.1"


def unavailable() -> str | None:
    """It takes a JDK and Maven."""
    return maven.unavailable("maestro")


def run(case: Case, folder: Path) -> ToolRun:
    """Import the system and interpret it; its CSV file holds all outputs."""
    began = time.perf_counter()
    fmus, start, constants = _for_maestro(case, folder)
    connections: dict[str, list[str]] = {}
    for source, target in [*case.connections, *constants]:
        connections.setdefault(_port(source), []).append(_port(target))
    system = {
        "fmus": {f"{{{name}}}": str(fmu) for name, fmu in fmus.items()},
        "connections": connections,
        "parameters": {_port(path): value for path, value in start.items()},
        "logVariables": {f"{{{name}}}.{name}": case.recorded_of(name) for name in case.fmus},
        "startTime": 0.0,
        "endTime": case.stop_time,
        "algorithm": {"type": "fixed-step", "size": case.step_size},
    }
    file = folder / "system.json"
    file.write_text(json.dumps(system), encoding="utf-8")
    command = ["java", "-cp", os.pathsep.join(maven.class_path("maestro")), "org.intocps.maestro.Main"]
    done = subprocess.run(
        [*command, "import", "--interpret", f"-output={folder / 'out'}", "sg1", str(file)],
        capture_output=True,
        text=True,
        check=False,
    )
    if reasons := [line for line in done.stderr.splitlines() if "Exception" in line]:
        raise RuntimeError(reasons[-1])
    columns = read_columns(folder / "out" / "outputs.csv")
    x_E, y_E = (columns[_port(name)] for name in case.path)
    total = time.perf_counter() - began
    note = "time of the whole process, the Java machine and the expansion of the system included"
    return ToolRun(total, total, columns["time"], x_E, y_E, "parallel (Jacobi)", len(columns) - 1, note)


def _port(path: str) -> str:
    instance, variable = split(path)
    return f"{{{instance}}}.{instance}.{variable}"


def _for_maestro(case: Case, folder: Path) -> tuple[dict[str, Path], dict[str, float], list[tuple[str, str]]]:
    """FMUs as Maestro takes them, start values of parameters, and connections that set the inputs."""
    fmus, start = {}, {}
    inputs: dict[str, tuple[float, str]] = {}
    for name, fmu in case.fmus.items():
        fmus[name] = folder / "fmus" / name / fmu.name
        with zipfile.ZipFile(fmu) as archive:
            members = {member: archive.read(member) for member in archive.namelist()}
        description = members["modelDescription.xml"]
        members["modelDescription.xml"] = description.replace(b'canInterpolateInputs="true"', b"")
        write_archive(fmus[name], members)
        variables = {v.name: v for v in fmpy.read_model_description(fmu).modelVariables}
        for variable, value in case.start.get(name, {}).items():
            if variables[variable].causality == "input":
                inputs[f"{name}.{variable}"] = value, variables[variable].unit
            else:
                start[f"{name}.{variable}"] = value
    if not inputs:
        return fmus, start, []
    fmus["constants"] = build_native(_constants(inputs.values()), folder / "fmus", "fmi2")
    return fmus, start, [(f"constants.y_{i}", target) for i, target in enumerate(inputs)]


def _constants(values: Iterable[tuple[float, str]]) -> Model:
    """Outputs y_0, y_1, ... with the given values and units, which Maestro compares with those of the inputs."""
    return Model(
        name="Constants",
        description="Outputs that do not change",
        parameters=Layout([Variable(f"K_{i}", unit, "Value", start=value) for i, (value, unit) in enumerate(values)]),
        inputs=Layout([]),
        outputs=Layout([Variable(f"y_{i}", unit, "Value") for i, (_, unit) in enumerate(values)]),
        states=(),
        initial_state=lambda p: p[:0],
        derivatives=lambda t, x, u, p: x,
        output_values=lambda t, x, u, p: p,
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=1e-3),
    )
