"""Gains alpha and beta that minimise the paper's performance index, section 5.

Equation numbers are those of Han et al. 2021. alpha weighs the robust part and beta the PD part of the torque
(38); beta is in N.m.s/rad, the index J mixes squares of unlike quantities and carries no unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controller_fmu.membership import Sine, psi_moments
from controller_fmu.uniqueness import convexity_margin, reason_for_no_minimum
from fmu_export.errors import ArgumentError, ModelError, needs

with needs("robot"):
    from scipy.optimize import minimize

# Powers of alpha and beta beside rho_0 ... rho_6 and twice rho_7 in (80).
POWER_OF_ALPHA = np.array([0, -2, -2, -1, -1, 0, 0, 2, 0])
POWER_OF_BETA = np.array([0, -3, -2, -2, -1, -1, 1, 0, 2])


class NoMinimum(ModelError, ValueError):
    """J has no minimum over alpha, beta > 0; the message names cause and remedy."""


@cache
def paper_moments() -> tuple[float, float]:
    """D2 and D4 for the paper's membership (91), one value driving both components of psi."""
    return psi_moments(Sine())


@dataclass(frozen=True)
class PerformanceIndex:
    """Performance index J(alpha, beta) of (78)-(81).

    Parameters
    ----------
    mu, nu
        Weights of the steady error and of the control cost, not negative, (78).
    k
        Adaptation constant of (37), positive.
    lambda_3
        min(S_ii, 1), in (0, 1], (54).
    s_a, s_b
        Start value V0 = s_a + s_b beta of the Lyapunov function (42), not negative; `lyapunov_constants`.
    D2, D4
        D[|psi|^2] and D[|psi|^4] of the uncertainty bound, (77); `psi_moments`.

    Raises
    ------
    ArgumentError
        When a value is outside its range.
    """

    mu: float = 1.0
    nu: float = 1.0
    k: float = 12.0
    lambda_3: float = 1.0
    s_a: float = 0.803
    s_b: float = 0.043
    D2: float = field(default_factory=lambda: paper_moments()[0])
    D4: float = field(default_factory=lambda: paper_moments()[1])

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ArgumentError(f"performance index: {name} = {value!r} must be a finite number, 0 or greater")
        if self.k == 0:
            raise ArgumentError("performance index: k = 0 must be greater than 0")
        if not 0 < self.lambda_3 <= 1:
            raise ArgumentError(f"performance index: lambda_3 = {self.lambda_3!r} must be in (0, 1]: give min(S_ii, 1)")
        if not self.D4 > self.D2**2:
            raise ArgumentError(
                f"performance index: D4 = {self.D4!r} must be greater than D2^2 = {self.D2**2!r}; "
                "take both from one membership function wide enough to tell them apart"
            )

    @property
    def rho(self) -> NDArray[np.float64]:
        """Coefficients rho_0 ... rho_7, shape (8,): (81) with s_a, s_b in place of the paper's numbers."""
        mu, k, l3, s_a, s_b, D2, D4 = self.mu, self.k, self.lambda_3, self.s_a, self.s_b, self.D2, self.D4
        return np.array(
            [
                k * (2 * s_a * s_b - s_b * k * D2) / (4 * l3) + mu * k**2 * D4 / 4,
                k**3 / (256 * l3**3),
                mu * k**2 / (64 * l3**2),
                (k**3 * D2 - 2 * s_a * k**2) / (32 * l3**2),
                k**2 * (2 * l3 * mu * D2 - s_b) / (16 * l3**2),
                k * (4 * s_a**2 + k**2 * D4 - 4 * s_a * k * D2) / (16 * l3),
                s_b**2 * k / (4 * l3),
                self.nu,
            ]
        )

    def terms(
        self, alpha: ArrayLike, beta: ArrayLike, order_alpha: int = 0, order_beta: int = 0
    ) -> NDArray[np.float64]:
        """Terms of (80), each differentiated `order_alpha` times by alpha and `order_beta` times by beta.

        Returns
        -------
        ndarray
            Shape (9, ...) over the common shape of alpha and beta; their sum is the derivative of J.
        """
        alpha, beta = np.broadcast_arrays(alpha, beta)
        column = (-1, *(1,) * alpha.ndim)
        coefficient = self.rho[[0, 1, 2, 3, 4, 5, 6, 7, 7]]
        for power, order in ((POWER_OF_ALPHA, order_alpha), (POWER_OF_BETA, order_beta)):
            for i in range(order):
                coefficient = coefficient * (power - i)
        a, b = (POWER_OF_ALPHA - order_alpha).reshape(column), (POWER_OF_BETA - order_beta).reshape(column)
        terms: NDArray[np.float64] = coefficient.reshape(column) * (1.0 * alpha) ** a * (1.0 * beta) ** b
        return terms

    def __call__(self, alpha: ArrayLike, beta: ArrayLike) -> NDArray[np.float64]:
        """J(alpha, beta) of (80), of the common shape of alpha and beta, both positive."""
        values: NDArray[np.float64] = self.terms(alpha, beta).sum(axis=0)
        return values

    def gradient(self, alpha: ArrayLike, beta: ArrayLike) -> NDArray[np.float64]:
        """First derivatives [dJ/dalpha, dJ/dbeta], shape (2, ...).

        They are those of the first lines of (83); its factored dJ/dbeta prints 3 rho_3 alpha beta where the
        derivative has 2 rho_3 alpha beta.
        """
        return np.stack([self.terms(alpha, beta, *order).sum(axis=0) for order in ((1, 0), (0, 1))])

    def hessian(self, alpha: ArrayLike, beta: ArrayLike) -> NDArray[np.float64]:
        """Second derivatives (84) by [alpha, beta], shape (2, 2, ...)."""
        aa, ab, bb = (self.terms(alpha, beta, *order).sum(axis=0) for order in ((2, 0), (1, 1), (0, 2)))
        return np.stack([np.stack([aa, ab]), np.stack([ab, bb])])


