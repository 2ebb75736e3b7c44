"""numpy's linear algebra on arrays of symbols, without pivoting at run time: CasADi's solvers of small systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fmu_export.errors import needs
from fmu_export.trace.symbols.arrays import FLOAT, Array, Scalar, elements_of, unwrapped
from fmu_export.trace.symbols.expressions import as_written
from fmu_export.trace.symbols.refusal import refuse

with needs("export"):
    import casadi as ca


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if axis is None and ord in (None, 2, "fro") and (ord != 2 or np.ndim(x) == 1):
        flat = np.ravel(x)
        result = np.sqrt(np.dot(flat, flat))
        return np.reshape(result, (1,) * np.ndim(x)) if keepdims else result
    if (axis is None and np.ndim(x) != 1) or isinstance(axis, tuple):
        refuse("np.linalg.norm of a matrix with ord= can't be traced")
    axis = 0 if axis is None else axis
    if ord in (None, 2):
        return np.sqrt(np.sum(x * x, axis=axis, keepdims=keepdims))
    if ord == 1:
        return np.sum(np.abs(x), axis=axis, keepdims=keepdims)
    if ord in (np.inf, -np.inf):
        return (np.max if ord > 0 else np.min)(np.abs(x), axis=axis, keepdims=keepdims)
    return refuse("np.linalg.norm with this ord= can't be traced")


def _matrix(a: Any) -> Any:
    base, _ = elements_of(a)
    if base.ndim != 2:
        refuse("np.linalg functions of stacks of matrices can't be traced")
    return ca.vertcat(*(ca.horzcat(*(e.sx for e in row)) for row in base))


def _from_matrix(matrix: Any) -> Array:
    dense = ca.densify(matrix)
    base = np.empty(matrix.shape, dtype=object)
    for i, j in np.ndindex(*matrix.shape):
        base[i, j] = Scalar(dense[i, j])
    return Array(base, FLOAT)


def _solve(a: Any, b: Any) -> Any:
    right = b if np.ndim(b) == 2 else np.reshape(b, (-1, 1))
    with as_written(False):
        return np.reshape(_from_matrix(ca.solve(_matrix(a), _matrix(right))), np.shape(b))


def _inverse(a: Any) -> Any:
    with as_written(False):
        return _from_matrix(ca.solve(_matrix(a), ca.SX.eye(len(a))))


def _determinant(a: Any) -> Any:
    with as_written(False):
        return unwrapped(Scalar(ca.det(_matrix(a))), FLOAT)


def _matrix_power(a: Any, n: int) -> Any:
    return np.linalg.matmul(np.eye(len(a)), _repeated(a if n >= 0 else _inverse(a), abs(n)))


def _repeated(a: Any, n: int) -> Any:
    if n == 0:
        return np.eye(len(a))
    half = _repeated(a, n // 2)
    square = a if n == 1 else half @ half
    return square @ a if n % 2 and n > 1 else square


HANDLERS: dict[Any, Callable[..., Any]] = {
    np.linalg.norm: _norm,
    np.linalg.vector_norm: lambda x, axis=None, keepdims=False, ord=2: _norm(
        x if axis is not None else np.ravel(x), ord, axis, keepdims
    ),
    np.linalg.solve: _solve,
    np.linalg.inv: _inverse,
    np.linalg.det: _determinant,
    np.linalg.matrix_power: _matrix_power,
}
