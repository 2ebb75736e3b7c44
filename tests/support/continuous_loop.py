"""The continuous closed loop, fast: the models' traced functions under DOP853, no FMU, no step and no coupling.

`parallel_robot.continuous_loop` does the same by python-control on the numpy models, a hundred times slower; a test
holds the two together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from fmu_export.trace.trace import trace
from parallel_robot.models import MODELS
from parallel_robot.wiring import CONNECTIONS
from plant_fmu.kinematics import chain_ends
from plant_fmu.model import PARAMETERS

P = PARAMETERS.unpack(PARAMETERS.starts)


def control_law() -> ca.Function:
    """law(t, plant's state (12,), psi (2,)) -> tau_a (3,), psi' (2,): the controller on the desired path."""
    plant, controller, trajectory = (MODELS[n] for n in ("plant", "controller", "trajectory"))
    t, x, psi = ca.SX.sym("t"), ca.SX.sym("x", 12), ca.SX.sym("psi", 2)
    reference = trace(trajectory).outputs(t, ca.SX(0, 1), ca.SX(0, 1), trajectory.parameters.starts)
    signals = {f"plant.{name}": x[i] for i, name in enumerate(plant.state_layout.names)}
    signals |= {f"trajectory.{name}": reference[i] for i, name in enumerate(trajectory.outputs.names)}
    sources = {target: source for source, target in CONNECTIONS}
    parts = (name.partition("[") for name in controller.inputs.names)
    inputs = ca.vertcat(*(signals[sources[f"controller.{base}"] + bracket + i] for base, bracket, i in parts))
    c, traced = controller.parameters.starts, trace(controller)
    tau_a = traced.outputs(t, psi, inputs, c)[:3]
    return ca.Function("law", [t, x, psi], [tau_a, traced.derivatives(t, psi, inputs, c)])


def closed_loop_rate() -> ca.Function:
    """rate(t, state (14,), w (5,)) with w = [tau_d, dm, dm_rate]; inputs in the order of the declarations."""
    plant = trace(MODELS["plant"])
    t, state, w = ca.SX.sym("t"), ca.SX.sym("state", 14), ca.SX.sym("w", 5)
    x, psi = state[:12], state[12:]
    tau_a, psi_rate = control_law()(t, x, psi)
    x_rate = plant.derivatives(t, x, ca.vertcat(tau_a, w), MODELS["plant"].parameters.starts)
    return ca.Function("rate", [t, state, w], [ca.vertcat(x_rate, psi_rate)])


def solve(times: np.ndarray, w: Callable[[float], np.ndarray], breakpoints: Sequence[float], rtol: float) -> np.ndarray:
    """States (n, 14) at times (n,) in s; w(t) -> (5,) is tau_d, dm and dm_rate, and jumps at the breakpoints only."""
    rate = closed_loop_rate()
    start = np.concatenate([MODELS[n].initial_state(MODELS[n].parameters.starts) for n in ("plant", "controller")])
    return integrate(lambda t, state: rate(t, state, w(t)).full().ravel(), start, times, breakpoints, rtol)


def integrate(
    rate: Callable[[float, np.ndarray], np.ndarray],
    start: np.ndarray,
    times: np.ndarray,
    breakpoints: Sequence[float],
    rtol: float,
) -> np.ndarray:
    """States (n, n_x) at times (n,) in s of state' = rate(t, state), which jumps at the breakpoints only."""
    x = start
    states = np.empty((len(times), len(x)))
    states[0] = x
    for begin, end in pairwise([times[0], *breakpoints, times[-1]]):
        latest = np.nextafter(end, begin)  # before a jump, not on it

        def f(t: float, state: np.ndarray, latest: float = latest) -> np.ndarray:
            return rate(min(t, latest), state)

        wanted = (times > begin) & (times <= end)
        t_eval = np.unique(np.append(times[wanted], end))
        solution = solve_ivp(f, (begin, end), x, "DOP853", t_eval, rtol=rtol, atol=rtol / 100)
        assert solution.success
        states[wanted] = solution.y.T[: wanted.sum()]
        x = solution.y[:, -1]
    return states


def end_effector(states: np.ndarray) -> np.ndarray:
    """Position (n, 2) in m."""
    return np.array([np.mean(chain_ends(x[:6], P.l, P.x_A, P.y_A), axis=1) for x in states])
