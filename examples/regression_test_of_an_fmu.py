"""Regression test of an FMU: `pytest examples/regression_test_of_an_fmu.py`; more in docs/regression.md.

The fixture comes with this package (`pip install ".[regression]"`). Build the FMUs first.
"""

from pathlib import Path

import pytest

from cosim.regression import FmuRegression

REFERENCE = Path(__file__).resolve().parents[1] / "reference"


@pytest.mark.parametrize("name", ["RobotPlant", "RobotController"])
def test_fmu_gives_its_reference(fmu_regression: FmuRegression, name: str) -> None:
    fmu_regression(f"fmus/fmi2/{name}.fmu", reference=REFERENCE, interface="co_simulation")
