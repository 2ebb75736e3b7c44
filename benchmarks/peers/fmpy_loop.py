"""FMPy as its users drive it: a loop in Python over the wrappers `FMU2Slave.getReal`, `setReal` and `doStep`."""

from __future__ import annotations

import time
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from benchmarks.peers.case import PATH, Case, PeerRun, split

NAME = "fmpy_loop"
TITLE = "FMPy, loop over FMU2Slave"
PACKAGE = "fmpy"


def unavailable() -> str | None:
    """FMPy is a dependency of the project."""
    return None


def run(case: Case, folder: Path) -> PeerRun:
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

    for slave in instances.values():
        slave.setupExperiment(startTime=0.0, stopTime=case.stop_time)
    for name, values in case.start.items():
        instances[name].setReal([references[name][v] for v in values], list(values.values()))
    for slave in instances.values():
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
            row += slave.getReal(refs)
        rows.append(row)
    loop_time = time.perf_counter() - loop_began

    table: np.ndarray = np.array(rows)
    for slave in slaves:
        slave.terminate()
        slave.freeInstance()
    x_E, y_E = (table[:, columns.index(name)] for name in PATH)
    total = time.perf_counter() - began
    return PeerRun(loop_time, total, case.times, x_E, y_E, "sequential", len(columns))


def instance(name: str, fmu: Path, folder: Path) -> FMU2Slave:
    """An instance of an FMU file, unpacked into a folder."""
    description = fmpy.read_model_description(fmu)
    fmpy.extract(fmu, folder)
    slave = FMU2Slave(
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


def _exchange(transfers: list[tuple[list[tuple[FMU2Slave, list[int]]], FMU2Slave, list[int]]]) -> None:
    for sources, target, references in transfers:
        values = []
        for source, refs in sources:
            values += source.getReal(refs)
        target.setReal(references, values)
