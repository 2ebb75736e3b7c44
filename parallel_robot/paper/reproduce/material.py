"""The material of claims and errata: the runs with what is computed from them once, and the register of measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from cosim.errors import ArgumentError
from parallel_robot.metrics import metrics
from parallel_robot.paper.reproduce.content import Condition, Measured, Runs, TableRow, TheoremCheck
from parallel_robot.paper.reproduce.table import table1
from parallel_robot.paper.reproduce.theorem import Motion, motions, theorem_1

#: Names of the five tracking errors.
ERRORS = ("x", "y", "theta_a[1]", "theta_a[2]", "theta_a[3]")


@dataclass(frozen=True)
class Material:
    """The runs with Table 1, the metrics of each run, and the runs in the variables of Theorem 1."""

    runs: Runs

    @cached_property
    def table1(self) -> tuple[TableRow, ...]:
        """Table 1, computed."""
        return table1()

    @cached_property
    def motions(self) -> dict[str, Motion]:
        """Runs of the proposed controllers by key, see `theorem.motions`."""
        return motions(self.runs)

    @cached_property
    def theorem1(self) -> tuple[TheoremCheck, ...]:
        """Theorem 1 along these runs."""
        return theorem_1(self.runs, self.motions)

    @cached_property
    def _metrics(self) -> dict[tuple[str, Condition], dict[str, dict[str, float]]]:
        return {which: metrics(r, self.runs.steady_after)["tracking"] for which, r in self.runs.closed_loop.items()}

    def metric(self, key: str, name: str, what: str, condition: Condition = "disturbed") -> float:
        """One number of `parallel_robot.metrics` on a run: what = "steady_max", "rms", "accumulated", ..."""
        return self._metrics[key, condition][name][what]

    def initial_error(self, name: str) -> float:
        """Size of an error (m or rad) at the start, the same for all controllers."""
        results = self.runs.closed_loop["1", "disturbed"]
        axis = {"x": ("plant.x_E", "trajectory.x_ref"), "y": ("plant.y_E", "trajectory.y_ref")}
        actual, desired = axis.get(name, (f"plant.{name}", "trajectory." + name.replace("theta_a", "theta_ref")))
        return abs(float(results[actual][0] - results[desired][0]))

    def against_pd(self, what: str, condition: Condition = "disturbed") -> dict[str, float]:
        """A metric of each proposed controller over that of PD, for the five errors."""
        return {
            f"{name}, mu/nu = {c.key}": self.metric(c.key, name, what, condition)
            / self.metric("pd", name, what, condition)
            for c in self.runs.proposed
            for name in ERRORS
        }


#: A measure computes from the material the numbers that decide a claim.
Measure = Callable[[Material], Measured]

#: All measures, by the name that `claims.toml` gives as `metric`.
MEASURES: dict[str, Measure] = {}


def measure(function: Measure) -> Measure:
    """Register a function as a measure under its own name; a decorator.

    Raises
    ------
    ArgumentError
        Another measure has that name.
    """
    name = function.__name__
    if MEASURES.setdefault(name, function) is not function:
        raise ArgumentError(f"two measures are called {name!r}; rename one")
    return function
