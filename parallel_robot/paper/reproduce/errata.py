"""Table of the errors and gaps of the paper, each with the computation that shows it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from parallel_robot.paper.reproduce import gains, model, path, proof, tracking
from parallel_robot.paper.reproduce.content import Erratum
from parallel_robot.paper.reproduce.material import Material

#: In the order of the paper.
ERRATA: tuple[Callable[[Material], Erratum], ...] = (
    model.sizes,
    model.matrix_b,
    model.masses,
    model.force_of_torque,
    model.uncertainty_sign,
    proof.bound_of_gains,
    proof.larger_k,
    proof.lower_bound,
    proof.upper_bound,
    proof.lyapunov_rate,
    proof.decreasing_outside,
    proof.place_of_d,
    gains.centre_of_gravity,
    gains.start_constants,
    gains.factored_derivative,
    gains.positive_hessian,
    gains.concave,
    gains.corrected_index,
    model.base_1,
    model.fig_4_duration,
    path.path_not_printed,
    tracking.mass_support,
    tracking.turns,
    gains.printed_rho_4,
    gains.cut_alpha,
    tracking.steady_errors,
)


def show(find: Callable[[Material], Erratum], material: Material) -> Erratum:
    """One erratum, its numbers as plain floats."""
    found = find(material)
    numbers = {name: float(number) for name, number in found.numbers.items()}
    return dataclasses.replace(found, numbers=numbers, shown=bool(found.shown))


def find_errata(material: Material) -> tuple[Erratum, ...]:
    """All errata."""
    return tuple(show(find, material) for find in ERRATA)
