"""Isolated FMUs compute what they compute in this process, and whatever they do ends no more than the run."""

from __future__ import annotations

import functools
import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Log, Results, SetupError, Simulation, SimulationError, SimulationInterrupted, System, simulate
from cosim.__main__ import command_line
from cosim.commands.options import IsolationOptions, take_from_isolated
from cosim.fmi.isolation.limits import Limits, parse_bytes
from cosim.fmi.isolation.process import WorkerProcess
from cosim.loop.channel import channel_library, functions
from cosim.scenario import ScenarioError, load_scenario
from cosim.ssp import Experiment, read_ssp, write_ssp
from parallel_robot.scenario import load_scenario as load_robot_scenario
from tests.support.c_fmus import ender, talker, tank
from tests.support.corpus import Materials
from tests.support.corpus.case import DESCRIPTION_2, fmu_2
from tests.support.fmi1_fmu import build_fmi1_tank
from tests.support.fmi3_events import clocks, state_space
from tests.support.hybrid_models import THERMOSTAT
from tests.support.patience import PATIENCE, wait_for
from tests.support.quirks import Quirk, quirky
from tests.support.small_fmus import build, compiled
from tests.support.tiny_models import INTEGRATOR

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="FMUs are not isolated on Windows")


def children(parent: int | str = "self") -> set[int]:
    """Processes of this one that are there, but for those that have ended."""
    found = set()
    for folder in Path(f"/proc/{parent}/task").iterdir():
        with suppress(FileNotFoundError):  # a thread that has ended
            found |= {int(text) for text in (folder / "children").read_text().split()}
    return {number for number in found if is_there(number)}


def is_there(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.fixture(autouse=True)
def nothing_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)  # where an FMU tells that it has begun never to return
    before = children()
    yield
    wait_for(lambda: children() <= before)


def one(fmu: Path, start: Mapping[str, Any] | None = None, **signals: Callable[[float], Any]) -> System:
    system = System()
    system.add("m", fmu, start=start)
    for name, function in signals.items():
        system.drive(f"m.{name}", function)
    return system


def round_trips(simulation: Simulation) -> dict[str, int]:
    """How often each isolated FMU has been asked for something."""
    return {
        name: int.from_bytes(instance._library._process.memory[:4], sys.byteorder)
        for name, instance in simulation._components.instances.items()
    }


# The same numbers, by the same calls


def facts(results: Results) -> Any:
    """All that a run gives, but for what tells of isolation."""
    typed = {name: list(results[name]) for name in results.typed}
    info = {key: results.info.get(key) for key in ("status", "warnings", "messages", "extrapolation", "ended_by")}
    return results.names, results.values.tobytes(), typed, info


def both(system: System, **options: Any) -> Results:
    """The results of a system, which are the same in this process and in another."""
    here, there = (simulate(system, 1.0, 0.1, isolate=isolate, **options) for isolate in (False, True))
    assert "isolated" not in here.info["fmus"]["m"]
    assert there.info["fmus"]["m"]["isolated"]
    assert facts(here) == facts(there)
    return there


def test_fmi1(tmp_path: Path) -> None:
    fmu = build_fmi1_tank(tmp_path / "tank.fmu")
    both(one(fmu, {"text": "héllo", "x_start": 0.25}, u=lambda t: t, n=lambda t: int(9 * t), b=lambda t: t > 0.5))


def test_fmi2(tmp_path: Path) -> None:
    fmu = compiled(tmp_path, "fmi2_probe")
    both(one(fmu, u=lambda t: t**2, n=lambda t: int(9 * t), e=lambda _: 2, b=lambda t: t > 0.5))


