"""`cosim sweep` as people use it: what it prints, what it refuses, Ctrl-C, and going on after it."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.__main__ import main
from cosim.commands.sweep import sweep_progress
from cosim.sweep.store import read
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.patience import PATIENCE, wait_for

ROOT = Path(__file__).parents[2]

#: Simulated time (s): seconds of work for a few hundred runs, with fast FMUs and with slow ones.
STOP_TIME = "0.2" if DEFAULT_FLAVOUR == "pythonfmu" else "4"


@pytest.fixture
def here(robot_fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the FMUs in `fmus`."""
    (tmp_path / "fmus").symlink_to(robot_fmus, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def sweep(*arguments: str, **options) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "cosim", "sweep", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment, **options)


@pytest.mark.slow
def test_a_sweep_with_failing_runs_says_so_and_is_a_success(here):
    started = sweep("--vary", "controller.alpha=0.5,1", "--vary", "plant.X=-1,1", "--seeds", "1:2", "--stop", "0.1")
    out, err = started.communicate(timeout=PATIENCE)
    assert (started.returncode, err) == (0, "")
    lines = dict(line.split(maxsplit=1) for line in out.splitlines())
    assert list(lines) == ["runs", "failed", "rate", "results"]
    assert lines["runs"] == "8 of 8, 8 of them now"
    assert lines["failed"].startswith("4; the first: point 0: start value of 'plant.X': -1.0 is out of bounds")
    assert re.match(r"[\d.]+ runs a second on \d+ workers?, [\d.]+ s", lines["rate"])
    assert lines["results"].startswith("results/sweep-tracking ")
    table = read(Path("results/sweep-tracking")).to_pylist()
    assert [(r["seed"], r["controller.alpha"], r["plant.X"]) for r in table] == [
        (s, a, x) for s in (1, 2) for a in (0.5, 1.0) for x in (-1.0, 1.0)
    ]
    assert [r["error"] is None for r in table] == [False, True] * 4
    assert [r["tracking.x.max"] is None for r in table] == [True, False] * 4


@pytest.mark.slow
def test_steps_are_varied_and_errors_over_time_kept(here):
    started = sweep("--step", "0.001,0.002", "--curves", "0.01", "--stop", "0.1", "--workers", "1")
    assert started.wait(timeout=PATIENCE) == 0
    started.communicate()
    table = read(Path("results/sweep-tracking"))
    assert table["step_size"].to_pylist() == [0.001, 0.002]
    assert [len(curve) for curve in table["tracking.y.curve"].to_pylist()] == [11, 11]


