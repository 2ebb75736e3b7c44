"""The public surface as a stranger's type checker sees it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
from pathlib import Path

import cosim
from cosim import Results, Signal, Simulation, System, simulate
from fmu_export import DefaultExperiment, Layout, Variable, to_control


def study() -> float:
    system = System()
    system.add("plant", "RobotPlant.fmu", start={"dm": 0.0, "tau_d": [0.0, 0.0, 0.0]})
    system.drive("plant.tau_a", lambda t: [0.0, 0.0, 0.0])
    results: Results = simulate(system, 1.0, 1e-3)
    with Simulation(system) as simulation:
        signals = [Signal("plant.tau_a", lambda t: 0.0)]
        results = simulation.run(1.0, 1e-3, start={"plant.m_a": 1.0}, signals=signals)
    results.save(Path("results.mat"))
    results.plot("plant.x_E")[0].set_xlim(0.0, 1.0)
    return float(results["plant.x_E"][-1])


try:
    print(study(), Layout([Variable("K", "N.m", "gain")]).names, DefaultExperiment(1.0, 0.1), to_control)
except cosim.SimulationError as error:
    print(error.component, error.time)
"""

#: A line -> what is wrong with it.
WRONG = {
    "cosim.simulat": 'Module has no attribute "simulat"',
    'cosim.System().add("plant", 3)': 'Argument 2 to "add" of "System" has incompatible type "int"',
    "cosim.simulate(cosim.System(), 1.0, 1e-3, order=1)": 'Argument "order" to "simulate"',
    "cosim.System().connect('a.x')": 'Missing positional argument "target"',
}


@pytest.mark.slow
def test_a_strict_type_checker_takes_good_scripts_and_finds_mistakes(tmp_path: Path) -> None:
    (tmp_path / "good.py").write_text(SCRIPT)
    (tmp_path / "bad.py").write_text("\n".join(["import cosim", *WRONG]))
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", "cache", "--no-error-summary"]
    done = subprocess.run([*command, "good.py", "bad.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    found = [line for line in done.stdout.splitlines() if ": error:" in line]
    assert len(found) == len(WRONG), done.stdout
    for number, (line, message) in enumerate(zip(found, WRONG.values(), strict=True), start=2):
        assert line.startswith(f"bad.py:{number}: error: {message}")
