"""Commands that are killed at random moments, or whose disk is full: nothing is lost but the last chunk."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.trust.kills import NUMBERS, kinds, tries
from tests.support.c_fmus import ender
from tests.support.native_fmus import require_compiler
from tests.support.patience import PATIENCE, wait_for

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and limits of files differ elsewhere")


def test_each_kind_is_known_by_its_name(tmp_path: Path) -> None:
    assert [kind.name for kind in kinds(tmp_path)] == list(NUMBERS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["run, csv", "run, npz", "run, signals", "run, full disk", "sweep"])
def test_nothing_is_lost_but_the_last_chunk(kind: str, tmp_path: Path) -> None:
    require_compiler()
    (found,) = tries(tmp_path, {kind: 4}, seed=1)
    assert found.tried == 4
    assert found.wrong == []
    assert found.found.total() >= 4


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_run_ends_whose_fmu_does_not_come_back(tmp_path: Path, number: signal.Signals) -> None:
    ender(tmp_path / "f.fmu", "STEPPING", "FOREVER")
    command = [sys.executable, "-m", "cosim", "run", "f.fmu", "--step", "0.1", "--stop", "1", "--out", "o"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as program:
        wait_for(lambda: (tmp_path / "forever").exists() or program.poll() is not None)
        program.send_signal(number)
        _, said = program.communicate(timeout=PATIENCE)
    assert program.returncode == -signal.SIGKILL
    assert said.startswith("cosim: component 'f' (f.fmu) was stuck in fmi2DoStep at t = 0.4 s: the run was told to end")
    assert said.count("\n") == 1
    assert list((tmp_path / "o").iterdir()) == []
