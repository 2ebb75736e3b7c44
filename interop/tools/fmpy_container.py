"""FMPy's container: an FMU that holds the others and couples them in compiled code.

Traps: it takes "Float64" where FMPy writes "Real" for connections of FMI 2.0; value reference 0 is the time; it copies
connections in the order of their list, so that their order decides on delays.
"""

from __future__ import annotations

import time
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING

import fmpy
from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable

from interop.tools.availability import missing
from interop.tools.case import Case, ToolRun, split
from interop.tools.container_loop import NOTE, run_container

if TYPE_CHECKING:
    from fmpy.container_fmu.config import Component, Connection

NAME = "fmpy_container"
TITLE = "FMPy, container FMU"
PACKAGE = "fmpy"


def unavailable() -> str | None:
    """Earlier versions of FMPy have no container, or another one."""
    return missing("fmpy.container_fmu.cli", "pip install 'fmpy>=0.3.32'")


def run(case: Case, folder: Path) -> ToolRun:
    """Build the container, then step it and get all from it at each communication point."""
    began = time.perf_counter()
    file = folder / "container.fmu"
    _build(case, folder / "build", file)
    table, loop_time = run_container(file, folder / "container", case, case.recorded)
    x_E, y_E = (table[:, case.recorded.index(name)] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(loop_time, total, case.times, x_E, y_E, "sequential", len(case.recorded), NOTE)


def _build(case: Case, folder: Path, file: Path) -> None:
    from fmpy.container_fmu.cli import create_container_fmu
    from fmpy.container_fmu.config import Component, Configuration

    components = {i: Component(i, fmu, fmpy.read_model_description(fmu)) for i, fmu in case.fmus.items()}
    inner = {f"{i}.{v.name}": v for i, c in components.items() for v in c.modelDescription.modelVariables}
    start = {f"{i}.{name}": value for i, values in case.start.items() for name, value in values.items()}
    outer = {
        ModelVariable(
            name,
            type="Real",
            variability="continuous",
            causality="input" if name in start else "output",
            start=repr(start[name]) if name in start else None,
        ): [(components[split(name)[0]], inner[name])]
        for name in dict.fromkeys([*case.recorded, *start])
    }
    description = ModelDescription(
        fmiVersion="2.0",
        modelName="Container",
        instantiationToken="{container}",
        coSimulation=CoSimulation(fixedInternalStepSize=case.step_size),
        modelVariables=[ModelVariable("time", type="Real", causality="independent", variability="continuous"), *outer],
    )
    folder.mkdir()
    configuration = Configuration(
        parallelDoStep=False,  # threads cost more than these FMUs
        modelDescription=description,
        components=list(components.values()),
        connections=_connections(case, components, inner),
        variableMappings=outer,
    )
    create_container_fmu(configuration, folder, file)


def _connections(case: Case, components: dict[str, Component], inner: dict[str, ModelVariable]) -> list[Connection]:
    """One for each pair of instances, in the order of the case."""
    from fmpy.container_fmu.config import Connection

    pairs: dict[tuple[str, str], Connection] = {}
    for source, target in case.connections:
        key = split(source)[0], split(target)[0]
        pair = pairs.setdefault(key, Connection(components[key[0]], [], components[key[1]], []))
        pair.startConnectors.append(_float64(inner[source]))
        pair.endConnectors.append(_float64(inner[target]))
    return list(pairs.values())


def _float64(variable: ModelVariable) -> ModelVariable:
    renamed = copy(variable)
    renamed.type = "Float64"
    return renamed
