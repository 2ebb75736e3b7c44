"""What would give the steady errors of 1e-6 m that the paper's insets show: one run for each assumption."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from cosim.master.simulation import Simulation
from cosim.results.results import Results
from parallel_robot.metrics import tracking_errors
from parallel_robot.paper.reproduce.acting import signals
from parallel_robot.paper.reproduce.content import Condition, Controller, Reading
from parallel_robot.scenario import RobotScenario

Progress = Callable[[str], None]

#: Torque limits (N m): about the largest torque of the printed law, at the start; and less than its steady one.
START_TORQUE, WEAK = 0.5, 0.1


@dataclass(frozen=True)
class Assumption:
    """How a run differs from the printed law with the gains of row (1, 1).

    Attributes
    ----------
    label : str
        In words.
    condition : Condition
        What acts on the robot.
    alpha, beta : float
        Factors of the gains.
    start : mapping
        Other start values of the controller.
    step_size, stop_time : float or None
        In s; None: those of the scenario.
    """

    label: str
    condition: Condition = "disturbed"
    alpha: float = 1.0
    beta: float = 1.0
    start: Mapping[str, float] = field(default_factory=dict)
    step_size: float | None = None
    stop_time: float | None = None


#: Factor of beta, and other start values, of a controller stiff enough; k is above 2 beta S_ii, as the proof asks for.
_STIFF, _STIFF_START = 100.0, {"S": 500.0, "k": 2e5}

_FEEDFORWARD = {"feedforward": 1.0}

ASSUMPTIONS = (
    Assumption("as printed"),
    Assumption("PD control, alpha = 0", alpha=0.0),
    Assumption("as printed, for 60 s", stop_time=60.0),
    Assumption("as printed, and the robot is as the model says", "nominal"),
    Assumption("k = 0.1, where the proof asks for 2 beta S_ii = 6.6 or more", start={"k": 0.1}),
    Assumption("alpha, beta and k ten times as large", alpha=10.0, beta=10.0, start={"k": 120.0}),
    Assumption(
        "beta a hundred times as large, S_ii = 500 1/s, torque renewed each 0.1 ms",
        beta=_STIFF,
        start=_STIFF_START,
        step_size=1e-4,
    ),
    Assumption(
        "the same with motors of 0.5 N m",
        beta=_STIFF,
        start={**_STIFF_START, "tau_max": START_TORQUE},
        step_size=1e-4,
    ),
    Assumption("nominal feedforward", start=_FEEDFORWARD),
    Assumption("nominal feedforward, and no disturbance torque", "mass change", start=_FEEDFORWARD),
    Assumption("nominal feedforward, and no mass change", "disturbance", start=_FEEDFORWARD),
    Assumption("nominal feedforward, and the robot is as the model says", "nominal", start=_FEEDFORWARD),
    Assumption("the same with half the communication step", "nominal", start=_FEEDFORWARD, step_size=5e-4),
    Assumption("as printed, motors of 0.1 N m", start={"tau_max": WEAK}),
    Assumption("the same with nominal feedforward", start={"tau_max": WEAK, **_FEEDFORWARD}),
)


def all_readings(
    simulation: Simulation, scenario: RobotScenario, controller: Controller, progress: Progress
) -> tuple[Reading, ...]:
    """Run all assumptions.

    Parameters
    ----------
    simulation : Simulation
        Of the scenario, open.
    scenario : RobotScenario
    controller : Controller
        With the gains that the factors multiply.
    progress : callable
        Called with a word on each run.
    """
    readings = []
    for assumption in ASSUMPTIONS:
        stop_time, step_size = assumption.stop_time or scenario.stop_time, assumption.step_size or scenario.step_size
        gains = {"alpha": assumption.alpha * controller.alpha, "beta": assumption.beta * controller.beta}
        start = {f"controller.{name}": value for name, value in {**gains, **assumption.start}.items()}
        results = simulation.run(stop_time, step_size, start=start, signals=signals(scenario, assumption.condition))
        steady_after = stop_time - (scenario.stop_time - scenario.steady_after)
        readings.append(_reading(assumption, results, steady_after))
        progress(assumption.label)
    return tuple(readings)


def _reading(assumption: Assumption, results: Results, steady_after: float) -> Reading:
    errors, torque = tracking_errors(results), np.asarray(results["controller.tau_a"])
    steady = results.time >= steady_after
    return Reading(
        assumption=assumption.label,
        condition=assumption.condition,
        steady_x=float(np.abs(errors["x"][steady]).max()),
        steady_y=float(np.abs(errors["y"][steady]).max()),
        torque_rms=float(np.sqrt(np.mean(torque[steady] ** 2))),
        torque_steady=float(np.abs(torque[steady]).max()),
        torque_max=float(np.abs(torque).max()),
    )
