"""The sweep itself: keep all workers busy with batches, and never more of them in flight than that takes."""

from __future__ import annotations

import dataclasses
import pickle
import time as clock
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import suppress
from os import PathLike
from pathlib import Path
from queue import Empty, SimpleQueue
from uuid import uuid4

import numpy as np

from cosim.errors import needs
from cosim.master.interrupts import DeferredInterrupt
from cosim.sweep.batch import Batch, BatchSize, Rows
from cosim.sweep.cluster import are_workers_starting, connect, deliver
from cosim.sweep.errors import SweepError, WorkerTrouble
from cosim.sweep.points import Points
from cosim.sweep.store import Store, SweepSummary
from cosim.sweep.study import Study
from cosim.sweep.worker import run_batch, run_isolated
from cosim.versions import versions

with needs("sweep"):
    from dask.typing import Key
    from distributed import Client, Future, KilledWorker

#: Batches in flight for each worker process: one that runs and one that waits beside it.
_BATCHES_EACH = 2

#: Time (s) between two looks at Ctrl-C, and between two counts of the workers.
_LOOK, _COUNT = 0.2, 2.0

#: Time (s) after which it is said that workers are missing, or that no run has succeeded. A sweep without workers ends
#: then, unless some are starting, for which it waits longer.
_NOTICED, _STARTING = 6.0, 120.0

#: Number of times that a batch may find its worker unable before the sweep ends.
_RETRIES = 2

#: Number of times that Dask may give up on a batch for lost workers before the sweep ends.
_MOST_LOSSES = 3

_GO_ON = "start the same command again: it goes on where it stopped"


def sweep(
    study: Study,
    files: Mapping[str, str | PathLike[str]],
    points: Points,
    folder: str | PathLike[str],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda done, workers: None,
    warn: Callable[[str], None] = lambda line: None,
    observe: Callable[[Rows], None] | None = None,
) -> SweepSummary:
    """Run all points of a study that the folder has no row of yet.

    Parameters
    ----------
    study : Study
    files : mapping
        SHA-256 -> FMU file on this machine.
    points : Points
    folder : path
        Of the results; see `cosim.sweep.store`.
    scheduler : str, optional
        Address of a Dask scheduler; by default workers are started here.
    workers : int, optional
        How many to start here, one for each core by default.
    progress : callable, optional
        Called now and then with the number of rows so far and of workers.
    warn : callable, optional
        Gets a line when workers have ended for good, and when all runs fail.
    observe : callable, optional
        Gets the rows that the folder has, without curves, and then those of each batch that comes back.

    Raises
    ------
    SweepError
        The folder holds another sweep, or the cluster can't go on, as without workers; rows that have arrived are on
        disk.
    """
    question = {"version": versions()["closed-chain-cosim"], **study.fingerprint()}
    store = Store(Path(folder), points, study.metrics, question, curves=study.curves)
    missing = store.missing()
    if observe is not None:
        observe(store.kept())
    if not len(missing):
        return store.summary()
    with connect(scheduler, workers) as client:
        for sha256, path in files.items():
            if deliver(client, Path(path).read_bytes()) != sha256:
                raise SweepError(f"{path} has changed in between; {_GO_ON}")
        key = deliver(client, pickle.dumps(study))
        began = clock.perf_counter()
        flight = _Flight(client, key, points, missing)
        try:
            finished = flight.run(store, progress, warn, observe)
        finally:
            store.flush()
            flight.cancel()
        seconds = clock.perf_counter() - began
    return dataclasses.replace(
        store.summary(), interrupted=not finished, runs=flight.done, seconds=seconds, workers=flight.most_slots
    )


