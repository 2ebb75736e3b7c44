"""Workspace and force transmission of the robot with two and with three motors; section 2.2 of the paper.

The passive links carry what the motors do to the end effector. A motor of its chain alone moves it along the direction
[cos theta_b, sin theta_b] of that link, (23). With these directions as rows, the smallest singular value tells how well
the worst force of size 1 N is balanced: 0 where a force exists that no motor can withstand, a parallel singularity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from plant_fmu.kinematics import inverse_kinematics, reach_margin
from plant_fmu.model import PARAMETERS

#: The motors that can be driven: all, and each pair, which leaves a five-bar linkage.
DRIVEN: tuple[tuple[int, ...], ...] = ((1, 2, 3), *combinations((1, 2, 3), 2))


@dataclass(frozen=True)
class TransmissionMap:
    """Force transmission over a grid of positions of the end effector.

    Attributes
    ----------
    x, y : array (n,)
        Of the grid (m).
    values : mapping
        Driven motors -> array (n, n) over y and x: the smallest singular value, NaN out of reach.
    """

    x: np.ndarray
    y: np.ndarray
    values: dict[tuple[int, ...], np.ndarray]


def transmission(theta_b: np.ndarray, driven: Sequence[int]) -> float:
    """Smallest singular value of the directions of the passive links of driven chains, between 0 and sqrt(3/2).

    Parameters
    ----------
    theta_b : array (3,)
        Angles of the passive links (rad).
    driven : sequence of int
        Numbers of the chains whose motors are driven, 1 to 3.
    """
    b = theta_b[[i - 1 for i in driven]]
    return float(np.linalg.svd(np.stack([np.cos(b), np.sin(b)], axis=1), compute_uv=False)[-1])


def transmission_map(points: int = 101) -> TransmissionMap:
    """The robot's map over its workspace, with so many points in x and in y."""
    P = PARAMETERS.unpack(PARAMETERS.starts)
    low, high = (np.array([f(P.x_A), f(P.y_A)]) for f in (max, min))
    x, y = (np.linspace(a - 2.0 * P.l, b + 2.0 * P.l, points) for a, b in zip(low, high, strict=True))
    values = {driven: np.full((points, points), np.nan) for driven in DRIVEN}
    for i, y_E in enumerate(y):
        for j, x_E in enumerate(x):
            if (reach_margin(x_E, y_E, P.l, P.x_A, P.y_A) > 1e-9).all():
                theta_b = inverse_kinematics(x_E, y_E, P.l, P.x_A, P.y_A)[3:]
                for driven in DRIVEN:
                    values[driven][i, j] = transmission(theta_b, driven)
    return TransmissionMap(x, y, values)
