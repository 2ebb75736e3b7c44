"""The robot in MuJoCo: an MJCF model whose loops are closed by soft constraints, as stiff as one asks for."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from tests.support.oracles.links import Links, to_angles, to_joint_torques, to_joints

_CHAIN = """
<body pos="{x_A} {y_A} 0">
  <joint axis="0 0 1"/>
  <inertial pos="{r_a} 0 0" mass="{m_a}" diaginertia="{J_a} {J_a} {J_a}"/>
  <body pos="{l} 0 0">
    <joint axis="0 0 1"/>
    <inertial pos="{r_b} 0 0" mass="{m_b}" diaginertia="{J_b} {J_b} {J_b}"/>
    <site name="end {number}" pos="{l} 0 0"/>
  </body>
</body>"""

_ROBOT = """
<mujoco model="planar 2-DOF redundantly actuated parallel robot">
  <compiler angle="radian"/>
  <option gravity="0 0 0" integrator="RK4" solver="Newton" tolerance="0"/>
  <worldbody>{chains}</worldbody>
  <equality>
    <connect site1="end 1" site2="end 2"/>
    <connect site1="end 1" site2="end 3"/>
  </equality>
</mujoco>"""


def mjcf(links: Links) -> str:
    """The robot in MuJoCo's own language; of a link's moments of inertia only that about z acts in a plane."""
    numbers = {name: repr(float(value)) for name, value in vars(links).items() if np.ndim(value) == 0}
    chains = (
        _CHAIN.format(**numbers, x_A=float(x), y_A=float(y), number=i + 1)
        for i, (x, y) in enumerate(zip(links.x_A, links.y_A, strict=True))
    )
    return _ROBOT.format(chains="".join(chains))


class MujocoRobot:
    """Three chains of two hinges about z, their ends connected pairwise, without gravity.

    A closure error r has the acceleration r'' = (1 - d) a - d (b r' + k r), where a is what r'' would be without the
    connection (MuJoCo's documentation, chapter Computation, section Constraint model). It is rigid for d = 1, which
    MuJoCo does not allow: d <= 0.9999.

    Parameters
    ----------
    links : Links
    impedance : float
        d.
    time_constant : float
        Of the critically damped decay of r (s).
    """

    def __init__(self, links: Links, impedance: float, time_constant: float = 0.02) -> None:
        self._model = mujoco.MjModel.from_xml_string(mjcf(links))
        self._model.eq_solimp[:, :2] = impedance  # the same at any closure error
        self._model.eq_solref[:] = [time_constant, 1.0]
        self._data = mujoco.MjData(self._model)

    def accelerations(self, theta: np.ndarray, omega: np.ndarray, tau_a: np.ndarray) -> np.ndarray:
        """Accelerations theta'' (6,) in rad/s^2 in the paper's absolute angles."""
        self._data.qpos[:], self._data.qvel[:] = to_joints(theta), to_joints(omega)
        self._data.qfrc_applied[:] = to_joint_torques(tau_a)
        mujoco.mj_forward(self._model, self._data)
        return to_angles(self._data.qacc)

    def path(
        self,
        theta: np.ndarray,
        torque: Callable[[float, np.ndarray, np.ndarray], np.ndarray],
        duration: float,
        step: float,
    ) -> np.ndarray:
        """End effector (n, 2) in m after each step (s) from rest at theta (6,), by MuJoCo's own RK4.

        The torque (3,) in N m is torque(t, theta, omega), evaluated at every stage.
        """
        model, data = self._model, self._data
        model.opt.timestep = step
        mujoco.mj_resetData(model, data)
        data.qpos[:] = to_joints(theta)

        def control(_: mujoco.MjModel, data: mujoco.MjData) -> None:
            tau_a = torque(data.time, to_angles(data.qpos), to_angles(data.qvel))
            data.qfrc_applied[:] = to_joint_torques(tau_a)

        positions = np.empty((round(duration / step), 2))
        mujoco.set_mjcb_control(control)
        try:
            for row in positions:
                mujoco.mj_step(model, data)
                mujoco.mj_kinematics(model, data)
                row[:] = data.site_xpos[:, :2].mean(axis=0)
        finally:
            mujoco.set_mjcb_control(None)
        return positions