@dataclass(frozen=True)
class OptimalGains:
    """Minimum of J over all alpha, beta > 0, with what certifies it.

    Parameters
    ----------
    alpha, beta, J
        Optimal gains and the index there; beta in N.m.s/rad.
    gradient, hessian_eigenvalues
        Of J by (alpha, beta) at the optimum, two numbers each.
    relative_gradient
        Largest gradient component over the sum of its terms' sizes: rounding at a stationary point.
    convexity_margin
        Positive: there is no other stationary point, see `controller_fmu.uniqueness`.
    """

    alpha: float
    beta: float
    J: float
    gradient: tuple[float, float]
    hessian_eigenvalues: tuple[float, float]
    relative_gradient: float
    convexity_margin: float

    @property
    def is_unique_minimum(self) -> bool:
        """Whether the numbers prove the global minimum over all alpha, beta > 0."""
        return self.relative_gradient < 1e-12 and self.hessian_eigenvalues[0] > 0 and self.convexity_margin > 0


def optimal_gains(index: PerformanceIndex, start: tuple[float, float] = (1.0, 1.0)) -> OptimalGains:
    """Minimise the performance index (82).

    Parameters
    ----------
    index
        The index to minimise.
    start
        First (alpha, beta), both positive. The result depends on it in the last digit at most.

    Returns
    -------
    OptimalGains
        The only stationary point of J over all alpha, beta > 0, which is its global minimum.

    Raises
    ------
    NoMinimum
        When J has no minimum; possible only for nu = 0.
    ArgumentError
        When `start` is not positive, or when the numbers are too far apart for double precision.
    """
    if not (np.all(np.isfinite(start)) and min(start) > 0):
        raise ArgumentError(f"optimal gains: start = {start!r} must hold two positive numbers, alpha and beta")
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            if reason := reason_for_no_minimum(index.rho):
                raise NoMinimum(f"no optimal gains for mu = {index.mu!r}, nu = {index.nu!r}: {reason}; give nu > 0")
            gains = _certificate(index, *np.exp(_newton(index, _descend(index, np.log(start)))).tolist())
    except (ArithmeticError, np.linalg.LinAlgError):
        gains = None
    if gains is None or not gains.is_unique_minimum:
        raise ArgumentError(
            f"optimal gains: the values of {index} lie too far apart for double precision; bring them closer"
        )
    return gains


