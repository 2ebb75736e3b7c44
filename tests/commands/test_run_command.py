"""`cosim run`, end to end: what it writes, and that every failure is one line with nothing lost."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import json
import math
import os
import pty
import resource
import shutil
import signal
import subprocess
import sys
import termios
from functools import partial
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains
from cosim.__main__ import main
from cosim.commands import execution
from cosim.results.figure_process import FigureProcess
from cosim.results.results import Results
from cosim.results.stored import StoredResults
from cosim.system.system import System
from fmu_export.package.record import RECORD
from parallel_robot import fmus
from parallel_robot.choices import FLAVOURS
from parallel_robot.fmus import fmu_path
from parallel_robot.models import MODELS
from parallel_robot.scenario import FAMILY, load_scenario
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.patience import PATIENCE

FIGURES = ["path.png", "tracking_errors.png", "torques.png", "psi.png", "closure_error.png"]
#: dm = -5 sin(pi t) kg; the mass matrix loses its definiteness within the first tenth of a second.
INDEFINITE = """
title = "mass change out of bounds"
[run]
stop_time = 0.5
[signals."plant.dm"]
shape = "sine"
amplitude = -5.0
frequency = 0.5
[start.plant]
tau_d = [0.0, 0.0, 0.0]
"""


@pytest.fixture
def here(robot_fmus: Path, tmp_path, monkeypatch) -> Path:
    """An empty working folder with built FMUs in it and a folder of its own for temporary files."""
    shutil.copytree(robot_fmus / DEFAULT_FLAVOUR, tmp_path / "fmus" / DEFAULT_FLAVOUR)
    (tmp_path / "temporary").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    monkeypatch.setattr("tempfile.tempdir", None)
    return tmp_path


def cosim(*arguments: str, **options) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cosim", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False, **options)


def summary_of(folder: str | Path = "results/tracking") -> dict:
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"), parse_constant=refuse)


def error_line(capsys) -> str:
    shown = capsys.readouterr()
    assert shown.err.startswith("cosim: ")
    assert shown.err.count("\n") == 1, shown.err
    assert "Traceback" not in shown.err
    return shown.err


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def is_png(path: Path) -> bool:
    image = matplotlib.image.imread(path)  # decodes all of it and its checksums
    return image.ndim == 3 and min(image.shape[:2]) > 500 and float(np.ptp(image)) > 0.5


# A run that succeeds


def test_a_run_in_a_process_of_its_own_writes_all_it_promises(here):
    done = cosim("run", "--stop", "0.5")
    assert (done.returncode, done.stderr) == (0, "")
    folder = Path("results/tracking")
    assert sorted(p.name for p in folder.iterdir()) == sorted(["results.csv", "summary.json", *FIGURES])
    for name in FIGURES:
        assert is_png(folder / name)

    with (folder / "results.csv").open(encoding="utf-8", newline="") as stream:
        first_line = stream.readline()
        rows = [[float(cell) for cell in row] for row in csv.reader(stream)]
    names = first_line.rstrip("\n").split('","')
    assert first_line.startswith('"time","')
    assert first_line.endswith('"\n')
    assert {n.split(".")[0] for n in names[1:]} == {"plant", "controller", "trajectory"}
    assert len(set(names)) == len(names)
    for name in (
        "plant.x_E",
        "plant.theta_a[3]",
        "plant.F_c[6]",
        "plant.dm",
        "controller.tau_a[1]",
        "trajectory.x_ref",
    ):
        assert name in names
    assert len(rows) == 501
    assert {len(row) for row in rows} == {len(names)}
    assert [row[0] for row in rows] == [i * 1e-3 for i in range(501)]
    assert all(math.isfinite(v) for row in rows for v in row)
    # and the file is what the reader of the program makes of it
    assert Results.from_csv(folder / "results.csv").values.tolist() == [row[1:] for row in rows]

    summary = summary_of()
    assert summary["scenario"] == "tracking"
    assert (summary["step_size"], summary["stop_time"], summary["order"], summary["seed"]) == (
        1e-3,
        0.5,
        "sequential",
        1,
    )
    assert (summary["status"], summary["error"]) == ("completed", None)
    assert set(summary["fmus"]) == set(MODELS)
    for instance, fmu in summary["fmus"].items():
        assert fmu["sha256"] == digest(fmu_path(Path("fmus"), DEFAULT_FLAVOUR, instance))
    optimum = optimal_gains(PerformanceIndex())
    assert summary["parameters"]["controller.alpha"] == pytest.approx(optimum.alpha, rel=1e-12)
    assert summary["parameters"]["controller.beta"] == pytest.approx(optimum.beta, rel=1e-12)
    assert summary["parameters"]["plant.m_a"] == 1.2525
    assert 0.0 < summary["loop_time_s"] <= summary["wall_time_s"] < 100.0
    assert {"python", "platform", "numpy", "fmpy", "closed-chain-cosim"} <= set(summary["versions"])
    assert summary["versions"]["numpy"] == np.__version__
    assert summary["signals"]["plant.dm"] == {"shape": "sine", "amplitude": 0.25, "frequency": 0.5, "phase": 0.0}

    # metrics, once more from the file
    column = {name: np.array([row[i] for row in rows]) for i, name in enumerate(names)}
    error = np.abs(column["plant.x_E"] - column["trajectory.x_ref"])
    x = summary["metrics"]["tracking"]["x"]
    assert x["max"] == error.max()
    assert x["rms"] == pytest.approx(math.sqrt(sum(e * e for e in error) / 501), rel=1e-12)
    assert x["accumulated"] == pytest.approx(1e-3 * (error.sum() - 0.5 * (error[0] + error[-1])), rel=1e-12)
    assert x["steady_max"] is None
    assert summary["metrics"]["closure_error_max"] == column["plant.closure_error"].max()
    # the paper's start: E = (0.22, 0.30), about (-5, +5) mm from the desired start
    assert error[0] == pytest.approx(0.005, abs=1e-12)

    lines = done.stdout.splitlines()
    assert max(map(len, lines)) <= 100
    assert "0.5 s at 1 ms, sequential order" in lines[1]
    table = {line.split()[0]: line.split()[1:] for line in lines if line.split()[:1] and line.split()[0] in ("x", "y")}
    assert float(table["x"][0]) == pytest.approx(1e3 * x["max"], rel=1e-3)
    assert table["x"][1] == "mm"
    assert lines[-1] == "results, summary and figures: results/tracking"
    assert list((here / "temporary").iterdir()) == []


def test_two_runs_write_the_same_bytes(here, no_figures):
    assert main(["run", "--stop", "0.1", "--out", "a"]) == 0
    assert main(["run", "--stop", "0.1", "--out", "b"]) == 0
    assert Path("a/results.csv").read_bytes() == Path("b/results.csv").read_bytes()
    assert main(["run", "--stop", "0.1", "--out", "c", "--set", "controller.beta=1.7"]) == 0
    assert Path("a/results.csv").read_bytes() != Path("c/results.csv").read_bytes()


def test_a_folder_holds_one_run_and_what_is_the_user_s(here):
    assert main(["run", "--stop", "0.01", "--out", "r"]) == 0
    Path("r/notes.txt").write_text("mine")
    assert set(summary_of("r")["files"]) == {"results.csv", *FIGURES}
    assert main(["run", "open-loop", "--stop", "0.02", "--format", "parquet", "--out", "r"]) == 0
    files = summary_of("r")["files"]
    assert files == {name: digest(Path("r") / name) for name in files}
    assert {p.name for p in Path("r").iterdir()} == {*files, "summary.json", "notes.txt"}
    assert set(files) == {"results.parquet", "path.png", "torques.png", "closure_error.png"}


def test_a_long_run_takes_the_place_of_a_short_one(here, no_figures, monkeypatch):
    assert main(["run", "--stop", "0.01", "--format", "npz", "--out", "r"]) == 0
    monkeypatch.setattr(execution, "MOST_VALUES_IN_MEMORY", 1000)
    assert main(["run", "--stop", "0.2", "--out", "r"]) == 0
    files = summary_of("r")["files"]
    assert files == {name: digest(Path("r") / name) for name in ("results.csv", "results.parquet")}
    assert {p.name for p in Path("r").iterdir()} == {*files, "summary.json"}


def test_a_file_of_the_user_is_not_replaced(here, no_figures, capsys):
    Path("r").mkdir()
    Path("r/results.csv").write_text("mine")
    assert main(["run", "--stop", "0.01", "--out", "r"]) == 1
    assert "r/results.csv is there and belongs to no run" in error_line(capsys)
    assert [p.read_text() for p in Path("r").iterdir()] == ["mine"]


def test_a_run_that_fails_before_its_first_point_leaves_the_folder_as_it_was(here, no_figures, capsys):
    assert main(["run", "--stop", "0.01", "--out", "r"]) == 0
    before = {p: digest(p) for p in Path("r").iterdir()}
    capsys.readouterr()
    assert main(["run", "--stop", "0.02", "--out", "r", "--set", "plant.x_E_start=3"]) == 1
    error_line(capsys)
    assert {p: digest(p) for p in Path("r").iterdir()} == before


def test_the_seed_changes_the_disturbance_and_nothing_before_it(here, no_figures):
    Path("early.toml").write_text(
        "[start.plant]\ndm = 0.0\n[signals.'plant.tau_d']\nshape = 'multisine'\nrms = 0.01\nlowest = 0.5\n"
        "highest = 10.0\nstart_time = 0.05\n",
        encoding="utf-8",
    )
    for seed in ("1", "2"):
        assert main(["run", "early.toml", "--stop", "0.1", "--seed", seed, "--out", seed]) == 0
        assert summary_of(seed)["seed"] == int(seed)
    one, two = (Results.from_csv(f"{seed}/results.csv") for seed in "12")
    before = one.time < 0.05
    assert before.sum() == 50
    assert one.values[before].tolist() == two.values[before].tolist()
    assert not one["plant.tau_d"][before].any()
    assert (one["plant.tau_d"][~before] != two["plant.tau_d"][~before]).all()


def test_set_reaches_the_fmu_and_the_summary(here, no_figures):
    assert main(["run", "--stop", "0.05", "--out", "robust"]) == 0
    assert main(["run", "--stop", "0.05", "--out", "pd", "--set", "controller.alpha=0"]) == 0
    assert summary_of("robust")["parameters"]["controller.alpha"] > 1.0
    assert summary_of("pd")["parameters"]["controller.alpha"] == 0.0
    pd, robust = Results.from_csv("pd/results.csv"), Results.from_csv("robust/results.csv")
    assert not np.array_equal(pd["plant.tau_a"], robust["plant.tau_a"])
    # without the robust part (38) is -beta (theta_e' + S theta_e)
    theta_e = pd["controller.theta_a"] - pd["controller.theta_ref"]
    omega_e = pd["controller.omega_a"] - pd["controller.omega_ref"]
    expected = -summary_of("pd")["parameters"]["controller.beta"] * (omega_e + 2.0 * theta_e)
    assert pd["controller.tau_a"] == pytest.approx(expected, abs=1e-12)
    assert not np.allclose(robust["controller.tau_a"], expected, atol=1e-9)


def test_the_pd_scenario_is_tracking_with_alpha_set_to_zero(here, no_figures):
    assert main(["run", "pd", "--stop", "0.05", "--out", "a"]) == 0
    assert main(["run", "--stop", "0.05", "--out", "b", "--set", "controller.alpha=0"]) == 0
    assert Path("a/results.csv").read_bytes() == Path("b/results.csv").read_bytes()


def test_set_takes_whole_vectors_elements_and_repetition(here, no_figures):
    options = ["--set", "controller.S=3", "--set", "controller.S[2]=4", "--set", "plant.r_a=0.1"]
    assert main(["run", "--stop", "0.002", *options]) == 0
    parameters = summary_of()["parameters"]
    assert [parameters[f"controller.S[{i}]"] for i in (1, 2, 3)] == [3.0, 4.0, 3.0]
    assert parameters["plant.r_a"] == 0.1


def test_step_stop_and_order_of_the_command_line_win(here, no_figures, capsys):
    assert main(["run", "--stop", "0.02", "--step", "0.002", "--order", "parallel", "--coupling", "hold"]) == 0
    summary = summary_of()
    assert (summary["step_size"], summary["stop_time"], summary["order"]) == (0.002, 0.02, "parallel")
    assert Results.from_csv("results/tracking/results.csv").time.tolist() == pytest.approx(
        np.arange(11) * 0.002, abs=1e-17
    )
    assert "0.02 s at 2 ms, parallel order" in capsys.readouterr().out


def test_open_loop_has_no_tracking_errors_and_no_figures_of_them(here, capsys):
    assert main(["run", "open-loop", "--stop", "0.1"]) == 0
    assert sorted(p.name for p in Path("results/open-loop").iterdir()) == sorted(
        ["results.csv", "summary.json", "path.png", "torques.png", "closure_error.png"]
    )
    assert summary_of("results/open-loop")["metrics"]["tracking"] == {}
    assert "tracking error" not in capsys.readouterr().out
    tau_a = Results.from_csv("results/open-loop/results.csv")["plant.tau_a"]
    assert tau_a[[0, 100]] == pytest.approx(np.array([[0.1] * 3, [0.1 * math.cos(math.pi * 0.1)] * 3]), abs=1e-15)


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("text", ["components = ['trajectory']", "components = ['plant']\nstart.plant.tau_a = 0.0"])
def test_any_part_of_the_system_runs_alone(here, text):
    Path("alone.toml").write_text(
        text + ("\nstart.plant.tau_d = 0.0\nstart.plant.dm = 0.0\n" if "plant" in text else "\n"), encoding="utf-8"
    )
    assert main(["run", "alone.toml", "--stop", "0.01"]) == 0
    assert len(Results.from_csv("results/alone/results.csv").time) == 11
    assert summary_of("results/alone")["status"] == "completed"


def test_a_title_is_a_text_and_no_formula(here):
    Path("mine.toml").write_text(
        r"""title = 'gain $\nothing$ and 5'
