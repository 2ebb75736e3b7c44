"""A signal, its reference and its band as curves for a page, and where in the band the signal is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.page.encoding import block, column_of
from cosim.regression.comparison import SignalComparison
from cosim.regression.funnel import Curve

#: Of a curve the first, smallest, largest and last points of so many pieces of time are kept: of signals that are off,
#: and of others.
_PIECES, _PIECES_WITHIN = 1000, 250

#: The place in the band is shown up to so many half widths of it.
_MOST_HALVES = 4.0

#: Curves in the order of their columns in the page, each its times (s) and its values.
CURVES = ("lower", "upper", "reference", "result", "place", "outside")


@dataclass(frozen=True)
class Picture:
    """What the script of a page draws of a signal.

    Attributes
    ----------
    curves : mapping
        Of `CURVES`; `place` is the relative place in the band, -1 at the lower bound and 1 at the upper one, cut off at
        `limit`, and `outside` that of the values that are off.
    limit : float
        What the axis of the place reaches to.
    data : mapping
        For the script: name, unit, limit and the columns of the block.
    block : bytes
        The curves, deflated.
    """

    curves: dict[str, Curve]
    limit: float
    data: dict[str, Any]
    block: bytes


def picture(signal: SignalComparison) -> Picture:
    """Curves of a signal, without points that can't be seen."""
    place = _place(signal)
    seen = place[np.isfinite(place)]
    limit = min(max(1.4, 1.15 * float(np.abs(seen).max(initial=0.0))), _MOST_HALVES)
    time = signal.result.time
    cut = np.clip(np.nan_to_num(place, nan=limit), -limit, limit)
    outside = np.abs(np.nan_to_num(place, nan=np.inf)) > 1.0 if signal.finding else np.zeros(len(place), bool)
    whole = {
        "lower": signal.lower,
        "upper": signal.upper,
        "reference": signal.reference,
        "result": signal.result,
        "place": Curve(time, cut),
        "outside": Curve(time[outside], cut[outside]),
    }
    curves = {name: _thinned(curve, _PIECES if signal.finding else _PIECES_WITHIN) for name, curve in whole.items()}
    columns = [column_of(array) for name in CURVES for array in (curves[name].time, curves[name].values)]
    data = {
        "name": signal.name,
        "unit": "" if signal.unit == "1" else signal.unit,
        "limit": limit,
        "finding": signal.finding,
        "columns": [{"rows": len(c.numbers), "offset": c.offset, "scale": c.scale} for c in columns],
    }
    return Picture(curves, limit, data, block([column.numbers for column in columns]))


def _place(signal: SignalComparison) -> np.ndarray:
    """Relative position of a result in its band: -1 at the lower bound, 1 at the upper one."""
    time, values = signal.result.time, signal.result.values
    low, high = (np.interp(time, c.time, c.values) for c in (signal.lower, signal.upper))
    with np.errstate(divide="ignore", invalid="ignore"):
        place = (values - (low + high) / 2.0) / ((high - low) / 2.0)
    # a band without width, or one that is not a number where the result is none either
    return np.where(signal.distance == 0.0, np.where(np.isfinite(place), place, 0.0), place)


def _thinned(curve: Curve, pieces: int) -> Curve:
    """A curve without the points that can't be seen: of each piece of time the first, smallest, largest and last."""
    if len(curve.time) <= 4 * pieces:
        return curve
    kept: list[int] = []
    for piece in np.array_split(np.arange(len(curve.time)), pieces):
        values = curve.values[piece]
        finite = piece[np.isfinite(values)]
        extremes = [finite[f(curve.values[finite])] for f in (np.argmin, np.argmax) if len(finite)]
        gaps = piece[~np.isfinite(values)][:1]
        kept += sorted({piece[0], piece[-1], *extremes, *gaps})
    return Curve(curve.time[kept], curve.values[kept])
