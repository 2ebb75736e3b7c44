"""A controller of your own, here PID on each active joint; this file builds its FMU.

Then: cosim run --fmu controller=PID.fmu
"""

from pathlib import Path

import numpy as np

from fmu_export import DefaultExperiment, Layout, Model, Variable, build_native

INPUTS = Layout(
    [
        Variable("theta_a", "rad", "Measured angle of the active links", size=3),
        Variable("omega_a", "rad/s", "Measured angular velocity of the active links", size=3),
        Variable("theta_ref", "rad", "Desired angle of the active links", size=3),
        Variable("omega_ref", "rad/s", "Desired angular velocity of the active links", size=3),
    ]
)
OUTPUTS = Layout(
    [
        Variable("tau_a", "N.m", "Torque on the active joints", size=3),
        Variable("z", "rad.s", "Integral of the angle error", size=3),
    ]
)
PARAMETERS = Layout(
    [
        Variable("K_p", "N.m/rad", "Proportional gain", start=6.0, tunable=True),
        Variable("K_i", "N.m/(rad.s)", "Integral gain", start=12.0, tunable=True),
        Variable("K_d", "N.m.s/rad", "Derivative gain", start=2.0, tunable=True),
    ]
)


def initial_state(p):
    """State x at the start."""
    return np.zeros(3)


def derivatives(t, x, u, p):
    """Time derivative of the state x."""
    U = INPUTS.unpack(u)
    return U.theta_a - U.theta_ref


def outputs(t, x, u, p):
    """Torque, and the state itself."""
    U, P = INPUTS.unpack(u), PARAMETERS.unpack(p)
    tau_a = -P.K_p * (U.theta_a - U.theta_ref) - P.K_i * x - P.K_d * (U.omega_a - U.omega_ref)
    return OUTPUTS.pack(tau_a=tau_a, z=x)


MODEL = Model(
    name="PID",
    description="PID control of each active joint",
    parameters=PARAMETERS,
    inputs=INPUTS,
    outputs=OUTPUTS,
    states=("z",),  # those of the outputs that are the state x
    initial_state=initial_state,
    derivatives=derivatives,
    output_values=outputs,
    default_experiment=DefaultExperiment(stop_time=15.0, step_size=1e-3),
)

if __name__ == "__main__":
    print("built", build_native(MODEL, Path(), "fmi2"))
