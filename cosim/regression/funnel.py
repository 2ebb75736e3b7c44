"""The funnel around a curve that may be late or early: pyfunnel of LBNL (https://github.com/lbl-srg/funnel)."""

from __future__ import annotations

from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from cosim.errors import CosimError, needs
from cosim.files.temporary import TemporaryFolder


class FunnelError(CosimError):
    """There is no funnel: its library is missing or refuses the curves."""


@dataclass(frozen=True)
class Curve:
    """Times (n,) in s that don't decrease, and values (n,)."""

    time: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Funnel:
    """Lower and upper bound, and how far each point of the result is beyond them (0 inside)."""

    lower: Curve
    upper: Curve
    beyond: np.ndarray


def funnel(reference: Curve, result: Curve, time_shift: float, allowed: float) -> Funnel:
    """Compare a result with the funnel around its reference.

    The funnel is what rectangles of half width `time_shift` and half height `allowed` cover when they run along the
    reference, which is a polygon. Both curves must be finite and begin and end at the same times.

    Parameters
    ----------
    reference, result : Curve
    time_shift : float
        In s, greater than 0.
    allowed : float
        In the unit of the values, greater than 0.

    Raises
    ------
    FunnelError
        pyfunnel has no library for this platform, or refuses the curves.
    MissingExtra
        pyfunnel is not installed.
    """
    with needs("regression"):
        import pyfunnel
    middle = (reference.values.max() + reference.values.min()) / 2.0
    # in units of the tolerances, for pyfunnel widens any below 1e-10
    ends = reference.time[[0, -1]]
    times = [np.clip(curve.time, *ends) / time_shift for curve in (reference, result)]
    values = [(curve.values - middle) / allowed for curve in (reference, result)]
    # it asks for equal ends to the last bit
    times[1][0], times[1][-1] = times[0][0], times[0][-1]
    with TemporaryFolder() as folder, redirect_stdout(StringIO()) as said:
        try:
            status = pyfunnel.compareAndReport(times[0], values[0], times[1], values[1], folder, atolx=1.0, atoly=1.0)
        except Exception as error:
            raise FunnelError(f"pyfunnel can't be used: {' '.join(str(error).split())}") from error
        if status:
            raise FunnelError(f"pyfunnel refuses the curves: {' '.join(said.getvalue().split())}")
        lower, upper, errors = (
            _columns(Path(folder) / f"{name}.csv") for name in ("lowerBound", "upperBound", "errors")
        )
    low, high = (Curve(x * time_shift, y * allowed + middle) for x, y in (lower, upper))
    return Funnel(low, high, np.abs(errors[1]) * allowed)


def _columns(path: Path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2).T
