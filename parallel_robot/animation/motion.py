"""The motion of the robot in a run, as columns of 32-bit floats at about 100 Hz."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded

#: Rows are this far apart (s); the disturbance has nothing above 10 Hz.
_ROW = 0.01

#: A longer run has rows farther apart.
_MOST_ROWS = 12_000

_NUMBERS = (1, 2, 3)

#: Forces whose sum is smaller than this share of the largest balance.
_BALANCED = 1e-6


@dataclass(frozen=True, eq=False)
class Motion:
    """The robot in a run.

    Attributes
    ----------
    key, label : str
        Identifier, and name for people.
    start, step : float
        Time of the first row and from row to row (s).
    columns : dict of arrays (n,)
        a1..a3, b1..b3: angles (rad); E_x, E_y: end effector (m). As far as they are recorded also d_x, d_y: its desired
        position (m), error: its distance from there (m), f1_x..f3_y: force (N) of the closure on the end of each
        chain, tau1..tau3 (N m).
    geometry : mapping
        `l`: length of the links; `x_A`, `y_A`: bases (m).
    onset : float or None
        When the disturbance torque sets in (s).
    """

    key: str
    label: str
    start: float
    step: float
    columns: dict[str, np.ndarray]
    geometry: Mapping[str, Any]
    onset: float | None = None

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.columns["E_x"])

    @property
    def sent(self) -> dict[str, np.ndarray]:
        """Columns that a page needs: the force of the third chain, where it balances the others, follows from them."""
        first, second, third = (
            np.stack([self.columns.get(f"f{i}_{axis}", np.array([np.nan])) for axis in "xy"]) for i in _NUMBERS
        )
        off = np.abs(first + second + third).max()  # NaN where a force is not known
        if off <= _BALANCED * np.abs(third).max():
            return {name: column for name, column in self.columns.items() if name not in ("f3_x", "f3_y")}
        return self.columns

    def as_data(self, block: str) -> dict[str, Any]:
        """What the script of a page knows of it; `block` is the id of its deflated columns."""
        return {
            "key": self.key,
            "label": self.label,
            "onset": self.onset,
            "start": self.start,
            "step": self.step,
            "rows": self.rows,
            "robot": dict(self.geometry),
            "names": list(self.sent),
            "block": block,
        }


def motion_of(results: Recorded, key: str, label: str) -> Motion | None:
    """The motion of the robot in a run; None where the run has no robot, or its geometry is not known."""
    plant = _owner(results, ("theta_a[3]", "theta_b[3]", "x_E", "y_E"))
    geometry = None if plant is None else geometry_of(results, plant)
    if plant is None or geometry is None or len(results.time) < 2:
        return None
    every = rows_apart(results.time)
    thin = results.thinned(every)
    start, step = times_of(results.time, every)
    disturbance: Mapping[str, Any] = results.info.get("signals", {}).get(f"{plant}tau_d", {})
    path = _owner(results, ("x_ref", "y_ref"))
    return Motion(key, label, start, step, columns_of(thin, plant, path), geometry, disturbance.get("start_time"))


def rows_apart(time: np.ndarray) -> int:
    """Of how many rows of a run one is shown."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    return max(1, round(_ROW / step), -(-len(time) // _MOST_ROWS))


def times_of(time: np.ndarray, every: int) -> tuple[float, float]:
    """Time of the first row, and from one shown row to the next (s)."""
    return round(float(time[0]), 9), round(every * float(time[-1] - time[0]) / (len(time) - 1), 9)


def _owner(results: Recorded, names: tuple[str, ...]) -> str | None:
    """What stands before names that one component has, as "plant."; None where no one has all."""
    last = names[-1]
    prefixes = (name.removesuffix(last) for name in results.names if name == last or name.endswith(f".{last}"))
    return next((p for p in prefixes if all(f"{p}{name}" in results.names for name in names)), None)


def geometry_of(results: Recorded, plant: str) -> dict[str, Any] | None:
    """Link length and bases (m) of a run whose robot has this before its names."""
    p = results.info.get("parameters", {})
    if any(f"{plant}{name}" not in p for name in ("l", "x_A[3]", "y_A[3]")):
        return None
    bases = {name: [p[f"{plant}{name}[{i}]"] for i in _NUMBERS] for name in ("x_A", "y_A")}
    return {"l": p[f"{plant}l"], **bases}


def columns_of(results: Recorded, plant: str = "plant.", path: str | None = "trajectory.") -> dict[str, np.ndarray]:
    """Columns of a motion from all rows of results; `plant` and `path` stand before the names of robot and path."""
    columns = {f"a{i}": results[f"{plant}theta_a[{i}]"] for i in _NUMBERS}
    columns |= {f"b{i}": results[f"{plant}theta_b[{i}]"] for i in _NUMBERS}
    columns |= {"E_x": results[f"{plant}x_E"], "E_y": results[f"{plant}y_E"]}
    if f"{plant}F_c[6]" in results.names:
        forces = chain_forces(results, plant)
        columns |= {f"f{i}_{axis}": forces[:, i - 1, k] for i in _NUMBERS for k, axis in enumerate("xy")}
    if f"{plant}tau_a[3]" in results.names:
        columns |= {f"tau{i}": results[f"{plant}tau_a[{i}]"] for i in _NUMBERS}
    if path is not None and f"{path}x_ref" in results.names:
        columns |= {"d_x": results[f"{path}x_ref"], "d_y": results[f"{path}y_ref"]}
        columns["error"] = np.hypot(columns["E_x"] - columns["d_x"], columns["E_y"] - columns["d_y"])
    return columns


def chain_forces(results: Recorded, plant: str = "plant.") -> np.ndarray:
    """Force of the loop closure on the end of each chain (n, 3, 2) (N); the three sum to zero.

    F_c (19) is in joint coordinates: in chain i, (F_a, F_b) = J_i^T f_i, with the columns l [-sin a, cos a] and
    l [-sin b, cos b] of J_i, the derivatives of the chain's end; this solves for f_i.
    """
    a, b, F_c = results[f"{plant}theta_a"], results[f"{plant}theta_b"], results[f"{plant}F_c"]
    F_a, F_b = F_c[:, :3], F_c[:, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):  # of a stretched chain F_c gives no force
        scale = 1.0 / (results.info["parameters"][f"{plant}l"] * np.sin(b - a))
        return np.stack(
            [scale * (np.cos(b) * F_a - np.cos(a) * F_b), scale * (np.sin(b) * F_a - np.sin(a) * F_b)], axis=2
        )
