"""What the tools run: the closed loop, as three FMUs that they couple, and as one FMU."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cosim import System
from interop.tools.case import Case, split
from parallel_robot.fmus import CLOSED_LOOP, fmu_path
from parallel_robot.models import MODELS
from parallel_robot.wiring import CONNECTIONS

STOP_TIME, STEP = 3.0, 1e-3

#: Inputs that nothing feeds, and values that differ from the start values in the files: a tool that does not set them
#: runs another system.
START = {
    "plant": {"dm": 0.1, "tau_d[1]": 0.05, "tau_d[2]": -0.03, "tau_d[3]": 0.04, "x_E_start": 0.21},
    "controller": {"alpha": 2.0, "S[2]": 2.5},
    "trajectory": {"R": 0.4},
}


def coupled(folder: Path, flavour: str, step: float = STEP) -> Case:
    """Robot, controller and desired path, connected by the tool."""
    return Case(
        fmus={name: fmu_path(folder, flavour, name) for name in MODELS},
        connections=[pair for source, target in CONNECTIONS for pair in _scalars(source, target)],
        start=START,
        stop_time=STOP_TIME,
        step_size=step,
        recorded=[f"{n}.{v}" for n, m in MODELS.items() for v in m.outputs.names],
    )


def _scalars(source: str, target: str) -> list[tuple[str, str]]:
    """Connections of the elements of two variables."""
    (a, output), (b, variable) = split(source), split(target)
    outputs = next(v.names for v in MODELS[a].outputs.variables if v.name == output)
    inputs = next(v.names for v in MODELS[b].inputs.variables if v.name == variable)
    return [(f"{a}.{o}", f"{b}.{i}") for o, i in zip(outputs, inputs, strict=True)]


def one_fmu(folder: Path, flavour: str, step: float = STEP) -> Case:
    """The closed loop in one FMU."""
    return Case(
        fmus={"loop": fmu_path(folder, flavour, CLOSED_LOOP)},
        connections=[],
        start={"loop": {f"{part}.{name}": value for part, values in START.items() for name, value in values.items()}},
        stop_time=STOP_TIME,
        step_size=step,
        recorded=[f"loop.{n}.{v}" for n, m in MODELS.items() for v in m.outputs.names],
        path=("loop.plant.x_E", "loop.plant.y_E"),
    )


def packaged(folder: Path, flavour: str, step: float = STEP) -> Case:
    """The three FMUs, their connections and start values as an SSP, which is written beside the FMUs."""
    from cosim.ssp.writer import Experiment, write_ssp

    parts = coupled(folder, flavour, step)
    path = folder / "ssp" / f"{flavour}_{step * 1e3:g}ms.ssp"
    path.parent.mkdir(exist_ok=True)
    write_ssp(path, system(parts), "RobotClosedLoop", Experiment(STOP_TIME, step))
    return replace(parts, fmus={"system": path}, connections=[], start={})


def system(case: Case) -> System:
    """The same for our own master."""
    result = System()
    for name, fmu in case.fmus.items():
        result.add(name, fmu, start=case.start.get(name))
    for source, target in case.connections:
        result.connect(source, target)
    return result
