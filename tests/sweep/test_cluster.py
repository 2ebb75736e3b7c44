"""Sweeps on a real scheduler and workers, each a process of its own; some of them die."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import dask
import psutil
import pytest
from distributed import Client
from distributed.security import Security

import cosim.sweep.cluster
from cosim import Simulation
from cosim.sweep import engine
from cosim.sweep.batch import Rows
from cosim.sweep.cluster import connect
from cosim.sweep.engine import sweep
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Levels, Points, Range, design
from cosim.sweep.store import read
from cosim.versions import versions
from parallel_robot.scenario import load_scenario
from parallel_robot.sweep import METRICS, robot_study
from tests.support import some
from tests.support.dask_cluster import Cluster
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.patience import PATIENCE, wait_for
from tests.support.sweep_study import CounterStudy, arrivals, build_counter, process, sha256

#: Simulated time (s) of a run, disturbed at its end; less where only slow FMUs can be built.
STOP_TIME = 0.2 if DEFAULT_FLAVOUR == "pythonfmu" else 5.0


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler without workers, to do with as one likes."""
    started = Cluster(tmp_path)
    try:
        yield started
    finally:
        started.close()


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a scheduler with one worker that stay alive."""
    started = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        started.worker()
        yield started.address
    finally:
        started.close()


@pytest.fixture(scope="module")
def counter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_counter(tmp_path_factory.mktemp("counter"))


def counter_points(n: int, deadly: tuple[int, ...] = ()) -> Points:
    """Rates 0, 1, 2, ..., some of which take the process down."""
    levels = [1 if i in deadly else 0 for i in range(n)]
    rates = design("grid", [Levels("counter.rate", tuple(map(float, range(n))))]).columns[0]
    factors = (Levels("counter.rate", tuple(map(float, range(n)))), Levels("counter.deadly", (0.0, 1.0)))
    return Points(factors, (rates, rates * 0 + levels))


@pytest.mark.slow
def test_a_worker_is_killed_half_way_and_all_rows_are_those_of_a_plain_loop(cluster, robot_fmus, tmp_path):
    """On top: FMUs travel once to each worker, also to one that comes later, and not again for the next sweep."""
    scenario = dataclasses.replace(load_scenario("tracking"), stop_time=STOP_TIME)
    study, files = robot_study({"tracking": scenario}, robot_fmus, [DEFAULT_FLAVOUR])
    factors = [Range("controller.alpha", 0.5, 3.0), Range("controller.beta", 1.0, 2.0)]
    points = design("sobol", factors, 48, seed=1)
    first, _ = cluster.worker(), cluster.worker()
    wait_for(lambda: len(cluster.ask(process)) == 2)
    address = next(address for address, number in cluster.ask(process).items() if number == first.pid)
    died_at: list[int] = []

    with Client(cluster.address, set_as_default=False) as client:

        def kill_half_way(done: int, workers: int) -> None:
            if not died_at and done >= 16 and client.processing()[address]:  # in the middle of a batch
                first.send_signal(signal.SIGKILL)
                first.wait()
                died_at.append(done)
                cluster.worker()

        summary = sweep(study, files, points, tmp_path / "out", scheduler=cluster.address, progress=kill_half_way)
    assert 16 <= died_at[0] < 48
    assert first.returncode == -signal.SIGKILL
    assert (summary.done, summary.failed, summary.runs) == (48, 0, 48)

    table = read(tmp_path / "out")
    assert table["index"].to_pylist() == list(range(48))
    with Simulation(scenario.system(robot_fmus, DEFAULT_FLAVOUR)) as simulation:
        for row in table.to_pylist():
            start = {f.name: row[f.name] for f in factors}
            results = simulation.run(scenario.stop_time, scenario.step_size, start=start)
            expected = study.row(study.plan(start), results)
            assert {n: row[n] for n in METRICS[:-1]} == {n: expected[n] for n in METRICS[:-1]}

    wait_for(lambda: len(cluster.ask(process)) == 2)
    for counts in some(cluster.ask(arrivals).values()):
        assert set(counts) >= set(files)
        assert len(counts) == len(files) + 1  # and the study
        assert set(counts.values()) == {1}
    held = dataclasses.replace(scenario, extrapolation="hold")
    other, _ = robot_study({"tracking": held}, robot_fmus, [DEFAULT_FLAVOUR])
    sweep(other, files, design("sobol", factors, 2), tmp_path / "other", scheduler=cluster.address)
    for counts in some(cluster.ask(arrivals).values()):
        assert len(counts) == len(files) + 2
        assert set(counts.values()) == {1}


@pytest.mark.slow
def test_a_deadly_point_is_a_row_and_the_others_have_theirs(counter, tmp_path):
    """On this machine's own workers, which Dask starts again."""
    study = CounterStudy(sha256(counter))
    files = {study.fmu: counter}
    hosts: set[str] = set()

    def look(done: int, workers: int) -> None:
        if not hosts and workers:
            hosts.update(listening())

    summary = sweep(study, files, counter_points(12, deadly=(5,)), tmp_path / "out", workers=2, progress=look)
    assert hosts == {"127.0.0.1"}
    table = read(tmp_path / "out")
    assert table["y"].to_pylist() == [float(i) if i != 5 else None for i in range(12)]
    errors = table["error"].to_pylist()
    ended = "counter failed at t = 0 s: its process was ended (segmentation fault, SIGSEGV) in fmi2DoStep"
    assert errors.pop(5).startswith(ended)
    assert errors == [None] * 11
    assert summary.first_error.startswith(f"point 5: {ended}")
    assert (summary.done, summary.failed, summary.workers) == (12, 1, 2)


