"""`cosim run --checkpoint EVERY` and `--resume`: a run that was killed comes to the files of one that was not."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Results, StoredResults
from cosim.__main__ import main
from cosim.commands import execution
from cosim.master.state import RunState
from parallel_robot.ssp import write_robot_ssp
from tests.support.descriptions import without_capability
from tests.support.tiny_models import INTEGRATOR
from tests.support.tiny_models import build as build_tiny

TANK = """
title = "a tank"
[run]
stop_time = 20.0
step_size = 1e-3
[components]
tank = {fmu = "Integrator.fmu"}
[signals."tank.u"]
shape = "noise"
rms = 1.0
"""

SCRIPT = """
import sys
from cosim.__main__ import main
from cosim.commands import execution
execution.MOST_VALUES_IN_MEMORY = int(sys.argv[1])
sys.exit(main(sys.argv[2:]))
"""


@pytest.fixture(scope="module")
def material(robot_fmus: Path, native_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """FMUs in all flavours, an SSP, a scenario of another system."""
    folder = tmp_path_factory.mktemp("material")
    for flavour, source in (("fmi2", native_fmus), ("fmi3", native_fmus), ("pythonfmu", robot_fmus)):
        shutil.copytree(source / flavour, folder / "fmus" / flavour)
    write_robot_ssp(folder / "loop.ssp", folder / "fmus", "fmi2")
    build_tiny(folder, INTEGRATOR)
    (folder / "tank.toml").write_text(TANK, encoding="utf-8")
    times = np.linspace(0.0, 20.0, 201)
    rows = "\n".join(f"{t!r},{u!r}" for t, u in zip(times.tolist(), np.sin(times).tolist(), strict=True))
    (folder / "in.csv").write_text(f"time,u\n{rows}\n", encoding="utf-8")
    return folder


@pytest.fixture
def here(material: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with all of that."""
    for path in material.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def point_of(folder: str) -> int:
    path = Path(folder) / "checkpoint" / "run.state"
    return RunState.read(path).point if path.exists() else -1


def end_after_a_checkpoint(command: list[str], out: str, how: signal.Signals, most: int) -> subprocess.Popen[str]:
    """A run in another process, which a signal ends when it has gone on from where it began."""
    before = point_of(out)
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(most), *command, "--out", out],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        while process.poll() is None and point_of(out) <= max(before, 0):
            pass
        os.kill(process.pid, how)
        process.communicate(timeout=120)
    finally:
        process.kill()
        process.wait()
    return process


def said(folder: str) -> dict[str, Any]:
    """The summary, without what two runs do not have in common."""
    summary: dict[str, Any] = json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"))
    assert 0.0 < summary.pop("loop_time_s") <= summary.pop("wall_time_s")
    return summary


def is_the_same(folder: str, expected: str) -> None:
    """All files are there with the same bytes, and nothing else."""
    names = {path.name for path in Path(expected).iterdir()}
    assert {path.name for path in Path(folder).iterdir()} == names
    for name in names - {"summary.json"}:
        assert (Path(folder) / name).read_bytes() == (Path(expected) / name).read_bytes(), name
    assert said(folder) == said(expected)


RUNS: dict[str, list[str]] = {
    "scenario": ["run", "tracking", "--stop", "12", "--record-every", "3"],
    "fmi3": ["run", "tracking", "--stop", "12", "--flavour", "fmi3", "--order", "parallel"],
    "pythonfmu": ["run", "tracking", "--stop", "0.3", "--flavour", "pythonfmu"],
    "own": ["run", "tank.toml", "--set", "tank.T=2", "--seed", "3"],
    "streamed": ["run", "tank.toml", "--format", "csv", "--format", "parquet"],
    "fmu": ["run", "Integrator.fmu", "--input", "in.csv", "--stop", "20", "--step", "1e-3", "--format", "mat"],
    "ssp": ["run", "loop.ssp", "--stop", "12", "--step", "1e-3", "--format", "parquet", "--format", "npz"],
}


