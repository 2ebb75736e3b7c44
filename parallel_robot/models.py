"""The models of the system by the component names that scenarios, results and analyses use."""

from __future__ import annotations

from functools import cache

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.modelling.model import Model
from parallel_robot.wiring import CONNECTIONS
from plant_fmu.model import MODEL as PLANT
from trajectory_fmu.model import MODEL as TRAJECTORY

MODELS: dict[str, Model] = {"plant": PLANT, "controller": CONTROLLER, "trajectory": TRAJECTORY}


@cache
def closed_loop_model() -> Model:
    """`RobotClosedLoop`: all of `MODELS` connected to one model, for tools that can't couple FMUs."""
    from fmu_export.trace.composition import compose  # CasADi takes a while to import

    return compose(
        "RobotClosedLoop",
        "Parallel robot, adaptive robust controller and desired path, connected: the closed loop of Han et al. 2021",
        MODELS,
        CONNECTIONS,
        PLANT.default_experiment,
    )