components = ['plant']
start.plant = {dm = 0.0, tau_a = 0.0, tau_d = 0.0}""",
        encoding="utf-8",
    )
    assert main(["run", "mine.toml", "--stop", "0.01"]) == 0
    assert is_png(Path("results/mine/torques.png"))


def test_no_line_of_the_table_is_wider_than_100_characters_whatever_the_numbers():
    number = 1.234e-8  # four digits and an exponent
    error = dict.fromkeys(("max", "rms", "accumulated", "steady_max", "steady_rms"), number)
    summary = {
        "loop_time_s": 12345.678,
        "step_size": 1.25e-5,
        "extrapolation": {"mode": "auto", "linear": ["plant.tau_a[1]"], "hold": ["plant.tau_d[1]"] * 1000},
        "realtime": {"factor": 1.0, "overruns": 10**9, "lateness_max_s": 1.234e-5, "jitter_rms_s": 1.234e-5},
        "metrics": {
            "tracking": dict.fromkeys(("x", "theta_a[1]"), error),
            "control_effort": {"max": 1.234e-05, "integral": 1.234e-05},
            "closure_error_max": 1.2e-16,
        },
    }
    scenario = load_scenario("tracking")
    prepared = execution.PreparedRun(
        source="tracking",
        title=scenario.title,
        system=System(),
        plan=execution.Plan(scenario.stop_time, scenario.step_size),
        folder=Path("results/tracking"),
        about={},
        report=partial(FAMILY.report, scenario),
        drawing=FAMILY.drawing,
    )
    table = execution.in_words(prepared, summary)
    assert max(map(len, table.splitlines())) <= 100
    rows = [line for line in table.splitlines() if line.startswith(("tracking error", "x ", "theta_a"))]
    assert len({len(row) for row in rows}) == 1  # columns stay aligned


def test_a_run_over_2_s_shows_its_progress(here, no_figures, capsys, monkeypatch):
    clock = iter(range(0, 100000, 3))  # each look at the clock is 3 s after the one before
    monkeypatch.setattr("tqdm.std.time", lambda: float(next(clock)))
    assert main(["run", "--stop", "0.3"]) == 0
    assert "s simulated" not in capsys.readouterr().err  # no terminal, no bar
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main(["run", "--stop", "0.3"]) == 0
    assert "s simulated" in capsys.readouterr().err


# Options and scenarios that make no sense


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--step", "0"], ["step 0.0 s", "must be positive"]),
        (["--step", "-0.001"], ["step -0.001 s", "must be positive"]),
        (["--step", "nan"], ["step", "nan", "not a finite number"]),
        (["--step", "inf"], ["step", "inf", "not a finite number"]),
        (["--stop", "0.5", "--step", "0.3"], ["not a whole number of steps of 0.3 s", "stop at 0.3 s or 0.6 s"]),
        (["--stop", "0.5", "--step", "1"], ["not a whole number of steps of 1.0 s", "stop at 1 s"]),
        (["--stop", "-1"], ["stop time -1.0 s", "later than the start time"]),
        (["--stop", "0"], ["stop time 0.0 s", "later than the start time"]),
        (["--stop", "nan"], ["stop time", "nan"]),
        (["--stop", "0.5", "--step", repr(2.0**-50)], ["step"]),  # 4 PiB of times alone
        (["--stop", "0.5", "--step", repr(2.0**-1000)], ["step"]),
        (["--seed", "-1"], ["seed", "-1"]),
        (["trackng"], ["'trackng'", "did you mean 'tracking'?"]),
        (["nowhere.toml"], ["'nowhere.toml'"]),
        (["--set", "controller.alpha"], ["--set controller.alpha", "COMPONENT.NAME=VALUE"]),
        (["--set", "controller.alpha=much"], ["'controller.alpha'", "'much' is not a value of type Real"]),
        (["--set", "controller.alpha="], ["'controller.alpha'", "'' is not a value of type Real"]),
        (["--set", "alpha=1"], ["--set alpha=1", "COMPONENT.NAME=VALUE"]),
        (["--set", "contoller.alpha=1"], ["'contoller'", "did you mean 'controller'?"]),
        (["--set", "controller.alhpa=1"], ["'controller'", "'alhpa'", "did you mean 'alpha'?"]),
        (["--set", "controller.S[4]=1"], ["'controller'", "S[4]"]),
        (["--set", "controller.alpha=nan"], ["'controller.alpha'", "nan is not a finite number"]),
        (["--set", "controller.beta=inf"], ["'controller.beta'", "inf is not a finite number"]),
        (["--set", "controller.alpha=-1"], ["'controller.alpha'", "-1.0 is out of bounds", "at least 0.0"]),
        (["--set", "plant.x_E=1"], ["'plant.x_E'", "output"]),
        (["--set", "plant.x_E_start=3"], ["plant", "out of reach of chain", "move it to within 2 l of the base"]),
        (["--set", "trajectory.x_c=3"], ["trajectory", "leaves the reach of chain", "move or shrink it"]),
        (["--set", "plant.X=0.001"], ["plant", "X Y - Z^2 must be positive", "correct X, Y, Z"]),
        (["open-loop", "--set", "controller.alpha=1"], ["'controller'", "known are plant"]),
        (["--fmus", f"fmus/{DEFAULT_FLAVOUR}/RobotPlant.fmu"], ["RobotPlant.fmu", "--fmus"]),
    ],
    ids=lambda value: (
        " ".join(value) if isinstance(value, list) and value[0].startswith(("-", "tr", "no", "op")) else ""
    ),
)
def test_what_makes_no_sense_is_one_line_with_the_remedy(here, no_figures, capsys, options, expected):
    assert main(["run", *([] if "--stop" in options else ["--stop", "0.002"]), *options]) == 1
    line = error_line(capsys)
    for part in expected:
        assert part in line
    assert not list(Path("results").rglob("results.csv")) if Path("results").exists() else True
    assert list((here / "temporary").iterdir()) == []


@pytest.mark.parametrize(
    "options",
    [["--stpo"], ["--step", "x"], ["--order", "both"], ["--flavour", "fmi9"], ["--coupling", "x"], ["a", "b"]],
)
def test_unknown_options_are_exit_code_2(here, capsys, options):
    with pytest.raises(SystemExit) as ended:
        main(["run", *options])
    assert ended.value.code == 2
    assert options[-1] in capsys.readouterr().err
    assert not Path("results").exists()


def test_an_unreachable_start_in_a_process_of_its_own(here):
    done = cosim("run", "--stop", "0.002", "--set", "plant.x_E_start=3")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    for part in ("cosim: plant", "out of reach of chain 1", "move it to within 2 l of the base"):
        assert part in done.stderr
    assert list((here / "temporary").iterdir()) == []


def test_debug_shows_the_traceback(here, capsys):
    assert main(["--debug", "run", "--set", "controller.alpha=-1", "--stop", "0.002"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("Traceback (most recent call last):")
    assert "SetupError: start value of 'controller.alpha'" in err


# Failures in the middle, and where the results go


def test_a_failure_in_the_middle_keeps_what_was_recorded(here, capsys):
    Path("mine.toml").write_text(INDEFINITE, encoding="utf-8")
    assert main(["run", "mine.toml"]) == 1
    line = error_line(capsys)
    for part in ("plant failed at t = ", "mass matrix is not positive definite", "dm", "results/mine"):
        assert part in line
    failed_at = float(line.split("at t = ")[1].split(" s")[0])
    results = Results.from_csv("results/mine/results.csv")
    assert 0.01 < failed_at < 0.5
    assert results.time.tolist() == [i * 1e-3 for i in range(round(failed_at * 1e3) + 1)]
    # X Y = Z^2 by hand, with r_b = Z / (m_b l): the step from the last row recorded goes beyond it
    X, Y, Z, m_b, length, r_a = 0.0932, 0.0381, 0.0426, 1.0771, 0.244, 0.122
    r_b = Z / (m_b * length)
    dm = results["plant.dm"]
    dm = np.append(dm, 2.0 * dm[-1] - dm[-2])
    margin = (X + dm * (r_a**2 + length**2)) * (Y + dm * r_b**2) - (Z + dm * length * r_b) ** 2
    assert (margin[:-1] > 0.0).all()
    assert margin[-1] <= 0.0
    summary = summary_of("results/mine")
    assert summary["status"] == "failed"
    assert summary["error"] == line.removeprefix("cosim: ").partition("; what was recorded is in")[0]
    assert is_png(Path("results/mine/path.png"))
    assert list((here / "temporary").iterdir()) == []


def test_a_failure_in_the_first_step_keeps_its_one_row(here, capsys):
    Path("mine.toml").write_text(
        "components = ['plant']\nstart.plant = {dm = 0.0, tau_d = 0.0, tau_a = 1e150}\n", encoding="utf-8"
    )
    assert main(["run", "mine.toml", "--stop", "0.01"]) == 1
    assert "plant failed at t = 0 s" in error_line(capsys)
    assert Results.from_csv("results/mine/results.csv").time.tolist() == [0.0]
    assert summary_of("results/mine")["status"] == "failed"
    assert sorted(p.name for p in Path("results/mine").iterdir()) == ["results.csv", "summary.json"]


def test_torques_whose_squares_are_beyond_floats_leave_a_valid_summary(here, capsys):
    Path("mine.toml").write_text(
        "components = ['plant']\nstart.plant = {dm = 0.0, tau_d = 0.0, tau_a = 1e200}\n", encoding="utf-8"
    )
    assert main(["run", "mine.toml", "--stop", "0.01"]) == 1
    error_line(capsys)
    assert summary_of("results/mine")["status"] == "failed"  # and it is JSON, which knows no Infinity


def read_to_the_end(terminal: int) -> bytes:
    read = b""
    with contextlib.suppress(OSError):  # how a terminal says that its other end is closed
        while chunk := os.read(terminal, 4096):
            read += chunk
    return read


@pytest.mark.slow
def test_ctrl_c_half_way_keeps_what_was_recorded(here):
    command = [sys.executable, "-m", "cosim", "run", "--stop", "600"]
    terminal, child_end = pty.openpty()  # the bar, which tells when the run is under way, needs a terminal
    termios.tcsetwinsize(terminal, (24, 100))
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=child_end)
    os.close(child_end)
    try:
        err = b""
        while b"s simulated" not in err:
            err += os.read(terminal, 4096)  # fails when the child has ended
        process.send_signal(signal.SIGINT)
        rest = read_to_the_end(terminal)
        out = process.communicate(timeout=PATIENCE)[0]
    finally:
        process.kill()
        process.wait()
        os.close(terminal)
    assert process.returncode == 130
    assert out == b""
    assert b"Traceback" not in rest
    last = rest.decode().strip().replace("\r", "\n").splitlines()[-1]
    assert last.startswith("cosim: interrupted at t = ")
    assert last.endswith("; what was recorded is in results/tracking")
    stopped = float(last.split("t = ")[1].split(" s")[0])
    results = Results.from_csv("results/tracking/results.csv")
    assert 100 < len(results.time) < 600000
    assert results.time[0] == 0.0
    assert results.time[-1] == pytest.approx(stopped - 1e-3, abs=1e-9)
    summary = summary_of()
    assert summary["status"] == "interrupted"
    assert summary["error"] == f"interrupted at t = {stopped:.9g} s"
    assert summary["stop_time"] == 600.0
    assert is_png(Path("results/tracking/path.png"))
    assert list((here / "temporary").iterdir()) == []


@pytest.mark.parametrize("out", ["file/out", "file"])
def test_an_impossible_out_is_refused_before_anything_runs(here, capsys, monkeypatch, out):
    Path("file").write_text("a regular file")
    monkeypatch.setattr(execution, "execute", lambda *_, **__: pytest.fail("something ran"))
    monkeypatch.setattr(fmus, "build_missing", lambda *_: pytest.fail("something was built"))
    assert main(["run", "--out", out]) == 1
    line = error_line(capsys)
    assert f"can't write into {out}" in line
    assert "choose another --out" in line
    assert Path("file").read_text() == "a regular file"


def with_largest_file(size: int):
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def test_a_full_disk_is_one_line(here):
    # room for all members of the FMUs, none for the results
    done = cosim("run", "--stop", "1", preexec_fn=with_largest_file(500_000))
    assert done.returncode == 1
    assert "largest torque" in done.stdout  # what came of the run is said before it is written
    assert "results/tracking" not in done.stdout
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    for part in ("cosim: can't write into results/tracking", "nor among the temporary files", "free some space"):
        assert part in done.stderr
    assert not Path("results/tracking/results.csv").exists()  # no half of a table that looks whole


def test_no_room_to_unpack_the_fmus_is_one_line_that_says_so(here):
    done = cosim("run", "--stop", "0.01", preexec_fn=with_largest_file(10_000))
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    assert "unpack" in done.stderr
    assert list((here / "temporary").iterdir()) == []


@pytest.mark.parametrize("step", ["results.csv", "summary.json", "figures"])
def test_results_that_the_folder_refuses_go_to_another(here, capsys, monkeypatch, request, step):
    out = Path("results/tracking")
    if step != "figures":
        request.getfixturevalue("no_figures")

    def refuse(original, folder_of):
        def write(*arguments, **options):
            if folder_of(*arguments).is_relative_to(out):
                raise OSError(28, "No space left on device")
            return original(*arguments, **options)

        return write

    if step == "results.csv":
        monkeypatch.setattr(Results, "to_csv", refuse(Results.to_csv, lambda _, path: path.parent))
    elif step == "summary.json":
        monkeypatch.setattr(execution, "write_json", refuse(execution.write_json, lambda path, _: path.parent))
    else:
        monkeypatch.setattr(FigureProcess, "write", refuse(FigureProcess.write, lambda *a: a[-1]))
    assert main(["run", "--stop", "0.01"]) == 1
    line = error_line(capsys)
    assert "can't write into results/tracking: No space left on device" in line
    rescue = Path(line.strip().rpartition("the results are in ")[2])
    assert rescue.parent == here / "temporary"
    figures = FIGURES if step == "figures" else []
    assert sorted(p.name for p in rescue.iterdir()) == sorted(["results.csv", "summary.json", *figures])
    assert len(Results.from_csv(rescue / "results.csv").time) == 11
    assert summary_of(rescue)["status"] == "completed"


def test_a_failed_run_whose_folder_refuses_says_both(here, no_figures, capsys, monkeypatch):
    Path("mine.toml").write_text(INDEFINITE, encoding="utf-8")
    original = Results.to_csv

    def save(results, path, **options):
        if path.is_relative_to("results/mine"):
            raise OSError(28, "No space left on device")
        original(results, path, **options)

    monkeypatch.setattr(Results, "to_csv", save)
    assert main(["run", "mine.toml"]) == 1
    line = error_line(capsys)
    assert "the results are in" in line
    assert "mass matrix is not positive definite" in line  # why the run failed must not be lost


def test_a_failed_run_whose_figures_fail_too_says_both(here, capsys, monkeypatch):
    Path("mine.toml").write_text(INDEFINITE, encoding="utf-8")
    start = FigureProcess.start

    def killed(figures, drawing=""):
        start(figures, drawing)
        figures._process.kill()

    monkeypatch.setattr(FigureProcess, "start", killed)
    assert main(["run", "mine.toml"]) == 1
    shown = capsys.readouterr()
    assert "mass matrix is not positive definite" in shown.err
    assert "what was recorded is in results/mine" in shown.err
    assert "note: there are no figures, because the process that draws figures ended" in shown.out
    assert len(Results.from_csv("results/mine/results.csv").time) > 1


# FMUs


@pytest.mark.slow
def test_missing_fmus_are_built_and_existing_ones_are_left_alone(here, no_figures, capsys):
    shutil.rmtree("fmus")
    assert main(["run", "--stop", "0.002", "--fmus", "mine"]) == 0
    paths = [fmu_path(Path("mine"), DEFAULT_FLAVOUR, instance) for instance in MODELS]
    assert capsys.readouterr().out.splitlines()[:3] == [f"built {path}" for path in paths]
    assert not Path("fmus").exists()
    before = {path: (path.stat().st_mtime_ns, digest(path)) for path in paths}
    assert main(["run", "--stop", "0.002", "--fmus", "mine"]) == 0
    assert "built" not in capsys.readouterr().out
    assert {path: (path.stat().st_mtime_ns, digest(path)) for path in paths} == before


def test_gains_written_into_the_controller_survive_when_another_fmu_is_missing(here, no_figures):
    # building the missing plant must not put the controller's own gains back without a word
    controller = fmu_path(Path("fmus"), DEFAULT_FLAVOUR, "controller")
    assert main(["tune", "--mu", "5", "--write", str(controller)]) == 0
    before = digest(controller)
    fmu_path(Path("fmus"), DEFAULT_FLAVOUR, "plant").unlink()
    assert main(["run", "--stop", "0.002"]) == 0
    assert digest(controller) == before


def test_changed_sources_are_noted(here, no_figures, capsys, monkeypatch):
    assert main(["run", "--stop", "0.002"]) == 0
    assert "note:" not in capsys.readouterr().out
    monkeypatch.setattr(fmus, "fingerprint_of_sources", lambda _: "others")
    assert main(["run", "--stop", "0.002"]) == 0
    note = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")]
    assert len(note) == 1
    assert "rebuild with: python build_fmus.py" in note[0]
    assert "the sources have changed since" in note[0]
    # one file is enough, and one that the gain tool has changed counts too
    record = Path("fmus") / DEFAULT_FLAVOUR / RECORD
    record.write_text(json.dumps({"RobotController.fmu": {"sources": "others still"}}))
    assert main(["run", "--stop", "0.002"]) == 0
    assert "RobotController.fmu was built" in capsys.readouterr().out


def test_a_checkout_and_an_installed_package_are_the_same_sources(tmp_path, monkeypatch):
    """FMUs that a clone built are not outdated for the package installed from it, which keeps the licence elsewhere."""
    root, ours = Path(fmus.__file__).parents[1], fmus._sources()
    for name in ("plant_fmu", "controller_fmu", "trajectory_fmu", "fmu_export", "parallel_robot"):
        shutil.copytree(root / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    licence = tmp_path / "closed_chain_cosim-1.2.3.dist-info" / "licenses" / "LICENSE"
    licence.parent.mkdir(parents=True)
    shutil.copy(root / "LICENSE", licence)
    monkeypatch.setattr(fmus, "__file__", str(tmp_path / "parallel_robot" / "fmus.py"))
    assert fmus._sources() == ours
    licence.write_text("other terms")
    assert fmus._sources() != ours


@pytest.mark.parametrize("damage", ["truncated", "empty", "text", "without description", "without binaries"])
def test_a_broken_fmu_is_one_line(here, no_figures, capsys, damage):
    import zipfile

    path = fmu_path(Path("fmus"), DEFAULT_FLAVOUR, "controller")
    content = path.read_bytes()
    if damage == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "text":
        path.write_bytes(b"this is not an archive")
    else:
        drop = "modelDescription.xml" if damage == "without description" else "binaries/"
        with zipfile.ZipFile(path) as archive:
            members = {n: archive.read(n) for n in archive.namelist() if not n.startswith(drop)}
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data)
    assert main(["run", "--stop", "0.002"]) == 1
    line = error_line(capsys)
    assert "component 'controller'" in line
    assert "RobotController.fmu" in line
    assert list((here / "temporary").iterdir()) == []


def test_the_contract_names_three_flavours(here):
    assert set(FLAVOURS) <= {"pythonfmu", "fmi2", "fmi3"}
    assert "pythonfmu" in FLAVOURS


@pytest.mark.parametrize("path", ["plant.dm", "plant.tau_d[1]", "plant.tau_a", "controller.theta_a[2]"])
def test_a_start_value_of_a_fed_input_is_refused(here, capsys, path):
    assert main(["run", "--stop", "0.01", "--set", f"{path}=0.1"]) == 1
    assert f"'{path}' is fed by a connection or a signal" in capsys.readouterr().err


# Recording, formats, pacing


def test_chosen_variables_at_chosen_points_in_chosen_formats(here, no_figures):
    options = ["--record", "plant.x_E", "--record", "plant.theta_a", "--record-every", "5"]
    assert main(["run", "--stop", "0.1", *options, "--format", "npz", "--format", "csv"]) == 0
    results = Results.from_csv("results/tracking/results.csv")
    assert results.names == ["plant.x_E", *(f"plant.theta_a[{i}]" for i in (1, 2, 3))]
    assert results.time.tolist() == [5 * i * 1e-3 for i in range(21)]
    assert (np.load("results/tracking/results.npz")["values"] == results.values).all()
    assert summary_of()["record_every"] == 5


@pytest.mark.parametrize(
    ("recorded", "figures"),
    [
        (["plant.x_E"], []),
        pytest.param(["plant.tau_a"], [], marks=pytest.mark.slow),
        (["plant.tau_a[1]", "trajectory.x_ref"], []),
        (["plant.closure_error", "controller.psi[2]"], ["closure_error.png"]),
        (["plant.x_E", "plant.y_E", "trajectory.x_ref", "plant.tau_a", "plant.tau_d"], ["path.png", "torques.png"]),
    ],
)
def test_figures_and_metrics_are_those_of_what_was_recorded(here, capsys, recorded, figures):
    assert main(["run", "--stop", "0.01", *(f"--record={name}" for name in recorded)]) == 0
    summary = summary_of()
    assert [name for name in summary["files"] if name.endswith(".png")] == figures
    assert (summary["metrics"]["control_effort"] is None) == ("plant.tau_a" not in "".join(recorded))
    assert (summary["metrics"]["closure_error_max"] is None) == ("plant.closure_error" not in recorded)
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "note:" not in shown.out
    what = "results, summary and figures" if figures else "results and summary"
    assert shown.out.endswith(f"{what}: results/tracking\n")


@pytest.mark.parametrize("failing", ["metrics", "figures"])
def test_metrics_or_figures_that_fail_are_a_note(here, no_figures, capsys, monkeypatch, failing):
    def fail(*_):
        raise KeyError("plant.z_E")

    if failing == "metrics":
        monkeypatch.setattr("parallel_robot.metrics.metrics", fail)
    else:
        monkeypatch.setattr(FigureProcess, "write", fail)
    assert main(["run", "--stop", "0.01"]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")]
    assert len(notes) == 1
    assert "KeyError: 'plant.z_E'" in notes[0]
    assert failing in notes[0]
    assert summary_of()["status"] == "completed"


@pytest.mark.parametrize("formats", [[], ["--format", "parquet"]])
def test_a_long_run_goes_to_the_disk_and_says_the_same(here, no_figures, monkeypatch, formats):
    assert main(["run", "--stop", "0.2", "--out", "short"]) == 0
    monkeypatch.setattr(execution, "MOST_VALUES_IN_MEMORY", 1000)
    assert main(["run", "--stop", "0.2", "--out", "long", *formats]) == 0
    short = Results.from_csv("short/results.csv")
    stored = StoredResults(Path("long/results.parquet"), {})
    assert all((stored[name] == short[name]).all() for name in ("time", *short.names))
    assert summary_of("long")["metrics"] == summary_of("short")["metrics"]
    assert Path("long/results.csv").exists() == (not formats)
    if not formats:
        assert Path("long/results.csv").read_bytes() == Path("short/results.csv").read_bytes()


def test_a_long_run_that_fails_keeps_what_it_had(here, no_figures, capsys, monkeypatch):
    Path("mine.toml").write_text(INDEFINITE, encoding="utf-8")
    monkeypatch.setattr(execution, "MOST_VALUES_IN_MEMORY", 100)
    assert main(["run", "mine.toml"]) == 1
    assert "what was recorded is in results/mine" in error_line(capsys)
    stored = StoredResults(Path("results/mine/results.parquet"), {})
    assert 0.0 < stored.time[-1] < 0.1
    assert summary_of("results/mine")["status"] == "failed"


def test_a_disk_too_small_for_a_long_run_is_known_beforehand(here, capsys, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9, 10**6))
    assert main(["run", "--stop", "3600"]) == 1
    line = error_line(capsys)
    columns = 1 + sum(len(model.inputs) + len(model.outputs) for model in MODELS.values())
    expected = 3_600_001 * columns * (20 + 8) / 1e9
    assert f"the results need about {expected:.3g} GB" in line
    assert "record less (--record, --record-every)" in line


def test_real_time_is_kept_and_reported(here, no_figures, capsys):
    assert main(["run", "--stop", "0.2", "--realtime", "1"]) == 0
    assert "real time times 1: " in capsys.readouterr().out
    summary = summary_of()
    assert summary["loop_time_s"] >= 0.2
    assert summary["realtime"]["factor"] == 1.0
    assert main(["run", "--stop", "0.2", "--realtime", "0"]) == 1
    assert "real-time factor 0.0 must be a positive number" in error_line(capsys)


def test_the_coupling_is_said_and_can_be_demanded(here, no_figures, capsys):
    if DEFAULT_FLAVOUR == "pythonfmu":
        pytest.skip("there is no C compiler: no FMU here takes linear inputs")
    for coupling, words in (("auto", "fourth-order"), ("linear", "second-order"), ("hold", "first-order")):
        assert main(["run", "--stop", "0.01", "--coupling", coupling]) == 0
        assert words in capsys.readouterr().out
        assert summary_of()["extrapolation"]["mode"] == coupling
    assert main(["run", "--stop", "0.01", "--coupling", "linear", "--flavour", "pythonfmu"]) == 1
    assert "can only be held, because its FMU can't interpolate inputs" in error_line(capsys)
