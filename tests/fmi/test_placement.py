"""FMUs on other machines compute what they compute here, and whatever they or their machines do, the run says it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import dask
import fmpy
import pytest

from cosim import Limits, Log, SetupError, Simulation, SimulationError, SimulationInterrupted, System, simulate
from cosim.__main__ import main
from cosim.commands.options import chosen_places
from cosim.pack import pack
from cosim.scenario import ScenarioError, load_scenario
from cosim.ssp import Experiment, read_ssp, write_ssp
from tests.support.c_fmus import ender, talker, tank
from tests.support.dask_cluster import Cluster
from tests.support.patience import PATIENCE, wait_for
from tests.support.small_fmus import compiled

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="FMUs are not isolated on Windows")


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A cluster with a worker that has a licence."""
    cluster = Cluster(tmp_path_factory.mktemp("nodes"))
    try:
        cluster.worker("--resources", "licence=1")
        yield cluster
    finally:
        cluster.close()


@pytest.fixture
def two_nodes(tmp_path: Path) -> Iterator[tuple[Cluster, list[subprocess.Popen[bytes]]]]:
    """A cluster with two workers, one on the left and one on the right, to do with as one likes."""
    cluster = Cluster(tmp_path)
    try:
        workers = [cluster.worker("--resources", f"{side}=1") for side in ("left", "right")]
        yield cluster, workers
    finally:
        cluster.close()


def one(fmu: Path, start: Any = None, place: str | None = "licence") -> System:
    system = System()
    system.add("m", fmu, start=start, place=place)
    return system


def fmus_of(cluster: Cluster) -> list[int]:
    """Processes of FMUs that the workers of a cluster have."""

    def children() -> list[int]:
        import psutil

        found = []
        for process in psutil.Process().children():
            with suppress(psutil.NoSuchProcess):  # it ends now
                found += [process.pid] if "worker.py" in " ".join(process.cmdline()) else []
        return found

    return [number for found in cluster.ask(children).values() for number in found]  # type: ignore[attr-defined]


def has_both(cluster: Cluster) -> bool:
    """Whether both workers are there; on a busy machine they take long to answer."""
    try:
        return len(cluster.ask(os.getpid)) == 2
    except OSError:
        return False


def test_the_numbers_are_those_of_a_run_here(tmp_path: Path, nodes: Cluster) -> None:
    fmu = compiled(tmp_path, "fmi3_types")
    start = {"Int8": [-128, 127], "UInt64": [0, 2**64 - 1], "words": ["", "ünïcode"], "Binary": b"\x00\xff" * 50_000}

    def system(place: str | None) -> System:
        made = one(fmu, start, place)
        made.drive("m.String", lambda t: f"at {t:.3f}" * int(1 + 9 * t))
        return made

    here = simulate(system(None), 1.0, 0.1)
    with Simulation(system("licence"), scheduler=nodes.address) as simulation:
        for _ in range(2):
            there = simulation.run(1.0, 0.1)
            assert there.values.tobytes() == here.values.tobytes()
            assert all(list(there[name]) == list(here[name]) for name in here.typed)
        assert there.info["fmus"]["m"]["place"] == "licence"
        with simulation.start(0.1) as run:
            run.step(5)
            state = run.save()
    with Simulation(system(None)) as simulation, simulation.start(0.1) as run:
        run.restore(state)
        run.step(5)
        assert run.results.values.tobytes() == here.values.tobytes()
    wait_for(lambda: not fmus_of(nodes))


def test_messages_come_when_they_are_said(tmp_path: Path, nodes: Cluster) -> None:
    logs = []
    for place in (None, "licence"):
        log = tmp_path / f"{place}.log"
        system = one(talker(tmp_path / "talker.fmu", version=2), place=place)
        simulate(system, 1.0, 0.1, log=Log("all", file=log), scheduler=place and nodes.address)
        logs.append(log.read_text())
    assert logs[0].count("\n") > 1
    assert logs[0] == logs[1]


