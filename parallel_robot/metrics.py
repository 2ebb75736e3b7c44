"""Metrics of a run of the robot: tracking errors, control effort, closure error."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from cosim.results.results import Results
from cosim.results.stored import StoredResults

#: Tracking error name -> actual and desired variable.
_PAIRS = {
    "x": ("plant.x_E", "trajectory.x_ref"),
    "y": ("plant.y_E", "trajectory.y_ref"),
    **{f"theta_a[{i}]": (f"plant.theta_a[{i}]", f"trajectory.theta_ref[{i}]") for i in (1, 2, 3)},
}

#: OpenBLAS shares the product of longer vectors among its threads.
_ROWS_OF_ONE_THREAD = 10_000

#: Variables of all tracking errors.
PAIRED = tuple(variable for pair in _PAIRS.values() for variable in pair)


def tracking_errors(results: Results | StoredResults) -> dict[str, np.ndarray]:
    """Errors actual - desired (n,) of x and y (m) and of the active joints (rad, (32)); empty without a trajectory."""
    return dict(_tracking_errors(results))


def _tracking_errors(results: Results | StoredResults) -> Iterator[tuple[str, np.ndarray]]:
    """One at a time: those of an hour take 30 MB each."""
    for name, (actual, desired) in _PAIRS.items():
        if actual in results and desired in results:
            yield name, results[actual] - results[desired]


def metrics(results: Results | StoredResults, steady_after: float) -> dict[str, Any]:
    """Summarise a run.

    Parameters
    ----------
    results : Results
        Of a scenario of the robot.
    steady_after : float
        From this time (s) on errors count as steady.

    Returns
    -------
    dict
        `tracking`: for x, y (m) and each joint (rad) `max`, `rms` and `accumulated` (integral of the absolute error,
        as Figs. 13-17 of the paper) over the run, `steady_max` and `steady_rms` from `steady_after` on (None for a
        shorter run); `control_effort`: `max` (N m) and `integral` of `|tau_a|^2` (N^2 m^2 s); `closure_error_max` (m).
        Errors whose variables were not recorded are left out, other such entries are None.
    """
    time = results.time
    steady = int(np.searchsorted(time, steady_after))
    tracking = {name: _measures(error, time, steady) for name, error in _tracking_errors(results)}
    return {
        "tracking": tracking,
        "control_effort": _control_effort(results["plant.tau_a"], time) if "plant.tau_a" in results else None,
        "closure_error_max": (
            float(results["plant.closure_error"].max()) if "plant.closure_error" in results else None
        ),
        "steady_after": steady_after,
    }


def _control_effort(tau_a: np.ndarray, time: np.ndarray) -> dict[str, float | None]:
    return {"max": float(np.maximum(tau_a.max(), -tau_a.min())), "integral": _integral_of_squares(tau_a, time)}


def _measures(error: np.ndarray, time: np.ndarray, steady: int) -> dict[str, float | None]:
    """Measures of an error, which is steady from a row on."""
    absolute = np.abs(error)
    is_steady = steady < len(time)
    return {
        "max": float(absolute.max()),
        "rms": _rms(error),
        "accumulated": float(np.trapezoid(absolute, time)),
        "steady_max": float(absolute[steady:].max()) if is_steady else None,
        "steady_rms": _rms(error[steady:]) if is_steady else None,
    }


def _integral_of_squares(tau_a: np.ndarray, time: np.ndarray) -> float | None:
    with np.errstate(over="ignore"):  # torques of a run that failed
        integral = float(np.trapezoid(np.einsum("ij,ij->i", tau_a, tau_a), time))
    return integral if np.isfinite(integral) else None


def _rms(error: np.ndarray) -> float:
    """In pieces that BLAS sums in one thread: more threads would round the last bit in another way."""
    pieces = np.array_split(error, -(-len(error) // _ROWS_OF_ONE_THREAD))
    return math.sqrt(sum(float(np.dot(piece, piece)) for piece in pieces) / len(error))
