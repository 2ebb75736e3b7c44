"""Figs. 7 to 17: path and errors of the six controllers."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from parallel_robot.metrics import metrics, tracking_errors
from parallel_robot.paper.reproduce.content import PRINTED_STEADY, Condition, Runs
from parallel_robot.paper.reproduce.figures import style

#: Numbers of the figures of each error over time, and of its accumulation.
TIME_FIGURES = {name: 8 + i for i, name in enumerate(style.ERROR_NAMES)}

ACCUMULATED_FIGURES = {name: 13 + i for i, name in enumerate(style.ERROR_NAMES)}


def fig_7(runs: Runs) -> style.Drawing:
    """Fig. 7: desired path, proposed control and PD, with zooms on the start and on the disturbance."""
    lines = {
        "desired": {"color": style.ORANGE, "linewidth": 3.2},
        "proposed control": {**style.CONTROLLER_LINES["1"], "color": style.BLUE},
        "PD control": style.CONTROLLER_LINES["pd"],
    }
    proposed, pd = (runs.closed_loop[key, "disturbed"] for key in ("1", "pd"))
    paths = {
        "desired": (proposed["trajectory.x_ref"], proposed["trajectory.y_ref"]),
        "proposed control": (proposed["plant.x_E"], proposed["plant.y_E"]),
        "PD control": (pd["plant.x_E"], pd["plant.y_E"]),
    }
    time = proposed.time
    windows = (
        ("start: the initial error", time <= 0.2, 0.001),
        (f"after {runs.disturbed_from:g} s: the disturbance", np.abs(time - runs.disturbed_from - 1.35) <= 0.12, 0.001),
    )

    def draw(figure: Figure) -> None:
        left, right = cast(Any, figure.subfigures(1, 2, width_ratios=(1.35, 1.0)))
        whole = left.subplots()
        zooms = right.subplots(2, 1)
        for axes in (whole, *zooms):
            for label, (x, y) in paths.items():
                kwargs = {key: value for key, value in lines[label].items() if key != "marker"}
                axes.plot(x[::5], y[::5], label=label, **kwargs)
            axes.plot(proposed["plant.x_E"][0], proposed["plant.y_E"][0], "o", color=style.BLACK, label="start")
            axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
        whole.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2)
        for axes, letter, (title, shown, margin) in zip(zooms, "ab", windows, strict=True):
            x = np.concatenate([p[0][shown] for p in paths.values()])
            y = np.concatenate([p[1][shown] for p in paths.values()])
            centre = (x.max() + x.min()) / 2, (y.max() + y.min()) / 2
            half = max(np.ptp(x), np.ptp(y)) / 2 + margin
            axes.set_xlim(centre[0] - half, centre[0] + half)
            axes.set_ylim(centre[1] - half, centre[1] + half)
            axes.set_title(f"{letter}  {title}")
            axes.locator_params(nbins=4)
            corner = centre[0] - half, centre[1] - half
            whole.add_patch(Rectangle(corner, 2 * half, 2 * half, fill=False, linewidth=0.9))
            whole.text(corner[0] + 1.9 * half, corner[1] + 0.05 * half, letter, ha="right", va="bottom", weight="bold")

    steady = {key: _steady(runs, key, "x") for key in ("1", "pd")}
    return style.Drawing(
        7,
        "The path under the proposed control and under PD",
        "Desired path (93) and the paths under the optimal gains of (mu, nu) = (1, 1) and under PD control (alpha = "
        "0, the "
        f"same beta and S), with mass change, and with disturbance torque from {runs.disturbed_from:g} s on. Both lag "
        f"behind by millimetres: the largest steady error in x is {steady['1']:.2f} mm with the proposed control and "
        f"{steady['pd']:.2f} mm with PD; the paper's figure shows no visible error.",
        "A closed curve with five lobes around (0.225, 0.355) m. The path under the proposed control runs a few "
        "millimetres beside it, that under PD control somewhat further; two zooms show the start and the time after "
        "the disturbance sets in.",
        draw,
        (7.5, 4.6),
    )


def _steady(runs: Runs, key: str, name: str, condition: Condition = "disturbed") -> float:
    """Largest steady error (mm or mrad)."""
    results = runs.closed_loop[key, condition]
    return 1e3 * float(metrics(results, runs.steady_after)["tracking"][name]["steady_max"])


def error_over_time(runs: Runs, name: str) -> style.Drawing:
    """Figs. 8 to 12: one error over time under the six controllers, with a zoom on the steady part."""
    unit = style.error_unit(name)
    symbol = style.ERROR_NAMES[name]

    def curves(axes: Axes, window: tuple[float, float]) -> None:
        for i, controller in enumerate(runs.controllers):
            results = runs.closed_loop[controller.key, "disturbed"]
            time, error = results.time, 1e3 * tracking_errors(results)[name]
            shown = (time >= window[0]) & (time <= window[1])
            every = max(1, int(shown.sum()) // style.MOST_POINTS)
            points = time[shown][::every]
            mark = (i * len(points) // 60 + len(points) // 50, len(points) // 10)
            line = style.CONTROLLER_LINES[controller.key]
            axes.plot(points, error[shown][::every], label=controller.label, markevery=mark, **line)
        axes.axhline(0.0, color="grey", linewidth=0.7)
        axes.set(xlabel="Time (s)", ylabel=f"Error of {symbol} ({unit})", xlim=window)

    def draw(figure: Figure) -> None:
        whole, zoom = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
        end = float(runs.info["stop_time"])
        curves(whole, (0.0, end))
        curves(zoom, (runs.steady_after, end))
        whole.axvline(runs.disturbed_from, color=style.BLACK, linestyle=":", linewidth=0.9)
        whole.annotate(
            "disturbance sets in",
            (runs.disturbed_from, 1.01),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            fontsize=7.5,
        )
        whole.axvspan(runs.steady_after, end, color="#EFEFEF", zorder=0)
        zoom.set_title(f"steady part, from {runs.steady_after:g} s")
        handles, labels = whole.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=6, columnspacing=1.2)

    best, worst = _steady(runs, "10", name), _steady(runs, "0.1", name)
    printed = 1e3 * PRINTED_STEADY[name]
    return style.Drawing(
        TIME_FIGURES[name],
        f"Tracking error of {style.ERROR_WORDS[name]}",
        f"Error of {style.ERROR_WORDS[name]} (actual less desired) with mass change, and with disturbance torque from "
        f"{runs.disturbed_from:g} s on. Largest steady errors: {worst:.3g} {unit} for mu/nu = 0.1, {best:.3g} {unit} "
        f"for mu/nu = 10, {_steady(runs, 'pd', name):.3g} {unit} for PD. The inset of the paper's figure ends at "
        f"{printed:.2g} {unit}.",
        f"Six curves that oscillate about zero over 15 seconds, of the same shape; for mu/nu = 10 they reach "
        f"{best:.3g} "
        f"{unit} in the steady part, for mu/nu = 0.1 {worst:.3g} {unit}, for PD {_steady(runs, 'pd', name):.3g} "
        f"{unit}.",
        draw,
        (7.5, 3.3),
    )


def accumulated_error(runs: Runs, name: str) -> style.Drawing:
    """Figs. 13 to 17: the accumulated error of the six controllers, with and without the disturbance torque."""
    unit = f"{style.error_unit(name)} s"
    symbol = style.ERROR_NAMES[name]
    torques = sorted({(seed, rms) for _, seed, rms in runs.accumulated if rms > 0.0})
    levels = sorted({rms for _, rms in torques})
    total = {
        (key, condition): 1e3
        * metrics(runs.closed_loop[key, condition], runs.steady_after)["tracking"][name]["accumulated"]
        for key, condition in runs.closed_loop
    }

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
        for i, controller in enumerate(runs.controllers):
            colour = style.CONTROLLER_LINES[controller.key]["color"]
            left.bar(
                i - 0.2, total[controller.key, "disturbed"], 0.38, color=colour, edgecolor=style.BLACK, linewidth=0.6
            )
            left.bar(
                i + 0.2,
                total[controller.key, "mass change"],
                0.38,
                color="white",
                edgecolor=colour,
                hatch="////",
                linewidth=1,
            )
            for level, marker, shift in zip(levels, ("o", "^"), (-0.15, 0.15), strict=True):
                percent = [100.0 * (_ratio(runs, controller.key, s, r, name) - 1.0) for s, r in torques if r == level]
                places = i + shift + np.linspace(-0.07, 0.07, len(percent))
                face = colour if level == levels[0] else "white"
                right.plot(places, percent, marker, color=colour, markerfacecolor=face, markersize=3.5, linestyle="")
        ticks = [c.label.replace(r"$\mu/\nu$ = ", "") for c in runs.controllers]
        for axes in (left, right):
            axes.set_xticks(range(len(ticks)), ticks)
            axes.set_xlabel(r"PD, or $\mu/\nu$ of the optimal gains (1)")
            axes.grid(visible=False, axis="x")
        left.set_ylabel(f"Accumulated error of {symbol} ({unit})")
        grey = "#777777"
        left.legend(
            handles=[
                Patch(facecolor=grey, edgecolor=style.BLACK, label="with disturbance torque"),
                Patch(facecolor="white", edgecolor=grey, hatch="////", label="without"),
            ],
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=2,
        )
        right.axhline(0.0, color="grey", linewidth=0.8)
        right.set_ylabel("Rise by the disturbance (%)")
        for level, marker, face in zip(levels, ("o", "^"), (grey, "white"), strict=True):
            right.plot([], [], marker, color=grey, markerfacecolor=face, linestyle="", label=f"{level:g} N m rms")
        right.legend(loc="lower left", bbox_to_anchor=(-0.05, 1.0), ncols=2, columnspacing=1.0, handlelength=1.2)

    pd, low, high = (total[key, "disturbed"] for key in ("pd", "0.1", "10"))
    count = len(torques) // len(levels)
    rises = [_ratio(runs, c.key, seed, rms, name) - 1.0 for c in runs.controllers for seed, rms in torques]
    return style.Drawing(
        ACCUMULATED_FIGURES[name],
        f"Accumulated error of {style.ERROR_WORDS[name]}",
        f"Integral of the absolute error of {style.ERROR_WORDS[name]} over 15 s, with mass change: PD {pd:.4g} {unit}, "
        f"mu/nu = 0.1 {low:.4g} {unit}, mu/nu = 10 {high:.4g} {unit}. Right: by how much {count} other disturbance "
        f"torques of each of two sizes raise it; below zero, the error is smaller with the disturbance.",
        f"Bars: PD {pd:.4g}, then for mu/nu from 0.1 to 10 falling from {low:.4g} to {high:.4g} {unit}; with and "
        f"without "
        f"disturbance they hardly differ. Right, dots for {len(rises)} cases, {sum(r < 0.0 for r in rises)} of them "
        f"below zero.",
        draw,
        (7.5, 3.4),
    )


def _ratio(runs: Runs, key: str, seed: int, rms: float, name: str) -> float:
    """Accumulated error under a disturbance torque over that without."""
    return runs.accumulated[key, seed, rms][name] / runs.accumulated[key, 0, 0.0][name]
