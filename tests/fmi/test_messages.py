"""Messages of FMUs: counted, shown, logged, from wherever they come."""

from __future__ import annotations

import ctypes
import gc
import hashlib
import io
import json
import logging
import sys
import tempfile
from pathlib import Path
from typing import Any

import fmpy.fmi2 as fmi2
import pytest

import cosim.fmi.message_log
from cosim import Log, Results, SetupError, Simulation, SimulationError, System, simulate
from cosim.__main__ import main
from cosim.fmi.fmu_file import load
from cosim.fmi.instance import Instance
from cosim.fmi.messages import Messages
from tests.support.c_fmus import talker, tank

both = pytest.mark.parametrize("version", [2, 3])


def system_of(**fmus: Path) -> System:
    """Components by their names."""
    system = System()
    for name, fmu in fmus.items():
        system.add(name, fmu)
    return system


def run(fmu: Path, log: Log | str | None = None, steps: int = 5) -> Results:
    """The results of a run of one FMU, `m`, with steps of 0.5 s."""
    return simulate(system_of(m=fmu), 0.5 * steps, 0.5, log=log)


def said(results: Results) -> dict[str, Any]:
    """What results have of the messages of `m`."""
    about: dict[str, Any] = results.info["messages"]["m"]
    return about


def texts(results: Results) -> list[str]:
    """First texts of `m`."""
    return [first["text"] for first in said(results)["first"]]


def lines(path: Path) -> list[str]:
    """Lines of a log."""
    return path.read_text(encoding="utf-8").splitlines()


# Counted


@both
def test_warnings_are_counted_and_the_first_of_each_kind_is_kept(version: int, tmp_path: Path) -> None:
    results = run(talker(tmp_path / "t.fmu", "WARNS", version=version), steps=7)
    assert results.info["status"] == "completed"
    assert results["m.y"].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert results.info["warnings"] == 3  # the messages of the steps that begin at 0.5, 1.5 and 2.5 s
    assert said(results) == {
        "info": 1,
        "warnings": 3,
        "errors": 0,
        "first": [
            {
                "time": 0.5,
                "status": "warning",
                "category": "logTable",
                "text": "0.5 is outside of the table",
                "count": 3,
            }
        ],
    }
    assert "log" not in results.info


@both
def test_a_warning_without_a_message_is_counted_too(version: int, tmp_path: Path) -> None:
    results = run(talker(tmp_path / "t.fmu", "MUTE", version=version))
    assert results.info["warnings"] == 2
    (first,) = said(results)["first"]
    assert first == {
        "time": 0.5,
        "status": "warning",
        "category": "",
        "text": f"fmi{version}DoStep returned warning",
        "count": 2,
    }


def test_an_fmu_that_says_nothing_leaves_nothing(tmp_path: Path) -> None:
    results = run(tank(tmp_path / "tank.fmu"))
    assert (results.info["warnings"], results.info["messages"]) == (0, {})


@both
def test_each_run_counts_from_zero(version: int, tmp_path: Path) -> None:
    fmu = talker(tmp_path / "t.fmu", "WARNS", version=version)
    with Simulation(system_of(m=fmu), log=Log("warning", file=tmp_path / "log")) as simulation:
        counts = [simulation.run(0.5 * n, 0.5).info["warnings"] for n in (2, 6, 4)]
    assert counts == [1, 3, 2]
    assert [line for line in lines(tmp_path / "log") if line.startswith("---")] == ["--- the FMUs start afresh ---"] * 2


def test_a_run_that_is_stepped_counts_as_it_goes(tmp_path: Path) -> None:
    fmu = talker(tmp_path / "t.fmu", "WARNS")
    with Simulation(system_of(m=fmu)) as simulation, simulation.start(step_size=0.5) as stepped:
        counts = []
        for _ in range(4):
            stepped.step()
            counts.append(stepped.results.info["warnings"])
    assert counts == [0, 1, 1, 2]


@both
def test_two_instances_are_told_apart(version: int, tmp_path: Path) -> None:
    fmu = talker(tmp_path / "t.fmu", "WARNS", version=version)
    system = system_of(a=fmu, b=fmu)
    results = simulate(system, 2.0, 0.5, log=Log("warning", file=tmp_path / "log"))
    assert [results.info["messages"][name]["warnings"] for name in "ab"] == [2, 2]
    assert lines(tmp_path / "log") == [
        f"t = {t} s: {name}: warning: [logTable] {t} is outside of the table" for t in (0.5, 1.5) for name in "ab"
    ]


# From wherever they come


