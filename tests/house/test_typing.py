"""The public surface as a stranger's type checker sees it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
from pathlib import Path
from typing import Any

import cosim
from cosim import Results, Signal, Simulation, System, simulate
from fmu_export import DefaultExperiment, Layout, Model, ModelClass, Variable, build_native, discrete, every, input
from fmu_export import output, parameter, state, to_control, when


class Ball(ModelClass, name="Ball", stop_time=3.0, solver="dopri5"):
    e = parameter(0.8, "1", "Restitution", min=0.0)
    h = state(1.0, "m")
    v = state([0.0], "m/s")
    push = input(0.0, "m/s2")
    on = discrete(False)
    energy = output("J")

    def derivatives(m) -> dict[str, Any]:
        return dict(h=m.v[0], v=[m.push - 9.81 + 0.0 * m.t])

    def outputs(m) -> dict[str, Any]:
        return dict(energy=9.81 * m.h)

    @when(lambda m: m.h, "falling")
    def bounce(m) -> dict[str, Any]:
        return dict(h=0.0, v=-m.e * m.v)

    @every(0.1)
    def sample(m) -> dict[str, Any]:
        return dict(on=m.h > 0.5)


def ball() -> Model:
    build_native(Ball, "folder", "fmi3")
    build_native(Ball(e=0.9), "folder", "fmi2")
    print(Ball(e=0.9).bounce()["v"])
    return Ball.model()


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
    "fmu_export.parameter(0.8, unti='m')": 'Unexpected keyword argument "unti" for "parameter"',
    "fmu_export.when(lambda m: m.h, 'fallign')": 'Argument 2 to "when" has incompatible type',
    "class B(fmu_export.ModelClass, stoptime=1.0): pass": 'Unexpected keyword argument "stoptime"',
    "fmu_export.ModelClass().y": '"ModelClass" has no attribute "y"',
}


@pytest.mark.slow
def test_a_strict_type_checker_takes_good_scripts_and_finds_mistakes(tmp_path: Path) -> None:
    (tmp_path / "good.py").write_text(SCRIPT)
    (tmp_path / "bad.py").write_text("\n".join(["import cosim, fmu_export", *WRONG]))
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", "cache", "--no-error-summary"]
    done = subprocess.run([*command, "good.py", "bad.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    found = [line for line in done.stdout.splitlines() if ": error:" in line]
    assert len(found) == len(WRONG), done.stdout
    for number, (line, message) in enumerate(zip(found, WRONG.values(), strict=True), start=2):
        assert line.startswith(f"bad.py:{number}: error: {message}")
