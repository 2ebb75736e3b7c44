"""Runs as columns of 32-bit floats at about 100 Hz: what animation and plots of the page show."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.results.results import Results
from parallel_robot.metrics import tracking_errors
from parallel_robot.paper.reproduce.content import CONDITIONS, Condition, Runs

#: Rows of the page's data are this far apart (s); the disturbance has nothing above 10 Hz.
_ROW = 0.01

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
class Series:
    """A run as the page knows it.

    Attributes
    ----------
    key, label : str
        Identifier, and name for people.
    controller : int or None
        Number of the controller; None in open loop.
    condition : Condition or None
    onset : float or None
        When the disturbance torque sets in (s).
    start, step : float
        Time of the first row and from row to row (s).
    columns : dict of arrays (n,)
        a1..a3, b1..b3: angles (rad); E_x, E_y, d_x, d_y: end effector and its desired position (m); f1_x..f3_y: force
        (N) of the closure on the end of each chain; tau1..tau3 (N m); closure (m); psi1, psi2; with a desired path
        also error (m), and for x, y (m) and q1..q3 (rad) the error and, after "sum_", its accumulated magnitude.
    parameters : mapping
        Start values of the run, for its geometry.
    """

    key: str
    label: str
    controller: int | None
    condition: Condition | None
    onset: float | None
    start: float
    step: float
    columns: dict[str, np.ndarray]
    parameters: dict[str, Any]

    def geometry(self) -> dict[str, Any]:
        """Link length and bases (m)."""
        p = self.parameters
        bases = {name: [p[f"plant.{name}[{i}]"] for i in (1, 2, 3)] for name in ("x_A", "y_A")}
        return {"l": p["plant.l"], **bases}

    def as_json(self) -> dict[str, Any]:
        """Names and numbers for the page; all columns one after the other in base64."""
        data = np.concatenate(list(self.columns.values())).astype("<f4")
        return {
            "key": self.key,
            "label": self.label,
            "onset": self.onset,
            "start": self.start,
            "step": self.step,
            "rows": len(next(iter(self.columns.values()))),
            "robot": self.geometry(),
            "names": list(self.columns),
            "data": b64encode(data.tobytes()).decode(),
        }


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
    time = results.time
    step = (time[-1] - time[0]) / (len(time) - 1)
    every = max(1, round(_ROW / step))
    columns = {name: column[::every] for name, column in _columns(results).items()}
    start, row = round(float(time[0]), 9), round(every * float(step), 9)
    return Series(key, label, controller, condition, onset, start, row, columns, dict(results.info["parameters"]))


def _columns(results: Results) -> dict[str, np.ndarray]:
    numbers = (1, 2, 3)
    columns = {f"a{i}": results[f"plant.theta_a[{i}]"] for i in numbers}
    columns |= {f"b{i}": results[f"plant.theta_b[{i}]"] for i in numbers}
    columns |= {"E_x": results["plant.x_E"], "E_y": results["plant.y_E"]}
    forces = chain_forces(results)
    columns |= {f"f{i}_{axis}": forces[:, i - 1, k] for i in numbers for k, axis in enumerate("xy")}
    columns |= {f"tau{i}": results[f"plant.tau_a[{i}]"] for i in numbers}
    columns |= {"closure": results["plant.closure_error"]}
    if "controller.psi" in results:
        columns |= {f"psi{i}": results[f"controller.psi[{i}]"] for i in (1, 2)}
    errors = {name.replace("theta_a[", "q").rstrip("]"): e for name, e in tracking_errors(results).items()}
    if errors:
        columns |= {"d_x": results["trajectory.x_ref"], "d_y": results["trajectory.y_ref"]}
        columns |= {"error": np.hypot(errors["x"], errors["y"])}
        columns |= errors
        # accumulated at the full rate of the run
        columns |= {f"sum_{name}": _accumulated(error, results.time) for name, error in errors.items()}
    return columns


def _accumulated(error: np.ndarray, time: np.ndarray) -> np.ndarray:
    magnitude = np.abs(error)
    pieces = 0.5 * (magnitude[1:] + magnitude[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(pieces)])


def chain_forces(results: Results) -> np.ndarray:
    """Force of the loop closure on the end of each chain (n, 3, 2) (N); the three sum to zero.

    F_c (19) is in joint coordinates: in chain i, (F_a, F_b) = J_i^T f_i, with the columns l [-sin a, cos a] and
    l [-sin b, cos b] of J_i, the derivatives of the chain's end; this solves for f_i.
    """
    a, b = results["plant.theta_a"], results["plant.theta_b"]
    F_a, F_b = results["plant.F_c"][:, :3], results["plant.F_c"][:, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):  # of a stretched chain F_c gives no force
        scale = 1.0 / (results.info["parameters"]["plant.l"] * np.sin(b - a))
        return np.stack(
            [scale * (np.cos(b) * F_a - np.cos(a) * F_b), scale * (np.sin(b) * F_a - np.sin(a) * F_b)], axis=2
        )
