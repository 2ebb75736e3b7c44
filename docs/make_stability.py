"""Draw the figure of docs/stability.md: the largest stable step over a gain, and from where on runs diverge.

python build_fmus.py && python docs/make_stability.py fmus docs/stability.png
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cosim import Simulation, SimulationError
from parallel_robot import largest_stable_step, load_scenario

#: Gains beta (N m s/rad) of the curves, and those at which runs are made.
GAINS = np.geomspace(0.8, 4.0, 9)
RUNS = GAINS[::2]

#: Order, extrapolation, and the colour and label of the curve.
ALGORITHMS = (
    ("sequential", "hold", "#0072B2", "Gauss-Seidel, zero-order hold"),
    ("sequential", "linear", "#D55E00", "Gauss-Seidel, linear (the default falls back to it)"),
    ("parallel", "hold", "#009E73", "Jacobi, zero-order hold"),
    ("parallel", "linear", "#CC79A7", "Jacobi, linear"),
)


def diverges(simulation: Simulation, step: float, beta: float) -> bool:
    """Whether the end effector is ever further than 0.1 m from the desired path."""
    try:
        results = simulation.run(step * round(15.0 / step), step, start={"controller.beta": beta})
    except SimulationError:
        return True
    error = np.hypot(
        results["plant.x_E"] - results["trajectory.x_ref"], results["plant.y_E"] - results["trajectory.y_ref"]
    )
    return bool(error.max() > 0.1)


def shortest_diverging_step(simulation: Simulation, beta: float, stable: float) -> float:
    """Step (s) from which on runs diverge, to half a percent, by bisection from a stable one."""
    lower, upper = 0.9 * stable, 1.5 * stable
    while upper / lower > 1.005:
        middle = math.sqrt(lower * upper)
        lower, upper = (lower, middle) if diverges(simulation, middle, beta) else (middle, upper)
    return upper


def main(fmus: Path, picture: Path) -> None:
    """Draw one curve for each algorithm."""
    figure = Figure(figsize=(7, 4.4), layout="constrained", dpi=110)
    axes = figure.subplots()
    system = load_scenario("tracking-undisturbed").system(fmus, "fmi2")
    for order, extrapolation, colour, label in ALGORITHMS:
        steps = [
            largest_stable_step({"controller": {"beta": beta}}, order=order, extrapolation=extrapolation)
            for beta in GAINS
        ]
        axes.loglog(GAINS, 1e3 * np.array(steps), color=colour, label=label)
        with Simulation(system, order=order, extrapolation=extrapolation) as simulation:
            found = [
                shortest_diverging_step(simulation, beta, step)
                for beta, step in zip(GAINS, steps, strict=True)
                if beta in RUNS
            ]
        axes.loglog(RUNS, 1e3 * np.array(found), "x", color=colour)
    axes.plot([], [], "x", color="black", label="runs diverge from here on")
    axes.set(xlabel=r"gain $\beta$ (N m s/rad)", ylabel="communication step (ms)")
    axes.set_xticks([0.8, 1.0, 2.0, 4.0], ["0.8", "1", "2", "4"])
    axes.set_yticks([5, 10, 20, 50, 100], ["5", "10", "20", "50", "100"])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(picture)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
