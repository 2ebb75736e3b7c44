"""Fixtures shared by all tests: the FMUs, built once for each worker."""

from __future__ import annotations

from pathlib import Path

import pytest

from controller_fmu.model import MODEL as CONTROLLER
from cosim.robot.trajectory import MODEL as TRAJECTORY
from fmu_export.pythonfmu_backend import build_pythonfmu
from plant_fmu.model import MODEL as PLANT


@pytest.fixture(scope="session")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with RobotPlant.fmu, RobotController.fmu and RobotTrajectory.fmu (pythonfmu flavour)."""
    folder = tmp_path_factory.mktemp("fmus")
    for model in (PLANT, CONTROLLER, TRAJECTORY):
        build_pythonfmu(model, folder)
    return folder
