"""Our FMUs against `reference/`, in a process of their own; and that a small change is found."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from cosim.fmi.fmu_file import read_fmu
from cosim.regression import Case, check
from cosim.regression.run import interfaces_of
from fmu_export.package.start_values import write_start_values
from tests.support.native_fmus import DEFAULT_FLAVOUR

REFERENCE = Path(__file__).parents[2] / "reference"
CASES = ("RobotPlant", "RobotController", "RobotTrajectory")  # tests/test_closed_loop_fmu.py has that of all in one


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("flavour", sorted({"pythonfmu", DEFAULT_FLAVOUR}))
def test_fmu_gives_its_reference(robot_fmus: Path, name: str, flavour: str) -> None:
    fmu = robot_fmus / flavour / f"{name}.fmu"
    interfaces = interfaces_of(read_fmu(fmu, name))
    assert len(interfaces) == (1 if flavour == "pythonfmu" else 2)
    for interface in interfaces:
        # Python in FMUs of one process shares its modules
        outcome = check(Case(name, REFERENCE / name), fmu, interface, isolated=flavour == "pythonfmu")
        assert outcome.findings == []
        assert len(outcome.signals) == len(Case(name, REFERENCE / name).reference().names)


@pytest.mark.parametrize(
    ("name", "parameter", "change"),
    [("RobotPlant", "Z", 1e-7), ("RobotController", "alpha", 1e-6), ("RobotTrajectory", "b", 1e-7)],
)
def test_small_change_of_a_parameter_is_found(
    fmus: Path, tmp_path: Path, name: str, parameter: str, change: float
) -> None:
    fmu = tmp_path / f"{name}.fmu"
    fmu.write_bytes((fmus / f"{name}.fmu").read_bytes())
    start = {"Z": 0.0426, "alpha": 1.3597632624476745, "b": 0.06 / 3.5}[parameter]
    write_start_values(fmu, {parameter: start * (1 + change)})
    findings = check(Case(name, REFERENCE / name), fmu, "co_simulation").findings
    assert "differs at" in findings[0]


@pytest.mark.parametrize("name", [*CASES, "RobotClosedLoop"])
def test_references_name_all_units_and_hold_numbers(name: str) -> None:
    case = Case(name, REFERENCE / name)
    reference = case.reference()
    assert np.isfinite(reference.values).all()
    tables = tomllib.loads(case.tolerances_path.read_text(encoding="utf-8"))
    for interface in ("co_simulation", "model_exchange"):
        tolerances = case.tolerances(interface)
        assert all(tolerances.of(signal).unit for signal in reference.names)
        assert tolerances.relative <= 1e-7
    assert set(tables["signals"]) <= {n.partition("[")[0] for n in reference.names}
