"""The models of the system by the instance names that scenarios, results and analyses use."""

from __future__ import annotations

from controller_fmu.model import MODEL as CONTROLLER
from cosim.robot.trajectory import MODEL as TRAJECTORY
from fmu_export.model import Model
from plant_fmu.model import MODEL as PLANT

MODELS: dict[str, Model] = {"plant": PLANT, "controller": CONTROLLER, "trajectory": TRAJECTORY}
