"""Measures of Theorem 1 and its assumptions along the runs."""

from __future__ import annotations

from parallel_robot.paper.reproduce.content import Measured
from parallel_robot.paper.reproduce.material import Material


def stays_bounded(material: Material) -> Measured:
    """Largest |Z| over the bound d for the run's start."""
    return Measured({f"mu/nu = {t.controller}": t.Z_max / t.d_chi for t in material.theorem1})


def ultimately_bounded(material: Material) -> Measured:
    """Largest steady |Z| over chi_min of (63)."""
    return Measured(
        {f"mu/nu = {t.controller}": t.Z_steady / t.chi_min for t in material.theorem1},
        note="the bound holds and is far from the motion: it guarantees a ball, not an accuracy",
    )


def lyapunov_inequality(material: Material) -> Measured:
    """Largest V' + lambda |Z|^2 - h of (59) as printed, over h: negative when V falls as it should."""
    return Measured({f"mu/nu = {t.controller}": t.excess_printed / t.h_printed for t in material.theorem1})


def bound_exists(material: Material) -> Measured:
    """Least parameter p with psi_bar = (p, p) for which Pi is a bound of |g| along the run."""
    values = {f"mu/nu = {t.controller}": max(t.psi_bar) for t in material.theorem1}
    return Measured(values, note="(91) centres it at 0.25 and ends at 0.5")


def estimate_near_quarter(material: Material) -> Measured:
    """Largest component of the estimate over the run; (91) gives full membership to 0.25 and half to 1/12."""
    return Measured({f"mu/nu = {key}": float(m.psi.max()) for key, m in material.motions.items()})


def errors_vanish(material: Material) -> Measured:
    """Largest steady |Z| without its psi part, over that at the start."""
    values = {}
    for key, m in material.motions.items():
        size = (m.error**2).sum(axis=1) + (m.rate**2).sum(axis=1)
        values[f"mu/nu = {key}"] = float((size[m.time >= material.runs.steady_after].max() / size[0]) ** 0.5)
    return Measured(values)
