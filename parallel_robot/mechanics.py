"""The Udwadia-Kalaba equation (1)-(10) for any mechanical system with constraints.

M q'' = Q + Q_c moves a system of n coordinates whose m constraints are A(q, q', t) q'' = b(q, q', t) in second-order
form (6): holonomic ones differentiated twice, nonholonomic ones once, time-dependent ones included. Equation numbers
are those of Han et al. 2021; the equation is that of Udwadia and Kalaba 1992, doi 10.1098/rspa.1992.0158.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fmu_export.errors import ArgumentError
from plant_fmu.symmetric import solve_positive_definite, solve_semidefinite

Array = Any


class ConstrainedMotion(NamedTuple):
    """Accelerations q'' (n,) and the force of the constraints Q_c (n,), which does no work on virtual displacements."""

    acceleration: Array
    force: Array


def udwadia_kalaba(M: Array, Q: Array, A: Array, b: Array) -> ConstrainedMotion:
    """Accelerations and constraint force of a constrained system, (8)-(10).

    The constraint force is Q_c = M^(1/2) B^+ (b - A a), with a = M^-1 Q and B = A M^(-1/2). Since B^+ = B^T (B B^T)^+,
    it is A^T (A M^-1 A^T)^+ (b - A a), which is what is computed: without square roots of matrices, and for dependent
    constraints by an elimination that passes over those which follow from the others. Numbers and symbols go through
    the same lines, so that a model that calls it can be traced.

    Parameters
    ----------
    M : array (n, n)
        Mass matrix, symmetric and positive definite.
    Q : array (n,)
        Generalised forces besides those of the constraints; Coriolis and gyroscopic terms belong to them, with their
        sign as in M q'' = Q.
    A : array (m, n)
        Constraint matrix of (6), of any rank; m may be 0.
    b : array (m,)
        Right side of (6). For a solution it has to be consistent (Assumption 1): see `inconsistency`.

    Returns
    -------
    ConstrainedMotion
        `acceleration` (n,) and `force` (n,), in the units of Q over M and of Q.

    Raises
    ------
    ArgumentError
        The shapes do not fit.

    Examples
    --------
    A pendulum of 2 kg and 0.5 m in Cartesian coordinates, held out horizontally: x x'' + y y'' = -x'^2 - y'^2.

    >>> import numpy as np
    >>> M, Q = 2.0 * np.eye(2), np.array([0.0, -2.0 * 9.81])
    >>> motion = udwadia_kalaba(M, Q, np.array([[0.5, 0.0]]), np.array([0.0]))
    >>> motion.acceleration
    array([ 0.  , -9.81])
    """
    n, m = len(Q), len(b)
    for what, found, expected in (("M", np.shape(M), (n, n)), ("A", np.shape(A), (m, n))):
        if tuple(found) != expected:
            raise ArgumentError(
                f"udwadia_kalaba: {what} has shape {tuple(found)}; {expected} fits Q ({n},) and b ({m},)"
            )
    free = solve_positive_definite(M, Q)
    if m == 0:
        return ConstrainedMotion(free, 0.0 * free)
    over_M = np.stack([solve_positive_definite(M, A[i]) for i in range(m)])  # A M^-1
    multipliers = solve_semidefinite(A @ over_M.T, b - A @ free)
    force = A.T @ multipliers
    return ConstrainedMotion(free + over_M.T @ multipliers, force)


def inconsistency(M: Array, A: Array, b: Array) -> Array:
    """How far a constraint equation is from having a solution: Assumption 1 of the paper.

    Parameters
    ----------
    M : array (n, n)
        Mass matrix, symmetric and positive definite.
    A : array (m, n)
        Constraint matrix.
    b : array (m,)
        Right side of A q'' = b.

    Returns
    -------
    array (m,)
        What is left of A q'' = b, 0 up to rounding for a consistent equation. Of one without a solution, equations that
        come first are met, and those which contradict them are not.
    """
    over_M = np.stack([solve_positive_definite(M, A[i]) for i in range(len(b))])
    return b - A @ (over_M.T @ solve_semidefinite(A @ over_M.T, b))
