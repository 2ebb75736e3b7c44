"""`RobotController`: the paper's adaptive robust controller as a `Model`.

Equation numbers are those of Han et al. 2021. Feedforward and torque limits go beyond the paper and are off by default.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from fmu_export.modelling.functions import norm, saturate
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable

Array = Any

#: Start value of the torque limits, which stands for none: FMI has no infinity. It is that of Modelica.Constants.inf.
NO_LIMIT = 1e60

#: All but the start of psi are tunable: they enter (37) and (38) by their present values only, and psi goes on from
#: where it is. So a change is a jump of the torque and of psi', as a jump of an input is.
PARAMETERS = Layout(
    [
        Variable(
            "alpha",
            "1",
            "Weight of the robust part, (38); start value: optimum of Table 1, row (1, 1); 0 leaves PD control",
            start=1.3597632624476745,
            min=0.0,
            tunable=True,
        ),
        Variable(
            "beta",
            "N.m.s/rad",
            "Weight of the PD part, (38); start value: optimum of Table 1, row (1, 1)",
            start=1.6620017712713446,
            min=0.0,
            tunable=True,
        ),
        Variable(
            "S",
            "s-1",
            "Diagonal of S: ratio of position to velocity feedback",
            size=3,
            start=2.0,
            min=0.0,
            tunable=True,
        ),
        Variable("k", "1", "Adaptation constant of (37)", start=12.0, min=1e-12, tunable=True),
        Variable(
            "leakage",
            "s-1",
            "Leakage of (37): psi' = ... - leakage psi; 1 in the paper",
            start=1.0,
            min=0.0,
            tunable=True,
        ),
        Variable(
            "bound_angles",
            "1",
            "Factor of |theta_a|^2 in the bounding function (89); 0: full turns of the joints change nothing",
            start=1.0,
            min=0.0,
            tunable=True,
        ),
        Variable(
            "bound_constant",
            "1",
            "What is added to it in (89): psi_1 bounds what is there at rest; 0 in the paper",
            start=0.0,
            min=0.0,
            tunable=True,
        ),
        Variable("psi_start", "1", "Initial estimate psi of the uncertainty bound", size=2, start=0.0),
        Variable("feedforward", "1", "Share of tau_ref in the torque: 0 none (the paper), 1 all", tunable=True),
        Variable(
            "tau_max",
            "N.m",
            "Torque limit of each motor; 1e60 is none",
            size=3,
            start=NO_LIMIT,
            min=0.0,
            tunable=True,
        ),
    ]
)

INPUTS = Layout(
    [
        Variable("theta_a", "rad", "Measured angle of the active links", size=3),
        Variable("omega_a", "rad/s", "Measured angular velocity of the active links", size=3),
        Variable("theta_ref", "rad", "Desired angle of the active links", size=3),
        Variable("omega_ref", "rad/s", "Desired angular velocity of the active links", size=3),
        Variable("tau_ref", "N.m", "Torque that a nominal model needs for the desired motion", size=3),
    ]
)

OUTPUTS = Layout(
    [
        Variable("tau_a", "N.m", "Control torque on the active joints", size=3),
        Variable("psi", "1", "Estimate of the uncertainty bound, (90)", size=2),
    ]
)


def _sliding_error(U: SimpleNamespace, P: SimpleNamespace) -> Array:
    """Error s = theta_e' + S theta_e (3,) in rad/s, with theta_e = theta_a - theta_a,d (32)."""
    return (U.omega_a - U.omega_ref) + P.S * (U.theta_a - U.theta_ref)


def _regressor(U: SimpleNamespace, P: SimpleNamespace) -> Array:
    """Regressor (2,) of the bounding function: [|theta_a|^2; |theta_a'|^2] in (89)."""
    return np.stack([P.bound_angles * (U.theta_a @ U.theta_a) + P.bound_constant, U.omega_a @ U.omega_a])


def initial_state(p: Array) -> Array:
    """Initial psi (2,)."""
    return PARAMETERS.unpack(p).psi_start


def derivatives(t: Any, x: Array, u: Array, p: Array) -> Array:  # noqa: ARG001 -- the law is autonomous
    """Adaptive law psi' (2,) in 1/s, (37), (90)."""
    U, P = INPUTS.unpack(u), PARAMETERS.unpack(p)
    s = _sliding_error(U, P)
    return norm(s) / P.k * _regressor(U, P) - P.leakage * x


def output_values(t: Any, x: Array, u: Array, p: Array) -> Array:  # noqa: ARG001
    """Control torque and psi, (5,): (38), with the feedforward added, within the limits."""
    U, P = INPUTS.unpack(u), PARAMETERS.unpack(p)
    s = _sliding_error(U, P)
    Pi = x @ _regressor(U, P)  # (89)
    tau_1 = -s * Pi**2
    tau_2 = -s
    tau_a = P.alpha * tau_1 + P.beta * tau_2 + P.feedforward * U.tau_ref
    return OUTPUTS.pack(tau_a=saturate(tau_a, P.tau_max), psi=x)


MODEL = Model(
    name="RobotController",
    description="Adaptive robust controller of Han et al. 2021 for a parallel robot with three active joints",
    parameters=PARAMETERS,
    inputs=INPUTS,
    outputs=OUTPUTS,
    states=("psi",),
    initial_state=initial_state,
    derivatives=derivatives,
    output_values=output_values,
    solver="rk43",
    default_experiment=DefaultExperiment(stop_time=15.0, step_size=1e-3),
)
