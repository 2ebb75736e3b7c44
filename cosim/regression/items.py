"""FMU files as pytest sees them: a test for each case and interface."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cosim.errors import CosimError
from cosim.fmi.fmu_file import read_fmu
from cosim.regression.case import Case, find_cases
from cosim.regression.outcome import SHORT, Outcome, check
from cosim.regression.page import part
from cosim.regression.rebaseline import rebaseline
from cosim.regression.run import ScheduledOnly, interfaces_of
from cosim.regression.session import PARTS, SELECTION, WRITTEN, folder_for_shipped
from cosim.regression.shipped import all_cases
from cosim.regression.tolerances import Interface
from cosim.terminal import printable


def collector(path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """The collector of an FMU file, None for one that the options don't name."""
    if path.absolute() in parent.config.stash[SELECTION].fmus:
        return FmuFile.from_parent(parent, path=path)
    return None


def troubles(session: pytest.Session, items: list[pytest.Item]) -> list[pytest.Item]:
    """A failing test for each option that names no FMU, and one where no FMU of the session has a reference."""
    lines = list(session.config.stash[SELECTION].troubles)
    missing = [item for item in items if isinstance(item, NoReference)]
    if missing and not any(isinstance(item, CaseItem) for item in items):
        lines.append(f"--fmu: no FMU has a reference; {missing[0].line}")
    return [Trouble.from_parent(session, name=line.partition(":")[0], line=line) for line in lines]


class FmuFile(pytest.File):
    """One FMU file."""

    def collect(self) -> Iterator[pytest.Item]:
        """Its cases, or why there are none."""
        renewed = self.config.getoption("cosim_fmu_rebaseline")
        try:
            interfaces = interfaces_of(read_fmu(self.path, str(near(self.path))))
            if renewed:
                cases = find_cases(self.path, reference_folder(self.config))
            else:
                found = all_cases(self.path, reference_folder(self.config), folder_for_shipped(self.config))
                cases = found.cases
                for note in found.notes:
                    yield NotTried.from_parent(self, name="not tried", line=f"{self.path.name}: {note}")
        except CosimError as error:
            passed_over = isinstance(error, ScheduledOnly) and self.path not in self.config.stash[SELECTION].named
            yield (NotTried if passed_over else Trouble).from_parent(self, name="FMU", line=str(error))
            return
        if renewed == self.path.stem and renewed not in [case.name for case in cases]:
            cases = [Case(renewed, (reference_folder(self.config) or Path("reference")) / renewed)]
        if renewed:
            cases = [case for case in cases if case.name == renewed]
        if not cases:
            kind = Trouble if renewed or self.path in self.config.stash[SELECTION].named else NoReference
            yield kind.from_parent(self, name="reference", line=no_case(self.path, self.config))
        for case in cases:
            for interface in interfaces:
                name = f"{case.name}-{SHORT[interface]}"
                write = bool(renewed) and interface == interfaces[0]
                yield CaseItem.from_parent(self, name=name, case=case, interface=interface, write=write)


def reference_folder(config: pytest.Config) -> Path | None:
    """Folder of cases, where one is given."""
    folder = config.getoption("cosim_fmu_reference")
    return Path(folder) if folder else None


def no_case(fmu: Path, config: pytest.Config) -> str:
    """Why an FMU has no case, and how to make one."""
    folder = reference_folder(config)
    renewed = config.getoption("cosim_fmu_rebaseline")
    where = folder if folder is not None else f"{fmu.parent}, or 'reference' in it or here"
    if renewed:
        return f"--fmu-rebaseline {renewed}: no such case of {fmu.name} in {where}; a new one is named '{fmu.stem}'"
    if folder is not None and not folder.is_dir():
        return f"--fmu-reference {folder}: there is no such folder"
    return f"{fmu.name}: no reference of it in {where}; make one with --fmu-rebaseline {fmu.stem}"


class Differences(CosimError):
    """An FMU leaves its reference; the text has one line for each finding."""


class _Plain(pytest.Item):
    """A test whose failures are told in their own words."""

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], *args: Any) -> Any:
        if isinstance(excinfo.value, CosimError):
            return printable(str(excinfo.value))
        return super().repr_failure(excinfo, *args)

    def reportinfo(self) -> tuple[Path, None, str]:
        return self.path, None, self.name


class Trouble(_Plain):
    """A test that fails, for there is nothing to test."""

    def __init__(self, *, line: str, **options: Any) -> None:
        super().__init__(**options)
        self.line = line

    def runtest(self) -> None:
        """Say why."""
        raise Differences(self.line)


class NoReference(Trouble):
    """An FMU of a folder that has no reference; it is passed over, since others of the folder may have one."""

    def runtest(self) -> None:
        """Say so."""
        pytest.skip(printable(self.line))


class NotTried(Trouble):
    """Something that an FMU brings along and that is not tried."""

    def runtest(self) -> None:
        """Say so."""
        pytest.skip(printable(self.line))


class CaseItem(_Plain):
    """One case by one interface."""

    def __init__(self, *, case: Case, interface: Interface, write: bool, **options: Any) -> None:
        super().__init__(**options)
        self._case, self._interface, self._write = case, interface, write

    def runtest(self) -> None:
        """Run the FMU, and compare or write."""
        check_signature(self.config, self.path)
        if self._write:
            said = rebaseline(
                *(self._case, self.path, self._interface, self.config.getoption("cosim_fmu_timeout")),
                build=self.config.getoption("cosim_fmu_build"),
            )
            self.config.stash[WRITTEN].append(said)
            pytest.skip(said)
        outcome = judged(self, self._case, self.path, self._interface)
        if outcome.findings:
            raise Differences("\n".join(outcome.findings))
        if outcome.unclear:
            pytest.skip(printable(outcome.unclear))


def check_signature(config: pytest.Config, fmu: Path) -> None:
    """Check that an FMU is signed, where the session demands it.

    Raises
    ------
    CosimError
        It is not.
    """
    if keys := config.getoption("cosim_fmu_require_signed"):
        from cosim.signing import check_signed

        check_signed([near(fmu)], [Path(key) for key in keys])


def near(path: Path) -> Path:
    """A path as seen from here, where it lies below."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def judged(item: pytest.Item, case: Case, fmu: Path, interface: Interface) -> Outcome:
    """The outcome of a case, which also goes to the test report: properties, output, part of the page."""
    config = item.config
    in_process = config.getoption("cosim_fmu_in_process")
    outcome = check(
        case,
        near(fmu),
        interface,
        isolated=not in_process,
        timeout=config.getoption("cosim_fmu_timeout"),
        build=config.getoption("cosim_fmu_build"),
        log=config.getoption("cosim_fmu_log"),
    )
    item.user_properties += outcome.summary()
    if outcome.said:
        item.add_report_section("call", "FMU", printable(outcome.said))
    if config.getoption("cosim_fmu_report"):
        item.stash.setdefault(PARTS, []).append(part(outcome))
    return outcome