def test_all_types_of_fmi3(tmp_path: Path) -> None:
    fmu = compiled(tmp_path, "fmi3_types")
    start = {"Int8": [-128, 127], "UInt64": [0, 2**64 - 1], "Float32": [1.5, -0.25], "Boolean": [True, False]}
    words = {"words": ["", "ünïcode"], "Binary": b"\x00\x01\xff" * 99}
    results = both(one(fmu, {**start, **words}, String=lambda t: f"at {t:.3f}" * int(1 + 9 * t)))
    assert results["m.Binary_out"][-1] == b"\x00\x01\xff" * 99


def test_inputs_that_an_fmu_asks_for_during_a_step(tmp_path: Path) -> None:
    system = one(build(tmp_path, "fmi3", INTEGRATOR) / f"{INTEGRATOR.name}.fmu", u=lambda t: t**2)
    system.add("next", system.components["m"].fmu or "")
    system.connect("m.x", "next.u")
    results = both(system, extrapolation="linear")
    assert results.info["extrapolation"]["linear"] == ["m.u", "next.u"]


def test_derivatives_of_inputs_that_an_fmu_refuses_are_said_with_the_remedy(tmp_path: Path) -> None:
    """They reach it together with the step."""
    system = one(quirky(tmp_path, Quirk.REFUSES_DERIVATIVES), u=lambda t: t)
    said = []
    for isolate in (False, True):
        with pytest.raises(SimulationError) as failed:
            simulate(system, 1.0, 0.1, extrapolation="linear", isolate=isolate)
        said.append(str(failed.value))
        assert simulate(system, 1.0, 0.1, isolate=isolate).info["derivatives_refused"].keys() == {"m"}
    assert said[0] == said[1]
    assert "fmi2SetRealInputDerivatives returned error, though it says" in said[0]
    assert "use extrapolation='hold'" in said[0]


# Model exchange


@pytest.fixture(scope="module")
def exchanging(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], System]:
    """A thermostat, which has events, with an integrator of its temperature, in model exchange; by flavour."""

    @functools.cache
    def fmus(flavour: Any) -> tuple[Path, Path]:
        folder = tmp_path_factory.mktemp(flavour)
        return tuple(build(folder, flavour, of) / f"{of.name}.fmu" for of in (THERMOSTAT, INTEGRATOR))  # type: ignore

    def system(flavour: str) -> System:
        thermostat, integrator = fmus(flavour)
        made = System()
        made.add("m", thermostat, {"tau": 0.5, "rate": 60.0}, interface="model-exchange")
        made.add("sum", integrator, interface="model-exchange")
        made.connect("m.T", "sum.u", units="ignore")
        made.drive("m.ambient", lambda t: 10.0 + t)
        return made

    return system


@pytest.mark.parametrize("flavour", ["fmi2", pytest.param("fmi3", marks=pytest.mark.slow)])
def test_model_exchange(exchanging: Callable[[str], System], flavour: str) -> None:
    """Stages, event indicators and resets: the same numbers as in this process, with each solver."""
    system = exchanging(flavour)
    for solver in ("rk4", "dopri5", "cvode"):
        results = both(system, solver=solver)
        assert results.info["model_exchange"]["solver"] == solver
        assert set(results["m.on"]) == {0.0, 1.0}
    system.components["sum"] = replace(system.components["sum"], isolate=True)  # the other one in this process
    assert facts(simulate(system, 1.0, 0.1)) == facts(simulate(exchanging(flavour), 1.0, 0.1))


def test_a_process_that_ends_in_model_exchange_ends_the_run_with_its_name(
    exchanging: Callable[[str], System],
) -> None:
    system, before = exchanging("fmi2"), children()

    def kill(t: float) -> float:
        if t > 0.45:
            for process in children() - before:
                with suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
        return 0.0

    system.components["m"] = replace(system.components["m"], isolate=True)
    system.add_function("killer", kill, outputs=["y"])
    with pytest.raises(SimulationError, match=r"SIGKILL|signal 9|[Kk]illed") as failed:
        simulate(system, 1.0, 0.1)
    assert failed.value.component == "m"
    assert failed.value.results is not None
    assert len(failed.value.results.time) >= 4


