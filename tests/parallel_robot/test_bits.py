"""Zero- and first-order hold with fixed internal steps have the bits that they had before other couplings came.

The numbers are those of commit 815be0e: nothing but an earlier version can say what its bits were. The signals have
values that are exact in binary arithmetic, wherever they are computed; what FMUs compute has the same bits anyway.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from cosim import Simulation, System
from parallel_robot.models import MODELS
from parallel_robot.wiring import CONNECTIONS

NAMES = ("plant.theta_a", "plant.theta_b", "plant.omega_a", "plant.omega_b", "controller.tau_a", "controller.psi")
JUMP = 0.5  # s

#: By flavour, order, extrapolation and communication step (s).
BITS = {
    ("fmi2", "sequential", "hold", 0.001): "b5a39c890bb41c5b",
    ("fmi2", "sequential", "hold", 0.005): "e78cbe48d3887f08",
    ("fmi2", "sequential", "linear", 0.001): "c8b98a96b320c6bc",
    ("fmi2", "sequential", "linear", 0.005): "f1a71834e6bce23f",
    ("fmi2", "parallel", "hold", 0.001): "787ea19fc3c6ae4e",
    ("fmi2", "parallel", "hold", 0.005): "8d61664ba7e28aaf",
    ("fmi2", "parallel", "linear", 0.001): "214949fb78c9b536",
    ("fmi2", "parallel", "linear", 0.005): "d85e389a8f48ddf1",
    ("fmi3", "sequential", "hold", 0.001): "b5a39c890bb41c5b",
    ("fmi3", "sequential", "hold", 0.005): "e78cbe48d3887f08",
    ("fmi3", "sequential", "linear", 0.001): "8ddbd7383d00ebb1",
    ("fmi3", "sequential", "linear", 0.005): "771fa7a637024d07",
    ("fmi3", "parallel", "hold", 0.001): "787ea19fc3c6ae4e",
    ("fmi3", "parallel", "hold", 0.005): "8d61664ba7e28aaf",
    ("fmi3", "parallel", "linear", 0.001): "2b661276a698f1fc",
    ("fmi3", "parallel", "linear", 0.005): "dc32ae84402308df",
}


def disturbed(folder: Path, flavour: str) -> System:
    """The robot on its path, with a mass that grows, and a torque that sets in at once."""
    system = System()
    fixed = {"rtol": 0.0, "max_step": 1e-3}
    for name, model in MODELS.items():
        system.add(name, folder / flavour / f"{model.name}.fmu", start=fixed if model.states else None)
    for source, target in CONNECTIONS:
        system.connect(source, target)
    system.drive("plant.dm", lambda t: 0.125 * t, vectorized=True)
    torque = np.array([0.25, -0.125, 0.5])
    system.drive("plant.tau_d", lambda t: (t >= JUMP)[:, None] * torque, breakpoints=[JUMP], vectorized=True)
    return system


def bits(system: System, order: str, extrapolation: str, step: float) -> str:
    with Simulation(system, order=order, extrapolation=extrapolation) as simulation:
        run = simulation.run(1.0, step)
    return hashlib.sha256(b"".join(np.ascontiguousarray(run[name]).tobytes() for name in NAMES)).hexdigest()[:16]


@pytest.mark.parametrize(("flavour", "order", "extrapolation", "step"), BITS)
def test_hold_and_linear_have_their_bits(
    native_fmus: Path, flavour: str, order: str, extrapolation: str, step: float
) -> None:
    found = bits(disturbed(native_fmus, flavour), order, extrapolation, step)
    assert found == BITS[flavour, order, extrapolation, step]
