"""Figures of the Monte Carlo runs: bands of the errors, sensitivities; and how a figure is written."""

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

from parallel_robot.paper.reproduce import style
from parallel_robot.paper.robustness.content import Sensitivity, StudyFigure
from parallel_robot.paper.robustness.rows import Rows

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
        "What the steady error depends on",
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
