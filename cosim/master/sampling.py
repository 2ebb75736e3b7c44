"""Input signals, sampled at the communication points ahead of the stepping loop."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from cosim.errors import ArgumentError
from cosim.fmi.instance import CallFailed
from cosim.fmi.types import Texts
from cosim.system.resolution import Drive

#: Samples kept at once (values, not bytes); more are dropped behind the loop as it goes.
_MOST_SAMPLES = 4_000_000

#: Sampling ahead may take this long (s) before the loop goes on, so that Ctrl-C and progress don't wait for it.
_LONGEST = 0.05

#: A jump this near before a communication point (in steps) is taken to be at it, for rounding.
_TOLERANCE = 1e-6


class Samples:
    """Values of the signals of a system at its communication points.

    Parameters
    ----------
    drives : sequence of Drive
    start_time, step_size : float
        In s.
    last_point : int
        Number of the last communication point.
    reach : int
        By how many points the loop looks back from those it performs.
    ahead : bool
        Whether it looks ahead by as many.
    inside : bool
        Whether it needs values inside the steps, too.
    texts : Texts, optional
        Texts of the system.
    most : int, optional
        Samples (values) that are kept at once.

    Attributes
    ----------
    values : array (rows, columns)
        Slots, see `cosim.fmi.types`: one column for each target of each drive.
    inside : array (rows, columns, 2) or None
        The same of real ones after a third and two thirds of the step to the next value; NaN where they can't be had.
    jumps : array (rows,) of uint8
        Whether a signal jumps at this point or since the one before.
    first, end : int
        Rows are the points first ... end - 1.
    failure : CallFailed or None
        Why there is no sample at point `end`.
    failed : Drive or None
        Which signal failed there.
    """

    def __init__(
        self,
        drives: Sequence[Drive],
        start_time: float,
        step_size: float,
        last_point: int,
        reach: int,
        *,
        ahead: bool = True,
        inside: bool = False,
        texts: Texts | None = None,
        most: int | None = None,
    ) -> None:
        self.drives = tuple(drives)
        self._start_time, self._step_size = start_time, step_size
        self._last_point, self._reach = last_point, reach
        self._texts = Texts() if texts is None else texts
        self._ahead = reach if ahead else 0
        widths = [len(d.targets) for d in drives]
        ends = np.cumsum([0, *widths])
        self.columns = [np.arange(a, a + n, dtype=np.int32) for a, n in zip(ends, widths, strict=False)]
        self._breakpoints = np.unique([b for d in drives for b in d.breakpoints])
        self._rows = max(
            (_MOST_SAMPLES if most is None else most) // max(1, (3 if inside else 1) * int(ends[-1])), 4 * reach + 1
        )
        self.values = np.empty((min(self._rows, last_point + 1), int(ends[-1])))
        self.inside = np.full((*self.values.shape, 2), np.nan) if inside else None
        self.jumps = np.zeros(len(self.values), dtype=np.uint8)
        self.first = self.end = 0
        self.failure: CallFailed | None = None
        self.failed: Drive | None = None

    def cover(self, first: int, end: int, stop: Callable[[], bool]) -> int:
        """Have samples for the points first ... end - 1, and for as many beyond as the loop looks ahead.

        Returns the end of those that could be had: fewer when a signal takes long or fails, none when `stop` says so.
        """
        wanted = min(end + self._ahead, self._last_point + 1)
        if wanted > self.first + len(self.values):  # drop what lies behind
            self._drop(max(first - self._reach, 0))
            wanted = min(wanted, self.first + len(self.values))
        while self.end < wanted and self.failure is None:
            self._sample(self.end, wanted, stop)
            if stop() or self._usable() > first:
                break
        return max(first, min(end, self._usable()))

    def begin_at(self, point: int) -> None:
        """Forget all samples, and go on from a point; the loop looks back from there."""
        self.first = self.end = max(point - self._reach, 0)
        self.failure = self.failed = None

    def _usable(self) -> int:
        """End of the points for which the loop finds all that it looks at."""
        whole = self.end > self._last_point or self.failure is not None
        return self.end if whole else self.end - self._ahead

    def _drop(self, first: int) -> None:
        kept = slice(first - self.first, self.end - self.first)
        n = self.end - first
        self.values[:n] = self.values[kept].copy()
        if self.inside is not None:
            self.inside[:n] = self.inside[kept].copy()
        self.jumps[:n] = self.jumps[kept].copy()
        self.first = first

    def _sample(self, first: int, end: int, stop: Callable[[], bool]) -> None:
        points = np.arange(first, end)
        failures: list[tuple[int, Drive, CallFailed]] = []
        for drive, columns in zip(self.drives, self.columns, strict=True):
            own = points % drive.every == 0  # the other rows of this signal are never read
            times = _at_breakpoints(self._times(points[own]), drive.breakpoints, _TOLERANCE * self._step_size)
            block, failure = sample(drive, times, stop, self._texts)
            if len(block) < own.sum():  # the other signals are needed as far as this one goes only
                points = points[: np.flatnonzero(own)[len(block)]]
                own = own[: len(points)]
            if failure is not None:
                failures.append((len(points), drive, failure))
            self.values[np.ix_(points[own] - self.first, columns)] = block
            if self.inside is not None and drive.targets[0].kind == "real" and not drive.added:
                self._sample_inside(drive, columns, points[own])
        for row, drive, failure in failures:
            if row == len(points):  # no signal has been cut before
                self.failed, self.failure = drive, failure
        self.end = first + len(points)
        times = self._times(points)
        before = np.searchsorted(self._breakpoints, times - (1.0 - _TOLERANCE) * self._step_size, side="right")
        until = np.searchsorted(self._breakpoints, times + _TOLERANCE * self._step_size, side="right")
        self.jumps[first - self.first : self.end - self.first] = until > before

    def _sample_inside(self, drive: Drive, columns: np.ndarray, points: np.ndarray) -> None:
        """Values between those at points; where a signal fails there the loop goes straight."""
        assert self.inside is not None
        points = points[points + drive.every <= self._last_point]
        for k, part in enumerate((1.0 / 3.0, 2.0 / 3.0)):
            times = self._times(points) + part * drive.every * self._step_size
            block, _ = sample(drive, times, texts=self._texts)
            rows = np.full((len(points), len(columns)), np.nan)
            rows[: len(block)] = block
            self.inside[:, :, k][np.ix_(points - self.first, columns)] = rows

    def _times(self, points: np.ndarray) -> np.ndarray:
        return self._start_time + points * self._step_size


def _at_breakpoints(times: np.ndarray, breakpoints: Sequence[float], tolerance: float) -> np.ndarray:
    """Times (s), moved to a breakpoint where they lie before it by rounding: what comes after the jump counts."""
    if not len(breakpoints):
        return times
    ordered = np.unique(breakpoints)
    following = ordered[np.minimum(np.searchsorted(ordered, times), len(ordered) - 1)]
    return np.where((times < following) & (times > following - tolerance), following, times)


def sample(
    drive: Drive, times: np.ndarray, stop: Callable[[], bool] = lambda: False, texts: Texts | None = None
) -> tuple[np.ndarray, CallFailed | None]:
    """Slots (n, size) of a signal at times (s), as many rows as could be had, and the failure that ended them."""
    name = f"{drive.component}.{drive.targets[0].name}"
    texts = Texts() if texts is None else texts
    return _vectorized(drive, times, texts, name) if drive.vectorized else _one_by_one(drive, times, texts, name, stop)


def _vectorized(drive: Drive, times: np.ndarray, texts: Texts, name: str) -> tuple[np.ndarray, CallFailed | None]:
    is_real = drive.targets[0].kind == "real"
    try:
        values = np.array(drive.function(times), dtype=np.float64 if is_real else None, ndmin=1)
        block = np.broadcast_to(values[:, None] if values.ndim == 1 else values, (len(times), len(drive.targets)))
    except Exception as error:
        if len(times) == 1:
            return np.empty((0, len(drive.targets))), _raised(name, error)
        return _until_it_raises(drive, times, texts, name)
    if not is_real:
        return _slots(drive, block, texts, name)
    for i in np.flatnonzero(~np.isfinite(block).all(axis=1))[:1]:
        return block[:i], _not_finite(name, block[i])
    return block, None


def _until_it_raises(drive: Drive, times: np.ndarray, texts: Texts, name: str) -> tuple[np.ndarray, CallFailed | None]:
    """Point by point, since a function of many times does not say at which one it raised."""
    rows = [np.empty((0, len(drive.targets)))]
    for i in range(len(times)):
        row, failure = _vectorized(drive, times[i : i + 1], texts, name)
        if failure is not None:
            return np.vstack(rows), failure
        rows.append(row)
    return np.vstack(rows), None


def _one_by_one(
    drive: Drive, times: np.ndarray, texts: Texts, name: str, stop: Callable[[], bool]
) -> tuple[np.ndarray, CallFailed | None]:
    size = len(drive.targets)
    block = np.empty((len(times), size))
    began = clock.perf_counter()
    for i, time in enumerate(times.tolist()):
        if i and (stop() or clock.perf_counter() - began > _LONGEST):
            return block[:i], None
        try:
            block[i] = _one_sample(drive, time, texts, name)
        except CallFailed as error:
            return block[:i], error
    return block, None


def _one_sample(drive: Drive, time: float, texts: Texts, name: str) -> np.ndarray:
    is_real = drive.targets[0].kind == "real"
    try:
        value = drive.function(time)
        value = np.atleast_1d(np.asarray(value, dtype=float if is_real else _exact_type(value)))
    except Exception as error:
        raise _raised(name, error) from error
    if value.ndim != 1:
        raise CallFailed(f"the signal that feeds '{name}' gives an array of shape {value.shape}; make it flat")
    if value.size not in (1, len(drive.targets)):
        raise CallFailed(f"the signal that feeds '{name}' gives {value.size} values, not {len(drive.targets)}")
    if not is_real:
        row, failure = _slots(drive, np.broadcast_to(value, (1, len(drive.targets))), texts, name)
        if failure is not None:
            raise failure
        return np.asarray(row[0])
    if not np.isfinite(value).all():
        raise _not_finite(name, value)
    return value


def _exact_type(value: Any) -> Any:
    """Type of an array that keeps what it is given: texts, bytes and large whole numbers as Python has them."""
    return None if isinstance(value, np.ndarray) else object


def _slots(drive: Drive, block: np.ndarray, texts: Texts, name: str) -> tuple[np.ndarray, CallFailed | None]:
    """Slots (n, size) of values that are not real, as many rows as there are before a wrong value."""
    slots = np.empty(block.shape)
    for i, row in enumerate(block.tolist()):
        try:
            values = [element.value(value) for element, value in zip(drive.targets, row, strict=True)]
        except (ArgumentError, OverflowError):
            fmi_type = drive.targets[0].variable.type
            return slots[:i], CallFailed(f"the signal that feeds '{name}' gives {row[:8]}, no value of type {fmi_type}")
        slots[i] = drive.targets[0].type.slots(values, texts)
    return slots, None


def _raised(name: str, error: Exception) -> CallFailed:
    return CallFailed(f"the signal that feeds '{name}' failed: {type(error).__name__}: {error}")


def _not_finite(name: str, value: np.ndarray) -> CallFailed:
    return CallFailed(f"the signal that feeds '{name}' gives {value.tolist()}, which is not finite")
