"""Fixtures of the tests of the paper: all runs of the reproduction, made once for each worker."""

from __future__ import annotations

from pathlib import Path

import pytest

from parallel_robot.fmus import build
from parallel_robot.paper.reproduce.content import Runs
from parallel_robot.paper.reproduce.material import Material
from parallel_robot.paper.reproduce.runs import run_all
from tests.support.native_fmus import require_compiler


@pytest.fixture(scope="session")
def reproduction_fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the FMUs that the runs are made with."""
    require_compiler()
    folder = tmp_path_factory.mktemp("reproduction_fmus")
    build(folder, "fmi2")
    return folder


@pytest.fixture(scope="session")
def material(reproduction_fmus: Path) -> Material:
    """All runs."""
    return Material(run_all(reproduction_fmus))


@pytest.fixture(scope="session")
def runs(material: Material) -> Runs:
    """The runs by controller and condition."""
    return material.runs
