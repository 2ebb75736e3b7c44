"""Gaussian elimination of a sparse matrix, planned from its pattern: where the factors have entries, in which order."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from fmu_export.errors import needs

with needs("export"):
    import casadi as ca


@dataclass(frozen=True)
class Elimination:
    """The LU factors of a square matrix, row by row in the order of elimination, L below the diagonal and U from it.

    Parameters
    ----------
    pivots : tuple of int
        Row and column of the matrix that are eliminated first, second, ...
    row_starts : tuple of int
        Where each row begins among the entries of the factors; their number at the end.
    columns : tuple of int
        Column of each entry, counted in the order of elimination; ascending in a row.
    diagonal : tuple of int
        Where the diagonal entry of each row is.
    """

    pivots: tuple[int, ...]
    row_starts: tuple[int, ...]
    columns: tuple[int, ...]
    diagonal: tuple[int, ...]

    def places(self, entries: Iterable[tuple[int, int]]) -> list[int]:
        """Where entries (row, column) of the matrix are among those of the factors."""
        position = {pivot: i for i, pivot in enumerate(self.pivots)}
        place = {
            (i, self.columns[k]): k
            for i in range(len(self.pivots))
            for k in range(self.row_starts[i], self.row_starts[i + 1])
        }
        return [place[position[row], position[column]] for row, column in entries]


def eliminate(n: int, entries: Iterable[tuple[int, int]]) -> Elimination:
    """Plan the elimination along the diagonal, in an order with little fill and without exchange of rows.

    Parameters
    ----------
    n : int
        Rows and columns of the matrix.
    entries : iterable of (int, int)
        Row and column of what is not zero; the diagonal need not be among them.
    """
    entries = list(entries)
    rows, columns = [r for r, _ in entries], [c for _, c in entries]
    pattern = ca.Sparsity.triplet(n, n, rows, columns)
    # approximate minimum degree takes a symmetric pattern
    pivots = [int(i) for i in pattern.unite(pattern.T).unite(ca.Sparsity.diag(n)).amd()]
    position = {pivot: i for i, pivot in enumerate(pivots)}
    patterns = [1 << i for i in range(n)]  # of each row, bit by column
    for row, column in entries:
        patterns[position[row]] |= 1 << position[column]
    for i in range(n):
        before = (1 << i) - 1  # the columns left of the diagonal
        done = 0
        while left := patterns[i] & before & ~done:
            pivot = (left & -left).bit_length() - 1
            done = (1 << pivot + 1) - 1
            patterns[i] |= patterns[pivot] & ~done  # the row minus a multiple of the pivot's
    return _layout(pivots, patterns)


def _layout(pivots: list[int], patterns: list[int]) -> Elimination:
    row_starts, columns, diagonal = [0], list[int](), list[int]()
    for i, pattern in enumerate(patterns):
        row = [j for j, bit in enumerate(reversed(f"{pattern:b}")) if bit == "1"]
        diagonal.append(len(columns) + row.index(i))
        columns += row
        row_starts.append(len(columns))
    return Elimination(tuple(pivots), tuple(row_starts), tuple(columns), tuple(diagonal))
