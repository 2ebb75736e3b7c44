"""Ecos through ecospy: its fixed-step algorithm, all recorded by its CSV writer (it keeps nothing in memory)."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from interop.tools.availability import missing
from interop.tools.case import Case, ToolRun, split

if TYPE_CHECKING:
    from ecospy import EcosSimulation

NAME = "ecos"
TITLE = "Ecos, CSV writer"
PACKAGE = "ecospy"

#: The set that is applied; of an SSP, the parameter sets of this name.
START_VALUES = "start values"


def unavailable() -> str | None:
    """Its wheel holds its library, but not TBB, which that links."""
    if reason := missing("ecospy", "pip install ecospy"):
        return reason
    try:
        ctypes.CDLL("libtbb.so.12")
    except OSError:
        return "ecospy needs TBB 12: apt-get install libtbb12"
    return None


def run(case: Case, folder: Path) -> ToolRun:
    """Run once with the CSV writer, timed, and once for the path: the writer keeps only six decimals."""
    return record(lambda: _simulation(case), case, folder)


def record(simulate: Callable[[], AbstractContextManager[EcosSimulation]], case: Case, folder: Path) -> ToolRun:
    """Run simulations that `simulate` makes, which take their start values from the parameter set `START_VALUES`."""
    began = time.perf_counter()
    file = folder / "results.csv"
    with simulate() as simulation:
        simulation.add_csv_writer(str(file), identifiers=[_identifier(name) for name in case.recorded])
        simulation.init(parameter_set=START_VALUES)
        loop_began = time.perf_counter()
        simulation.step(case.steps)
        loop_time = time.perf_counter() - loop_began
    table = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2)
    total = time.perf_counter() - began
    iterations_and_time = 2
    recorded = table.shape[1] - iterations_and_time
    if len(table) != case.steps + 1 or recorded != len(case.recorded):
        raise RuntimeError(f"ecos wrote {len(table)} rows of {recorded} values")

    x_E, y_E = _path(simulate, case)
    note = "the CSV file has six decimals; the path is from a second run, without it"
    return ToolRun(loop_time, total, case.times, x_E, y_E, "parallel (Jacobi)", recorded, note)


@contextmanager
def _simulation(case: Case) -> Iterator[EcosSimulation]:
    from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

    EcosLib.set_log_level("err")
    with EcosSimulationStructure() as structure:
        for instance, fmu in case.fmus.items():
            structure.add_model(instance, fmu)
        for source, target in case.connections:
            structure.make_real_connection(_identifier(source), _identifier(target))
        start = {f"{i}::{name}": float(value) for i, values in case.start.items() for name, value in values.items()}
        structure.add_parameter_set(START_VALUES, start)
        with EcosSimulation(structure=structure, step_size=case.step_size) as simulation:
            yield simulation
            simulation.terminate()


def _path(simulate: Callable[[], AbstractContextManager[EcosSimulation]], case: Case) -> np.ndarray:
    """Position of the end effector (2, steps + 1) in m, read step by step."""
    names = [_identifier(name) for name in case.path]
    with simulate() as simulation:
        simulation.init(parameter_set=START_VALUES)
        path = [[simulation.get_real(name) for name in names]]
        for _ in range(case.steps):
            simulation.step()
            path.append([simulation.get_real(name) for name in names])
    return np.array(path).T


def _identifier(path: str) -> str:
    return "::".join(split(path))
