"""Each FMU as a stranger's tool loads it: fmpy's own command line, in a process that can't import this project."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cosim import Results
from parallel_robot.models import MODELS

HOST = """
import runpy, sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("plant_fmu", "controller_fmu", "fmu_export", "cosim", "pythonfmu", "casadi"):
            raise ImportError(f"{name} is not on this machine")

sys.meta_path.insert(0, Absent())
try:
    import fmu_export
except ImportError:
    sys.argv[0] = "fmpy"
    runpy.run_module("fmpy", run_name="__main__")
else:
    sys.exit("the project can be imported: this proves nothing")
"""


@pytest.mark.parametrize("instance", MODELS)
def test_fmpy_simulate_runs_the_fmu(fmus: Path, tmp_path: Path, instance: str) -> None:
    model = MODELS[instance]
    command = [sys.executable, "-c", HOST, "simulate", fmus / f"{model.name}.fmu", "--stop-time", "0.5"]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "COV"))}
    subprocess.run([*command, "--output-file", "out.csv"], cwd=tmp_path, check=True, env=environment)
    results = Results.from_csv(tmp_path / "out.csv")
    assert len(results.time) == 501
    x = model.initial_state(model.parameters.starts)
    expected = model.output_values(0.0, x, np.zeros(len(model.inputs)), model.parameters.starts)
    found = [results[name][0] for name in model.outputs.names]
    np.testing.assert_allclose(found, expected, atol=1e-14)