def test_clocks_and_events(tmp_path: Path) -> None:
    both(one(clocks(tmp_path), {"delay": 0.2, "period": 0.3}, trigger=lambda t: t > 0.5, u=lambda t: t))


def test_structural_parameters_and_arrays(tmp_path: Path) -> None:
    both(one(state_space(tmp_path), {"m": 2, "n": 2, "r": 2, "A": [0.0, 1.0, -1.0, 0.0], "x0": [1.0, 0.0]}))


@pytest.mark.parametrize("version", [2, 3])
def test_messages_come_when_they_are_said(tmp_path: Path, version: int) -> None:
    logs = []
    for isolate in (False, True):
        log = tmp_path / f"{isolate}.log"
        system = one(talker(tmp_path / "talker.fmu", version=version))
        simulate(system, 1.0, 0.1, log=Log("all", file=log), isolate=isolate)
        logs.append(log.read_text())
    assert logs[0].count("\n") > 1
    assert logs[0] == logs[1]


def test_a_state_goes_back_and_to_an_fmu_in_this_process(tmp_path: Path) -> None:
    system = one(compiled(tmp_path, "fmi3_types"), String=lambda t: f"{t:.2f}")
    whole = simulate(system, 1.0, 0.1)
    with Simulation(system, isolate=True) as there, there.start(0.1) as run:
        run.step(5)
        state = run.save()
        run.step(3)
        run.restore(state)
        run.step(5)
        assert run.results.values.tobytes() == whole.values.tobytes()
    with Simulation(system) as here, here.start(0.1) as run:
        run.restore(state)
        run.step(5)
        assert run.results.values.tobytes() == whole.values.tobytes()


def test_an_fmu_gets_the_same_calls_in_the_same_order(tmp_path: Path) -> None:
    fmu = compiled(tmp_path, "fmi2_probe")
    journals = []
    for isolate in (False, True):
        journal = tmp_path / f"{isolate}.txt"
        simulate(one(fmu, {"journal": str(journal)}, u=lambda t: t), 1.0, 0.1, isolate=isolate)
        journals.append(journal.read_text())
    assert len(journals[0]) > 100
    assert journals[0] == journals[1]


