"""Stationary points of the performance index by elimination: all there are, not one that a search comes to."""

import numpy as np
from scipy.optimize import brentq


def stationary_points(rho):
    """All zeros of the gradient (83) with 1e-4 < beta < 1e4, by elimination of alpha; needs rho_7 > 0.

    dJ/dalpha = 0 reads 2 rho_7 beta^3 alpha^4 - (rho_4 beta^2 + rho_3 beta) alpha - 2 rho_2 beta - 2 rho_1
    = 0, which has one positive root (one change of sign). dJ/dbeta along it is scanned for changes of sign.
    """

    def alpha_of(beta):
        quartic = [
            2 * rho[7] * beta**3,
            0,
            0,
            -rho[4] * beta**2 - rho[3] * beta,
            -2 * rho[2] * beta - 2 * rho[1],
        ]
        roots = np.roots(quartic)
        (positive,) = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
        return positive

    def slope(log_beta):
        b = np.exp(log_beta)
        a = alpha_of(b)
        steady = -3 * rho[1] / (a**2 * b**4) - 2 * rho[2] / (a**2 * b**3) - 2 * rho[3] / (a * b**3)
        return steady - rho[4] / (a * b**2) - rho[5] / b**2 + rho[6] + 2 * rho[7] * b

    grid = np.linspace(np.log(1e-4), np.log(1e4), 801)
    signs = np.sign([slope(x) for x in grid])
    betas = [np.exp(brentq(slope, grid[i], grid[i + 1], xtol=1e-13)) for i in np.flatnonzero(np.diff(signs))]
    return [(alpha_of(beta), beta) for beta in betas]
