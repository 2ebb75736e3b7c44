"""Elimination planned from a pattern: the tables hold all that dense elimination fills, and little more."""

from __future__ import annotations

import numpy as np
import pytest

from fmu_export.native.elimination import Elimination, eliminate


def random_pattern(n: int, per_row: int, seed: int) -> list[tuple[int, int]]:
    rng = np.random.default_rng(seed)
    return sorted({(int(i), int(j)) for i in range(n) for j in rng.choice(n, per_row)})


def factors_by_tables(plan: Elimination, matrix: np.ndarray) -> np.ndarray:
    """L (unit diagonal left out) and U in one matrix, computed at the entries of the plan only."""
    a = matrix[np.ix_(plan.pivots, plan.pivots)].copy()
    for i in range(len(a)):
        row = plan.columns[plan.row_starts[i] : plan.row_starts[i + 1]]
        assert list(row) == sorted(set(row))
        assert plan.columns[plan.diagonal[i]] == i
        for pivot in (j for j in row if j < i):
            a[i, pivot] /= a[pivot, pivot]
            right = plan.columns[plan.diagonal[pivot] + 1 : plan.row_starts[pivot + 1]]
            assert set(right) <= set(row), "an entry that fills has no place"
            a[i, list(right)] -= a[i, pivot] * a[pivot, list(right)]
    return a


@pytest.mark.parametrize(("n", "per_row"), [(1, 1), (5, 1), (12, 2), (30, 3), (30, 30)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_factors_by_the_tables_are_those_of_the_matrix(n: int, per_row: int, seed: int) -> None:
    entries = random_pattern(n, per_row, seed)
    matrix = n * 4.0 * np.eye(n)
    rng = np.random.default_rng(seed)
    for i, j in entries:
        matrix[i, j] += rng.standard_normal()
    plan = eliminate(n, entries)
    assert sorted(plan.pivots) == list(range(n))
    found = factors_by_tables(plan, matrix)
    product = (np.tril(found, -1) + np.eye(n)) @ np.triu(found)
    np.testing.assert_allclose(product, matrix[np.ix_(plan.pivots, plan.pivots)], rtol=1e-12, atol=1e-12)


def test_places_are_those_of_the_entries() -> None:
    entries = random_pattern(20, 3, 4)
    plan = eliminate(20, entries)
    for (row, column), place in zip(entries, plan.places(entries), strict=True):
        i = int(np.searchsorted(plan.row_starts, place, side="right")) - 1
        assert (plan.pivots[i], plan.pivots[plan.columns[place]]) == (row, column)


def test_the_order_keeps_the_fill_small() -> None:
    """An arrow fills completely from its head on, not at all from its tail; a chain does not fill either way."""
    n = 50
    arrow = [(0, i) for i in range(n)] + [(i, 0) for i in range(n)] + [(i, i) for i in range(n)]
    assert len(eliminate(n, arrow).columns) == 3 * n - 2
    chain = [(i, j) for i in range(n) for j in (i - 1, i, i + 1) if 0 <= j < n]
    assert len(eliminate(n, chain).columns) == 3 * n - 2
    grid = 20
    plate = [
        (grid * r + c, grid * s + d)
        for r in range(grid)
        for c in range(grid)
        for s, d in ((r, c), (r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1))
        if 0 <= s < grid and 0 <= d < grid
    ]
    row_by_row = 2 * grid**3  # the band of the natural order, which fills
    assert len(eliminate(grid**2, plate).columns) < 0.7 * row_by_row


def test_a_matrix_without_entries_has_its_diagonal() -> None:
    plan = eliminate(3, [])
    assert plan.row_starts == (0, 1, 2, 3)
    assert sorted(plan.pivots) == [0, 1, 2]
    assert plan.columns == (0, 1, 2)