@pytest.mark.parametrize("flavour", ["fmi2", "fmi3"])
def test_what_is_read_after_a_call_goes_over_with_it(native_fmus: Path, flavour: str) -> None:
    system = load_robot_scenario("tracking").system(native_fmus, flavour)
    here = simulate(system, 0.1, 1e-3)
    with Simulation(system, isolate=True) as simulation:
        before = round_trips(simulation)
        there = simulation.run(0.1, 1e-3)
        after = round_trips(simulation)
    assert here.info["extrapolation"]["adaptive"]
    assert there.values.tobytes() == here.values.tobytes()
    # A step with what is read then; inputs, what follows from them, and its derivatives; and those of the controller by
    # its inputs, whose rates are known last.
    of_a_step = {name: (after[name] - before[name]) // 100 for name in after}
    assert of_a_step == {"plant": 2, "controller": 3, "trajectory": 1}


def test_components_may_be_isolated_one_by_one_and_at_the_same_time(tmp_path: Path) -> None:
    fmu = tank(tmp_path / "tank.fmu", attributes='canBeInstantiatedOnlyOncePerProcess="true"')

    def rows(isolate: Any, **options: Any) -> tuple[bytes, set[str]]:
        system = System()
        for name in "abc":
            system.add(name, fmu, start={"u": 1.0} if name == "a" else None, isolate=name == "b")
        system.connect("a.y", "b.u")
        system.connect("b.y", "c.u")
        results = simulate(system, 1.0, 0.1, isolate=isolate, **options)
        return results.values.tobytes(), {n for n, fmu in results.info["fmus"].items() if "isolated" in fmu}

    values, isolated = rows(False)
    # `c` is the second instance of an FMU that allows one in a process
    assert isolated == {"b", "c"}
    assert rows(True) == (values, {"a", "b", "c"})
    assert rows(["c"], threads=2) == (values, {"b", "c"})


def test_runs_after_the_first_one_and_threads(tmp_path: Path) -> None:
    system = one(tank(tmp_path / "tank.fmu"), {"u": 1.0})
    with Simulation(system, isolate=True) as simulation:
        first = simulation.run(1.0, 0.1)
        for _ in range(2):
            assert simulation.run(1.0, 0.1).values.tobytes() == first.values.tobytes()


def test_a_process_may_be_ready_before_its_master_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # as where the master is held up, by other programs or the collection of its garbage, while the FMU is loaded
    start = WorkerProcess.__init__

    def start_and_be_held_up(process: WorkerProcess, *arguments: Any) -> None:
        start(process, *arguments)
        area = channel_library().channel_area()
        wait_for(lambda: any(process.memory[area + 8 : area + 8 + len(functions())]))

    system = one(tank(tmp_path / "tank.fmu"), {"u": 1.0})
    monkeypatch.setattr(WorkerProcess, "__init__", start_and_be_held_up)
    both(system)


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="threads can't be kept on a core here")
def test_on_one_core_by_turns_and_afterwards_on_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fmu, before = tank(tmp_path / "tank.fmu"), os.sched_getaffinity(0)
    end, during, afterwards = threading.Event(), [], []
    threads: list[threading.Thread] = []

    def look(u: float) -> float:
        during.append(os.sched_getaffinity(0))
        if not threads:  # it inherits the core
            threads.append(
                threading.Thread(target=lambda: (end.wait(PATIENCE), afterwards.append(os.sched_getaffinity(0))))
            )
            threads[0].start()
        return u

    def run(**options: Any) -> bytes:
        system = System()
        system.add("a", fmu, start={"u": 1.0})
        system.add("b", fmu)
        system.add_function("f", lambda _, u: look(u), inputs=["u"], outputs=["y"])
        system.connect("a.y", "f.u")
        system.connect("f.y", "b.u")
        return simulate(system, 2.0, 0.01, **options).values.tobytes()

    expected = run()
    assert all(cores == before for cores in during)
    during.clear()
    end.set()
    threads.pop().join()
    end.clear()
    afterwards.clear()
    monkeypatch.setattr("cosim.fmi.isolation.library.cores", lambda: 2)
    assert run(isolate=True) == expected
    assert any(len(cores) == 1 for cores in during)
    assert os.sched_getaffinity(0) == before
    end.set()
    threads.pop().join()
    assert afterwards == [before]


# Whatever an FMU does