def lyapunov_constants(M: ArrayLike, theta_e: ArrayLike, omega_e: ArrayLike, S: ArrayLike) -> tuple[float, float]:
    """s_a and s_b in V0 = s_a + s_b beta, the start value of the tracking part of (42).

    V0 of (74) has the part of psi, k/2 |psi(0) - psi_bar|^2, too; add it to s_a. With k = 12, psi(0) = 0 and
    psi_bar = (0.25, 0.25) it is 0.75, most of the paper's 0.803.

    Parameters
    ----------
    M
        Mass matrix in the active joint space (27), symmetric, shape (3, 3), kg m^2.
    theta_e, omega_e
        Tracking error (32) of the active joints and its rate, shape (3,), rad and rad/s.
    S
        Diagonal of the matrix S, positive, shape (3,), 1/s.

    Returns
    -------
    tuple of float
        s_a = s^T M s / 2 with s = omega_e + S theta_e in J, and s_b = theta_e^T S theta_e in rad^2/s.

    Raises
    ------
    ArgumentError
        When a shape is wrong or a number is not finite.
    """
    arrays = {"M": np.asarray(M, float), "theta_e": np.asarray(theta_e, float)}
    arrays |= {"omega_e": np.asarray(omega_e, float), "S": np.asarray(S, float)}
    for name, array in arrays.items():
        shape = (3, 3) if name == "M" else (3,)
        if array.shape != shape or not np.all(np.isfinite(array)):
            raise ArgumentError(
                f"Lyapunov constants: {name} of shape {array.shape} must be finite and of shape {shape}"
            )
    mass, error, rate, gain = arrays.values()
    s = rate + gain * error
    return float(s @ mass @ s / 2), float(error @ (gain * error))


def _certificate(index: PerformanceIndex, alpha: float, beta: float) -> OptimalGains:
    """Evaluate J and what tells whether (alpha, beta) is its minimum."""
    gradient = index.gradient(alpha, beta)
    sizes = np.array([np.abs(index.terms(alpha, beta, *order)).sum() for order in ((1, 0), (0, 1))])
    low, high = np.linalg.eigvalsh(index.hessian(alpha, beta)).tolist()
    return OptimalGains(
        alpha=alpha,
        beta=beta,
        J=float(index(alpha, beta)),
        gradient=(float(gradient[0]), float(gradient[1])),
        hessian_eigenvalues=(low, high),
        relative_gradient=float(np.max(np.abs(gradient) / sizes)),
        convexity_margin=convexity_margin(index.rho),
    )


def _log_derivatives(
    index: PerformanceIndex, x: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """J, gradient (2,) and Hessian (2, 2) by x = (log alpha, log beta), which keeps the gains positive."""
    terms = index.terms(*np.exp(x))
    powers = np.stack([POWER_OF_ALPHA, POWER_OF_BETA])
    return float(terms.sum()), powers @ terms, (powers * terms) @ powers.T


def _descend(index: PerformanceIndex, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Point near the minimum, from any start: log J, which is flat enough for a trust region, by x = log gains."""

    def log_J(x: NDArray[np.float64]) -> float:
        return float(np.log(_log_derivatives(index, x)[0]))

    def gradient(x: NDArray[np.float64]) -> NDArray[np.float64]:
        J, first, _ = _log_derivatives(index, x)
        return first / J

    def hessian(x: NDArray[np.float64]) -> NDArray[np.float64]:
        J, first, second = _log_derivatives(index, x)
        return second / J - np.outer(first, first) / J**2

    options = {"gtol": 1e-8, "maxiter": 1000}
    found: NDArray[np.float64] = minimize(
        log_J, start, jac=gradient, hess=hessian, method="trust-ncg", options=options
    ).x
    return found


def _newton(index: PerformanceIndex, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Polish a point near the minimum until rounding stops the steps from shrinking."""
    last = np.inf
    while True:
        _, gradient, hessian = _log_derivatives(index, x)
        step = np.linalg.solve(hessian, gradient)
        size = np.abs(step).max()
        if not size < last / 2:
            return x
        x, last = x - step, size
