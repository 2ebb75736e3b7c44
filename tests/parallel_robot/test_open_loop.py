"""Open loop (paper, Fig. 4): the plant FMU against DOP853 fed with the same held torque, energy, and order of RK4."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import DOP853

from cosim import Results, System, simulate
from fmu_export.trace.straight_line import python_source
from fmu_export.trace.trace import trace
from parallel_robot.scenario import load_scenario
from plant_fmu.kinematics import chain_ends
from plant_fmu.model import MODEL, PARAMETERS
from tests.support.native_fmus import DEFAULT_FLAVOUR

P = PARAMETERS.unpack(PARAMETERS.starts)


@pytest.fixture(scope="module")
def run(robot_fmus: Path) -> Results:
    scenario = load_scenario("open-loop")
    return simulate(
        scenario.system(robot_fmus, DEFAULT_FLAVOUR), scenario.stop_time, scenario.step_size, extrapolation="hold"
    )


def rate_without_stabilisation() -> Callable[[np.ndarray, np.ndarray], list[float]]:
    """Rate theta'' of the plant without Baumgarte's terms, fast enough for 15,000 integrations."""
    module: dict = {}
    exec(python_source([(trace(MODEL).derivatives, ("t", "x", "u", "p"))]), module)
    p = PARAMETERS.starts.copy()
    p[PARAMETERS.names.index("baumgarte")] = 0.0
    parameters = p.tolist()
    return lambda x, u: module["derivatives"](0.0, x.tolist(), u, parameters)


def integrate_held(times: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """States (n, 12) at the times under a torque that is held from each time to the next, by DOP853 at 1e-12."""
    rate = rate_without_stabilisation()
    x = MODEL.initial_state(PARAMETERS.starts)
    states = [x]
    for i in range(len(times) - 1):
        u = [*torque[i].tolist(), 0.0, 0.0, 0.0, 0.0, 0.0]
        solver = DOP853(
            lambda _, x, u=u: np.array(rate(x, u)), times[i], x, times[i + 1], first_step=5e-4, rtol=1e-12, atol=1e-14
        )
        while solver.status == "running":
            solver.step()
        x = solver.y
        states.append(x)
    return np.array(states)


@pytest.mark.parametrize("rows", [2001, pytest.param(None, marks=pytest.mark.slow)], ids=["2 s", "all"])
def test_path_is_that_of_dop853_within_1e_10_m(run: Results, rows: int | None) -> None:
    states = integrate_held(run.time[:rows], run["plant.tau_a"])
    x, y = (np.array([chain_ends(s[:6], P.l, P.x_A, P.y_A)[k].mean() for s in states]) for k in (0, 1))
    x_E, y_E = run["plant.x_E"][:rows], run["plant.y_E"][:rows]
    distance = np.hypot(x_E - x, y_E - y)
    print(f"largest distance {distance.max():.2e} m")
    assert distance.max() < 1e-10
    assert np.abs(x_E - np.roll(x, 1))[1:].max() > 1e-6  # a path one step late would be found


def test_loop_stays_closed(run: Results) -> None:
    assert run["plant.closure_error"].max() < 1e-11


def test_kinetic_energy_is_the_work_of_the_torques(run: Results) -> None:
    """The torque is held, so that its work over a step is exactly torque times turn."""
    turns = np.diff(run["plant.theta_a"], axis=0)
    work = np.concatenate([[0.0], np.cumsum((run["plant.tau_a"][:-1] * turns).sum(axis=1))])
    imbalance = np.abs(run["plant.kinetic_energy"] - work).max()
    print(f"largest imbalance {imbalance:.2e} J")
    assert imbalance < 1e-10
    assert run["plant.kinetic_energy"].max() > 1e-4


def test_path_stays_in_the_axes_of_fig_4_for_some_seconds_only(run: Results) -> None:
    """The paper doesn't print the duration; 15 s would not fit its axes, 6.5 s do."""
    x, y = run["plant.x_E"], run["plant.y_E"]
    outside = (x < 0.21) | (x > 0.224) | (y < 0.275) | (y > 0.30 + 1e-12)
    first = run.time[np.argmax(outside)]
    assert outside.any()
    assert 6.0 < first < 8.0


def test_rk4_has_order_4(robot_fmus: Path) -> None:
    """Error of the FMU's own integration against its step, under a constant torque."""

    def end(step: float) -> np.ndarray:
        system = System()
        start = {"tau_a": [0.5, -0.3, 0.4], "tau_d": 0.0, "dm": 0.0, "rtol": 0.0, "max_step": step}
        system.add("plant", robot_fmus / DEFAULT_FLAVOUR / "RobotPlant.fmu", start=start)
        results = simulate(system, 0.64, 0.64, record=["plant.x_E", "plant.y_E"], extrapolation="hold")
        return results.values[-1]

    steps = [0.04, 0.02, 0.01]
    reference = end(0.64 / 4096)
    errors = [np.hypot(*(end(step) - reference)) for step in steps]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    print(f"errors {errors}, order {order:.2f}")
    assert order == pytest.approx(4.0, abs=0.3)


def test_mass_change_keeps_the_loop_closed_and_the_start_at_rest(robot_fmus: Path) -> None:
    system = System()
    system.add("plant", robot_fmus / DEFAULT_FLAVOUR / "RobotPlant.fmu", start={"tau_a": 0.0, "tau_d": 0.0})
    system.drive("plant.dm", lambda t: 0.25 * np.sin(np.pi * t))
    results = simulate(system, 1.0, 0.01, extrapolation="hold")
    assert np.abs(results["plant.omega_a"]).max() < 1e-14
    assert results["plant.closure_error"].max() < 1e-15
