"""A run that is watched and steered as it goes on: values are set, it is paused and stopped, at communication points.

What was done is kept, with the communication points at which it was, so that the run can be repeated to the last bit.
"""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from cosim.errors import CosimError, SetupError
from cosim.master.chunks import ChunkLength
from cosim.master.failures import SimulationError, SimulationInterrupted
from cosim.master.pacing import Pacer
from cosim.master.recording import Growing, Sink
from cosim.master.run import Grid
from cosim.master.stepping import SteppedRun
from cosim.results.results import Results

#: A run that is paused looks for commands this often (s).
_LOOK = 0.01

#: More values than this go to a sink.
_MOST_VALUES = 1_000_000


class Steering:
    """Commands for a run, given from any thread while it goes on.

    Each takes effect at the next communication point where the run looks for commands, within about 50 ms of its own
    time. Pass it to `Simulation.run(steering=)`; `Results.info["commands"]` has what was done, and when.

    Parameters
    ----------
    commands : iterable of mapping
        Commands of an earlier run, as its results have them, which are repeated at their communication points.
    told : callable, optional
        Called by the run with each command once it is carried out, with its "point" and "time" (s), or refused: then it
        also has "why".

    Raises
    ------
    SetupError
        A command is none.

    Examples
    --------
    >>> from cosim import Simulation
    >>> steering = Steering()
    >>> steering.set("controller.alpha", 2.0)
    >>> with Simulation(system) as simulation:
    ...     results = simulation.run(0.01, 1e-3, steering=steering)
    ...     again = simulation.run(0.01, 1e-3, steering=Steering(results.info["commands"]))
    """

    def __init__(
        self,
        commands: Iterable[Mapping[str, Any]] = (),
        told: Callable[[Mapping[str, Any]], object] = lambda command: None,
    ) -> None:
        self.tell = told
        self._lock = threading.Lock()
        self._waiting: list[dict[str, Any]] = []
        self._paused = threading.Event()
        self._planned = sorted((_checked(command) for command in commands), key=lambda c: int(c["point"]))

    def set(self, name: str, value: Any) -> None:
        """Set an input that nothing feeds, or a tunable parameter, `component.variable`, from the next point on."""
        self._give({"set": {name: value}})

    def pause(self) -> None:
        """Have the run wait at the next communication point; values can still be set."""
        self._paused.set()

    def resume(self) -> None:
        """Have the run go on."""
        self._paused.clear()

    def stop(self) -> None:
        """End the run at the next communication point; its results are those up to there."""
        self._give({"stop": True})
        self.resume()

    @property
    def is_paused(self) -> bool:
        """Whether the run waits, or will at the next point."""
        return self._paused.is_set()

    def _give(self, command: dict[str, Any]) -> None:
        with self._lock:
            self._waiting.append(command)

    # For the run

    def next_planned(self) -> int | None:
        """The communication point of the next command that is to be repeated."""
        return int(self._planned[0]["point"]) if self._planned else None

    def taken_at(self, point: int) -> list[dict[str, Any]]:
        """Commands for a communication point: those that are repeated there, and those that wait."""
        found: list[dict[str, Any]] = []
        while self._planned and int(self._planned[0]["point"]) <= point:
            planned = self._planned.pop(0)
            found.append({key: planned[key] for key in ("set", "stop") if key in planned})
        with self._lock:
            found += self._waiting
            self._waiting = []
        return found


def _checked(command: Mapping[str, Any]) -> dict[str, Any]:
    point, values = command.get("point"), command.get("set", {})
    if (
        not isinstance(point, int)
        or point < 0
        or not isinstance(values, Mapping)
        or not ({"set", "stop"} & set(command))
    ):
        raise SetupError(
            f"{command!r} is not a command; write {{'point': 100, 'set': {{'plant.dm': 0.1}}}}, or 'stop': True"
        )
    return dict(command)