@pytest.mark.parametrize(
    ("where", "how", "what"),
    [
        ("STEPPING", "SEGMENTATION", "its process was ended (segmentation fault, SIGSEGV) in fmi2DoStep"),
        ("STEPPING", "EXIT_0", "its process ended with exit code 0 in fmi2DoStep; it called exit()"),
        *(
            pytest.param(*rest, marks=pytest.mark.slow)
            for rest in (
                ("STEPPING", "ABORT", "its process was ended (it aborted, SIGABRT) in fmi2DoStep"),
                ("STEPPING", "END_3", "its process ended with exit code 3 in fmi2DoStep; it called exit()"),
                ("STEPPING", "IN_THREAD", "its process was ended (segmentation fault, SIGSEGV) in fmi2DoStep"),
                ("STEPPING", "RECURSION", "its process was ended (segmentation fault, SIGSEGV) in fmi2DoStep"),
            )
        ),
    ],
)
def test_an_fmu_that_ends_its_process_ends_the_run_with_what_was_recorded(
    tmp_path: Path, where: str, how: str, what: str
) -> None:
    system = one(ender(tmp_path / "f.fmu", where, how))
    system.add("tank", tank(tmp_path / "tank.fmu"), start={"u": 1.0})
    with Simulation(system, isolate=["m"]) as simulation:
        for _ in range(2):
            with pytest.raises(SimulationError) as caught:
                simulation.run(1.0, 0.1)
            assert str(caught.value).startswith(f"m failed at t = 0.4 s: {what}")
            assert (caught.value.component, caught.value.time) == ("m", 0.4)
            assert caught.value.results["tank.y"].tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize(
    ("where", "what"),
    [
        (
            "LOADING",
            "can't be loaded: its process was ended (segmentation fault, SIGSEGV) in the loading of its library",
        ),
        (
            "INSTANTIATING",
            "can't be instantiated: its process was ended (segmentation fault, SIGSEGV) in fmi2Instantiate",
        ),
        ("GETTING", "m failed at t = 0 s: its process was ended (segmentation fault, SIGSEGV) in fmi2GetReal"),
    ],
)
def test_an_end_before_the_first_communication_point(tmp_path: Path, where: str, what: str) -> None:
    expected = what.replace("CAUSE", "segmentation fault, SIGSEGV")
    with pytest.raises((SetupError, SimulationError), match=re.escape(expected)):
        simulate(one(ender(tmp_path / "f.fmu", where, "SEGMENTATION")), 1.0, 0.1, isolate=True)


@pytest.mark.parametrize("where", ["TERMINATING", "FREEING", "UNLOADING"])
def test_an_end_after_the_run_costs_nothing(tmp_path: Path, where: str) -> None:
    results = simulate(one(ender(tmp_path / "f.fmu", where, "EXIT_3")), 1.0, 0.1, isolate=True)
    assert len(results.time) == 11
    assert ("fmi2Terminate" in str(results.info.get("not_terminated"))) == (where == "TERMINATING")


@pytest.mark.parametrize("threads", [1, 2])
def test_a_step_that_never_ends(tmp_path: Path, threads: int) -> None:
    system = one(ender(tmp_path / "f.fmu", "STEPPING", "FOREVER"))
    system.add("tank", tank(tmp_path / "tank.fmu"), start={"u": 1.0})
    with pytest.raises(SimulationError, match=r"^m failed at t = 0\.4 s: fmi2DoStep took longer than 0\.3 s") as caught:
        simulate(system, 1.0, 0.1, isolate=["m"], limits=Limits(call_time=0.3), threads=threads)
    assert len(caught.value.results.time) == 5


def test_memory_has_a_limit(tmp_path: Path) -> None:
    system = one(ender(tmp_path / "f.fmu", "STEPPING", "MEMORY"))
    with pytest.raises(SimulationError, match=r"SIGSEGV\) in fmi2DoStep; its memory is limited to 300000000 bytes"):
        simulate(system, 1.0, 0.1, isolate=True, limits=Limits(memory=parse_bytes("300M")))


def ctrl_c_when_it_never_returns() -> threading.Thread:
    def wait_and_send() -> None:
        wait_for(Path("forever").exists)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=wait_and_send)
    thread.start()
    return thread


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_ctrl_c_ends_a_run_whose_fmu_never_returns(tmp_path: Path, threads: int) -> None:
    system = one(ender(tmp_path / "f.fmu", "STEPPING", "FOREVER"))
    system.add("tank", tank(tmp_path / "tank.fmu"), start={"u": 1.0})
    with Simulation(system, isolate=["m"], threads=threads) as simulation:
        thread = ctrl_c_when_it_never_returns()
        with pytest.raises(SimulationInterrupted, match=r"^interrupted at t = 0\.4 s$") as caught:
            simulation.run(1.0, 0.1)
        thread.join()
        assert len(caught.value.results.time) == 5


