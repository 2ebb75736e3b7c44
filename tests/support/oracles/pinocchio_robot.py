"""The robot in Pinocchio: a tree of joints and bodies whose loops are closed by its constraint dynamics."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tests.support.oracles.links import Links, to_absolute_forces, to_angles, to_joint_torques, to_joints


def _body(mass: float, r: float, J: float) -> pin.Inertia:
    """A link along x; of its moments of inertia only that about z acts in a plane."""
    return pin.Inertia(mass, np.array([r, 0.0, 0.0]), J * np.eye(3))


def _at(x: float, y: float = 0.0) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, 0.0]))


class PinocchioRobot:
    """Three chains of two revolute joints about z, their ends held together pairwise, without gravity.

    Without stabilisation of the closure: at closed states it would add nothing.
    """

    def __init__(self, links: Links) -> None:
        self._links = links
        self._model = pin.Model()
        self._model.gravity = pin.Motion.Zero()
        self._tip = _at(links.l)
        self._passive = []
        for i in range(3):
            active = self._model.addJoint(0, pin.JointModelRZ(), _at(links.x_A[i], links.y_A[i]), f"active {i + 1}")
            passive = self._model.addJoint(active, pin.JointModelRZ(), _at(links.l), f"passive {i + 1}")
            self._model.appendBodyToJoint(active, _body(links.m_a, links.r_a, links.J_a), pin.SE3.Identity())
            self._model.appendBodyToJoint(passive, _body(links.m_b, links.r_b, links.J_b), pin.SE3.Identity())
            self._passive.append(passive)
        self._closures = pin.StdVec_RigidConstraintModel()
        self._closure_data = pin.StdVec_RigidConstraintData()
        for other in self._passive[1:]:
            closure = pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D,
                self._model,
                self._passive[0],
                self._tip,
                other,
                self._tip,
                pin.ReferenceFrame.LOCAL,
            )
            self._closures.append(closure)
            self._closure_data.append(closure.createData())
        self._data = self._model.createData()
        pin.initConstraintDynamics(self._model, self._data, self._closures, self._closure_data)
        # a closure's third row, out of the plane, is void: proximal iterations bear that, a plain solution would not
        self._proximal = pin.ProximalSettings(1e-14, 1e-6, 20)

    def grow(self, dm: float) -> None:
        """Make both links of every chain heavier by dm (kg) than the given ones, at their mass centres."""
        for passive in self._passive:
            self._model.inertias[passive - 1].mass = self._links.m_a + dm
            self._model.inertias[passive].mass = self._links.m_b + dm

    def joint_accelerations(self, q: np.ndarray, v: np.ndarray, tau_a: np.ndarray) -> np.ndarray:
        """Accelerations (6,) of the joints at joint coordinates and rates (6,), see `to_joints`."""
        tau = to_joint_torques(tau_a)
        return pin.constraintDynamics(
            self._model, self._data, q, v, tau, self._closures, self._closure_data, self._proximal
        )

    def closed_chain(self, theta: np.ndarray, omega: np.ndarray, tau_a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accelerations theta'' (6,) in rad/s^2 and closure force F_c (6,) in N m, in the paper's absolute angles.

        The closure force is what the open chains need, by the recursive Newton-Euler algorithm, beyond the torques.
        """
        q, v = to_joints(theta), to_joints(omega)
        accelerations = self.joint_accelerations(q, v, tau_a).copy()
        needed = pin.rnea(self._model, self._data, q, v, accelerations)
        return to_angles(accelerations), to_absolute_forces(needed - to_joint_torques(tau_a))

    def mass_matrix(self, theta: np.ndarray) -> np.ndarray:
        """Mass matrix (6, 6) of the open chains in absolute angles, by the composite rigid body algorithm."""
        upper = np.triu(pin.crba(self._model, self._data, to_joints(theta)))
        M = upper + np.triu(upper, 1).T
        T = np.column_stack([to_joints(e) for e in np.eye(6)])
        return T.T @ M @ T

    def chain_ends(self, q: np.ndarray) -> np.ndarray:
        """Positions (3, 2) in m of the three passive ends at joint coordinates (6,)."""
        pin.forwardKinematics(self._model, self._data, q)
        return np.array([self._data.oMi[j].act(self._tip).translation[:2] for j in self._passive])

    def end_velocities(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Velocities (3, 2) in m/s of the three passive ends."""
        pin.forwardKinematics(self._model, self._data, q, v)
        at_tips = (self._tip.actInv(self._data.v[j]).linear for j in self._passive)
        return np.array([(self._data.oMi[j].rotation @ u)[:2] for j, u in zip(self._passive, at_tips, strict=True)])
