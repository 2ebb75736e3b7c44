"""A signal, its reference and its band as an SVG element, drawn at a width that a phone can show."""

from __future__ import annotations

import math
from html import escape
from itertools import pairwise

import numpy as np

from cosim.regression.comparison import SignalComparison
from cosim.regression.funnel import Curve

_WIDTH, _LEFT, _RIGHT = 440.0, 72.0, 8.0
#: Top and height of the two panels: the curves, and the place in the band.
_CURVES = (20.0, 140.0)
_PLACE = (176.0, 56.0)
_HEIGHT = 272.0

#: Points kept of a curve: the extremes of so many pieces of time.
_PIECES = 300

#: The lower panel shows at most so many half widths of the band.
_MOST_HALVES = 4.0


def plot(signal: SignalComparison) -> str:
    """Upper panel: reference, result and band; lower panel: where in the band the result is (-1 to 1)."""
    ends = (signal.reference.time[0], signal.reference.time[-1])
    curves = (signal.lower, signal.upper, signal.reference, signal.result)
    values = np.concatenate([c.values[np.isfinite(c.values)] for c in curves])
    low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
    pad = 0.06 * (high - low) or abs(low) * 1e-3 or 1.0
    upper = _Panel(*_CURVES, ends, (low - pad, high + pad))
    place = _place(signal)
    seen = place[np.isfinite(place)]
    limit = min(max(1.4, 1.15 * float(np.abs(seen).max(initial=0.0))), _MOST_HALVES)
    lower = _Panel(*_PLACE, ends, (-limit, limit))
    shown = Curve(signal.result.time, np.clip(np.nan_to_num(place, nan=limit), -limit, limit))
    unit = f" ({signal.unit})" if signal.unit not in ("", "1") else ""
    label = f"{signal.name}{unit} over time: {signal.finding or 'the result stays within the band of the reference'}"
    outside = np.abs(np.nan_to_num(place, nan=np.inf)) > 1.0 if signal.finding else np.zeros(len(place), bool)
    marks = _thinned(Curve(signal.result.time[outside], shown.values[outside]))
    lines = [
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{escape(label)}">',
        *upper.frame(),
        f'<path class="band" d="{upper.area(signal.lower, signal.upper)}"/>',
        f'<path class="reference" d="{upper.path(signal.reference)}"/>',
        f'<path class="result" d="{upper.path(signal.result)}"/>',
        *lower.frame([-1.0, 1.0]),
        f'<path class="band" d="{lower.area(_level(-1.0, ends), _level(1.0, ends))}"/>',
        f'<path class="result whole" d="{lower.path(shown)}"/>',
        *(
            f'<circle class="outside" cx="{lower.x(t):.1f}" cy="{lower.y(v):.1f}" r="2"/>'
            for t, v in zip(*marks, strict=True)
        ),
        *lower.times(),
        f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2:g}" y="{_HEIGHT - 6:g}" text-anchor="middle">t (s)</text>',
        "</svg>",
    ]
    return "\n".join(lines)


def _place(signal: SignalComparison) -> np.ndarray:
    """Relative position of a result in its band: -1 at the lower bound, 1 at the upper one."""
    time, values = signal.result.time, signal.result.values
    low, high = (np.interp(time, c.time, c.values) for c in (signal.lower, signal.upper))
    with np.errstate(divide="ignore", invalid="ignore"):
        place = (values - (low + high) / 2.0) / ((high - low) / 2.0)
    # a band without width, or one that is not a number where the result is none either
    return np.where(signal.distance == 0.0, np.where(np.isfinite(place), place, 0.0), place)


def _level(value: float, ends: tuple[float, float]) -> Curve:
    return Curve(np.array(ends), np.full(2, value))


