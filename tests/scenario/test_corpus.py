"""The broken and hostile scenarios and SSPs of the corpus: each is read and set up, or refused in a line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim import CosimError, Simulation
from cosim.osp import read_osp
from cosim.scenario import load_scenario
from cosim.ssp import read_ssp
from tests.support.corpus import RUNS, SCENARIOS, SYSTEMS, Case, Materials
from tests.support.native_fmus import require_compiler

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the FMUs of the corpus are for Linux")

#: Words of cases that only a command refuses: for their times, recordings, metrics.
LATE = ("a stop", "a step", "a negative step", "a recording of", "a recording every", "a metric of nothing")


@pytest.fixture(scope="module")
def materials(tmp_path_factory: pytest.TempPathFactory) -> Materials:
    require_compiler()
    return Materials(tmp_path_factory.mktemp("corpus"))


def set_up_scenario(path: Path, folder: Path) -> None:
    Simulation(load_scenario(str(path)).system())


def set_up_system(path: Path, folder: Path) -> None:
    found = read_osp(path) if path.suffix == ".xml" else read_ssp(path, folder / "unpacked")
    Simulation(found.system, order=found.order)


def faults(cases: list[Case], set_up: Callable[[Path, Path], None], folder: Path, materials: Materials) -> list[str]:
    """Cases that come out in another way than they should."""
    found = []
    for k, case in enumerate(cases):
        (here := folder / str(k)).mkdir()
        said = ""
        try:
            set_up(case.make(here, materials), here)
        except CosimError as error:
            said = str(error)
        late = any(text in case.name for text in LATE)
        wanted = not said if case.expected == RUNS else late or (bool(said) and case.says in said)
        if not wanted or "\n" in said:
            found.append(f"{case.name}: wanted {case.expected} {case.says!r}, got {said!r}")
        assert not list(folder.rglob("escaped*")), case.name
    return found


def test_scenarios(tmp_path: Path, materials: Materials) -> None:
    assert faults(list(SCENARIOS), set_up_scenario, tmp_path, materials) == []


def test_systems(tmp_path: Path, materials: Materials) -> None:
    assert faults(list(SYSTEMS), set_up_system, tmp_path, materials) == []
