"""The figure of the gains: Pareto fronts, and how far from them each choice of gains is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from parallel_robot.paper.reproduce import style
from parallel_robot.paper.robustness.content import Front, Placed, StudyFigure
from parallel_robot.paper.robustness.draw import Draw
from parallel_robot.paper.robustness.findings import CONDITION_WORDS
from parallel_robot.paper.robustness.gains import gain_of_others, in_condition
from parallel_robot.paper.robustness.rows import Rows

#: Gains with which one could be lowered by more than this (%), without raising the other, are all of one colour.
_FAR = 50.0

#: Places that ticks of logarithmic axes may have, by the largest ratio of their ends for which they can be read.
_TICKS = {
    4.0: (0.08, 0.09, 0.1, 0.11, 0.12, 0.13, 0.14, 0.15, 0.16, 0.18, 0.2, 0.25, 0.3),
    500.0: (0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0),
    np.inf: (0.1, 1.0, 10.0, 100.0),
}


def pareto(rows: Rows, fronts: Sequence[Front]) -> tuple[Draw, StudyFigure]:
    """Steady error against control effort of all gains with the front; and the distance of all gains from it."""

    def draw(figure: Figure) -> None:
        grid = figure.subplots(2, 2, width_ratios=(1.15, 1.0))
        for (costs, gains), front in zip(grid, fronts, strict=True):
            _, others = in_condition(rows, front.condition)
            _draw_costs(costs, front, rows.effort[others], rows.error[others])
            coloured = _draw_gains(gains, front, rows, others)
            figure.colorbar(coloured, ax=gains, label="Error or effort too large by (%)", extend="max")
        handles, labels = grid[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=4, columnspacing=1.2)

    places = "; ".join(
        f"{CONDITION_WORDS[f.condition]}, the optimum of (mu, nu) = (1, 1) is "
        f"{next(p.place for p in f.placed if p.controller == '1')}; "
        f"{f.near} of {f.gains} gains are on it or near it"
        for f in fronts
    )
    return draw, StudyFigure(
        "pareto",
        "Steady error against control effort over the gains",
        f"{len(rows.error)} runs over alpha and beta. Left: all gains, the Pareto front, on which no gains lower one "
        "without raising the other, and the paper's controllers. Right: by how much other gains lower one without "
        f"raising the other. {places[0].upper()}{places[1:]}.",
        "Four panels. Left, dots with a falling front along their lower left edge, and markers of the paper's six "
        f"controllers on it or beside it; right, a map of the gains with the optima. {places[0].upper()}{places[1:]}.",
    )


def _draw_costs(axes: Axes, front: Front, effort: np.ndarray, error: np.ndarray) -> None:
    axes.plot(effort, error, ".", color="#B0B0B0", markersize=3, label="other gains")
    efforts, errors = ([getattr(p, what) for p in front.points] for what in ("effort", "error"))
    axes.plot(efforts, errors, ".-", color=style.BLACK, linewidth=1.0, markersize=3, label="Pareto front")
    _mark(axes, front.placed, "effort", "error")
    _logarithmic(axes)
    axes.set(xlabel=r"Control effort, rms of $|\tau_a|$ (N m)", ylabel="Steady error (mm)")
    axes.set_title(CONDITION_WORDS[front.condition])


def _draw_gains(axes: Axes, front: Front, rows: Rows, others: np.ndarray) -> Any:
    costs = np.stack([rows.error[others], rows.effort[others]], axis=1)
    valid = np.isfinite(costs).all(axis=1)
    percent = np.full(len(costs), np.nan)
    percent[valid] = 100.0 * (1.0 - 1.0 / gain_of_others(costs[valid], costs[valid]).max(axis=1))
    alpha, beta = (np.unique(gain[others]) for gain in (rows.alpha, rows.beta))
    table = percent.reshape(len(alpha), len(beta)).T  # alpha varies slowest in the sweep
    coloured = axes.pcolormesh(alpha, beta, table, shading="nearest", cmap="viridis_r", vmin=0.0, vmax=_FAR)
    coloured.set_rasterized(True)
    _mark(axes, front.placed[1:], "alpha", "beta")
    _logarithmic(axes)
    axes.set(xlabel=r"$\alpha$ (1)", ylabel=r"$\beta$ (N m s/rad)")
    axes.set_title("the same gains")
    axes.grid(visible=False)
    return coloured


def _mark(axes: Axes, placed: Sequence[Placed], x: str, y: str) -> None:
    """The paper's controllers."""
    for p in placed:
        line = style.CONTROLLER_LINES[p.controller]
        cross = line["marker"] == "x"
        axes.plot(
            getattr(p, x),
            getattr(p, y),
            line["marker"],
            color=line["color"],
            markeredgecolor=line["color"] if cross else style.BLACK,
            markersize=7,
            markeredgewidth=2.0 if cross else 0.8,
            linestyle="",
            zorder=5,
            label="PD" if p.controller == "pd" else rf"optimum, $\mu/\nu$ = {p.controller}",
        )


def _logarithmic(axes: Axes) -> None:
    """Logarithmic axes with plain numbers at ticks that can be read."""
    axes.set(xscale="log", yscale="log")
    for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        ticks = next(t for ratio, t in _TICKS.items() if limits[1] <= ratio * limits[0])
        axis.set_ticks([t for t in ticks if limits[0] <= t <= limits[1]], minor=False)
        axis.set_ticks([], minor=True)
        axis.set_major_formatter("{x:g}")
