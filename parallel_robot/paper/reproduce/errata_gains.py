"""Errata of section 5: the performance index and its optimum."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from controller_fmu.model import PARAMETERS as CONTROLLER
from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains
from parallel_robot.paper.reproduce.content import Erratum
from parallel_robot.paper.reproduce.errata_proof import PSI_BAR
from parallel_robot.paper.reproduce.material import Material
from parallel_robot.paper.reproduce.table import PRINTED
from parallel_robot.start import lyapunov_start_constants


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
        "V of (42) at the start of the runs, whose errors are those of Figs. 8-12; and the optimal gains for (1, 1) "
        "with it.",
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
        "dJ/dbeta at the optimum of (1, 1) by a central difference, and by the factored form with either multiple.",
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
        "The determinant C of (85) for mu = nu = 0.001 where it is most negative beside its terms; convexity margin "
        "of that J.",
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
        "Eigenvalues of the Hessian of J at the optima of Table 1.",
        values,
        min(values.values()) > 0.0,
    )


def cut_alpha(material: Material) -> Erratum:
    """The first alpha of Table 1."""
    row = next(r for r in material.table1 if (r.mu, r.nu) == PRINTED[0][:2])
    return Erratum(
        "cut-alpha",
        "Table 1, row (1, 1)",
        f"alpha = {row.printed_alpha}",
        f"alpha = {row.alpha:.4f}: it was cut, the other numbers are rounded",
        "The optimum to more digits.",
        {"alpha": row.alpha, "printed": float(row.printed_alpha)},
        row.agrees and f"{row.alpha:.4f}" != row.printed_alpha,
    )


def corrected_index(material: Material) -> Erratum:
    """What the optimum would be with the corrected h."""
    c = material.runs.controller("1")
    index = PerformanceIndex(c.mu, c.nu)

    def J(log_gains: np.ndarray) -> float:
        """(78) with h = k/2 |psi_bar|^2 + 1/(4 alpha); eta_inf = k h/(2 lambda_3 beta) is u |psi_bar|^2 + v."""
        alpha, beta = np.exp(log_gains)
        v0, ratio = index.s_a + index.s_b * beta, index.k / (2 * index.lambda_3 * beta)
        u, v = ratio * index.k / 2, ratio / (4 * alpha)
        transient = (v0 - v) ** 2 - 2 * u * (v0 - v) * index.D2 + u**2 * index.D4
        steady = u**2 * index.D4 + 2 * u * v * index.D2 + v**2
        return float(transient * ratio / 2 + index.mu * steady + index.nu * (alpha**2 + beta**2))

    found = minimize(J, np.log([c.alpha, c.beta]), method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12})
    alpha, beta = np.exp(found.x)
    return Erratum(
        "corrected-index",
        "(75)-(82), Table 1",
        f"optimal gains {c.alpha:.4f} and {c.beta:.4f} for (1, 1)",
        f"{alpha:.4f} and {beta:.4f}, were J built on the bound that the proof supports",
        'J of (78) with the h of the erratum "lyapunov-rate", minimised; and 2 beta max(S_ii), which k has to reach.',
        {
            "alpha": float(alpha),
            "beta (N m s/rad)": float(beta),
            "J": float(found.fun),
            "k": index.k,
            "2 beta max(S_ii)": 2 * float(beta) * float(CONTROLLER.unpack(CONTROLLER.starts).S.max()),
        },
        bool(abs(beta - c.beta) > 0.01),
    )
