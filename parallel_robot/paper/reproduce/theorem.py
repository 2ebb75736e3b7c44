"""Theorem 1 along the runs: whether V falls as (59) says, and whether the radii (62), (63) hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from parallel_robot.paper.reproduce.content import Condition, Controller, Runs, TheoremCheck
from parallel_robot.paper.reproduce.motion import Motion, motion

CONDITION: Condition = "disturbed"


def motions(runs: Runs) -> dict[str, Motion]:
    """The runs of the five proposed controllers, taken apart."""
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
        k/2 |psi_bar|^2 + 1/(4 alpha). (59) bounds -k |psi|^2 - k psi^T psi_bar by
        -beta lambda_3 (|psi|^2 - |psi_bar|^2), as if 2 beta lambda_3 could stand for k before the second term too,
        which may be positive; what holds, by Young's inequality, is -k/2 |psi|^2 + k/2 |psi_bar|^2.
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


def constants(
    alpha: float, beta: float, psi_bar: np.ndarray, k: float = 12.0, lambda_3: float = 1.0, lambda_M_min: float = 1.0
) -> Constants:
    """Constants of (45)-(59) for gains, psi_bar (2,), k, lambda_3 = min(S_ii, 1) and the least eigenvalue of M (29)."""
    rate, square = beta * lambda_3, float(psi_bar @ psi_bar)
    h, h_corrected = (factor * square + 1 / (4 * alpha) for factor in (rate, k / 2))
    return Constants(min(lambda_M_min, k / 2), k / 2, rate, h, h_corrected)


def check(m: Motion, controller: Controller, steady_after: float) -> TheoremCheck:
    """Hold one run against (59), (62), (63)."""
    psi_bar = m.least_psi_bar
    lambda_M_min = float(np.linalg.eigvalsh(m.M)[:, 0].min())
    c = constants(controller.alpha, m.beta, psi_bar, m.k, min(*m.S.tolist(), 1.0), lambda_M_min)
    Z = m.Z(psi_bar)
    excess = np.gradient(m.V(psi_bar), m.time, edge_order=2) + c.rate * Z**2
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
    )


def theorem_1(runs: Runs, taken_apart: dict[str, Motion]) -> tuple[TheoremCheck, ...]:
    """Theorem 1 along the runs of the five proposed controllers, with mass change and disturbance torque."""
    return tuple(check(taken_apart[c.key], c, runs.steady_after) for c in runs.proposed)