@both
def test_a_flood_is_counted_in_little_memory(version: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The log keeps its first and its last lines, and says what is missing."""
    monkeypatch.setattr(cosim.fmi.message_log, "MOST_LOG_BYTES", 10_000)
    n = 20_000
    results = run(talker(tmp_path / "t.fmu", f"FLOOD={n}", version=version), Log("warning", file=tmp_path / "log"))
    assert results.info["warnings"] == n
    assert [(first["text"], first["count"]) for first in said(results)["first"]] == [("0 is outside of the table", n)]
    assert "10000 bytes" in results.info["log"]["incomplete"]
    written = lines(tmp_path / "log")
    (note,) = [i for i, line in enumerate(written) if line.startswith("---")]
    assert [line.split()[7] for line in written[:note]] == [str(i) for i in range(note)]
    assert [line.split()[7] for line in written[note + 1 :]] == [str(i) for i in range(n - 1000, n)]
    assert f" {n - note - 1000} messages are left out" in written[note]


@both
def test_messages_come_from_threads(version: int, tmp_path: Path) -> None:
    results = run(talker(tmp_path / "t.fmu", "THREADS=8", version=version), Log("warning", file=tmp_path / "log"))
    assert said(results)["warnings"] == 8000
    written = lines(tmp_path / "log")
    assert len(written) == 8000
    assert set(written) == {f"t = 0 s: m: warning: [logThread] from a thread: {i}" for i in range(1000)}


@both
def test_odd_messages_become_lines(version: int, tmp_path: Path) -> None:
    results = run(talker(tmp_path / "t.fmu", "ODD", version=version), Log(file=tmp_path / "log"))
    assert said(results)["warnings"] == 5
    assert said(results)["info"] == 1  # a note without a text says nothing
    first = "t = 0 s: m:"
    assert lines(tmp_path / "log") == [
        f"{first} info: [logEvents] the first step, at 0 s",
        f"{first} warning: [logOdd] two lines and \\x1b[31mred\\x1b[0m",
        f"{first} warning: [log\ufffd] no UTF-8: \ufffd( \ufffd",
        f"{first} warning: (a message without text)",
        f"{first} status 77: [logOdd] a status that FMI does not have",
        f"{first} warning: [logOdd] pressure ü 1.500 bar, 100%",
    ]
    json.dumps(results.info)


@both
def test_a_message_of_an_instance_that_is_gone_arrives(version: int, tmp_path: Path) -> None:
    """An FMU may keep the callbacks of an instance in a global variable, and use them when it is gone."""
    fmu = load("m", talker(tmp_path / "t.fmu", "LATE", version=version))
    fmu.unpack(tmp_path / "unpacked")
    messages = Messages("first")
    first = Instance("first", tmp_path / "unpacked", fmu.description, messages=messages)
    second = Instance("second", tmp_path / "unpacked", fmu.description)
    first.instantiate()
    second.instantiate()
    first.close()
    del first
    gc.collect()
    others = [bytearray(n) for n in range(1, 200) for _ in range(100)]  # take the memory that is free now
    flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)] + [ctypes.byref(ctypes.c_double())]
    second.call(f"fmi{version}DoStep", 0.0, 0.5, True, *(flags if version == 3 else ()))
    second.close()
    assert others
    about = messages.about()
    assert about is not None
    assert [(kind["time"], kind["text"]) for kind in about["first"]] == [(None, "after its end")]


def test_messages_that_nobody_awaits_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmu = load("m", talker(tmp_path / "t.fmu", "LATE"))
    fmu.unpack(tmp_path / "unpacked")
    first, second = (Instance(name, tmp_path / "unpacked", fmu.description) for name in ("first", "second"))
    first.instantiate()
    second.instantiate()
    first.close()
    del first
    gc.collect()
    second.call("fmi2DoStep", 0.0, 0.5, True)
    second.close()
    assert capsys.readouterr().err == "first: warning: after its end\n"


def test_a_message_with_a_wrong_environment_goes_by_the_name(tmp_path: Path) -> None:
    fmu = talker(tmp_path / "t.fmu", "STRAY", "WARNS")
    results = simulate(system_of(a=fmu, b=fmu), 2.0, 0.5)
    assert [results.info["messages"][name]["warnings"] for name in "ab"] == [2, 2]


def test_another_host_in_the_process_takes_no_messages_away(tmp_path: Path) -> None:
    """FMPy's logger is one in a process, the last that was given to it."""
    theirs: list[bytes] = []
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *arguments: theirs.append(arguments[-1]))
    fmu = talker(tmp_path / "t.fmu", "WARNS")
    with Simulation(system_of(m=fmu)) as simulation:
        fmi2.addLoggerProxy(ctypes.byref(callbacks))
        assert simulation.run(2.0, 0.5).info["warnings"] == 2
    assert theirs == []