@pytest.mark.parametrize(
    ("kind", "most", "kills"),
    [
        pytest.param("scenario", 10**7, 2, marks=pytest.mark.slow),
        pytest.param("pythonfmu", 10**7, 1, marks=pytest.mark.slow),
        pytest.param("fmu", 10**7, 1, marks=pytest.mark.slow),
        pytest.param("ssp", 10**7, 1, marks=pytest.mark.slow),
        ("streamed", 1000, 1),
        pytest.param("fmi3", 10**7, 2, marks=pytest.mark.slow),
        pytest.param("own", 10**7, 2, marks=pytest.mark.slow),
        pytest.param("streamed", 1000, 3, marks=pytest.mark.slow),
    ],
)
@pytest.mark.usefixtures("no_figures", "here")
def test_a_run_that_was_killed_leaves_the_files_of_one_that_was_not(
    monkeypatch: pytest.MonkeyPatch, kind: str, most: int, kills: int
) -> None:
    command = RUNS[kind]
    monkeypatch.setattr(execution, "MOST_VALUES_IN_MEMORY", most)
    assert main([*command, "--out", "whole"]) == 0
    every = "0.002" if kind == "pythonfmu" else "0.02"
    for i in range(kills):
        options = ["--checkpoint", every, *(["--resume"] if i else [])]
        process = end_after_a_checkpoint([*command, *options], "killed", signal.SIGKILL, most)
        assert process.returncode == -signal.SIGKILL
    assert main([*command, "--checkpoint", "5", "--resume", "--out", "killed"]) == 0
    is_the_same("killed", "whole")


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_figures_are_those_of_a_run_that_was_not_killed() -> None:
    command = ["run", "tracking", "--stop", "6"]
    assert main([*command, "--out", "whole"]) == 0
    process = end_after_a_checkpoint([*command, "--checkpoint", "0.01"], "killed", signal.SIGKILL, 10**7)
    assert process.returncode == -signal.SIGKILL
    assert main([*command, "--checkpoint", "5", "--resume", "--out", "killed"]) == 0
    assert len(list(Path("killed").glob("*.png"))) == 5
    is_the_same("killed", "whole")


@pytest.mark.usefixtures("no_figures", "here")
def test_ctrl_c_keeps_what_was_recorded_and_a_last_checkpoint(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "tank.toml", "--stop", "2000"]
    with pytest.MonkeyPatch.context() as patched:
        press(patched, after=1.0)
        assert main([*command, "--checkpoint", "1000", "--out", "r"]) == 130
    line = capsys.readouterr().err
    assert line.startswith("cosim: interrupted at t = ")
    assert line.endswith("; what was recorded is in r; --resume goes on from its last checkpoint\n")
    time = float(line.split("t = ")[1].split(" s")[0])
    assert point_of("r") == round(time * 1000)
    results = Results.from_csv("r/results.csv")
    assert results.time[-1] == pytest.approx(time, abs=1e-9)
    assert said("r")["status"] == "interrupted"
    stop = ["run", "tank.toml", "--stop", f"{math_ceil(time) + 1}"]
    assert main([*stop, "--resume", "--out", "r"]) == 0
    assert main([*stop, "--out", "whole"]) == 0
    is_the_same("r", "whole")
    whole = Results.from_csv("r/results.csv")
    assert whole.values[: len(results.time)].tobytes() == results.values.tobytes()


def math_ceil(time: float) -> int:
    return int(-(-time // 1))


def press(patched: pytest.MonkeyPatch, after: float) -> None:
    """Ctrl-C once, when the run has come so far (s)."""
    pressed: list[float] = []
    original = execution._progress

    def progress(plan: execution.Plan) -> Any:
        class Pressing:
            def __enter__(self) -> Callable[[float], None]:
                return self.report

            def __exit__(self, *_: object) -> None:
                pass

            def report(self, time: float) -> None:
                if time >= after and not pressed:
                    pressed.append(time)
                    signal.raise_signal(signal.SIGINT)

        return Pressing()

    assert original is not None
    patched.setattr(execution, "_progress", progress)


def error_line(capsys: pytest.CaptureFixture[str]) -> str:
    shown = capsys.readouterr().err
    assert shown.startswith("cosim: ")
    assert shown.count("\n") == 1
    return shown


@pytest.fixture
def unfinished(here: Path, no_figures: None, capsys: pytest.CaptureFixture[str]) -> dict[Path, bytes]:
    """The files of a run of the tank that was stopped, in the folder r."""
    with pytest.MonkeyPatch.context() as patched:
        press(patched, after=1.0)
        assert main(["run", "tank.toml", "--checkpoint", "0.5", "--out", "r"]) == 130
    capsys.readouterr()
    return files_in(Path("r"))


def files_in(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--step", "0.002"], "other communication step: 0.001 then, 0.002 now"),
        (["--set", "tank.T=2"], "other start value of tank.T: none then, 2.0 now"),
        (["--order", "parallel"], "other order: sequential then, parallel now"),
        (["--extrapolation", "hold"], "other extrapolation"),
        (["--record", "tank.x"], "other recorded variables"),
        (["--record-every", "2"], "other record_every: 1 then, 2 now"),
        (["--seed", "2"], "other signal of tank.u"),
        (["--start", "0.5"], "other start time: 0.0 then, 0.5 now"),
        (["--fmu", "tank=Other.fmu"], "other FMU file of tank"),
        (["--stop", "0.5"], "beyond the stop time"),
    ],
)
@pytest.mark.slow
def test_another_run_is_refused_in_a_line_that_names_what_differs(
    unfinished: dict[Path, bytes], capsys: pytest.CaptureFixture[str], options: list[str], says: str
) -> None:
    without_capability(Path("Integrator.fmu"), Path("Other.fmu"), "canHandleVariableCommunicationStepSize")
    assert main(["run", "tank.toml", "--resume", "--out", "r", *options]) == 1
    line = error_line(capsys)
    assert says in line
    assert "r/checkpoint/run.state" in line
    assert files_in(Path("r")) == unfinished
    assert main(["run", "tank.toml", "--resume", "--out", "r"]) == 0
    assert not Path("r/checkpoint").exists()


@pytest.mark.parametrize("options", [[], ["--checkpoint", "0.5"]])
def test_a_checkpoint_is_not_lost_to_a_run_that_does_not_resume_it(
    unfinished: dict[Path, bytes], capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    assert main(["run", "tank.toml", "--out", "r", *options]) == 1
    assert "r/checkpoint is the checkpoint of a run that has not ended; --resume that run" in error_line(capsys)
    assert files_in(Path("r")) == unfinished


@pytest.mark.usefixtures("no_figures", "here")
def test_nothing_to_resume_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "tank.toml", "--resume", "--out", "r"]) == 1
    assert error_line(capsys) == "cosim: r holds no checkpoint to resume; start the run with --checkpoint EVERY\n"
    assert main(["run", "tank.toml", "--stop", "1", "--checkpoint", "0.1", "--out", "r"]) == 0  # leaves none
    assert {path.name for path in Path("r").iterdir()} == {"results.csv", "summary.json"}
    capsys.readouterr()
    assert main(["run", "tank.toml", "--stop", "1", "--resume", "--out", "r"]) == 1
    assert "r holds no checkpoint to resume" in error_line(capsys)