def test_an_fmu_needs_no_library_for_the_machine_of_the_run(
    tmp_path: Path, nodes: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = tank(tmp_path / "tank.fmu")
    expected = simulate(one(fmu, {"u": 1.0}, place=None), 1.0, 0.1)
    monkeypatch.setattr(fmpy, "platform", "another")
    monkeypatch.setattr(fmpy, "platform_tuple", "another-one")
    with pytest.raises(SetupError, match="has no binary for another"):
        simulate(one(fmu, {"u": 1.0}, place=None), 1.0, 0.1)
    with dask.config.set({"scheduler-address": nodes.address}):
        assert simulate(one(fmu, {"u": 1.0}), 1.0, 0.1).values.tobytes() == expected.values.tobytes()


@pytest.mark.slow
def test_what_an_fmu_does_ends_its_process_only(tmp_path: Path, nodes: Cluster) -> None:
    with pytest.raises(SimulationError) as caught:
        simulate(one(ender(tmp_path / "f.fmu", "STEPPING", "EXIT_0")), 1.0, 0.1, scheduler=nodes.address)
    assert str(caught.value) == (
        "m failed at t = 0.4 s: its process on licence ended with exit code 0 in fmi2DoStep; it called exit(), which "
        "an FMU must not do; ask its supplier"
    )
    assert len(caught.value.results.time) == 5
    with pytest.raises(SetupError, match=r"^component 'm': .*f\.fmu can't be loaded: its process on licence was ended"):
        simulate(one(ender(tmp_path / "f.fmu", "LOADING", "SEGMENTATION")), 1.0, 0.1, scheduler=nodes.address)
    never = one(ender(tmp_path / "f.fmu", "STEPPING", "FOREVER"))
    with pytest.raises(SimulationError, match=r"^m failed at t = 0\.4 s: fmi2DoStep took longer than 5 s"):
        simulate(never, 1.0, 0.1, scheduler=nodes.address, limits=Limits(call_time=5.0))
    wait_for(lambda: not fmus_of(nodes))


def test_what_can_not_be_placed_is_refused(tmp_path: Path, nodes: Cluster) -> None:
    fmu = tank(tmp_path / "tank.fmu")
    with pytest.raises(SetupError, match=r"FMUs with a place need a scheduler.*give its address with --scheduler"):
        simulate(one(fmu), 1.0, 0.1)
    with pytest.raises(
        SetupError, match=r"^component 'm': tcp:.* has no worker at the address 'license', nor one with"
    ):
        simulate(one(fmu, place="license"), 1.0, 0.1, scheduler=nodes.address)
    with pytest.raises(SetupError, match=r"no component has a place there; give one its place \(--place\)"):
        simulate(one(fmu, place=None), 1.0, 0.1, scheduler=nodes.address)
    empty = fmu.with_name("no_library.fmu")
    empty.write_bytes(fmu.read_bytes().replace(b"binaries/", b"elsewhere"[:9]))
    with pytest.raises(SetupError, match=r"no_library\.fmu can't be run on licence: has no binary for"):
        simulate(one(empty), 1.0, 0.1, scheduler=nodes.address)
    with pytest.raises(SetupError, match="place = '' must be the address of a worker"):
        System().add("a", "a.fmu", place="")
    with pytest.raises(SetupError, match="component 'm' has a place, 'licence'; a packed FMU has"):
        pack(one(fmu), tmp_path / "packed.fmu", 0.1)
    for text in ("m", "=there", "m="):
        with pytest.raises(SetupError, match="write COMPONENT=PLACE"):
            chosen_places([text], ["m"])
    with pytest.raises(SetupError, match="there is no component 'x'; known are m"):
        chosen_places(["x=there"], ["m"])


def test_scenarios_and_ssps_say_places(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tank(tmp_path / "tank.fmu")
    toml = tmp_path / "tanks.toml"
    text = '[run]\nstop_time = 1\nstep_size = 0.5\n[components.a]\nfmu = "tank.fmu"\nplace = {}\n'
    toml.write_text(text.format('"licence"') + '[components.b]\nfmu = "tank.fmu"\n')
    system = load_scenario(str(toml)).system()
    assert {name: c.place for name, c in system.components.items()} == {"a": "licence", "b": None}
    system.connect("a.y", "b.u")
    write_ssp(tmp_path / "tanks.ssp", system, "tanks", Experiment(1.0, 0.5))
    read = read_ssp(tmp_path / "tanks.ssp", tmp_path / "unpacked").system
    assert {name: c.place for name, c in read.components.items()} == {"a": "licence", "b": None}
    assert not any(c.isolate for c in read.components.values())
    for scenario in (toml, tmp_path / "tanks.ssp"):
        assert main(["sweep", str(scenario), "--vary", "b.x=1,2", "--out", str(tmp_path / "o")]) == 1
        assert "component 'a' has a place, 'licence'; runs of a sweep have" in capsys.readouterr().err
    for wrong in ('""', "1"):
        toml.write_text(text.format(wrong))
        with pytest.raises(ScenarioError, match=r"components.a\] place"):
            load_scenario(str(toml))


# Two machines


@pytest.mark.slow
def test_components_on_two_machines(two_nodes: Any, tmp_path: Path) -> None:
    cluster, _ = two_nodes
    fmu = tank(tmp_path / "tank.fmu")

    def system(*places: str | None) -> System:
        made = System()
        made.add("a", fmu, start={"u": 1.0}, place=places[0])
        made.add("b", fmu, place=places[1])
        made.connect("a.y", "b.u")
        return made

    wait_for(lambda: has_both(cluster))
    expected = simulate(system(None, None), 1.0, 0.1)
    by_address = simulate(system(*cluster.ask(os.getpid)), 1.0, 0.1, scheduler=cluster.address, threads=2)
    for results in (simulate(system("left", "right"), 1.0, 0.1, scheduler=cluster.address), by_address):
        assert results.values.tobytes() == expected.values.tobytes()
    toml = tmp_path / "tanks.toml"
    toml.write_text(
        '[run]\nstop_time = 1\nstep_size = 0.1\n[components.a]\nfmu = "tank.fmu"\n[components.b]\nfmu = "tank.fmu"\n'
        'place = "right"\n[[connections]]\nfrom = "a.y"\nto = "b.u"\n[start]\na.u = 1.0\n'
    )
    options = ["--place", "a=left", "--scheduler", cluster.address, "--out", str(tmp_path / "o")]
    assert main(["run", str(toml), *options]) == 0
    assert '"place": "left"' in (tmp_path / "o/summary.json").read_text()


@pytest.mark.slow
def test_the_loss_of_a_machine_ends_the_run_with_what_was_recorded(two_nodes: Any, tmp_path: Path) -> None:
    cluster, workers = two_nodes
    wait_for(lambda: has_both(cluster))
    system = one(ender(tmp_path / "f.fmu", "STEPPING", "FOREVER"), place="right")
    system.add("tank", tank(tmp_path / "tank.fmu"), start={"u": 1.0}, place="left")

    def lose() -> None:
        wait_for((tmp_path / "forever").exists)
        workers[1].kill()

    with Simulation(system, scheduler=cluster.address) as simulation:
        thread = threading.Thread(target=lose)
        thread.start()
        with pytest.raises(SimulationError, match=r"^m failed at t = 0\.4 s: its host right was lost \(.*\)$"):
            simulation.run(1.0, 0.1)
        thread.join()


@pytest.mark.slow
def test_ctrl_c_and_the_end_of_the_run_end_what_is_elsewhere(two_nodes: Any, tmp_path: Path) -> None:
    cluster, _ = two_nodes
    wait_for(lambda: has_both(cluster))
    system = one(ender(tmp_path / "f.fmu", "STEPPING", "FOREVER"), place="right")

    def interrupt() -> None:
        wait_for((tmp_path / "forever").exists)
        os.kill(os.getpid(), signal.SIGINT)

    with Simulation(system, scheduler=cluster.address) as simulation:
        thread = threading.Thread(target=interrupt)
        thread.start()
        with pytest.raises(SimulationInterrupted, match=r"^interrupted at t = 0\.4 s$") as caught:
            simulation.run(1.0, 0.1)
        thread.join()
        assert len(caught.value.results.time) == 5
    wait_for(lambda: not fmus_of(cluster))
    (tmp_path / "forever").unlink()
    command = [sys.executable, "-m", "cosim", "run", "f.fmu", "--place", "f=left", "--scheduler", cluster.address]
    with subprocess.Popen([*command, "--out", "o"], cwd=tmp_path) as process:
        wait_for((tmp_path / "forever").exists)
        assert len(fmus_of(cluster)) == 1
        process.kill()
        process.wait(PATIENCE)
    wait_for(lambda: not fmus_of(cluster))
