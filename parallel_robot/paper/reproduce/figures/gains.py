"""Figs. 5 and 6: where the performance index J is stationary, and its surface."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from controller_fmu.optimal_gains import PerformanceIndex
from parallel_robot.paper.reproduce.content import Runs
from parallel_robot.paper.reproduce.figures import style

#: Range of alpha and beta shown.
LOWEST, HIGHEST = 0.4, 4.0


def _grid(points: int = 241) -> tuple[np.ndarray, np.ndarray]:
    values = np.linspace(LOWEST, HIGHEST, points)
    alpha, beta = np.meshgrid(values, values)
    return alpha, beta


def fig_5(runs: Runs) -> style.Drawing:
    """Fig. 5: the curves dJ/dalpha = 0 and dJ/dbeta = 0 cross once."""
    one = runs.controller("1")
    index = PerformanceIndex(one.mu, one.nu)

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        alpha, beta = _grid()
        slopes = index.gradient(alpha, beta)
        kinds: tuple[tuple[str, Any, str], ...] = (
            (style.BLUE, "solid", r"$\partial J/\partial\alpha = 0$"),
            (style.VERMILION, "dashed", r"$\partial J/\partial\beta = 0$"),
        )
        for slope, (colour, dashes, _) in zip(slopes, kinds, strict=True):
            axes.contour(alpha, beta, slope, levels=[0.0], colors=[colour], linestyles=[dashes], linewidths=1.8)
        handles = [Line2D([], [], color=c, linestyle=d, linewidth=1.8, label=label) for c, d, label in kinds]
        axes.plot(one.alpha, one.beta, "o", color=style.BLACK, markersize=7, zorder=5)
        handles.append(
            Line2D(
                [],
                [],
                color=style.BLACK,
                marker="o",
                linestyle="",
                label=f"the one crossing\n({one.alpha:.5f}, {one.beta:.4f})",
            )
        )
        for other in runs.proposed:
            if other.key != one.key:
                marker = style.CONTROLLER_LINES[other.key]["marker"]
                axes.plot(other.alpha, other.beta, marker, markerfacecolor="white", color=style.BLACK, markersize=5.5)
                handles.append(
                    Line2D(
                        [],
                        [],
                        color=style.BLACK,
                        marker=marker,
                        markerfacecolor="white",
                        linestyle="",
                        label=f"optimum of ({other.mu:g}, {other.nu:g})",
                    )
                )
        axes.set(xlabel=r"$\alpha$ (1)", ylabel=r"$\beta$ (N m s/rad)", xlim=(LOWEST, HIGHEST), ylim=(LOWEST, HIGHEST))
        axes.legend(handles=handles, loc="upper right")

    return style.Drawing(
        5,
        "The optimal gains as the crossing of two curves",
        f"Where the derivatives of J vanish for (mu, nu) = (1, 1). They cross once, at alpha = {one.alpha:.5f} and "
        f"beta = "
        f"{one.beta:.5f} N m s/rad; that there is no other crossing for any positive gains is proved, not only drawn. "
        "Open markers: the optima of the other rows of Table 1.",
        "Two falling curves over alpha and beta from 0.4 to 4 cross at one point, "
        f"({one.alpha:.3f}, {one.beta:.3f}). Four open markers, the other optima of Table 1, lie along a rising line "
        "through it.",
        draw,
        (5.4, 4.4),
    )


def fig_6(runs: Runs) -> style.Drawing:
    """Fig. 6: the surface J(alpha, beta) and its minimum."""
    one = runs.controller("1")
    index = PerformanceIndex(one.mu, one.nu)
    lowest = float(index(one.alpha, one.beta))

    def draw(figure: Figure) -> None:
        alpha, beta = _grid(81)
        J = index(alpha, beta)
        norm = LogNorm(J.min(), J.max())
        left, right = cast(Any, figure.subfigures(1, 2, width_ratios=(1.0, 1.05)))
        surface = left.add_subplot(projection="3d")
        faces = colormaps["viridis"](norm(J))
        surface.plot_surface(
            alpha, beta, np.log10(J), facecolors=faces, rstride=2, cstride=2, linewidth=0.0, shade=False
        )
        surface.plot([one.alpha], [one.beta], [np.log10(lowest)], "o", color=style.VERMILION, markersize=6, zorder=10)
        surface.set(xlabel=r"$\alpha$ (1)", ylabel=r"$\beta$ (N m s/rad)")
        surface.set_zlabel(r"$\log_{10} J$ (1)", labelpad=1.0)
        for ticks in (surface.set_xticks, surface.set_yticks):
            ticks([1, 2, 3, 4])
        surface.set_zticks([1.0, 1.5, 2.0, 2.5])
        surface.view_init(elev=28, azim=38)
        surface.set_box_aspect((1.0, 1.0, 0.8), zoom=0.86)
        flat = right.subplots()
        levels = np.geomspace(J.min() * 1.0001, J.max(), 22)
        filled = flat.contourf(alpha, beta, J, levels=levels, norm=norm, cmap="viridis", extend="min")
        flat.plot(one.alpha, one.beta, "o", color=style.VERMILION, markeredgecolor="white", markersize=8)
        flat.annotate(
            f"J = {lowest:.4f}",
            (one.alpha, one.beta),
            xytext=(10, 8),
            textcoords="offset points",
            color="white",
            fontweight="bold",
        )
        flat.set(xlabel=r"$\alpha$ (1)", ylabel=r"$\beta$ (N m s/rad)")
        flat.grid(visible=False)
        bar = right.colorbar(filled, ax=flat, label="J (1)", ticks=[10, 20, 50, 100, 200, 400])
        bar.ax.yaxis.set_major_formatter("{x:g}")

    return style.Drawing(
        6,
        "The performance index over the gains",
        "J(alpha, beta) of (80) for (mu, nu) = (1, 1), as a surface (logarithm) and from above. Its minimum, the dot, "
        f"is J = {lowest:.4f}. J is convex here, a valley; the paper calls it globally concave.",
        f"A bowl-shaped surface that rises steeply towards small gains, with one minimum of {lowest:.4f} at alpha = "
        f"{one.alpha:.3f}, beta = {one.beta:.3f}; beside it the same as filled contours.",
        draw,
        (8.2, 3.7),
    )