# Errors


@both
def test_an_error_has_the_last_messages(version: int, tmp_path: Path) -> None:
    with pytest.raises(SimulationError) as error:
        run(talker(tmp_path / "t.fmu", "FAILS", version=version))
    assert error.value.log == "the step shrank to 1e-09 s; no convergence at 1.5 s"
    assert str(error.value).endswith(error.value.log)
    assert error.value.results is not None
    about = error.value.results.info["messages"]["m"]
    assert (about["warnings"], about["errors"]) == (1, 1)
    assert [first["time"] for first in about["first"]] == [1.5, 1.5]


# Levels and categories


@pytest.mark.parametrize(
    ("level", "expected"),
    [
        ("none", None),
        ("error", ["error"]),
        ("warning", ["warning", "error"]),
        ("info", ["info", "warning", "error"]),
    ],
)
def test_a_level_says_what_is_written(level: str, expected: list[str] | None, tmp_path: Path) -> None:
    with pytest.raises(SimulationError):
        run(talker(tmp_path / "t.fmu", "FAILS"), Log(level, file=tmp_path / "log"))
    if expected is None:
        assert not (tmp_path / "log").exists()
    else:
        assert [line.split(": ")[2] for line in lines(tmp_path / "log")] == expected


@both
def test_an_fmu_is_asked_for_categories_only_when_they_are_wanted(version: int, tmp_path: Path) -> None:
    fmu = talker(tmp_path / "t.fmu", "WARNS", version=version)

    def log_of(log: Log) -> list[str]:
        run(fmu, log, steps=2)
        return [line.partition(": m: ")[2] for line in lines(tmp_path / "log")]

    path = tmp_path / "log"
    info = "info: [logEvents] the first step, at 0 s"
    warning = "warning: [logTable] 0.5 is outside of the table"
    assert log_of(Log("info", file=path)) == [info, warning]
    assert log_of(Log("all", file=path)) == ["info: [logEvents] asked for: everything", info, warning]
    asked = "info: [logTable] asked for: logTable"
    assert log_of(Log("info", ["logTable"], path)) == [asked, warning]
    assert log_of(Log("warning", ["logEvents"], path)) == []


def test_categories_are_those_of_each_fmu(tmp_path: Path) -> None:
    a = talker(tmp_path / "a.fmu", categories=["logA", "logBoth"])
    b = talker(tmp_path / "b.fmu", categories=["logBoth"])
    log = Log(categories=["logA", "logBoth"], file=tmp_path / "log")
    simulate(system_of(a=a, b=b), 0.5, 0.5, log=log)
    assert lines(tmp_path / "log") == [
        "outside the run: a: info: [logA] asked for: logA logBoth",
        "outside the run: b: info: [logBoth] asked for: logBoth",
    ]


def test_a_category_that_no_fmu_has_is_refused(tmp_path: Path) -> None:
    a, none = talker(tmp_path / "a.fmu"), talker(tmp_path / "none.fmu", categories=())
    log = Log(categories=["logTables"])
    with pytest.raises(SetupError, match="no FMU has a log category 'logTables'; did you mean 'logTable'"):
        run(a, log)
    run(none, log)  # one that lists none may have it, but is not asked


def test_an_fmu_that_takes_no_choice_runs_all_the_same(tmp_path: Path) -> None:
    results = run(talker(tmp_path / "t.fmu", "REFUSES"), "all")
    assert results.info["status"] == "completed"
    assert texts(results) == ["fmi2SetDebugLogging returned error; it says what it likes"]


def test_an_fmu_that_offers_no_choice_is_not_asked(tmp_path: Path) -> None:
    assert run(tank(tmp_path / "tank.fmu"), "all").info["messages"] == {}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"level": "debug"}, "log level 'debug': choose none, error, warning, info, all"),
        ({"categories": "logTable"}, r"must be a list of names: \['logTable'\]"),
        ({"level": "none", "categories": ["logTable"]}, "mean nothing at level 'none'"),
    ],
)
def test_a_log_that_makes_no_sense_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(SetupError, match=message):
        Log(**arguments)


def test_a_log_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    fmu = talker(tmp_path / "t.fmu")
    with pytest.raises(SetupError, match="can't write the log"):
        run(fmu, Log(file=tmp_path / "no folder" / "log"))