def test_ctrl_c_while_an_fmu_is_instantiated(tmp_path: Path) -> None:
    system = one(ender(tmp_path / "f.fmu", "INSTANTIATING", "FOREVER"))
    thread = ctrl_c_when_it_never_returns()
    with pytest.raises(KeyboardInterrupt):
        simulate(system, 1.0, 0.1, isolate=True)
    thread.join()


# The program


@contextmanager
def program(fmu: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "cosim", "run", str(fmu), "--isolated", "--out", "o", *options]
    with subprocess.Popen(command, cwd=fmu.parent, stderr=subprocess.PIPE, text=True, process_group=0) as process:
        try:
            yield process
        finally:
            process.kill()


def worker_of(process: subprocess.Popen[str]) -> int:
    """The process of the FMU, that of the run's process, that of the program's."""

    def found() -> list[int]:
        processes = [number for run in children(process.pid) for number in children(run)]
        return [number for number in processes if "worker.py" in Path(f"/proc/{number}/cmdline").read_text()]

    return wait_for(found)[0]


@pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_the_program(tmp_path: Path, number: signal.Signals) -> None:
    with program(ender(tmp_path / "f.fmu", "STEPPING", "FOREVER")) as process:
        wait_for((tmp_path / "forever").exists)
        worker = worker_of(process)
        process.send_signal(number)
        _, said = process.communicate(timeout=PATIENCE)
    wait_for(lambda: not is_there(worker))
    assert process.returncode != 0
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert "what was recorded is in o" in said
        assert json.loads((tmp_path / "o/summary.json").read_text())["status"] == "interrupted"


@pytest.mark.slow
def members_of_group(number: int) -> set[int]:
    """Processes of a group that are there."""
    found = set()
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, group = file.read_text().rpartition(")")[2].split()[:3]
            if int(group) == number and state != "Z":
                found.add(int(file.parent.name))
    return found


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the library and /proc are those of Linux")
@pytest.mark.parametrize("what", ["fork", "orphan"])
def test_what_an_fmu_has_started_neither_answers_nor_stays(tmp_path: Path, what: str) -> None:
    """By fork(): a copy that goes on as the first one does, and one that waits for ever."""
    materials = Materials(tmp_path)
    fmus = [
        fmu_2(tmp_path, materials, DESCRIPTION_2.replace("{GUID}", g), name=f"{g}.fmu") for g in ("", f"{what}@step")
    ]
    harmless = simulate(one(fmus[0], {"u": 2.0}), 1.0, 0.1)
    with Simulation(one(fmus[1], {"u": 2.0}), isolate=True) as simulation:
        group = simulation._components.instances["m"]._library._process.number
        assert simulation.run(1.0, 0.1).values.tobytes() == harmless.values.tobytes()
        if what == "orphan":
            assert len(members_of_group(group)) == 2
    wait_for(lambda: not members_of_group(group))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the library and /proc are those of Linux")
def test_an_fmu_that_ends_the_thread_that_calls_it_ends_the_run(tmp_path: Path) -> None:
    fmu = fmu_2(tmp_path, Materials(tmp_path), DESCRIPTION_2.replace("{GUID}", "leave@later"))
    with pytest.raises(
        SimulationError, match=r"m failed at t = 0\.5 s: its thread was ended \(pthread_exit\) in fmi2DoStep"
    ):
        simulate(one(fmu, {"u": 2.0}), 1.0, 0.1, isolate=True)


def test_a_crash_leaves_results_and_a_line(tmp_path: Path) -> None:
    with program(ender(tmp_path / "f.fmu", "STEPPING", "EXIT_0")) as process:
        _, said = process.communicate(timeout=PATIENCE)
    assert (process.returncode, said.count("\n")) == (1, 1)
    assert said.startswith("cosim: f failed at t = 0.4 s: its process ended with exit code 0 in fmi2DoStep; it called")
    assert (tmp_path / "o/results.csv").read_text().count("\n") == 6


# What is written


