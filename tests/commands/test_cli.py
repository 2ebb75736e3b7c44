"""The program as a whole: help, exit codes, one line for an error, gain tool and runs together, the build script."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from fmpy.model_description import read_model_description

from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains
from cosim.__main__ import command_line, main
from cosim.commands import compare
from cosim.errors import CosimError
from fmu_export.package.start_values import write_start_values
from parallel_robot.choices import scenario_names
from parallel_robot.commands import tune
from plant_fmu.model import MODEL as PLANT
from plant_fmu.model import output_values
from tests.support import some
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.patience import PATIENCE

ROOT = Path(__file__).resolve().parents[2]

#: Options that the contract of the command line names.
CONTRACT = {
    "run": ["SCENARIO", "--flavour", "--step", "--stop", "--coupling", "--out", "--set"],
    "tune": ["--mu", "--nu", "--json", "--write"],
    "validate": ["FMU"],
    "compare": ["RESULT", "REFERENCE"],
}


@pytest.fixture
def here(robot_fmus: Path, tmp_path, monkeypatch) -> Path:
    shutil.copytree(robot_fmus / DEFAULT_FLAVOUR, tmp_path / "fmus" / DEFAULT_FLAVOUR)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def error_line(capsys) -> str:
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("cosim: ")
    assert shown.err.count("\n") == 1, shown.err
    return shown.err


# Help and exit codes


@pytest.mark.parametrize("command", CONTRACT)
def test_every_command_has_a_help_that_names_its_options(capsys, command):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out.lower()
    for option in CONTRACT[command]:
        assert option.lower() in shown


def test_every_help_has_examples_that_are_read_as_they_stand():
    parser = command_line()
    (subparsers,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    for name, command in some(subparsers.choices.items()):
        head, *lines = command.format_help().partition("\nexamples:\n")[2].splitlines()
        for line in some([head, *lines]):
            program, *arguments = shlex.split(line.partition(" > ")[0])
            assert program == "cosim", line
            assert arguments[0] in subparsers.choices, line
            parser.parse_args(arguments)
        assert f"cosim {name}" in head


def test_help_of_the_program_names_all_commands(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    for word in [*CONTRACT, "--debug", "--version"]:
        assert word in shown


def test_help_of_run_names_the_scenarios(capsys):
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    shown = capsys.readouterr().out
    for scenario in ("tracking", "tracking-feedforward", "tracking-noise", "tracking-undisturbed", "pd", "open-loop"):
        assert scenario in "".join(shown.split())  # lines break at hyphens, too


@pytest.mark.parametrize(
    "arguments", [[], ["--debug"], ["rnu"], ["compare", "one"], ["tune", "--mu"], ["run", "--set"]]
)
def test_a_command_line_that_can_t_be_read_is_exit_code_2(capsys, arguments):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert "usage: cosim" in capsys.readouterr().err


def test_the_version_is_that_of_the_project():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    done = subprocess.run(
        [sys.executable, "-m", "cosim", "--version"], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{version}\n", "")


# Errors


@pytest.fixture
def failing(monkeypatch):
    """Make `cosim compare a b` raise an error."""

    def fail_with(error: BaseException) -> None:
        def fail(args: argparse.Namespace) -> int:
            raise error

        monkeypatch.setattr(compare, "run", fail)

    return fail_with


@pytest.mark.parametrize("kind", [ValueError, OSError, CosimError, UnicodeError])
def test_an_error_is_one_line_and_exit_code_1(capsys, failing, kind):
    failing(kind("what was wrong; what to do"))
    assert main(["compare", "a", "b"]) == 1
    assert error_line(capsys) == "cosim: what was wrong; what to do\n"


def test_an_error_of_many_lines_is_one_line_too(capsys, failing):
    failing(ValueError("first\n  second\nthird"))
    assert main(["compare", "a", "b"]) == 1
    line = error_line(capsys)
    assert all(word in line for word in ("first", "second", "third"))


def test_an_error_without_words_says_its_kind(capsys, failing):
    failing(TimeoutError())
    assert main(["compare", "a", "b"]) == 1
    assert error_line(capsys).startswith("cosim: TimeoutError: ; this is a fault of the program")


def test_memory_that_is_not_there_is_one_line(capsys, failing):
    failing(MemoryError("Unable to allocate 4.00 PiB"))
    assert main(["compare", "a", "b"]) == 1
    assert "4.00 PiB" in error_line(capsys)


def test_debug_shows_the_traceback_in_place_of_the_line(capsys, failing):
    failing(ValueError("what was wrong"))
    assert main(["--debug", "compare", "a", "b"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("Traceback (most recent call last):")
    assert err.endswith("ValueError: what was wrong\n")


def test_a_mistake_in_the_program_is_not_taken_for_one_of_the_user(failing, capsys):
    failing(AttributeError("a bug"))
    assert main(["compare", "a", "b"]) == 1
    said = error_line(capsys)
    assert said.startswith("cosim: AttributeError: a bug; this is a fault of the program")
    assert main(["--debug", "compare", "a", "b"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_ctrl_c_is_exit_code_130(capsys, failing):
    failing(KeyboardInterrupt())
    assert main(["compare", "a", "b"]) == 130
    assert error_line(capsys) == "cosim: interrupted\n"


def test_the_exit_code_of_the_command_is_that_of_the_program(monkeypatch):
    monkeypatch.setattr(compare, "run", lambda args: 1)
    assert main(["compare", "a", "b"]) == 1
    monkeypatch.setattr(compare, "run", lambda args: 0)
    assert main(["compare", "a", "b"]) == 0


# The gain tool and the runs


def test_gains_written_into_the_controller_are_those_of_the_next_run(here, no_figures, capsys):
    controller = here / "fmus" / DEFAULT_FLAVOUR / "RobotController.fmu"
    assert main(["tune", "--mu", "5", "--nu", "1", "--json", "--write", str(controller)]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["written"] == str(controller)
    expected = optimal_gains(PerformanceIndex(5.0, 1.0))
    assert (record["alpha"], record["beta"]) == (expected.alpha, expected.beta)
    assert record["alpha"] == pytest.approx(1.7839, abs=5e-5)  # Table 1, row (5, 1)
    assert record["beta"] == pytest.approx(1.9337, abs=5e-5)
    starts = {v.name: v.start for v in read_model_description(controller).modelVariables}
    assert (float(starts["alpha"]), float(starts["beta"])) == (expected.alpha, expected.beta)
    assert main(["validate", str(controller)]) == 0

    assert main(["run", "--stop", "0.01"]) == 0
    summary = json.loads(Path("results/tracking/summary.json").read_text(encoding="utf-8"))
    assert summary["parameters"]["controller.alpha"] == expected.alpha
    assert summary["parameters"]["controller.beta"] == expected.beta
    assert summary["parameters"]["controller.k"] == 12.0
    assert summary["fmus"]["controller"]["sha256"] == digest(controller)


def test_s_b_of_the_plant_is_a_tenth_of_the_paper_s(capsys):
    assert main(["tune", "--from-plant", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["s_b"] == pytest.approx(0.0043, abs=5e-5)
    assert record["s_b"] != pytest.approx(PerformanceIndex.s_b, rel=0.5)
    # by hand: S theta_e^T theta_e at t = 0 with S = 2; the plant is at (0.22, 0.30), the path at (0.225, 0.295)
    p = PLANT.parameters.starts.copy()
    x = PLANT.initial_state(p)
    outputs = PLANT.outputs.unpack(output_values(0.0, x, np.zeros(len(PLANT.inputs)), p))
    names = list(PLANT.parameters.names)
    p[names.index("x_E_start")], p[names.index("y_E_start")] = 0.225, 0.295
    theta_e = outputs.theta_a - PLANT.initial_state(p)[:3]
    assert record["s_b"] == pytest.approx(2.0 * float(theta_e @ theta_e), rel=1e-9)
    assert record["s_a"] > 0.0


def test_write_into_a_missing_file_is_refused(here, capsys):
    assert main(["tune", "--write", "nowhere/RobotController.fmu"]) == 1
    assert "nowhere/RobotController.fmu" in error_line(capsys)
    assert not Path("nowhere").exists()


@pytest.mark.parametrize("name", ["RobotPlant.fmu", "RobotTrajectory.fmu"])
def test_write_into_another_fmu_is_refused_and_changes_nothing(here, capsys, name):
    path = here / "fmus" / DEFAULT_FLAVOUR / name
    before = digest(path), path.stat().st_mtime_ns
    assert main(["tune", "--write", str(path)]) == 1
    line = error_line(capsys)
    assert name in line
    assert "no parameter 'alpha'" in line
    assert (digest(path), path.stat().st_mtime_ns) == before
    assert [p.name for p in path.parent.glob("*.part*")] == []


def test_write_into_what_is_no_fmu_is_refused_and_changes_nothing(here, capsys):
    Path("text.fmu").write_text("no archive", encoding="utf-8")
    assert main(["tune", "--write", "text.fmu"]) == 1
    assert "text.fmu: not an FMU" in error_line(capsys)
    assert Path("text.fmu").read_text(encoding="utf-8") == "no archive"


def test_gains_that_the_tool_refuses_are_not_written(here, capsys):
    controller = here / "fmus" / DEFAULT_FLAVOUR / "RobotController.fmu"
    before = digest(controller)
    assert main(["tune", "--mu", "nan", "--write", str(controller)]) == 1
    assert "mu" in error_line(capsys)
    assert digest(controller) == before


def test_a_run_agrees_with_itself_and_not_with_another(here, no_figures, capsys):
    assert main(["run", "--stop", "0.02", "--out", "a"]) == 0
    assert main(["run", "--stop", "0.02", "--out", "b"]) == 0
    assert main(["run", "pd", "--stop", "0.02", "--out", "c"]) == 0
    capsys.readouterr()
    assert main(["compare", "a/results.csv", "b/results.csv"]) == 0
    assert main(["compare", "a/results.csv", "c/results.csv"]) == 1
    assert "controller.tau_a[1]" in capsys.readouterr().out


# The build script


def build(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "build_fmus.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


@pytest.mark.slow
def test_the_build_script_writes_the_same_bytes_twice(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    digests = []
    for options in (["--flavour", "pythonfmu"], ["--flavour", "pythonfmu", "--fmus", "other"]):
        done = build(*options)
        assert (done.returncode, done.stderr) == (0, "")
        folder = Path("other" if "other" in options else "fmus") / "pythonfmu"
        assert sorted(p.name for p in folder.iterdir()) == [
            ".built.json",
            "RobotClosedLoop.fmu",
            "RobotController.fmu",
            "RobotPlant.fmu",
            "RobotTrajectory.fmu",
        ]
        for path in some(folder.glob("*.fmu")):
            assert str(path) in done.stdout
        digests.append({p.name: digest(p) for p in folder.iterdir()})
    assert digests[0] == digests[1]
    published = Path("fmus/fmus.sha256")
    assert published.read_bytes() == Path("other/fmus.sha256").read_bytes()
    published.write_text(published.read_text().replace("a", "b", 1))
    done = build("--flavour", "pythonfmu", "--fmus", "other", "--check", str(published))
    assert done.returncode == 1
    assert "is not that of fmus/fmus.sha256" in done.stdout


def test_the_hashes_of_fmus_are_as_other_programs_have_them(tmp_path, capsys):
    script = runpy.run_path(str(ROOT / "build_fmus.py"))
    for name, content in (("fmi2/A.fmu", b"a"), ("wasm/A.wasm", b"b"), ("fmi2/.built.json", b"c")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    script["write_hashes"](tmp_path)
    published = tmp_path / "fmus.sha256"
    assert published.read_text() == (
        f"{hashlib.sha256(b'a').hexdigest()}  fmi2/A.fmu\n{hashlib.sha256(b'b').hexdigest()}  wasm/A.wasm\n"
    )
    assert script["has_hashes"](tmp_path, published)
    (tmp_path / "wasm/A.wasm").unlink()
    (tmp_path / "fmi2/A.fmu").write_bytes(b"changed")
    assert not script["has_hashes"](tmp_path, published)
    said = capsys.readouterr().out
    assert f"fmi2/A.fmu is not that of {published}" in said
    assert "wasm/A.wasm is missing" in said


@pytest.mark.slow
def test_only_what_has_changed_is_built_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ("--flavour", "pythonfmu", "--fmu", "controller", "--fmu", "trajectory")
    build(*options)
    paths = sorted(Path("fmus/pythonfmu").glob("*.fmu"))
    before = {path: digest(path) for path in paths}
    for path in paths:
        os.utime(path, (1.0, 1.0))
    write_start_values(paths[0], {"alpha": 2.0})  # somebody else's change
    done = build(*options)
    assert (done.returncode, done.stderr) == (0, "")
    assert [path.stat().st_mtime == 1.0 for path in paths] == [False, True]
    assert {path: digest(path) for path in paths} == before
    Path("fmus/pythonfmu/.built.json").write_text("damaged")
    build(*options)
    assert all(path.stat().st_mtime > 1.0 for path in paths)
    assert {path: digest(path) for path in paths} == before


@pytest.mark.slow
def test_the_build_script_refuses_an_impossible_place_in_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("a regular file", encoding="utf-8")
    done = build("--fmus", "file/fmus", "--flavour", "pythonfmu")
    assert done.returncode == 1
    assert done.stdout.startswith("built in ")
    assert done.stderr.startswith("build_fmus.py: can't write the FMUs into file/fmus/pythonfmu: ")
    assert "choose another folder with --fmus" in done.stderr
    assert done.stderr.count("\n") == 1
    assert Path("file").read_text(encoding="utf-8") == "a regular file"


def test_commands_need_no_working_folder_of_the_project(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert tune.run(argparse_of("tune")) == 0
    assert list(tmp_path.iterdir()) == []
    assert scenario_names() == [
        "open-loop",
        "pd",
        "tracking",
        "tracking-feedforward",
        "tracking-noise",
        "tracking-undisturbed",
    ]


def argparse_of(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    subparsers = parser.add_subparsers()
    tune.register(subparsers)
    return parser.parse_args(arguments)
