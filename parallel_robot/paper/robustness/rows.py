"""The rows of both sweeps as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from cosim.sweep.scenarios import SCENARIO
from cosim.sweep.store import read
from parallel_robot.paper.reproduce.figures.style import ERROR_NAMES
from parallel_robot.paper.robustness.study import ALPHA, BETA, CONDITIONS, CURVE_PERIOD, GAINS, MONTE_CARLO
from parallel_robot.scenario import load_scenario
from parallel_robot.sweep import curve_name

_INTEGRAL = "control_effort.integral"


@dataclass(frozen=True)
class Rows:
    """Results of runs, NaN where one failed.

    Attributes
    ----------
    error : array (n,)
        Steady error (mm): root mean square of the end effector's distance from where it should be.
    effort : array (n,)
        Control effort (N m): root mean square of |tau_a| over the whole run.
    steady_max : mapping
        Tracking error -> largest steady value (n,) in mm or mrad.
    curves : mapping
        Tracking error -> its values over time (n, points) in mm or mrad.
    factors : mapping
        Factor -> its values (n,).
    """

    error: np.ndarray
    effort: np.ndarray
    steady_max: dict[str, np.ndarray]
    curves: dict[str, np.ndarray]
    factors: dict[str, np.ndarray]

    @property
    def scenario(self) -> np.ndarray:
        """Scenario (n,) of the runs over the gains."""
        return self.factors[SCENARIO]

    @property
    def alpha(self) -> np.ndarray:
        """Gain alpha (n,) of the runs over the gains."""
        return self.factors[ALPHA]

    @property
    def beta(self) -> np.ndarray:
        """Gain beta (n,) of the runs over the gains, in N m s/rad."""
        return self.factors[BETA]

    @property
    def times(self) -> np.ndarray:
        """Times (s) of the curves."""
        return np.arange(next(iter(self.curves.values())).shape[1]) * CURVE_PERIOD


def monte_carlo(folder: Path, factors: Sequence[str]) -> Rows:
    """Rows of the Monte Carlo sweep, in the order of its design."""
    return _rows(folder / MONTE_CARLO, CONDITIONS[1], factors)


def gains(folder: Path) -> Rows:
    """Rows of the sweep over the gains."""
    return _rows(folder / GAINS, CONDITIONS[0], (SCENARIO, ALPHA, BETA))


def _rows(folder: Path, scenario: str, factors: Sequence[str]) -> Rows:
    steady_max = [f"tracking.{name}.steady_max" for name in ERROR_NAMES]
    rms = [f"tracking.{name}.steady_rms" for name in ("x", "y")]
    columns = [*factors, *steady_max, *rms, _INTEGRAL, *map(curve_name, ERROR_NAMES)]
    table = read(folder, columns)
    numbers = {name: table[name].to_numpy().astype(float) for name in (*steady_max, *rms, _INTEGRAL)}
    return Rows(
        error=1e3 * np.hypot(*(numbers[name] for name in rms)),
        effort=np.sqrt(numbers[_INTEGRAL] / load_scenario(scenario).stop_time),
        steady_max={name: 1e3 * numbers[f"tracking.{name}.steady_max"] for name in ERROR_NAMES},
        curves={name: 1e3 * _curves(table[curve_name(name)]) for name in ERROR_NAMES},
        factors={name: np.array(table[name].to_pylist()) for name in factors},
    )


def _curves(column: pa.ChunkedArray) -> np.ndarray:
    """Curves (n, points) of a column of lists, which are of one length where there are any."""
    there = column.is_valid().to_numpy()
    values = column.combine_chunks().flatten().to_numpy()
    curves = np.full((len(there), len(values) // max(1, int(there.sum()))), np.nan)
    curves[there] = values.reshape(int(there.sum()), -1)
    return curves
