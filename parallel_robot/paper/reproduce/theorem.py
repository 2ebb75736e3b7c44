"""Theorem 1 along the runs: the variables of its proof, the fall of V (59) and the radii (62), (63).

The variables follow from recorded outputs of the FMUs and from M of (27); rates are central differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller_fmu.model import PARAMETERS as CONTROLLER
from cosim.results.results import Results
from parallel_robot.paper.reproduce.content import Condition, Controller, Runs, TheoremCheck
from plant_fmu import model as plant
from plant_fmu.dynamics import mass_matrix, uncertain_inertia
from plant_fmu.model import PARAMETERS as PLANT
from plant_fmu.reduced import passive_velocity_map
from trajectory_fmu import model as trajectory

#: Every so many-th communication point is looked at: rates to about 0.3 % at the disturbance's highest frequency.
EVERY = 2


#: Every so many-th of these points is drawn.
_DRAWN = 50

#: Far larger beta (N m s/rad) than those of Table 1.
STIFF = (100.0, 400.0)


@dataclass(frozen=True)
class Motion:
    """A run in the variables of section 4; n points.

    Attributes
    ----------
    time : array (n,)
        In s.
    M : array (n, 3, 3)
        Mass matrix (27) with the mass change (kg m^2).
    error, rate : array (n, 3)
        theta_e (rad) and theta_e' (rad/s), (32).
    s : array (n, 3)
        theta_e' + S theta_e (rad/s).
    psi : array (n, 2)
        The estimate of (37).
    regressor : array (n, 2)
        |theta_a|^2 and |theta_a'|^2 of (89).
    g : array (n, 3)
        Total uncertainty (33) with the disturbance torque in it (N m): what M s' + M' s / 2 is besides tau_a.
    beta, k : float
    S : array (3,)
    """

    time: np.ndarray
    M: np.ndarray
    error: np.ndarray
    rate: np.ndarray
    s: np.ndarray
    psi: np.ndarray
    regressor: np.ndarray
    g: np.ndarray
    beta: float
    k: float
    S: np.ndarray

    @property
    def tracking_part(self) -> np.ndarray:
        """V_theta_e of (42), (n,)."""
        kinetic = 0.5 * np.einsum("ni,nij,nj->n", self.s, self.M, self.s)
        V: np.ndarray = kinetic + self.beta * (self.error**2 @ self.S)
        return V

    def V(self, psi_bar: np.ndarray) -> np.ndarray:
        """V of (40), (42), (n,), for a parameter psi_bar (2,) of the bound."""
        V: np.ndarray = self.tracking_part + 0.5 * self.k * ((self.psi - psi_bar) ** 2).sum(axis=1)
        return V

    def Z(self, psi_bar: np.ndarray) -> np.ndarray:
        """|Z| (n,), with Z = [theta_e; theta_e'; psi - psi_bar]."""
        parts = np.column_stack([self.error, self.rate, self.psi - psi_bar])
        norms: np.ndarray = np.linalg.norm(parts, axis=1)
        return norms

    @property
    def least_psi_bar(self) -> np.ndarray:
        """The least psi_bar (2,) with equal components for which (35), psi_bar^T regressor >= |g|, holds on the run."""
        needed = np.linalg.norm(self.g, axis=1) / self.regressor.sum(axis=1)
        return np.full(2, needed.max())


def reduced_mass(theta: np.ndarray, X: float, Y: float, Z: float, l: float) -> np.ndarray:
    """M of (27), (3, 3), at joint angles theta (6,); it doesn't depend on velocities."""
    N, _ = passive_velocity_map(theta, np.zeros(6), l)
    P = np.concatenate([np.eye(3), N])
    M: np.ndarray = P.T @ mass_matrix(theta, X, Y, Z) @ P
    return M


def motion(results: Results, controller: Controller) -> Motion:
    """Variables of Theorem 1 along a closed-loop run."""
    r = results.thinned(EVERY)
    p, c = PLANT.unpack(PLANT.starts), CONTROLLER.unpack(CONTROLLER.starts)
    theta = np.column_stack([r["plant.theta_a"], r["plant.theta_b"]])
    inertia = uncertain_inertia(p.X, p.Y, p.Z, r["plant.dm"], p.l, p.r_a, p.Z / (p.m_b * p.l))
    M = np.array([reduced_mass(angles, X, Y, Z, p.l) for angles, X, Y, Z in zip(theta, *inertia, strict=True)])
    error = r["plant.theta_a"] - r["trajectory.theta_ref"]
    rate = r["plant.omega_a"] - r["trajectory.omega_ref"]
    s = rate + c.S * error
    s_rate, M_rate = (np.gradient(values, r.time, axis=0, edge_order=2) for values in (s, M))
    g = np.einsum("nij,nj->ni", M, s_rate) + 0.5 * np.einsum("nij,nj->ni", M_rate, s) - r["controller.tau_a"]
    regressor = np.column_stack([(r["plant.theta_a"] ** 2).sum(axis=1), (r["plant.omega_a"] ** 2).sum(axis=1)])
    return Motion(r.time, M, error, rate, s, r["controller.psi"], regressor, g, controller.beta, float(c.k), c.S)


def needed_bound(results: Results, until: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) in s and the least p for which psi_bar = (p, p) meets (35) at each, over the begin of a run.

    As `Motion.least_psi_bar`, but with the accelerations that the model computes in place of differences of recorded
    velocities: gains of hundreds leave no time for these at the start.
    """
    r = results
    rows = np.flatnonzero(r.time <= until)[::5]
    needed = [
        _needed(
            float(r.time[i]),
            np.concatenate([r[f"plant.{name}"][i] for name in ("theta_a", "theta_b", "omega_a", "omega_b")]),
            r["controller.tau_a"][i],
            r["plant.tau_d"][i],
            r["plant.dm"][i],
        )
        for i in rows
    ]
    return r.time[rows], np.array(needed)


def needed_at_start(beta: float) -> float:
    """The same at the start of a run, where psi = 0 leaves the PD part of (38): no run is needed."""
    x = plant.initial_state(PLANT.starts)
    theta_ref, omega_ref = _desired(0.0)
    s = x[6:9] - omega_ref + CONTROLLER.unpack(CONTROLLER.starts).S * (x[:3] - theta_ref)
    return _needed(0.0, x, -beta * s, np.zeros(3), 0.0)


def _needed(t: float, x: np.ndarray, tau_a: np.ndarray, tau_d: np.ndarray, dm: float) -> float:
    """|g| of (33) over the regressor of (89), in a state x (12,) of the plant under torques (3,) and a mass change."""
    p, c, step = PLANT.unpack(PLANT.starts), CONTROLLER.unpack(CONTROLLER.starts), 1e-6
    theta, omega = x[:6], x[6:]
    u = plant.INPUTS.pack(tau_a=tau_a, tau_d=tau_d, dm=dm, dm_rate=0.0)
    acceleration = plant.derivatives(0.0, x, u, PLANT.starts)[6:9]
    inertia = uncertain_inertia(p.X, p.Y, p.Z, dm, p.l, p.r_a, p.Z / (p.m_b * p.l))
    M = reduced_mass(theta, *inertia, p.l)
    ahead, behind = (reduced_mass(theta + d * omega, *inertia, p.l) for d in (step, -step))
    theta_ref, omega_ref = _desired(t)
    desired_acceleration = (_desired(t + 1e-5)[1] - _desired(t - 1e-5)[1]) / 2e-5
    rate = omega[:3] - omega_ref
    s, s_rate = rate + c.S * (theta[:3] - theta_ref), acceleration - desired_acceleration + c.S * rate
    g = M @ s_rate + 0.5 * ((ahead - behind) / (2.0 * step)) @ s - tau_a
    return float(np.linalg.norm(g) / (theta[:3] @ theta[:3] + omega[:3] @ omega[:3]))


def _desired(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Desired angles and velocities (3,) of the active joints."""
    none = np.empty(0)
    R = trajectory.OUTPUTS.unpack(trajectory.output_values(t, none, none, trajectory.PARAMETERS.starts))
    return R.theta_ref, R.omega_ref


CONDITION: Condition = "disturbed"


def motions(runs: Runs) -> dict[str, Motion]:
    """Variables of Theorem 1 along the runs of the proposed controllers, by key."""
    return {c.key: motion(runs.closed_loop[c.key, CONDITION], c) for c in runs.proposed}


@dataclass(frozen=True)
class Constants:
    """Constants of the proof as printed, and the one that its last step supports.

    Attributes
    ----------
    lambda_1, lambda_2 : float
        Of (45) and (49): lambda_1 |Z|^2 <= V <= lambda_2 |Z|^2.
    rate : float
        lambda of (59), beta lambda_3.
    h : float
        h of (59), beta lambda_3 |psi_bar|^2 + 1/(4 alpha).
    h_corrected : float
        k^2/(4 (k - beta lambda_3)) |psi_bar|^2 + 1/(4 alpha). (59) bounds -k |psi|^2 - k psi^T psi_bar by
        -beta lambda_3 (|psi|^2 - |psi_bar|^2), as if 2 beta lambda_3 could stand for k before the second term too,
        which may be positive. With beta lambda_3 |psi|^2 set aside, -(k - beta lambda_3) |psi|^2 - k psi^T psi_bar is
        at most this, and is it for psi = -k/(2 (k - beta lambda_3)) psi_bar. It takes k > beta lambda_3.
    """

    lambda_1: float
    lambda_2: float
    rate: float
    h: float
    h_corrected: float

    @property
    def Gamma(self) -> float:
        """Radius (62)."""
        return float(np.sqrt(self.h / self.rate))

    @property
    def stretch(self) -> float:
        """sqrt(lambda_2/lambda_1) of (63)."""
        return float(np.sqrt(self.lambda_2 / self.lambda_1))

    def time_to(self, radius: float, start: float) -> float:
        """T of (64) in s: after it |Z| stays below a radius larger than chi_min, from |Z(0)| = start."""
        inner = radius / self.stretch
        if start <= inner:
            return 0.0
        return (self.lambda_2 * start**2 - self.lambda_1 * self.Gamma**2) / (self.rate * inner**2 - self.h)

    def envelope(self, time: np.ndarray, V_start: float, *, corrected: bool = False) -> np.ndarray:
        """Right side of (74) at times (n,) in s, for V(0), with h as printed or corrected: (n,)."""
        decay = self.rate / self.lambda_2  # 2 lambda_3 beta / k
        end = (self.h_corrected if corrected else self.h) / decay
        values: np.ndarray = (V_start - end) * np.exp(-decay * time) + end
        return values


def constants(
    alpha: float, beta: float, psi_bar: np.ndarray, k: float = 12.0, lambda_3: float = 1.0, lambda_M_min: float = 1.0
) -> Constants:
    """Constants of (45)-(59) for gains, psi_bar (2,), k, lambda_3 = min(S_ii, 1) and the least eigenvalue of M (29)."""
    rate, square = beta * lambda_3, float(psi_bar @ psi_bar)
    h, h_corrected = (factor * square + 1 / (4 * alpha) for factor in (rate, k**2 / (4 * (k - rate))))
    return Constants(min(lambda_M_min, k / 2), k / 2, rate, h, h_corrected)


def check(m: Motion, controller: Controller, steady_after: float) -> TheoremCheck:
    """Compare one run with (59), (62), (63)."""
    psi_bar = m.least_psi_bar
    lambda_M_min = float(np.linalg.eigvalsh(m.M)[:, 0].min())
    c = constants(controller.alpha, m.beta, psi_bar, m.k, min(*m.S.tolist(), 1.0), lambda_M_min)
    Z = m.Z(psi_bar)
    V = m.V(psi_bar)
    printed, corrected = (c.envelope(m.time, float(V[0]), corrected=which) for which in (False, True))
    curves = {"time": m.time, "V": V, "printed": printed, "corrected": corrected}
    below = np.less(Z, 2.0 * c.Gamma * c.stretch)
    excess = np.gradient(V, m.time, edge_order=2) + c.rate * Z**2
    return TheoremCheck(
        controller=controller.key,
        condition=CONDITION,
        psi_bar=(float(psi_bar[0]), float(psi_bar[1])),
        lambda_hat=c.rate,
        h_printed=c.h,
        h_corrected=c.h_corrected,
        excess_printed=float((excess - c.h).max()),
        excess_corrected=float((excess - c.h_corrected).max()),
        share_violated=float((excess > c.h).mean()),
        Z_start=float(Z[0]),
        Z_max=float(Z.max()),
        Z_steady=float(Z[m.time >= steady_after].max()),
        Gamma=c.Gamma,
        chi_min=c.Gamma * c.stretch,
        d_chi=max(float(Z[0]), c.Gamma) * c.stretch,
        T_chi=c.time_to(2.0 * c.Gamma * c.stretch, float(Z[0])),
        below_from=0.0 if below.all() else float(m.time[np.flatnonzero(~below)[-1]]),
        envelope_printed=float((V / printed).max()),
        envelope_corrected=float((V / corrected).max()),
        V_curves={name: tuple(map(float, curve[::_DRAWN])) for name, curve in curves.items()},
    )


def theorem_1(runs: Runs, taken_apart: dict[str, Motion]) -> tuple[TheoremCheck, ...]:
    """Theorem 1 along the runs of the five proposed controllers, with mass change and disturbance torque."""
    return tuple(check(taken_apart[c.key], c, runs.steady_after) for c in runs.proposed)
