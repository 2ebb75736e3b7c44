"""The two sweeps of the study: Monte Carlo over all uncertainties, and a grid over the gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controller_fmu.membership import Membership, Sine
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Levels, Points, Range
from cosim.sweep.scenarios import SCENARIO as SCENARIO_FACTOR
from cosim.sweep.scenarios import SEED, STEP, check
from cosim.sweep.sensitivity import Uncertain, base_for, groups_of, saltelli
from parallel_robot.paper.reproduce.table import controllers
from parallel_robot.scenario import RobotScenario, load_scenario
from parallel_robot.sweep import RobotStudy, robot_study
from plant_fmu.model import PARAMETERS

#: Scenario of the Monte Carlo runs.
SCENARIO = "tracking-noise"

#: Sizes of disturbance and noise go from nothing to so many times what the scenario has.
_LARGEST = 2.0

#: Start of the end effector: that of the paper, give or take this (m), in x and in y.
_START_RANGE = 0.01

_SEEDS = 10_000

#: Communication steps (s); all divide the period of the noise, so that all see the same noise.
_STEPS = (0.5e-3, 1e-3, 2e-3, 4e-3)

#: Factors of which more or less means nothing.
NO_ORDER = (SEED, "plant.dm.phase")

#: Intervals in which a membership function is taken as constant to draw from it.
_INTERVALS = 4096


@dataclass(frozen=True)
class Source:
    """An uncertain factor with its unit and distribution, for people.

    Attributes
    ----------
    uncertain : Uncertain
    unit : str
    distribution : str
        In words.
    """

    uncertain: Uncertain
    unit: str
    distribution: str


def drawn_by_membership(membership: Membership) -> Callable[[np.ndarray], np.ndarray]:
    """Values of a fuzzy number at probabilities (n,), with a density in proportion to its membership.

    The mean of any function over such values is its D-operation (77).
    """
    from scipy.stats import rv_histogram  # takes a while to import

    edges = np.linspace(*membership.support, _INTERVALS + 1)
    weights = membership((edges[1:] + edges[:-1]) / 2.0)
    quantile: Callable[[np.ndarray], np.ndarray] = rv_histogram((weights, edges), density=True).ppf
    return quantile


def sources(scenario: RobotScenario) -> tuple[Source, ...]:
    """All uncertain factors, around a scenario with noise."""
    mass = Sine()  # (88): close to 0.25, which is what the paper simulates with
    span = mass.support
    start, plant = scenario.start.get("plant", {}), PARAMETERS.unpack(PARAMETERS.starts)

    def from_nothing(name: str) -> Range:
        target, _, number = name.rpartition(".")
        return Range(name, 0.0, _LARGEST * getattr(scenario.shape(target), number))

    def around(name: str) -> Range:
        centre = start.get(name, getattr(plant, name))
        return Range(f"plant.{name}", centre - _START_RANGE, centre + _START_RANGE)

    dm = Uncertain(Range("plant.dm.amplitude", *span), "amplitude of the mass change", drawn_by_membership(mass))
    steps = ", ".join(f"{1e3 * h:g}" for h in _STEPS)
    return (
        Source(dm, "kg", f"fuzzy number (88) on [{span[0]:g}, {span[1]:g}], density in proportion to its membership"),
        _plain(Range("plant.dm.phase", 0.0, 2.0 * math.pi), "phase of the mass change", "rad"),
        _plain(around("x_E_start"), "start point", "m"),
        _plain(around("y_E_start"), "start point", "m"),
        _plain(from_nothing("plant.tau_d.rms"), "size of the disturbance torque", "N m"),
        Source(
            Uncertain(Levels(SEED, tuple(range(1, _SEEDS + 1))), "seed of disturbance and noise"),
            "1",
            f"one of {_SEEDS:,}",
        ),
        _plain(from_nothing("controller.theta_a.rms"), "noise of the angles", "rad"),
        _plain(from_nothing("controller.omega_a.rms"), "noise of the velocities", "rad/s"),
        Source(Uncertain(Levels(STEP, _STEPS), "communication step"), "s", f"{steps} ms, equally likely"),
    )


def _plain(factor: Range, group: str, unit: str) -> Source:
    return Source(Uncertain(factor, group), unit, f"uniform on [{factor.low:.4g}, {factor.high:.4g}]")


#: Folders of the sweeps in that of the study.
MONTE_CARLO, GAINS = "monte-carlo", "gains"

#: Conditions of the grid: as the paper's section 6, and with sensor noise.
CONDITIONS = ("tracking", SCENARIO)

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


#: Sets of runs that the confidence of a sensitivity index needs.
_LEAST_SETS = 2


def monte_carlo(fmus: Path, flavour: str, runs: int, seed: int) -> Sweep:
    """At least so many runs over everything that is uncertain, with the gains of the controller FMU.

    Raises
    ------
    SweepError
        The numbers or the FMUs make no sense.
    """
    scenario = load_scenario(SCENARIO)
    if runs < 1:
        raise SweepError(f"{runs} runs can't be made; ask for at least one")
    varied = [source.uncertain for source in sources(scenario)]
    base = base_for(varied, runs)
    if base < _LEAST_SETS:
        least = _LEAST_SETS // 2 * (len(groups_of(varied)) + 2) + 1
        raise SweepError(f"{runs} runs are too few for sensitivities; ask for at least {least}")
    points = saltelli(varied, base, seed)
    return _sweep(MONTE_CARLO, fmus, flavour, [SCENARIO], points)


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
    study, files = robot_study(loaded, fmus, [flavour], curve_period=CURVE_PERIOD)
    discrete = ("scenario", "seed")
    check(study, files, [f for f in points.factors if f.name not in discrete])
    return Sweep(name, study, files, points)