class SteeredRun:
    """A run with a steering, which is stepped to its end.

    Parameters
    ----------
    run : SteppedRun
    recorder : Growing
        What it records to.
    grid : Grid
    results : Results
        Without rows.
    steering : Steering
    observe : callable, optional
        Takes times and values of further rows.
    sink : callable, optional
        Takes times and slots of rows that are not kept.
    values : callable
        Values of slots, as `observe` gets them.
    """

    def __init__(
        self,
        run: SteppedRun,
        recorder: Growing,
        grid: Grid,
        results: Results,
        steering: Steering,
        observe: Sink | None,
        sink: Sink | None,
        values: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self._run, self._recorder, self._grid, self._results = run, recorder, grid, results
        self._steering, self._observe, self._sink, self._values = steering, observe, sink, values
        self._done: list[dict[str, Any]] = []
        self._refused: list[dict[str, Any]] = []
        self._observed = self._passed_on = 0
        self._stopped = False
        self._loop_time = 0.0
        self._began = clock.perf_counter()

    def to_end(self, progress: Callable[[float], None] | None, pacer: Pacer | None) -> Results:
        """Step to the end.

        Raises
        ------
        SimulationError
            An FMU failed.
        SimulationInterrupted
            Ctrl-C.
        """
        run, grid, chunk = self._run, self._grid, ChunkLength()
        interrupted_at = run.time if run.is_interrupted else None
        try:
            if progress is not None:
                progress(run.time)
            while run.point <= grid.last_point and interrupted_at is None and not run.has_ended:
                self._wait_while_paused(pacer)
                self._obey()
                if self._stopped or run.point == grid.last_point or run.is_interrupted:
                    interrupted_at = run.time if run.is_interrupted else None
                    break
                if pacer is not None:
                    pacer.wait(run.time - grid.start_time, lambda: run.is_interrupted)
                    chunk.steps = 1
                planned = self._steering.next_planned()
                n = min(chunk.steps, grid.last_point - run.point, *([] if planned is None else [planned - run.point]))
                began, first = clock.perf_counter(), run.point
                try:
                    run.step(n)
                except SimulationInterrupted as interrupt:
                    interrupted_at = interrupt.time
                took = clock.perf_counter() - began
                self._loop_time += took
                self._show()
                if progress is not None:
                    progress(run.time)
                chunk.took(run.point - first, took)
            run.end()
            self._show()
        except SimulationError as error:
            error.results = self._finished("failed", pacer)
            raise
        if interrupted_at is not None:
            raise SimulationInterrupted(interrupted_at, self._finished("interrupted", pacer))
        return self._finished("stopped" if self._stopped else "completed", pacer)

    def _wait_while_paused(self, pacer: Pacer | None) -> None:
        began = clock.perf_counter()
        while self._steering.is_paused and not self._run.is_interrupted:
            self._obey()
            clock.sleep(_LOOK)
        if pacer is not None:
            pacer.begin_later(clock.perf_counter() - began)

    def _obey(self) -> None:
        """Carry out the commands for this communication point."""
        for command in self._steering.taken_at(self._run.point):
            known = {"point": self._run.point, "time": self._run.time, **command}
            try:
                for name, value in command.get("set", {}).items():
                    self._run[name] = value
            except SimulationError:
                raise
            except (CosimError, TypeError, ValueError) as error:
                self._refused.append({**known, "why": " ".join(str(error).split())})
                self._steering.tell(self._refused[-1])
                continue
            self._done.append(known)
            self._steering.tell(known)
            self._stopped = self._stopped or bool(command.get("stop"))

    def _show(self) -> None:
        """Rows that are new to who observes and to the sink."""
        times, slots = self._recorder.result()
        if self._observe is not None and len(times) > (seen := self._observed - self._passed_on):
            self._observe(times[seen:], self._values(slots[seen:]))
            self._observed = self._passed_on + len(times)
        if self._sink is not None and (self._recorder.size >= _MOST_VALUES or self._run.has_ended) and len(times):
            self._sink(times, slots)
            self._passed_on += len(times)
            self._recorder.begin_at(self._passed_on)

    def _finished(self, status: str, pacer: Pacer | None) -> Results:
        results = self._results
        if self._sink is not None and len(self._recorder.result()[0]):
            self._sink(*self._recorder.result())
            self._recorder.begin_at(self._passed_on + len(self._recorder.result()[0]))
        times, slots = self._recorder.result()
        self._run.hand_over(times, slots.copy(), results)
        results.info |= {
            "status": status,
            "loop_time_s": self._loop_time,
            "wall_time_s": clock.perf_counter() - self._began,
            "commands": self._done,
        }
        if self._refused:
            results.info["commands_refused"] = self._refused
        if self._stopped:
            results.info["stop_time"] = self._run.time
        if pacer is not None:
            results.info["realtime"] = pacer.report()
        return results
