"""What acts on the robot in the runs: disturbance torque and mass change."""

from __future__ import annotations

import dataclasses

import numpy as np

from cosim.scenario.signals import Multisine, Shape, Sine
from cosim.system.system import Signal
from parallel_robot.paper.reproduce.content import Condition
from parallel_robot.scenario import RobotScenario

DISTURBANCE, MASS_CHANGE, MASS_RATE = "plant.tau_d", "plant.dm", "plant.dm_rate"


def multisine(scenario: RobotScenario) -> Multisine:
    """The disturbance torque of a scenario."""
    signal = scenario.signals[DISTURBANCE]
    assert isinstance(signal, Multisine)
    return signal


def signals(scenario: RobotScenario, condition: Condition, rms: float | None = None) -> list[Signal]:
    """Disturbance torque, of another size (rms in N m) if one is given, and mass change of a condition."""
    torque = multisine(scenario)
    if rms is not None:
        torque = dataclasses.replace(torque, rms=rms)
    mass: Shape = scenario.signals[MASS_CHANGE]
    if condition not in ("disturbed", "disturbance"):
        torque = dataclasses.replace(torque, rms=0.0)
    if condition not in ("disturbed", "mass change"):
        mass = Sine(amplitude=0.0, frequency=1.0)
    return [
        Signal(target, signal.function(size, scenario.seed, target), signal.breakpoints, vectorized=True)
        for target, signal, size in ((DISTURBANCE, torque, 3), (MASS_CHANGE, mass, 1))
    ]


#: Shapes of the disturbance torque, which the paper leaves open, and how long each lasts (s); None: until the end.
SHAPES: dict[str, float | None] = {"multisine": None, "multisine of 0.5 s": 0.5, "pulse of 0.2 s": 0.2}


def disturbance(scenario: RobotScenario, shape: str, level: float) -> list[Signal]:
    """Mass change and a disturbance torque from 4 s on.

    Parameters
    ----------
    scenario : RobotScenario
        Its multisine is taken, and its mass change.
    shape : str
        One of `SHAPES`.
    level : float
        Root mean square of a multisine, size of a pulse (N m).
    """
    torque, mass = signals(scenario, "disturbed", rms=level)
    start, lasts = multisine(scenario).start_time, SHAPES[shape]
    if lasts is None:
        return [torque, mass]
    end = start + lasts
    random = dataclasses.replace(multisine(scenario), rms=level).function(3, scenario.seed, DISTURBANCE)

    def values(times: float | np.ndarray) -> np.ndarray:
        t = np.asarray(times)
        inside = np.asarray((t >= start) & (t < end), dtype=float)[..., None]
        size = level if shape.startswith("pulse") else np.asarray(random(times))
        return np.asarray(inside * size * np.ones(3))

    return [dataclasses.replace(torque, function=values, breakpoints=(start, end)), mass]