def test_a_sweep_that_was_interrupted_runs_only_what_is_missing(address, counter, tmp_path):
    study = CounterStudy(sha256(counter), stop_time=200.0)
    files, points, folder = {study.fmu: counter}, counter_points(40), tmp_path / "out"

    def interrupt(done: int, workers: int) -> None:
        if done >= 3:
            os.kill(os.getpid(), signal.SIGINT)

    first = sweep(study, files, points, folder, scheduler=address, progress=interrupt)
    assert first.interrupted
    assert 3 <= first.runs == first.done < 40
    parts = {path: path.read_bytes() for path in (folder / "results").iterdir()}
    second = sweep(study, files, points, folder, scheduler=address)
    assert not second.interrupted
    assert (second.runs, second.done) == (40 - first.runs, 40)
    assert {path: path.read_bytes() for path in parts} == parts
    assert read(folder)["y"].to_pylist() == [200.0 * i for i in range(40)]
    third = sweep(study, files, points, folder, scheduler="tcp://127.0.0.1:1")  # nothing is missing: nobody is asked
    assert (third.runs, third.done) == (0, 40)
    with Client(address, set_as_default=False) as client:  # nothing was left behind
        wait_for(lambda: not any(client.processing().values()))
    with pytest.raises(SweepError, match=r"holds another sweep \(other stop_time\)"):
        sweep(CounterStudy(study.fmu, stop_time=1.0), files, points, folder)


