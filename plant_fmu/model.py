"""`RobotPlant`: the closed-chain robot as a `Model` (equations in `kinematics` and `dynamics`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from fmu_export.modelling.functions import norm
from fmu_export.modelling.model import DefaultExperiment, Model, ModelFunction, Requirement
from fmu_export.modelling.variables import Layout, Variable
from plant_fmu.dynamics import closed_chain, mass_matrix, uncertain_inertia
from plant_fmu.kinematics import chain_ends, inverse_kinematics, loop_closure, reach_margin, velocity_jacobians

Array = Any

#: Link length and base positions (m): the paper's section 6 and (87), with A1 corrected to (0, 0.25) (see README.md).
#: Fixed: another geometry during a run would tear the closed chain apart.
GEOMETRY = (
    Variable("l", "m", "Length of every link", start=0.244, min=1e-6),
    Variable("x_A", "m", "x position of the base joints", size=3, start=(0.0, 0.43, 0.4269)),
    Variable("y_A", "m", "y position of the base joints", size=3, start=(0.25, 0.0, 0.5005)),
)

#: Inertia constants (87). Tunable: the closure (16) does not contain them, so angles and angular velocities satisfy it
#: after a change, too; the velocities stay what they are, as with the mass change dm.
INERTIA = (
    Variable("X", "kg.m2", "Inertia constant X of (13)", start=0.0932, min=1e-12, tunable=True),
    Variable("Y", "kg.m2", "Inertia constant Y of (13)", start=0.0381, min=1e-12, tunable=True),
    Variable("Z", "kg.m2", "Inertia constant Z of (13)", start=0.0426, min=0.0, tunable=True),
)

#: Fixed besides the geometry are start position and velocity, which act at the start only, and m_a, m_b, r_a: they say
#: how the nominal inertia came about, but a change of a mass does not change X, Y, Z. The input dm changes the masses
#: in a run.
PARAMETERS = Layout(
    [
        *INERTIA,
        Variable("m_a", "kg", "Mass of every active link", start=1.2525, min=1e-12),
        Variable("m_b", "kg", "Mass of every passive link", start=1.0771, min=1e-12),
        *GEOMETRY,
        Variable("r_a", "m", "Mass centre of the active link, from its joint", start=0.122, min=0.0),
        Variable("x_E_start", "m", "Initial x position of the end effector", start=0.22),
        Variable("y_E_start", "m", "Initial y position of the end effector", start=0.30),
        Variable("v_x_start", "m/s", "Initial x velocity of the end effector"),
        Variable("v_y_start", "m/s", "Initial y velocity of the end effector"),
        Variable("baumgarte", "s-1", "Rate of Baumgarte's closure stabilisation", start=10.0, min=0.0, tunable=True),
    ]
)

INPUTS = Layout(
    [
        Variable("tau_a", "N.m", "Torque on the active joints", size=3),
        Variable("tau_d", "N.m", "Disturbance torque on the active joints", size=3),
        Variable("dm", "kg", "Uncertain growth of both link masses of every chain"),
        Variable("dm_rate", "kg/s", "Rate of the growth that arrives at rest; 0: mass arrives moving as the link does"),
    ]
)

OUTPUTS = Layout(
    [
        Variable("theta_a", "rad", "Angle of the active links, from the x axis", size=3),
        Variable("theta_b", "rad", "Angle of the passive links, from the x axis", size=3),
        Variable("omega_a", "rad/s", "Angular velocity of the active links", size=3),
        Variable("omega_b", "rad/s", "Angular velocity of the passive links", size=3),
        Variable("x_E", "m", "x position of the end effector"),
        Variable("y_E", "m", "y position of the end effector"),
        Variable("F_c", "N.m", "Closure force in joint coordinates, (19)", size=6),
        Variable("closure_error", "m", "Norm of the loop closure (16)"),
        Variable("kinetic_energy", "J", "Kinetic energy of all links"),
    ]
)


def _inertia(u: Any, p: Any) -> tuple[Any, Any, Any]:
    """Inertia constants with the uncertainty dm; r_b = Z / (m_b l) by (13)."""
    return uncertain_inertia(p.X, p.Y, p.Z, u.dm, p.l, p.r_a, p.Z / (p.m_b * p.l))


def _inertia_rates(u: Any, p: Any) -> tuple[Any, Any, Any]:
    """Rates of the inertia constants, of mass that arrives at rest."""
    return uncertain_inertia(0.0, 0.0, 0.0, u.dm_rate, p.l, p.r_a, p.Z / (p.m_b * p.l))


def _dynamics(x: Array, u: Array, p: Array) -> tuple[Array, Array]:
    """Accelerations (6,) and closure force (6,); the disturbance acts beside the control torque (28)."""
    U, P = INPUTS.unpack(u), PARAMETERS.unpack(p)
    inertia, rates = _inertia(U, P), _inertia_rates(U, P)
    return closed_chain(x[:6], x[6:], U.tau_a + U.tau_d, *inertia, P.l, P.x_A, P.y_A, P.baumgarte, rates)


def initial_state(p: Array) -> Array:
    """State (12,) at the start position and velocity of the end effector: closed to rounding, by inverse kinematics."""
    P = PARAMETERS.unpack(p)
    theta = inverse_kinematics(P.x_E_start, P.y_E_start, P.l, P.x_A, P.y_A)
    omega = np.concatenate(velocity_jacobians(theta, P.l)) @ np.stack([P.v_x_start, P.v_y_start])
    return np.concatenate([theta, omega])


def derivatives(t: Any, x: Array, u: Array, p: Array) -> Array:  # noqa: ARG001 -- the plant is autonomous
    """Derivative (12,) of the state [theta; omega]: (20) solved for theta''."""
    accelerations, _ = _dynamics(x, u, p)
    return np.concatenate([x[6:], accelerations])


def output_values(t: Any, x: Array, u: Array, p: Array) -> Array:  # noqa: ARG001
    """Outputs (22,) in the order of `OUTPUTS`; the end effector is the mean of the three chain ends."""
    U, P = INPUTS.unpack(u), PARAMETERS.unpack(p)
    theta, omega = x[:6], x[6:]
    x_ends, y_ends = chain_ends(theta, P.l, P.x_A, P.y_A)
    phi = loop_closure(theta, P.l, P.x_A, P.y_A)
    _, F_c = _dynamics(x, u, p)
    return OUTPUTS.pack(
        theta_a=theta[:3],
        theta_b=theta[3:],
        omega_a=omega[:3],
        omega_b=omega[3:],
        x_E=np.sum(x_ends) / 3.0,
        y_E=np.sum(y_ends) / 3.0,
        F_c=F_c,
        closure_error=norm(phi),
        kinetic_energy=0.5 * (omega @ mass_matrix(theta, *_inertia(U, P)) @ omega),
    )


def _reach_of_chain(i: int) -> ModelFunction:
    def margin(t: Any, x: Array, u: Array, p: Array) -> Any:  # noqa: ARG001
        P = PARAMETERS.unpack(p)
        return reach_margin(P.x_E_start, P.y_E_start, P.l, P.x_A, P.y_A)[i]

    return margin


def _inertia_margin(which: int) -> ModelFunction:
    def margin(t: Any, x: Array, u: Array, p: Array) -> Any:  # noqa: ARG001
        X, Y, Z = _inertia(INPUTS.unpack(u), PARAMETERS.unpack(p))
        return (X, Y, X * Y - Z**2)[which]

    return margin


#: Of the link length, what the loop closure may be off; beyond, some hundredths of the torques' work are lost.
CLOSURE_LIMIT = 1.0 / 250.0


def _closure_margin(t: Any, x: Array, u: Array, p: Array) -> Any:  # noqa: ARG001
    P = PARAMETERS.unpack(p)
    phi = loop_closure(x[:6], P.l, P.x_A, P.y_A)
    return (CLOSURE_LIMIT * P.l) ** 2 - phi @ phi


_INDEFINITE = (
    "the mass matrix is not positive definite: {} must be positive with the mass change dm added; "
    "make dm larger (less negative) or correct X, Y, Z, m_b, r_a"
)

MODEL = Model(
    name="RobotPlant",
    description="Planar 2-DOF redundantly actuated parallel robot, closed chain by the Udwadia-Kalaba equation",
    parameters=PARAMETERS,
    inputs=INPUTS,
    outputs=OUTPUTS,
    states=("theta_a", "theta_b", "omega_a", "omega_b"),
    initial_state=initial_state,
    derivatives=derivatives,
    output_values=output_values,
    solver="rk43",
    default_experiment=DefaultExperiment(stop_time=15.0, step_size=1e-3),
    requirements=(
        *(
            Requirement(
                f"the start position (x_E_start, y_E_start) is out of reach of chain {i + 1}: "
                f"move it to within 2 l of the base (x_A[{i + 1}], y_A[{i + 1}])",
                _reach_of_chain(i),
                at="start",
            )
            for i in range(3)
        ),
        *(Requirement(_INDEFINITE.format(what), _inertia_margin(i)) for i, what in enumerate(("X", "Y", "X Y - Z^2"))),
        Requirement(
            "the loop closure is lost, closure_error is above l / 250: the internal step does not resolve the motion; "
            "make the torques or max_step smaller",
            _closure_margin,
            of_integration=True,
        ),
    ),
)
