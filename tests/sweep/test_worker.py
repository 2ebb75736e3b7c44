"""What a worker does with a batch: failures are rows, simulations stay open, and deadly points are found."""

from __future__ import annotations

import errno
import os
import pickle
import platform
import signal
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest

from cosim.loop.binding import LoopLibraryError
from cosim.master.simulation import Simulation
from cosim.scenario import Scenario, ScenarioComponent
from cosim.sweep import stock, worker
from cosim.sweep.batch import Batch, Rows
from cosim.sweep.errors import WorkerTrouble
from cosim.sweep.scenarios import scenario_study
from cosim.sweep.worker import run_batch, run_isolated
from cosim.versions import versions
from tests.support.c_fmus import ender
from tests.support.sweep_study import CounterStudy, build_counter, sha256

OWN = versions()["closed-chain-cosim"]


@pytest.fixture(scope="module")
def counter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_counter(tmp_path_factory.mktemp("counter"))


@pytest.fixture
def study(counter: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Makes this process a worker that has received the study and its FMU."""
    monkeypatch.setattr(stock, "_paths", {})
    monkeypatch.setattr(worker, "_studies", {})
    monkeypatch.setattr(tempfile, "tempdir", None)
    folder = tmp_path / "stock"
    stock.put(sha256(counter), counter.read_bytes(), folder)
    study = CounterStudy(sha256(counter))
    stock.put("the study", pickle.dumps(study), folder)
    yield study
    while worker._open:
        worker._open.popitem()[1].close()
    assert {p.name for p in folder.iterdir()} == {sha256(counter), "the study"}


def batch(**columns: list[float]) -> Batch:
    indices = list(range(100, 100 + len(next(iter(columns.values())))))
    return Batch("the study", OWN, indices, {f"counter.{name}": values for name, values in columns.items()})


def test_each_point_is_a_row(study):
    rows = run_batch(batch(rate=[1.0, 0.1, 0.3]))
    assert rows.indices == [100, 101, 102]
    assert rows.metrics == {"y": [1.0, pytest.approx(0.1), pytest.approx(0.3)]}
    assert rows.errors == [None, None, None]
    assert rows.seconds > 0.0


def test_a_run_that_fails_is_a_row_and_the_next_run_is_as_ever(study):
    alone = run_batch(batch(rate=[0.1])).metrics["y"]
    rows = run_batch(batch(rate=[4.0, 0.1, 4.0], limit=[1.0, 1.0, 1e9]))
    assert rows.metrics["y"] == [None, *alone, 4.0]
    assert rows.errors[0].startswith("counter failed at t = 0.25 s: ")
    assert "over the limit" in rows.errors[0]
    assert "\n" not in rows.errors[0]
    assert rows.errors[1:] == [None, None]


def test_a_point_that_can_not_be_set_is_a_row(study):
    rows = run_batch(batch(rate=[1.0], speed=[2.0]))
    assert rows.errors[0].startswith("component 'counter' has no variable 'speed'; ")


def test_a_bug_in_the_study_is_a_row_that_names_its_type(study, monkeypatch):
    monkeypatch.setattr(CounterStudy, "row", lambda self, planned, results: {"y": 1.0 / 0.0})
    assert run_batch(batch(rate=[1.0])).errors == ["ZeroDivisionError: float division by zero"]


def test_the_simulation_stays_open_for_all_batches_of_a_variant(study, monkeypatch):
    opened = []
    enter = Simulation.__enter__
    monkeypatch.setattr(Simulation, "__enter__", lambda self: opened.append(self) or enter(self))
    for _ in range(3):
        run_batch(batch(rate=[1.0, 2.0]))
    assert len(opened) == 1


def test_the_simulation_used_longest_ago_is_closed_when_there_are_too_many(study, monkeypatch):
    monkeypatch.setattr(worker, "_MOST_OPEN", 2)
    closed = []
    close = Simulation.close
    monkeypatch.setattr(Simulation, "close", lambda self: closed.append(self) or close(self))
    plain = CounterStudy.plan
    for number in (1.0, 2.0, 1.0, 3.0, 1.0):
        monkeypatch.setattr(CounterStudy, "plan", lambda s, p, n=number: replace(plain(s, p), variant=n))
        assert run_batch(batch(rate=[number])).metrics["y"] == [number]
    assert [key[1] for key in worker._open] == [3.0, 1.0]
    assert len(closed) == 1


# Workers that can't run anything


@pytest.mark.parametrize("run", [run_batch, run_isolated])
def test_another_version_is_trouble_of_the_worker(study, run):
    other = Batch("the study", "0.0.1", [1], {"counter.rate": [1.0]})
    with pytest.raises(WorkerTrouble, match=rf"has closed-chain-cosim {OWN}, the sweep comes from 0\.0\.1; install"):
        run(other)


def test_an_fmu_that_has_not_arrived_is_trouble_of_the_worker(study, monkeypatch):
    del stock._paths[study.fmu]
    with pytest.raises(WorkerTrouble, match=rf"file {study.fmu[:12]} has not arrived"):
        run_batch(batch(rate=[1.0]))


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EMFILE])
def test_a_full_disk_is_trouble_of_the_worker(study, monkeypatch, number):
    def full(self, member, path):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("zipfile.ZipFile.extract", full)
    with pytest.raises(WorkerTrouble, match=os.strerror(number)):
        run_batch(batch(rate=[1.0]))


def test_a_missing_stepping_loop_is_trouble_of_the_worker(study, monkeypatch):
    def missing() -> None:
        raise LoopLibraryError("the compiled loop is gone")

    monkeypatch.setattr("cosim.master.simulation.loop_library", missing)
    with pytest.raises(WorkerTrouble, match="the compiled loop is gone"):
        run_batch(batch(rate=[1.0]))


def test_an_archive_that_can_not_be_unpacked_is_a_row(study, monkeypatch):
    def damaged(self, member, path):
        raise ValueError("bad archive")

    monkeypatch.setattr("zipfile.ZipFile.extract", damaged)
    assert "bad archive" in run_batch(batch(rate=[1.0])).errors[0]


# Batches in which workers have died


def test_a_deadly_point_is_found_and_the_others_have_their_rows(study):
    rows = run_isolated(batch(rate=[1.0, 2.0, 3.0, 4.0], deadly=[0.0, 1.0, 0.0, 0.0], limit=[9.0, 9.0, 9.0, 0.5]))
    assert rows.indices == [100, 101, 102, 103]
    assert rows.metrics["y"] == [1.0, None, 3.0, None]
    assert [rows.errors[0], rows.errors[2]] == [None, None]
    assert "its process was ended (segmentation fault, SIGSEGV) in fmi2DoStep" in rows.errors[1]
    assert "over the limit" in rows.errors[3]


@pytest.mark.skipif(sys.platform != "linux", reason="the FMU is in C for Linux")
@pytest.mark.parametrize("how", ["EXIT_0", "END_0"])
def test_a_point_that_ends_its_process_as_if_all_was_well_is_an_error(tmp_path, monkeypatch, how):
    fmu = ender(tmp_path / "f.fmu", "STEPPING", how)
    made, files = scenario_study({"s": Scenario("s", "s", {"m": ScenarioComponent(fmu)}, 1.0, 0.1)})
    monkeypatch.setattr(stock, "_paths", {})
    monkeypatch.setattr(worker, "_studies", {})
    for sha, path in files.items():
        stock.put(sha, path.read_bytes(), tmp_path / "stock")
    stock.put("the study", pickle.dumps(made), tmp_path / "stock")
    rows = run_isolated(Batch("the study", OWN, [0, 1], {"seed": [1, 2]}))
    assert len(rows.errors) == 2
    assert all("its process ended with exit code 0 in fmi2DoStep; it called exit()" in e for e in rows.errors)


def test_rows_are_the_same_in_a_process_of_their_own(study):
    points = batch(rate=[0.1, 0.7, 4.0], limit=[1.0, 1.0, 1.0])
    here, there = run_batch(points), run_isolated(points)
    assert (here.indices, here.metrics, here.errors) == (there.indices, there.metrics, there.errors)
    assert there.seconds > 0.0


def test_a_point_is_run_again_whose_fmu_something_else_has_killed(study, monkeypatch):
    """As the kernel does that is short of memory: the point is not to blame."""
    real, killed = Simulation.run, []

    def killing(simulation, *arguments, **options):
        if len(killed) < 1:
            killed.append(1)
            os.kill(simulation._components.instances["counter"]._library._process.number, signal.SIGKILL)
        return real(simulation, *arguments, **options)

    monkeypatch.setattr(Simulation, "run", killing)
    rows = run_isolated(batch(rate=[1.0, 2.0]))
    assert killed
    assert (rows.metrics["y"], rows.errors) == ([1.0, 2.0], [None] * 2)


# What travels


def test_a_task_is_small_and_rows_too(study):
    """No FMU is in a task; 40 runs of the robot have about this many factors and metrics."""
    columns = {f"component.parameter{i}": [0.1 * k for k in range(40)] for i in range(3)}
    assert len(pickle.dumps(Batch("a" * 64, OWN, list(range(40)), columns))) < 3_000
    metrics: dict[str, list[float | None]] = {f"tracking.{i}": [0.3 * k for k in range(40)] for i in range(29)}
    assert len(pickle.dumps(Rows(list(range(40)), metrics, [None] * 40, 1.0))) < 15_000


def test_fmus_are_unpacked_where_dask_cleans_up(study):
    assert tempfile.gettempdir() == str(stock.path(study.fmu).parent)


# Memory

#: Page faults of a loop that allocates large arrays, as a worker does that runs one simulation after the other.
ALLOCATING = """
import resource, sys
import numpy as np
from cosim.sweep.worker import keep_memory

if sys.argv[1] == "keep":
    keep_memory()
for i in range(21):
    np.ones(1_000_000)  # 8 MB
    if not i:
        first = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - first) / 20)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's allocator is told anything")
def test_freed_memory_serves_the_next_run() -> None:
    def page_faults_a_run(what: str) -> float:
        command = [sys.executable, "-c", ALLOCATING, what]
        environment = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536"}  # what Dask's nanny sets
        return float(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)

    assert page_faults_a_run("keep") < 10
    assert page_faults_a_run("give back") > 100  # at least: pages may be large