def test_another_version_on_a_worker_is_one_line(address, counter, tmp_path, monkeypatch):
    study = CounterStudy(sha256(counter))
    own = versions()["closed-chain-cosim"]
    monkeypatch.setattr(cosim.sweep.cluster, "versions", lambda: {"closed-chain-cosim": "0.0.1"})
    with pytest.raises(SweepError) as error:
        sweep(study, {study.fmu: counter}, counter_points(4), tmp_path / "out", scheduler=address)
    assert f"has closed-chain-cosim {own}, here it is 0.0.1; install the same version there" in str(error.value)
    assert "worker tcp://127.0.0.1:" in str(error.value)
    # a worker that joins later is not asked: its first task tells
    monkeypatch.setattr(cosim.sweep.cluster, "_check_versions", lambda client: None)
    monkeypatch.setattr("cosim.sweep.engine.versions", lambda: {"closed-chain-cosim": "0.0.1"})
    with pytest.raises(SweepError) as error:
        sweep(study, {study.fmu: counter}, counter_points(4), tmp_path / "other", scheduler=address)
    assert f"has closed-chain-cosim {own}, the sweep comes from 0.0.1; install the same" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_has_no_workers_or_dies_is_one_line(cluster, counter, tmp_path, monkeypatch):
    study = CounterStudy(sha256(counter), stop_time=200.0)
    files, points = {study.fmu: counter}, counter_points(400)

    def refused(scheduler: str, **options) -> str:
        with pytest.raises(SweepError) as error:
            sweep(study, files, points, tmp_path / "out", scheduler=scheduler, **options)
        assert "\n" not in str(error.value)
        return str(error.value)

    with monkeypatch.context() as impatient:
        impatient.setattr(cosim.cluster, "_ANSWER", 0.5)
        assert refused("tcp://127.0.0.1:1").startswith("--scheduler tcp://127.0.0.1:1: no answer: ")
        assert refused("nonsense://").startswith("--scheduler nonsense://: no answer: ")
    assert "leave out --workers or --scheduler" in refused(cluster.address, workers=2)
    monkeypatch.setattr(cosim.cluster, "_FIRST_WORKER", 0.5)
    assert refused(cluster.address).endswith(f"has no workers; start some: dask worker {cluster.address} --nthreads 1")

    cluster.worker()
    with Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(1, timeout=PATIENCE)

    def kill(done: int, workers: int) -> None:
        if done >= 3:
            cluster.scheduler.kill()
            monkeypatch.setitem(dask.config.config["distributed"]["comm"]["timeouts"], "connect", "1s")

    text = refused(cluster.address, progress=kill)
    assert text.startswith("the scheduler ")
    assert text.endswith("start the same command again: it goes on where it stopped")
    assert read(tmp_path / "out").num_rows >= 3


def certificates(folder: Path) -> dict[str, dict[str, str]]:
    """Settings of Dask's TLS, with certificates that are made for it, for client, scheduler and workers."""
    made, folder = Security.temporary(), folder / "tls"
    folder.mkdir(parents=True)
    found: dict[str, dict[str, str]] = {}
    (folder / "ca.pem").write_text(made.tls_ca_file)
    for role in ("client", "scheduler", "worker"):
        found[role] = {}
        for what in ("cert", "key"):
            path = folder / f"{role}-{what}.pem"
            path.write_text(getattr(made, f"tls_{role}_{what}"))
            found[role][what] = str(path)
    return found


def tls(certificates: dict[str, dict[str, str]], ca_file: str | None) -> dask.config.set:
    """Context in which this process has certificates."""
    settings = {f"distributed.comm.tls.{r}.{w}": p for r, pair in certificates.items() for w, p in pair.items()}
    return dask.config.set({"distributed.comm.tls.ca-file": ca_file, **settings})


@pytest.mark.slow
def test_a_cluster_with_tls_takes_who_has_its_certificates_and_nobody_else(counter, tmp_path, monkeypatch):
    """As docs/sweeps.md has it."""
    monkeypatch.setattr(cosim.cluster, "_ANSWER", 5.0)
    study = CounterStudy(sha256(counter))
    files, points = {study.fmu: counter}, counter_points(4)
    own, others = certificates(tmp_path / "own"), certificates(tmp_path / "others")
    ca = {name: str(tmp_path / name / "tls/ca.pem") for name in ("own", "others")}
    settings = {
        f"DASK_DISTRIBUTED__COMM__TLS__{role.upper()}__{what.upper()}": path
        for role, pair in own.items()
        for what, path in pair.items()
    }
    settings |= {
        "DASK_DISTRIBUTED__COMM__TLS__CA_FILE": ca["own"],
        "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true",
    }
    cluster = Cluster(tmp_path, **settings)
    try:
        assert cluster.address.startswith("tls://127.0.0.1:")
        cluster.worker()
        for config, ca_file in (({}, None), (others, ca["others"]), (own, ca["others"]), (others, ca["own"])):
            address = cluster.address if config else cluster.address.replace("tls:", "tcp:")
            with tls(config, ca_file), pytest.raises(SweepError, match="no answer") as refused:
                sweep(study, files, points, tmp_path / "out", scheduler=address)
            assert "\n" not in str(refused.value)
        with tls(own, ca["own"]):
            summary = sweep(study, files, points, tmp_path / "out", scheduler=cluster.address)
        assert (summary.done, summary.failed) == (4, 0)
    finally:
        cluster.close()


def listening() -> set[str]:
    """Addresses at which this process and those that it has started listen."""
    here = psutil.Process()
    found = [c for p in (here, *here.children(recursive=True)) for c in p.net_connections("inet")]
    return {c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN}


