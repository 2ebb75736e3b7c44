"""The runs behind figures and claims, from native FMU files: set up once, run one after the other.

A run of the paper's 15 s takes about 50 ms, less than what a second process would take to start and to load the FMUs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

from cosim.master.simulation import Simulation
from cosim.results.results import Results
from cosim.system.system import Signal
from parallel_robot.metrics import metrics
from parallel_robot.paper.reproduce.acting import MASS_CHANGE, multisine, signals
from parallel_robot.paper.reproduce.content import CONDITIONS, Condition, Controller, Runs
from parallel_robot.paper.reproduce.readings import ASSUMPTIONS, all_readings
from parallel_robot.paper.reproduce.table import controllers
from parallel_robot.scenario import load_scenario

#: Only native FMUs are fast enough for all runs.
FLAVOUR = "fmi2"

#: Claims on the disturbance are judged under several, since the paper doesn't say which it used: seeds, and rms (N m).
SEEDS = tuple(range(1, 11))
LEVELS = (0.01, 0.05)

Progress = Callable[[str], None]


def number_of_runs() -> int:
    """How many runs `run_all` makes."""
    six = len(controllers())
    return six * (len(CONDITIONS) + 1 + len(SEEDS) * len(LEVELS)) + (six - 1) + len(ASSUMPTIONS) + 1


def run_all(folder: Path, progress: Progress = lambda what: None) -> Runs:
    """Make all runs.

    Parameters
    ----------
    folder : Path
        Holds `fmi2/RobotPlant.fmu` and the other two FMUs.
    progress : callable
        Called with a word on each run that has been made.

    Raises
    ------
    SetupError
        The FMUs can't be loaded or coupled.
    SimulationError
        An FMU failed.
    """
    scenario = load_scenario("tracking")
    six = controllers()
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
            for controller in six:
                closed_loop[controller.key, condition] = run(controller, acting)
        acting = signals(scenario, "disturbed")
        for controller in six[1:]:
            results = run(dataclasses.replace(controller, alpha=0.0), acting)
            pd_same_beta[controller.key] = metrics(results, scenario.steady_after)["tracking"]
        for seed, rms in _disturbances():
            acting = signals(dataclasses.replace(scenario, seed=seed), "disturbed", rms)
            for controller in six:
                found = metrics(run(controller, acting), scenario.steady_after)["tracking"]
                accumulated[controller.key, seed, rms] = {name: e["accumulated"] for name, e in found.items()}
        one = next(c for c in six if c.key == "1")
        readings = all_readings(simulation, scenario, one, progress)
        info = closed_loop["1", "disturbed"].info
    return Runs(
        controllers=six,
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
            "coupling": info["coupling"],
            "seed": scenario.seed,
            "disturbance": dataclasses.asdict(multisine(scenario)),
            "mass_change": dataclasses.asdict(scenario.signals[MASS_CHANGE]),
        },
    )


def _disturbances() -> Iterator[tuple[int, float]]:
    yield 0, 0.0
    for rms in LEVELS:
        for seed in SEEDS:
            yield seed, rms


def _open_loop(folder: Path, progress: Progress) -> Results:
    """The robot alone under the torque of Fig. 4."""
    scenario = load_scenario("open-loop")
    with Simulation(scenario.system(folder, FLAVOUR), order=scenario.order) as simulation:
        results = simulation.run(scenario.stop_time, scenario.step_size)
    progress("open loop")
    return results
