"""Draw the figures of docs/coupling.md: one step of each extrapolation, and error over step and over cost.

python build_fmus.py && python -m benchmarks --only coupling --out DIR && python docs/make_coupling.py DIR docs
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.master.coupling.algorithm import EXTRAPOLATIONS

#: The extrapolations that are drawn; those by least squares beside those that go through all values.
DRAWN = (
    ("hold",),
    ("linear",),
    ("quadratic", "quadratic-least-squares"),
    ("cubic", "cubic-least-squares"),
    ("tangent",),
    ("hermite", "hermite-least-squares"),
)
COLOURS = ("#D55E00", "#0072B2")

#: Of the curves over the step: name, colour, marker.
CURVES = (
    ("hold", "#999999", "o"),
    ("linear", "#D55E00", "s"),
    ("quadratic-least-squares", "#CC79A7", "^"),
    ("hermite", "#009E73", "v"),
    ("adaptive", "#0072B2", "D"),
)


def one_step(picture: Path) -> None:
    """Each extrapolation over one step, with what it goes by."""
    figure = Figure(figsize=(9.0, 5.2), dpi=150, layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, names in zip(panels.flat, DRAWN, strict=True):
        draw(axes, names)
    for axes in panels[1]:
        axes.set_xlabel("time (steps)")
    for axes in panels[:, 0]:
        axes.set_ylabel("input")
    figure.savefig(picture)


def value(t: np.ndarray) -> np.ndarray:
    """The input that a component would have without a communication step."""
    return np.asarray(np.sin(0.8 * t + 0.4) + 0.12 * t)


def rate(t: np.ndarray) -> np.ndarray:
    """Its derivative."""
    return np.asarray(0.8 * np.cos(0.8 * t + 0.4) + 0.12)


def draw(axes: Axes, names: tuple[str, ...]) -> None:
    """One panel."""
    time, step = np.linspace(-4.2, 1.0, 200), np.linspace(0.0, 1.0, 30)
    axes.axvspan(0.0, 1.0, color="#F0E442", alpha=0.25, lw=0)
    axes.plot(time, value(time), color="black", lw=0.8, ls=":", label="without a step")
    points = max(EXTRAPOLATIONS[name].points for name in names)
    for name, colour in zip(names, COLOURS, strict=False):
        extrapolation, known = EXTRAPOLATIONS[name], -np.arange(EXTRAPOLATIONS[name].points, dtype=float)
        u = np.full_like(step, value(np.zeros(1))[0])
        rows = extrapolation.rate_weights or [np.zeros(len(known))] * extrapolation.degree
        for d, (weights, more) in enumerate(zip(extrapolation.weights, rows, strict=True), start=1):
            u = u + (weights @ value(known) + more @ rate(known)) * step**d / math.factorial(d)
        axes.plot(step, u, color=colour, lw=2.0, label=name)
    past = -np.arange(points, dtype=float)
    axes.plot(past, value(past), "o", color="black", ms=4)
    if EXTRAPOLATIONS[names[0]].uses_rates:
        for t in past:
            side = np.array([-0.25, 0.25])
            axes.plot(t + side, value(np.array([t])) + side * rate(np.array([t])), color="black", lw=1.4)
    axes.legend(fontsize=7, loc="upper left", frameon=False)
    axes.grid(alpha=0.3)


def errors(results: Path, picture: Path) -> None:
    """Error over step, and over the time of a run."""
    sections = json.loads((results / "benchmarks.json").read_text(encoding="utf-8"))["sections"]
    data = sections["Coupling schemes: the robot"]["data"]
    steps = 1e3 * np.array(data["steps"])
    figure = Figure(figsize=(9.0, 3.8), dpi=150, layout="constrained")
    over_step, over_cost = figure.subplots(1, 2, sharey=True)
    for name, colour, marker in CURVES:
        found = np.array(data["errors"][f"sequential, {name}"], dtype=float)
        cost = data["cost"][f"sequential, {name}"] * 15.0 / (1e-3 * steps) * 1e-3
        good = np.isfinite(found)
        over_step.loglog(steps[good], found[good], marker=marker, color=colour, ms=4, label=name)
        over_cost.loglog(cost[good], found[good], marker=marker, color=colour, ms=4, label=name)
    over_step.set(xlabel="communication step (ms)", ylabel="largest error of the end effector (m)")
    over_cost.set(xlabel="time of 15 s, at the time of a step of 1 ms (ms)")
    for axes in (over_step, over_cost):
        axes.grid(alpha=0.3)
    over_step.legend(fontsize=7)
    figure.savefig(picture)


def main(results: Path, folder: Path) -> None:
    """Draw both."""
    one_step(folder / "coupling.png")
    if (results / "benchmarks.json").exists():
        errors(results, folder / "coupling_errors.png")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
