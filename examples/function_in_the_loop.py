"""A digital controller in plain Python, called every 2 ms in the loop with the robot's FMUs. Build the FMUs first."""

import numpy as np

from cosim import System, simulate


class PID:
    """tau_a = -K_p e - K_i (integral of e) - K_d e', where e is the error of the angles."""

    def __init__(self, period, K_p=6.0, K_i=12.0, K_d=2.0):
        self.period, self.K_p, self.K_i, self.K_d = period, K_p, K_i, K_d
        self.reset()

    def reset(self):
        """Every run begins here."""
        self.integral = np.zeros(3)

    def __call__(self, time, theta_a, omega_a, theta_ref, omega_ref):
        """Torques in N.m."""
        error = theta_a - theta_ref
        self.integral = self.integral + self.period * error
        return -self.K_p * error - self.K_i * self.integral - self.K_d * (omega_a - omega_ref)


STEP, EVERY = 0.001, 2
system = System()
system.add("plant", "fmus/fmi2/RobotPlant.fmu", start={"tau_d": [0, 0, 0], "dm": 0})
system.add("trajectory", "fmus/fmi2/RobotTrajectory.fmu")
system.add_function(
    "controller",
    PID(EVERY * STEP),
    inputs={
        "theta_a[1..3]": "rad",
        "omega_a[1..3]": "rad/s",
        "theta_ref[1..3]": "rad",
        "omega_ref[1..3]": "rad/s",
    },
    outputs={"tau_a[1..3]": "N.m"},
    every=EVERY,
)
for name in ("theta_a", "omega_a"):
    system.connect(f"plant.{name}", f"controller.{name}")
for name in ("theta_ref", "omega_ref"):
    system.connect(f"trajectory.{name}", f"controller.{name}")
system.connect("controller.tau_a", "plant.tau_a")

results = simulate(system, stop_time=4.0, step_size=STEP)
error = np.hypot(results["plant.x_E"] - results["trajectory.x_ref"], results["plant.y_E"] - results["trajectory.y_ref"])
print(f"position error after 2 s: at most {1e3 * error[results.time > 2].max():.2f} mm")
results.to_csv("results.csv")
