"""Stability of the closed loop along the path: continuous poles, and the largest stable communication step.

The loop is linearised at points along its own solution (frozen time). Of the plant's twelve states four are free; the
other eight describe the loop closure, whose errors decay at the Baumgarte rate whatever the controller does. They are
taken out by restricting the linearised plant to the tangent space of the closed states, which is invariant. Its bases
are turned as little as can be from point to point (parallel transport), so that the transition matrices of the points
can be multiplied.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg import block_diag, null_space, polar

from cosim.analysis import LinearComponent, LinearSystem, largest_stable_step_along
from cosim.master.coupling.algorithm import AUTO
from fmu_export.control_backend import parameter_array
from fmu_export.modelling.model import Model
from parallel_robot.continuous_loop import ContinuousSolution, controller_inputs, solve, undisturbed
from parallel_robot.models import MODELS
from parallel_robot.wiring import CONNECTIONS
from plant_fmu.kinematics import constraint_matrix

Parameters = Mapping[str, Mapping[str, Any]]

#: One period of the desired path (93) with w = 1, in s.
_PERIOD = 2.0 * np.pi

#: What the loop of plant and controller consists of; the desired path only feeds it.
_LOOP = ("plant", "controller")


def linearize_along(solution: ContinuousSolution, parameters: Parameters | None = None) -> LinearSystem:
    """Plant, on its four free states, and controller, linearised at each point of a solution without mass change.

    Parameters
    ----------
    solution : ContinuousSolution
        Of n points.
    parameters : mapping, optional
        As in `closed_loop_poles`.

    Returns
    -------
    LinearSystem
        Components "plant" and "controller" with a leading axis of n. The plant's states are coordinates in the tangent
        space.
    """
    given = parameters or {}
    p = {name: parameter_array(model.parameters, given.get(name, {})) for name, model in MODELS.items()}
    plant, controller, trajectory = (MODELS[name] for name in ("plant", "controller", "trajectory"))
    l = plant.parameters.unpack(p["plant"]).l
    linear: dict[str, list[tuple[np.ndarray, ...]]] = {name: [] for name in _LOOP}
    T = None
    for t, x in zip(solution.time, solution.states, strict=True):
        desired = trajectory.output_values(t, np.empty(0), np.empty(0), p["trajectory"])
        u_controller = controller_inputs(x, desired)
        torque = controller.outputs.unpack(controller.output_values(t, x[12:], u_controller, p["controller"])).tau_a
        u_plant = np.concatenate([torque, undisturbed(t)])
        A, B, C, D = _linearize(plant, t, x[:12], u_plant, p["plant"])
        T = _free_directions(x[:12], l, T)
        linear["plant"].append((T.T @ A @ T, T.T @ B, C @ T, D))
        linear["controller"].append(_linearize(controller, t, x[12:], u_controller, p["controller"]))
    components = {}
    for name in _LOOP:
        A, B, C, D = (np.array(matrices) for matrices in zip(*linear[name], strict=True))
        components[name] = LinearComponent(A, B, C, D, MODELS[name].inputs.names, MODELS[name].outputs.names)
    return LinearSystem(components, [c for c in CONNECTIONS if all(end.partition(".")[0] in _LOOP for end in c)])


def _linearize(model: Model, t: float, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
    """Matrices A, B, C, D of a model, exact to rounding: by complex steps (Squire and Trapp 1998)."""
    point, n = np.concatenate([x, u]), len(x)
    columns = []
    for i in range(len(point)):
        z = point.astype(complex)
        z[i] += 1e-30j
        columns.append(np.concatenate([f(t, z[:n], z[n:], p) for f in (model.derivatives, model.output_values)]).imag)
    J = np.array(columns).T / 1e-30
    return J[:n, :n], J[:n, n:], J[n:, :n], J[n:, n:]


def _free_directions(x: np.ndarray, l: float, before: np.ndarray | None) -> np.ndarray:
    """Orthonormal basis (12, 4) of the directions in which closed states neighbour a closed state.

    The basis nearest to that of the point before, where there is one.
    """
    theta, omega = x[:6], x[6:]
    A = constraint_matrix(theta, l)
    A_rate = np.imag(constraint_matrix(theta + 1e-30j * omega, l)) / 1e-30  # exact: complex step
    closure = block_diag(A, A)
    closure[4:, :6] = A_rate
    basis: np.ndarray = null_space(closure)
    return basis if before is None else basis @ polar(basis.T @ before)[0]


def closed_loop_poles(
    parameters: Parameters | None = None, *, duration: float = _PERIOD, points: int = 64
) -> tuple[np.ndarray, np.ndarray]:
    """Poles of the continuous closed loop along its undisturbed solution.

    Parameters
    ----------
    parameters : mapping, optional
        Component -> parameters that differ from the start values, as {"controller": {"alpha": 2.0}}.
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
    order: str = "sequential",
    extrapolation: str = AUTO,
    duration: float = 2.0 * _PERIOD,
    points: int = 128,
) -> float:
    """Largest communication step (s) at which the co-simulated closed loop is stable along the path.

    Stable means here: a deviation decays over the path, and grows nowhere to more than three times as much as in the
    continuous loop (`cosim.analysis.largest_stable_step_along`). Runs of `tracking-undisturbed` diverge from 1.04 to
    1.2 times this step on with the gains of Table 1, row (1, 1), and others near it. With little damping (beta of 0.8
    and less) and long steps they may diverge from 0.8 times it on: they leave the continuous solution, along which the
    loop is linearised, too far. Keep some distance.

    Parameters
    ----------
    parameters : mapping, optional
        As in `closed_loop_poles`.
    order : {"sequential", "parallel"}
        Gauss-Seidel or Jacobi, as in `cosim.Simulation`.
    extrapolation : {"auto", "hold", "linear"}
        What inputs do between communication points: zero-order hold or linear extrapolation. "auto" is analysed as
        linear, to which the default of `cosim.Simulation` falls back: the native FMUs can. Those of the pythonfmu
        flavour hold their inputs.
    duration : float
        From t = 0 to this time (s); two periods of the path by default.
    points : int
        Number of equally long pieces of the path; the loop is linearised in the middle of each.

    Returns
    -------
    float
        The step, to four digits; infinite where the loop stays stable up to a step of 1 s.

    Raises
    ------
    ArgumentError
        The loop is unstable even at a step of 0.1 ms: there is no stable one.
    """
    middles = (np.arange(points) + 0.5) * (duration / points)
    solution = solve([0.0, *middles], parameters=parameters, rtol=1e-6)
    loop = linearize_along(ContinuousSolution(solution.time[1:], solution.states[1:]), parameters)
    return largest_stable_step_along(loop, duration, order=order, extrapolation=extrapolation)
