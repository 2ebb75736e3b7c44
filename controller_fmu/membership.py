"""Membership functions of fuzzy numbers, and the D-operation that averages over them.

Equation numbers are those of Han et al. 2021. A membership W(v) in [0, 1] says how far the value v belongs
to a fuzzy number; the D-operation (77) is the mean of a function weighted with it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmu_export.errors import ModelError, needs

with needs("robot"):
    from scipy.integrate import quad


class MembershipError(ModelError, ValueError):
    """A membership function that cannot be built, read or averaged over; the message names the remedy."""


class Membership(ABC):
    """Weight W(v) of a fuzzy number: in [0, 1] on a finite support, zero outside it."""

    @property
    @abstractmethod
    def breakpoints(self) -> tuple[float, ...]:
        """Ascending points between which W is smooth; the first and the last bound the support."""

    @abstractmethod
    def _inside(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        """W(v) for v within the support."""

    @property
    def support(self) -> tuple[float, float]:
        """Lower and upper end of the values that can belong to the fuzzy number."""
        return self.breakpoints[0], self.breakpoints[-1]

    def __call__(self, v: ArrayLike) -> NDArray[np.float64]:
        """W(v), of the shape of v."""
        v = np.asarray(v, dtype=float)
        lower, upper = self.support
        return np.where((lower <= v) & (v <= upper), self._inside(v), 0.0)


@dataclass(frozen=True)
class Sine(Membership):
    """Half-wave of a sine on [lower, upper]; default: the paper's sin(2 pi v) on [0, 0.5], (88), (91)."""

    lower: float = 0.0
    upper: float = 0.5

    def __post_init__(self) -> None:
        _require_ascending("sine", lower=self.lower, upper=self.upper)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Ends of the half-wave."""
        return self.lower, self.upper

    def _inside(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        width = self.upper - self.lower
        phase = np.divide(v - self.lower, width, out=np.zeros_like(v), where=width > 0)
        # Rounding of pi leaves sin(pi) a little off zero; a membership is never negative.
        return np.maximum(np.sin(np.pi * phase), 0.0)


class _PiecewiseLinear(Membership):
    """Straight lines through (breakpoints, values)."""

    @property
    @abstractmethod
    def values(self) -> tuple[float, ...]:
        """W at the breakpoints."""

    @cached_property
    def _lines(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return np.array(self.breakpoints), np.array(self.values)

    def _inside(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        # The slope of an edge narrower than about 1e-308 overflows.
        return np.maximum(np.minimum(np.interp(v, *self._lines), 1.0), 0.0)


@dataclass(frozen=True)
class Triangle(_PiecewiseLinear):
    """Triangle of height 1 at `peak`; an edge may be vertical."""

    lower: float
    peak: float
    upper: float

    def __post_init__(self) -> None:
        _require_ascending("triangle", lower=self.lower, peak=self.peak, upper=self.upper)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Corners of the triangle."""
        return self.lower, self.peak, self.upper

    @property
    def values(self) -> tuple[float, ...]:
        """W at the corners."""
        return 0.0, 1.0, 0.0


