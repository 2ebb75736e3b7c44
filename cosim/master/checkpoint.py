"""Checkpoints: what a long run needs to go on another day, after Ctrl-C, a kill or a power cut.

    run.state   state of the run at a communication point, see `RunState`
    run.rows    what it has recorded, as the loop keeps it: 8 bytes a value, row by row

Rows are only ever added, and are on the disk before the state that follows them, which replaces the one before in one
go. Whenever the run ends, there is a whole state, and all rows before it.
"""

from __future__ import annotations

import dataclasses
import math
import os
import time as clock
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from os import PathLike
from pathlib import Path

import numpy as np

from cosim.errors import SetupError
from cosim.files.whole import part_of
from cosim.master.chunks import ChunkLength
from cosim.master.failures import SimulationError, SimulationInterrupted
from cosim.master.pacing import Pacer
from cosim.master.recording import Growing, Sink
from cosim.master.run import Grid
from cosim.master.state import RunState
from cosim.master.stepping import SteppedRun
from cosim.results.results import Results

#: So many values at most are in memory before they go to the disk, and are read back at once.
_MOST_VALUES = 1_000_000

#: Steps until the first look at the clock, and how much longer a chunk may be than the one before.

#: By how many steps a checkpoint may be due after a communication point, for rounding.
_TOLERANCE = 1e-6


