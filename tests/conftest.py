"""Fixtures shared by all tests: the FMUs, built once for each worker."""

from __future__ import annotations

from pathlib import Path

import pytest

from cosim.results.figure_process import FigureProcess
from fmu_export.native.backend import build_native
from parallel_robot.fmus import build, default_flavour
from parallel_robot.models import MODELS
from tests.support.fmi3_gain import build_gain
from tests.support.native_fmus import FLAVOURS, require_compiler, unpack

#: The flavour that `cosim run` takes when none is asked for: fmi2 where there is a C compiler, else pythonfmu.
DEFAULT_FLAVOUR = default_flavour(Path("no such folder"))[0]


@pytest.fixture(scope="session")
def robot_fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of built FMUs, laid out as `build_fmus.py` does: <folder>/pythonfmu/RobotPlant.fmu and so on.

    Also of the flavour that is the default here: fmi2 where there is a C compiler.
    """
    folder = tmp_path_factory.mktemp("fmus")
    for flavour in {"pythonfmu", DEFAULT_FLAVOUR}:
        build(folder, flavour)
    return folder


@pytest.fixture(scope="session")
def fmus(robot_fmus: Path) -> Path:
    """Folder with RobotPlant.fmu, RobotController.fmu and RobotTrajectory.fmu of the pythonfmu flavour."""
    return robot_fmus / "pythonfmu"


@pytest.fixture(scope="session")
def native_fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the FMUs in C: <folder>/fmi2/RobotPlant.fmu, <folder>/fmi3/RobotPlant.fmu and so on."""
    require_compiler()
    folder = tmp_path_factory.mktemp("native")
    for flavour in FLAVOURS:
        for model in MODELS.values():
            build_native(model, folder / flavour, flavour)
    return folder


@pytest.fixture(scope="session")
def unpacked(native_fmus: Path) -> Path:
    """The same, unpacked: <folder>/<flavour>/<model name>/modelDescription.xml and so on."""
    folder = native_fmus / "unpacked"
    for flavour in FLAVOURS:
        for fmu in sorted((native_fmus / flavour).glob("*.fmu")):
            unpack(fmu, folder / flavour / fmu.stem)
    return folder


@pytest.fixture(scope="session")
def gain3c(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU of tests/support/fmi3_gain.c."""
    require_compiler()
    return build_gain(tmp_path_factory.mktemp("fmi3"))


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """`cosim run` without figures, which take most of the time of a short run."""
    monkeypatch.setattr(FigureProcess, "start", lambda *_: None)
    monkeypatch.setattr(FigureProcess, "write", lambda *_: [])
