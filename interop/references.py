"""What the runs of other tools are compared with: our own runs, and the continuous closed loop."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from cosim import Simulation
from fmu_export.trace.trace import trace
from interop.cases import START, STEP, coupled, system
from interop.tools.case import Case, ToolRun
from parallel_robot.models import closed_loop_model


@dataclass(frozen=True)
class References:
    """Paths of the end effector (n, 2) in m at the communication points of `case`."""

    fmus: Path

    @cached_property
    def case(self) -> Case:
        """The three FMUs, native, FMI 2.0."""
        return coupled(self.fmus, "fmi2")

    @cached_property
    def sequential(self) -> np.ndarray:
        """Ours: an output with direct feedthrough follows the inputs at once; all inputs held."""
        return self._ours("sequential")

    @cached_property
    def parallel(self) -> np.ndarray:
        """Ours: all outputs are read before any input is set (Jacobi); all inputs held."""
        return self._ours("parallel")

    def _ours(self, order: str) -> np.ndarray:
        with Simulation(
            system(self.case), order=order, extrapolation="hold", record=list(self.case.path)
        ) as simulation:
            results = simulation.run(self.case.stop_time, self.case.step_size)
        return np.column_stack([results[name] for name in self.case.path])

    @cached_property
    def continuous(self) -> np.ndarray:
        """The closed loop without FMUs and steps: the composed model under DOP853 (1e-11)."""
        model = closed_loop_model()
        changed = {f"{part}.{name}": value for part, values in START.items() for name, value in values.items()}
        p = np.array([changed.get(n, s) for n, s in zip(model.parameters.names, model.parameters.starts, strict=True)])
        u = np.array([changed.get(n, s) for n, s in zip(model.inputs.names, model.inputs.starts, strict=True)])
        traced, times = trace(model), self.case.times
        solution = solve_ivp(
            lambda t, x: traced.derivatives(t, x, u, p).full().ravel(),
            (times[0], times[-1]),
            model.initial_state(p),
            "DOP853",
            times,
            rtol=1e-11,
            atol=1e-13,
        )
        where = [model.outputs.names.index(name) for name in self.case.path]
        outputs = (traced.outputs(t, x, u, p).full().ravel() for t, x in zip(times, solution.y.T, strict=True))
        return np.array([y[where] for y in outputs])

    @cached_property
    def first_order_error(self) -> float:
        """Distance (m) of our own parallel run from the continuous loop: one step of delay in each connection."""
        return distance(self.parallel, self.continuous)


def path_of(run: ToolRun, step: float = STEP) -> np.ndarray:
    """Path (n, 2) of a run at the communication points from the start on; NaN where it has no value.

    Raises
    ------
    ValueError
        Times of the run are no communication points, or it has none.
    """
    rows = np.round(run.time / step).astype(int)
    if len(rows) == 0 or np.abs(run.time - rows * step).max() > 1e-9:
        raise ValueError("its times are not the communication points")
    path = np.full((rows.max() + 1, 2), np.nan)  # the start may be missing
    path[rows] = np.column_stack([run.x_E, run.y_E])
    return path


def distance(path: np.ndarray, reference: np.ndarray) -> float:
    """Largest distance (m) of two paths over the time that they share, which must be all but the start.

    Raises
    ------
    ValueError
        One of them ends early or has gaps.
    """
    n = len(reference)
    if len(path) < n or not np.isfinite(path[1:n]).all():
        raise ValueError("it has no value at some communication points")
    found = np.hypot(*(path[1:n] - reference[1:]).T)
    return float(found.max())