@dataclass(frozen=True)
class Trapezoid(_PiecewiseLinear):
    """Trapezoid of height 1 from `left` to `right`; vertical edges make it a rectangle (an interval)."""

    lower: float
    left: float
    right: float
    upper: float

    def __post_init__(self) -> None:
        _require_ascending("trapezoid", lower=self.lower, left=self.left, right=self.right, upper=self.upper)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Corners of the trapezoid."""
        return self.lower, self.left, self.right, self.upper

    @property
    def values(self) -> tuple[float, ...]:
        """W at the corners."""
        return 0.0, 1.0, 1.0, 0.0


@dataclass(frozen=True)
class Gaussian(Membership):
    """Bell exp(-((v - mean)/sigma)^2 / 2), cut off outside [lower, upper]."""

    mean: float
    sigma: float
    lower: float
    upper: float

    @classmethod
    def within(cls, mean: float, sigma: float, n_sigmas: float = 4.0) -> Gaussian:
        """Bell cut off at `n_sigmas` on either side of the mean."""
        return cls(mean, sigma, mean - n_sigmas * sigma, mean + n_sigmas * sigma)

    def __post_init__(self) -> None:
        _require_finite("gaussian", mean=self.mean, sigma=self.sigma)
        if self.sigma <= 0:
            raise MembershipError(f"gaussian membership: sigma = {self.sigma!r} must be greater than 0")
        _require_ascending("gaussian", lower=self.lower, upper=self.upper)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Ends, and marks around the bell so that quadrature finds it however wide the support is."""
        marks = (self.mean + n * self.sigma for n in (-8.0, -3.0, 0.0, 3.0, 8.0))
        return self.lower, *(m for m in marks if self.lower < m < self.upper), self.upper

    def _inside(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.exp(-0.5 * ((v - self.mean) / self.sigma) ** 2)


@dataclass(frozen=True)
class PointTable(_PiecewiseLinear):
    """Straight lines through given points (v, W), for example from measured data."""

    points: tuple[float, ...]
    weights: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", tuple(map(float, self.points)))
        object.__setattr__(self, "weights", tuple(map(float, self.weights)))
        if len(self.points) != len(self.weights) or len(self.points) < 2:
            raise MembershipError(
                f"points membership: {len(self.points)} points and {len(self.weights)} weights given; "
                "give at least two points and one weight for each"
            )
        _require_finite("points", **{f"point {i + 1}": v for i, v in enumerate(self.points)})
        for first, second in pairwise(self.points):
            if first >= second:
                raise MembershipError(f"points membership: v = {second!r} after {first!r}; points must increase")
        for v, weight in zip(self.points, self.weights, strict=True):
            if not 0 <= weight <= 1:
                raise MembershipError(f"points membership: weight {weight!r} at v = {v!r} must be in [0, 1]")

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """The given points."""
        return self.points

    @property
    def values(self) -> tuple[float, ...]:
        """The given weights."""
        return self.weights


def d_operation(f: Callable[[float], float], membership: Membership) -> float:
    """Mean of a function of a fuzzy number, the D-operation (77).

    Parameters
    ----------
    f
        Real function of one value v of the fuzzy number.
    membership
        Weight W(v) of each value.

    Returns
    -------
    float
        Integral of f W over the support divided by the integral of W, good to about 1e-12 relative.

    Raises
    ------
    MembershipError
        When W has no area, or when the quadrature of f W does not converge.
    """
    area, _ = _integral(lambda v: float(membership(v)), membership)
    if not area > 0:
        raise MembershipError(
            f"{membership} has no area to take a mean over: widen its support or give it a positive weight"
        )
    try:
        weighted, error = _integral(lambda v: f(v) * float(membership(v)), membership)
        # f W may change sign and cancel, so the error is judged against the integral of |f W|.
        size, _ = _integral(lambda v: abs(f(v)) * float(membership(v)), membership)
    except OverflowError:
        weighted = error = size = np.inf
    if not error <= 1e-9 * size < np.inf:
        raise MembershipError(
            f"the D-operation over {membership} did not converge: "
            "give a function that is finite and piecewise smooth on the support"
        )
    return weighted / area


def psi_moments(membership: Membership, shared: bool = True, components: int = 2) -> tuple[float, float]:
    """D2 = D[|psi|^2] and D4 = D[|psi|^4] of the uncertainty bound psi, as (81) needs them.

    Parameters
    ----------
    membership
        Membership of every component of psi.
    shared
        True: one value v drives all n components, so |psi|^2 = n v^2 (the only reading that gives the paper's
        Table 1). False: the components vary independently of one another.
    components
        Number n of components; (89) has two.

    Returns
    -------
    tuple of float
        D2 and D4; dimensionless.

    Raises
    ------
    MembershipError
        As `d_operation`; or when `components` is less than 1.
    """
    if components < 1:
        raise MembershipError(f"psi has {components} components; give 1 or more")
    n = components
    v2 = d_operation(lambda v: v**2, membership)
    v4 = d_operation(lambda v: v**4, membership)
    return n * v2, n**2 * v4 if shared else n * v4 + n * (n - 1) * v2**2


def membership_from_text(text: str) -> Membership:
    """Membership written as ``name`` or ``name:number,number,...``, for the command line.

    Parameters
    ----------
    text
        ``sine``, ``sine:lower,upper``, ``triangle:lower,peak,upper``, ``trapezoid:lower,left,right,upper``,
        ``gaussian:mean,sigma`` (cut off at 4 sigma), ``gaussian:mean,sigma,lower,upper`` or
        ``points:v0=w0,v1=w1,...``.

    Raises
    ------
    MembershipError
        When the name is unknown, a number does not parse or is missing, or the membership itself is refused.
    """
    name, _, rest = text.strip().partition(":")
    name = name.strip().lower()
    fields = [field.strip() for field in rest.split(",")] if rest.strip() else []
    if name == "points":
        pairs = [field.split("=") for field in fields]
        if any(len(pair) != 2 for pair in pairs):
            raise MembershipError(f"membership {text!r}: write every point as v=w, as in points:0=0,0.25=1,0.5=0")
        return PointTable(*(tuple(_number(pair[i], text) for pair in pairs) for i in (0, 1)))
    if name not in _FORMS:
        raise MembershipError(f"unknown membership {name!r} in {text!r}; known: {', '.join([*_FORMS, 'points'])}")
    forms = _FORMS[name]
    if len(fields) not in forms:
        counts = " or ".join(str(count) for count in sorted(forms))
        raise MembershipError(f"membership {text!r}: {name} takes {counts} numbers, not {len(fields)}")
    return forms[len(fields)](*(_number(field, text) for field in fields))


_FORMS: dict[str, dict[int, Callable[..., Membership]]] = {
    "sine": {0: Sine, 2: Sine},
    "triangle": {3: Triangle},
    "trapezoid": {4: Trapezoid},
    "gaussian": {2: Gaussian.within, 4: Gaussian},
}


def _number(field: str, text: str) -> float:
    try:
        return float(field)
    except ValueError:
        raise MembershipError(f"membership {text!r}: {field!r} is not a number") from None


def _require_finite(name: str, **numbers: float) -> None:
    for label, number in numbers.items():
        if not np.isfinite(number):
            raise MembershipError(f"{name} membership: {label} = {number!r} must be a finite number")


def _require_ascending(name: str, **numbers: float) -> None:
    _require_finite(name, **numbers)
    for (first, low), (second, high) in pairwise(numbers.items()):
        if low > high:
            raise MembershipError(
                f"{name} membership: {first} = {low!r} is above {second} = {high!r}; give {' <= '.join(numbers)}"
            )


def _integral(f: Callable[[float], float], membership: Membership) -> tuple[float, float]:
    """Integral of f over the support and its error estimate; one quadrature for each smooth piece."""
    total, error = 0.0, 0.0
    for lower, upper in pairwise(membership.breakpoints):
        # With full_output the verdict on convergence is left to the caller, who knows the size that matters.
        value, estimate, *_ = quad(f, lower, upper, epsabs=0.0, epsrel=1e-13, full_output=1)
        total, error = total + value, error + estimate
    return total, error
