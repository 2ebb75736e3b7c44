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

#: A room with a heater that a thermostat switches; `switched` counts the switchings, and is not an output.
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


def _counted(*changes: Any) -> Any:
    return np.stack([c + 0.0 for c in changes])


#: sin(2 pi t) crosses zero; each direction is counted, and `last` is when there was one. There are not states.
CROSSINGS = Model(
    name="Crossings",
    parameters=[Variable("f", "Hz", start=1.0)],
    outputs=[Variable("falls"), Variable("rises"), Variable("all"), Variable("last", "s")],
    discrete=[Variable("falls"), Variable("rises"), Variable("all"), Variable("last", "s")],
    output_values=lambda t, x, z, u, p: z,
    default_experiment=DefaultExperiment(3.0, 0.1),
    events=[
        Event(
            "fall",
            lambda t, x, z, u, p: np.sin(2.0 * np.pi * p[0] * t),
            lambda t, x, z, u, p: (x, _counted(z[0] + 1.0, z[1], z[2], t)),
        ),
        Event(
            "rise",
            lambda t, x, z, u, p: np.sin(2.0 * np.pi * p[0] * t),
            lambda t, x, z, u, p: (x, _counted(z[0], z[1] + 1.0, z[2], t)),
            "rising",
        ),
        Event(
            "cross",
            lambda t, x, z, u, p: np.sin(2.0 * np.pi * p[0] * t),
            lambda t, x, z, u, p: (x, _counted(z[0], z[1], z[2] + 1.0, t)),
            "both",
        ),
    ],
)

#: Two samplers: each counts, and the slow one notes what the fast one has counted before.
SAMPLERS = Model(
    name="Samplers",
    outputs=[Variable("fast"), Variable("slow"), Variable("seen")],
    discrete=[Variable("fast"), Variable("slow"), Variable("seen")],
    output_values=lambda t, x, z, u, p: z,
    default_experiment=DefaultExperiment(1.0, 0.1),
    sampled=[
        Sampled("fast", lambda t, x, z, u, p: _counted(z[0] + 1.0, z[1], z[2]), 0.1),
        Sampled("slow", lambda t, x, z, u, p: _counted(z[0], z[1] + 1.0, z[0]), 0.15, 0.05),
    ],
)

#: A sample-and-hold element, and a switch that counts how often its input rises.
HOLD = Model(
    name="Hold",
    inputs=[Variable("u"), Variable("v")],
    outputs=[Variable("y"), Variable("switched"), Variable("when", "s")],
    discrete=[Variable("y"), Variable("switched"), Variable("when", "s")],
    output_values=lambda t, x, z, u, p: z,
    default_experiment=DefaultExperiment(1.0, 0.1),
    sampled=[Sampled("hold", lambda t, x, z, u, p: _counted(u[0], z[1], z[2]), 0.1)],
    events=[
        Event(
            "switch",
            lambda t, x, z, u, p: u[1] - 0.5,
            lambda t, x, z, u, p: (x, _counted(z[0], z[1] + 1.0, t)),
            "rising",
        )
    ],
)

#: x = t - 0.2 crosses zero exactly at a sampling instant; the sampler notes whether it has seen the event.
COINCIDENCE = Model(
    name="Coincidence",
    outputs=[Variable("x"), Variable("hits"), Variable("seen")],
    states=["x"],
    discrete=[Variable("hits"), Variable("seen")],
    initial_state=lambda p: np.array([-0.2]),
    derivatives=lambda t, x, z, u, p: 1.0 + 0.0 * x,
    output_values=lambda t, x, z, u, p: np.concatenate([x, z]),
    default_experiment=DefaultExperiment(1.0, 0.1),
    sampled=[Sampled("look", lambda t, x, z, u, p: _counted(z[0], z[0]), 0.1)],
    events=[Event("hit", lambda t, x, z, u, p: x[0], lambda t, x, z, u, p: (x, _counted(z[0] + 1.0, z[1])), "rising")],
)

#: A parabola that is below zero from 0.49 to 0.51 s.
DIP = Model(
    name="Dip",
    outputs=[Variable("x"), Variable("v"), Variable("falls"), Variable("rises"), Variable("last", "s")],
    states=["x", "v"],
    discrete=[Variable("falls"), Variable("rises"), Variable("last", "s")],
    initial_state=lambda p: np.array([0.25 - 1e-4, -1.0]),
    derivatives=lambda t, x, z, u, p: np.stack([x[1], 2.0 + 0.0 * x[1]]),
    output_values=lambda t, x, z, u, p: np.concatenate([x, z]),
    default_experiment=DefaultExperiment(1.0, 1.0),
    events=[
        Event("fall", lambda t, x, z, u, p: x[0], lambda t, x, z, u, p: (x, _counted(z[0] + 1.0, z[1], t))),
        Event("rise", lambda t, x, z, u, p: x[0], lambda t, x, z, u, p: (x, _counted(z[0], z[1] + 1.0, t)), "rising"),
    ],
)

_BALLS = 30

#: Many equal balls, whose events are at one instant.
BALLS = Model(
    name="Balls",
    parameters=BALL.parameters,
    outputs=[Variable("h", "m", size=_BALLS), Variable("v", "m/s", size=_BALLS)],
    states=["h", "v"],
    initial_state=lambda p: np.concatenate([np.ones(_BALLS) * p[2], np.zeros(_BALLS)]),
    derivatives=lambda t, x, u, p: np.concatenate([x[_BALLS:], -p[0] * np.ones(_BALLS)]),
    default_experiment=DefaultExperiment(3.0, 0.01),
    events=[
        Event(
            f"bounce_{i}",
            lambda t, x, u, p, i=i: x[i],  # type: ignore[misc]
            lambda t, x, u, p, i=i: np.concatenate(  # type: ignore[misc]
                [x[:i], np.zeros(1), x[i + 1 : _BALLS + i], -p[1] * x[_BALLS + i : _BALLS + i + 1], x[_BALLS + i + 1 :]]
            ),
        )
        for i in range(_BALLS)
    ],
)

#: The input sets off the first of a chain of events, which are declared from its end; z holds what has happened.
CHAIN = Model(
    name="Chain",
    inputs=[Variable("u")],
    parameters=[Variable("endless", start=0.0)],
    outputs=[Variable("z", size=4)],
    discrete=[Variable("z", size=4)],
    output_values=lambda t, x, z, u, p: z,
    events=[
        Event(
            "back", lambda t, x, z, u, p: z[3] - 0.5, lambda t, x, z, u, p: (x, _counted(*(z * (1.0 - p[0])))), "rising"
        ),
        Event(
            "third",
            lambda t, x, z, u, p: z[1] - 0.5,
            lambda t, x, z, u, p: (x, _counted(*z[:3], z[1] + z[3])),
            "rising",
        ),
        Event(
            "second", lambda t, x, z, u, p: z[0] - 0.5, lambda t, x, z, u, p: (x, _counted(z[0], 1.0, *z[2:])), "rising"
        ),
        Event(
            "first",
            lambda t, x, z, u, p: np.where(z[0] < 0.5, u[0] - 0.5, -1.0),
            lambda t, x, z, u, p: (x, _counted(1.0, *z[1:])),
            "rising",
        ),
    ],
)

HYBRID = {m.name: m for m in (BALL, THERMOSTAT, SAMPLED_PI, CROSSINGS, SAMPLERS, HOLD, COINCIDENCE, DIP, BALLS, CHAIN)}
