"""Which outputs of robot, controller and trajectory feed which inputs; used by FMUs and by python-control alike."""

from __future__ import annotations

#: Names of the components in scenarios, results and analyses.
COMPONENTS = ("plant", "controller", "trajectory")

#: (source, target) as `component.variable`, whole vectors.
CONNECTIONS = (
    ("plant.theta_a", "controller.theta_a"),
    ("plant.omega_a", "controller.omega_a"),
    ("trajectory.theta_ref", "controller.theta_ref"),
    ("trajectory.omega_ref", "controller.omega_ref"),
    ("trajectory.tau_ref", "controller.tau_ref"),
    ("controller.tau_a", "plant.tau_a"),
)

#: Inputs that a system may leave unconnected, and what they are then: with a desired path that has no such output.
OPTIONAL_INPUTS = {"controller.tau_ref": 0.0}

#: Values of inputs of this package's FMUs that nothing has to feed: mass arrives moving, as in the paper.
UNFED_INPUTS = {"plant.dm_rate": 0.0}
