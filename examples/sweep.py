"""How the steady error depends on the controller's gain and on the mass change: a simulation is set up once, run often.

More runs, on all cores or on a cluster: `cosim sweep`. Build the FMUs first.
"""

from pathlib import Path

import numpy as np

from cosim import Signal, Simulation
from parallel_robot import load_scenario

system = load_scenario("tracking").system(Path("fmus"), "fmi2")
recorded = ["plant.x_E", "plant.y_E", "trajectory.x_ref", "trajectory.y_ref"]

with Simulation(system, record=recorded) as simulation:
    for dm in (0.0, 0.25):  # kg
        mass_change = Signal("plant.dm", lambda t, dm=dm: dm * np.sin(np.pi * t), vectorized=True)
        for alpha in (0.0, 1.0, 2.0, 4.0):
            r = simulation.run(10.0, 1e-3, start={"controller.alpha": alpha}, signals=[mass_change])
            error = np.hypot(r["plant.x_E"] - r["trajectory.x_ref"], r["plant.y_E"] - r["trajectory.y_ref"])
            steady = error[r.time > 8.0].max()
            print(f"mass change {dm:4.2f} kg, alpha = {alpha:g}: steady error {1e3 * steady:.2f} mm")
