"""Runs that end early keep what was recorded, say who failed, when and why, and leave nothing behind."""

from __future__ import annotations

import gc
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest

from cosim import Results, SetupError, SimulationError, SimulationInterrupted, System, simulate
from cosim.master.interrupts import DeferredInterrupt
from tests.support.patience import PATIENCE
from tests.support.tiny_models import FRAGILE_MESSAGE, GAIN, INTEGRATOR, build

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("tiny"))


@pytest.fixture
def temporary(plain_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fresh folder for temporary files, which must be empty again after the test."""
    folder = plain_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    assert tempfile.gettempdir() == str(folder)
    yield folder
    assert list(folder.iterdir()) == []
    assert os.environ["TMPDIR"] == str(folder)


def failing(tiny: Path) -> System:
    """A tank with x' = -1 from x = 1.875; `fragile` passes x on and fails at t = 2 s, where x < 0."""
    system = System()
    system.add("before", tiny / "Gain.fmu", start={"u": 0.0})
    system.add("tank", tiny / "Integrator.fmu", start={"x_start": 1.875, "u": -1.0})
    system.add("fragile", tiny / "Fragile.fmu")
    system.add("after", tiny / "Gain.fmu", start={"u[2]": 0.0})
    system.connect("tank.x", "fragile.u")
    system.connect("fragile.y", "after.u[1]")
    return system


# An FMU fails


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_an_fmu_that_fails_ends_the_run_with_its_name_time_and_log(tiny, temporary, order):
    with pytest.raises(SimulationError) as failed:
        simulate(failing(tiny), 4.0, 0.25, order=order)
    error = failed.value
    assert (error.component, error.time) == ("fragile", 2.0)
    assert FRAGILE_MESSAGE in error.log
    assert str(error).startswith("fragile failed at t = 2 s: fmi2DoStep returned ")
    assert str(error).endswith(error.log)
    assert "\n" not in str(error)


def test_the_log_is_that_of_the_fmu_that_failed_whatever_stands_behind_it(tiny):
    # each FMU in turn is the last of the system, and so the last one whose logger was registered
    for last in ("before", "tank", "fragile", "after"):
        system = failing(tiny)
        system.components[last] = system.components.pop(last)
        with pytest.raises(SimulationError, match="fragile failed") as failed:
            simulate(system, 4.0, 0.5)
        assert FRAGILE_MESSAGE in failed.value.log, last


def test_what_was_recorded_is_kept_and_can_be_written(tiny, temporary, tmp_path):
    with pytest.raises(SimulationError) as failed:
        simulate(failing(tiny), 4.0, 0.25)
    r = failed.value.results
    assert r.time.tolist() == [0.25 * i for i in range(9)]
    assert r["tank.x"] == pytest.approx(1.875 - r.time, rel=1e-11)
    assert (r["after.y[1]"] == 2.0 * r["tank.x"]).all()
    assert r.info["status"] == "failed"
    assert r.info["loop_time_s"] > 0.0
    r.to_csv(tmp_path / "partial.csv")
    back = Results.from_csv(tmp_path / "partial.csv")
    assert back.names == r.names
    assert (back.values == r.values).all()
    complete = simulate(failing(tiny), 2.0, 0.25)  # the same, stopped in time
    assert (complete.values == r.values).all()


def test_an_output_that_cannot_be_computed_is_its_own_components_failure(tiny, temporary):
    # y = sqrt(u) of a negative u: the FMU says so in its log; it must be blamed, not the one that gets the NaN
    system = System()
    system.add("root", tiny / "Root.fmu")
    system.add("next", tiny / "Integrator.fmu")
    system.drive("root.u", lambda t: 1.0 - t)
    system.connect("root.y", "next.u")
    with pytest.raises(SimulationError, match="math domain error") as failed:
        simulate(system, 4.0, 0.5)
    assert (failed.value.component, failed.value.time) == ("root", 1.5)
    assert failed.value.results.time.tolist() == [0.0, 0.5, 1.0]


def test_an_initialisation_that_fails_is_named_and_has_no_results(tiny, temporary):
    system = failing(tiny)
    system.components["tank"].start["x_start"] = -1.0
    with pytest.raises(SimulationError) as failed:
        simulate(system, 4.0, 0.25, start_time=1.0)
    assert (failed.value.component, failed.value.time) == ("fragile", 1.0)
    assert FRAGILE_MESSAGE in failed.value.log
    assert failed.value.results is None


def test_a_signal_that_fails_ends_the_run_at_its_input(tiny, temporary):
    system = failing(tiny)
    del system.components["before"].start["u"]
    system.drive("before.u", lambda t: 1.0 / (t - 1.0))
    with pytest.raises(
        SimulationError, match=r"signal that feeds 'before\.u\[1\]' failed: ZeroDivisionError"
    ) as failed:
        simulate(system, 4.0, 0.25)
    assert (failed.value.component, failed.value.time) == ("before", 1.0)
    assert failed.value.results.time.tolist() == [0.0, 0.25, 0.5, 0.75]
    assert isinstance(failed.value.__cause__.__cause__, ZeroDivisionError)


def test_a_run_after_a_failed_one_is_untouched_by_it(tiny):
    fine = simulate(failing(tiny), 1.0, 0.25)
    with pytest.raises(SimulationError):
        simulate(failing(tiny), 4.0, 0.25)
    again = simulate(failing(tiny), 1.0, 0.25)
    assert (fine.values == again.values).all()


def test_set_up_errors_and_errors_of_the_caller_leave_nothing_behind(tiny, temporary, tmp_path):
    system = failing(tiny)
    system.connect("fragile.y", "nobody.u")
    with pytest.raises(SetupError):
        simulate(system, 1.0, 0.25)
    broken = tmp_path / "broken.fmu"
    shutil.copy(tiny / "Gain.fmu", broken)
    system = failing(tiny)
    system.add("broken", broken, start={"u": 0.0, "K": 100.0})
    with pytest.raises(SetupError):
        simulate(system, 1.0, 0.25)

    def progress(_: float) -> None:
        raise LookupError("of the caller")

    with pytest.raises(LookupError, match="of the caller"):
        simulate(failing(tiny), 1.0, 0.25, progress=progress)


def test_a_run_to_its_end_leaves_nothing_behind(tiny, temporary):
    simulate(failing(tiny), 1.0, 0.25)


# Ctrl-C


def interrupting(at: float):
    def function(t: float) -> float:
        if t == at:
            signal.raise_signal(signal.SIGINT)
        return t

    return function


@pytest.fixture
def handled() -> list[int]:
    """Replace the handler of Ctrl-C for one test; what reaches it is counted."""
    calls: list[int] = []

    def handler(number: int, _frame: object) -> None:
        calls.append(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, handler)
    yield calls
    assert signal.getsignal(signal.SIGINT) is handler
    signal.signal(signal.SIGINT, before)


def interrupted_system(tiny: Path, at: float) -> System:
    system = System()
    system.add("g", tiny / "Gain.fmu")
    system.drive("g.u", interrupting(at))
    return system


def test_ctrl_c_ends_a_run_between_two_calls_and_keeps_the_results(tiny, temporary, handled):
    with pytest.raises(SimulationInterrupted, match=r"interrupted at t = 1 s") as interrupted:
        simulate(interrupted_system(tiny, 0.75), 4.0, 0.25)
    assert isinstance(interrupted.value, KeyboardInterrupt)
    assert interrupted.value.time == 1.0
    assert interrupted.value.results.time.tolist() == [0.0, 0.25, 0.5, 0.75]
    assert interrupted.value.results["g.y[1]"].tolist() == [0.0, 0.5, 1.0, 1.5]
    assert interrupted.value.results.info["status"] == "interrupted"
    assert handled == []


def test_ctrl_c_at_the_last_point_is_not_lost(tiny, temporary, handled):
    # a loop of many runs must end there, not go on with the next run
    with pytest.raises(KeyboardInterrupt):
        simulate(interrupted_system(tiny, 4.0), 4.0, 0.25)


def test_a_second_ctrl_c_interrupts_at_once(tiny, temporary, handled):
    def function(t: float) -> float:
        if t == 1.0:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
        return t

    system = interrupted_system(tiny, 99.0)
    system.signals.clear()
    system.drive("g.u", function)
    with pytest.raises(KeyboardInterrupt) as interrupted:
        simulate(system, 4.0, 0.25)
    assert not isinstance(interrupted.value, SimulationInterrupted)
    assert handled == [signal.SIGINT]


def test_the_handler_is_restored_however_a_run_ends(tiny, handled):
    simulate(interrupted_system(tiny, 99.0), 1.0, 0.25)
    with pytest.raises(SimulationError):
        simulate(failing(tiny), 4.0, 0.5)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    assert handled == [signal.SIGINT]


def test_an_ignored_ctrl_c_stays_ignored(tiny):
    # background jobs are started with SIGINT ignored; a run in them must not listen to it
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert len(simulate(interrupted_system(tiny, 0.5), 1.0, 0.25).time) == 5
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    except KeyboardInterrupt:
        pytest.fail("the run was interrupted")
    finally:
        signal.signal(signal.SIGINT, before)


def test_deferred_interrupt_by_itself(handled):
    with DeferredInterrupt() as interrupt:
        assert not interrupt.requested
        signal.raise_signal(signal.SIGINT)
        assert interrupt.requested
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def child(script: str, tiny: Path, temporary: Path) -> subprocess.Popen:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(temporary), "PYTHONWARNINGS": "error"}
    head = "import json, sys, time\nfrom pathlib import Path\nfrom cosim import *\ntiny = Path(sys.argv[1])\n"
    return subprocess.Popen(
        [sys.executable, "-c", head + script, str(tiny)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.skipif(sys.platform == "win32", reason="Windows can't send SIGINT to one process only")
def test_ctrl_c_from_outside(tiny, plain_path):
    script = """
def signal(t):
    if t == 2.0:
        print("half", flush=True)
        sys.stdin.readline()  # the interrupt comes in here: it is sent before the line
    return t

system = System()
system.add("i", tiny / "Integrator.fmu")
system.drive("i.u", signal)
try:
    simulate(system, 4.0, 0.25)
except SimulationInterrupted as error:
    print(json.dumps([error.time, error.results.time.tolist()]))
    sys.exit(3)
"""
    temporary = plain_path / "temporary"
    temporary.mkdir()
    process = child(script, tiny, temporary)
    assert process.stdout.readline() == "half\n"
    assert list(temporary.iterdir()) != []  # so that the emptiness below says something
    process.send_signal(signal.SIGINT)
    out, err = process.communicate("\n", timeout=PATIENCE)
    assert (process.returncode, err) == (3, "")
    assert json.loads(out) == [2.25, [0.25 * i for i in range(9)]]
    assert list(temporary.iterdir()) == []


def test_an_error_that_nobody_catches_leaves_nothing_behind(tiny, plain_path):
    script = """
system = System()
system.add("f", tiny / "Fragile.fmu")
system.add("g", tiny / "Gain.fmu", start={"u": 0})
system.drive("f.u", lambda t: 1 - t)
simulate(system, 4.0, 0.25)
"""
    temporary = plain_path / "temporary"
    temporary.mkdir()
    process = child(script, tiny, temporary)
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "SimulationError: f failed at t = 1 s" in err.splitlines()[-1]
    assert list(temporary.iterdir()) == []


# Threads, repetition, files


def test_a_run_in_another_thread(tiny, temporary):
    expected = simulate(failing(tiny), 1.0, 0.25)
    outcome: list[object] = []

    def work() -> None:
        outcome.append(simulate(failing(tiny), 1.0, 0.25))
        try:
            simulate(failing(tiny), 4.0, 0.25)
        except SimulationError as error:
            outcome.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(30)
    assert not thread.is_alive()
    assert (outcome[0].values == expected.values).all()
    assert (outcome[1].component, outcome[1].time) == ("fragile", 2.0)


def test_a_log_message_after_a_run_inside_the_run_has_ended(tiny, tmp_path):
    # in a process of its own: a message to the logger of an instance that is gone could end the process
    script = """
inner = System()
inner.add("g", tiny / "Gain.fmu", start={"u": 1.0})

def signal(t):
    simulate(inner, 1.0, 0.5)  # a signal may be anything, also another run
    return 1.0 - t

system = System()
system.add("f", tiny / "Fragile.fmu")
system.drive("f.u", signal)
try:
    simulate(system, 4.0, 0.5)
except SimulationError as error:
    print(error)
"""
    process = child(script, tiny, tmp_path)
    out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, err) == (0, "")
    assert out.startswith("f failed at t = 1 s")
    assert FRAGILE_MESSAGE in out


def test_runs_are_equal_bit_for_bit(tiny):
    runs = []
    for _ in range(3):
        system = System()
        system.add("lag", tiny / "Lag.fmu", start={"x_start": 0.1, "T": 0.7})
        system.add("g", tiny / "Gain.fmu", start={"K": -0.3, "u[2]": 0.1})
        system.connect("lag.x", "g.u[1]")
        system.connect("g.y[1]", "lag.u")
        runs.append(simulate(system, 2.0, 0.1))
    assert len({run.values.tobytes() for run in runs}) == 1
    assert len({run.time.tobytes() for run in runs}) == 1
    system.components["g"].start["K"] = -0.3000000001
    assert simulate(system, 2.0, 0.1).values.tobytes() != runs[0].values.tobytes()


def test_one_system_object_can_be_run_again(tiny):
    system = failing(tiny)
    first, second = (simulate(system, 1.0, 0.25) for _ in range(2))
    assert (first.values == second.values).all()
    assert first.time is not second.time


def test_two_instances_of_one_file_are_apart(tiny, temporary):
    system = System()
    system.add("a", tiny / "Lag.fmu", start={"x_start": 1.0, "T": 1.0, "u": 0.0})
    system.add("b", tiny / "Lag.fmu", start={"x_start": -2.0, "T": 0.25, "u": 0.0})
    both = simulate(system, 1.0, 0.25)
    for name in "ab":
        alone = System()
        alone.components[name] = system.components[name]
        assert (simulate(alone, 1.0, 0.25)[f"{name}.x"] == both[f"{name}.x"]).all()
    assert (both["a.x"] != both["b.x"]).all()
    assert both.info["parameters"]["a.T"] == 1.0
    assert both.info["parameters"]["b.T"] == 0.25


def test_an_fmu_file_is_free_after_a_run_and_its_new_content_counts(tmp_path):
    path = build(tmp_path / "first", GAIN) / "Gain.fmu"
    other = build(tmp_path / "second", INTEGRATOR) / "Integrator.fmu"
    system = System()
    system.add("c", path, start={"u": 1.0})
    assert "c.y[1]" in simulate(system, 1.0, 0.5)
    path.write_bytes(other.read_bytes())
    assert simulate(system, 1.0, 0.5)["c.x"] == pytest.approx([0.0, 0.5, 1.0], rel=1e-12)
    path.unlink()
    with pytest.raises(SetupError, match="no such FMU file"):
        simulate(system, 1.0, 0.5)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="no /proc/self/fd to count open files in")
@pytest.mark.slow
def test_open_files_do_not_grow(tiny):
    def run() -> None:
        simulate(failing(tiny), 1.0, 0.25)
        with pytest.raises(SimulationError):
            simulate(failing(tiny), 4.0, 0.5)

    def mapped() -> int:
        return Path("/proc/self/maps").read_text().count("cosim_")

    run()
    gc.collect()
    opened, libraries = len(os.listdir("/proc/self/fd")), mapped()  # noqa: PTH208
    for _ in range(20):
        run()
    gc.collect()
    assert len(os.listdir("/proc/self/fd")) <= opened  # noqa: PTH208
    assert mapped() <= libraries
