"""FMPy as its users drive it: a loop in Python over the wrappers `FMU2Slave.getReal`, `setReal` and `doStep`.

FMI 3.0 is the same with `FMU3Slave`, `getFloat64` and `setFloat64`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from interop.tools.case import Case, ToolRun, split

NAME = "fmpy_loop"
TITLE = "FMPy, loop over FMU2Slave"
PACKAGE = "fmpy"

Slave: TypeAlias = FMU2Slave | FMU3Slave


def unavailable() -> str | None:
    """FMPy is a dependency of the project."""
    return None


def run(case: Case, folder: Path) -> ToolRun:
    """Exchange in the order of the connections, record, step; one call of FMPy for each instance and purpose."""
    began = time.perf_counter()
    references = case.references()
    instances = {name: instance(name, fmu, folder / name) for name, fmu in case.fmus.items()}
    transfers = [
        (
            [(instances[source], refs) for source, refs in sources.items()],
            instances[target],
            targets,
        )
        for target, sources, targets in _transfers(case, references)
    ]
    recorded = {name: names for name in instances if (names := case.recorded_of(name))}
    records = [(instances[name], [references[name][v] for v in names]) for name, names in recorded.items()]
    columns = [f"{name}.{v}" for name, names in recorded.items() for v in names]

    for name, values in case.start.items():
        setter(instances[name])([references[name][v] for v in values], list(values.values()))
    for slave in instances.values():
        if isinstance(slave, FMU2Slave):
            slave.setupExperiment(startTime=0.0, stopTime=case.stop_time)
        slave.enterInitializationMode()
    _exchange(transfers)
    for slave in instances.values():
        slave.exitInitializationMode()

    slaves, step_size, rows = list(instances.values()), case.step_size, []
    loop_began = time.perf_counter()
    for i in range(case.steps + 1):
        if i:
            for slave in slaves:
                slave.doStep((i - 1) * step_size, step_size)
        _exchange(transfers)
        row = []
        for slave, refs in records:
            row += getter(slave)(refs)
        rows.append(row)
    loop_time = time.perf_counter() - loop_began

    table: np.ndarray = np.array(rows)
    for slave in slaves:
        slave.terminate()
        slave.freeInstance()
    x_E, y_E = (table[:, columns.index(name)] for name in case.path)
    total = time.perf_counter() - began
    return ToolRun(loop_time, total, case.times, x_E, y_E, "sequential", len(columns))


def getter(slave: Slave) -> Callable[[list[int]], list[float]]:
    """Get real values by their references."""
    return slave.getReal if isinstance(slave, FMU2Slave) else slave.getFloat64


def setter(slave: Slave) -> Callable[[list[int], list[float]], None]:
    """Set real values by their references."""
    return slave.setReal if isinstance(slave, FMU2Slave) else slave.setFloat64


def instance(name: str, fmu: Path, folder: Path) -> Slave:
    """An instance of an FMU file, unpacked into a folder."""
    description = fmpy.read_model_description(fmu)
    fmpy.extract(fmu, folder)
    slave = (FMU2Slave if description.fmiVersion.startswith("2") else FMU3Slave)(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName=name,
    )
    slave.instantiate()
    return slave


def _transfers(case: Case, references: dict[str, dict[str, int]]) -> list[tuple[str, dict[str, list[int]], list[int]]]:
    """(target, source -> its value references, value references of the target), each target once."""
    targets = dict.fromkeys(split(target)[0] for _, target in case.connections)
    result = []
    for target in targets:
        sources: dict[str, list[int]] = {}
        fed: dict[str, list[int]] = {}
        for source, sink in (tuple(map(split, c)) for c in case.connections):
            if sink[0] == target:
                sources.setdefault(source[0], []).append(references[source[0]][source[1]])
                fed.setdefault(source[0], []).append(references[target][sink[1]])
        result.append((target, sources, [r for refs in fed.values() for r in refs]))
    return result


def _exchange(transfers: list[tuple[list[tuple[Slave, list[int]]], Slave, list[int]]]) -> None:
    for sources, target, references in transfers:
        values = []
        for source, refs in sources:
            values += getter(source)(refs)
        setter(target)(references, values)
