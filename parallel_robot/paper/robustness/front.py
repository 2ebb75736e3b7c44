"""Steady error against control effort over the gains: the Pareto front, and where the paper's controllers lie."""

from __future__ import annotations

import numpy as np

from controller_fmu.model import PARAMETERS as CONTROLLER
from cosim.sweep.pareto import least_within, non_dominated
from parallel_robot.paper.reproduce.table import controllers
from parallel_robot.paper.robustness.content import Front, FrontPoint, Place, Placed
from parallel_robot.paper.robustness.rows import Rows
from parallel_robot.paper.robustness.study import CONDITIONS

#: A controller is near the front when other gains lower neither error nor effort by more than a tenth without raising
#: the other.
NEAR = 1.0 / 0.9

#: How much more effort is allowed to see what error it would buy.
MORE_EFFORT = 1.05


def in_condition(rows: Rows, condition: str) -> tuple[np.ndarray, np.ndarray]:
    """Places of the paper's controllers and of the grid among the rows, in one condition."""
    places = np.flatnonzero(rows.scenario == condition)
    six = len(controllers())
    return places[:six], places[six:]


def gain_of_others(own: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Factors (k, 2) by which others (n, 2) lower the error of points (k, 2) at no more effort, and the other way."""
    least = [least_within(grid[:, i], grid[:, 1 - i], own[:, 1 - i]) for i in (0, 1)]
    factors: np.ndarray = own / np.minimum(own, np.stack(least, axis=1))
    return factors


def fronts(rows: Rows) -> tuple[Front, ...]:
    """The front of each condition."""
    return tuple(_front(rows, condition) for condition in CONDITIONS)


def _front(rows: Rows, condition: str) -> Front:
    paper, grid = in_condition(rows, condition)
    grid = grid[np.isfinite(rows.error[grid]) & np.isfinite(rows.effort[grid])]
    costs = np.stack([rows.error, rows.effort], axis=1)
    on_front = grid[non_dominated(costs[grid])]
    edge = (rows.alpha[on_front] == rows.alpha.max()) | (rows.beta[on_front] == rows.beta.max())
    controller = CONTROLLER.unpack(CONTROLLER.starts)
    largest_beta = controller.k / (2.0 * max(controller.S))
    points = [
        FrontPoint(*(float(a[i]) for a in (rows.alpha, rows.beta, rows.error, rows.effort)))
        for i in on_front[np.argsort(rows.effort[on_front], kind="stable")]
    ]
    placed = [_placed(c.key, c.alpha, c.beta, costs[i], costs[grid]) for c, i in zip(controllers(), paper, strict=True)]
    return Front(
        condition,
        gains=len(grid),
        near=int((gain_of_others(costs[grid], costs[grid]).max(axis=1) <= NEAR).sum()),
        at_edge=int(edge.sum()),
        beyond_proof=int((rows.beta[on_front] > largest_beta).sum()),
        points=tuple(points),
        placed=tuple(placed),
    )


def _placed(key: str, alpha: float, beta: float, own: np.ndarray, grid: np.ndarray) -> Placed:
    error, effort = own.tolist()
    dominated_by = int((grid < own).all(axis=1).sum())
    alone = gain_of_others(own[np.newaxis], grid)[0].tolist()
    near: Place = "near the front" if max(alone) <= NEAR else "away from the front"
    with_more = least_within(grid[:, 0], grid[:, 1], np.array([MORE_EFFORT * effort]))
    return Placed(
        controller=key,
        alpha=alpha,
        beta=beta,
        error=error,
        effort=effort,
        dominated_by=dominated_by,
        error_alone=alone[0],
        effort_alone=alone[1],
        error_for_more=error / min(error, float(with_more[0])),
        place=near if dominated_by else "on the front",
    )