def test_without_a_file_messages_go_to_the_logger_of_python(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "cosim.messages"):
        run(talker(tmp_path / "t.fmu", "WARNS"), "info", steps=2)
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [
        ("INFO", "t = 0 s: m: info: [logEvents] the first step, at 0 s"),
        ("WARNING", "t = 0.5 s: m: warning: [logTable] 0.5 is outside of the table"),
    ]


# On the command line


@pytest.mark.usefixtures("no_figures")
def test_a_run_shows_warnings_and_keeps_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmu, out = talker(tmp_path / "t.fmu", "WARNS"), tmp_path / "out"
    command = ["run", str(fmu), "--step", "0.5", "--stop", "2", "--out", str(out)]
    assert main([*command, "--log", "warning"]) == 0
    note = "note: t: 2 warnings from its FMU: '0.5 is outside of the table' (2 times, first at t = 0.5 s)\n"
    assert note in capsys.readouterr().out
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert (summary["warnings"], summary["messages"]["t"]["warnings"]) == (2, 2)
    assert summary["log"] == {"level": "warning", "categories": [], "file": "messages.log"}
    log = (out / "messages.log").read_bytes()
    assert summary["files"]["messages.log"] == hashlib.sha256(log).hexdigest()
    assert log.count(b"\n") == 2
    assert main(command) == 0
    assert note in capsys.readouterr().out
    assert not (out / "messages.log").exists()  # it belonged to the run before


@pytest.mark.usefixtures("no_figures")
def test_categories_on_the_command_line(tmp_path: Path) -> None:
    fmu, out = talker(tmp_path / "t.fmu", "WARNS"), tmp_path / "out"
    command = ["run", str(fmu), "--step", "0.5", "--stop", "2", "--out", str(out)]
    assert main([*command, "--log-categories", "logTable,logEvents"]) == 0
    assert lines(out / "messages.log")[0].endswith("asked for: logTable logEvents")


@pytest.mark.usefixtures("no_figures")
def test_the_log_of_a_run_that_fails_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmu, out = talker(tmp_path / "t.fmu", "FAILS"), tmp_path / "out"
    assert main(["run", str(fmu), "--step", "0.5", "--stop", "5", "--out", str(out), "--log", "error"]) == 1
    assert "no convergence at 1.5 s" in capsys.readouterr().err
    assert lines(out / "messages.log") == ["t = 1.5 s: t: error: [logSolver] no convergence at 1.5 s"]


def test_the_log_of_a_run_without_results_is_kept_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    fmu, out = talker(tmp_path / "t.fmu", "STARTLESS"), tmp_path / "out"
    command = ["run", str(fmu), "--step", "0.5", "--stop", "5", "--out", str(out)]
    assert main([*command, "--log", "info"]) == 1
    error = capsys.readouterr().err
    assert "no initial state: 3 residuals; what the FMUs said is in " in error
    assert error.count("\n") == 1
    line = "t = 0 s: t: error: [logSolver] no initial state: 3 residuals"
    assert lines(Path(error.split()[-1])) == [line, "--- the FMUs start afresh ---", line]  # with a tolerance
    assert list(out.iterdir()) == []


@pytest.mark.usefixtures("no_figures")
def test_a_warning_that_the_terminal_cannot_show_ends_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", terminal)
    fmu, out = talker(tmp_path / "t.fmu", "ODD"), tmp_path / "out"
    assert main(["run", str(fmu), "--step", "0.5", "--stop", "2", "--out", str(out)]) == 0
    terminal.flush()
    assert b"no UTF-8: \\ufffd( \\ufffd" in terminal.buffer.getvalue()  # type: ignore[attr-defined]


def test_a_log_goes_on_where_its_file_was_moved_to_also_one_that_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cosim.fmi.message_log.MOST_LOG_BYTES", 30)
    here, there = tmp_path / "here.log", tmp_path / "there.log"
    writer = cosim.fmi.message_log.LogWriter(Log("info", file=here))
    writer.open()
    for text in ("one", "two"):
        writer.write(1.0, "a", 0, "ok", "", text)
    with writer.moving(lambda: there):
        here.rename(there)
    writer.write(2.0, "a", 0, "ok", "", "three")
    writer.close()
    full = "--- 0 messages are left out here: the log reached 30 bytes ---"
    lines = ["t = 1 s: a: ok: one", full, "t = 1 s: a: ok: two", full, "t = 2 s: a: ok: three"]
    assert there.read_text().splitlines() == lines
    assert not here.exists()
