"""The two sweeps of the study: Monte Carlo over what is uncertain, and a grid over the gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.sweep.errors import SweepError
from cosim.sweep.points import Levels, Points, Range
from cosim.sweep.sensitivity import base_for, saltelli
from parallel_robot.paper.reproduce.table import controllers
from parallel_robot.paper.robustness import uncertain
from parallel_robot.scenario import load_scenario
from parallel_robot.sweep import SCENARIO as SCENARIO_FACTOR
from parallel_robot.sweep import RobotStudy, check, robot_study

#: Folders of the sweeps in that of the study.
MONTE_CARLO, GAINS = "monte-carlo", "gains"

#: Conditions of the grid: as the paper's section 6, and with sensor noise.
CONDITIONS = ("tracking", uncertain.SCENARIO)

ALPHA, BETA = "controller.alpha", "controller.beta"

#: Range of the grid: about a hundred times the optima of Table 1 for alpha, ten times for beta, and a tenth of them.
ALPHAS, BETAS = (0.1, 100.0), (0.15, 20.0)

#: Points of the bands, each so many seconds.
CURVE_PERIOD = 0.1


@dataclass(frozen=True)
class Sweep:
    """All that `cosim.sweep.engine.sweep` needs to run one of the two.

    Attributes
    ----------
    name : str
        Of its folder.
    study : RobotStudy
    files : dict
        SHA-256 -> FMU file.
    points : Points
    """

    name: str
    study: RobotStudy
    files: dict[str, Path]
    points: Points


def monte_carlo(fmus: Path, flavour: str, runs: int, seed: int) -> Sweep:
    """At least so many runs over everything that is uncertain, with the gains of the controller FMU.

    Raises
    ------
    SweepError
        The numbers or the FMUs make no sense.
    """
    scenario = load_scenario(uncertain.SCENARIO)
    if runs < 1:
        raise SweepError(f"{runs} runs can't be made; ask for at least one")
    varied = [source.uncertain for source in uncertain.sources(scenario)]
    points = saltelli(varied, base_for(varied, runs), seed)
    return _sweep(MONTE_CARLO, fmus, flavour, [uncertain.SCENARIO], points)


def gains(fmus: Path, flavour: str, levels: int) -> Sweep:
    """The paper's six controllers, then a grid of so many levels of each gain, under both conditions.

    Raises
    ------
    SweepError
        The numbers or the FMUs make no sense.
    """
    if levels < 2:
        raise SweepError(f"a grid of {levels} levels has no front; use at least two")
    grid = np.meshgrid(np.geomspace(*ALPHAS, levels), np.geomspace(*BETAS, levels), indexing="ij")
    six = controllers()
    alpha = np.concatenate([[c.alpha for c in six], grid[0].ravel()])
    beta = np.concatenate([[c.beta for c in six], grid[1].ravel()])
    which = np.repeat(np.arange(len(CONDITIONS), dtype=np.int32), len(alpha))
    factors = (Levels(SCENARIO_FACTOR, CONDITIONS), Range(ALPHA, 0.0, ALPHAS[1]), Range(BETA, 0.0, BETAS[1]))
    columns = (which, *(np.tile(gain, len(CONDITIONS)) for gain in (alpha, beta)))
    return _sweep(GAINS, fmus, flavour, CONDITIONS, Points(factors, columns))


def _sweep(name: str, fmus: Path, flavour: str, scenarios: Sequence[str], points: Points) -> Sweep:
    loaded = {scenario: load_scenario(scenario) for scenario in scenarios}
    study, files = robot_study(loaded, fmus, [flavour], {}, "auto", CURVE_PERIOD)
    discrete = ("scenario", "seed")
    check(study, files, [f for f in points.factors if f.name not in discrete])
    return Sweep(name, study, files, points)
