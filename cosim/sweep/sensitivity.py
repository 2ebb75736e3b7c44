"""Sensitivity of a result to uncertain factors: Saltelli's design for a sweep, and Sobol' indices from its rows.

Saltelli et al., Computer Physics Communications 181(2), 2010: two independent samples A and B of all factors, and for
each group of factors A with that group taken from B. All rows have the same distribution, so that they are a Monte
Carlo sample as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.errors import needs
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Factor, Points, Range, check_number, scaled

#: Resamples of the bootstrap, and the confidence level of its intervals.
_RESAMPLES, _CONFIDENCE = 1000, 0.95


@dataclass(frozen=True)
class Uncertain:
    """A factor that is not known.

    Attributes
    ----------
    factor : Factor
        Levels are equally likely.
    group : str
        Factors of one group are judged together.
    quantile : callable, optional
        Value of a range at probabilities (n,) in [0, 1); by default all values are equally likely.
    """

    factor: Factor
    group: str
    quantile: Callable[[np.ndarray], np.ndarray] | None = None

    def values(self, unit: np.ndarray) -> np.ndarray:
        """Column of `Points` at probabilities (n,)."""
        if self.quantile is None or not isinstance(self.factor, Range):
            return scaled(self.factor, unit)
        values: np.ndarray = np.clip(self.quantile(unit), self.factor.low, self.factor.high)
        return values


@dataclass(frozen=True)
class Index:
    """Sobol' indices of one group of factors: shares of the variance of a result.

    Attributes
    ----------
    first : float
        Share that the group explains alone.
    total : float
        Share that would be gone if the group were known: with its interactions.
    first_interval, total_interval : tuple of float
        95 % confidence intervals, by bootstrap.
    """

    group: str
    first: float
    total: float
    first_interval: tuple[float, float]
    total_interval: tuple[float, float]


def groups_of(uncertain: Sequence[Uncertain]) -> list[str]:
    """Names of the groups, in order."""
    return list(dict.fromkeys(u.group for u in uncertain))


def base_for(uncertain: Sequence[Uncertain], runs: int) -> int:
    """Size of A and B, a power of two, that makes at least so many runs."""
    least = -(-max(runs, 1) // (len(groups_of(uncertain)) + 2))
    return 1 << (least - 1).bit_length()


def saltelli(uncertain: Sequence[Uncertain], base: int, seed: int = 0) -> Points:
    """Saltelli's design: the rows of A, of B, then for each group those of A with that group from B.

    Parameters
    ----------
    uncertain : sequence of Uncertain
    base : int
        Size of A and B, a power of two, for which the Sobol' sequence is balanced.
    seed : int
        Fixes the scrambling.

    Raises
    ------
    SweepError
        The numbers make no sense.
    """
    with needs("sweep"):
        from scipy.stats import qmc  # takes a while to import

    if base < 1 or base & (base - 1):
        raise SweepError(f"{base} rows of each sample: use a power of two")
    if seed < 0:
        raise SweepError(f"seed {seed} must be 0 or greater")
    groups = groups_of(uncertain)
    check_number(base * (len(groups) + 2))
    both = qmc.Sobol(2 * len(uncertain), rng=np.random.default_rng(seed)).random(base)
    A, B = both[:, : len(uncertain)], both[:, len(uncertain) :]
    mixed = [np.where([u.group == group for u in uncertain], B, A) for group in groups]
    unit = np.concatenate([A, B, *mixed])
    columns = tuple(u.values(column) for u, column in zip(uncertain, unit.T, strict=True))
    return Points(tuple(u.factor for u in uncertain), columns)


def sobol(groups: Sequence[str], results: np.ndarray, seed: int = 0) -> list[Index]:
    """Sobol' indices of each group.

    Parameters
    ----------
    groups : sequence of str
        As of the design.
    results : array (rows,)
        One number for each row of `saltelli`, in its order; NaN for a run that failed.
    seed : int
        Fixes the bootstrap.

    Returns
    -------
    list of Index
        From the rows of A and B for which all runs succeeded: as many of them as make a power of two.

    Raises
    ------
    SweepError
        Less than two are left, or the number of rows does not fit.
    """
    with needs("sweep"):
        from scipy.stats import bootstrap, sobol_indices

    parts = len(groups) + 2
    if len(results) % parts:
        raise SweepError(f"{len(results)} rows are not a design of {len(groups)} groups; give all rows")
    blocks = np.asarray(results, dtype=float).reshape(parts, -1)
    blocks = blocks[:, np.isfinite(blocks).all(axis=0)]
    n = (1 << blocks.shape[1].bit_length()) // 2
    if n < 2:
        raise SweepError(f"only {blocks.shape[1]} sets of runs have all succeeded; that is too few for sensitivities")
    blocks = blocks[:, :n]

    def indices(rows: np.ndarray) -> np.ndarray:
        f = blocks[:, np.newaxis, rows]
        found = sobol_indices(func={"f_A": f[0], "f_B": f[1], "f_AB": f[2:]}, n=n)
        return np.stack([np.atleast_1d(found.first_order), np.atleast_1d(found.total_order)])

    first, total = indices(np.arange(n))
    spread = bootstrap(
        (np.arange(n),),
        indices,
        vectorized=False,
        n_resamples=_RESAMPLES,
        confidence_level=_CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    ends = np.stack([spread.low, spread.high], axis=-1).tolist()
    return [
        Index(group, float(first[i]), float(total[i]), tuple(ends[0][i]), tuple(ends[1][i]))
        for i, group in enumerate(groups)
    ]
