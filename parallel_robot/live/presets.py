"""Presets of the live page: the rows of Table 1, PD control, and the readings of the paper."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from controller_fmu.optimal_gains import POWER_OF_ALPHA, POWER_OF_BETA, PerformanceIndex
from parallel_robot.paper.reproduce.content import Controller
from parallel_robot.paper.reproduce.readings import ASSUMPTIONS, Assumption
from parallel_robot.paper.reproduce.table import controllers, table1

#: Start value of a reading -> control of the page; others have the name of the variable.
_CONTROLS = {"controller.S": "S", "controller.psi_start": "psi_start", "controller.tau_max": "tau_max"}


def presets() -> dict[str, dict[str, dict[str, Any]]]:
    """Heading -> label -> values of controls; all other controls are at their start values."""
    rows = {f"{row.mu:g}, {row.nu:g}": row for row in table1()}
    pd, *_ = controllers()
    return {
        "Optima of Table 1": {
            f"μ, ν = {label}": {"weights": label, "alpha": row.alpha, "beta": row.beta} for label, row in rows.items()
        },
        "Other control, other surroundings": {
            "PD control: α = 0": {"alpha": pd.alpha, "beta": pd.beta},
            "PD control with nothing acting on the robot": {"alpha": pd.alpha, "rms": 0.0, "mass_amplitude": 0.0},
            "nothing acts on the robot": {"rms": 0.0, "mass_amplitude": 0.0},
            "a heavy load, and a strong disturbance": {"rms": 0.05, "mass_amplitude": 0.8},
        },
        "Readings of the paper": {a.label: _reading(a, controllers()) for a in _without_couplings()},
    }


def _without_couplings() -> Iterable[Assumption]:
    """Assumptions that are not on the communication step alone: the closed loop of the page has none."""
    seen = []
    for assumption in ASSUMPTIONS:
        values = _reading(assumption, controllers())
        if values not in seen:
            seen.append(values)
            yield assumption


def _reading(assumption: Assumption, known: Iterable[Controller]) -> dict[str, Any]:
    """Values of controls under an assumption."""
    controller = next(c for c in known if c.key == assumption.key)
    values: dict[str, Any] = {
        "weights": f"{controller.mu:g}, {controller.nu:g}",
        "alpha": assumption.alpha * controller.alpha,
        "beta": assumption.beta * controller.beta,
    }
    if assumption.condition in ("nominal", "mass change"):
        values["rms"] = 0.0
    if assumption.condition in ("nominal", "disturbance"):
        values["mass_amplitude"] = 0.0
    if assumption.mass_at_rest:
        values["at_rest"] = 1.0
    if assumption.stop_time is not None:
        values["stop_time"] = assumption.stop_time
    values |= {_CONTROLS.get(name, name.partition(".")[2]): value for name, value in assumption.start.items()}
    return values


def index_data() -> dict[str, Any]:
    """The performance index J (80) for the weights of Table 1, as terms c alpha^a beta^b, with its optimum.

    Coefficients hold for the printed k and S.
    """
    found = {}
    for row in table1():
        index = PerformanceIndex(row.mu, row.nu)
        coefficients = index.terms(1.0, 1.0)  # at 1 a term is its coefficient
        found[f"{row.mu:g}, {row.nu:g}"] = {
            "coefficients": np.asarray(coefficients).tolist(),
            "alpha": row.alpha,
            "beta": row.beta,
            "J": row.J,
        }
    return {
        "powers": {"alpha": POWER_OF_ALPHA.tolist(), "beta": POWER_OF_BETA.tolist()},
        "rows": found,
        "k": PerformanceIndex().k,
        "lambda_3": PerformanceIndex().lambda_3,
    }
