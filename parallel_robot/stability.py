"""Stability of the closed loop along the path: continuous poles, and the largest stable communication step.

The loop is linearised at points along its own solution (frozen time). Of the plant's twelve states four are free; the
other eight describe the loop closure, whose errors decay at the Baumgarte rate whatever the controller does. They are
taken out by restricting the linearised plant to the tangent space of the closed states, which is invariant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import control
import numpy as np
from scipy.linalg import block_diag, expm, null_space

from cosim.errors import ArgumentError
from fmu_export.control_backend import parameter_array, to_control
from fmu_export.modelling.model import Layout
from parallel_robot.continuous_loop import ContinuousSolution, solve
from parallel_robot.models import MODELS
from plant_fmu.kinematics import constraint_matrix

Parameters = Mapping[str, Mapping[str, Any]]
Order = Literal["sequential", "parallel"]

#: One period of the desired path (93) with w = 1, in s, and how finely it is looked at.
_PERIOD = 2.0 * np.pi
_POINTS = 64

#: Steps between which the limit is searched (s), and the relative accuracy to which it is found.
_SHORTEST, _LONGEST = 1e-4, 1.0
_ACCURACY = 1e-4


@dataclass(frozen=True)
class LinearLoop:
    """Plant and controller linearised at n points of a path; the plant on its four free states.

    The plant maps tau_a (3) to y = [theta_a; omega_a] (6) without feedthrough, the controller y to tau_a.
    """

    plant_A: np.ndarray  # (n, 4, 4)
    plant_B: np.ndarray  # (n, 4, 3)
    plant_C: np.ndarray  # (n, 6, 4)
    controller_A: np.ndarray  # (n, 2, 2)
    controller_B: np.ndarray  # (n, 2, 6)
    controller_C: np.ndarray  # (n, 3, 2)
    controller_D: np.ndarray  # (n, 3, 6)

    def poles(self) -> np.ndarray:
        """Poles (n, 6) of the continuous closed loop in 1/s."""
        return np.linalg.eigvals(_sequential(self, self.plant_A, self.plant_B, self.controller_A, self.controller_B))

    def step_matrices(self, step: float, order: Order) -> np.ndarray:
        """Transition matrices (n, m, m) of the sampled closed loop over one communication step (s).

        The FMUs hold their inputs over a step; in the parallel order the plant gets the torque that belongs to the
        measurements of the step before.
        """
        A, B = _zero_order_hold(self.plant_A, self.plant_B, step)
        A_c, B_c = _zero_order_hold(self.controller_A, self.controller_B, step)
        if order == "sequential":
            return _sequential(self, A, B, A_c, B_c)
        # the delayed measurement is a state: tau = C_c psi + D_c y_before
        n = len(A)
        return np.block(
            [
                [A, B @ self.controller_C, B @ self.controller_D],
                [B_c @ self.plant_C, A_c, np.zeros((n, 2, 6))],
                [self.plant_C, np.zeros((n, 6, 8))],
            ]
        )


def _sequential(loop: LinearLoop, A: np.ndarray, B: np.ndarray, A_c: np.ndarray, B_c: np.ndarray) -> np.ndarray:
    """Closed loop without delay, continuous or sampled, by what A, B, A_c, B_c are: (n, 6, 6)."""
    C = loop.plant_C
    return np.block([[A + B @ loop.controller_D @ C, B @ loop.controller_C], [B_c @ C, A_c]])


def _zero_order_hold(A: np.ndarray, B: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Discrete A and B (n, ...) for inputs held over a step (s), by the exponential of [A B; 0 0]."""
    n, states, inputs = B.shape
    augmented = np.zeros((n, states + inputs, states + inputs))
    augmented[:, :states] = np.concatenate([A, B], axis=2) * step
    transition = expm(augmented)
    return transition[:, :states, :states], transition[:, :states, states:]


