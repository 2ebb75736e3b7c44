"""Columns of numbers as few bytes, which a browser decodes by itself, and their extremes where they are too many.

A column is taken as 32-bit floats. Of their bits, read as integers, the second differences are written: they are small
where a curve is smooth. A sign folded into the lowest bit and bytes of equal weight side by side let DEFLATE find what
they have in common. `decode.js` undoes it.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

#: A column whose range is smaller than this share of its magnitude is written relative to its first value.
_NARROW = 1e-3

#: Magnitudes that 32-bit floats hold with all their digits.
_LARGEST, _SMALLEST = 1e38, 1e-30

#: Times are evenly spaced if none is farther from its place than this share of a step.
_EVEN = 1e-6


@dataclass(frozen=True)
class Column:
    """A column as 32-bit floats (n,): the value is `offset + scale * number`."""

    numbers: np.ndarray
    offset: float = 0.0
    scale: float = 1.0


def column_of(values: np.ndarray) -> Column:
    """A column (n,) of real numbers, shifted and scaled where 32-bit floats would lose what matters of it."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return Column(values.astype("<f4"))
    low, high = float(finite.min()), float(finite.max())
    size = max(abs(low), abs(high))
    offset = 0.0
    if np.isfinite(high - low) and high - low < _NARROW * size:
        offset = float(finite[0])
        size = max(abs(low - offset), abs(high - offset))
    scale = 1.0 if size == 0.0 or _SMALLEST < size < _LARGEST else float(2.0 ** np.floor(np.log2(size)))
    numbers = values if offset == 0.0 and scale == 1.0 else (values - offset) / scale
    return Column(numbers.astype("<f4"), offset, scale)


def encoded(numbers: np.ndarray) -> bytes:
    """Bytes of 32-bit floats (n,), four a number, that DEFLATE makes few of."""
    bits = np.ascontiguousarray(numbers, dtype="<f4").view("<u4")
    first = np.diff(bits, prepend=np.uint32(0))  # modulo 2^32, as all that follows
    second = np.diff(first, prepend=np.uint32(0)).view("<i4")
    folded = ((second << 1) ^ (second >> 31)).view("u1")
    return _shuffled(folded, 4)


def _shuffled(octets: np.ndarray, width: int) -> bytes:
    return np.ascontiguousarray(octets.reshape(-1, width).T).tobytes()


def block(columns: Sequence[np.ndarray]) -> bytes:
    """Columns of 32-bit floats, one after the other, deflated."""
    return zlib.compress(b"".join(map(encoded, columns)), 6)


def extremes(values: np.ndarray, every: int) -> np.ndarray:
    """The smallest and the largest value of every so many rows, in the order in which they come.

    Where a value is not a number, the second of the two is none either, so that the curve has a gap.

    Parameters
    ----------
    values : array (n,)
    every : int

    Returns
    -------
    array (2 * ceil(n / every),)
    """
    n = len(values)
    buckets = -(-n // every)
    if buckets * every > n:
        values = np.concatenate([values, np.full(buckets * every - n, values[-1])])
    rows = values.reshape(buckets, every)
    missing = np.isnan(rows)
    low = np.argmin(np.where(missing, np.inf, rows) if missing.any() else rows, axis=1)
    high = np.argmax(np.where(missing, -np.inf, rows) if missing.any() else rows, axis=1)
    found: np.ndarray = np.take_along_axis(rows, np.sort(np.stack([low, high], axis=1), axis=1), axis=1)
    found[missing.any(axis=1), 1] = np.nan
    return found.ravel()


def times(time: np.ndarray, every: int = 1) -> tuple[dict[str, Any], bytes | None]:
    """Times (n,) in s, of all rows or of the two extremes of every so many, for the page.

    Returns
    -------
    dict
        `rows`, and `start` and `step` (s) if they are evenly spaced.
    bytes or None
        The times as 64-bit floats, shuffled and deflated, if they are not.
    """
    if every > 1:
        firsts = np.arange(0, len(time), every)
        time = np.stack([time[firsts], time[np.minimum(firsts + every // 2, len(time) - 1)]], axis=1).ravel()
    n = len(time)
    if n < 2:
        return {"rows": n, "start": float(time[0]) if n else 0.0, "step": 1.0}, None
    # of extremes the last pair may be closer than the others
    step = float(time[-1] - time[0]) / (n - 1) if every == 1 else float(time[2] - time[0]) / 2 if n > 2 else 1.0
    place = time[0] + step * np.arange(n)
    if step > 0.0 and np.abs(time - place).max() <= (_EVEN if every == 1 else 0.5) * step:
        return {"rows": n, "start": float(time[0]), "step": step}, None
    octets = np.ascontiguousarray(time, dtype="<f8").view("u1")
    return {"rows": n}, zlib.compress(_shuffled(octets, 8), 6)
