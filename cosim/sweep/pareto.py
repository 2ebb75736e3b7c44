"""Choices of which none is better in one respect without being worse in another."""

from __future__ import annotations

import numpy as np


def non_dominated(costs: np.ndarray) -> np.ndarray:
    """Whether no other point is at least as good in all costs and better in one: (n,) of bool, costs (n, m)."""
    no_worse = (costs[:, np.newaxis] <= costs).all(axis=-1)
    better = (costs[:, np.newaxis] < costs).any(axis=-1)
    return np.logical_not((no_worse & better).any(axis=0))


def least_within(wanted: np.ndarray, limited: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Least of one cost (n,) where the other (n,) is at most a limit, for limits (k,); infinite if nowhere."""
    order = np.argsort(limited, kind="stable")
    least = np.concatenate([[np.inf], np.minimum.accumulate(wanted[order])])
    return least[np.searchsorted(limited[order], limits, side="right")]