@pytest.mark.parametrize("every", ["0", "-1", "nan", "inf"])
@pytest.mark.usefixtures("no_figures", "here")
def test_an_interval_that_makes_no_sense_is_one_line(capsys: pytest.CaptureFixture[str], every: str) -> None:
    assert main(["run", "tank.toml", f"--checkpoint={every}", "--out", "r"]) == 1
    assert "must be a positive number of simulated seconds" in error_line(capsys)


@pytest.mark.parametrize("capability", ["canGetAndSetFMUstate", "canSerializeFMUstate"])
@pytest.mark.usefixtures("no_figures", "here")
def test_an_fmu_without_states_is_refused_before_the_run(capsys: pytest.CaptureFixture[str], capability: str) -> None:
    without_capability(Path("Integrator.fmu"), Path("Poor.fmu"), capability)
    assert main(["run", "Poor.fmu", "--stop", "1", "--checkpoint", "0.1", "--out", "r"]) == 1
    line = error_line(capsys)
    assert f"component 'Poor': Poor.fmu can't save its state ({capability} is not set" in line
    assert list(Path("r").iterdir()) == []
    assert main(["run", "Poor.fmu", "--stop", "1", "--out", "r"]) == 0


@pytest.mark.usefixtures("no_figures", "here")
def test_a_full_disk_is_a_warning(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    original = RunState.write

    def write(state: RunState, path: Path) -> None:
        if state.point > 500:
            raise OSError(28, "No space left on device")
        original(state, path)

    monkeypatch.setattr(RunState, "write", write)
    assert main(["run", "tank.toml", "--stop", "2", "--checkpoint", "0.25", "--out", "r"]) == 0
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1
    assert shown.startswith("warning: no checkpoint at t = 0.75 s: [Errno 28] No space left on device; the run goes on")
    monkeypatch.undo()


@pytest.mark.usefixtures("no_figures", "here")
def test_real_time_and_checkpoints_go_together(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "tank.toml", "--stop", "0.1", "--checkpoint", "0.05", "--realtime", "10", "--out", "r"]) == 0
    assert "real time times 10: " in capsys.readouterr().out
    assert main(["run", "tank.toml", "--stop", "0.1", "--out", "whole"]) == 0
    assert Path("r/results.csv").read_bytes() == Path("whole/results.csv").read_bytes()


@pytest.mark.usefixtures("no_figures", "here")
def test_an_interrupted_long_run_has_its_rows_on_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "MOST_VALUES_IN_MEMORY", 1000)
    with pytest.MonkeyPatch.context() as patched:
        press(patched, after=1.0)
        assert main(["run", "tank.toml", "--checkpoint", "0.1", "--out", "r"]) == 130
    rows = StoredResults(Path("r/results.parquet"), {})
    assert len(rows.time) == point_of("r") + 1
    assert (rows["tank.x"] == Results.from_csv("r/results.csv")["tank.x"]).all()


def test_results_that_find_no_place_leave_the_checkpoint(
    unfinished: dict[Path, bytes], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run has ended, but its results are elsewhere: the same command tries again."""
    assert unfinished
    original = Results.to_csv

    def save(results: Results, path: Path, **options: Any) -> None:
        if path.is_relative_to("r"):
            raise OSError(28, "No space left on device")
        original(results, path, **options)

    with monkeypatch.context() as patched:
        patched.setattr(Results, "to_csv", save)
        assert main(["run", "tank.toml", "--resume", "--out", "r"]) == 1
    assert "the results are in" in error_line(capsys)
    assert main(["run", "tank.toml", "--resume", "--out", "r"]) == 0
    assert main(["run", "tank.toml", "--out", "whole"]) == 0
    is_the_same("r", "whole")
