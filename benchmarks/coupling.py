"""Order and accuracy of the coupling schemes, with mass change and disturbance."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from benchmarks.measure import Section
from benchmarks.system import STOP_TIME, disturbed
from cosim import Simulation, SimulationError
from cosim.master.algorithm import ORDERS
from parallel_robot.stability import largest_stable_step
from tests.support.continuous_loop import end_effector, solve

STEPS = (20e-3, 10e-3, 4e-3, 2e-3, 1e-3, 0.5e-3)
EVERY = 0.02  # s


def measure_coupling(folder: Path) -> Section:
    """Largest distance of the end effector from the continuous loop."""
    scenario = disturbed()
    parts = [scenario.signals[n].function(size, scenario.seed, n) for n, size in (("plant.tau_d", 3), ("plant.dm", 1))]
    times = np.arange(round(STOP_TIME / EVERY) + 1) * EVERY
    path = end_effector(solve(times, lambda t: np.concatenate([f(t) for f in parts]), [4.0], rtol=1e-11))
    errors: dict[str, list[float]] = {}
    for order in ORDERS:
        for coupling in ("hold", "linear"):
            with Simulation(scenario.system(folder, "fmi2"), order=order, extrapolation=coupling) as simulation:
                found = errors[f"{order}, {coupling}"] = []
                for step in STEPS:
                    try:
                        r = simulation.run(STOP_TIME, step)
                    except SimulationError:  # diverged
                        found.append(math.inf)
                        continue
                    ours = np.column_stack([r["plant.x_E"], r["plant.y_E"]])[:: round(EVERY / step)]
                    found.append(float(np.hypot(*(ours - path).T).max()))
    orders = {n: float(np.polyfit(np.log(STEPS[2:]), np.log(e[2:]), 1)[0]) for n, e in errors.items()}
    stable = {n: largest_stable_step(order=o, extrapolation=e) for n in errors for o, e in [n.split(", ")]}
    second = orders["sequential, linear"]
    return Section(
        "Coupling schemes",
        "Largest distance (m) of the end effector from the continuous loop (DOP853, 1e-11) over 15 s, mass change and "
        "disturbance on; order fitted from 4 to 0.5 ms; largest stable step by the linear analysis.",
        ("scheme", *(f"{1e3 * s:g} ms" for s in STEPS), "order", "stable up to"),
        [
            (
                n,
                *("unstable" if math.isinf(e) else f"{e:.1e}" for e in values),
                f"{orders[n]:.2f}",
                f"{1e3 * stable[n]:.1f} ms",
            )
            for n, values in errors.items()
        ],
        {"steps": STEPS, "errors": errors, "orders": orders, "largest_stable_steps": stable},
        [(f"order of the sequential linear coupling: {second:.3f}, 2", abs(second - 2.0) < 0.05)],
    )
