"""Draw the README's picture: the robot on its path, and how the FMUs are coupled.

cosim run tracking && python docs/make_picture.py results/tracking/results.csv docs/robot.png
"""

from __future__ import annotations

import sys

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from cosim import Results
from plant_fmu.model import PARAMETERS

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#555555"
P = PARAMETERS.unpack(PARAMETERS.starts)


def draw_robot(axes: Axes, results: Results, time: float) -> None:
    """The three chains at one time (s), with the desired and the actual path of the end effector."""
    axes.plot(
        results["trajectory.x_ref"], results["trajectory.y_ref"], "--", color=ORANGE, lw=1.4, label="desired path"
    )
    axes.plot(results["plant.x_E"], results["plant.y_E"], color=BLUE, lw=1.2, label="actual path")
    row = int(np.argmin(np.abs(results.time - time)))
    a = results["plant.theta_a"][row]
    x_E, y_E = results["plant.x_E"][row], results["plant.y_E"][row]
    for i in range(3):
        elbow = P.x_A[i] + P.l * np.cos(a[i]), P.y_A[i] + P.l * np.sin(a[i])
        axes.plot([P.x_A[i], elbow[0]], [P.y_A[i], elbow[1]], color=GREY, lw=5, solid_capstyle="round")
        axes.plot([elbow[0], x_E], [elbow[1], y_E], color=GREY, lw=2.5, solid_capstyle="round", alpha=0.7)
        axes.plot(*elbow, "o", color="white", mec=GREY, ms=7)
        axes.plot(P.x_A[i], P.y_A[i], "s", color="black", ms=11)
        axes.annotate(
            rf"$A_{i + 1}$, $\tau_{{a,{i + 1}}}$",
            (P.x_A[i], P.y_A[i]),
            (10, -14),
            textcoords="offset points",
            fontsize=9,
        )
    axes.plot(x_E, y_E, "o", color=GREEN, ms=10, label="end effector")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", xlim=(-0.06, 0.56), ylim=(-0.07, 0.56))
    axes.legend(loc="lower left", fontsize=8)


def draw_coupling(axes: Axes) -> None:
    """FMUs as boxes, connections as arrows."""
    axes.set_axis_off()
    axes.set(xlim=(0, 10), ylim=(0, 10))
    for x, y, text, colour in (
        (0.4, 6.6, "RobotTrajectory.fmu\ndesired path (93)", ORANGE),
        (5.6, 6.6, "RobotController.fmu\nadaptive robust control (38)", BLUE),
        (5.6, 1.6, "RobotPlant.fmu\nUdwadia-Kalaba (20)", GREEN),
        (0.4, 1.6, "cosim tune\noptimal gains (82)", GREY),
    ):
        axes.add_patch(FancyBboxPatch((x, y), 4.0, 1.8, boxstyle="round,pad=0.1", fc="white", ec=colour, lw=2))
        axes.text(x + 2.0, y + 0.9, text, ha="center", va="center", fontsize=9)
    for start, end, text, at in (
        ((4.5, 7.5), (5.5, 7.5), "$\\theta_{a,d}$, $\\dot\\theta_{a,d}$", (4.25, 8.75)),
        ((8.6, 6.5), (8.6, 3.5), "$\\tau_a$", (8.8, 5.0)),
        ((6.6, 3.5), (6.6, 6.5), "$\\theta_a$, $\\dot\\theta_a$", (6.8, 5.0)),
        ((4.0, 3.5), (5.7, 6.5), "$\\alpha$, $\\beta$", (3.7, 5.0)),
        ((7.6, 0.2), (7.6, 1.5), "$\\Delta m$, $\\tau_d$", (7.8, 0.4)),
    ):
        axes.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=16, color="black", lw=1.3))
        axes.text(*at, text, fontsize=10, va="center")


def main(result: str, picture: str) -> None:
    """Draw both parts side by side."""
    figure = Figure(figsize=(11, 5), layout="constrained", dpi=110)
    left, right = figure.subplots(1, 2)
    draw_robot(left, Results.from_csv(result), time=5.0)
    draw_coupling(right)
    figure.savefig(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