class _Flight:
    """Batches on their way through the cluster."""

    def __init__(self, client: Client, study: str, points: Points, missing: np.ndarray) -> None:
        self._client = client
        self._study, self._version = study, versions()["closed-chain-cosim"]
        self._points = points
        self._missing = missing
        self._next = 0
        self._suspects: deque[Batch] = deque()
        self._deaths: Counter[int] = Counter()
        self._flying: dict[Key, tuple[Future[Rows], Batch]] = {}
        self._landed: SimpleQueue[Future[Rows]] = SimpleQueue()
        self._sizes = BatchSize()
        self._name = f"cosim-sweep-{uuid4().hex[:12]}"  # equal keys of two clients would share their results
        self._sent = 0
        self._counted = -_COUNT
        self._watch = _Watch(client)
        self.slots = self.most_slots = 0
        self.done = 0

    def run(
        self,
        store: Store,
        progress: Callable[[int, int], None],
        warn: Callable[[str], None],
        observe: Callable[[Rows], None] | None,
    ) -> bool:
        """Run everything; returns False when Ctrl-C came first.

        Raises
        ------
        SweepError
            The cluster can't go on.
        """
        before = len(self._points) - len(self._missing)
        with DeferredInterrupt() as interrupt:
            while self._next < len(self._missing) or self._suspects or self._flying:
                if interrupt.requested:
                    return False
                self._count_slots()
                for line in self._watch.lines(self.slots):
                    warn(line)
                progress(before + self.done, self.slots)
                self._fill()
                for batch, rows in self._collect():
                    self._sizes.learn(len(batch.indices), rows.seconds)
                    self.done += len(batch.indices)
                    self._watch.learn(rows)
                    store.add(rows)
                    if observe is not None:
                        observe(rows)
            progress(before + self.done, self.slots)
        return True

    def cancel(self) -> None:
        """Take back what has not been run."""
        futures = [future for future, _ in self._flying.values()]
        self._flying.clear()
        with suppress(OSError):  # a scheduler that is gone runs nothing
            self._client.cancel(futures, force=True)

    def _count_slots(self) -> None:
        if clock.monotonic() - self._counted >= _COUNT:
            try:
                self.slots = len(self._client.nthreads())  # the threads of one process take turns
                self.most_slots = max(self.most_slots, self.slots)
            except OSError as error:
                raise SweepError(f"the scheduler no longer answers; {_GO_ON}") from error
            self._counted = clock.monotonic()

    def _fill(self) -> None:
        while len(self._flying) < _BATCHES_EACH * self.slots:
            if self._suspects:
                self._submit(run_isolated, self._suspects.popleft())
            elif self._next < len(self._missing):
                size = self._sizes.next(len(self._missing) - self._next, self.slots)
                indices = self._missing[self._next : self._next + size]
                self._next += size
                columns = self._points.take(indices)
                self._submit(run_batch, Batch(self._study, self._version, indices.tolist(), columns))
            else:
                return

    def _submit(self, function: Callable[[Batch], Rows], batch: Batch) -> None:
        self._sent += 1
        future = self._client.submit(function, batch, key=f"{self._name}-{self._sent}", pure=False, retries=_RETRIES)
        self._flying[future.key] = (future, batch)
        future.add_done_callback(self._landed.put)

    def _collect(self) -> list[tuple[Batch, Rows]]:
        """Batches that have come back, if any did within a moment."""
        landed = []
        try:
            landed.append(self._landed.get(timeout=_LOOK))
            while True:
                landed.append(self._landed.get_nowait())
        except Empty:
            pass
        try:
            # one message for all of them; None stands for those that failed
            results = self._client.gather({future.key: future for future in landed}, errors="skip")
        except (OSError, CancelledError) as error:
            raise SweepError(f"the scheduler no longer answers; {_GO_ON}") from error
        found = []
        for future in landed:
            _, batch = self._flying.pop(future.key)
            if results[future.key] is None:
                self._failed(future, batch)
            else:
                found.append((batch, results[future.key]))
        return found

    def _failed(self, future: Future[Rows], batch: Batch) -> None:
        """Give a batch in which workers died another chance; nothing else may fail."""
        error = future.exception() if future.status == "error" else None
        if error is None:
            raise SweepError(f"the scheduler has dropped runs; {_GO_ON}")
        if isinstance(error, WorkerTrouble):
            raise SweepError(f"a worker can't run anything: {error}; {_GO_ON}")
        if not isinstance(error, KilledWorker):
            raise SweepError(f"a worker can't take runs: {type(error).__name__}: {error}; {_GO_ON}")
        self._deaths[batch.indices[0]] += 1
        if self._deaths[batch.indices[0]] > _MOST_LOSSES:
            raise SweepError(f"workers are lost again and again, also without running anything; {_GO_ON}")
        self._suspects.append(batch)


class _Watch:
    """What goes wrong with a sweep as a whole: no or fewer workers, no run that succeeds."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._began = clock.monotonic()
        self._most = 0
        self._fewer_since: float | None = None
        self._failed, self._first_error = 0, ""
        self._has_succeeded = self._has_said_failed = False

    def learn(self, rows: Rows) -> None:
        """Take note of rows that have arrived."""
        errors = [error for error in rows.errors if error is not None]
        self._has_succeeded |= len(errors) < len(rows.errors)
        if errors and not self._first_error:
            self._first_error = f"point {rows.indices[rows.errors.index(errors[0])]}: {errors[0]}"
        self._failed += len(errors)

    def lines(self, workers: int) -> Iterator[str]:
        """What is to be said now.

        Raises
        ------
        SweepError
            There are no workers, and none are to be expected.
        """
        now = clock.monotonic()
        if workers >= self._most:
            self._most, self._fewer_since = workers, None
        elif self._fewer_since is None:
            self._fewer_since = now
        missing = 0.0 if self._fewer_since is None else now - self._fewer_since
        if missing >= (_STARTING if are_workers_starting(self._client) else _NOTICED):
            if not workers:
                raise SweepError(f"no workers are left; {_GO_ON}")
            yield f"{self._most - workers} of {self._most} workers have ended; the sweep goes on with {workers}"
            self._most, self._fewer_since = workers, None
        if now - self._began >= _NOTICED and self._failed and not (self._has_succeeded or self._has_said_failed):
            self._has_said_failed = True
            yield f"all {self._failed} runs so far have failed; the first: {self._first_error}"
