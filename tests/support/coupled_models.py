"""Models that are small parts of systems whose solutions are known, for tests of model exchange."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from fmu_export.modelling.model import Event, Model, Sampled
from fmu_export.modelling.variables import Variable

#: A mass that a force accelerates.
MASS = Model(
    name="Mass",
    parameters=[Variable("m", "kg", start=2.0), Variable("x_start", "m"), Variable("v_start", "m/s")],
    inputs=[Variable("F", "N")],
    outputs=[Variable("x", "m"), Variable("v", "m/s")],
    states=["x", "v"],
    initial_state=lambda p: p[1:3],
    derivatives=lambda t, x, u, p: np.stack([x[1], u[0] / p[0]]),
    output_values=lambda t, x, u, p: x,
)

#: A spring with a damper between two masses: direct feedthrough, and no states.
SPRING = Model(
    name="Spring",
    parameters=[Variable("c", "N/m", start=50.0), Variable("d", "N.s/m", start=0.4)],
    inputs=[Variable("x", "m", size=2), Variable("v", "m/s", size=2)],
    outputs=[Variable("F", "N", size=2)],
    output_values=lambda t, x, u, p: np.stack(
        [p[0] * (u[1] - u[0]) + p[1] * (u[3] - u[2]), p[0] * (u[0] - u[1]) + p[1] * (u[2] - u[3])]
    ),
)

#: A room that is heated or not.
ROOM = Model(
    name="Room",
    parameters=[
        Variable("tau", "s", start=80.0),
        Variable("rate", "K/s", start=0.25),
        Variable("T_start", "K", start=20.0),
    ],
    inputs=[Variable("ambient", "K", start=12.0), Variable("on", type="boolean")],
    outputs=[Variable("T", "K")],
    states=["T"],
    initial_state=lambda p: p[2:3],
    derivatives=lambda t, x, u, p: (u[:1] - x) / p[0] + u[1:] * p[1],
    output_values=lambda t, x, u, p: x,
)

#: What switches its heater: a machine of two modes, which sees the temperature as an input.
SWITCH = Model(
    name="Switch",
    parameters=[Variable("low", "K", start=18.0), Variable("high", "K", start=22.0)],
    inputs=[Variable("T", "K", start=20.0)],
    outputs=[Variable("on", type="boolean")],
    discrete=[Variable("on", type="boolean")],
    output_values=lambda t, x, z, u, p: z,
    events=[
        Event("cold", lambda t, x, z, u, p: u[0] - p[0], lambda t, x, z, u, p: (x, np.ones(1) + 0.0 * z)),
        Event("warm", lambda t, x, z, u, p: u[0] - p[1], lambda t, x, z, u, p: (x, 0.0 * z), "rising"),
    ],
)

#: A sampled proportional controller.
SAMPLED = Model(
    name="Sampled",
    parameters=[Variable("K", start=2.0, tunable=True)],
    inputs=[Variable("reference", start=1.0), Variable("x")],
    outputs=[Variable("u")],
    discrete=[Variable("u")],
    output_values=lambda t, x, z, u, p: z,
    sampled=[Sampled("law", lambda t, x, z, u, p: p[:1] * (u[:1] - u[1:]), 0.1)],
)

ALL = (MASS, SPRING, ROOM, SWITCH, SAMPLED)


def oscillator_matrix(masses: tuple[float, float], c: float, d: float) -> np.ndarray:
    """Matrix (4, 4) of the motion x_1, v_1, x_2, v_2 of two masses with a spring and a damper between them."""
    pull = np.array([-c, -d, c, d])
    matrix = np.zeros((4, 4))
    matrix[0, 1] = matrix[2, 3] = 1.0
    matrix[1], matrix[3] = pull / masses[0], -pull / masses[1]
    return matrix


def oscillation(times: np.ndarray, masses: tuple[float, float], start: np.ndarray, c: float, d: float) -> np.ndarray:
    """Their places and speeds (n, 4) at times (n,) in s."""
    return np.array([expm(oscillator_matrix(masses, c, d) * t) @ start for t in times])
