"""Measures of the performance index and of the gains that minimise it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from controller_fmu.model import PARAMETERS as CONTROLLER
from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains
from parallel_robot.paper.reproduce.content import Measured
from parallel_robot.paper.reproduce.material import Material
from parallel_robot.paper.reproduce.theorem import constants

#: Further weights, beside those of Table 1, for what the paper says of J in general; the last with a large V0.
OTHER_INDICES = {
    "mu = 0.1, nu = 1": PerformanceIndex(0.1, 1.0),
    "mu = 0.01, nu = 0.01": PerformanceIndex(0.01, 0.01),
    "mu = 0.001, nu = 0.001": PerformanceIndex(0.001, 0.001),
    "mu = nu = 0.01, V0 = 3 + 0.043 beta": PerformanceIndex(0.01, 0.01, s_a=3.0),
}


def table_agreement(material: Material) -> Measured:
    """1 for each row of Table 1 whose three numbers come to the printed digits, else 0."""
    return Measured({f"({r.mu:g}, {r.nu:g})": float(r.agrees) for r in material.table1})


def gains_rise(material: Material) -> Measured:
    """Alpha and beta of each mu/nu over those of the next smaller one."""
    values = {}
    for low, high in pairwise(material.runs.proposed):
        values[f"alpha, {low.key} to {high.key}"] = high.alpha / low.alpha
        values[f"beta, {low.key} to {high.key}"] = high.beta / low.beta
    return Measured(values)


def gains_by_ratio_alone(material: Material) -> Measured:
    """Alpha for (10 mu, 10 nu) over alpha for (mu, nu): 1 if the ratio were all that counts."""
    values = {}
    for c in material.runs.proposed:
        scaled = optimal_gains(PerformanceIndex(10 * c.mu, 10 * c.nu))
        values[f"mu/nu = {c.key}"] = abs(scaled.alpha / c.alpha - 1.0)
    return Measured(values, note="change of alpha when mu and nu both grow tenfold, which leaves mu/nu as it is")


def _grid() -> tuple[np.ndarray, np.ndarray]:
    values = np.geomspace(0.05, 50.0, 121)
    alpha, beta = np.meshgrid(values, values)
    return alpha, beta


def _indices(material: Material) -> dict[str, PerformanceIndex]:
    return {f"mu = {c.mu:g}, nu = {c.nu:g}": PerformanceIndex(c.mu, c.nu) for c in material.runs.proposed}


def uniqueness(material: Material) -> Measured:
    """Convexity margin of J in (1/(alpha beta), beta): positive proves that no second stationary point exists."""
    indices = _indices(material) | OTHER_INDICES
    return Measured({label: optimal_gains(index).convexity_margin for label, index in indices.items()})


def hessian(material: Material) -> Measured:
    """(85): the least of sign A, sign B and C/|A B| over alpha, beta in 0.05 to 50."""
    alpha, beta = _grid()
    values = {}
    for label, index in (_indices(material) | OTHER_INDICES).items():
        (aa, ab), (_, bb) = index.hessian(alpha, beta)
        values[label] = float(
            min((aa / np.abs(aa)).min(), (bb / np.abs(bb)).min(), (1 - ab**2 / np.abs(aa * bb)).min())
        )
    return Measured(values, note="the last three are indices with small weights, or with a large initial error")


def concavity(material: Material) -> Measured:
    """Share of alpha, beta in 0.05 to 50 at which J is concave: both eigenvalues of its Hessian at most 0."""
    alpha, beta = _grid()
    values = {}
    for label, index in _indices(material).items():
        eigenvalues = np.linalg.eigvalsh(np.moveaxis(index.hessian(alpha, beta), (0, 1), (-2, -1)))
        values[label] = float((eigenvalues[..., 1] <= 0.0).mean())
    return Measured(values, note="J is convex at all these points, so that its stationary point is a minimum")


def gradient(material: Material) -> Measured:
    """Gradient of J at the computed optimum, over the sizes of the terms it is summed from."""
    values = {label: optimal_gains(index).relative_gradient for label, index in _indices(material).items()}
    return Measured(values)


def ultimate_radius(material: Material) -> Measured:
    """Gamma of (62) of each controller over that of the next smaller mu/nu, whose alpha and beta are both smaller."""
    psi_bar = np.array([0.25, 0.25])
    Gamma = {c.key: constants(c.alpha, c.beta, psi_bar).Gamma for c in material.runs.proposed}
    return Measured(
        {
            f"mu/nu {low.key} to {high.key}": Gamma[high.key] / Gamma[low.key]
            for low, high in pairwise(material.runs.proposed)
        },
        note=f"it doesn't fall below |psi_bar| = {np.linalg.norm(psi_bar):.3g} however large the gains",
    )


def adaptation_constant(material: Material) -> Measured:
    """K over 2 beta max(S_ii), what the proof asks for before (59)."""
    p = CONTROLLER.unpack(CONTROLLER.starts)
    return Measured({f"mu/nu = {c.key}": float(p.k / (2 * c.beta * p.S.max())) for c in material.runs.proposed})


def control_cost(material: Material) -> Measured:
    """Integral of |tau_a|^2 of each controller over that of the next smaller mu/nu."""
    effort = {}
    for c in material.runs.proposed:
        r = material.runs.closed_loop[c.key, "disturbed"]
        effort[c.key] = float(np.trapezoid((r["controller.tau_a"] ** 2).sum(axis=1), r.time))
    keys = list(effort)
    return Measured({f"mu/nu {low} to {high}": effort[high] / effort[low] for low, high in pairwise(keys)})
