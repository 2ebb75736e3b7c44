"""Packed systems beside the same systems unpacked, for the tests of packing."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from cosim import Results, System
from parallel_robot.wiring import CONNECTIONS
from tests.support.tiny_models import GAIN, INTEGRATOR

#: Versions of FMI of packed FMUs.
VERSIONS = (2, 3)


def robot(folders: Sequence[Path]) -> System:
    """The robot's closed loop, with the FMUs of plant, controller and trajectory from these folders."""
    system = System()
    for folder, name in zip(folders, ("Plant", "Controller", "Trajectory"), strict=True):
        system.add(name.lower(), folder / f"Robot{name}.fmu")
    for source, target in CONNECTIONS:
        system.connect(source, target)
    return system


def small_loop(folder: Path, every: int = 1, of_gain: Path | None = None) -> System:
    """An integrator, which communicates every so many steps, and a gain in a loop; the gain's second input is open."""
    system = System()
    system.add("i", folder / f"{INTEGRATOR.name}.fmu", start={"x_start": 1.0}, every=every)
    system.add("g", (of_gain or folder) / f"{GAIN.name}.fmu", start={"K": -1.3})
    system.connect("i.x", "g.u[1]")
    system.connect("g.y[1]", "i.u")
    return system


def _passed_over(*message: object) -> None:
    """FMPy keeps one logger for all instances, also when its owner is gone: each run has to give one that stays."""


def run_in_fmpy(
    fmu: Path, stop_time: float, step: float, output: Sequence[str], start: Mapping[str, Any] | None = None, **more: Any
) -> np.ndarray:
    """Outputs (rows, columns) of an FMU that FMPy runs at a communication step (s)."""
    found = fmpy.simulate_fmu(
        str(fmu),
        fmi_type="CoSimulation",
        stop_time=stop_time,
        output_interval=step,
        step_size=step,
        output=list(output),
        start_values=dict(start or {}),
        **{"logger": _passed_over, **more},
    )
    return np.column_stack([found[name].astype(float) for name in output])


def columns(results: Results, names: Sequence[str]) -> np.ndarray:
    """Columns of results by name (rows, columns), as numbers."""
    return np.column_stack([np.asarray(results[name], dtype=float) for name in names])


@contextmanager
def instance_of(fmu: Path, logger: Callable[..., None] = _passed_over) -> Iterator[tuple[Any, dict[str, int]]]:
    """An instance in FMPy that has just been instantiated, and the value references of its variables."""
    description = fmpy.read_model_description(str(fmu), validate=False)
    folder = fmpy.extract(str(fmu))
    instance = fmpy.instantiate_fmu(folder, description, "CoSimulation", logger=logger)
    try:
        yield instance, {v.name: v.valueReference for v in description.modelVariables}
    finally:
        instance.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)


def initialized(instance: Any, stop_time: float | None = None) -> Any:
    """The instance of FMI 2.0, through its initialisation."""
    instance.setupExperiment(startTime=0.0, stopTime=stop_time)
    instance.enterInitializationMode()
    instance.exitInitializationMode()
    return instance