@pytest.mark.slow
def test_ctrl_c_in_a_terminal_ends_it_in_one_line_and_the_same_command_goes_on(here):
    command = ("--vary", "controller.alpha=0.5:3:160", "--stop", STOP_TIME, "--workers", "2", "--out", "out")
    started = sweep(*command, start_new_session=True)
    wait_for(lambda: started.poll() is not None or list(Path("out/results").glob("part-*")))
    assert started.poll() is None
    os.killpg(started.pid, signal.SIGINT)  # as a terminal does: all processes get it
    out, err = started.communicate(timeout=PATIENCE)
    assert started.returncode == 130
    assert err == "cosim: interrupted; the same command goes on where it stopped\n"
    done = read(Path("out")).num_rows
    assert 1 <= done < 160
    assert out.startswith(f"runs      {done} of 160, {done} of them now\n")

    started = sweep(*command)
    out, err = started.communicate(timeout=PATIENCE)
    assert (started.returncode, err) == (0, "")
    assert out.startswith(f"runs      160 of 160, {160 - done} of them now\n")
    assert read(Path("out"))["index"].to_pylist() == list(range(160))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "nothing is varied"),
        (["--vary", "controller.alpha"], "is not a factor"),
        (["--vary", "controller.alpha=3:1"], "is empty"),
        (["--vary", "controller.alpha=nan,1"], "not a finite number"),
        (["--vary", "controller.alpha=0:1"], "a grid needs levels of controller.alpha"),
        (["--vary", "controller.alpha=0:1", "--design", "sobol"], "--points"),
        (["--vary", "controller.alpha=0,1", "--points", "5"], "leave out --points"),
        (["--vary", "controller.alpha=0,1", "--vary", "controller.alpha=2"], "varied twice"),
        (["--vary", "controller.alfa=0,1"], "did you mean 'alpha'?"),
        (["--vary", "plant.tau_a=0,1"], "a connection or a signal feeds it"),
        (["--vary", "plant.tau_d.rsm=0,1"], "did you mean 'rms'?"),
        (["--seeds", "5:1"], "smaller number first"),
        (["--seeds=-3:1"], "0 or greater"),
        (["--seeds", "1:2", "--flavour", "fmi4"], "did you mean 'fmi"),
        (["--seeds", "1:2", "--fmu", "controller"], "COMPONENT=FILE"),
        (["--seeds", "1:2", "--fmu", "controller=nowhere.fmu"], "nowhere.fmu"),
        (["--seeds", "1:2", "--step", "0.07"], "not a whole number of steps"),
        (["--step", "0.001,0.07"], "not a whole number of steps of 0.07 s"),
        (["--step", "0.001:0.002"], "a range; write H,H"),
        (["--step", "0"], "nothing is varied"),
        (["--step", "0.001,0.002", "--curves", "0.003"], "need steps that divide it, not 0.002 s"),
        (["--seeds", "1:2", "--stop", "nan"], "not a finite number"),
        (["--seeds", "1:2", "--workers", "0"], "at least one"),
        (["--seeds", "1:2", "--out", "fmus/fmi2/RobotPlant.fmu/x"], "choose another --out"),
        (["trakcing", "--seeds", "1:2"], "did you mean 'tracking'?"),
        (["pd", "pd", "--seeds", "1:2"], "named twice"),
        (["open-loop", "--vary", "controller.alpha=0,1"], "scenario open-loop: "),
    ],
)
def test_what_makes_no_sense_is_one_line_before_anything_starts(here, capsys, arguments, says):
    assert main(["sweep", *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("cosim: ")
    assert says in err
    assert err.count("\n") == 1
    assert list(Path("results").rglob("part-*")) == []


@pytest.mark.slow
def test_the_folder_of_another_sweep_is_refused(here, capsys):
    started = sweep("--vary", "controller.alpha=0.5", "--stop", "0.01", "--workers", "1", "--out", "out")
    assert started.wait(timeout=PATIENCE) == 0
    started.communicate()
    assert main(["sweep", "--vary", "controller.alpha=0.6", "--stop", "0.01", "--out", "out"]) == 1
    assert "out holds another sweep (other points_sha256)" in capsys.readouterr().err
    assert main(["sweep", "--vary", "controller.alpha=0.5", "--stop", "0.02", "--out", "out"]) == 1
    assert "out holds another sweep (other scenarios)" in capsys.readouterr().err
    assert main(["sweep", "--vary", "controller.alpha=0.5", "--stop", "0.01", "--out", "out"]) == 0
    assert capsys.readouterr().out.startswith("runs      1 of 1, 0 of them now\n")


def test_help_explains_with_examples(capsys):
    with pytest.raises(SystemExit) as done:
        main(["sweep", "--help"])
    assert done.value.code == 0
    out = " ".join(capsys.readouterr().out.split())
    for text in ("LOW:HIGH", "FIRST:LAST", "examples:", "--scheduler", "Latin hypercube", "resumes"):
        assert text in out


def test_the_program_starts_without_dask_and_arrow():
    code = (
        "import sys, cosim.__main__; "
        "print(sorted({m.partition('.')[0] for m in sys.modules} & {'dask', 'distributed', 'pyarrow', 'scipy'}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_progress_bar_has_rate_and_time_left_and_counts_from_what_was_there(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    now = [100.0]
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    with sweep_progress(1000) as progress:
        progress(400, 2)
        now[0] += 0.2
        progress(420, 2)
        now[0] += 0.2
        progress(430, 0)
    text = sys.stderr.getvalue()
    assert "40%" in text
    assert "400/1000" in text
    assert "430/1000" in text
    assert "waiting for workers" in text
    assert re.findall(r"([\d.]+) runs/s", text)[-1] == "75.00"


def test_there_is_no_bar_where_there_is_no_terminal(capsys):
    with sweep_progress(1000) as progress:
        progress(400, 2)
    assert capsys.readouterr().err == ""
