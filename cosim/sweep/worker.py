"""A worker's run of a batch: point by point, on simulations that stay open."""

from __future__ import annotations

import ctypes
import errno
import gc
import pickle
import sys
import threading
import time as clock
from collections import OrderedDict
from collections.abc import Hashable, Iterator, Mapping
from functools import cache
from socket import gethostname
from typing import cast

from cosim.errors import CosimError
from cosim.fmi.instance import ProcessEnded
from cosim.fmi.isolation.process import can_isolate
from cosim.loop.binding import LoopLibraryError
from cosim.master.simulation import Simulation
from cosim.sweep import stock
from cosim.sweep.batch import Batch, Row, Rows
from cosim.sweep.errors import WorkerTrouble
from cosim.sweep.points import Value
from cosim.sweep.study import Study
from cosim.versions import versions

#: Simulations that a process keeps open.
_MOST_OPEN = 8

#: Failures of the machine, not of the run: the point is better off on another worker.
_OF_THE_MACHINE = (errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.EROFS, errno.EIO)

#: Parameters of glibc's mallopt, and the largest block (bytes) that it lets come from the heap.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _LARGEST = -1, -3, 32 << 20

#: FMUs need not be thread-safe: the threads of a worker take turns.
_turn = threading.Lock()

_studies: dict[str, Study] = {}
_open: OrderedDict[tuple[str, Hashable, bool], Simulation] = OrderedDict()


class Timer:
    """Context that adds up the time (s) spent in it."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __enter__(self) -> None:
        self._began = clock.perf_counter()

    def __exit__(self, *_: object) -> None:
        self.seconds += clock.perf_counter() - self._began


def run_batch(batch: Batch) -> Rows:
    """Run all points of a batch; a run that fails becomes a row with its error.

    Raises
    ------
    WorkerTrouble
        This worker can't run anything.
    """
    return _run(batch, isolate=False)


def run_isolated(batch: Batch) -> Rows:
    """Run a batch in which workers have died, with each FMU in a process of its own: the deadly point gets an error.

    Dask blames all tasks that a lost worker had at hand.

    Raises
    ------
    WorkerTrouble
        This worker can't run anything.
    """
    return _run(batch, isolate=can_isolate())


def _run(batch: Batch, *, isolate: bool) -> Rows:
    with _turn:
        timer = Timer()
        rows = list(_rows_of(batch, timer, isolate=isolate))
        return Rows.of(_names_of(study_of(batch)), rows, timer.seconds)


def study_of(batch: Batch) -> Study:
    """The study of a batch, read once in each process.

    Raises
    ------
    WorkerTrouble
        It has not arrived, or comes from another version of this package.
    """
    own = versions()["closed-chain-cosim"]
    if batch.version != own:
        raise WorkerTrouble(
            f"{gethostname()} has closed-chain-cosim {own}, the sweep comes from {batch.version}; install the same"
        )
    if batch.study not in _studies:
        keep_memory()
        _studies[batch.study] = cast(Study, pickle.loads(stock.path(batch.study).read_bytes()))
    return _studies[batch.study]


def _names_of(study: Study) -> list[str]:
    """Names of all that a row has."""
    return [*study.metrics, *study.curves]


def _rows_of(batch: Batch, timer: Timer, *, isolate: bool) -> Iterator[Row]:
    study = study_of(batch)
    for index, point in batch.points():
        yield _row(batch.study, study, index, point, timer, isolate=isolate)


def _row(
    key: str,
    study: Study,
    index: int,
    point: Mapping[str, Value],
    timer: Timer,
    *,
    isolate: bool,
    again: bool = False,
) -> Row:
    try:
        planned = study.plan(point)
        simulation = _simulation(key, study, planned.variant, isolate=isolate)
        with timer:
            results = simulation.run(
                planned.stop_time,
                planned.step_size,
                start_time=planned.start_time,
                start=planned.start,
                signals=planned.signals,
                record_every=planned.record_every,
                tolerance=planned.tolerance,
            )
            return Row(index, study.row(planned, results), None)
    except WorkerTrouble:
        raise
    except Exception as error:  # whatever goes wrong in a run is that run's result
        if not again and _was_killed(error):  # as by a system that is short of memory: the point need not be to blame
            return _row(key, study, index, point, timer, isolate=isolate, again=True)
        if _is_of_the_machine(error):
            raise WorkerTrouble(f"{gethostname()}: {_line(error)}") from error
        return Row(index, None, _line(error))


def _simulation(key: str, study: Study, variant: Hashable, *, isolate: bool) -> Simulation:
    place = (key, variant, isolate)
    if place not in _open:
        simulation = study.simulation(variant, stock.path)
        if isolate:
            simulation.isolate()
        _open[place] = simulation.__enter__()
        if len(_open) > _MOST_OPEN:
            _open.popitem(last=False)[1].close()
    _open.move_to_end(place)
    return _open[place]


def _was_killed(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, ProcessEnded):
            return error.was_killed
        error = error.__cause__
    return False


def _is_of_the_machine(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, LoopLibraryError) or (isinstance(error, OSError) and error.errno in _OF_THE_MACHINE):
            return True
        error = error.__cause__
    return False


def _line(error: Exception) -> str:
    """An error in one line."""
    text = str(error) if isinstance(error, CosimError) else f"{type(error).__name__}: {error}"
    return " ".join(text.split())


@cache  # once in each process
def keep_memory() -> None:
    """Have freed memory kept, and leave what is imported out of the garbage collections.

    Dask starts its workers with `MALLOC_TRIM_THRESHOLD_`: glibc then returns each large array to the system as soon as
    it is freed, and a run gets its memory page by page again; that took an eighth of the time of a run. A worker keeps
    no more than its largest run needs.
    """
    gc.freeze()
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # not every libc is glibc
        if mallopt is not None:
            mallopt(_M_MMAP_THRESHOLD, _LARGEST)
            mallopt(_M_TRIM_THRESHOLD, 8 * _LARGEST)