@pytest.mark.parametrize(("text", "number"), [("1", 1), ("500M", 500_000_000), ("1.5g", 1_500_000_000), ("2 kB", 2000)])
def test_amounts_of_memory(text: str, number: int) -> None:
    assert parse_bytes(text) == number


@pytest.mark.parametrize("text", ["", "M", "0", "-1", "1T", "1e9", "nan"])
def test_no_amounts_of_memory(text: str) -> None:
    with pytest.raises(SetupError, match="is not an amount of memory; write"):
        parse_bytes(text)


def test_scenarios_and_ssps_say_what_is_isolated(tmp_path: Path) -> None:
    tank(tmp_path / "tank.fmu")
    toml = tmp_path / "tanks.toml"
    text = '[run]\nstop_time = 1\nstep_size = 0.5\n[components.a]\nfmu = "tank.fmu"\nisolate = {}\n'
    toml.write_text(text.format("true") + '[components.b]\nfmu = "tank.fmu"\n')
    system = load_scenario(str(toml)).system()
    assert {name: c.isolate for name, c in system.components.items()} == {"a": True, "b": False}
    system.connect("a.y", "b.u")
    write_ssp(tmp_path / "tanks.ssp", system, "tanks", Experiment(1.0, 0.5))
    read = read_ssp(tmp_path / "tanks.ssp", tmp_path / "unpacked").system
    assert {name: c.isolate for name, c in read.components.items()} == {"a": True, "b": False}
    toml.write_text(text.format("1"))
    with pytest.raises(ScenarioError, match="isolate = 1 must be true or false"):
        load_scenario(str(toml))


@pytest.mark.parametrize(
    ("options", "scenario", "isolate"),
    [
        ("x.toml --isolated", "x.toml", True),
        ("--isolated x.toml", "x.toml", True),
        ("x.toml --isolated plant --isolated controller", "x.toml", ("plant", "controller")),
        ("--isolated plant x.toml", "x.toml", ("plant",)),
        ("x.toml", "x.toml", False),
    ],
)
def test_what_stands_behind_the_option(options: str, scenario: str, isolate: Any) -> None:
    args = command_line().parse_args(["run", *options.split()])
    behind = take_from_isolated(args, lambda _: False) if args.scenario is None else []
    assert (args.scenario or behind[0]) == scenario
    assert IsolationOptions.of(args).isolate == isolate


def test_what_can_not_be_isolated_is_refused(tmp_path: Path) -> None:
    system = one(tank(tmp_path / "tank.fmu"))
    system.add_function("f", lambda _: None)
    for name in ("tank", "f"):
        with pytest.raises(SetupError, match=rf"there is no component '{name}' with an FMU; known are m"):
            Simulation(system, isolate=[name])
    with pytest.raises(SetupError, match=r"none is isolated; isolate some \(option --isolated\)"):
        Simulation(system, limits=Limits(call_time=1.0))
    for wrong in ({"call_time": 0.0}, {"call_time": float("nan")}, {"memory": 0}):
        with pytest.raises(SetupError, match="must be a positive number of"):
            Limits(**wrong)
    with pytest.raises(SetupError, match="isolate = 'yes' must be True or False"):
        System().add("a", "a.fmu", isolate="yes")  # type: ignore[arg-type]


def test_a_call_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cosim.fmi.isolation.process.CHANNEL_SIZE", 400_000)
    system = one(compiled(tmp_path, "fmi3_types"), {"Binary": bytes(300_000)})
    with pytest.raises(SimulationError, match=r"fmi3SetBinary: its values are more than \d+ bytes"):
        simulate(system, 1.0, 0.1, isolate=True)


def test_large_values_go_over(tmp_path: Path) -> None:
    data = np.random.default_rng(1).bytes(100_000)
    results = simulate(one(compiled(tmp_path, "fmi3_types"), {"Binary": data}), 0.2, 0.1, isolate=True)
    assert results["m.Binary_out"][-1] == data
