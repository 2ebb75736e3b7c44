"""Why the performance index (80) has at most one stationary point, and when it has one.

The paper argues from (85), that the Hessian in (alpha, beta) is positive definite everywhere. That holds when
rho_1 ... rho_5 and rho_7 are not negative, since every term of (80) is then convex; it fails in general
(rho_4 < 0 for a small mu, rho_3 < 0 for a large initial error). The conclusion holds all the same, by another
route. With u = 1/(alpha beta) in place of alpha, (80) reads

    J = rho_0 + (rho_1 u^2 + rho_3 u + rho_5)/beta + rho_2 u^2 + rho_4 u + rho_6 beta
        + rho_7 (1/(u beta)^2 + beta^2).

- (rho_1 u^2 + rho_3 u + rho_5)/beta, a quadratic over a linear function, is strictly convex in (u, beta) when
  rho_1 > 0 and 4 rho_1 rho_5 > rho_3^2.
- rho_2 u^2 and rho_7 (...) are convex when rho_2 >= 0 and rho_7 >= 0.
- The other terms are linear in (u, beta): rho_0, rho_4 and rho_6 may have any sign.

(alpha, beta) -> (u, beta) maps the positive quadrant smoothly and one to one onto itself, so stationary
points correspond: there is at most one over *all* alpha, beta > 0, and it is the global minimum. By (81),
4 rho_1 rho_5 - rho_3^2 = k^6 (D4 - D2^2)/(1024 lambda_3^4): positive for every fuzzy number of some width.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def convexity_margin(rho: NDArray[np.float64]) -> float:
    """How far (80) is from losing its convexity in (1/(alpha beta), beta).

    Parameters
    ----------
    rho
        Coefficients rho_0 ... rho_7 of (80), shape (8,).

    Returns
    -------
    float
        1 - rho_3^2/(4 rho_1 rho_5), at most 1: positive proves that there is no second stationary point.
        Minus infinity when a coefficient has a sign that no index (78) gives.
    """
    _, rho_1, rho_2, rho_3, _, rho_5, _, rho_7 = rho
    if not (rho_1 > 0 and rho_5 > 0 and rho_2 >= 0 and rho_7 >= 0):
        return -np.inf
    return float(1 - (rho_3 / rho_1) * (rho_3 / rho_5) / 4)


def reason_for_no_minimum(rho: NDArray[np.float64]) -> str | None:
    """Why J has no minimum over alpha, beta > 0, or None when it has one.

    Parameters
    ----------
    rho
        Coefficients rho_0 ... rho_7 by (81), shape (8,), with a positive `convexity_margin`.

    Notes
    -----
    J_1 and J_2 of (78) are means of squares. With nu = rho_7 > 0 they and nu (alpha^2 + beta^2) grow without
    bound towards every edge of the quadrant, so the minimum exists. With nu = 0 the edge u = 0 (alpha
    infinite) costs nothing, and J is least on it at beta = sqrt(rho_5/rho_6). As J is convex in (u, beta), a
    minimum inside exists exactly when J falls from there into the quadrant: dJ/du = rho_4 + rho_3/beta < 0.
    """
    _, _, rho_2, rho_3, rho_4, rho_5, rho_6, rho_7 = rho
    if rho_7 > 0:
        return None
    if rho_2 == 0:
        return "with mu = nu = 0 steady error and gains cost nothing, and J falls towards 0 as beta grows"
    if rho_4 + rho_3 * np.sqrt(rho_6 / rho_5) >= 0:
        return "with nu = 0 the gains cost nothing, and J falls as alpha grows without end"
    return None
