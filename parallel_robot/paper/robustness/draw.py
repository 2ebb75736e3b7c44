"""The figures of the study: bands of the errors, sensitivities, Pareto fronts over the gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib import style as mpl_style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from parallel_robot.paper.reproduce.figures import style
from parallel_robot.paper.robustness.content import Front, Placed, Sensitivity, StudyFigure
from parallel_robot.paper.robustness.front import gain_of_others, in_condition
from parallel_robot.paper.robustness.rows import Rows
from parallel_robot.paper.robustness.text import CONDITION_WORDS

Draw = Callable[[Figure], None]

#: Colour of the bands and of their median.
_BAND, _MEDIAN = style.SKY, style.BLUE


def bands(
    rows: Rows, quantiles: Mapping[str, np.ndarray], nominal: Mapping[str, np.ndarray], disturbed_from: float
) -> tuple[Draw, StudyFigure]:
    """Tracking errors over time: quantiles over all runs, and the paper's case."""
    time = rows.times

    def panel(axes: Axes, name: str) -> None:
        lowest, low, median, high, highest = quantiles[name]
        axes.fill_between(time, lowest, highest, color=_BAND, alpha=0.35, linewidth=0, label="5 to 95 % of the runs")
        axes.fill_between(time, low, high, color=_BAND, alpha=0.75, linewidth=0, label="25 to 75 %")
        axes.plot(time, median, color=_MEDIAN, label="median")
        axes.plot(time, nominal[name], color=style.BLACK, linestyle=(0, (3, 1.2)), linewidth=0.9, label="paper's case")
        axes.axvline(disturbed_from, color=style.BLACK, linestyle=":", linewidth=0.9)
        axes.set(ylabel=f"Error of {style.ERROR_NAMES[name]} ({style.error_unit(name)})", xlim=(0.0, time[-1]))

    def draw(figure: Figure) -> None:
        columns = cast(Any, figure.subfigures(1, 2))
        panels = [axes for column, n in zip(columns, (2, 3), strict=True) for axes in column.subplots(n, sharex=True)]
        for name, axes in zip(quantiles, panels, strict=True):
            panel(axes, name)
        for axes in (panels[1], panels[-1]):
            axes.set_xlabel("Time (s)")
        handles, labels = panels[0].get_legend_handles_labels()
        handles.append(Line2D([], [], color=style.BLACK, linestyle=":", linewidth=0.9))
        figure.legend(handles, [*labels, "disturbance sets in"], loc="outside upper center", ncols=5, columnspacing=1.2)

    width = {name: float(np.mean(q[4] - q[0])) for name, q in quantiles.items()}
    return draw, StudyFigure(
        "bands",
        "Tracking errors over all runs",
        f"Errors of the end effector and of the active joints over {len(rows.error)} runs with everything uncertain, "
        "with the gains of (mu, nu) = (1, 1). Dashed: the case that the paper simulates, without noise.",
        "Five panels of errors over 15 s. In each a band around a median that oscillates about zero; 90 % of the runs "
        f"lie within {width['x']:.2g} mm in x and {width['y']:.2g} mm in y on average.",
    )


def sensitivities(found: Sequence[Sensitivity], runs: int) -> tuple[Draw, StudyFigure]:
    """First and total Sobol' indices with their confidence intervals."""
    ranked = sorted(found[0].indices, key=lambda index: index.total)
    groups = [index.group for index in ranked]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(1, len(found), sharey=True)
        for axes, sensitivity in zip(panels, found, strict=True):
            by_group = {index.group: index for index in sensitivity.indices}
            for kind, colour, marker, shift in (
                ("first", style.BLUE, "o", 0.13),
                ("total", style.VERMILION, "s", -0.13),
            ):
                values = np.array([getattr(by_group[g], kind) for g in groups])
                ends = np.array([getattr(by_group[g], f"{kind}_interval") for g in groups]).T
                # percentile intervals of a bootstrap need not hold the estimate
                around = np.maximum(np.stack([values - ends[0], ends[1] - values]), 0.0)
                axes.errorbar(
                    100 * values,
                    np.arange(len(groups)) + shift,
                    xerr=100 * around,
                    fmt=marker,
                    color=colour,
                    markerfacecolor=colour if kind == "first" else "white",
                    capsize=2,
                    label={"first": "alone (first order)", "total": "with interactions (total)"}[kind],
                )
            axes.axvline(0.0, color="grey", linewidth=0.8)
            axes.set_yticks(np.arange(len(groups)), groups)
            axes.set(xlabel="Share of the variance (%)")
            axes.set_title(sensitivity.result)
            axes.grid(visible=False, axis="y")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=2)

    best = ranked[-1]
    return draw, StudyFigure(
        "sensitivity",
        "Sensitivity of the steady error",
        f"Sobol' indices of the steady error (rms of the end effector's distance from 8 s on) and of the control "
        f"effort (rms of |tau_a| over the run) from {runs} runs, with 95 % confidence intervals by bootstrap.",
        f"Dots with error bars for {len(groups)} sources of uncertainty. The steady error depends most on the "
        f"{best.group}: {100 * best.total:.0f} % of the variance.",
    )


def save(draw: Draw, figure: StudyFigure, folder: Path, size: tuple[float, float]) -> None:
    """Draw and write `<name>.svg` and `.png`.

    Raises
    ------
    OSError
        A file can't be written.
    """
    with mpl_style.context(style.STYLE), mpl.rc_context():
        drawn = Figure(figsize=size, layout="constrained")
        draw(drawn)
        no_time: Mapping[str, str | None] = {"Date": None}
        drawn.savefig(folder / f"{figure.name}.svg", metadata=dict(no_time))
        drawn.set_layout_engine("none")  # the layout is done, and costs as much as the drawing
        drawn.savefig(folder / f"{figure.name}.png")


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
