"""The process that draws: it starts beside a run, draws the same, outlives a bad folder, and ends with its context."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cosim.results.figure_process import FigureProcess, as_drawn
from cosim.results.output import OutputError
from cosim.results.results import Results
from parallel_robot.figures import write_figures
from tests.support import some
from tests.support.patience import PATIENCE, wait_for
from tests.support.robot_results import made

PLANT = ("plant",)
DRAWING = "parallel_robot.figures:write_figures"


def test_the_process_draws_the_same(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    results = made()
    with FigureProcess() as process:
        process.start()
        written = process.write(DRAWING, results, ("a title", 8.0), tmp_path / "there")
    for path in some(write_figures(results, "a title", 8.0, tmp_path / "here")):
        assert (tmp_path / "there" / path.name).read_bytes() == path.read_bytes()
        assert tmp_path / "there" / path.name in written


def test_after_a_folder_that_can_t_be_written_another_is(tmp_path: Path) -> None:
    with FigureProcess() as process:
        with pytest.raises(FileNotFoundError, match="nowhere"):
            process.write(DRAWING, made(20, PLANT), ("t", 8.0), tmp_path / "nowhere")
        assert tmp_path / "closure_error.png" in process.write(DRAWING, made(20, PLANT), ("t", 8.0), tmp_path)


def test_an_error_in_drawing_reaches_the_caller(tmp_path: Path) -> None:
    uneven = Results(made(20).time, ["plant.closure_error"], made(10).values[:, :1])
    with FigureProcess() as process, pytest.raises(ValueError, match="same first dimension"):
        process.write(DRAWING, uneven, ("t", 8.0), tmp_path)


def test_a_process_that_was_ended_is_one_line(tmp_path: Path) -> None:
    with FigureProcess() as process:
        process.start()
        assert process._process is not None
        process._process.kill()
        process._process.wait()
        with pytest.raises(OutputError, match="the process that draws figures ended with exit code") as error:
            process.write(DRAWING, made(20, PLANT), ("t", 8.0), tmp_path)
    assert "\n" not in str(error.value)


def test_the_process_ends_with_its_context_even_while_it_starts() -> None:
    with FigureProcess() as process:
        process.start()
    assert process._process is not None
    assert process._process.poll() is not None


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL")
def test_the_process_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    code = (
        "from cosim.results.figure_process import FigureProcess\n"
        "import time\n"
        "with FigureProcess() as process:\n"
        "    process.start()\n"
        "    print(process._process.pid, flush=True)\n"
        "    time.sleep(3600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        parent.kill()
    wait_for(lambda: not _runs(child))


def _runs(pid: int) -> bool:
    """Whether a process runs; one that has ended and was not asked for its exit code does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_modules_in_the_working_folder_are_not_taken_for_others(tmp_path: Path, monkeypatch) -> None:
    for name in ("matplotlib", "numpy", "pickle"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('the wrong one')", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with FigureProcess() as process:
        assert process.write(DRAWING, made(20, PLANT), ("t", 8.0), tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="no groups of processes")
@pytest.mark.parametrize("delay", [0.1, *(pytest.param(delay, marks=pytest.mark.slow) for delay in (0.02, 0.3))])
def test_ctrl_c_in_a_terminal_is_one_line(robot_fmus: Path, tmp_path: Path, delay: float) -> None:
    """It goes to all processes of the terminal's group; only the program may speak of it."""
    arguments = ["run", "--stop", "600", "--fmus", str(robot_fmus)]
    code = f"from cosim.__main__ import main; print(flush=True); raise SystemExit(main({arguments!r}))"
    command = [sys.executable, "-c", code]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=tmp_path, stdout=pipe, stderr=pipe, text=True, process_group=0) as program:
        assert program.stdout is not None
        program.stdout.readline()
        time.sleep(delay)
        os.killpg(program.pid, signal.SIGINT)
        _, said = program.communicate(timeout=PATIENCE)
    assert program.returncode == 130
    assert said.count("\n") == 1
    assert said.startswith("cosim: interrupted")


def test_a_figure_gets_about_as_many_points_as_it_can_show() -> None:
    results = made(rows=40_001, components=PLANT)
    seen = as_drawn(results)
    assert 2000 < len(seen.time) < 4000
    assert seen.time[0] == 0.0
    assert seen.time[-1] == pytest.approx(10.0, abs=0.01)
    assert len(as_drawn(made(rows=3999)).time) == 3999
