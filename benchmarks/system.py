"""The system that is measured: the paper's 15 s at 1 ms, everything recorded."""

from __future__ import annotations

from pathlib import Path

from cosim import System
from interop.tools.case import PATH, Case
from parallel_robot.fmus import fmu_path
from parallel_robot.models import MODELS
from parallel_robot.scenario import RobotScenario, load_scenario
from parallel_robot.wiring import CONNECTIONS

STOP_TIME, STEP = 15.0, 1e-3
#: No signals, which not every master can feed: the inputs that nothing is connected to are held at zero.
START = {"plant": {"dm": 0.0, "tau_d[1]": 0.0, "tau_d[2]": 0.0, "tau_d[3]": 0.0}}


def disturbed() -> RobotScenario:
    """With mass change and disturbance, as the paper's section 6 has it."""
    return load_scenario("tracking")


def undisturbed(folder: Path, flavour: str = "fmi2") -> System:
    """The system of the peers' case for our own master."""
    system = System()
    for name in MODELS:
        system.add(name, fmu_path(folder, flavour, name), start=START.get(name))
    for source, target in CONNECTIONS:
        system.connect(source, target)
    return system


def case(folder: Path, step: float = STEP, *, path_only: bool = False) -> Case:
    """The case for the peers."""
    recorded = [f"{n}.{v}" for n, m in MODELS.items() for v in (*m.inputs.names, *m.outputs.names)]
    return Case(
        fmus={name: fmu_path(folder, "fmi2", name) for name in MODELS},
        connections=[(f"{s}[{i}]", f"{t}[{i}]") for s, t in CONNECTIONS for i in (1, 2, 3)],
        start=START,
        stop_time=STOP_TIME,
        step_size=step,
        recorded=list(PATH) if path_only else recorded,
    )
