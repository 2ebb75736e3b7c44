"""Sobol' indices against functions whose indices are known; Pareto fronts against their definition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.sweep.errors import SweepError
from cosim.sweep.pareto import least_within, non_dominated
from cosim.sweep.points import Levels, Range
from cosim.sweep.sensitivity import Uncertain, base_for, groups_of, saltelli, sobol

ISHIGAMI = [Uncertain(Range(f"x{i}", -np.pi, np.pi), f"x{i}") for i in (1, 2, 3)]

#: First and total indices of the Ishigami function with a = 7, b = 0.1, in closed form (Saltelli et al., Sensitivity
#: Analysis, 2000): V1 = (1 + b pi^4/5)^2/2, V2 = a^2/8, V13 = 8 b^2 pi^8/225.
V1, V2, V13 = (1.0 + 0.1 * np.pi**4 / 5.0) ** 2 / 2.0, 49.0 / 8.0, 8.0 * 0.01 * np.pi**8 / 225.0
FIRST = np.array([V1, V2, 0.0]) / (V1 + V2 + V13)
TOTAL = np.array([V1 + V13, V2, V13]) / (V1 + V2 + V13)


def ishigami(x: np.ndarray) -> np.ndarray:
    return np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


def errors(found) -> np.ndarray:
    """Deviations of first and total indices (2, 3) from the closed form."""
    return np.abs(np.array([[i.first for i in found], [i.total for i in found]]) - np.array([FIRST, TOTAL]))


def test_indices_of_the_ishigami_function():
    points = saltelli(ISHIGAMI, 2048, seed=3)
    results = ishigami(np.array(points.columns))
    found = sobol(groups_of(ISHIGAMI), results)
    assert errors(found).max() < 0.03
    for index, first, total in zip(found, FIRST, TOTAL, strict=True):
        assert index.first_interval[0] < first < index.first_interval[1]
        assert index.total_interval[0] < total < index.total_interval[1]
    # the comparison can fail: rows in another order, and a design of other groups
    parts = results.reshape(5, -1)
    assert errors(sobol(groups_of(ISHIGAMI), parts[[0, 1, 3, 4, 2]].ravel())).max() > 0.1
    assert errors(sobol(groups_of(ISHIGAMI), np.random.default_rng(1).permutation(results))).max() > 0.1


def test_confidence_intervals_shrink_as_one_over_the_root_of_the_runs():
    widths = []
    for base in (256, 4096):
        results = ishigami(np.array(saltelli(ISHIGAMI, base).columns))
        widths.append([high - low for low, high in (i.total_interval for i in sobol(groups_of(ISHIGAMI), results))])
    assert np.array(widths[0]) / np.array(widths[1]) == pytest.approx([4.0] * 3, rel=0.25)


def test_groups_levels_and_other_distributions_in_a_linear_model():
    uncertain = [
        Uncertain(Range("a", 0.0, 1.0), "both"),
        Uncertain(Levels("n", (1, 2, 3, 4)), "levels"),
        Uncertain(Range("b", 0.0, 4.0), "both"),
        Uncertain(Range("c", 0.0, 1.0), "squared", lambda u: u**2),
    ]
    points = saltelli(uncertain, 1024)
    a, n, b, c = points.columns
    assert n.dtype == np.int32
    found = {i.group: i for i in sobol(groups_of(uncertain), 2.0 * a + (1.0 + n) + b + 3.0 * c)}
    # variances: 1/12 and 16/12 of uniform ranges, 15/12 of four levels, 4/45 of a squared uniform number
    variances = {"both": 4.0 / 12.0 + 16.0 / 12.0, "levels": 15.0 / 12.0, "squared": 9.0 * 4.0 / 45.0}
    for group, variance in variances.items():
        share = variance / sum(variances.values())
        assert found[group].first == pytest.approx(share, abs=0.02)
        assert found[group].total == pytest.approx(share, abs=0.02)


def test_each_part_of_the_design_takes_one_group_from_b():
    uncertain = [Uncertain(Range(name, 0.0, 1.0), name[0]) for name in ("g1", "h", "g2")]
    points = saltelli(uncertain, 8)
    A, B, g, h = np.array(points.columns).reshape(3, 4, 8).transpose(1, 0, 2)
    assert (g == np.array([B[0], A[1], B[2]])).all()
    assert (h == np.array([A[0], B[1], A[2]])).all()
    assert points.sha256() == saltelli(uncertain, 8).sha256() != saltelli(uncertain, 8, seed=1).sha256()


def test_failed_runs_are_left_out_with_their_sets():
    results = ishigami(np.array(saltelli(ISHIGAMI, 2048).columns))
    results[[5, 2048 + 7, 4 * 2048 + 1000]] = np.nan
    assert errors(sobol(groups_of(ISHIGAMI), results)).max() < 0.05
    with pytest.raises(SweepError, match="only 1 sets of runs have all succeeded"):
        sobol(["x"], np.array([1.0, np.nan, 2.0, 1.0, 3.0, 1.0]))
    with pytest.raises(SweepError, match="7 rows are not a design of 1 groups"):
        sobol(["x"], np.arange(7.0))


@pytest.mark.parametrize(("runs", "base"), [(1, 1), (5, 1), (6, 2), (10, 2), (11, 4), (10_000, 2048)])
def test_at_least_so_many_runs(runs, base):
    assert base_for(ISHIGAMI, runs) == base
    assert len(saltelli(ISHIGAMI, base)) == 5 * base >= runs


@pytest.mark.parametrize(("base", "seed", "says"), [(3, 0, "power of two"), (0, 0, "power of two"), (2, -1, "seed -1")])
def test_designs_that_make_no_sense_are_one_line(base, seed, says):
    with pytest.raises(SweepError, match=says):
        saltelli(ISHIGAMI, base, seed)


COSTS = st.lists(st.tuples(st.integers(1, 6), st.integers(1, 6)), min_size=1, max_size=12)


@given(COSTS)
def test_the_front_is_what_nothing_dominates(costs):
    expected = [not any(a <= x and b <= y and (a, b) != (x, y) for a, b in costs) for x, y in costs]
    assert non_dominated(np.array(costs, dtype=float)).tolist() == expected


@given(COSTS, st.integers(0, 7))
def test_the_least_within_a_limit(costs, limit):
    wanted, limited = np.array(costs, dtype=float).T
    expected = min((a for a, b in costs if b <= limit), default=np.inf)
    assert least_within(wanted, limited, np.array([limit, 7.0])).tolist() == [expected, wanted.min()]
