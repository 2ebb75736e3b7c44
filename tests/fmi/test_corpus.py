"""The corpus of broken and hostile FMUs, read by the reader that all commands share; what runs of it is slow."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from cosim import CosimError, SetupError
from cosim.commands.validate import _problems
from cosim.fmi.fmu_file import load
from cosim.system.variables import Ports
from tests.support.corpus import ARCHIVES, REFUSED, RUNS, STOPS, Case, Materials, all_cases
from tests.support.corpus.mutations import mutants
from tests.support.native_fmus import require_compiler
from tests.support.patience import PATIENCE

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the libraries of the corpus are for Linux")


@pytest.fixture(scope="module")
def materials(tmp_path_factory: pytest.TempPathFactory) -> Materials:
    require_compiler()
    return Materials(tmp_path_factory.mktemp("corpus"))


def test_the_corpus_is_large_and_has_all_kinds() -> None:
    cases = all_cases()
    numbers = {
        kind: sum(case.kind == kind for case in cases) for kind in ("archive", "system", "scenario", "reference")
    }
    assert numbers["archive"] >= 200
    assert min(numbers.values()) >= 40
    assert len({case.name for case in cases}) == len(cases)
    assert {case.expected for case in cases} == {REFUSED, RUNS, STOPS}


def costs_much(case: Case) -> bool:
    """Whether it takes seconds to make or to read."""
    return any(text in case.name for text in ("MiB", "100,001", "20,000", "200,000", "MB", "laughs"))


QUICK = [case for case in ARCHIVES if not case.is_hostile and not costs_much(case)]


def refusal(case: Case, folder: Path, materials: Materials) -> str:
    """Why an FMU can't be set up, without loading it; empty where it can."""
    try:
        fmu = load("x", case.make(folder, materials))
        fmu.check_binary()
        fmu.unpack(folder / "unpacked")
    except SetupError as error:
        return str(error)
    return ""


@linux
def test_fmus_are_refused_in_one_line_before_they_are_loaded(tmp_path: Path, materials: Materials) -> None:
    """All of them in one test: one a test would cost more time than what is tested."""
    wrong = []
    for k, case in enumerate(QUICK):
        (folder := tmp_path / str(k)).mkdir()
        said = refusal(case, folder, materials)
        late = "experiment" in case.name or "a stop" in case.name or "step" in case.name  # a run's own refusal
        if case.expected == RUNS and said:
            wrong.append(f"{case.name}: {said}")
        elif case.expected == REFUSED and not late and not (said and case.says in said and "\n" not in said):
            wrong.append(f"{case.name}: wanted {case.says!r}, got {said!r}")
        elif "\x1b" in said or "Errno" in said:
            wrong.append(f"{case.name}: {said!r}")
        assert not list(tmp_path.glob("escaped*")), case.name
    assert wrong == []


@pytest.mark.parametrize("number", [150, pytest.param(20_000, marks=pytest.mark.slow)])
def test_whatever_is_changed_the_reader_has_an_fmu_or_a_line(tmp_path: Path, number: int) -> None:
    outcomes = Counter[str]()
    for path in mutants(tmp_path / "x.fmu", number, seed=1):
        try:
            ports = Ports("x", load("x", path).description)
        except CosimError as error:
            outcomes["lines" if "\n" in str(error) else "line"] += 1
        else:
            assert len(ports.all_elements()) < 100
            outcomes["fmu"] += 1
    assert set(outcomes) == {"line", "fmu"}


@linux
@pytest.mark.slow
def test_validate_finds_what_a_run_refuses(tmp_path: Path, materials: Materials) -> None:
    wrong = []
    for k, case in enumerate(case for case in ARCHIVES if not costs_much(case)):
        (folder := tmp_path / str(k)).mkdir()
        try:
            found = _problems(case.make(folder, materials))
        except CosimError as error:
            found = [f"raised: {error}"]
        if case.passes != (not found):
            wrong.append(f"{case.name}: {found}")
    assert wrong == []


@linux
@pytest.mark.slow
def test_all_come_out_as_they_should() -> None:
    command = [sys.executable, "-m", "benchmarks.trust", "--master", "cosim run"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=4 * PATIENCE, check=False)
    assert done.returncode == 0, done.stdout
