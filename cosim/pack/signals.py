"""Signals of a system as tables, which a packed FMU can read: exact for shapes of straight pieces, else sampled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cosim.errors import SetupError
from cosim.fmi.types import Texts
from cosim.master.sampling import sample
from cosim.scenario.signals import Constant, CsvColumn, PulseTrain, Ramp, Shape, ShapedSignal, Step
from cosim.system.resolution import Drive
from cosim.system.system import Signal

#: What a table does between its rows: holds, is linear, is linear as numpy.interp computes it; numbers as in packed.h.
HELD, LINEAR, INTERP = 0, 1, 2

#: A sampled signal of more values than this is refused: its table would be larger than the FMUs.
MOST_SAMPLED_VALUES = 5_000_000


@dataclass(frozen=True)
class SignalRows:
    """A signal in rows.

    Attributes
    ----------
    between : int
        `HELD`, `LINEAR` or `INTERP`.
    times : array (n,)
        In s.
    slots : array (n, size)
        Slots; see `cosim.fmi.types`.
    breakpoints : tuple of float
        Times (s) at which it jumps, ascending.
    sampled : bool
        It has the signal's values at the points of the packed FMU's own grid, where inputs follow polynomials also
        inside its steps, and lines between them.
    """

    between: int
    times: np.ndarray
    slots: np.ndarray
    breakpoints: tuple[float, ...]
    sampled: bool = False


def table_of(
    signal: Signal, drive: Drive, texts: Texts, grid: tuple[float, float | None, float], *, inside: bool = False
) -> SignalRows:
    """The table of a signal.

    Parameters
    ----------
    signal, drive : Signal, Drive
        The signal, and what it drives.
    texts : Texts
        Texts of the system.
    grid : (float, float or None, float)
        Start time, stop time and internal step (s) of the packed FMU: a signal that has no straight pieces is sampled
        there.
    inside : bool
        Inputs follow polynomials, for which a signal is asked for after a third and two thirds of each step, too.

    Raises
    ------
    SetupError
        It fails, or has to be sampled, and there is no stop time or there are too many points.
    """
    breakpoints = tuple(np.unique(drive.breakpoints).tolist())
    shape = signal.function.shape if isinstance(signal.function, ShapedSignal) else None
    is_real = drive.targets[0].kind == "real"
    if isinstance(shape, CsvColumn) and shape.between == "linear" and is_real:
        times, values = shape.rows
        return SignalRows(LINEAR, times, np.broadcast_to(values, (len(times), len(drive.targets))), breakpoints)
    if isinstance(shape, Ramp) and is_real:
        times = np.array([shape.start_time, shape.end_time])
        return SignalRows(INTERP, times, _values(drive, times, texts), breakpoints)
    if (edges := _edges(shape)) is not None:
        return SignalRows(HELD, edges, _values(drive, edges, texts), breakpoints)
    start_time, stop_time, step = grid
    name = f"{drive.component}.{drive.targets[0].name}"
    if stop_time is None:
        raise SetupError(
            f"the signal that feeds '{name}' has to be sampled, and it is not known until when; give a stop time, or "
            "make it an input of the packed FMU"
        )
    is_asked_inside = inside and is_real and not drive.added
    number = math.ceil((stop_time - start_time) / step - 1e-6) + 1
    points = number + 2 * math.ceil(number / drive.every) if is_asked_inside else number
    if points * len(drive.targets) > MOST_SAMPLED_VALUES:
        raise SetupError(
            f"the signal that feeds '{name}' would have {points} samples; give an earlier stop time or a longer step, "
            "or make it an input of the packed FMU"
        )
    times = start_time + np.arange(number) * step
    if is_asked_inside:  # at the very times that the loop computes
        own = times[: -1 : drive.every]
        times = np.unique(
            [*times, *(own + (1.0 / 3.0) * drive.every * step), *(own + (2.0 / 3.0) * drive.every * step)]
        )
    between = LINEAR if is_real else HELD
    try:
        values = _values(drive, times, texts)
    except SetupError:
        if not is_asked_inside:
            raise
        return table_of(signal, drive, texts, grid)  # where it fails inside steps it goes straight, as in a run
    return SignalRows(between, times, values, breakpoints, sampled=True)


def _edges(shape: Shape | None) -> np.ndarray | None:
    """Times (s) from which on a shape has another constant value, one before all of them first; None for others."""
    if isinstance(shape, Constant):
        return np.array([0.0])
    if isinstance(shape, (Step, PulseTrain)):
        edges = np.unique(shape.breakpoints)
        return np.array([np.nextafter(edges[0], -math.inf), *edges])
    if isinstance(shape, CsvColumn) and shape.between == "hold":
        return np.unique(shape.rows[0])
    return None


def _values(drive: Drive, times: np.ndarray, texts: Texts) -> np.ndarray:
    """Slots (n, size) of a signal at times (s)."""
    rows: list[np.ndarray] = []
    reached = 0
    while reached < len(times):
        block, failure = sample(drive, times[reached:], texts=texts)
        if failure is not None:
            raise SetupError(f"{failure}; it can't be packed")
        rows.append(np.asarray(block))
        reached += len(block)
    return np.vstack(rows)


def tables_of(
    signals: Sequence[Signal],
    drives: Sequence[Drive],
    texts: Texts,
    grid: tuple[float, float | None, float],
    *,
    inside: bool = False,
) -> list[SignalRows]:
    """Tables of all signals; see `table_of`."""
    return [table_of(signal, drive, texts, grid, inside=inside) for signal, drive in zip(signals, drives, strict=True)]