@pytest.mark.slow
def test_the_last_worker_that_ends_as_if_all_was_well_is_noticed(cluster, counter, tmp_path):
    study = CounterStudy(sha256(counter), stop_time=4000.0)
    files, points, warned = {study.fmu: counter}, counter_points(400), []
    first, second = cluster.worker(), cluster.worker()
    wait_for(lambda: len(cluster.ask(process)) == 2)

    def end(done: int, workers: int) -> None:
        if done >= 3:
            first.kill()
        if warned and second.poll() is None:
            with suppress(OSError), Client(cluster.address, set_as_default=False) as client:
                client.run(os._exit, 0)
            second.wait(PATIENCE)

    with pytest.raises(SweepError, match="no workers are left; start the same command again: it goes on where it st"):
        sweep(study, files, points, tmp_path / "out", scheduler=cluster.address, progress=end, warn=warned.append)
    assert second.returncode == 0
    assert warned == ["1 of 2 workers have ended; the sweep goes on with 1"]
    assert 3 <= read(tmp_path / "out").num_rows < 400


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


def watch(monkeypatch: pytest.MonkeyPatch, *, starting: bool = False) -> tuple[engine._Watch, Clock]:
    """A watch of a cluster where processes start that will be workers, or don't."""
    clock = Clock()
    monkeypatch.setattr(engine, "clock", clock)
    nanny = SimpleNamespace(pid=1 if starting else None)
    client = SimpleNamespace(cluster=SimpleNamespace(workers={0: nanny}))
    return engine._Watch(client), clock


@pytest.mark.parametrize(("starting", "patience"), [(False, 6.0), (True, 120.0)])
def test_workers_that_are_gone_are_said_and_waited_for_while_others_start(monkeypatch, starting, patience):
    watched, clock = watch(monkeypatch, starting=starting)
    for _ in range(50):  # fewer for a while are no reason to worry
        for workers in (4, 3, 0, 4):
            assert list(watched.lines(workers)) == []
            clock.now += 0.4
    assert list(watched.lines(3)) == []
    clock.now += patience - 0.1
    assert list(watched.lines(3)) == []
    clock.now += 0.2
    assert list(watched.lines(3)) == ["1 of 4 workers have ended; the sweep goes on with 3"]
    clock.now += 1000.0
    assert list(watched.lines(3)) == []
    assert list(watched.lines(0)) == []
    clock.now += patience + 0.1
    with pytest.raises(SweepError, match="no workers are left"):
        list(watched.lines(0))


def test_runs_that_all_fail_are_said_once(monkeypatch):
    watched, clock = watch(monkeypatch)
    failed = Rows([7, 8], {}, ["too hot", "too cold"])
    watched.learn(failed)
    assert list(watched.lines(1)) == []
    clock.now += 6.1
    assert list(watched.lines(1)) == ["all 2 runs so far have failed; the first: point 7: too hot"]
    watched.learn(failed)
    assert list(watched.lines(1)) == []


def test_runs_of_which_one_succeeds_are_not(monkeypatch):
    watched, clock = watch(monkeypatch)
    watched.learn(Rows([7, 8], {}, [None, "too cold"]))
    clock.now += 6.1
    assert list(watched.lines(1)) == []


def test_no_workers_is_one_line(counter, tmp_path):
    study = CounterStudy(sha256(counter))
    with pytest.raises(SweepError, match="0 workers can't run anything"):
        sweep(study, {study.fmu: counter}, counter_points(4), tmp_path / "out", workers=0)


def test_workers_that_do_not_start_in_time_are_one_line(monkeypatch):
    def late(workers: int) -> None:
        raise TimeoutError

    monkeypatch.setattr("cosim.sweep.cluster._local", late)
    with pytest.raises(SweepError, match=r"did not start in time, .* \(--workers\)$"), connect(workers=2):
        pass


@pytest.mark.slow
def test_an_fmu_that_changes_under_way_is_one_line(address, counter, tmp_path):
    study = CounterStudy("0" * 64)
    with pytest.raises(SweepError, match=r"Counter\.fmu has changed in between"):
        sweep(study, {study.fmu: counter}, counter_points(4), tmp_path / "out", scheduler=address)
