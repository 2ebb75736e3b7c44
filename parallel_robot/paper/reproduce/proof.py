"""Measures and errata of the proof of Theorem 1, section 4 of the paper."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from parallel_robot.paper.reproduce.content import Erratum, Measured
from parallel_robot.paper.reproduce.material import Material, measure
from parallel_robot.paper.reproduce.theorem import STIFF, Constants, constants, needed_at_start


@measure
def stays_bounded(material: Material) -> Measured:
    """Largest |Z| over the bound d for the run's start."""
    return Measured({f"mu/nu = {t.controller}": t.Z_max / t.d_chi for t in material.theorem1})


@measure
def ultimately_bounded(material: Material) -> Measured:
    """Largest steady |Z| over chi_min of (63)."""
    return Measured(
        {f"mu/nu = {t.controller}": t.Z_steady / t.chi_min for t in material.theorem1},
        note="the bound holds and is far from the motion: it guarantees a ball, not an accuracy",
    )


@measure
def lyapunov_inequality(material: Material) -> Measured:
    """V' + lambda |Z|^2 - h of (59) as printed, over h, in a state without tracking error; negative if V falls."""
    values = {}
    for c in material.runs.proposed:
        found, V_rate, square = _without_error(c.alpha, c.beta, material.motions["1"].k)
        values[f"psi = psi_bar/2, mu/nu = {c.key}"] = (V_rate + found.rate * square - found.h) / found.h
    along = max(t.excess_printed / t.h_printed for t in material.theorem1)
    return Measured(
        values, note=f"along the runs it holds, with at most {along:.3g}; but (59) claims it for every state"
    )


@measure
def bound_exists(material: Material) -> Measured:
    """Least parameter p with psi_bar = (p, p) for which Pi is a bound of |g| along the run."""
    values = {f"mu/nu = {t.controller}": max(t.psi_bar) for t in material.theorem1}
    return Measured(values, note='(91) centres it at 0.25 and ends at 0.5; see the erratum "bound-of-gains"')


@measure
def estimate_near_quarter(material: Material) -> Measured:
    """Largest component of the estimate over the run; (91) gives full membership to 0.25 and half to 1/12."""
    return Measured({f"mu/nu = {key}": float(m.psi.max()) for key, m in material.motions.items()})


@measure
def errors_vanish(material: Material) -> Measured:
    """Largest steady |Z| without its psi part, over that at the start."""
    values = {}
    for key, m in material.motions.items():
        size = (m.error**2).sum(axis=1) + (m.rate**2).sum(axis=1)
        values[f"mu/nu = {key}"] = float((size[m.time >= material.runs.steady_after].max() / size[0]) ** 0.5)
    return Measured(values)


#: A parameter of the bound from the paper's own fuzzy set (91): "close to 0.25".
PSI_BAR = np.array([0.25, 0.25])


def _block(lambda_M: float, beta: float, S_ii: float) -> np.ndarray:
    """Lambda_i of (43), (47)."""
    return np.array([[lambda_M * S_ii**2 + 2 * beta * S_ii, lambda_M * S_ii], [lambda_M * S_ii, lambda_M]])


def _without_error(alpha: float, beta: float, k: float) -> tuple[Constants, float, float]:
    """A state without tracking error in which the estimate is half of psi_bar: constants of (59), V' and |Z|^2.

    Then s = 0, and (37) is psi' = -psi.
    """
    psi_tilde = PSI_BAR / 2
    psi = psi_tilde - PSI_BAR
    return constants(alpha, beta, PSI_BAR, k), k * float(psi @ -psi_tilde), float(psi @ psi)


def lyapunov_rate(material: Material) -> Erratum:
    """The last step of (59)."""
    m, c = material.motions["1"], material.runs.controller("1")
    found, V_rate, square = _without_error(c.alpha, c.beta, m.k)
    bound, bound_corrected = (-found.rate * square + h for h in (found.h, found.h_corrected))
    return Erratum(
        "lyapunov-rate",
        "(59), and from it (62)-(64), (67)-(75)",
        "V' <= -beta lambda_3 |Z|^2 + beta lambda_3 |psi_bar|^2 + 1/(4 alpha)",
        "the same with k^2/(4 (k - beta lambda_3)) in place of the second beta lambda_3: k >= 2 beta lambda_3 may "
        "not replace k before a term "
        "that can be positive. The steady part of J changes with it",
        "V' is computed in a state without tracking error in which the estimate is half of psi_bar = (0.25, "
        "0.25), with "
        "the gains of (1, 1).",
        {"V' (J/s)": V_rate, "bound as printed (J/s)": bound, "bound corrected (J/s)": bound_corrected},
        V_rate > bound and V_rate <= bound_corrected,
    )


def lower_bound(material: Material) -> Erratum:
    """lambda_1 of (43)-(45)."""
    m, c = material.motions["1"], material.runs.controller("1")
    lambda_M = float(np.linalg.eigvalsh(m.M)[:, 0].min())
    least = float(np.linalg.eigvalsh(_block(lambda_M, c.beta, float(m.S[0])))[0])
    return Erratum(
        "lower-bound",
        "after (43), (44), (45)",
        "lambda_min(Lambda_i) = lambda_M_min, and V >= lambda_M_min |X|^2",
        "lambda_min(Lambda_i) is smaller, and the factor 1/2 stays: V >= lambda_min(Lambda_i) |X|^2 / 2, so that the "
        "radius (63) has to be larger",
        "The least eigenvalue of Lambda_i is computed for the least eigenvalue of M on the path and the gains "
        "of (1, 1).",
        {
            "lambda_M_min (kg m^2)": lambda_M,
            "lambda_min(Lambda_i)": least,
            "lambda_1 printed over true (1)": lambda_M / (least / 2),
            "radius (63) true over printed (1)": float(np.sqrt(lambda_M / (least / 2))),
        },
        least / 2 < lambda_M,
    )


