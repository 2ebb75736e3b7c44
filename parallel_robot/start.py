"""The start value of the paper's Lyapunov function (42), from the robot at its start and the path it has to follow."""

from __future__ import annotations

import numpy as np

from controller_fmu.optimal_gains import lyapunov_constants
from plant_fmu import model as plant
from plant_fmu.reduced import reduced_form
from trajectory_fmu import model as trajectory


def lyapunov_start_constants(S: np.ndarray) -> tuple[float, float]:
    """s_a (J) and s_b (rad^2/s) of V0 = s_a + s_b beta for the start values of robot and trajectory.

    Parameters
    ----------
    S : array (3,)
        Diagonal of S (1/s).
    """
    p = plant.PARAMETERS.starts
    P = plant.PARAMETERS.unpack(p)
    x = plant.initial_state(p)
    no_input = np.zeros(len(plant.INPUTS))
    F_c = plant.OUTPUTS.unpack(plant.output_values(0.0, x, no_input, p)).F_c
    M = reduced_form(x[:6], x[6:], F_c, P.X, P.Y, P.Z, P.l).M
    reference = trajectory.OUTPUTS.unpack(
        trajectory.output_values(0.0, np.zeros(0), np.zeros(0), trajectory.PARAMETERS.starts)
    )
    return lyapunov_constants(M, x[:3] - reference.theta_ref, x[6:9] - reference.omega_ref, S)