def linearize_along(solution: ContinuousSolution, parameters: Parameters | None = None) -> LinearLoop:
    """Linearise plant and controller at each point of a solution of the closed loop, without mass change."""
    given = parameters or {}
    plant, controller, trajectory = (to_control(model, name, given.get(name)) for name, model in MODELS.items())
    joints = [0, 1, 2, 6, 7, 8]  # theta_a and omega_a among the plant's states
    columns: list[tuple[np.ndarray, ...]] = []
    for t, x in zip(solution.time, solution.states, strict=True):
        R = MODELS["trajectory"].outputs.unpack(trajectory.output(t, [], []))
        u_controller = np.concatenate([x[joints], R.theta_ref, R.omega_ref, R.tau_ref])
        tau_a = controller.output(t, x[12:], u_controller)[:3]
        K = control.linearize(controller, x[12:], u_controller, t=t)
        P = control.linearize(plant, x[:12], np.concatenate([tau_a, np.zeros(4)]), t=t)
        T = _free_directions(x[:12], given)
        columns.append((T.T @ P.A @ T, T.T @ P.B[:, :3], T[joints], K.A, K.B[:, :6], K.C[:3], K.D[:3, :6]))
    return LinearLoop(*(np.array(matrices) for matrices in zip(*columns, strict=True)))


def _free_directions(x: np.ndarray, given: Parameters) -> np.ndarray:
    """Orthonormal basis (12, 4) of the directions in which closed states neighbour a closed state."""
    parameters: Layout = MODELS["plant"].parameters
    l = parameters.unpack(parameter_array(parameters, given.get("plant", {}))).l
    theta, omega = x[:6], x[6:]
    A = constraint_matrix(theta, l)
    A_rate = np.imag(constraint_matrix(theta + 1e-30j * omega, l)) / 1e-30  # exact: complex step
    closure = block_diag(A, A)
    closure[4:, :6] = A_rate
    basis: np.ndarray = null_space(closure)
    return basis


def closed_loop_poles(
    parameters: Parameters | None = None, *, duration: float = _PERIOD, points: int = _POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """Poles of the continuous closed loop along its undisturbed solution.

    Parameters
    ----------
    parameters : mapping, optional
        Instance name -> parameters that differ from the start values, as {"controller": {"alpha": 2.0}}.
    duration : float
        From t = 0 to this time (s); one period of the path by default.
    points : int
        Number of equally spaced points.

    Returns
    -------
    times : array (points,)
        In s.
    poles : array (points, 6)
        In 1/s: four of the tracking errors, two of the adaptation.
    """
    times = np.linspace(0.0, duration, points)
    return times, linearize_along(solve(times, parameters=parameters, rtol=1e-6), parameters).poles()


def largest_stable_step(
    parameters: Parameters | None = None,
    *,
    order: Order = "sequential",
    duration: float = _PERIOD,
    points: int = _POINTS,
) -> float:
    """Largest communication step (s) at which the sampled closed loop is stable all along the path.

    Stable means here: at every point the eigenvalues of the transition matrix over one step lie inside the unit
    circle. The criterion is on the safe side: a loop that is unstable on a short piece of the path only recovers on the
    rest of it. With the gains of Table 1, row (1, 1), runs diverge from about 1.2 times this step on.

    Parameters
    ----------
    parameters, duration, points
        As in `closed_loop_poles`.
    order : {"sequential", "parallel"}
        Order of the co-simulation master.

    Returns
    -------
    float
        The step, to four digits; infinite where the loop stays stable up to a step of 1 s.

    Raises
    ------
    ArgumentError
        The loop is unstable even at the shortest step: there is no stable one.
    """
    times = np.linspace(0.0, duration, points)
    loop = linearize_along(solve(times, parameters=parameters, rtol=1e-6), parameters)

    def stable(step: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(loop.step_matrices(step, order))).max() < 1.0)

    steps = np.geomspace(_SHORTEST, _LONGEST, 81)
    first_unstable = next((i for i, step in enumerate(steps) if not stable(step)), None)
    if first_unstable is None:
        return float("inf")
    if first_unstable == 0:
        raise ArgumentError(
            f"the closed loop is unstable even at a step of {_SHORTEST} s; change the gains alpha, beta, S or k"
        )
    lower, upper = steps[first_unstable - 1], steps[first_unstable]
    while upper / lower > 1.0 + _ACCURACY:
        middle = np.sqrt(lower * upper)
        lower, upper = (middle, upper) if stable(middle) else (lower, middle)
    return float(lower)
