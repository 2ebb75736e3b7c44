"""Figures of a run: path, tracking errors, torques, adaptation, loop closure."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from os import PathLike
from pathlib import Path

import numpy as np

from cosim.errors import needs
from cosim.results.results import Results
from parallel_robot.metrics import PAIRED, tracking_errors

with needs("plot"):
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.image import imsave

#: Okabe and Ito's colours, which colour-blind readers can tell apart; dashes tell them apart in greyscale.
_COLOURS = ("#0072B2", "#D55E00", "#009E73")
_DASHES = ("-", "--", "-.")

_DPI = 120

#: Intervals between ticks; more are not needed, and take more time than the curves.
_MOST_TICKS = 6

#: The default level makes files a quarter smaller, and takes a quarter of the time that figures take.
_PNG = {"compress_level": 1}


def write_figures(results: Results, title: str, steady_after: float, folder: str | PathLike[str]) -> list[Path]:
    """Draw what a run recorded, as PNG files.

    Parameters
    ----------
    results : Results
        Of a scenario of the robot.
    title : str
        Stands above every figure.
    steady_after : float
        Start (s) of the zoom on the steady part.
    folder : path
        Where `path.png`, `tracking_errors.png`, `torques.png`, `psi.png` and `closure_error.png` are written; those
        whose variables were not recorded are left out.

    Raises
    ------
    OSError
        A file can't be written.
    """
    drawings: dict[str, tuple[tuple[str, ...], Callable[[Figure, Results, float], None]]] = {
        "path": (("plant.x_E", "plant.y_E"), _path),
        "tracking_errors": (PAIRED, _tracking_errors),
        "torques": (tuple(f"plant.{name}[{i}]" for name in ("tau_a", "tau_d") for i in (1, 2, 3)), _torques),
        "psi": (("controller.psi[1]", "controller.psi[2]"), _psi),
        "closure_error": (("plant.closure_error",), _closure_error),
    }
    saved = {}
    with ThreadPoolExecutor(max_workers=1) as pool:  # images are written by C, which lets Python go on
        for name, (variables, draw) in drawings.items():
            if all(variable in results for variable in variables):
                figure = Figure(figsize=(9.0, 6.0), dpi=_DPI)
                # margins by hand: matplotlib's layout engines take longer than the run
                figure.subplots_adjust(left=0.09, right=0.97, bottom=0.09, top=0.88, hspace=0.45, wspace=0.2)
                figure.suptitle(title, fontsize=10, parse_math=False)
                draw(figure, results, steady_after)
                for axes in figure.axes:
                    axes.locator_params(nbins=_MOST_TICKS)
                canvas = FigureCanvasAgg(figure)
                canvas.draw()
                path = Path(folder) / f"{name}.png"
                saved[path] = pool.submit(imsave, path, np.asarray(canvas.buffer_rgba()), dpi=_DPI, pil_kwargs=_PNG)
    for future in saved.values():
        future.result()
    return list(saved)


def _lines(axes: Axes, time: np.ndarray, columns: np.ndarray, labels: list[str], legend: bool = True) -> None:
    for i, label in enumerate(labels):
        axes.plot(time, columns[:, i], color=_COLOURS[i], linestyle=_DASHES[i], linewidth=1.2, label=label)
    axes.grid(alpha=0.3)
    if legend:  # above the axes, where it hides no curve
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(labels), fontsize=8, frameon=False)


def _path(figure: Figure, results: Results, _steady_after: float) -> None:
    axes = figure.subplots()
    if "trajectory.x_ref" in results and "trajectory.y_ref" in results:
        desired = results["trajectory.x_ref"], results["trajectory.y_ref"]
        axes.plot(*desired, color=_COLOURS[1], linestyle="--", linewidth=1.2, label="desired")
    actual = results["plant.x_E"], results["plant.y_E"]
    axes.plot(*actual, color=_COLOURS[0], linewidth=1.2, label="actual")
    axes.plot(actual[0][0], actual[1][0], "o", color=_COLOURS[0], markersize=5, label="start")
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _tracking_errors(figure: Figure, results: Results, steady_after: float) -> None:
    errors = tracking_errors(results)
    position = 1e3 * np.column_stack([errors["x"], errors["y"]])
    joints = 1e3 * np.column_stack([errors[f"theta_a[{i}]"] for i in (1, 2, 3)])
    steady = results.time >= steady_after
    columns = 2 if steady.sum() > 1 else 1
    grid = figure.subplots(2, columns, squeeze=False)
    for row, values, labels, unit in (
        (grid[0], position, ["x", "y"], "Position error (mm)"),
        (grid[1], joints, [f"joint {i}" for i in (1, 2, 3)], "Joint error (mrad)"),
    ):
        _lines(row[0], results.time, values, labels)
        row[0].set(ylabel=unit, xlabel="Time (s)")
        if columns == 2:
            _lines(row[1], results.time[steady], values[steady], labels, legend=False)
            row[1].set(xlabel="Time (s)")
            row[1].set_title(f"steady part, from {steady_after:g} s", fontsize=9)


def _torques(figure: Figure, results: Results, _steady_after: float) -> None:
    upper, lower = figure.subplots(2, 1, sharex=True)
    labels = [f"joint {i}" for i in (1, 2, 3)]
    _lines(upper, results.time, results["plant.tau_a"], labels)
    upper.set(ylabel="Control torque τₐ (N m)")
    _lines(lower, results.time, results["plant.tau_d"], labels)
    lower.set(ylabel="Disturbance torque (N m)", xlabel="Time (s)")


def _psi(figure: Figure, results: Results, _steady_after: float) -> None:
    axes = figure.subplots()
    _lines(axes, results.time, results["controller.psi"], ["ψ₁", "ψ₂"])
    axes.set(xlabel="Time (s)", ylabel="Estimate ψ of the uncertainty bound (1)")


def _closure_error(figure: Figure, results: Results, _steady_after: float) -> None:
    axes = figure.subplots()
    axes.plot(results.time, results["plant.closure_error"], color=_COLOURS[0], linewidth=1.0)
    axes.set(xlabel="Time (s)", ylabel="Norm of the loop closure (m)")
    axes.grid(alpha=0.3)
