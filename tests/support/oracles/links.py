"""The links as bodies: what an engine of multibody dynamics wants, from what the paper's (13) and (87) give."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from plant_fmu.model import PARAMETERS


@dataclass(frozen=True)
class Links:
    """The two links of each chain, and the bases.

    X, Y and Z of (13) hold six numbers of two links. m_a, m_b and l are the paper's, r_a is a parameter of the plant;
    the rest follows: r_b = Z/(m_b l), J_b = Y - m_b r_b^2, J_a = X - m_b l^2 - m_a r_a^2.

    Attributes
    ----------
    l : float
        Length of every link (m).
    m_a, r_a, J_a : float
        Active link: mass (kg), mass centre from its joint (m), moment of inertia about the mass centre (kg m^2).
    m_b, r_b, J_b : float
        The same of the passive link.
    x_A, y_A : array (3,)
        Bases (m).
    """

    l: float
    m_a: float
    r_a: float
    J_a: float
    m_b: float
    r_b: float
    J_b: float
    x_A: np.ndarray
    y_A: np.ndarray

    @classmethod
    def of_plant(cls) -> Links:
        """The links that the start values of the plant's parameters describe."""
        P = PARAMETERS.unpack(PARAMETERS.starts)
        r_b = P.Z / (P.m_b * P.l)
        J_a, J_b = P.X - P.m_b * P.l**2 - P.m_a * P.r_a**2, P.Y - P.m_b * r_b**2
        return cls(P.l, P.m_a, P.r_a, J_a, P.m_b, r_b, J_b, P.x_A, P.y_A)

    def grown(self, dm: float) -> Links:
        """Both links heavier by dm (kg) at their mass centres, as in the paper's section 6."""
        return dataclasses.replace(self, m_a=self.m_a + dm, m_b=self.m_b + dm)


def to_joints(theta: np.ndarray) -> np.ndarray:
    """Joint coordinates (6,), chain by chain, of absolute angles [theta_a; theta_b] (6,) or of their rates.

    Engines measure the passive joint from the active link: theta_b - theta_a.
    """
    return np.column_stack([theta[:3], theta[3:] - theta[:3]]).ravel()


def to_angles(joints: np.ndarray) -> np.ndarray:
    """Inverse of `to_joints`."""
    chains = joints.reshape(3, 2)
    return np.concatenate([chains[:, 0], chains.sum(axis=1)])


def to_joint_torques(tau_a: np.ndarray) -> np.ndarray:
    """Torques (6,) on the joints, chain by chain: the motors stand on the ground, the passive joints are free."""
    return np.column_stack([tau_a, np.zeros(3)]).ravel()


def to_absolute_forces(joint_forces: np.ndarray) -> np.ndarray:
    """Generalised forces (6,) that do on [theta_a; theta_b] the work that `joint_forces` (6,) do on the joints."""
    on_a, on_b = joint_forces.reshape(3, 2).T
    return np.concatenate([on_a - on_b, on_b])
