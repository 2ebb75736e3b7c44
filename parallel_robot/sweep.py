"""Sweeps of the robot: which numbers of a run are kept."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.results.results import Results
from cosim.scenario.scenario import Scenario
from cosim.sweep.scenarios import LOOP_TIME, ScenarioStudy, study_of_alternatives
from cosim.sweep.scenarios import curve_name as cosim_curve_name
from parallel_robot.metrics import metrics, tracking_errors
from parallel_robot.scenario import RobotScenario
from parallel_robot.wiring import OPTIONAL_INPUTS

#: The factor whose values are flavours of the FMUs.
FLAVOUR = "flavour"

_ERRORS = ("x", "y", "theta_a[1]", "theta_a[2]", "theta_a[3]")
_MEASURES = ("max", "rms", "accumulated", "steady_max", "steady_rms")

_OF_FAMILY = (
    *(f"tracking.{error}.{measure}" for error in _ERRORS for measure in _MEASURES),
    "control_effort.max",
    "control_effort.integral",
    "closure_error_max",
)

#: Columns of a row where a scenario names no metrics of its own, in units as `parallel_robot.metrics.metrics` has them.
METRICS = (*_OF_FAMILY, LOOP_TIME)

#: What the metrics are made of.
_RECORDED = {
    "plant": ("x_E", "y_E", "theta_a", "tau_a", "closure_error"),
    "trajectory": ("x_ref", "y_ref", "theta_ref"),
}


@dataclass(frozen=True)
class RobotStudy(ScenarioStudy):
    """Runs of scenarios of the robot; the curves of a row are tracking errors (m, rad)."""

    of_family = _OF_FAMILY

    def _curve_variables(self) -> list[str]:
        return [f"tracking.{error}" for error in _ERRORS]

    def recorded(self, scenario: Scenario) -> list[str]:
        """What is recorded, for metrics and curves."""
        names = [f"{name}.{v}" for name in scenario.components for v in _RECORDED.get(name, ())]
        return names + super().recorded(scenario)

    def measured(self, scenario: Scenario, results: Results) -> Mapping[str, float | None]:
        """Metrics of a run."""
        assert isinstance(scenario, RobotScenario)
        of_family = dict(flat(metrics(results, scenario.steady_after)))
        return {**of_family, **super().measured(scenario, results)}

    def curve_values(self, results: Results) -> Mapping[str, Any]:
        """Tracking errors (n,) by name."""
        return {f"tracking.{error}": values for error, values in tracking_errors(results).items()}


def robot_study(
    scenarios: Mapping[str, RobotScenario],
    folder: Path,
    flavours: Sequence[str],
    own_fmus: Mapping[str, Sequence[Path]] | None = None,
    *,
    curve_period: float | None = None,
) -> tuple[RobotStudy, dict[str, Path]]:
    """A study of FMUs of some flavours in a folder, and their files by SHA-256; see `cosim.sweep.scenarios`.

    Raises
    ------
    SweepError
        An FMU can't be read, or is of no component.
    """
    with_files = {
        label: {flavour: scenario.with_flavour(folder, flavour) for flavour in flavours}
        for label, scenario in scenarios.items()
    }
    return study_of_alternatives(
        RobotStudy,
        with_files,
        own_fmus or {},
        alternative=FLAVOUR,
        optional_inputs=OPTIONAL_INPUTS,
        curve_period=curve_period,
    )


def curve_name(error: str) -> str:
    """Column that holds a tracking error (m, rad) over time."""
    return cosim_curve_name(f"tracking.{error}")


def flat(tree: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, float | None]]:
    """Leaves of nested mappings, names joined by dots."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{before}{name}.")
        else:
            yield before + name, value
