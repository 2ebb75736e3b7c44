"""Models with events, sampling and discrete states, whose behaviour is known in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np

from fmu_export.modelling.model import DefaultExperiment, Event, Model, Sampled
from fmu_export.modelling.variables import Variable

#: A ball that bounces: height and speed, restitution e.
BALL = Model(
    name="Ball",
    description="A bouncing ball",
    parameters=[Variable("g", "m/s2", start=9.81), Variable("e", start=0.8), Variable("h_start", "m", start=1.0)],
    inputs=[],
    outputs=[Variable("h", "m"), Variable("v", "m/s")],
    states=["h", "v"],
    initial_state=lambda p: np.stack([p[2], 0.0 * p[0]]),
    derivatives=lambda t, x, u, p: np.stack([x[1], -p[0]]),
    output_values=lambda t, x, u, p: x,
    default_experiment=DefaultExperiment(3.0, 0.01),
    events=[
        Event(
            "bounce",
            indicator=lambda t, x, u, p: x[0],
            reset=lambda t, x, u, p: np.stack([0.0 * x[0], -p[1] * x[1]]),
        )
    ],
)

#: A room with a heater that a thermostat switches; `switched` counts the switchings, and is no output.
THERMOSTAT = Model(
    name="Thermostat",
    description="A room with a thermostat",
    parameters=[
        Variable("low", "K", start=18.0, tunable=True),
        Variable("high", "K", start=22.0),
        Variable("tau", "s", start=100.0),
        Variable("rate", "K/s", start=0.3),
    ],
    inputs=[Variable("ambient", "K", start=10.0)],
    outputs=[Variable("T", "K"), Variable("on")],
    states=["T"],
    discrete=[Variable("on"), Variable("switched")],
    initial_state=lambda p: np.stack([20.0 + 0.0 * p[0]]),
    derivatives=lambda t, x, z, u, p: (u - x) / p[2] + z[:1] * p[3],
    output_values=lambda t, x, z, u, p: np.stack([x[0], z[0]]),
    default_experiment=DefaultExperiment(1000.0, 1.0),
    events=[
        Event(
            "too_cold",
            indicator=lambda t, x, z, u, p: x[0] - p[0],
            reset=lambda t, x, z, u, p: (x, np.stack([1.0 + 0.0 * z[0], z[1] + 1.0])),
        ),
        Event(
            "too_warm",
            indicator=lambda t, x, z, u, p: x[0] - p[1],
            reset=lambda t, x, z, u, p: (x, np.stack([0.0 * z[0], z[1] + 1.0])),
            direction="rising",
        ),
    ],
)


def _control(t: Any, x: Any, z: Any, u: Any, p: Any) -> Any:
    error = u[0] - x[0]
    unlimited = p[0] * error + z[0] + p[1] * error
    limited = np.clip(unlimited, -p[2], p[2])
    return np.stack([np.where(limited == unlimited, z[0] + p[1] * error, z[0]), limited])


#: A lag x' = -x + control under a sampled PI controller with anti-windup.
SAMPLED_PI = Model(
    name="SampledPI",
    description="A lag under a sampled PI controller",
    parameters=[
        Variable("K", start=2.0, tunable=True),
        Variable("K_i", start=0.5),
        Variable("limit", start=1.5),
        Variable("period", "s", start=0.1),
        Variable("offset", "s", start=0.0),
    ],
    inputs=[Variable("reference", start=1.0)],
    outputs=[Variable("x"), Variable("control")],
    states=["x"],
    discrete=[Variable("integral"), Variable("control")],
    initial_state=lambda p: 0.0 * p[:1],
    derivatives=lambda t, x, z, u, p: z[1:] - x,
    output_values=lambda t, x, z, u, p: np.stack([x[0], z[1]]),
    default_experiment=DefaultExperiment(2.1, 0.1),
    sampled=[Sampled("controller", _control, period="period", offset="offset")],
)
