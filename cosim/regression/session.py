"""What `--fmu` and its companions do to a pytest session."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

from cosim.files.temporary import TemporaryFolder
from cosim.regression.page import Part, write_page
from cosim.regression.rebaseline import reason_against


@dataclass
class Selection:
    """FMU files: all, those named one by one; and one line for each option that names none."""

    fmus: list[Path] = field(default_factory=list)
    named: list[Path] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)


#: Key of a session's selection.
SELECTION = pytest.StashKey[Selection]()

#: Key of a session's written references.
WRITTEN = pytest.StashKey[list[str]]()

#: Key of a test's sections of the page.
PARTS = pytest.StashKey[list[Part]]()

#: Where a session keeps the folder with the files of the cases that FMUs bring along.
_SHIPPED = pytest.StashKey[TemporaryFolder]()

#: Attribute of a test report that has them; pytest-xdist sends it to the main process.
_ATTRIBUTE = "cosim_fmu_page"


def select(names: list[str]) -> Selection:
    """Find FMU files by the names of files and folders."""
    selection = Selection()
    for name in names:
        path = Path(name)
        found = sorted(path.rglob("*.fmu")) if path.is_dir() else [path]
        if not found:
            selection.troubles.append(f"--fmu {name}: there is no FMU file in this folder")
        elif not path.exists():
            selection.troubles.append(f"--fmu {name}: there is no such file or folder")
        elif path.is_file() and path.suffix != ".fmu":
            selection.troubles.append(f"--fmu {name}: the name of an FMU file ends with .fmu")
        else:
            selection.fmus += [where for fmu in found if (where := _without_dots(fmu)) not in selection.fmus]
            selection.named += [] if path.is_dir() else [_without_dots(path)]
    return selection


def _without_dots(path: Path) -> Path:
    """An absolute path, as pytest has those that it collects."""
    return Path(os.path.abspath(path))  # noqa: PTH100 - pathlib leaves `..` in it


def configure(config: pytest.Config) -> None:
    """Make the FMU files part of what is collected: all of it where no path was given.

    Raises
    ------
    pytest.UsageError
        A reference is to be made anew where that is not allowed.
    """
    selection = select(config.getoption("cosim_fmu"))
    config.stash[SELECTION] = selection
    worker = hasattr(config, "workerinput")
    if case := config.getoption("cosim_fmu_rebaseline"):
        parallel = worker or bool(config.getoption("numprocesses", None)) or bool(config.getoption("tx", None))
        arguments = [str(argument) for argument in config.invocation_params.args]
        reason = reason_against(arguments, os.environ, parallel=parallel, fmus=len(selection.fmus))
        if reason:
            raise pytest.UsageError(f"--fmu-rebaseline {case}: {reason}")
        config.stash[WRITTEN] = []
        config.pluginmanager.register(_Written(), "cosim_fmu_written")
    if config.getoption("cosim_fmu"):  # also in a worker of pytest-xdist, which reads the command line anew
        given = config.args if config.args_source == config.ArgsSource.ARGS else []
        chosen = {_without_dots(Path(argument.partition("::")[0])) for argument in given}  # single tests of an FMU
        config.args = [*given, *(str(fmu) for fmu in selection.fmus if fmu not in chosen)]
    if not worker and (path := config.getoption("cosim_fmu_report")):
        config.pluginmanager.register(_Page(Path(path)), "cosim_fmu_report")


def folder_for_shipped(config: pytest.Config) -> Path:
    """A new folder for the files of the cases that one FMU brings along, which lives as long as the session."""
    if _SHIPPED not in config.stash:
        config.stash[_SHIPPED] = TemporaryFolder()
        config.add_cleanup(config.stash[_SHIPPED].cleanup)
    return Path(mkdtemp(dir=config.stash[_SHIPPED].name))


def pass_on(item: pytest.Item, report: pytest.TestReport) -> None:
    """Put what a test has for the page into its report."""
    if report.when == "call" and PARTS in item.stash:
        setattr(report, _ATTRIBUTE, item.stash[PARTS])


class _Written:
    """Says at the end which references were written."""

    def pytest_terminal_summary(self, terminalreporter: Any, config: pytest.Config) -> None:
        for line in config.stash[WRITTEN]:
            terminalreporter.write_line(line)


class _Page:
    """Collects the parts of the page from the test reports, and writes it at the end."""

    def __init__(self, path: Path) -> None:
        self._path = path.absolute()
        self._parts: list[Part] = []
        self._said = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._parts += getattr(report, _ATTRIBUTE, [])

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        try:
            write_page(self._parts, self._path)
            self._said = f"report of the FMUs: {self._path}"
        except OSError as error:
            self._said = f"--fmu-report {self._path}: can't be written: {error.strerror}"
            session.exitstatus = pytest.ExitCode.USAGE_ERROR

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        terminalreporter.write_line(self._said)
