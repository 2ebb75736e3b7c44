"""Two models in a few lines each; this file builds their FMUs, beside itself.

Then: cosim run tanks.toml
"""

from pathlib import Path

import numpy as np

from fmu_export import DefaultExperiment, Layout, Model, Variable, build_native

EXPERIMENT = DefaultExperiment(stop_time=60.0, step_size=0.05)

# A tank with a hole in its floor (Torricelli's law)

TANK_PARAMETERS = Layout(
    [
        Variable("A", "m2", "Cross section of the tank", start=0.5, min=1e-6),
        Variable("a", "m2", "Cross section of the hole", start=0.01, min=1e-9),
        Variable("level_start", "m", "Level at the start", start=0.2, min=0.0),
    ]
)
TANK_INPUTS = Layout([Variable("inflow", "m3/s", "What flows in")])
TANK_OUTPUTS = Layout([Variable("level", "m", "Level"), Variable("outflow", "m3/s", "What flows out")])


def outflow(level, a):
    """Flow through the hole (m3/s)."""
    return a * np.sqrt(2.0 * 9.81 * np.maximum(level, 1e-9))


TANK = Model(
    name="Tank",
    description="Tank with a hole in its floor",
    parameters=TANK_PARAMETERS,
    inputs=TANK_INPUTS,
    outputs=TANK_OUTPUTS,
    states=("level",),
    initial_state=lambda p: p[2:3],
    derivatives=lambda t, x, u, p: (u - outflow(x, p[1])) / p[0],
    output_values=lambda t, x, u, p: np.concatenate([x, outflow(x, p[1])]),
    default_experiment=EXPERIMENT,
)

# PI control of a level by a pump that only pumps in

CONTROLLER_PARAMETERS = Layout(
    [
        Variable("K_p", "m2/s", "Proportional gain", start=0.1),
        Variable("K_i", "m2/s2", "Integral gain", start=0.01),
        Variable("q_max", "m3/s", "Largest flow of the pump", start=0.1, min=0.0),
    ]
)
CONTROLLER_INPUTS = Layout([Variable("level", "m", "Measured level"), Variable("level_ref", "m", "Desired level")])
CONTROLLER_OUTPUTS = Layout(
    [Variable("flow", "m3/s", "Flow of the pump"), Variable("z", "m.s", "Integral of the error")]
)


def pump(t, x, u, p):
    """Flow of the pump, and the integral itself."""
    flow = np.clip(p[0] * (u[1:2] - u[0:1]) + p[1] * x, 0.0, p[2])
    return np.concatenate([flow, x])


LEVEL_CONTROLLER = Model(
    name="LevelController",
    description="PI control of a level",
    parameters=CONTROLLER_PARAMETERS,
    inputs=CONTROLLER_INPUTS,
    outputs=CONTROLLER_OUTPUTS,
    states=("z",),
    initial_state=lambda p: np.zeros(1),
    derivatives=lambda t, x, u, p: u[1:2] - u[0:1],
    output_values=pump,
    default_experiment=EXPERIMENT,
)

if __name__ == "__main__":
    for model in (TANK, LEVEL_CONTROLLER):
        print("built", build_native(model, Path(__file__).parent, "fmi2").name)
