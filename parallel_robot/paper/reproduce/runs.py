"""Runs behind figures and claims, from native FMU files: set up once, run one after the other.

A run of the paper's 15 s takes about 50 ms, less than what a second process would take to start and to load the FMUs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

from cosim.master.simulation import Simulation
from cosim.results.results import Results
from cosim.system.system import Signal
from parallel_robot.metrics import metrics
from parallel_robot.paper.reproduce.acting import MASS_CHANGE, SHAPES, disturbance, multisine, signals
from parallel_robot.paper.reproduce.content import CONDITIONS, Condition, Controller, Disturbed, Runs
from parallel_robot.paper.reproduce.readings import (
    ASSUMPTIONS,
    Assumption,
    continuous_readings,
    coupled_readings,
    least_bounds,
)
from parallel_robot.paper.reproduce.table import controllers
from parallel_robot.paper.reproduce.theorem import STIFF
from parallel_robot.scenario import RobotScenario, load_scenario

#: Only native FMUs are fast enough for all runs.
FLAVOUR = "fmi2"

#: Claims on the disturbance are judged under several, since the paper doesn't say which it used: seeds, and rms (N m).
SEEDS = tuple(range(1, 11))
LEVELS = (0.01, 0.05)

#: Shapes and levels (N m) under which PD and the control of row (1, 1) are compared.
EVENTS = tuple((shape, level) for shape in SHAPES for level in (0.01, 0.05, 0.2, 1.0))


Progress = Callable[[str], None]


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
    events : tuple of (str, float)
        Shape and level (N m) of further disturbance torques.
    stiff : tuple of float
        Further beta (N m s/rad) for which the bound of Assumption 4 is sought.
    """

    controllers: tuple[Controller, ...] = field(default_factory=controllers)
    seeds: tuple[int, ...] = SEEDS
    levels: tuple[float, ...] = LEVELS
    assumptions: tuple[Assumption, ...] = ASSUMPTIONS
    events: tuple[tuple[str, float], ...] = EVENTS
    stiff: tuple[float, ...] = STIFF

    @property
    def number_of_runs(self) -> int:
        """How many runs these are."""
        n = len(self.controllers)
        torques = 1 + len(self.seeds) * len(self.levels)
        further = 2 * len(self.events) + len(self.assumptions) + len(self.stiff) + 1
        return n * (len(CONDITIONS) + torques) + 2 * (n - 1) + further

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
    pd_same_effort: dict[str, tuple[float, dict[str, dict[str, float]]]] = {}
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
            pd_same_effort[controller.key] = _pd_of_equal_effort(
                simulation, scenario, controller, closed_loop[controller.key, "disturbed"]
            )
            progress(controller.key)
        disturbed = _disturbed(simulation, scenario, plan, closed_loop, progress)
        for seed, rms in plan.torques():
            acting = signals(dataclasses.replace(scenario, seed=seed), "disturbed", rms)
            for controller in plan.controllers:
                found = metrics(run(controller, acting), scenario.steady_after)["tracking"]
                accumulated[controller.key, seed, rms] = {name: e["accumulated"] for name, e in found.items()}
        readings = coupled_readings(simulation, scenario, plan.controllers, plan.assumptions, progress)
        info = closed_loop["1", "disturbed"].info
    return Runs(
        controllers=plan.controllers,
        closed_loop=closed_loop,
        open_loop=_open_loop(folder, progress),
        accumulated=accumulated,
        pd_same_beta=pd_same_beta,
        pd_same_effort=pd_same_effort,
        disturbed=disturbed,
        least_bound=least_bounds(folder, scenario, plan.controllers, plan.stiff, progress),
        readings=(
            *readings,
            *continuous_readings(folder, scenario, plan.controllers, plan.assumptions, progress),
        ),
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


def _pd_of_equal_effort(
    simulation: Simulation, scenario: RobotScenario, controller: Controller, proposed: Results
) -> tuple[float, dict[str, dict[str, float]]]:
    """Beta of the PD control whose integral of the squared torque is that of a run, and its tracking metrics."""
    effort = metrics(proposed, scenario.steady_after)["control_effort"]["integral"]
    acting = signals(scenario, "disturbed")
    found: dict[float, dict[str, Any]] = {}

    def excess(beta: float) -> float:
        start = {"controller.alpha": 0.0, "controller.beta": beta}
        results = simulation.run(scenario.stop_time, scenario.step_size, start=start, signals=acting)
        found[beta] = metrics(results, scenario.steady_after)
        return float(found[beta]["control_effort"]["integral"] / effort - 1.0)

    beta = float(brentq(excess, 0.2 * controller.beta, 5.0 * controller.beta, rtol=1e-4))
    if beta not in found:
        excess(beta)
    return beta, found[beta]["tracking"]


def _disturbed(
    simulation: Simulation,
    scenario: RobotScenario,
    plan: Plan,
    closed_loop: Mapping[tuple[str, Condition], Results],
    progress: Progress,
) -> tuple[Disturbed, ...]:
    rows = []
    for key in ("pd", "1"):
        controller = next(c for c in plan.controllers if c.key == key)
        start = {"controller.alpha": controller.alpha, "controller.beta": controller.beta}
        without = closed_loop[key, "mass change"]
        for shape, level in plan.events:
            acting = disturbance(scenario, shape, level)
            results = simulation.run(scenario.stop_time, scenario.step_size, start=start, signals=acting)
            rows.append(_effect(key, shape, level, results, without, scenario))
            progress(shape)
    return tuple(rows)


def _effect(
    key: str, shape: str, level: float, results: Results, without: Results, scenario: RobotScenario
) -> Disturbed:
    found, base = (metrics(r, scenario.steady_after)["tracking"] for r in (results, without))
    distance = np.hypot(results["plant.x_E"] - without["plant.x_E"], results["plant.y_E"] - without["plant.y_E"])
    peak, lasts = float(distance.max()), SHAPES[shape]
    back_after = None
    if lasts is not None:
        end = multisine(scenario).start_time + lasts
        late = np.flatnonzero(distance > 0.1 * peak)[-1]
        back_after = max(float(results.time[late]) - end, 0.0)
    steady = {name: found[name]["steady_rms"] / base[name]["steady_rms"] for name in found}
    return Disturbed(key, shape, level, steady, peak, back_after)


def _open_loop(folder: Path, progress: Progress) -> Results:
    """The robot alone under the torque of Fig. 4."""
    scenario = load_scenario("open-loop")
    with Simulation(scenario.system(folder, FLAVOUR), order=scenario.order) as simulation:
        results = simulation.run(scenario.stop_time, scenario.step_size)
    progress("open loop")
    return results
