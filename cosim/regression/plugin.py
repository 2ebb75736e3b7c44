"""The pytest plugin: options and hooks only, for pytest loads this in every session; see docs/regression.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cosim.regression.fixture import FmuRegression


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options, all of which begin with --fmu."""
    group = parser.getgroup("fmu", "regression of FMUs")
    group.addoption(
        "--fmu",
        action="append",
        default=[],
        dest="cosim_fmu",
        metavar="FMU",
        help="FMU file, or folder of them, to run and hold against references; may be given several times",
    )
    group.addoption(
        "--fmu-reference",
        dest="cosim_fmu_reference",
        metavar="DIR",
        help="folder of cases (default: that of the FMU, or 'reference' in it, or 'reference' here)",
    )
    group.addoption(
        "--fmu-report", dest="cosim_fmu_report", metavar="FILE", help="write a page with curves and bands (HTML)"
    )
    group.addoption(
        "--fmu-rebaseline",
        dest="cosim_fmu_rebaseline",
        metavar="CASE",
        help="rewrite the reference of this one case; refused in CI, in parallel, and where git could not undo it",
    )
    group.addoption(
        "--fmu-timeout",
        type=float,
        default=600.0,
        dest="cosim_fmu_timeout",
        metavar="SECONDS",
        help="longest time that one run may take (default: 600)",
    )
    group.addoption(
        "--fmu-build",
        action="store_true",
        dest="cosim_fmu_build",
        help="compile the C sources of FMUs that have no binary for this machine",
    )
    group.addoption(
        "--fmu-log",
        choices=("none", "error", "warning", "info", "all"),
        dest="cosim_fmu_log",
        metavar="LEVEL",
        help="show what the FMUs say with each failing test (with -rP: with all): none, error, warning, info, all",
    )
    group.addoption(
        "--fmu-require-signed",
        action="append",
        default=[],
        dest="cosim_fmu_require_signed",
        metavar="KEY",
        help="run only FMUs that the owner of this public key has signed (cosim sign); may be repeated",
    )
    group.addoption(
        "--fmu-isolated",
        action="store_false",
        dest="cosim_fmu_in_process",
        default=False,
        help="run each FMU in a process of its own, which is the default",
    )
    group.addoption(
        "--fmu-in-process",
        action="store_true",
        dest="cosim_fmu_in_process",
        help="run FMUs in this process, for a debugger: faster, but a crash ends the session",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Select FMUs, where an option asks for any."""
    if _used(config):
        from cosim.regression.session import configure

        configure(config)


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect the cases of an FMU file that was selected."""
    if file_path.suffix == ".fmu" and parent.config.getoption("cosim_fmu"):
        from cosim.regression.items import collector

        return collector(file_path, parent)
    return None


def pytest_collection_modifyitems(session: pytest.Session, items: list[pytest.Item]) -> None:
    """Add a failing test for each option that names no FMU."""
    if session.config.getoption("cosim_fmu"):
        from cosim.regression.items import troubles

        items += troubles(session, items)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Pass on what the page needs."""
    made: Any = yield
    if item.config.getoption("cosim_fmu_report"):
        from cosim.regression.session import pass_on

        pass_on(item, made.get_result())


@pytest.fixture
def fmu_regression(request: pytest.FixtureRequest) -> FmuRegression:
    """Run an FMU under the inputs of its cases, and fail where it leaves the references.

    `fmu_regression("my.fmu")` runs all cases and interfaces; see `cosim.regression.fixture.FmuRegression`.
    """
    from cosim.regression.fixture import FmuRegression

    return FmuRegression(request)


def _used(config: pytest.Config) -> bool:
    return any(config.getoption(f"cosim_fmu{name}") for name in ("", "_report", "_rebaseline"))
