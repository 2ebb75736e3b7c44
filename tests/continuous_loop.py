"""The continuous closed loop, fast: the models' traced functions under DOP853, no FMU, no step and no coupling.

`cosim.robot.closed_loop` does the same by python-control on the numpy models, a hundred times slower; a test holds the
two together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from cosim.robot.models import MODELS
from fmu_export.trace import trace
from plant_fmu.kinematics import chain_ends
from plant_fmu.model import PARAMETERS

P = PARAMETERS.unpack(PARAMETERS.starts)


def closed_loop_rate() -> ca.Function:
    """rate(t, state (14,), w (4,)) with w = [tau_d, dm]; inputs in the order of the declarations."""
    plant, controller, trajectory = (trace(MODELS[n]) for n in ("plant", "controller", "trajectory"))
    t, state, w = ca.SX.sym("t"), ca.SX.sym("state", 14), ca.SX.sym("w", 4)
    p, c, r = (m.parameters.starts for m in MODELS.values())
    x, psi = state[:12], state[12:]
    reference = trajectory.outputs(t, ca.SX(0, 1), ca.SX(0, 1), r)
    measured = ca.vertcat(x[:3], x[6:9], reference[:6])
    tau_a = controller.outputs(t, psi, measured, c)[:3]
    rate = ca.vertcat(plant.derivatives(t, x, ca.vertcat(tau_a, w), p), controller.derivatives(t, psi, measured, c))
    return ca.Function("rate", [t, state, w], [rate])


def solve(times: np.ndarray, w: Callable[[float], np.ndarray], breakpoints: Sequence[float], rtol: float) -> np.ndarray:
    """States (n, 14) at times (n,) in s; w(t) -> (4,) is tau_d and dm and jumps at the breakpoints only."""
    rate = closed_loop_rate()
    x = np.concatenate([MODELS[n].initial_state(MODELS[n].parameters.starts) for n in ("plant", "controller")])
    states = np.empty((len(times), len(x)))
    states[0] = x
    for begin, end in pairwise([times[0], *breakpoints, times[-1]]):
        latest = np.nextafter(end, begin)  # before a jump, not on it

        def f(t: float, state: np.ndarray, latest: float = latest) -> np.ndarray:
            return rate(t, state, w(min(t, latest))).full().ravel()

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
