"""The continuous closed loop by python-control: no FMU and no communication step, so an oracle for the master."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import control
import numpy as np
from scipy.integrate import solve_ivp

from cosim.errors import CosimError
from fmu_export.control_backend import parameter_array, to_control
from parallel_robot.models import MODELS
from parallel_robot.wiring import CONNECTIONS

#: Inputs of the closed loop: disturbance torque (N m), mass change (kg), and the rate of what arrives at rest (kg/s).
INPUTS = ("plant.tau_d[1]", "plant.tau_d[2]", "plant.tau_d[3]", "plant.dm", "plant.dm_rate")

#: w(t) -> (5,), the inputs of the closed loop at time t (s).
Disturbance = Callable[[float], np.ndarray]


def undisturbed(t: float) -> np.ndarray:  # noqa: ARG001
    """No disturbance torque and no mass change, (5,)."""
    return np.zeros(len(INPUTS))


def closed_loop(parameters: Mapping[str, Mapping[str, Any]] | None = None) -> control.InterconnectedSystem:
    """Plant, controller and trajectory, connected.

    Parameters
    ----------
    parameters : mapping, optional
        Instance name ("plant", "controller", "trajectory") -> parameter values that differ from the start values.

    Returns
    -------
    control.InterconnectedSystem
        States (14,): the plant's, then psi. Inputs: `INPUTS`. Outputs: all of the three parts. python-control allows
        no dots in these names: they read `plant_dm`, `plant_x_E` and so on.
    """
    given = parameters or {}
    parts = [to_control(model, name, given.get(name)) for name, model in MODELS.items()]
    connections = [[target, source] for s, t in CONNECTIONS for source, target in _elements(s, t)]
    outputs = [f"{part.name}.{output}" for part in parts for output in part.output_labels]
    return control.interconnect(
        parts,
        connections=connections,
        inplist=list(INPUTS),
        inputs=[_label(name) for name in INPUTS],
        outlist=outputs,
        outputs=[_label(name) for name in outputs],
        check_unused=False,
        name="closed_loop",
    )


def _label(path: str) -> str:
    return path.replace(".", "_")


def _elements(source: str, target: str) -> list[tuple[str, str]]:
    return [(f"{source}[{i}]", f"{target}[{i}]") for i in (1, 2, 3)]


def initial_state(parameters: Mapping[str, Mapping[str, Any]] | None = None) -> np.ndarray:
    """State (14,) of the closed loop at t = 0."""
    given = parameters or {}
    return np.concatenate(
        [model.initial_state(parameter_array(model.parameters, given.get(n, {}))) for n, model in MODELS.items()]
    )


def closed_loop_dynamics(
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
) -> Callable[[float, np.ndarray, np.ndarray], np.ndarray]:
    """f(t, x, w) -> x', that of `closed_loop` to the last bit, in a fifth of the time.

    The models are called one after the other, without python-control's search for the order in which to do so.

    Parameters
    ----------
    parameters : mapping, optional
        As in `closed_loop`.

    Returns
    -------
    callable
        Of the time (s), the state (14,) and the inputs (5,), see `INPUTS`; gives the rate (14,) of the state.
    """
    given = parameters or {}
    p = {name: parameter_array(model.parameters, given.get(name, {})) for name, model in MODELS.items()}
    plant, controller, trajectory = (MODELS[name] for name in ("plant", "controller", "trajectory"))
    none = np.empty(0)

    def dynamics(t: float, x: np.ndarray, w: np.ndarray) -> np.ndarray:
        u_controller = controller_inputs(x, trajectory.output_values(t, none, none, p["trajectory"]))
        tau_a = controller.output_values(t, x[12:], u_controller, p["controller"])[:3]
        u_plant = np.concatenate([tau_a, w])
        return np.concatenate(
            [
                plant.derivatives(t, x[:12], u_plant, p["plant"]),
                controller.derivatives(t, x[12:], u_controller, p["controller"]),
            ]
        )

    return dynamics


def controller_inputs(x: np.ndarray, desired: np.ndarray) -> np.ndarray:
    """Inputs of the controller, from the state (14,) of the closed loop and the outputs of the trajectory."""
    R = MODELS["trajectory"].outputs.unpack(desired)
    return np.concatenate([x[:3], x[6:9], R.theta_ref, R.omega_ref, R.tau_ref])


@dataclass(frozen=True)
class ContinuousSolution:
    """Solution of the continuous closed loop: time (n,) s, states (n, 14)."""

    time: np.ndarray
    states: np.ndarray


def solve(
    times: Sequence[float] | np.ndarray,
    disturbance: Disturbance = undisturbed,
    *,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    breakpoints: Sequence[float] = (),
    rtol: float = 1e-9,
) -> ContinuousSolution:
    """Integrate the continuous closed loop by DOP853.

    Parameters
    ----------
    times : array (n,)
        Where the solution is wanted (s), increasing; the first is the start.
    disturbance : callable
        w(t) -> (5,), see `INPUTS`.
    parameters : mapping, optional
        As in `closed_loop`.
    breakpoints : sequence of float
        Times (s) at which the disturbance jumps or has a kink; the integrator starts anew there.
    rtol : float
        Relative tolerance; the absolute one is a hundredth of it.

    Raises
    ------
    RuntimeError
        The integration fails: the closed loop diverges.
    """
    dynamics = closed_loop_dynamics(parameters)
    times = np.asarray(times, dtype=float)
    x = initial_state(parameters)
    inside = [b for b in sorted(breakpoints) if times[0] < b < times[-1]]
    edges = [times[0], *inside, times[-1]]
    states = np.empty((len(times), len(x)))
    states[0] = x
    for begin, end in pairwise(edges):
        before_end = np.nextafter(end, begin)  # at a jump, the piece before it needs the limit from the left

        def rate(t: float, state: np.ndarray, latest: float = before_end) -> np.ndarray:
            derivative: np.ndarray = dynamics(t, state, disturbance(min(t, latest)))
            return derivative

        wanted = (times > begin) & (times <= end)
        t_eval = np.unique(np.append(times[wanted], end))
        solution = solve_ivp(rate, (begin, end), x, method="DOP853", rtol=rtol, atol=rtol / 100, t_eval=t_eval)
        if not solution.success:
            raise CosimError(f"the closed loop can't be integrated beyond t = {solution.t[-1]:.6g} s")
        states[wanted] = solution.y.T[np.isin(solution.t, times[wanted])]
        x = solution.y[:, -1]
    return ContinuousSolution(times, states)
