"""Fixtures shared by all tests: the FMUs, built once for each worker."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.robot.fmus import build


@pytest.fixture(scope="session")
def robot_fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of built FMUs, laid out as `build_fmus.py` does: <folder>/pythonfmu/RobotPlant.fmu and so on."""
    folder = tmp_path_factory.mktemp("fmus")
    build(folder, "pythonfmu")
    return folder


@pytest.fixture(scope="session")
def fmus(robot_fmus: Path) -> Path:
    """Folder with RobotPlant.fmu, RobotController.fmu and RobotTrajectory.fmu of the pythonfmu flavour."""
    return robot_fmus / "pythonfmu"
