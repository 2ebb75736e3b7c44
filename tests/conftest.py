"""Fixtures shared by all tests: the FMUs, built once for each worker."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from cosim.fmi.unpacking import folder_for_fmus
from cosim.results.figure_process import FigureProcess
from fmu_export.native import toolchain
from parallel_robot.fmus import build
from tests.support import compilation
from tests.support.browser import Tabs, chromium
from tests.support.compilation import OPTIMISATION_OF_ROBOT, built_once
from tests.support.fmi3_gain import build_gain
from tests.support.native_fmus import DEFAULT_FLAVOUR, FLAVOURS, require_compiler, unpack

# on a busy machine an example takes long, which is no failure of what it tries
hypothesis.settings.register_profile("tests", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile("tests")

# background jobs start the tests with SIGINT ignored and nohup with SIGHUP, and every process of the tests inherits it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


class LeftOut:
    """Says how many slow tests were left out, and how they are run."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._number = 0

    def pytest_deselected(self, items: Sequence[pytest.Item]) -> None:
        """Count them, in a worker for the process that started it."""
        self._number += sum(item.get_closest_marker("slow") is not None for item in items)
        if hasattr(self._config, "workeroutput"):
            self._config.workeroutput["left out"] = self._number

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Each worker of xdist collects all tests."""
        self._number = max(self._number, getattr(node, "workeroutput", {}).get("left out", 0))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """One line, if there are any."""
        if self._number:
            terminalreporter.write_line(
                f"slow tests left out: {self._number}; python -m tests --all, or pytest -m '', runs them too"
            )


def pytest_configure(config: pytest.Config) -> None:
    """Count the tests that are left out."""
    config.pluginmanager.register(LeftOut(config))


def pytest_collection_finish() -> None:
    """Modules and tests live until the end: the many collections of garbage, some in tests, need not look at them."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def folder_of_compilation(tmp_path_factory: pytest.TempPathFactory) -> None:
    """The workers' folders for temporary files are in a common one."""
    base = tmp_path_factory.getbasetemp()
    compilation.folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled"


@pytest.fixture(scope="session", autouse=True)
def compile_fast() -> Iterator[None]:
    """FMUs that tests build in their own process: compilation is what takes the time of most of these tests.

    Without optimisation it takes a third, and gives the same bits, which tests of the elementary functions show. The
    robot's FMUs, which run for long, are optimised a little; what commands build is optimised as for users.
    """
    before, toolchain.OPTIMISATION = toolchain.OPTIMISATION, "-O0"
    yield
    toolchain.OPTIMISATION = before


@pytest.fixture
def plain_path() -> Iterator[Path]:
    """A fresh folder in which FMUs are unpacked, if it is that for temporary files; tmp_path may have another name."""
    with folder_for_fmus() as folder:
        yield Path(folder)


def _built(folder: Path, *flavours: str) -> Path:
    """The robot's FMUs in a folder, laid out as `build_fmus.py` does: <folder>/pythonfmu/RobotPlant.fmu and so on."""
    for flavour in flavours:
        built_once(f"robot-{flavour}", partial(build, flavour=flavour), folder, OPTIMISATION_OF_ROBOT)
    return folder


@pytest.fixture(scope="session")
def robot_fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of built FMUs: <folder>/pythonfmu/RobotPlant.fmu and so on.

    Also of the flavour that is the default here: fmi2 where there is a C compiler.
    """
    return _built(tmp_path_factory.mktemp("fmus"), *{"pythonfmu": None, DEFAULT_FLAVOUR: None})


@pytest.fixture(scope="session")
def fmus(robot_fmus: Path) -> Path:
    """Folder with RobotPlant.fmu, RobotController.fmu and RobotTrajectory.fmu of the pythonfmu flavour."""
    return robot_fmus / "pythonfmu"


@pytest.fixture(scope="session")
def native_fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the FMUs in C: <folder>/fmi2/RobotPlant.fmu, <folder>/fmi3/RobotPlant.fmu and so on."""
    require_compiler()
    return _built(tmp_path_factory.mktemp("native"), *FLAVOURS)


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


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, started once a file."""
    with chromium() as found:
        yield found


@pytest.fixture
def tabs(browser: Any) -> Iterator[Tabs]:
    """Opens pages; none may have logged an error or asked for anything outside of itself."""
    found = Tabs(browser)
    yield found
    found.close()
