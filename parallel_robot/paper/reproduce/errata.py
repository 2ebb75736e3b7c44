"""Errors and gaps of the paper, each with the computation that shows it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from parallel_robot.paper.reproduce import errata_gains, errata_model, errata_proof
from parallel_robot.paper.reproduce.content import Erratum
from parallel_robot.paper.reproduce.material import Material

#: In the order of the paper.
ERRATA: tuple[Callable[[Material], Erratum], ...] = (
    errata_model.matrix_b,
    errata_model.masses,
    errata_model.uncertainty_sign,
    errata_proof.lower_bound,
    errata_proof.upper_bound,
    errata_proof.lyapunov_rate,
    errata_proof.decreasing_outside,
    errata_gains.start_constants,
    errata_gains.factored_derivative,
    errata_gains.positive_hessian,
    errata_gains.concave,
    errata_gains.corrected_index,
    errata_model.base_1,
    errata_model.fig_4_duration,
    errata_model.mass_support,
    errata_model.turns,
    errata_gains.cut_alpha,
    errata_model.steady_errors,
)


def show(find: Callable[[Material], Erratum], material: Material) -> Erratum:
    """One erratum, its numbers as plain floats."""
    found = find(material)
    numbers = {name: float(number) for name, number in found.numbers.items()}
    return dataclasses.replace(found, numbers=numbers, shown=bool(found.shown))


def find_errata(material: Material) -> tuple[Erratum, ...]:
    """All errata."""
    return tuple(show(find, material) for find in ERRATA)
