"""Examples in docstrings run, and print what they say."""

from __future__ import annotations

import doctest
from importlib import import_module
from pathlib import Path

import pytest

from parallel_robot.scenario import load_scenario
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.sources import sources

MODULES = [name for name, path in sources().items() if ">>> " in path.read_text(encoding="utf-8")]


def test_there_are_examples():
    assert {
        "cosim",
        "cosim.results.results",
        "cosim.master.simulation",
        "cosim.system.system",
        "fmu_export.modelling.units",
    } <= set(MODULES)


@pytest.mark.parametrize("name", MODULES)
def test_examples_of_a_module(robot_fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    (tmp_path / "fmus").mkdir()
    for flavour in ("fmi2", "pythonfmu"):
        source = robot_fmus / (DEFAULT_FLAVOUR if flavour == "fmi2" else flavour)
        (tmp_path / "fmus" / flavour).symlink_to(source, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    module = import_module(name)
    given = {"system": load_scenario("tracking").system(Path("fmus"), "fmi2")}
    failed, attempted = doctest.testmod(module, extraglobs=given)
    assert attempted > 0
    assert failed == 0


def test_a_wrong_example_fails():
    test = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "wrong", None, None)
    assert doctest.DocTestRunner(verbose=False).run(test, out=lambda _: None).failed == 1
