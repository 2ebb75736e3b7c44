"""Couple robot, controller and desired path, and see how well the robot follows. Build the FMUs first."""

import numpy as np

from cosim import System, simulate

system = System()
system.add("plant", "fmus/fmi2/RobotPlant.fmu", start={"tau_d": [0, 0, 0]})
system.add("controller", "fmus/fmi2/RobotController.fmu", start={"alpha": 2.0})
system.add("trajectory", "fmus/fmi2/RobotTrajectory.fmu")
for name in ("theta_a", "omega_a"):
    system.connect(f"plant.{name}", f"controller.{name}")
for name in ("theta_ref", "omega_ref", "tau_ref"):
    system.connect(f"trajectory.{name}", f"controller.{name}")
system.connect("controller.tau_a", "plant.tau_a")
system.drive("plant.dm", lambda t: 0.25 * np.sin(np.pi * t))

results = simulate(system, stop_time=5.0, step_size=0.001)
error = np.hypot(results["plant.x_E"] - results["trajectory.x_ref"], results["plant.y_E"] - results["trajectory.y_ref"])
print(f"position error after 2 s: at most {1e3 * error[results.time > 2].max():.1f} mm")
results.to_csv("results.csv")
