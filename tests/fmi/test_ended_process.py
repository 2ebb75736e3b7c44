"""An FMU that ends the process it runs in leaves a line that names it, and is never a success."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from cosim import Results, Simulation, SimulationError, System, simulate
from cosim.loop import current_calls
from cosim.loop.binding import loop_library
from cosim.loop.current_calls import Caller, watched_calls
from tests.support.c_fmus import ender, tank
from tests.support.patience import PATIENCE, wait_for

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="what a signal leaves differs elsewhere")

#: Couples an FMU that ends the process with nothing; the name of its component would break a format.
SCRIPT = """
import sys
if "faulthandler" in sys.argv: import faulthandler; faulthandler.enable()
from cosim import System, simulate
system = System()
system.add("a%s", sys.argv[1])
print(len(simulate(system, 1.0, 0.1).time), "rows")
"""


def ended(command: Sequence[str], cwd: Path) -> tuple[int, str, list[str]]:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=PATIENCE, check=False)
    return done.returncode, done.stdout, done.stderr.splitlines()


def alone(fmu: Path, *options: str) -> tuple[int, str, list[str]]:
    return ended([sys.executable, "-c", SCRIPT, str(fmu), *options], fmu.parent)


@pytest.mark.parametrize(
    ("how", "number", "what"),
    [
        ("ABORT", signal.SIGABRT, "it aborted (SIGABRT)"),
        ("DIVISION", signal.SIGFPE, "arithmetic error (SIGFPE)"),
        ("RECURSION", signal.SIGSEGV, "segmentation fault (SIGSEGV)"),
        *(
            pytest.param(*rest, marks=pytest.mark.slow)
            for rest in (
                ("SEGMENTATION", signal.SIGSEGV, "segmentation fault (SIGSEGV)"),
                ("TRAP", signal.SIGILL, "illegal instruction (SIGILL)"),
                ("BUS", signal.SIGBUS, "bus error (SIGBUS)"),
            )
        ),
    ],
)
def test_a_crash_says_which_fmu_in_which_call_and_when(
    tmp_path: Path, how: str, number: signal.Signals, what: str
) -> None:
    fmu = ender(tmp_path / "f.fmu", "STEPPING", how)
    line = f"cosim: component 'a%s' (f.fmu) crashed in fmi2DoStep at t = 0.4 s: {what}; the fault is in the FMU, ask"
    code, out, said = alone(fmu)
    assert (code, out, len(said)) == (-number, "", 1)
    assert said[0].startswith(line)
    code, _, said = alone(fmu, "faulthandler")
    assert code == -number
    assert said[0].startswith(line)
    assert said[1].startswith("Fatal Python error: ")


@pytest.mark.parametrize(
    ("where", "what"),
    [
        ("LOADING", "the loading of its library"),
        ("GETTING", "fmi2GetReal at t = 0 s"),
        ("FREEING", "fmi2FreeInstance"),
        *(
            pytest.param(*rest, marks=pytest.mark.slow)
            for rest in (
                ("INSTANTIATING", "fmi2Instantiate"),
                ("SETTING_UP", "fmi2SetupExperiment at t = 0 s"),
                ("TERMINATING", "fmi2Terminate at t = 1 s"),
                ("UNLOADING", "the unloading of its library"),
            )
        ),
    ],
)
def test_every_call_is_named(tmp_path: Path, where: str, what: str) -> None:
    code, _, said = alone(ender(tmp_path / "f.fmu", where, "SEGMENTATION"))
    assert code == -signal.SIGSEGV
    assert said[0].startswith(f"cosim: component 'a%s' (f.fmu) crashed in {what}: segmentation fault")
    code, _, said = alone(ender(tmp_path / "f.fmu", where, "EXIT_0"))
    assert (code, len(said)) == (70, 1)
    assert said[0].startswith(f"cosim: component 'a%s' (f.fmu) ended the process in {what}: it called exit(), which")


def test_a_crash_in_a_thread_of_the_fmu_says_which_call_was_going_on(tmp_path: Path) -> None:
    code, _, said = alone(ender(tmp_path / "f.fmu", "STEPPING", "IN_THREAD"))
    assert code == -signal.SIGSEGV
    assert said[0].startswith(
        "cosim: component 'a%s' (f.fmu) was at work when another thread crashed, in fmi2DoStep at"
    )


def test_a_child_of_the_fmu_may_exit(tmp_path: Path) -> None:
    assert alone(ender(tmp_path / "f.fmu", "STEPPING", "IN_CHILD")) == (0, "11 rows\n", [])


@pytest.mark.parametrize(
    "how", ["EXIT_0", "END_0", "SEGMENTATION", *(pytest.param(h, marks=pytest.mark.slow) for h in ("EXIT_3", "END_3"))]
)
def test_no_end_of_the_process_is_a_success_of_the_program(tmp_path: Path, how: str) -> None:
    fmu = ender(tmp_path / "f.fmu", "STEPPING", how)
    code, out, said = ended([sys.executable, "-m", "cosim", "run", str(fmu), "--out", "o"], tmp_path)
    assert code == {"SEGMENTATION": -signal.SIGSEGV, "END_3": 3}.get(how, 70)
    assert (out, len(said)) == ("", 1)
    what = "crashed" if how == "SEGMENTATION" else "ended the process"
    assert said[0].startswith(f"cosim: component 'f' (f.fmu) {what} in fmi2DoStep at t = 0.4 s: ")
    assert {"EXIT": "it called exit(), which", "END_": "it called _exit(), which"}.get(how[:4], "segment") in said[0]
    assert list((tmp_path / "o").iterdir()) == []


@pytest.mark.parametrize(
    ("where", "how", "what", "options"),
    [
        ("TERMINATING", "SEGMENTATION", "crashed in fmi2Terminate at t = 1 s: segmentation fault", ["--log", "all"]),
        *(
            pytest.param(*rest, marks=pytest.mark.slow)
            for rest in (
                ("FREEING", "ABORT", "crashed in fmi2FreeInstance: it aborted", ["--format", "parquet", "--report"]),
                ("UNLOADING", "EXIT_0", "ended the process in the unloading of its library: it called exit()", []),
                ("TERMINATING", "END_0", "ended the process in fmi2Terminate at t = 1 s: exit status 0", []),
            )
        ),
    ],
)
def test_an_fmu_that_ends_the_process_after_the_run_costs_nothing(
    tmp_path: Path, where: str, how: str, what: str, options: list[str]
) -> None:
    command = [sys.executable, "-m", "cosim", "run", "f.fmu", "--step", "0.1", "--stop", "1", "--out", "o", *options]
    ender(tmp_path / "f.fmu", where, how)
    code, out, said = ended(command, tmp_path)
    line = f"component 'f' (f.fmu) {what}"
    assert (code, len(said)) == (0, 2)
    assert said[0].startswith(f"cosim: {line}")
    assert said[1] == f"cosim: note: that was when the run was over; all its results are in {tmp_path / 'o'}"
    assert out.splitlines()[-1] == "results, summary and figures: o"
    summary = json.loads((tmp_path / "o/summary.json").read_text())
    assert (summary["status"], summary["error"]) == ("completed", None)
    call = line.partition(":")[0].replace("crashed", "ended the process")
    assert summary["process_ended"].startswith(call)
    assert {*summary["files"], "summary.json"} == {path.name for path in (tmp_path / "o").iterdir()}
    for name, sha256 in summary["files"].items():
        assert hashlib.sha256((tmp_path / "o" / name).read_bytes()).hexdigest() == sha256
    table = next(name for name in summary["files"] if name.startswith("results.") and not name.endswith(".png"))
    assert Results.read(tmp_path / "o" / table).time == pytest.approx([n / 10 for n in range(11)])
    if where != "TERMINATING":  # and its files may make room for others
        assert ended(command, tmp_path)[0] == 0


@pytest.mark.slow
def test_what_a_failed_run_had_recorded_outlasts_a_crash_when_the_fmu_is_freed(tmp_path: Path) -> None:
    ender(tmp_path / "f.fmu", "FREEING", "ABORT", "FAILS")
    command = [sys.executable, "-m", "cosim", "run", "f.fmu", "--step", "0.1", "--stop", "1", "--out", "o"]
    code, _, said = ended(command, tmp_path)
    assert (code, len(said)) == (1, 2)
    assert said[0].startswith("cosim: component 'f' (f.fmu) crashed in fmi2FreeInstance: it aborted")
    assert said[1] == "cosim: f failed at t = 0.4 s: fmi2DoStep returned error; what was recorded is in o"
    assert len(Results.read(tmp_path / "o/results.csv").time) == 5


def test_a_run_that_is_well_is_as_it_was(tmp_path: Path) -> None:
    tank(tmp_path / "tank.fmu")
    command = [sys.executable, "-m", "cosim", "run", "tank.fmu", "--step", "0.1", "--out", "o"]
    code, _, said = ended([*command, "--stop", "1"], tmp_path)
    assert (code, said) == (0, [])
    assert json.loads((tmp_path / "o/summary.json").read_text())["status"] == "completed"
    code, _, said = ended([*command, "--stop", "1.05"], tmp_path)
    assert (code, len(said)) == (1, 1)
    assert "is not a whole number of steps" in said[0]


@pytest.mark.parametrize(
    ("number", "to_group"),
    [
        (signal.SIGINT, True),
        (signal.SIGTERM, False),
        *(
            pytest.param(*rest, marks=pytest.mark.slow)
            for rest in (
                (signal.SIGINT, False),
                (signal.SIGTERM, True),
                (signal.SIGHUP, False),
                (signal.SIGHUP, True),
            )
        ),
    ],
)
def test_signals_reach_the_run(tmp_path: Path, number: signal.Signals, to_group: bool) -> None:
    tank(tmp_path / "tank.fmu")
    command = [sys.executable, "-m", "cosim", "run", "tank.fmu", "--step", "0.01", "--stop", "1e4", "--realtime", "1"]
    command += ["--log", "info", "--out", "o"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, process_group=0) as program:
        log = tmp_path / "o/.unfinished/new/messages.log"
        wait_for(lambda: log.exists() or program.poll() is not None)
        time.sleep(0.2)
        (os.killpg if to_group else os.kill)(program.pid, number)
        _, said = program.communicate(timeout=PATIENCE)
    assert (program.returncode, said.count("\n")) == (130, 1)
    assert "what was recorded is in o" in said


@pytest.mark.slow
def test_an_fmu_that_ignores_ctrl_c_from_a_step_on_is_ended_by_it(tmp_path: Path) -> None:
    ender(tmp_path / "f.fmu", "STEPPING", "IGNORING")
    command = [sys.executable, "-m", "cosim", "run", "f.fmu", "--step", "0.1", "--stop", "1e4", "--realtime", "10"]
    with subprocess.Popen([*command, "--log", "info", "--out", "o"], cwd=tmp_path, stderr=subprocess.PIPE) as program:
        log = tmp_path / "o/.unfinished/new/messages.log"
        wait_for(lambda: log.exists() or program.poll() is not None)
        time.sleep(0.5)
        program.send_signal(signal.SIGINT)
        _, said = program.communicate(timeout=PATIENCE)
    assert program.returncode == 130
    assert b"what was recorded is in o" in said


def test_the_run_does_not_outlive_the_program(tmp_path: Path) -> None:
    tank(tmp_path / "tank.fmu")
    command = [sys.executable, "-m", "cosim", "run", "tank.fmu", "--step", "0.01", "--stop", "1e4", "--realtime", "1"]
    with subprocess.Popen([*command, "--out", "o"], cwd=tmp_path) as program:
        children = Path(f"/proc/{program.pid}/task/{program.pid}/children")
        (child,) = wait_for(lambda: children.read_text().split())
        time.sleep(0.2)
        program.kill()
        program.wait(PATIENCE)
    wait_for(lambda: not Path(f"/proc/{child}/stat").exists())


# Within this process


def handlers() -> list[bytes]:
    """The actions of the signals of a crash, as the C library has them."""
    libc, found = ctypes.CDLL(None), []
    for number in (signal.SIGSEGV, signal.SIGABRT, signal.SIGFPE, signal.SIGILL, signal.SIGBUS):
        action = ctypes.create_string_buffer(256)
        assert libc.sigaction(int(number), None, action) == 0
        found.append(action.raw[: ctypes.sizeof(ctypes.c_void_p)])  # the handler, which comes first
    return found


def test_handlers_are_there_while_fmus_run_and_are_then_what_they_were(tmp_path: Path) -> None:
    before = handlers()
    with watched_calls():
        within = handlers()
        with watched_calls():
            assert handlers() == within
        assert handlers() == within
    assert all(a != b for a, b in zip(before, within, strict=True))
    assert handlers() == before
    system = System()
    system.add("tank", tank(tmp_path / "tank.fmu"), start={"u": 1.0})
    seen: list[list[bytes]] = []
    system.add_function("f", lambda _, x: seen.append(handlers()), inputs=["x"])
    system.connect("tank.y", "f.x")
    with Simulation(system) as simulation:
        assert handlers() == before
        simulation.run(1.0, 0.5)
        assert handlers() == before
        with simulation.start(0.5) as run:
            run.step(2)
        assert handlers() == before
    assert handlers() == before
    assert len(seen) > 3
    assert seen == [within] * len(seen)


def test_a_handler_that_comes_meanwhile_stays(tmp_path: Path) -> None:
    """As that of faulthandler, which a user may switch on while a run is stepped."""
    code = """