class Checkpoint:
    """A folder with the state of a run and all that it has recorded, renewed as the run goes on.

    A run that ends early, for whatever reason, goes on from its last checkpoint with `resume`, and comes to the same
    results, to the last bit, as one that nothing has stopped.

    Parameters
    ----------
    folder : path
        Made when the run starts.
    every : float, optional
        Simulated time (s) between two checkpoints; as before by default, for a run that is resumed.
    resume : bool
        Go on from the checkpoint in the folder. System, step, algorithm and recording must be those of the run before;
        the stop time may be another one.
    warn : callable, optional
        Gets one line when a checkpoint can't be written; the run goes on, and the one before stays. By default a
        `RuntimeWarning`.

    Raises
    ------
    SetupError
        There is nothing to resume; or, without `resume`, the folder has the checkpoint of a run that has not ended.

    Examples
    --------
    >>> from cosim import Checkpoint, Simulation
    >>> checkpoint = Checkpoint("long-run", every=0.5)  # another day: Checkpoint("long-run", resume=True)
    >>> with Simulation(system) as simulation:
    ...     results = simulation.run(1.0, 1e-3, checkpoint=checkpoint)
    >>> results.save("results.parquet")
    >>> checkpoint.remove()
    """

    STATE, ROWS = "run.state", "run.rows"

    #: Size of the rows on the disk.
    BYTES_PER_VALUE = 8

    def __init__(
        self,
        folder: str | PathLike[str],
        every: float | None = None,
        *,
        resume: bool = False,
        warn: Callable[[str], object] | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.resume = resume
        self.every = every
        self._warn = warn
        self.state_path, self.rows_path = self.folder / self.STATE, self.folder / self.ROWS
        if every is not None and not (_is_number(every) and math.isfinite(every) and every > 0.0):
            raise SetupError(f"checkpoints every {every!r} s: must be a positive number of simulated seconds")
        exists = self.state_path.is_file()
        if resume and not exists:
            raise SetupError(f"{self.folder}: there is no checkpoint to resume; start the run with checkpoints")
        if exists and not resume:
            raise SetupError(
                f"{self.folder} is the checkpoint of a run that has not ended; resume that run, or remove the folder"
            )
        if every is None and not resume:
            raise SetupError("checkpoints need the interval at which they are written, in simulated seconds (every)")

    def warn(self, line: str) -> None:
        """Pass on a line about a checkpoint that could not be written."""
        if self._warn is not None:
            self._warn(line)
        else:
            warnings.warn(line, RuntimeWarning, stacklevel=2)

    def remove(self) -> None:
        """Remove the files of the checkpoint, and the folder if nothing else is in it."""
        for path in (self.state_path, self.rows_path, part_of(self.state_path)):  # rows alone are nothing to resume
            path.unlink(missing_ok=True)
        with suppress(OSError):
            self.folder.rmdir()


class CheckpointedRun:
    """A run that leaves checkpoints on its way, stepped from one to the next.

    Parameters
    ----------
    run : SteppedRun
    recorder : Growing
        Where it records.
    grid : Grid
    record_every : int
    results : Results
        Without rows; they say how the run is made.
    times : callable
        Times (n,) of the rows first ... end - 1.
    signals : callable
        Name -> what tells a signal from another one, up to a communication point.
    checkpoint : Checkpoint
    sink : callable, optional
        Gets all rows, those from before the run was resumed included.

    Raises
    ------
    SetupError
        An FMU can't save its state, or the checkpoint is that of another run.
    """

    def __init__(
        self,
        run: SteppedRun,
        recorder: Growing,
        grid: Grid,
        record_every: int,
        results: Results,
        times: Callable[[int, int], np.ndarray],
        signals: Callable[[int], dict[str, str]],
        checkpoint: Checkpoint,
        sink: Sink | None,
    ) -> None:
        self._run, self._recorder, self._grid, self._record_every = run, recorder, grid, record_every
        self._results, self._checkpoint, self._sink = results, checkpoint, sink
        self._times = times
        self._last_point = grid.last_point  # as far as signals are compared
        self._rows = _Rows(checkpoint.rows_path, len(results.names))
        self._loop_time = self._wall_time_before = 0.0
        self._began = clock.perf_counter()
        self._every = checkpoint.every or math.inf
        self._last = run.point  # that has a checkpoint
        self._failed = False  # to write the last one
        if checkpoint.resume:
            self._resume(signals)
        else:
            self._known_signals = signals(grid.last_point)
            self._start()

    def _start(self) -> None:
        """The first checkpoint, which shows whether there can be any."""
        try:
            self._checkpoint.folder.mkdir(parents=True, exist_ok=True)
            self._rows.cut_back(0, 0)  # those of a run that was killed before its first state
            self._write_state()
        except SetupError:
            self._checkpoint.remove()
            raise
        except OSError as error:
            raise SetupError(f"no checkpoint can be written: {error}; choose another folder") from error

    def _resume(self, signals: Callable[[int], dict[str, str]]) -> None:
        path = self._checkpoint.state_path
        state = RunState.read(path)
        try:
            self._run.restore(state)
            notes = {k: state.notes[k] for k in ("every", "loop_time_s", "wall_time_s", "crc32", "last_point")}
        except SetupError as error:
            raise SetupError(f"{path}: {error}") from error
        except KeyError:
            raise SetupError(f"{path}: not the state of a checkpoint") from None
        last_point = int(notes["last_point"])
        if differs := state.differences({"signals": signals(last_point)}):
            raise SetupError(f"{path}: the state is that of another run (other {'; other '.join(differs)})")
        self._last_point = max(last_point, self._grid.last_point)
        self._known_signals = signals(self._last_point)
        self._every = self._checkpoint.every or notes["every"]
        self._loop_time, self._wall_time_before = notes["loop_time_s"], notes["wall_time_s"]
        self._last = state.point
        try:
            self._rows.cut_back(-(-state.point // self._record_every), int(notes["crc32"]))
        except OSError as error:
            raise SetupError(f"{self._checkpoint.rows_path}: {error.strerror or error}") from error
        self._recorder.begin_at(self._rows.number)
        if self._sink is not None:
            for first, block in self._rows.blocks():
                self._sink(self._times(first, first + len(block)), block)

    def to_end(self, progress: Callable[[float], None] | None, pacer: Pacer | None) -> Results:
        """Step to the end; the results have all recorded rows however the run ends.

        Raises
        ------
        SimulationError
            An FMU failed; the last checkpoint stays.
        SimulationInterrupted
            Ctrl-C; there is a checkpoint of where the run stood.
        """
        run, grid, chunk, first_time = self._run, self._grid, ChunkLength(), self._run.time
        next_point = self._next(run.point)
        stopped, stopped_at = run.is_interrupted, run.time
        try:
            if progress is not None:
                progress(run.time)
            while run.point < grid.last_point and not stopped and not run.has_ended:
                if pacer is not None:
                    pacer.wait(run.time - first_time, lambda: run.is_interrupted)
                    chunk.steps = 1
                n = min(chunk.steps, next_point - run.point, grid.last_point - run.point)
                began, first = clock.perf_counter(), run.point
                try:
                    run.step(n)
                except SimulationInterrupted as interrupt:
                    stopped, stopped_at = True, interrupt.time
                took = clock.perf_counter() - began
                self._loop_time += took
                if progress is not None:
                    progress(run.time)
                if run.is_interrupted and not stopped:
                    stopped, stopped_at = True, run.time
                chunk.took(run.point - first, took)
                if (run.point >= next_point or stopped) and not run.has_ended:
                    self._keep()
                    next_point = self._next(run.point)
                elif self._recorder.size >= _MOST_VALUES and not self._failed:
                    self._drain()
            if pacer is not None and not stopped:
                pacer.wait(run.time - first_time, lambda: run.is_interrupted)
            run.end()
        except SimulationError as error:
            error.results = self._finished("failed", pacer)
            raise
        if stopped:
            raise SimulationInterrupted(stopped_at, self._finished("interrupted", pacer))
        return self._finished("completed", pacer)

    def _next(self, point: int) -> int:
        """The communication point after this one at which a checkpoint is due: at a multiple of `every`, or next."""
        per_step = self._grid.step_size / self._every
        if per_step >= 1.0:
            return point + 1
        due = (math.floor(point * per_step + _TOLERANCE) + 1) / per_step
        return max(point + 1, math.ceil(due - _TOLERANCE))

    # What goes to the disk

    def _keep(self) -> None:
        """Renew the checkpoint; where that fails, the one before stays."""
        if self._drain() and self._try(self._write_state):
            self._failed = False

    def _drain(self) -> bool:
        """Rows to the disk, and out of the memory; where that fails, they stay there."""
        times, rows = self._recorder.result()
        if not self._try(lambda: self._rows.append(rows)):
            return False
        if self._sink is not None and len(times):
            self._sink(times, rows)
        self._recorder.begin_at(self._rows.number)
        return True

    def _try(self, write: Callable[[], None]) -> bool:
        try:
            write()
        except (OSError, SetupError) as error:
            if not self._failed:
                self._checkpoint.warn(
                    f"no checkpoint at t = {self._run.time:.9g} s: {' '.join(str(error).split())}; "
                    f"the run goes on, and the checkpoint at t = {self._grid.time(self._last):.9g} s stays"
                )
            self._failed = True
            return False
        return True

    def _write_state(self) -> None:
        notes = {
            "every": self._every,
            "loop_time_s": self._loop_time,
            "wall_time_s": self._wall_time(),
            "crc32": self._rows.crc,
            "last_point": self._last_point,
        }
        state = self._run.save()
        made_with = {**state.made_with, "signals": self._known_signals}
        dataclasses.replace(state, made_with=made_with, notes=notes).write(self._checkpoint.state_path)
        self._last = self._run.point

    # Results

    def _wall_time(self) -> float:
        return self._wall_time_before + clock.perf_counter() - self._began

    def _finished(self, status: str, pacer: Pacer | None) -> Results:
        """All rows, from the disk and from the memory."""
        results = self._results
        times, rows = self._recorder.result()
        if self._sink is not None:
            if len(times):
                self._sink(times, rows)
            self._run.hand_over(np.empty(0), np.empty((0, rows.shape[1])), results)
        else:
            n = self._rows.number + len(rows)
            whole = np.empty((n, rows.shape[1]))
            for first, block in self._rows.blocks():
                whole[first : first + len(block)] = block
            whole[self._rows.number :] = rows
            self._run.hand_over(self._times(0, n), whole, results)
        results.info |= {"status": status, "loop_time_s": self._loop_time, "wall_time_s": self._wall_time()}
        if pacer is not None:
            results.info["realtime"] = pacer.report()
        return results


class _Rows:
    """Rows in a file, to which more are added, and which is cut back to what a checkpoint knows of.

    Attributes
    ----------
    number : int
        Rows that are on the disk for certain; what follows them in the file does not count.
    crc : int
        Checksum of them.
    """

    def __init__(self, path: Path, columns: int) -> None:
        self._path, self._columns = path, columns
        self.number = self.crc = 0

    def append(self, rows: np.ndarray) -> None:
        """Add rows (n, columns); an OSError leaves those before as they were."""
        data = _as_bytes(rows)
        rest = memoryview(data)
        with self._path.open("r+b", buffering=0) as stream:
            stream.seek(self.number * self._columns * 8)
            while rest:  # a write may stop short
                rest = rest[stream.write(rest) :]
            stream.truncate()
            os.fsync(stream.fileno())
        self.crc = zlib.crc32(data, self.crc)
        self.number += len(rows)

    def cut_back(self, number: int, crc: int) -> None:
        """Keep so many rows, whose checksum is known.

        Raises
        ------
        SetupError
            They are not there.
        OSError
            The file can't be read or written.
        """
        self._path.touch()
        self.number = number
        is_whole = self._path.stat().st_size >= number * self._columns * 8
        for _, block in self.blocks() if is_whole else ():
            self.crc = zlib.crc32(_as_bytes(block), self.crc)
        if not is_whole or self.crc != crc:
            raise SetupError(f"{self._path} is damaged: rows of the checkpoint are missing; run again from the start")
        self.append(np.empty((0, self._columns)))

    def blocks(self) -> Iterator[tuple[int, np.ndarray]]:
        """Number of the first row, and rows (n, columns), block by block."""
        size = max(1, _MOST_VALUES // max(1, self._columns))
        with self._path.open("rb") as stream:
            for first in range(0, self.number, size):
                n = min(size, self.number - first)
                data = stream.read(n * self._columns * 8)
                yield first, np.frombuffer(data, dtype="<f8").reshape(n, self._columns)


def _as_bytes(rows: np.ndarray) -> bytes:
    return np.ascontiguousarray(rows, dtype="<f8").tobytes()


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
