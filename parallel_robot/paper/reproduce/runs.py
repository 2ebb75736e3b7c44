"""Runs behind figures and claims, from native FMU files: set up once, run one after the other.

A run of the paper's 15 s takes about 50 ms, less than what a second process would take to start and to load the FMUs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cosim.master.simulation import Simulation
from cosim.results.results import Results
from cosim.scenario.signals import Multisine, Shape, Sine
from cosim.system.system import Signal
from parallel_robot.metrics import metrics, tracking_errors
from parallel_robot.paper.reproduce.content import CONDITIONS, Condition, Controller, Reading, Runs
from parallel_robot.paper.reproduce.table import controllers
from parallel_robot.scenario import RobotScenario, load_scenario

DISTURBANCE, MASS_CHANGE = "plant.tau_d", "plant.dm"

#: Only native FMUs are fast enough for all runs.
FLAVOUR = "fmi2"

#: Claims on the disturbance are judged under several, since the paper doesn't say which it used: seeds, and rms (N m).
SEEDS = tuple(range(1, 11))
LEVELS = (0.01, 0.05)

Progress = Callable[[str], None]


def multisine(scenario: RobotScenario) -> Multisine:
    """The disturbance torque of a scenario."""
    signal = scenario.signals[DISTURBANCE]
    assert isinstance(signal, Multisine)
    return signal


def signals(scenario: RobotScenario, condition: Condition, rms: float | None = None) -> list[Signal]:
    """Disturbance torque, of another size (rms in N m) if one is given, and mass change of a condition."""
    torque = multisine(scenario)
    if rms is not None:
        torque = dataclasses.replace(torque, rms=rms)
    mass: Shape = scenario.signals[MASS_CHANGE]
    if condition not in ("disturbed", "disturbance"):
        torque = dataclasses.replace(torque, rms=0.0)
    if condition not in ("disturbed", "mass change"):
        mass = Sine(amplitude=0.0, frequency=1.0)
    return [
        Signal(target, signal.function(size, scenario.seed, target), signal.breakpoints, vectorized=True)
        for target, signal, size in ((DISTURBANCE, torque, 3), (MASS_CHANGE, mass, 1))
    ]


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
    simulation: Simulation,
    scenario: RobotScenario,
    controller: Controller,
    assumptions: Sequence[Assumption],
    progress: Progress,
) -> tuple[Reading, ...]:
    """Make one run for each assumption.

    Parameters
    ----------
    simulation : Simulation
        Of the scenario, open.
    scenario : RobotScenario
    controller : Controller
        With the gains that the factors multiply.
    assumptions : sequence of Assumption
    progress : callable
        Called with a word on each run.
    """
    readings = []
    for assumption in assumptions:
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


@dataclass(frozen=True)
class Plan:
    """Which runs `run_all` makes; the default is all that the reproduction needs.

    Attributes
    ----------
    controllers : tuple of Controller
        PD first; mu/nu = 1 must be among them.
    seeds : tuple of int
    levels : tuple of float
        Rms (N m). Each seed with each level is one more disturbance torque, beside none.
    assumptions : tuple of Assumption
    """

    controllers: tuple[Controller, ...] = field(default_factory=controllers)
    seeds: tuple[int, ...] = SEEDS
    levels: tuple[float, ...] = LEVELS
    assumptions: tuple[Assumption, ...] = ASSUMPTIONS

    @property
    def number_of_runs(self) -> int:
        """How many runs these are."""
        n = len(self.controllers)
        torques = 1 + len(self.seeds) * len(self.levels)
        return n * (len(CONDITIONS) + torques) + (n - 1) + len(self.assumptions) + 1

    def torques(self) -> Iterator[tuple[int, float]]:
        """Seed and rms (N m) of each disturbance torque, first of none."""
        yield 0, 0.0
        for rms in self.levels:
            for seed in self.seeds:
                yield seed, rms


def run_all(folder: Path, progress: Progress = lambda what: None, plan: Plan | None = None) -> Runs:
    """Make all runs.

    Parameters
    ----------
    folder : Path
        Holds `fmi2/RobotPlant.fmu` and the other two FMUs.
    progress : callable
        Called with a word on each run that has been made.
    plan : Plan, optional
        Fewer runs than the whole reproduction needs.

    Raises
    ------
    SetupError
        The FMUs can't be loaded or coupled.
    SimulationError
        An FMU failed.
    """
    scenario = load_scenario("tracking")
    plan = plan or Plan()
    closed_loop: dict[tuple[str, Condition], Results] = {}
    accumulated: dict[tuple[str, int, float], dict[str, float]] = {}
    pd_same_beta: dict[str, dict[str, dict[str, float]]] = {}
    with Simulation(scenario.system(folder, FLAVOUR), order=scenario.order) as simulation:

        def run(controller: Controller, acting: list[Signal]) -> Results:
            start = {"controller.alpha": controller.alpha, "controller.beta": controller.beta}
            results = simulation.run(scenario.stop_time, scenario.step_size, start=start, signals=acting)
            progress(controller.key)
            return results

        for condition in CONDITIONS:
            acting = signals(scenario, condition)
            for controller in plan.controllers:
                closed_loop[controller.key, condition] = run(controller, acting)
        acting = signals(scenario, "disturbed")
        for controller in plan.controllers[1:]:
            results = run(dataclasses.replace(controller, alpha=0.0), acting)
            pd_same_beta[controller.key] = metrics(results, scenario.steady_after)["tracking"]
        for seed, rms in plan.torques():
            acting = signals(dataclasses.replace(scenario, seed=seed), "disturbed", rms)
            for controller in plan.controllers:
                found = metrics(run(controller, acting), scenario.steady_after)["tracking"]
                accumulated[controller.key, seed, rms] = {name: e["accumulated"] for name, e in found.items()}
        one = next(c for c in plan.controllers if c.key == "1")
        readings = all_readings(simulation, scenario, one, plan.assumptions, progress)
        info = closed_loop["1", "disturbed"].info
    return Runs(
        controllers=plan.controllers,
        closed_loop=closed_loop,
        open_loop=_open_loop(folder, progress),
        accumulated=accumulated,
        pd_same_beta=pd_same_beta,
        readings=readings,
        steady_after=scenario.steady_after,
        disturbed_from=multisine(scenario).start_time,
        info={
            "flavour": FLAVOUR,
            "step_size": scenario.step_size,
            "stop_time": scenario.stop_time,
            "order": scenario.order,
            "extrapolation": info["extrapolation"],
            "seed": scenario.seed,
            "disturbance": dataclasses.asdict(multisine(scenario)),
            "mass_change": dataclasses.asdict(scenario.signals[MASS_CHANGE]),
        },
    )


def _open_loop(folder: Path, progress: Progress) -> Results:
    """The robot alone under the torque of Fig. 4."""
    scenario = load_scenario("open-loop")
    with Simulation(scenario.system(folder, FLAVOUR), order=scenario.order) as simulation:
        results = simulation.run(scenario.stop_time, scenario.step_size)
    progress("open loop")
    return results
