"""What acts on the robot in a run: the disturbance torque and the mass change of a scenario, or less."""

from __future__ import annotations

import dataclasses

from cosim.scenario.signals import Multisine, Shape, Sine
from cosim.system.system import Signal
from parallel_robot.paper.reproduce.content import Condition
from parallel_robot.scenario import RobotScenario

DISTURBANCE, MASS_CHANGE = "plant.tau_d", "plant.dm"


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
