"""A host in C (`c/host.c`): the functions of FMI and nothing else, in a process without Python."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import fmpy
import numpy as np

from fmu_export.native.toolchain import ToolchainError, find_compiler, host_target
from interop.tools.case import Case, ToolRun, split

NAME = "c_host"
TITLE = "C host of ours, no Python in the process"
PACKAGE = "interop/tools/c/host.c"

_SOURCE = Path(__file__).with_name("c") / "host.c"


def unavailable() -> str | None:
    """It takes a C compiler, and the loader of POSIX."""
    if os.name != "posix":
        return "loads FMUs by dlopen, which this system has not"
    try:
        find_compiler()
    except ToolchainError as error:
        return str(error)
    return None


def run(case: Case, folder: Path) -> ToolRun:
    """Compile the host for the FMI version of the case, and run it."""
    descriptions = {i: fmpy.read_model_description(fmu) for i, fmu in case.fmus.items()}
    (version,) = {d.fmiMajorVersion for d in descriptions.values()}
    description, result = folder / "case.txt", folder / "result.bin"
    description.write_text(_description(case, descriptions, version, folder), encoding="utf-8")
    host = _compile(version, folder)
    environment = {"PATH": "/nonexistent"}  # nothing of the Python around it
    done = subprocess.run(
        [host, description, result], capture_output=True, text=True, check=False, env=environment, cwd=folder
    )
    if done.returncode:
        raise RuntimeError(done.stderr.strip() or f"the host ended with exit code {done.returncode}")
    (loop_time, total), values = np.split(np.fromfile(result), [2])
    table = values.reshape(case.steps + 1, len(case.recorded))
    x_E, y_E = (table[:, case.recorded.index(name)] for name in case.path)
    return ToolRun(loop_time, total, case.times, x_E, y_E, "sequential", len(case.recorded))


def _compile(version: int, folder: Path) -> Path:
    host = folder / "host"
    headers = Path(fmpy.__file__).parent / "c-code"
    command = [*find_compiler(), "-std=c99", "-O2", f"-DFMI={version}", f"-I{headers}", str(_SOURCE), "-o", str(host)]
    subprocess.run([*command, "-ldl"], check=True, capture_output=True)
    return host


def _description(
    case: Case, descriptions: dict[str, fmpy.model_description.ModelDescription], version: int, folder: Path
) -> str:
    """The case in the host's own format."""
    lines: list[tuple[object, ...]] = []
    for name, fmu in case.fmus.items():
        unpacked = folder / name
        fmpy.extract(fmu, unpacked)
        d = descriptions[name]
        platform = host_target().fmi2_folder if version == 2 else host_target().fmi3_folder
        library = unpacked / "binaries" / str(platform) / f"{d.coSimulation.modelIdentifier}{host_target().suffix}"
        resources = unpacked / "resources"
        lines.append(("fmu", name, library, d.guid, resources.as_uri() if version == 2 else resources))
    references = case.references()
    number = {name: i for i, name in enumerate(case.fmus)}

    def end(path: str) -> tuple[int, int]:
        instance, variable = split(path)
        return number[instance], references[instance][variable]

    lines += [
        ("start", *end(f"{i}.{n}"), repr(value)) for i, values in case.start.items() for n, value in values.items()
    ]
    lines += [("connect", *end(source), *end(target)) for source, target in case.connections]
    lines += [("record", *end(name)) for name in case.recorded]
    lines.append(("run", case.steps, repr(case.step_size)))
    return "".join("\t".join(map(str, line)) + "\n" for line in lines)