def _thinned(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """A curve without the points that can't be seen: of each piece of time the first, smallest, largest and last."""
    if len(curve.time) <= 4 * _PIECES:
        return curve.time, curve.values
    kept: list[int] = []
    for piece in np.array_split(np.arange(len(curve.time)), _PIECES):
        values = curve.values[piece]
        finite = piece[np.isfinite(values)]
        extremes = [finite[f(curve.values[finite])] for f in (np.argmin, np.argmax) if len(finite)]
        gaps = piece[~np.isfinite(values)][:1]
        kept += sorted({piece[0], piece[-1], *extremes, *gaps})
    return curve.time[kept], curve.values[kept]


class _Panel:
    """Axes with a frame."""

    def __init__(self, top: float, height: float, times: tuple[float, float], values: tuple[float, float]) -> None:
        self._top, self._height = top, height
        self._times, self._values = times, values

    def x(self, time: float) -> float:
        first, last = self._times
        share = (time - first) / ((last - first) or 1.0)
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * min(max(share, 0.0), 1.0)  # a funnel begins before and ends later

    def y(self, value: float) -> float:
        low, high = self._values
        return self._top + self._height * (high - value) / (high - low)

    def path(self, curve: Curve) -> str:
        """A line that has gaps where values are not finite."""
        words, pen = [], "M"
        for time, value in zip(*_thinned(curve), strict=True):
            if not math.isfinite(value):
                pen = "M"
                continue
            words.append(f"{pen}{self.x(time):.1f} {self.y(value):.1f}")
            pen = "L"
        return "".join(words)

    def area(self, lower: Curve, upper: Curve) -> str:
        """Area between two curves; empty where one is not finite."""
        there, back = _thinned(upper), _thinned(lower)
        points = [*zip(*there, strict=True), *zip(*(a[::-1] for a in back), strict=True)]
        return "M" + "L".join(f"{self.x(t):.1f} {self.y(v):.1f}" for t, v in points if math.isfinite(v)) + "Z"

    def frame(self, ticks: list[float] | None = None) -> list[str]:
        """Frame, and ticks of the values."""
        width = _WIDTH - _LEFT - _RIGHT
        lines = [f'<rect class="frame" x="{_LEFT:g}" y="{self._top:g}" width="{width:g}" height="{self._height:g}"/>']
        base, labels = _labels(ticks or _ticks(*self._values, 4))
        if base:
            lines.append(f'<text x="{_LEFT:g}" y="{self._top - 6:g}">{base} +</text>')
        for tick, text in labels:
            y = self.y(tick)
            lines.append(f'<path class="tick" d="M{_LEFT:g} {y:.1f}h{width:g}"/>')
            lines.append(f'<text x="{_LEFT - 5:g}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
        return lines

    def times(self) -> list[str]:
        """Ticks of the time."""
        y = self._top + self._height + 16
        return [
            f'<text x="{self.x(tick):.1f}" y="{y:g}" text-anchor="middle">{text}</text>'
            for tick, text in _labels(_ticks(*self._times, 5))[1]
        ]


def _ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers in a range."""
    rough = (high - low) / most
    if not (math.isfinite(rough) and rough > 0.0):
        return [low]
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * k for k in (1.0, 2.0, 5.0, 10.0) if power * k >= rough * 0.999)
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _labels(ticks: list[float]) -> tuple[str, list[tuple[float, str]]]:
    """Ticks with as many digits as tell them apart; where that is many, what is left of a common base."""
    step = min((b - a for a, b in pairwise(ticks)), default=0.0)
    largest = max(map(abs, ticks), default=0.0)
    digits = 3 if not step else max(1, math.ceil(math.log10(largest / step)) + 1)
    base = ticks[len(ticks) // 2] if digits > 6 else 0.0
    digits = 3 if base else digits
    texts = [f"{0.0 if abs(tick - base) < step / 2 else tick - base:.{digits}g}".replace("-", "−") for tick in ticks]
    return f"{base:.15g}".replace("-", "−") if base else "", list(zip(ticks, texts, strict=True))
