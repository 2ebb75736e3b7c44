"""Readings of the paper: runs under other assumptions than the printed law with the printed numbers.

The paper leaves much open, and its figures fit the printed numbers badly. A reading changes one or two things and shows
what comes of it, in the insets and in the main axes. That one fits does not prove that the authors ran it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from controller_fmu.model import PARAMETERS as CONTROLLER
from cosim.master.simulation import Simulation
from cosim.results.results import Results
from cosim.scenario.signals import Sine
from cosim.system.system import Signal, System
from parallel_robot.fmus import build_continuous
from parallel_robot.metrics import tracking_errors
from parallel_robot.paper.reproduce.acting import MASS_CHANGE, MASS_RATE, signals
from parallel_robot.paper.reproduce.content import Condition, Controller, Reading
from parallel_robot.paper.reproduce.path import PHASE_OF_INSET, THROUGH_INSET, centre_for
from parallel_robot.paper.reproduce.theorem import needed_bound
from parallel_robot.scenario import RobotScenario
from trajectory_fmu.model import PARAMETERS as TRAJECTORY
from trajectory_fmu.model import desired_path

Progress = Callable[[str], None]

#: Torque limits (N m): about the largest torque of the printed law, at the start; and less than its steady one.
START_TORQUE, WEAK = 0.5, 0.1

#: Relative tolerance of the implicit solver. A hundredth of it changes no error by more than 1e-4 of itself.
TOLERANCE = 1e-7

#: Communication step (s) of the continuous runs: when they are recorded, and between which points inputs are linear.
RECORDED_EVERY = 1e-3


@dataclass(frozen=True)
class Assumption:
    """How a run differs from the printed law with the gains of row (1, 1).

    Attributes
    ----------
    label : str
        In words.
    condition : Condition
        What acts on the robot.
    key : str
        The controller whose gains it takes: mu/nu.
    alpha, beta : float
        Factors of the gains.
    start : mapping
        Other start values, `component.variable`.
    step_size, stop_time : float or None
        In s; None: those of the scenario. In a continuous run the step is that by which coupled FMUs give the same.
    continuous : bool
        Integrate the continuous closed loop by an implicit method, instead of coupling FMUs: for gains that need
        steps of a microsecond.
    too_stiff : bool
        Coupled FMUs would take hours.
    mass_at_rest : bool
        The changing mass arrives at rest; only in a continuous run.
    other_law : str
        What it changes in the law itself, in words.
    k : float or None
        The k of the paper, where `controller.k` stands in for another law; None: it is `controller.k`.
    psi_unit : float
        What the estimate of the run is divided by for that of the law.
    """

    label: str
    condition: Condition = "disturbed"
    key: str = "1"
    alpha: float = 1.0
    beta: float = 1.0
    start: Mapping[str, float] = field(default_factory=dict)
    step_size: float | None = None
    stop_time: float | None = None
    continuous: bool = False
    too_stiff: bool = False
    mass_at_rest: bool = False
    other_law: str = ""
    k: float | None = None
    psi_unit: float = 1.0


def desired_start_velocity() -> dict[str, float]:
    """Start values of the plant for a robot that starts with the desired velocity (m/s)."""
    _, velocity, _ = desired_path(0.0, TRAJECTORY.starts)
    return {"plant.v_x_start": float(velocity[0]), "plant.v_y_start": float(velocity[1])}


#: Factor of beta, and other start values, of a controller stiff enough; k is above 2 beta S_ii, as the proof asks for.
_STIFF, _STIFF_START = 100.0, {"controller.S": 500.0, "controller.k": 2e5}

_FEEDFORWARD = {"controller.feedforward": 1.0}

_MOVING = desired_start_velocity()

_X_C, _Y_C = centre_for(PHASE_OF_INSET)

#: (89) with a constant in place of |theta_a|^2, which full turns of the joints do not change, and beside it.
_CONSTANT = {"controller.bound_angles": 0.0, "controller.bound_constant": 1.0}
_BESIDE = {"controller.bound_constant": 1.0}

#: k of the printed law for the same law with angles and angular velocities in degrees in (89) and (90): psi and the
#: regressor are then that factor times as large each, so that Pi is what it is for radians and k over its fourth power.
_DEGREES = 180.0 / math.pi

#: The printed k, and one far below it.
_K, _SMALL_K = float(CONTROLLER.unpack(CONTROLLER.starts).k), {"controller.k": 1e-3}

#: Where the fuzzy set (91) of the estimate ends.
_PSI_MOST = 0.5

COUPLED = (
    Assumption("as printed"),
    Assumption("PD control, alpha = 0", alpha=0.0),
    Assumption("as printed, for 60 s", stop_time=60.0),
    Assumption("as printed, and the robot is as the model says", "nominal"),
    Assumption("alpha, beta and k ten times as large", alpha=10.0, beta=10.0, start={"controller.k": 120.0}),
    Assumption(
        "beta a hundred times as large, S_ii = 500 1/s, torque renewed each 0.1 ms",
        beta=_STIFF,
        start=_STIFF_START,
        step_size=1e-4,
    ),
    Assumption(
        "the same with motors of 0.5 N m",
        beta=_STIFF,
        start={**_STIFF_START, "controller.tau_max": START_TORQUE},
        step_size=1e-4,
    ),
    Assumption("nominal feedforward", start=_FEEDFORWARD, other_law="(38)"),
    Assumption("nominal feedforward, and no disturbance torque", "mass change", start=_FEEDFORWARD, other_law="(38)"),
    Assumption("nominal feedforward, and no mass change", "disturbance", start=_FEEDFORWARD, other_law="(38)"),
    Assumption(
        "nominal feedforward, and the robot is as the model says", "nominal", start=_FEEDFORWARD, other_law="(38)"
    ),
    Assumption(
        "the same with half the communication step", "nominal", start=_FEEDFORWARD, step_size=5e-4, other_law="(38)"
    ),
    Assumption("as printed, motors of 0.1 N m", start={"controller.tau_max": WEAK}),
    Assumption(
        "the same with nominal feedforward", start={"controller.tau_max": WEAK, **_FEEDFORWARD}, other_law="(38)"
    ),
)

CONTINUOUS = tuple(
    dataclasses.replace(assumption, continuous=True)
    for assumption in (
        Assumption("k = 0.1", start={"controller.k": 0.1}, step_size=1e-4),
        Assumption("k = 0.01", start={"controller.k": 0.01}, step_size=1e-5),
        Assumption("k = 0.001", start=_SMALL_K, step_size=1e-6),
        Assumption("k = 0.001, gains of mu/nu = 0.1", key="0.1", start=_SMALL_K, step_size=1e-6),
        Assumption("k = 0.001, gains of mu/nu = 10", key="10", start=_SMALL_K, step_size=1e-6),
        Assumption("k = 0.0001", start={"controller.k": 1e-4}, too_stiff=True),
        Assumption(
            "k = 12 multiplies in (37): k in place of 1/k",
            start={"controller.k": 1.0 / _K},
            step_size=1e-4,
            other_law="(37)",
            k=_K,
        ),
        Assumption(
            "angles in degrees in (89) and (90)",
            start={"controller.k": _K / _DEGREES**4},
            too_stiff=True,
            other_law="(89)",
            k=_K,
            psi_unit=_DEGREES**2,
        ),
        Assumption("Pi = psi_1 + psi_2 |theta_a'|^2", start=_CONSTANT, other_law="Pi of (89)"),
        Assumption(
            "Pi = psi_1 (1 + |theta_a|^2) + psi_2 |theta_a'|^2",
            start=_BESIDE,
            other_law="Pi of (89)",
        ),
        Assumption(
            "Pi = psi_1 + psi_2 |theta_a'|^2, and k = 0.001",
            start={**_CONSTANT, **_SMALL_K},
            step_size=1e-4,
            other_law="Pi of (89)",
        ),
        Assumption("no leakage in (37)", start={"controller.leakage": 0.0}, other_law="(37)"),
        Assumption(
            "no leakage, and k = 0.001",
            start={"controller.leakage": 0.0, **_SMALL_K},
            step_size=1e-6,
            other_law="(37)",
        ),
        Assumption(
            "no leakage, and k = 12 multiplies",
            start={"controller.leakage": 0.0, "controller.k": 1.0 / _K},
            step_size=1e-4,
            other_law="(37)",
            k=_K,
        ),
        Assumption("psi(0) = (0.25, 0.25)", start={"controller.psi_start": 0.25}),
        Assumption(
            "psi(0) = (0.25, 0.25), and k = 0.001",
            start={"controller.psi_start": 0.25, **_SMALL_K},
            step_size=1e-6,
        ),
        Assumption("mass arrives at rest", mass_at_rest=True),
        Assumption(
            f"{THROUGH_INSET}: centre ({_X_C:.4f}, {_Y_C:.4f}) m, phase {PHASE_OF_INSET} rad",
            start={"trajectory.x_c": _X_C, "trajectory.y_c": _Y_C, "trajectory.phase": PHASE_OF_INSET},
        ),
        Assumption("start with the desired velocity", start=_MOVING),
        *(
            Assumption(f"start with the desired velocity, gains of mu/nu = {key}", key=key, start=_MOVING)
            for key in ("0.1", "0.2", "5", "10")
        ),
        Assumption(
            "start with the desired velocity, and k = 0.001",
            start={**_MOVING, **_SMALL_K},
            step_size=1e-6,
        ),
        Assumption("PD control, start with the desired velocity", alpha=0.0, start=_MOVING),
        Assumption(
            "PD control with beta = 3, start with the desired velocity",
            alpha=0.0,
            start={**_MOVING, "controller.beta": 3.0},
        ),
        Assumption(
            "PD control with beta = 3 and S_ii = 4 1/s, start with the desired velocity",
            alpha=0.0,
            start={**_MOVING, "controller.beta": 3.0, "controller.S": 4.0},
        ),
    )
)

#: In the order of the report.
ASSUMPTIONS = COUPLED + CONTINUOUS


def coupled_readings(
    simulation: Simulation,
    scenario: RobotScenario,
    controllers: Sequence[Controller],
    assumptions: Sequence[Assumption],
    progress: Progress,
) -> tuple[Reading, ...]:
    """One run of coupled FMUs for each assumption that is not continuous.

    Parameters
    ----------
    simulation : Simulation
        Of the scenario, open.
    scenario : RobotScenario
    controllers : sequence of Controller
        With the gains that the factors multiply.
    assumptions : sequence of Assumption
    progress : callable
        Called with a word on each run.
    """
    readings = []
    for assumption in assumptions:
        if assumption.continuous:
            continue
        stop_time, step_size = assumption.stop_time or scenario.stop_time, assumption.step_size or scenario.step_size
        start = _start(assumption, controllers)
        results = simulation.run(stop_time, step_size, start=start, signals=signals(scenario, assumption.condition))
        steady_after = stop_time - (scenario.stop_time - scenario.steady_after)
        readings.append(_reading(assumption, start, results, steady_after, scenario))
        progress(assumption.label)
    return tuple(readings)


def continuous_readings(
    folder: Path,
    scenario: RobotScenario,
    controllers: Sequence[Controller],
    assumptions: Sequence[Assumption],
    progress: Progress,
) -> tuple[Reading, ...]:
    """One run of the continuous closed loop, by an implicit method, for each assumption that is continuous.

    Parameters
    ----------
    folder : Path
        The FMU of the closed loop is built there, unless it is there.
    scenario, controllers, assumptions, progress
        As in `coupled_readings`.
    """
    wanted = [assumption for assumption in assumptions if assumption.continuous]
    if not wanted:
        return ()
    readings = []
    with _continuous_loop(folder, scenario) as loop:
        for assumption in wanted:
            start = _start(assumption, controllers)
            results = loop(assumption, start)
            readings.append(_reading(assumption, start, results, scenario.steady_after, scenario))
            progress(assumption.label)
    return tuple(readings)


def least_bounds(
    folder: Path,
    scenario: RobotScenario,
    controllers: Sequence[Controller],
    betas: Sequence[float],
    progress: Progress,
) -> dict[float, tuple[float, float]]:
    """For each beta the least parameter p of the bound (35) with psi_bar = (p, p) over the first second of a run.

    Parameters
    ----------
    folder, scenario, controllers, progress
        As in `continuous_readings`; alpha is that of row (1, 1).
    betas : sequence of float
        In N m s/rad.

    Returns
    -------
    dict
        beta -> (p over the first second, p over it without the first 20 ms).
    """
    if not betas:
        return {}
    found = {}
    with _continuous_loop(folder, scenario) as loop:
        for beta in betas:
            assumption = Assumption(f"beta = {beta:g}", continuous=True)
            results = loop(assumption, {**_start(assumption, controllers), "controller.beta": beta})
            time, needed = needed_bound(results, 1.0)
            found[beta] = float(needed.max()), float(needed[time > 0.02].max())
            progress(assumption.label)
    return found


@contextmanager
def _continuous_loop(
    folder: Path, scenario: RobotScenario
) -> Iterator[Callable[[Assumption, Mapping[str, float]], Results]]:
    """A function that runs the continuous loop under an assumption with start values, and gives its results."""
    system = System()
    system.add(_LOOP, build_continuous(folder))
    for signal in _loop_signals(scenario, Assumption("as printed")):
        system.drive(signal.target, signal.function, breakpoints=signal.breakpoints, vectorized=True)
    with Simulation(system) as simulation:

        def run(assumption: Assumption, start: Mapping[str, float]) -> Results:
            results = simulation.run(
                scenario.stop_time,
                RECORDED_EVERY,
                start={f"{_LOOP}.{name}": value for name, value in start.items()},
                signals=_loop_signals(scenario, assumption),
                tolerance=TOLERANCE,
            )
            return dataclasses.replace(results, names=[name.removeprefix(f"{_LOOP}.") for name in results.names])

        yield run


#: Name of the one component of the continuous runs.
_LOOP = "loop"


def _loop_signals(scenario: RobotScenario, assumption: Assumption) -> list[Signal]:
    mass = scenario.signals[MASS_CHANGE]
    assert isinstance(mass, Sine)
    rate = 2.0 * math.pi * mass.frequency * mass.amplitude if assumption.mass_at_rest else 0.0
    shape = Sine(rate, mass.frequency, mass.phase + math.pi / 2.0)
    acting = signals(scenario, assumption.condition)
    acting.append(Signal(MASS_RATE, shape.function(1, scenario.seed, MASS_RATE), vectorized=True))
    return [dataclasses.replace(signal, target=f"{_LOOP}.{signal.target}") for signal in acting]


def _start(assumption: Assumption, controllers: Sequence[Controller]) -> dict[str, float]:
    controller = next(c for c in controllers if c.key == assumption.key)
    gains = {"alpha": assumption.alpha * controller.alpha, "beta": assumption.beta * controller.beta}
    return {**{f"controller.{name}": value for name, value in gains.items()}, **assumption.start}


def _reading(
    assumption: Assumption,
    start: Mapping[str, float],
    results: Results,
    steady_after: float,
    scenario: RobotScenario,
) -> Reading:
    errors, torque = tracking_errors(results), np.asarray(results["controller.tau_a"])
    steady = results.time >= steady_after
    psi = float(np.max(results["controller.psi"])) / assumption.psi_unit
    return Reading(
        assumption=assumption.label,
        condition=assumption.condition,
        method="one FMU, RODAS4" if assumption.continuous else "coupled FMUs",
        steady={name: float(np.abs(error[steady]).max()) for name, error in errors.items()},
        span={name: (float(error.min()), float(error.max())) for name, error in errors.items()},
        torque_rms=float(np.sqrt(np.mean(torque[steady] ** 2))),
        torque_steady=float(np.abs(torque[steady]).max()),
        torque_max=float(np.abs(torque).max()),
        psi_max=psi,
        breaks=_broken(assumption, start, psi),
        command=_command(assumption, start, scenario),
    )


def _broken(assumption: Assumption, start: Mapping[str, float], psi: float) -> tuple[str, ...]:
    """The conditions and equations of the paper that an assumption does not keep to, with the largest estimate."""
    p = CONTROLLER.unpack(CONTROLLER.starts)
    k = start.get("controller.k", float(p.k)) if assumption.k is None else assumption.k
    largest = start.get("controller.S", float(p.S.max()))
    found = [assumption.other_law] if assumption.other_law else []
    if start["controller.alpha"] > 0.0:
        found += ["k >= 2 beta max S_ii"] if k < 2.0 * start["controller.beta"] * largest else []
        found += ["psi within (91)"] if psi > _PSI_MOST else []
    return tuple(found)


def _command(assumption: Assumption, start: Mapping[str, float], scenario: RobotScenario) -> str:
    """The command that runs the same law with coupled FMUs; empty where a scenario of one's own has to, or none can."""
    scenarios = {"disturbed": "tracking", "nominal": "tracking-undisturbed"}
    if assumption.too_stiff or assumption.mass_at_rest or assumption.condition not in scenarios:
        return ""
    p = CONTROLLER.unpack(CONTROLLER.starts)
    own = {"controller.alpha": float(p.alpha), "controller.beta": float(p.beta)}
    parts = [f"cosim run {scenarios[assumption.condition]}"]
    parts += [f"--set {n}={round(v, 15):.10g}" for n, v in start.items() if not math.isclose(v, own.get(n, math.inf))]
    step = assumption.step_size or scenario.step_size
    if step != scenario.step_size:
        parts += [f"--step {np.format_float_positional(step)}", f"--record-every {round(scenario.step_size / step)}"]
    if assumption.stop_time is not None:
        parts.append(f"--stop {assumption.stop_time:g}")
    return " ".join(parts)
