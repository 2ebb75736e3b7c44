"""`RobotTrajectory`: the desired path (93) and its joint angles as a `Model`.

Equation numbers are those of Han et al. 2021.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fmu_export.modelling.model import DefaultExperiment, Model, ModelFunction, Requirement
from fmu_export.modelling.variables import Layout, Variable
from plant_fmu.inverse_dynamics import minimum_norm_torque
from plant_fmu.kinematics import directions_to, inverse_kinematics, reach_margin, velocity_jacobians
from plant_fmu.model import GEOMETRY, INERTIA

Array = Any

_NOT_PRINTED = "(not in the paper, see README.md)"

#: Tunable is what moves, turns or scales the path: a change is a jump of the reference of just that size, a change of
#: set point, and the velocity stays the derivative of the path. w and n multiply the time: a change would throw the
#: reference to another place of the path, the farther the later it comes, so they are fixed.
PARAMETERS = Layout(
    [
        Variable("x_c", "m", f"x position of the centre of the path {_NOT_PRINTED}", start=0.225, tunable=True),
        Variable("y_c", "m", f"y position of the centre of the path {_NOT_PRINTED}", start=0.355, tunable=True),
        Variable("phase", "rad", f"Phase of the path {_NOT_PRINTED}", start=-np.pi / 2, tunable=True),
        Variable("w", "rad/s", "Angular frequency omega of (93)", start=1.0),
        Variable("n", "1", "Number of lobes n of (93)", start=5.0),
        Variable("R", "1", "Depth R of the lobes of (93)", start=0.5, tunable=True),
        Variable("a", "1", "Radius a of (93), in units of b", start=3.0, tunable=True),
        Variable("b", "m", "Scale b of (93)", start=0.06 / 3.5, tunable=True),
        *GEOMETRY,
        *INERTIA,
    ]
)

INPUTS = Layout([])

OUTPUTS = Layout(
    [
        Variable("theta_ref", "rad", "Desired angle of the active links", size=3),
        Variable("omega_ref", "rad/s", "Desired angular velocity of the active links", size=3),
        Variable("x_ref", "m", "Desired x position of the end effector"),
        Variable("y_ref", "m", "Desired y position of the end effector"),
        Variable("tau_ref", "N.m", "Least torque that moves the nominal robot as desired, (27)", size=3),
    ]
)


def desired_path(t: Any, p: Array) -> tuple[Array, Array, Array]:
    """Desired position (m), velocity (m/s) and acceleration (m/s^2) of the end effector, (2,) each, at t (s), (93)."""
    P = PARAMETERS.unpack(p)
    angle = P.w * t + P.phase
    radius = P.b * (P.a + P.R * np.cos(P.n * P.w * t))
    radius_rate = -P.b * P.R * P.n * P.w * np.sin(P.n * P.w * t)
    radius_acceleration = -P.b * P.R * (P.n * P.w) ** 2 * np.cos(P.n * P.w * t)
    outward = np.stack([np.cos(angle), np.sin(angle)])
    along = np.stack([-np.sin(angle), np.cos(angle)])
    centre = np.stack([P.x_c, P.y_c])
    return (
        centre + radius * outward,
        radius_rate * outward + radius * P.w * along,
        (radius_acceleration - radius * P.w**2) * outward + 2.0 * radius_rate * P.w * along,
    )


def initial_state(p: Array) -> Array:
    """Empty state (0,): the path is a function of time."""
    return p[:0]


def derivatives(t: Any, x: Array, u: Array, p: Array) -> Array:  # noqa: ARG001
    """Empty derivative (0,)."""
    return x


def output_values(t: Any, x: Array, u: Array, p: Array) -> Array:  # noqa: ARG001
    """Outputs (11,): joint references by inverse kinematics and J_a of (23), torque by inverse dynamics."""
    P = PARAMETERS.unpack(p)
    position, velocity, acceleration = desired_path(t, p)
    theta = inverse_kinematics(position[0], position[1], P.l, P.x_A, P.y_A)
    links = directions_to(position[0], position[1], P.l, P.x_A, P.y_A)
    J_a, _ = velocity_jacobians(links, P.l)
    return OUTPUTS.pack(
        theta_ref=theta[:3],
        omega_ref=J_a @ velocity,
        x_ref=position[0],
        y_ref=position[1],
        tau_ref=minimum_norm_torque(links, velocity, acceleration, P.X, P.Y, P.Z, P.l),
    )


def _reach_of_chain(i: int) -> ModelFunction:
    def margin(t: Any, x: Array, u: Array, p: Array) -> Any:  # noqa: ARG001
        P = PARAMETERS.unpack(p)
        position, _, _ = desired_path(t, p)
        return reach_margin(position[0], position[1], P.l, P.x_A, P.y_A)[i]

    return margin


MODEL = Model(
    name="RobotTrajectory",
    description="Desired path of the end effector (93) and the joint references that follow it",
    parameters=PARAMETERS,
    inputs=INPUTS,
    outputs=OUTPUTS,
    states=(),
    initial_state=initial_state,
    derivatives=derivatives,
    output_values=output_values,
    default_experiment=DefaultExperiment(stop_time=15.0, step_size=1e-3),
    requirements=tuple(
        Requirement(
            f"the desired path (x_ref, y_ref) leaves the reach of chain {i + 1}: "
            f"move or shrink it (x_c, y_c, a, R, b) to stay within 2 l of the base (x_A[{i + 1}], y_A[{i + 1}])",
            _reach_of_chain(i),
        )
        for i in range(3)
    ),
)
