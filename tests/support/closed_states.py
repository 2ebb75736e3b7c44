"""Random states of the robot whose chains are closed."""

import numpy as np

from plant_fmu.kinematics import inverse_kinematics, velocity_jacobians
from plant_fmu.model import PARAMETERS

P = PARAMETERS.unpack(PARAMETERS.starts)
GEOMETRY = (P.l, P.x_A, P.y_A)


def closed_states(n: int = 100) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Random closed states with random torques: theta (6,), omega (6,), tau_a (3,)."""
    random = np.random.default_rng(20)
    states = []
    for _ in range(n):
        theta = inverse_kinematics(random.uniform(0.18, 0.27), random.uniform(0.27, 0.38), *GEOMETRY)
        omega = np.concatenate(velocity_jacobians(theta, P.l)) @ random.uniform(-1, 1, 2)
        states.append((theta, omega, random.uniform(-1, 1, 3)))
    return states
