"""The robot in python-control: linearised at rest, under PD control, its poles and its answer to a torque step."""

import control
import numpy as np

from fmu_export import to_control
from parallel_robot import MODELS

model = MODELS["plant"]
robot = to_control(model, name="robot")  # a control.NonlinearIOSystem
x = model.initial_state(model.parameters.starts)  # at rest: an equilibrium without torques
linear = robot.linearize(x, np.zeros(robot.ninputs), copy_names=True)
print(f"{linear.nstates} states: {', '.join(linear.state_labels)}")

torques = ["tau_a[1]", "tau_a[2]", "tau_a[3]"]
measured = ["theta_a[1]", "theta_a[2]", "theta_a[3]", "omega_a[1]", "omega_a[2]", "omega_a[3]"]
K_p, K_d = 6.0, 2.0  # N.m/rad, N.m.s/rad
gain = np.hstack([K_p * np.eye(3), K_d * np.eye(3), np.zeros((3, 1))])
closed = control.feedback(linear[[*measured, "x_E"], torques], gain)

# 12 states, but two degrees of freedom: the eight poles at -10 are errors of the closed chains, which the plant's
# stabilisation (its parameter baumgarte) lets decay
print("poles (1/s):", *(f"{pole:.1f}" for pole in sorted(closed.poles(), key=abs)))

response = closed[6, 0]  # of x_E to tau_a[1]
time, x_E = control.step_response(0.1 * response, np.linspace(0.0, 3.0, 301))
print(f"0.1 N.m more on joint 1 moves the end effector by {1e3 * x_E[-1]:.3f} mm in x")
print(f"in the end, by the transfer function: {1e2 * response.dcgain():.3f} mm")
