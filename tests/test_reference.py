"""The FMUs under fixed inputs against `reference/`, in a process of their own; and that a small change is found."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.__main__ import main
from fmu_export.start_values import write_start_values

REFERENCE = Path(__file__).parents[1] / "reference"
CASES = ("RobotPlant", "RobotController", "RobotTrajectory")


def run_case(name: str, fmu: Path, out: Path) -> None:
    command = [sys.executable, REFERENCE / "run.py", REFERENCE / name, fmu, out]
    subprocess.run(command, check=True, cwd=out.parent, env={**os.environ, "PYTHONWARNINGS": "error"})


def compare(name: str, out: Path) -> int:
    return main(["compare", str(out), str(REFERENCE / name / f"{name}_ref.csv")])


@pytest.mark.parametrize("name", CASES)
def test_fmu_gives_its_reference(fmus: Path, tmp_path: Path, name: str) -> None:
    run_case(name, fmus / f"{name}.fmu", tmp_path / "out.csv")
    assert compare(name, tmp_path / "out.csv") == 0


@pytest.mark.parametrize(
    ("name", "parameter", "change"),
    [("RobotPlant", "Z", 1e-7), ("RobotController", "alpha", 1e-6), ("RobotTrajectory", "b", 1e-7)],
)
def test_small_change_of_a_parameter_is_found(
    fmus: Path, tmp_path: Path, capsys: pytest.CaptureFixture, name: str, parameter: str, change: float
) -> None:
    fmu = tmp_path / f"{name}.fmu"
    fmu.write_bytes((fmus / f"{name}.fmu").read_bytes())
    start = {"Z": 0.0426, "alpha": 1.3597632624476745, "b": 0.06 / 3.5}[parameter]
    write_start_values(fmu, {parameter: start * (1 + change)})
    run_case(name, fmu, tmp_path / "out.csv")
    assert compare(name, tmp_path / "out.csv") == 1
    assert "differs at" in capsys.readouterr().out
