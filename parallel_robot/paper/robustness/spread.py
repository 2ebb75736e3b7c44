"""Spread of the results over the Monte Carlo runs: bands over time, quantiles, sensitivities."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from cosim.sweep.sensitivity import Uncertain, groups_of, sobol
from parallel_robot.paper.reproduce.figures.style import ERROR_WORDS, error_unit
from parallel_robot.paper.robustness.content import Sensitivity, Spread
from parallel_robot.paper.robustness.rows import Rows
from parallel_robot.paper.robustness.study import NO_ORDER

#: Shares of the runs below the edges of the bands.
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def bands(rows: Rows) -> dict[str, np.ndarray]:
    """Each tracking error's quantiles over time (len(QUANTILES), points), in mm or mrad."""
    return {name: np.nanquantile(curves, QUANTILES, axis=0) for name, curves in rows.curves.items()}


def spreads(rows: Rows, nominal: Rows, which: int) -> tuple[Spread, ...]:
    """Quantiles of the results; nominal ones from a row of the sweep over the gains."""
    named = [
        ("steady error", "mm", rows.error, nominal.error),
        *(
            (f"largest steady error of {ERROR_WORDS[name]}", error_unit(name), values, nominal.steady_max[name])
            for name, values in rows.steady_max.items()
        ),
        ("control effort", "N m", rows.effort, nominal.effort),
    ]
    return tuple(_spread(name, unit, float(own[which]), values) for name, unit, values, own in named)


def _spread(name: str, unit: str, nominal: float, values: np.ndarray) -> Spread:
    low, median, high = np.nanquantile(values, (0.05, 0.5, 0.95)).tolist()
    return Spread(name, unit, nominal, low, median, high, float(np.nanmax(values)))


def sensitivities(rows: Rows, uncertain: Sequence[Uncertain], seed: int) -> tuple[Sensitivity, ...]:
    """Sobol' indices of steady error and control effort, and which way they go."""
    groups = groups_of(uncertain)
    results = {"steady error": rows.error, "control effort": rows.effort}
    return tuple(
        Sensitivity(name, tuple(sobol(groups, values, seed)), _trends(rows, values, uncertain))
        for name, values in results.items()
    )


def _trends(rows: Rows, values: np.ndarray, uncertain: Sequence[Uncertain]) -> dict[str, float]:
    """Rank correlations with the factors that are alone in their group."""
    from scipy.stats import spearmanr

    size = Counter(u.group for u in uncertain)
    alone = [u for u in uncertain if size[u.group] == 1 and u.factor.name not in NO_ORDER]
    return {u.group: float(spearmanr(rows.factors[u.factor.name], values, nan_policy="omit").statistic) for u in alone}
