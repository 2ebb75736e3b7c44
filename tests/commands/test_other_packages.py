"""Scenarios and commands of another package: installed into a fresh folder, the program finds and runs them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.results.results import Results
from tests.support.native_fmus import require_compiler
from tests.support.patience import PATIENCE

EXAMPLE = Path(__file__).resolve().parents[2] / "examples/tanks"

Program = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def tank_fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_compiler()
    folder = tmp_path_factory.mktemp("tanks")
    (folder / "build.py").write_bytes((EXAMPLE / "build.py").read_bytes())
    subprocess.run([sys.executable, folder / "build.py"], check=True, capture_output=True, timeout=PATIENCE)
    return folder


def installed(folder: Path, entry_points: dict[str, dict[str, str]]) -> None:
    """What an installer leaves besides the modules."""
    metadata = folder / "tank_scenarios-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: tank-scenarios\nVersion: 1.0\n", encoding="utf-8")
    lines = []
    for group, entries in entry_points.items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (metadata / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Program:
    """The program in a process that sees what is installed in the folder `site`."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "cosim", *arguments]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False)

    return run


@pytest.fixture
def package(tmp_path: Path, program: Program) -> None:
    """The package of the example is installed."""
    project = tomllib.loads((EXAMPLE / "package/pyproject.toml").read_text(encoding="utf-8"))["project"]
    installed(tmp_path / "site", project["entry-points"])
    (tmp_path / "site/tank_scenarios").symlink_to(EXAMPLE / "package/tank_scenarios", target_is_directory=True)


@pytest.mark.usefixtures("package")
def test_its_scenario_its_options_metrics_and_report(program: Program, tank_fmus: Path) -> None:
    done = program("run", "level", "--tank-fmus", str(tank_fmus))
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0] == "A step of the desired level"
    results = Results.from_csv("results/level/results.csv")
    assert len(results.time) == 1201
    assert results["controller.level"].tolist() == results["tank.level"].tolist()  # the connection of the family
    highest = results["tank.level"].max()
    assert 0.3 < highest < 0.5
    assert f"highest level {highest:.3f} m" in lines
    assert json.loads(Path("results/level/summary.json").read_text())["metrics"] == {"highest_level": highest}
    assert Path("results/level/results.png").stat().st_size > 10_000


@pytest.mark.usefixtures("package")
def test_its_command_and_its_help(program: Program) -> None:
    done = program("tank-time", "0.4905")
    assert (done.returncode, done.stdout, done.stderr) == (0, "15.8 s\n", "")
    assert "tank-time" in program("--help").stdout
    shown = program("run", "--help").stdout
    for word in ("level", "tracking", "--tank-fmus DIR", "--flavour", "a tank under level control"):
        assert word in shown


@pytest.mark.usefixtures("package")
@pytest.mark.slow
def test_beside_the_robot_a_file_names_its_system(program: Program, tank_fmus: Path) -> None:
    run = "[run]\nstop_time = 1.0\nstep_size = 0.1\n"
    reference = "[start.controller]\nlevel_ref = 0.3\n"
    Path("mine.toml").write_text(run + reference, encoding="utf-8")
    done = program("run", "mine.toml", "--tank-fmus", str(tank_fmus))
    assert done.returncode == 1
    assert 'mine.toml: needs [components] with their FMUs, or a line system = "' in done.stderr
    assert done.stderr.count("\n") == 1
    Path("mine.toml").write_text('system = "tank"\n' + run + reference, encoding="utf-8")
    assert program("run", "mine.toml", "--tank-fmus", str(tank_fmus)).returncode == 0
    assert len(Results.from_csv("results/mine/results.csv").time) == 11
    done = program("run", "mine.toml", "--flavour", "fmi2")
    assert (done.returncode, done.stdout) == (1, "")
    assert "--flavour is for scenarios of parallel_robot" in done.stderr
    done = program("run", "tracking", "--tank-fmus", "there")
    assert "--tank-fmus is for scenarios of tank" in done.stderr


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("no_such_module:FAMILY", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("json:dumps", "is not an instance of cosim.scenario.ScenarioFamily"),
    ],
)
def test_a_package_whose_scenarios_can_t_be_loaded_is_named_in_one_line(
    program: Program, tmp_path: Path, value: str, says: str
) -> None:
    installed(tmp_path / "site", {"cosim.scenarios": {"broken": value}})
    done = program("run", "tracking")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"cosim: entry point broken = {value} of the group cosim.scenarios: ")
    assert says in done.stderr
    assert done.stderr.count("\n") == 1
    assert program("compare", "a", "b").stderr.startswith("cosim: a: ")  # other commands go on