import faulthandler, os, sys
from cosim.loop.current_calls import watched_calls
with watched_calls():
    faulthandler.enable()
faulthandler.disable() if "off" in sys.argv else None
os.kill(os.getpid(), 11)
"""
    for option, said in (("on", True), ("off", False)):
        done = subprocess.run([sys.executable, "-c", code, option], capture_output=True, text=True, check=False)
        assert done.returncode == -signal.SIGSEGV
        assert ("Fatal Python error" in done.stderr) == said


@pytest.mark.slow
def test_each_thread_has_its_own_call(tmp_path: Path) -> None:
    path = tank(tmp_path / "tank.fmu")
    addresses = set()

    def run(_: int) -> float:
        system = System()
        system.add("tank", path, start={"u": 1.0})
        addresses.add(current_calls.address_of_call())
        return float(simulate(system, 1.0, 0.01)["tank.y"][-1])

    for _ in range(100):  # more threads than there are places; each gives its place back
        with ThreadPoolExecutor(4) as pool:
            assert list(pool.map(run, range(4))) == pytest.approx([1.0] * 4)
    assert len(addresses) >= 4


def test_more_threads_and_components_than_places_run_unnamed() -> None:
    library = loop_library()
    current_calls.address_of_call()
    taken = []
    while (place := library.take_place()) >= 0:
        taken.append(place)
    callers = [Caller(f"component {n}") for n in range(5000)]
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(callers[-1].noting(lambda x: x, "f"), 3).result(PATIENCE) == 3
    for place in taken:
        current_calls._all().calls.calls[place].thread = 0
    assert callers[-1].code("f") < 256 <= callers[0].code("f")
    del callers
    assert Caller("one more").code("f") >= 256


def test_a_call_that_raises_is_over() -> None:
    note = current_calls._here().code
    before = note[0]

    def fails() -> None:
        assert note[0] != before
        raise ValueError

    with pytest.raises(ValueError, match=r"^$"):
        Caller("one").noting(fails, "f")()
    assert note[0] == before


# Where a crash is an exception of Python, as ctypes makes it on Windows


@pytest.fixture
def crashing(monkeypatch: pytest.MonkeyPatch) -> Callable[[Simulation, str, str], None]:
    """Has a function of the only FMU crash, in the loop after four steps or where Python calls it."""

    def crash(simulation: Simulation, component: str, function: str) -> None:
        instance, what = simulation._components.instances[component], "exception: access violation writing 0x0"
        original = loop_library().loop_run

        def run(loop: Any, first: int, end: int, exchanged: bool) -> bool:
            assert original(loop, first, min(end, 4), exchanged)
            current_calls._here().code[0] = instance.code_of_call(function)
            raise OSError(what)

        def raising(*_: object) -> None:
            raise OSError(what)

        monkeypatch.setattr("cosim.fmi.instance._CRASHES_RAISE", True)
        if function == "fmi2DoStep":
            monkeypatch.setattr(loop_library(), "loop_run", run)
        else:
            instance._library.function(function)
            monkeypatch.setitem(instance._library._functions, function, raising)

    return crash


def test_a_crash_that_is_an_exception_ends_the_run_with_all_results(
    tmp_path: Path, crashing: Callable[[Simulation, str, str], None]
) -> None:
    system = System()
    system.add("t", tank(tmp_path / "t.fmu"), start={"u": 1.0})
    with Simulation(system) as simulation:
        crashing(simulation, "t", "fmi2DoStep")
        said = r"^t failed at t = 0\.3 s: crashed in fmi2DoStep \(exception: access violation writing 0x0\); the fault"
        with pytest.raises(SimulationError, match=said) as error:
            simulation.run(1.0, 0.1)
        assert error.value.component == "t"
        assert error.value.results is not None
        assert error.value.results["t.y"] == pytest.approx([0.0, 0.1, 0.2, 0.3])
        assert simulation._components.instances["t"].is_unusable


@pytest.mark.parametrize("function", ["fmi2Terminate", "fmi2FreeInstance"])
def test_a_crash_that_is_an_exception_after_the_run_is_told(
    tmp_path: Path, crashing: Callable[[Simulation, str, str], None], function: str
) -> None:
    system = System()
    system.add("t", tank(tmp_path / "t.fmu"), start={"u": 1.0})
    with Simulation(system, terminate_late=True) as simulation:
        crashing(simulation, "t", function)
        results = simulation.run(1.0, 0.1)
    said = results.info["not_terminated"] if function == "fmi2Terminate" else results.info["messages"]
    assert f"crashed in {function} (exception: access violation" in str(said["t"])
    assert results["t.y"][-1] == pytest.approx(1.0)
