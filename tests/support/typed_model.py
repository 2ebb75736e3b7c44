"""A model with variables of all types."""

from __future__ import annotations

import numpy as np

from fmu_export.modelling.model import Model
from fmu_export.modelling.variables import Layout, Variable

SPEEDS = ("off", "slow", "fast")
KINDS = {"low": -1, "high": 7}
TEXTS = ("plain", "b & c", "<größer> 'n' \"co\"")

#: Inputs go to outputs of their type; the state decays at a rate that the parameters choose.
TYPED = Model(
    name="Typed",
    parameters=Layout(
        [
            Variable("n", type="integer", start=3, min=1, max=9, tunable=True),
            Variable("flag", type="boolean", start=True),
            Variable("speed", type="enumeration", items=SPEEDS, start="slow"),
            Variable("label", type="string", items=TEXTS, start="b & c"),
            Variable("N", type="integer", size=2, start=[4, -5]),
        ]
    ),
    inputs=Layout(
        [
            Variable("u", "m"),
            Variable("on", type="boolean"),
            Variable("level", type="integer", start=-2),
            Variable("kind", type="enumeration", items=KINDS),
            Variable("text", type="string", items=TEXTS),
        ]
    ),
    outputs=Layout(
        [
            Variable("x"),
            Variable("half", type="integer"),
            Variable("not_on", type="boolean"),
            Variable("kind_seen", type="enumeration", items=KINDS),
            Variable("text_seen", type="string", items=TEXTS),
            Variable("y"),
        ]
    ),
    locals=Layout([Variable("count", type="integer")]),
    states=("x",),
    initial_state=lambda p: np.stack([1.0 + p[1]]),
    # 0, 1 or 2 by the enumeration
    derivatives=lambda t, x, u, p: -(p[2] - 1.0) * x,
    output_values=lambda t, x, u, p: np.stack(
        [x[0], u[2] / 2.0, 1.0 - u[1], u[3], u[4], u[0] + p[0] + 10.0 * p[3] + 100.0 * p[4] + 1000.0 * p[5], p[0]]
    ),
)
