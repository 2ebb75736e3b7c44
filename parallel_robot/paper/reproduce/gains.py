"""Measures and errata of the performance index and its optimal gains, section 5 of the paper and Table 1."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize

from controller_fmu.model import PARAMETERS as CONTROLLER
from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains
from parallel_robot.paper.reproduce.content import Erratum, Measured
from parallel_robot.paper.reproduce.material import Material, measure
from parallel_robot.paper.reproduce.proof import PSI_BAR
from parallel_robot.paper.reproduce.table import PRINTED
from parallel_robot.paper.reproduce.theorem import constants
from parallel_robot.start import lyapunov_start_constants

#: Further weights, beside those of Table 1, for what the paper says of J in general; the last with a large V0.
OTHER_INDICES = {
    "mu = 0.1, nu = 1": PerformanceIndex(0.1, 1.0),
    "mu = 0.01, nu = 0.01": PerformanceIndex(0.01, 0.01),
    "mu = 0.001, nu = 0.001": PerformanceIndex(0.001, 0.001),
    "mu = nu = 0.01, V0 = 3 + 0.043 beta": PerformanceIndex(0.01, 0.01, s_a=3.0),
}


@measure
def table_agreement(material: Material) -> Measured:
    """1 for each row of Table 1 whose three numbers come to the printed digits, else 0."""
    return Measured({f"({r.mu:g}, {r.nu:g})": float(r.agrees) for r in material.table1})


@measure
def gains_rise(material: Material) -> Measured:
    """Alpha and beta of each mu/nu over those of the next smaller one."""
    values = {}
    for low, high in pairwise(material.runs.proposed):
        values[f"alpha, {low.key} to {high.key}"] = high.alpha / low.alpha
        values[f"beta, {low.key} to {high.key}"] = high.beta / low.beta
    return Measured(values)


@measure
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


@measure
def uniqueness(material: Material) -> Measured:
    """Convexity margin of J in (1/(alpha beta), beta): positive proves that no second stationary point exists."""
    indices = _indices(material) | OTHER_INDICES
    return Measured({label: optimal_gains(index).convexity_margin for label, index in indices.items()})


@measure
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


@measure
def concavity(material: Material) -> Measured:
    """Share of alpha, beta in 0.05 to 50 at which J is concave: both eigenvalues of its Hessian at most 0."""
    alpha, beta = _grid()
    values = {}
    for label, index in _indices(material).items():
        eigenvalues = np.linalg.eigvalsh(np.moveaxis(index.hessian(alpha, beta), (0, 1), (-2, -1)))
        values[label] = float((eigenvalues[..., 1] <= 0.0).mean())
    return Measured(values, note="J is convex at all these points, so that its stationary point is a minimum")


@measure
def gradient(material: Material) -> Measured:
    """Gradient of J at the computed optimum, over the sizes of the terms it is summed from."""
    values = {label: optimal_gains(index).relative_gradient for label, index in _indices(material).items()}
    return Measured(values)


@measure
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


@measure
def adaptation_constant(material: Material) -> Measured:
    """K over 2 beta max(S_ii), which the proof asks for before (59)."""
    p = CONTROLLER.unpack(CONTROLLER.starts)
    return Measured({f"mu/nu = {c.key}": float(p.k / (2 * c.beta * p.S.max())) for c in material.runs.proposed})


@measure
def control_cost(material: Material) -> Measured:
    """Integral of |tau_a|^2 of each controller over that of the next smaller mu/nu."""
    effort = {}
    for c in material.runs.proposed:
        r = material.runs.closed_loop[c.key, "disturbed"]
        effort[c.key] = float(np.trapezoid((r["controller.tau_a"] ** 2).sum(axis=1), r.time))
    keys = list(effort)
    return Measured({f"mu/nu {low} to {high}": effort[high] / effort[low] for low, high in pairwise(keys)})


def start_constants(material: Material) -> Erratum:  # noqa: ARG001
    """V0 = 0.803 + 0.043 beta."""
    p = CONTROLLER.unpack(CONTROLLER.starts)
    s_a, s_b = lyapunov_start_constants(p.S)
    printed = PerformanceIndex()
    with_psi = s_a + float(p.k) / 2 * float(PSI_BAR @ PSI_BAR)
    own, own_psi = (optimal_gains(PerformanceIndex(s_a=a, s_b=s_b)) for a in (s_a, with_psi))
    return Erratum(
        "start-constants",
        "(81), V0 = 0.803 + 0.043 beta",
        "s_a = 0.803, s_b = theta_e^T S theta_e = 0.043",
        f"s_b = {s_b:.4f}, a tenth; s_a = {s_a:.4f} for the tracking part of V alone, {with_psi:.3f} with k/2 |psi - "
        f"psi_bar|^2 at psi = 0, psi_bar = (0.25, 0.25)",
        "V of (42) is computed at the start of the runs, whose errors are those of Figs. 8-12, and the optimal "
        "gains for "
        "(1, 1) are computed with it.",
        {
            "s_a printed": printed.s_a,
            "s_a, tracking part": s_a,
            "s_a with the part of psi": with_psi,
            "s_b printed": printed.s_b,
            "s_b": s_b,
            "alpha, tracking part only": own.alpha,
            "beta, tracking part only": own.beta,
            "alpha with the part of psi": own_psi.alpha,
            "beta with the part of psi": own_psi.beta,
        },
        s_b < 0.2 * printed.s_b,
    )


def factored_derivative(material: Material) -> Erratum:
    """3 rho_3 in (83)."""
    c = material.runs.controller("1")
    index, a, b = PerformanceIndex(c.mu, c.nu), c.alpha, c.beta
    r = index.rho

    def factored(multiple: float) -> float:
        """Last line of (83) with that multiple of rho_3 alpha beta."""
        bracket = 2 * r[7] * a**2 * b**5 + r[6] * a**2 * b**4 - r[5] * a**2 * b**2 - r[4] * a * b**2
        return float((bracket - multiple * r[3] * a * b - 2 * r[2] * b - 3 * r[1]) / (a**2 * b**4))

    step = 1e-6
    slope = float((index(a, b + step) - index(a, b - step)) / (2 * step))
    return Erratum(
        "factored-derivative",
        "(83), last line",
        "3 rho_3 alpha beta",
        "2 rho_3 alpha beta",
        "A central difference gives dJ/dbeta at the optimum of (1, 1); the factored form is computed with "
        "either multiple.",
        {"central difference": slope, "as printed": factored(3.0), "with 2": factored(2.0)},
        abs(factored(2.0) - slope) < 1e-6 < 0.01 < abs(factored(3.0) - slope),
    )


def positive_hessian(material: Material) -> Erratum:  # noqa: ARG001
    """(85) for any alpha and beta."""
    index = PerformanceIndex(0.001, 0.001)
    values = np.geomspace(0.05, 50.0, 121)
    alpha, beta = np.meshgrid(values, values)
    (aa, ab), (_, bb) = index.hessian(alpha, beta)
    C = aa * bb - ab**2
    where = np.unravel_index(np.argmin(C / (np.abs(aa * bb) + ab**2)), C.shape)
    gains = optimal_gains(index)
    return Erratum(
        "positive-hessian",
        "(85), Remark 10",
        "A > 0, B > 0, C > 0 for any alpha and beta, hence one minimum",
        "true for rho_1 ... rho_5 >= 0, so for all rows of Table 1; false for small mu and nu. That there is one "
        "minimum holds all the same: J is convex in (1/(alpha beta), beta)",
        "The determinant C of (85) is computed for mu = nu = 0.001 where it is most negative in relation to its terms; "
        "the convexity margin of the same J is computed too.",
        {
            "rho_4": float(index.rho[4]),
            "at alpha": float(alpha[where]),
            "at beta": float(beta[where]),
            "C": float(C[where]),
            "A": float(aa[where]),
            "B": float(bb[where]),
            "convexity margin": gains.convexity_margin,
        },
        bool(C[where] < 0.0 < gains.convexity_margin),
    )


def concave(material: Material) -> Erratum:
    """Convex is meant."""
    values = {}
    for c in material.runs.proposed:
        gains = optimal_gains(PerformanceIndex(c.mu, c.nu))
        values[f"least eigenvalue of the Hessian, ({c.mu:g}, {c.nu:g})"] = gains.hessian_eigenvalues[0]
    return Erratum(
        "concave",
        "Remark 10; after Fig. 6",
        "J is a global concave function",
        "J is convex, which is what its positive second derivatives say",
        "The eigenvalues of the Hessian of J are computed at the optima of Table 1.",
        values,
        min(values.values()) > 0.0,
    )


def printed_rho_4(material: Material) -> Erratum:  # noqa: ARG001
    """0.29735 in (92)."""
    factor = 2.0 * PerformanceIndex().D2
    return Erratum(
        "printed-rho-4",
        "(92)",
        "rho_4 = 9 (0.29735 mu - 0.043)",
        f"rho_4 = 9 ({factor:.5f} mu - 0.043)",
        "2 lambda_3 D[|psi|^2] of (81) is computed with the membership (91).",
        {"2 lambda_3 D[|psi|^2]": factor},
        f"{factor:.5f}" == "0.29736",
    )


def centre_of_gravity(material: Material) -> Erratum:  # noqa: ARG001
    """Remark 9."""
    v = np.linspace(0.0, 0.5, 100_001)
    weights = np.sin(2 * np.pi * v)
    of_one, of_delta = (float(np.trapezoid(f * weights, v) / np.trapezoid(weights, v)) for f in (np.ones_like(v), v))
    return Erratum(
        "centre-of-gravity",
        "Remark 9",
        "the D-operation with zeta(delta) = 1 is the centre-of-gravity defuzzification",
        "with zeta(delta) = delta; D[1] is 1 for every fuzzy set",
        "(77) is computed for the fuzzy set (91).",
        {"D[1]": of_one, "D[delta]": of_delta},
        abs(of_one - 1.0) < 1e-9 and abs(of_delta - 0.25) < 1e-6,
    )


def cut_alpha(material: Material) -> Erratum:
    """The first alpha of Table 1."""
    row = next(r for r in material.table1 if (r.mu, r.nu) == PRINTED[0][:2])
    return Erratum(
        "cut-alpha",
        "Table 1, row (1, 1)",
        f"alpha = {row.printed_alpha}",
        f"alpha = {row.alpha:.4f}: it was cut, the other numbers are rounded",
        "The optimum is computed to more digits.",
        {"alpha": row.alpha, "printed": float(row.printed_alpha)},
        row.agrees and f"{row.alpha:.4f}" != row.printed_alpha,
    )


def corrected_index(material: Material) -> Erratum:
    """The optimum with the corrected h."""
    c = material.runs.controller("1")
    index = PerformanceIndex(c.mu, c.nu)

    def J(log_gains: np.ndarray) -> float:
        """(78) with h of `theorem.Constants.h_corrected`; eta_inf = k h/(2 lambda_3 beta) is u |psi_bar|^2 + v."""
        alpha, beta = np.exp(log_gains)
        if index.lambda_3 * beta >= index.k:
            return math.inf
        v0, ratio = index.s_a + index.s_b * beta, index.k / (2 * index.lambda_3 * beta)
        u, v = ratio * index.k**2 / (4 * (index.k - index.lambda_3 * beta)), ratio / (4 * alpha)
        transient = (v0 - v) ** 2 - 2 * u * (v0 - v) * index.D2 + u**2 * index.D4
        steady = u**2 * index.D4 + 2 * u * v * index.D2 + v**2
        return float(transient * ratio / 2 + index.mu * steady + index.nu * (alpha**2 + beta**2))

    found = minimize(J, np.log([c.alpha, c.beta]), method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12})
    alpha, beta = np.exp(found.x)
    return Erratum(
        "corrected-index",
        "(75)-(82), Table 1",
        f"optimal gains {c.alpha:.4f} and {c.beta:.4f} for (1, 1)",
        f"{alpha:.4f} and {beta:.4f}, if J used the bound that the proof supports",
        'J of (78) is minimised with the h of the erratum "lyapunov-rate"; k has to reach 2 beta max(S_ii).',
        {
            "alpha": float(alpha),
            "beta (N m s/rad)": float(beta),
            "J": float(found.fun),
            "k": index.k,
            "2 beta max(S_ii)": 2 * float(beta) * float(CONTROLLER.unpack(CONTROLLER.starts).S.max()),
        },
        bool(abs(beta - c.beta) > 0.01),
    )
