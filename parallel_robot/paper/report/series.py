"""The runs of the paper as motions with their errors: what animation and plots of the report show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.results.results import Results
from parallel_robot.animation.motion import Motion, columns_of, geometry_of, rows_apart, times_of
from parallel_robot.metrics import tracking_errors
from parallel_robot.paper.reproduce.content import CONDITIONS, Condition, Runs

CONDITION_NAMES: dict[Condition, str] = {
    "disturbed": "mass change and disturbance torque",
    "mass change": "mass change only",
    "disturbance": "disturbance torque only",
    "nominal": "neither mass change nor disturbance",
}

OPEN_LOOP = "open-loop"


def controller_names(runs: Runs) -> list[str]:
    """Labels of the controllers without the formulas that matplotlib reads."""
    return [c.label.replace("$", "").replace("\\mu", "μ").replace("\\nu", "ν") for c in runs.controllers]


@dataclass(frozen=True, eq=False)
class Series(Motion):
    """A run as the report knows it.

    Attributes
    ----------
    controller : int or None
        Number of the controller; None in open loop.
    condition : Condition or None
    columns : dict of arrays (n,)
        Those of a motion; closure: loop closure error (m); psi1, psi2; with a desired path also, for x, y (m) and
        q1..q3 (rad), the error and, after "sum_", its accumulated magnitude.
    """

    controller: int | None = None
    condition: Condition | None = None


def all_series(runs: Runs) -> list[Series]:
    """All runs in the order of conditions and controllers, the open loop last."""
    found = []
    names = controller_names(runs)
    for condition in CONDITIONS:
        for number, controller in enumerate(runs.controllers):
            results = runs.closed_loop.get((controller.key, condition))
            if results is not None:
                label = f"{names[number]}, {CONDITION_NAMES[condition]}"
                onset = runs.disturbed_from if condition == "disturbed" else None
                found.append(_series(f"{controller.key}/{condition}", label, number, condition, onset, results))
    found.append(_series(OPEN_LOOP, "Open loop, torque of Fig. 4", None, None, None, runs.open_loop))
    return found


def _series(
    key: str, label: str, controller: int | None, condition: Condition | None, onset: float | None, results: Results
) -> Series:
    every = rows_apart(results.time)
    columns = {name: column[::every] for name, column in _columns(results).items()}
    start, step = times_of(results.time, every)
    geometry = geometry_of(results, "plant.")
    assert geometry is not None
    return Series(key, label, start, step, columns, geometry, onset, controller, condition)


def _columns(results: Results) -> dict[str, np.ndarray]:
    columns = {**columns_of(results), "closure": results["plant.closure_error"]}
    if "controller.psi" in results:
        columns |= {f"psi{i}": results[f"controller.psi[{i}]"] for i in (1, 2)}
    errors = {name.replace("theta_a[", "q").rstrip("]"): e for name, e in tracking_errors(results).items()}
    # accumulated at the full rate of the run
    return columns | errors | {f"sum_{name}": _accumulated(error, results.time) for name, error in errors.items()}


def _accumulated(error: np.ndarray, time: np.ndarray) -> np.ndarray:
    magnitude = np.abs(error)
    pieces = 0.5 * (magnitude[1:] + magnitude[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(pieces)])
