"""Fixtures of the tests of the paper: the runs of the reproduction, made once for each worker.

By default these are few runs; the tests marked `slow` use all runs that `cosim reproduce` makes.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from parallel_robot.paper.reproduce.content import Runs
from parallel_robot.paper.reproduce.material import Material
from parallel_robot.paper.reproduce.runs import Plan, run_all
from tests.support.native_fmus import require_compiler
from tests.support.reproduction import FEW, WHOLE


@pytest.fixture(scope="session")
def reproduction_fmus(robot_fmus: Path) -> Path:
    """Folder of the FMUs that the runs are made with."""
    require_compiler()
    return robot_fmus


@pytest.fixture(
    scope="session", params=[pytest.param(FEW, id="few"), pytest.param(WHOLE, id="whole", marks=pytest.mark.slow)]
)
def plan(request: pytest.FixtureRequest) -> Plan:
    """Which runs are made."""
    found: Plan = request.param
    return found


@pytest.fixture(scope="session")
def material(reproduction_fmus: Path, plan: Plan) -> Material:
    """The runs, with what is computed from them."""
    return Material(run_all(reproduction_fmus, plan=plan))


@pytest.fixture(scope="session")
def runs(material: Material) -> Runs:
    """The runs by controller and condition."""
    return material.runs
