"""What belongs to the whole process stays as it is while FMUs are loaded and run, in whichever thread."""

from __future__ import annotations

import asyncio
import ctypes
import locale
import math
import os
import signal
import subprocess
import sys
import threading
import zipfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import pytest

from cosim import SetupError, Simulation, System, simulate
from cosim.fmi.process_kept import KeptProcess
from cosim.regression.run import run as run_alone
from cosim.regression.tolerances import Interface
from tests.support.c_fmus import ender, tank
from tests.support.patience import PATIENCE
from tests.support.regression_fmus import make_case
from tests.support.small_fmus import FLAVOURS, build
from tests.support.tiny_models import INTEGRATOR

RUNS = 60
EXPECTED = [float(n) for n in range(RUNS)]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("process")
    for flavour in FLAVOURS:
        build(folder / flavour, flavour, INTEGRATOR)
    return folder


@pytest.fixture
def here(fmus: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, from which FMUs have relative paths."""
    monkeypatch.chdir(fmus)
    return fmus


def integral(fmu: str, rate: float) -> float:
    """Of a constant over one second."""
    system = System()
    system.add("i", fmu, start={"u": rate})
    return float(simulate(system, 1.0, 0.125)["i.x"][-1])


def fmu_of(run: int) -> str:
    return f"{FLAVOURS[run % len(FLAVOURS)]}/Integrator.fmu"


def test_many_runs_in_threads(here: Path) -> None:
    with ThreadPoolExecutor(4) as pool:
        runs = [pool.submit(integral, fmu_of(n), float(n)) for n in range(RUNS)]
        assert [run.result(120) for run in runs] == pytest.approx(EXPECTED, rel=1e-12)


@pytest.mark.slow  # as those in threads
def test_many_runs_in_an_event_loop(here: Path) -> None:
    async def all_runs() -> list[float]:
        return await asyncio.gather(*(asyncio.to_thread(integral, fmu_of(n), float(n)) for n in range(RUNS)))

    assert asyncio.run(all_runs()) == pytest.approx(EXPECTED, rel=1e-12)


@pytest.mark.slow
def test_many_runs_in_a_pool_of_processes(here: Path) -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        runs = [pool.submit(integral, fmu_of(n), float(n)) for n in range(RUNS)]
        assert [run.result(120) for run in runs] == pytest.approx(EXPECTED, rel=1e-12)


@contextmanager
def watched(folder: Path) -> Iterator[None]:
    """Another thread creates files by relative names and looks up the working folder; all of them are in `folder`."""
    done, seen, names = threading.Event(), set(), []

    def write() -> None:
        while not done.wait(1e-4):
            seen.add(Path.cwd())
            names.append(f"file {len(names)}")
            Path(names[-1]).touch()

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join(60)
    assert seen == {folder}
    assert names
    assert {file.name for file in folder.iterdir()} == set(names)


@pytest.mark.parametrize("flavour", ["pythonfmu", *(pytest.param(f, marks=pytest.mark.slow) for f in ("fmi2", "fmi3"))])
def test_another_thread_stays_in_its_folder(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flavour: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with watched(tmp_path):
        for n in range(20):
            assert integral(str(fmus / flavour / "Integrator.fmu"), float(n)) == pytest.approx(n, rel=1e-12)


@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
def test_another_thread_stays_in_its_folder_during_a_regression(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flavour: str, interface: Interface
) -> None:
    """FMPy's solver runs model exchange."""
    monkeypatch.chdir(tmp_path)
    case = make_case(
        tmp_path / "cases", "Integrator", toml="start.u = 2.0", opt="StartTime, 0\nStopTime, 1\nStepSize, 0.125\n"
    )
    (here := tmp_path / "here").mkdir()
    monkeypatch.chdir(here)
    with watched(here):
        for _ in range(5):
            results = run_alone(case, fmus / flavour / "Integrator.fmu", interface)
            assert results["x"][-1] == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_an_fmu_that_cannot_be_made_leaves_the_process_as_it_was(fmus: Path, tmp_path: Path, flavour: str) -> None:
    """Neither a run nor a failure to load changes working folder, environment, locale or signal handlers."""

    def process() -> tuple[object, ...]:
        handlers = [signal.getsignal(number) for number in sorted(signal.valid_signals())]
        return Path.cwd(), dict(os.environ), locale.setlocale(locale.LC_ALL), handlers

    fmu = fmus / flavour / "Integrator.fmu"
    before = process()
    assert integral(str(fmu), 1.0) == pytest.approx(1.0, rel=1e-12)
    assert process() == before
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(tmp_path / "broken.fmu", "w") as new:
        for name in old.namelist():
            new.writestr(name, b"no library" if name.startswith("binaries/") else old.read(name))
    with pytest.raises(SetupError, match=r"component 'i': .*broken\.fmu: can't be loaded"):
        integral(str(tmp_path / "broken.fmu"), 1.0)
    assert process() == before


def test_what_an_fmu_changes_of_the_process_is_so_in_its_calls_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The FMU goes to another folder, and finds itself there again; it changes locale, rounding and two signals."""

    def process() -> tuple[object, ...]:
        handlers = []
        for number in (signal.SIGINT, signal.SIGTERM):
            ctypes.CDLL(None).sigaction(number, None, action := (ctypes.c_void_p * 32)())
            handlers.append(action[0])
        rounding = one + math.ulp(1.0) / 4 == 1.0
        return Path.cwd(), locale.setlocale(locale.LC_ALL), handlers, rounding

    one = 1.0
    monkeypatch.chdir(tmp_path)
    tank(tmp_path / "meddler.fmu", "MEDDLES", options=("-lm",))
    before = process()
    assert before[-1]
    system = System()
    system.add("t", "meddler.fmu", start={"u": 1.0})
    with Simulation(system) as simulation:
        assert process() == before
        for _ in range(2):
            assert simulation.run(1.0, 0.5)["t.y"][-1] == 1.0
            assert process() == before
        with simulation.start(0.5) as stepped:
            assert process() == before
            stepped.step()
    assert process() == before


@pytest.mark.skipif(sys.platform == "win32", reason="there FMUs can't set what signals do")
def test_what_a_program_has_a_signal_do_during_a_run_stays() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        with KeptProcess().while_fmus_are_called():
            signal.signal(signal.SIGHUP, signal.SIG_IGN)
        ctypes.CDLL(None).sigaction(signal.SIGHUP, None, action := (ctypes.c_void_p * 32)())
        assert action[0] == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.skipif(sys.platform == "win32", reason="the FMU is one for POSIX")
def test_standard_streams_that_are_closed_are_open_again() -> None:
    code = """
import os
from cosim.fmi.process_kept import KeptProcess
from cosim.fmi.process_kept import KeptProcess
with KeptProcess().while_fmus_are_called():
    os.closerange(0, 3)
    assert os.open(os.devnull, os.O_RDONLY) == 0
os.write(1, b"out"), os.write(2, b"err")
try: os.fstat(3)
except OSError: print("no more files", flush=True)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "outno more files\n", "err")


@pytest.mark.slow
@pytest.mark.parametrize("where", ["LOADING", "GETTING", "STEPPING", "UNLOADING"])
@pytest.mark.skipif(sys.platform == "win32", reason="the FMU is one for POSIX")
def test_standard_streams_that_an_fmu_closes_are_open_again(tmp_path: Path, where: str) -> None:
    """And no file that is opened in their place gets what the FMU writes."""
    ender(tmp_path / "f.fmu", where, "CLOSING")
    command = [sys.executable, "-m", "cosim", "run", "f.fmu", "--step", "0.1", "--stop", "1", "--out", "o"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "results, summary and figures: o"
    assert len((tmp_path / "o/results.csv").read_text().splitlines()) == 12