def upper_bound(material: Material) -> Erratum:
    """lambda_max of (47), (48)."""
    m, c = material.motions["1"], material.runs.controller("1")
    lambda_M, S_ii = float(np.linalg.eigvalsh(m.M)[:, -1].max()), float(m.S[0])
    largest = float(np.linalg.eigvalsh(_block(lambda_M, c.beta, S_ii))[1])
    return Erratum(
        "upper-bound",
        "after (47), (48)",
        "lambda_max(Lambda_i) = 2 beta S_ii",
        "lambda_max(Lambda_i) is larger; V <= k/2 |Z|^2 (49) holds all the same with k = 12",
        "The largest eigenvalue of Lambda_i is computed for the largest one of M on the path and the gains of (1, 1).",
        {"2 beta S_ii": 2 * c.beta * S_ii, "lambda_max(Lambda_i)": largest, "k/2": m.k / 2},
        2 * c.beta * S_ii < largest <= m.k,
    )


def bound_of_gains(material: Material) -> Erratum:
    """Assumption 4 does not leave the bound free of the control."""
    beta = material.runs.controller("1").beta
    at_start = {b: needed_at_start(b) for b in (beta, *STIFF)}
    numbers = {f"needed at the start, beta = {b:.4g}": needed for b, needed in at_start.items()}
    numbers[f"over the run, beta = {beta:.4g}"] = max(max(t.psi_bar) for t in material.theorem1 if t.controller == "1")
    for b, (whole, later) in sorted(material.runs.least_bound.items()):
        numbers[f"over the first second, beta = {b:.4g}"] = whole
        numbers[f"the same after the first 20 ms, beta = {b:.4g}"] = later
    return Erratum(
        "bound-of-gains",
        "Assumption 4, (34), (35)",
        "a bound of |g| that depends on angles and velocities, with an unknown constant psi_bar",
        "F in g depends on the torque, so that psi_bar depends on the gains: the claim that (91) holds it is about "
        "these gains",
        "The least psi_bar = (p, p) that meets (35) is sought along runs with larger beta, and alpha of row (1, 1).",
        numbers,
        all(low < high for low, high in pairwise(at_start.values())),
    )


def place_of_d(material: Material) -> Erratum:
    """(61) prints the time T."""
    m, c = material.motions["1"], material.runs.controller("1")
    check = next(t for t in material.theorem1 if t.controller == "1")
    found = constants(c.alpha, c.beta, np.array(check.psi_bar), m.k)
    time = found.time_to(2.0 * check.chi_min, check.Z_start)
    return Erratum(
        "place-of-d",
        "(61)",
        "T(chi~, chi), the same as (64)",
        "d(chi) belongs there, the radius within which |Z| stays: chi sqrt(lambda_2/lambda_1) for chi > Gamma, else "
        "Gamma sqrt(lambda_2/lambda_1)",
        "Both are computed for the run of row (1, 1). The printed expression is a time; taken for a radius, "
        "the run leaves it.",
        {
            "d(chi)": check.d_chi,
            "largest |Z| of the run": check.Z_max,
            "(61) as printed, for twice chi_min (s)": time,
        },
        time < check.Z_max <= check.d_chi,
    )


def larger_k(material: Material) -> Erratum:
    """A larger k makes the adaptation slower."""
    m = material.motions["1"]
    i = int(np.argmax(np.linalg.norm(m.s, axis=1)))
    rate = float(np.linalg.norm(m.s[i]) * m.regressor[i, 0])
    growth = {k: rate / k for k in (m.k / 10, m.k, 10 * m.k)}
    return Erratum(
        "larger-k",
        "after (37); after (49)",
        "if k is appropriately large, the adaptive parameters will increase rapidly",
        "(37) has 1/k: a larger k makes the adaptation slower. The proof wants k large, fast adaptation wants it small",
        "The growth of psi by (37), without leakage, is computed where |s| is largest in the run of row (1, 1).",
        {f"growth of psi_1 with k = {k:g} (1/s)": value for k, value in growth.items()},
        all(slow < fast for fast, slow in pairwise(growth.values())),
    )


def decreasing_outside(material: Material) -> Erratum:
    """The radius (60)."""
    m, c = material.motions["1"], material.runs.controller("1")
    found = constants(c.alpha, c.beta, PSI_BAR, m.k)
    printed = found.h**2 / found.rate
    return Erratum(
        "decreasing-outside",
        "(60), as the scan reads",
        "V falls when |Z| >= h^2/lambda",
        "V falls when |Z| >= sqrt(h/lambda), as (62) has it",
        "The right side of (59) is computed at either radius, with psi_bar = (0.25, 0.25) and the gains of (1, "
        "1). V need "
        "not fall where it is positive.",
        {
            "h^2/lambda": printed,
            "sqrt(h/lambda)": found.Gamma,
            "right side at h^2/lambda (J/s)": found.h - found.rate * printed**2,
            "right side at sqrt(h/lambda) (J/s)": found.h - found.rate * found.Gamma**2,
        },
        printed < found.Gamma,
    )
