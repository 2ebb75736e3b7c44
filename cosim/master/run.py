"""One run of instantiated FMUs: initialisation, then the compiled stepping loop, chunk by chunk."""

from __future__ import annotations

import ctypes
import dataclasses
import math
import time as clock
import weakref
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from cosim.fmi.event_mode import EventInstance
from cosim.fmi.instance import CallFailed, CallInterrupted, ExperimentSetup, Instance, StepStatus
from cosim.fmi.messages import summary
from cosim.fmi.types import Texts
from cosim.fmi.variable_buffer import VariableBuffer
from cosim.loop.algebraic_loop import NO_SOLUTION
from cosim.loop.binding import (
    DOES_NOT_FIT,
    NOT_FINITE,
    RETURNED_EARLY,
    WANTS_TO_END,
    Extrapolated,
    Looks,
    Loop,
    Operation,
    OperationKind,
    Warned,
    loop_library,
)
from cosim.loop.channel import on_one_core
from cosim.loop.current_calls import address_of_call, function_of, have_one_component, is_at, left_call
from cosim.loop.iterated_step import NOT_CONVERGED
from cosim.loop.team import Team, Threads
from cosim.master import chunks
from cosim.master.chunks import ChunkLength
from cosim.master.component_times import ComponentTimes
from cosim.master.coupling.model_exchange import ModelExchangeGroup
from cosim.master.failures import (
    HOLD_INSTEAD,
    Failing,
    InterruptedInCall,
    SimulationError,
    SimulationInterrupted,
    reason_of,
)
from cosim.master.function_instance import FunctionInstance, in_one_line
from cosim.master.interrupts import DeferredInterrupt
from cosim.master.operations import Exchange, NamedOperation, OperationTable
from cosim.master.pacing import Pacer
from cosim.master.recording import Marks, NonFinite, RecordedColumns, Recorder
from cosim.master.refusals import refused_of
from cosim.master.sampling import Samples
from cosim.master.unfinished_steps import EndedBy, UnfinishedSteps
from cosim.results.results import Results
from cosim.system.resolution import StartValue
from cosim.system.variables import variables_of

#: A run that is stepped by hand samples its signals for so many points ahead.
_AHEAD = 1000

#: An FMU that ends the simulation this near (in steps) to a communication point has reached it, for rounding.
_SAME_TIME = 1e-6

#: In place of the status with which an FMU refused inputs during a step: that is known.
_TOLD = -1

#: Statuses after which a shorter step may do: the FMU has discarded it, or something is not finite or has no solution.
_SHORTER_MAY_DO = (2, NOT_FINITE, NO_SOLUTION, NOT_CONVERGED)

#: Status of FMI after which an instance is left alone.
_FATAL = 4

#: Any function of the standard, for the code of a component.
_ANY = "fmi2DoStep"

#: Fewer points than these are not worth to settle on a core.
_LONG = 64


@dataclass(frozen=True)
class Grid:
    """The communication points `start_time + i * step_size`, i = 0 ... last_point (s).

    The stop time (s) is that of the last point, but for rounding; None for a run without an end.
    """

    start_time: float
    step_size: float
    last_point: int
    stop_time: float | None = None

    def told_stop_time(self, every: int = 1) -> float | None:
        """Stop time (s) that an FMU is told which makes a step at every so many points.

        Where its last step ends later, for rounding (0.2 + 0.1 > 0.3) or since the run ends within it, its end.
        """
        if self.stop_time is None:
            return None
        begin = (self.last_point - 1) // every * every
        return max(self.stop_time, self.time(begin) + every * self.step_size)

    def time(self, point: int) -> float:
        """Time (s) of a point."""
        return self.start_time + point * self.step_size


class Run:
    """One run of instantiated FMUs."""

    def __init__(
        self,
        instances: Mapping[str, Instance],
        exchange: Exchange,
        samples: Samples,
        grid: Grid,
        interrupt: DeferredInterrupt,
        columns: RecordedColumns,
        threads: Threads,
        group: ModelExchangeGroup | None = None,
        *,
        profile: bool = False,
        nonfinite: NonFinite = "mark",
        postpone: Callable[[Callable[[], None], Callable[[], None]], None] | None = None,
        restore_process: Callable[[], None] = lambda: None,
    ) -> None:
        self._restore_process = restore_process
        self._columns = columns
        self._postpone = postpone  # telling FMUs that the run is over; at once by default
        self._ends_at_nonfinite = nonfinite == "error"
        #: Of what went elsewhere than into the results.
        self.marks = Marks(columns)
        self._threads = threads
        self._times = ComponentTimes(exchange, grid.last_point + 1) if profile else None
        self._team = Team(threads, *exchange.units_at_step()) if threads != 1 else None
        shared = self._team is None and any(instance.shares_core for instance in instances.values())
        self._where: Callable[[], AbstractContextManager[None]] = on_one_core if shared else nullcontext
        self._group = group
        self._instances = instances
        self._exchange = exchange
        self._samples = samples
        self._grid = grid
        self._interrupt = interrupt
        for instance in instances.values():
            if isinstance(instance, FunctionInstance):
                instance.interrupt = interrupt
        self._loop = Loop(
            start_time=grid.start_time,
            step_size=grid.step_size,
            per_second=1.0 / grid.step_size,
            last_point=grid.last_point,
            values=_pointer(exchange.values, ctypes.c_double),
            n_samples=samples.values.shape[1],
            runs=_pointer(exchange.recorded_runs, ctypes.c_int32),
            n_runs=len(exchange.recorded_runs),
            n_recorded=int(exchange.recorded_runs[:, 1].sum()),
            record_every=1,
            at_point=exchange.at_point.operations,
            at_step=exchange.at_step.operations,
            n_at_point=len(exchange.at_point),
            n_at_step=len(exchange.at_step),
            codes_at_point=exchange.at_point.codes,
            codes_at_step=exchange.at_step.codes,
            profile=None if self._times is None else ctypes.pointer(self._times.profile),
            start=None if exchange.starting is None else exchange.starting.address,
            team=None if self._team is None else self._team.address,
            warned=_counting_warnings(instances, {} if group is None else group.addresses),
            **({"looks": _looks} if any(instance.is_isolated for instance in instances.values()) else {}),
        )
        this = weakref.ref(self)  # what FMUs say when the run is gone has no time, and must not keep its memory
        for instance in instances.values():
            instance.messages.follow(lambda: None if (run := this()) is None else run.time)

        if exchange.events is not None:
            exchange.events.attach(*self._for_events())
        self._unfinished = UnfinishedSteps(instances, self._stop)
        self.ended_by: EndedBy | None = None
        self._end_point = 0
        self._not_terminated: dict[str, str] = {}
        self._info: dict[str, Any] | None = None  # of results that were handed over
        self._failed: NamedOperation | None = None
        self._sampled_from = self._sampled_end = 0
        self._ahead = _AHEAD
        self._records: np.ndarray | None = None  # that the loop points at

    @property
    def time(self) -> float:
        """Time (s) of the communication point that the run has come to."""
        return self._grid.time(self._loop.point)

    def _for_events(self) -> tuple[Callable[[], int], float, Callable[[int], None]]:
        """Where the run stands, its step (s), and an exchange again, for events; they must not keep the run."""
        this, table, loop = weakref.ref(self), self._exchange.at_point, self._loop
        first, end = self._exchange.exchanged_again

        def exchange(point: int) -> None:
            run = this()
            assert run is not None
            run._perform_operations(table, first, end, point)

        return lambda: int(loop.point), self._grid.step_size, exchange

    def initialize(self, starts: Sequence[StartValue], experiments: Mapping[str, ExperimentSetup]) -> None:
        """Set start values and run all FMUs, each for its experiment, through their initialisation mode."""
        time = self._grid.start_time
        for component, instance in self._instances.items():
            own = [s for s in starts if s.component == component]
            structural = [s for s in own if s.is_structural]
            own = [s for s in own if not s.is_structural]
            with Failing(component, time, instance):
                if structural:
                    instance.configure(partial(_set_start_values, instance, structural))
                instance.set_up(experiments[component])
                _set_start_values(instance, own)
                instance.enter_initialization_mode(experiments[component])
                _set_start_elements(instance, own)
        repeats = (
            self._exchange.events is not None
            or self._group is not None
            or self._exchange.iterations() is not None
            or self._exchange.iterated_steps() is not None
        )
        for instance in self._instances.values() if repeats else ():
            if isinstance(instance, FunctionInstance):  # after an event its inputs may be others
                instance.is_stepped = True
        if self._samples.cover(0, 1, lambda: False) < 1:
            raise self._signal_failure(0)
        self._point_at_samples()
        self._exchange_at_start(experiments)
        for component, instance in self._instances.items():
            with Failing(component, time, instance):
                instance.exit_initialization_mode()
        if self._group is not None:
            self._group.begin(experiments, self._grid.step_size)

    def refused_derivatives(self) -> dict[str, str]:
        """Component -> how its FMU refuses derivatives of its inputs, all zero, after the initialisation mode.

        Those of FMI 3.0 ask for their inputs during a step, and refuse them there.
        """
        refused = {}
        for row in self._exchange.steps.rows:
            operation = row.operation
            if operation.kind != OperationKind.EXTRAPOLATE or operation.version == 3:
                continue
            n, orders = operation.n_references, Extrapolated.from_address(operation.data).orders
            try:
                self._instances[row.component].call(
                    row.function, _address(operation.references), n, _address(orders), (ctypes.c_double * n)()
                )
            except CallFailed as error:
                refused[row.component] = str(error)
        return refused

    def refused_outputs(self) -> tuple[str, dict[str, str]]:
        """Component whose outputs could not be read, and those that its FMU refuses to give, with what it did."""
        row = self._failed
        if row is None or row.transfer is None or self._loop.status in (NOT_FINITE, _FATAL):
            return "", {}
        if self._instances[row.component].is_unusable:
            return "", {}
        return row.component, refused_of(self._instances[row.component], row.transfer)

    def _exchange_at_start(self, experiments: Mapping[str, ExperimentSetup]) -> None:
        """Exchange values in the initialisation mode.

        FMI 1.0 has no such mode: an FMU is initialised when its inputs have been set and before its first output is
        read.
        """
        table, done = self._exchange.at_start, 0
        waiting = {component for component, instance in self._instances.items() if instance.version == 1}
        for i, row in enumerate(table.rows if waiting else ()):
            if row.operation.kind == OperationKind.GET and row.component in waiting:
                self._perform_operations(table, done, i, 0)
                done = i
                self._initialize_alone(row.component, experiments[row.component])
                waiting.remove(row.component)
        self._perform_operations(table, done, len(table), 0)
        for component in waiting:
            self._initialize_alone(component, experiments[component])

    def _initialize_alone(self, component: str, experiment: ExperimentSetup) -> None:
        instance = self._instances[component]
        with Failing(component, experiment.start_time, instance):
            instance.initialize(experiment)

    def _perform_operations(self, table: OperationTable, first: int, end: int, point: int) -> None:
        """Perform the operations first ... end - 1 of a table."""
        if not self._performed(table, first, end, point):
            self._loop.failed += first
            raise self._failure(table)

    def _performed(self, table: OperationTable, first: int, end: int, point: int) -> bool:
        """Perform the operations first ... end - 1 of a table; whether all went well."""
        self._loop.call = address_of_call()
        operations, codes = table.from_row(first)
        return self._call(loop_library().loop_perform, operations, codes, end - first, point)

    def _call(self, function: Callable[..., Any], *arguments: Any) -> bool:
        """Whether all went well in a function of the loop.

        Raises
        ------
        SimulationError
            An FMU has crashed, where that is an exception of Python, as on Windows.
        """
        try:
            return bool(function(ctypes.byref(self._loop), *arguments))
        except OSError as error:
            code, time = left_call(), self._grid.time(self._loop.point)
            for component, instance in self._instances.items():
                if have_one_component(instance.code_of_call(_ANY), code):
                    failed = instance.crashed(function_of(code), error)
                    raise SimulationError(component, time, str(failed), instance.log()) from failed
            raise SimulationError("a component", time, f"crashed ({error})", "") from error

    def loop(
        self,
        recorder: Recorder,
        record_every: int,
        results: Results,
        progress: Callable[[float], None] | None,
        pacer: Pacer | None,
    ) -> Results:
        """Step to the end; the results have all recorded rows however the loop ends."""
        loop_began = loop_ended = clock.perf_counter()

        def finish(status: str) -> Results:
            results.info["status"] = status
            results.info["loop_time_s"] = loop_ended - loop_began
            self.hand_over(*recorder.result(), results)
            if pacer is not None:
                results.info["realtime"] = pacer.report()
            return results

        grid, point = self._grid, 0
        self._loop.record_every = record_every
        if progress is not None:
            progress(grid.start_time)
        chunk = ChunkLength(None if recorder.capacity is None else record_every * recorder.capacity)
        try:
            while point <= grid.last_point:
                if pacer is not None:
                    pacer.wait(grid.time(point) - grid.start_time, self._stop)
                    chunk.steps = 1
                if self._interrupt.requested:
                    self._terminate(grid.time(point))
                    raise SimulationInterrupted(grid.time(point), finish("interrupted"))
                began, first = clock.perf_counter(), point
                try:
                    point = self._go_on(recorder, point, min(point + chunk.steps, grid.last_point + 1), record_every)
                finally:  # what FMUs take to terminate is not the loop's time
                    loop_ended = clock.perf_counter()
                if progress is not None:
                    progress(grid.time(max(0, point - 1)))
                chunk.took(point - first, loop_ended - began)
                if self.ended_by is not None:
                    break
            self._terminate(grid.time(grid.last_point if self.ended_by is None else self._end_point))
        except SimulationError as error:
            error.results = finish("failed")
            raise
        except InterruptedInCall as stop:
            self._terminate(stop.time)
            raise SimulationInterrupted(stop.time, finish("interrupted")) from None
        if self._interrupt.requested:
            raise SimulationInterrupted(grid.time(grid.last_point), finish("interrupted"))
        return finish("completed")

    @property
    def texts(self) -> Texts:
        """Texts and binary values that slots have the numbers of."""
        return self._columns.texts

    def _say(self, results: Results) -> None:
        """Have results say what was out of the ordinary."""
        if self.ended_by is not None:
            results.info["ended_by"] = dataclasses.asdict(self.ended_by)
        if self._unfinished.repeated:
            results.info["steps_repeated"] = dict(self._unfinished.repeated)
        between = {n: i.between for n, i in self._instances.items() if isinstance(i, EventInstance) and i.between}
        if between:
            results.info["events_between_points"] = between
        if refusing := self._exchange.refusing():
            said = dict.fromkeys(sorted(refusing), "it refuses fmi3SetFloat64 during a step")
            results.info["derivatives_refused"] = {**results.info.get("derivatives_refused", {}), **said}
        if self._times is not None:
            results.info["profile"] = self._times.summary(int(self._loop.point) + 1, self._unfinished.repeated)
        if self._team is not None:
            results.info["threads"] = {
                "asked": self._threads,
                "used": self._team.threads,
                "steps_together": self._team.steps_together,
            }
        if iterations := self._exchange.iterations():
            results.info["iterations"] = iterations
        if iterated := self._exchange.iterated_steps():
            results.info["iterated_steps"] = iterated
        if self._exchange.starting is not None and (starts := self._exchange.starting.summary()):
            results.info["starting_blocks"] = starts
        if self._group is not None:
            results.info["model_exchange"] = self._group.summary()
        self._info = results.info
        self._say_how_it_ended(results.info)

    def _say_how_it_ended(self, info: dict[str, Any]) -> None:
        if self._not_terminated:
            info["not_terminated"] = dict(self._not_terminated)
        info |= summary(instance.messages for instance in self._instances.values())

    def hand_over(self, times: np.ndarray, slots: np.ndarray, results: Results) -> None:
        """Give results what was recorded: times (n,) and slots (n, columns)."""
        results.time, results.typed = times, self._columns.typed(slots)
        results.values = self._columns.numbers(slots, results.typed)
        marks = Marks(self._columns)
        marks.look(times, slots)
        if found := self.marks.found | marks.found:
            results.info["nonfinite"] = found
        self._say(results)

    # By hand

    @property
    def values(self) -> np.ndarray:
        """All values that are exchanged or recorded, where the layout has them."""
        return self._exchange.values

    def exchange(self, point: int, components: Collection[str] | None = None) -> None:
        """Exchange values at a communication point; with `components`, only read their outputs.

        Raises
        ------
        SimulationError
            An FMU or a signal fails.
        """
        if self._sampled_until(point, point + 1) <= point:
            raise self._signal_failure(point)
        table = self._exchange.at_point
        if components is None:
            self._perform_operations(table, 0, len(table), point)
            return
        for first, n in _reads(table, components):
            self._perform_operations(table, first, first + n, point)

    def advance(self, recorder: Recorder, first: int, end: int, record_every: int) -> int:
        """Step from a communication point, where values have been exchanged, to another, and exchange there.

        Returns the point that was reached: an earlier one after Ctrl-C.

        Raises
        ------
        SimulationError
            An FMU or a signal fails.
        """
        self._loop.record_every = record_every
        point = first
        while point < end and not (point > first and self._interrupt.requested):
            chunk_end = min(end, point + chunks.MOST)
            reached = min(chunk_end, self._sampled_until(point, chunk_end + 1))
            if reached <= point:
                raise self._signal_failure(point)
            self._perform(recorder, point, reached, record_every, exchanged=point == first)
            if self.ended_by is not None:
                return self._end_point
            point = reached
        self.exchange(point)
        return point

    # With variable steps

    def go_by(self, grid: Grid, samples: Samples, point: int) -> None:
        """Go on from a communication point of another grid, with samples of the signals there."""
        self._grid, self._samples, loop = grid, samples, self._loop
        samples.begin_at(point)
        self._sampled_from = self._sampled_end = self._ahead = 0
        loop.start_time, loop.step_size, loop.per_second = grid.start_time, grid.step_size, 1.0 / grid.step_size
        loop.last_point = grid.last_point

    def step_to(self, point: int) -> None:
        """Step from the communication point before to this one, and exchange values there.

        Raises
        ------
        SimulationError
            An FMU or a signal fails.
        """
        if self._sampled_until(point - 1, point + 1) < point:
            raise self._signal_failure(point)
        table = self._exchange.at_step
        self._perform_operations(table, 0, len(table), point - 1)
        self.exchange(point)

    @property
    def may_try_again(self) -> bool:
        """Whether the step that failed might go well if it were shorter."""
        return self._loop.status in _SHORTER_MAY_DO

    def take_over(self, values: np.ndarray, history: np.ndarray) -> None:
        """Take over values (n,) and a history."""
        self._exchange.values[:] = values
        self._exchange.restore_history(history)

    def space_history(self, ratio: float, last_step: float) -> None:
        """Have extrapolation know values at another distance, so many times that of the last step (s)."""
        self._exchange.space_history(ratio, last_step)

    def recorded_at(self, time: float) -> np.ndarray:
        """The recorded values (columns,) at this moment.

        Raises
        ------
        SimulationError
            One is not finite, where that ends the run.
        """
        row = self.recorded_now()
        if self._ends_at_nonfinite and (found := self._columns.first_not_finite(row[None])) is not None:
            raise self._not_finite(found[1], float(row[self._columns.names.index(found[1])]), time)
        return row

    def _sampled_until(self, first: int, end: int) -> int:
        """End of the points from `first` on that have samples: at `end` or before, at `first` only if a signal fails.

        Signals are sampled ahead, for a sampling costs more than a step.
        """
        if not (self._sampled_from <= first and end <= self._sampled_end):
            wanted = min(end + self._ahead, self._grid.last_point + 1)
            reached = self._samples.cover(first, wanted, lambda: False)
            while reached <= first and self._samples.failure is None:  # a slow signal comes bit by bit
                reached = self._samples.cover(first, wanted, lambda: False)
            self._sampled_from, self._sampled_end = first, reached
            self._point_at_samples()
        return self._sampled_end

    def history(self) -> np.ndarray:
        """Values of extrapolated inputs at earlier communication points, as numbers (n,)."""
        return self._exchange.history()

    def forget_history(self) -> None:
        """Hold extrapolated inputs over their next step: something has jumped."""
        self._exchange.forget_history()

    def stand_at(self, point: int, values: np.ndarray, history: np.ndarray) -> None:
        """Take over the values (n,) and the history of a run that stood at a communication point."""
        self._exchange.values[:] = values
        self._exchange.restore_history(history)
        self._samples.begin_at(point)
        self._sampled_end = 0

    def recorded_now(self) -> np.ndarray:
        """The recorded values (columns,) at this moment."""
        runs = self._exchange.recorded_runs
        return np.concatenate([self.values[a : a + n] for a, n in runs.tolist()] or [np.empty(0)])

    def record(self, recorder: Recorder, point: int, record_every: int) -> None:
        """Record the values as they are for a communication point."""
        if point % record_every == 0:
            row = _rows(point, record_every)
            rows, first = recorder.room(row, row + 1)
            rows[row - first] = self.recorded_now()
            self._loop.first_record = first
            self._recorded_until(recorder, rows, row, row + 1)

    def terminate(self, time: float) -> None:
        """Tell all FMUs that the run is over."""
        self._terminate(time)

    def _go_on(self, recorder: Recorder, first: int, end: int, record_every: int) -> int:
        """Perform a chunk of points; returns the first point that is still to be performed."""
        end = self._samples.cover(first, end, self._stop)
        if end == first:
            if self._samples.failure is None:  # Ctrl-C came while a signal was sampled
                return first
            raise self._signal_failure(first)
        self._point_at_samples()
        self._perform(recorder, first, end, record_every, exchanged=False)
        return end

    def _perform(self, recorder: Recorder, first: int, end: int, record_every: int, *, exchanged: bool) -> None:
        """Perform points that have samples; at the first one values may have been `exchanged` already."""
        begin = _rows(first, record_every)
        rows, self._loop.first_record = recorder.room(begin, _rows(end, record_every))
        if rows is not self._records:
            self._records, self._loop.records = rows, _pointer(rows, ctypes.c_double)
        self._loop.call = address_of_call()
        while first < end:
            try:
                if self._steps(first, end, exchanged=exchanged):
                    break
            except SimulationError as error:  # a crash, in a step or in the exchange before it
                stepped = isinstance(error.__cause__, CallFailed) and error.__cause__.function.endswith("DoStep")
                self._recorded_until(recorder, rows, begin, _rows(self._loop.point + stepped, record_every))
                raise
            stepping, point = bool(self._loop.failed_at_step), self._loop.point
            begin = self._recorded_until(recorder, rows, begin, _rows(point + stepping, record_every))
            if not stepping:
                raise self._failure(self._exchange.at_point)
            if self._exchange.starting is not None and (stuck := self._exchange.starting.failure()):
                component, failure = stuck
                reason = reason_of(failure)
                raise SimulationError(component, self._grid.time(point), reason, self._instances[component].log())
            self._finish_step(point)
            first, exchanged = point + 1, False
            if self.ended_by is not None:
                self._end_at(recorder, first, record_every)
                return
        self._recorded_until(recorder, rows, begin, _rows(end, record_every))

    def _steps(self, first: int, end: int, *, exchanged: bool) -> bool:
        """Step in the compiled loop; whether all went well."""
        with self._where() if end - first >= _LONG else nullcontext():
            done = self._call(loop_library().loop_run, first, end, exchanged)
        self._restore_process()
        return done

    def _recorded_until(self, recorder: Recorder, rows: np.ndarray, begin: int, end: int) -> int:
        """Have recorded the rows begin ... end - 1, which the loop has filled; returns the end.

        Raises
        ------
        SimulationError
            A value in them is not finite, where that ends the run; the rows before are recorded.
        """
        first = self._loop.first_record
        found = self._columns.first_not_finite(rows[begin - first : end - first]) if self._ends_at_nonfinite else None
        if found is None:
            recorder.recorded(end)
            return end
        row, name = begin + found[0], found[1]
        recorder.recorded(row)
        value = float(rows[row - first, self._columns.names.index(name)])
        raise self._not_finite(name, value, self._grid.time(row * self._loop.record_every))

    def _not_finite(self, name: str, value: float, time: float) -> SimulationError:
        component, _, variable = name.partition(".")
        what = f"'{variable}' is {value}; --nonfinite mark goes on"
        return SimulationError(component, time, what, self._instances[component].log())

    def _finish_step(self, point: int) -> None:
        """Finish the step from a communication point on, in which the loop got stuck at an operation."""
        table, loop = self._exchange.at_step, self._loop
        while True:
            k = loop.failed
            row, operation = table.rows[k], table.operations[k]
            if operation.kind == OperationKind.EXTRAPOLATE and operation.version == 3 and not self._exchange.demanded:
                Extrapolated.from_address(operation.data).refused = _TOLD
                if self._has_rest_of_step_gone_well(k, point):
                    return
                continue
            if operation.kind == OperationKind.GROUP and loop.status == WANTS_TO_END:
                assert self._group is not None
                self.ended_by = self.ended_by or self._group.ended()
                if self._has_rest_of_step_gone_well(k, point):
                    return
                continue
            if operation.kind != OperationKind.STEP:
                raise self._failure(table)
            time, step = self._grid.time(point), operation.every * self._grid.step_size
            inputs = [
                o
                for o in table.operations[:k]
                if o.kind == OperationKind.EXTRAPOLATE and o.instance == operation.instance
            ]
            with Failing(row.component, time, self._instances[row.component]):
                status = self._status_of_step(row, operation, loop.status, time)
                ended_by = self._unfinished.finish(row.component, status, time, step, inputs)
            self.ended_by = self.ended_by or ended_by
            if self._has_rest_of_step_gone_well(k, point):
                return

    def _has_rest_of_step_gone_well(self, failed: int, point: int) -> bool:
        """Perform what a step has left once the operation that failed has been dealt with; whether all went well."""
        self._loop.call = address_of_call()
        return self._call(loop_library().loop_rest_of_step, failed, point)

    def _status_of_step(self, row: NamedOperation, operation: Operation, status: int, time: float) -> StepStatus:
        if operation.version < 3:
            return self._instances[row.component].status_of_step(status, time)
        reached = ctypes.c_double.from_address(operation.data).value
        if status in (WANTS_TO_END, RETURNED_EARLY):
            return StepStatus(0, status == WANTS_TO_END, reached, returned_early=status == RETURNED_EARLY)
        return StepStatus(status, has_ended=False, reached=reached)

    def _end_at(self, recorder: Recorder, point: int, record_every: int) -> None:
        """Record a communication point, if the FMU that ended the simulation has reached it."""
        assert self.ended_by is not None
        self._end_point = point - 1
        if abs(self.ended_by.time - self._grid.time(point)) <= _SAME_TIME * self._grid.step_size:
            self._end_point = point
            self.exchange(point)
            self.record(recorder, point, record_every)

    def _stop(self) -> bool:
        return self._interrupt.requested

    def _point_at_samples(self) -> None:
        samples, loop = self._samples, self._loop
        loop.samples, loop.jumps = _pointer(samples.values, ctypes.c_double), _pointer(samples.jumps, ctypes.c_uint8)
        if samples.inside is not None:
            loop.samples_inside = _pointer(samples.inside, ctypes.c_double)
        loop.first_sample, loop.n_rows = samples.first, samples.end - samples.first

    def _terminate(self, time: float) -> None:
        if self._postpone is None:
            self._terminate_now(time)
        else:
            self._postpone(partial(self._terminate_late, time), self._say_again)

    def _terminate_late(self, time: float) -> None:
        is_at(time)
        try:
            self._terminate_now(time)
        finally:
            is_at(None)

    def _terminate_now(self, time: float) -> None:
        """Tell all FMUs that the run is over; what they have computed is as good when one fails in that."""
        for component, instance in self._instances.items():
            try:
                with Failing(component, time, instance):
                    instance.terminate()
            except SimulationError as error:
                self._not_terminated[component] = str(error)
        self._say_again()

    def _say_again(self) -> None:
        if self._info is not None:
            self._say_how_it_ended(self._info)

    # Failures

    def _signal_failure(self, point: int) -> SimulationError:
        samples = self._samples
        component = samples.failed.component if samples.failed else ""
        error = SimulationError(component, self._grid.time(point), str(samples.failure), "")
        error.__cause__ = samples.failure
        return error

    def _failure(self, table: OperationTable) -> BaseException:
        """The error that the loop has ended with."""
        row, time = table.rows[self._loop.failed], self._grid.time(self._loop.point)
        if row.iterated is not None:
            of_table = row.iterated.failed(self._loop.status)
            if of_table is None:
                component, what = row.iterated.failure(self._loop.status, self._instances)
                return SimulationError(component, time, what, "")
            row = of_table
        if row.torn is not None:
            if what := row.torn.failure(self._loop.status):
                self._failed = row
                return SimulationError(", ".join(row.torn.components), time, what, "")
            row = table.rows[row.torn.failed_row]
        if row.raised is not None:
            error = row.raised()
            if isinstance(error, BaseException):
                self._failed = row
                return error
            row = error
        self._failed = row
        instance = self._instances[row.component]
        if isinstance(instance, FunctionInstance) and row.operation.kind == OperationKind.CALL:
            return _failure_of_call(row.component, time, instance.raised())
        what = self._reason(row, self._loop.status, instance)
        if isinstance(what, CallInterrupted):
            return InterruptedInCall(time)
        return SimulationError(row.component, time, str(what), instance.log())

    def _reason(self, row: NamedOperation, status: int, instance: Instance) -> str | CallFailed:
        if status == NOT_FINITE:
            values = self._exchange.values
            wrong = [f"'{name}'" for name, position in row.finite if not math.isfinite(values[position])]
            return f"{len(wrong)} outputs are not finite, the first is {wrong[0]}"
        if status == DOES_NOT_FIT:
            return self._misfit(row)
        failure = instance.failure(row.function, status)
        if row.operation.kind == OperationKind.EXTRAPOLATE:
            return f"{failure}{HOLD_INSTEAD}"
        return failure if isinstance(failure, CallInterrupted) else reason_of(failure)

    def _misfit(self, row: NamedOperation) -> str:
        """The value of a link between different types that does not fit its target, in words."""
        for link in row.converted:
            value = self._exchange.value(link.source_component, link.source)
            if not link.carries(value):
                scaled = f" (times {link.factor!r} plus {link.offset!r})" if link.is_scaled else ""
                return (
                    f"'{link.source_component}.{link.source.name}' = {value!r}{scaled} does not fit input "
                    f"'{link.target.name}' of type {link.target.variable.type}"
                )
        raise AssertionError("a value that fits was refused")


#: Kinds of operations that compute or read outputs.
_READING = (OperationKind.GET, OperationKind.CALL, OperationKind.DIFFERENTIATE)

#: Kinds of operations, in the words of a warning.
_DOINGS = {
    OperationKind.SET: "setting inputs",
    OperationKind.GET: "reading outputs",
    OperationKind.EXTRAPOLATE: "setting derivatives of inputs",
    OperationKind.DIFFERENTIATE: "reading derivatives of outputs",
    OperationKind.GROUP: "model exchange",
}


def _look() -> None:
    """Let Python run the handlers of signals, which it does between two of its instructions."""
    with suppress(KeyboardInterrupt):  # the second Ctrl-C; the first one is known
        pass


_looks = Looks(_look)


def _counting_warnings(instances: Mapping[str, Instance], further: Mapping[int, str]) -> Any:
    """What the loop calls where an operation returns a warning; it must not know the run, or both would stay.

    `further` are addresses that operations have in place of that of an instance, with their components.
    """
    messages = {instance.address: instance.messages for instance in instances.values()}
    messages |= {address: instances[name].messages for address, name in further.items()}

    def warned(operation: Any) -> None:
        told = operation.contents
        messages[told.instance].warned(
            _DOINGS.get(told.kind, "fmiDoStep" if told.version == 1 else f"fmi{told.version}DoStep")
        )

    return Warned(warned)


def _failure_of_call(component: str, time: float, raised: BaseException) -> BaseException:
    """The error for an exception that ended a call of a function."""
    if isinstance(raised, KeyboardInterrupt):
        return InterruptedInCall(time)
    if not isinstance(raised, Exception):  # SystemExit
        return raised
    what = str(raised) if isinstance(raised, CallFailed) else f"its function raised {in_one_line(raised)}"
    error = SimulationError(component, time, what, "")
    error.__cause__ = raised
    return error


def _reads(table: OperationTable, components: Collection[str]) -> Iterator[tuple[int, int]]:
    """Places of the operations that compute and read outputs of components."""
    for i, row in enumerate(table.rows):
        if row.operation.kind in _READING and row.component in components:
            yield i, 1


def _rows(point: int, record_every: int) -> int:
    """Number of rows that are recorded before a point."""
    return -(-point // record_every)


def _address(pointer: Any) -> Any:
    return ctypes.cast(pointer, ctypes.c_void_p)


def _pointer(array: np.ndarray, kind: Any) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(kind))


def _set_start_values(instance: Instance, starts: Sequence[StartValue]) -> None:
    for start in starts:
        if start.is_whole:
            slots = start.elements[0].type.slots(start.values, instance.texts)
            VariableBuffer(instance, variables_of(start.elements), slots).set()


def _set_start_elements(instance: Instance, starts: Sequence[StartValue]) -> None:
    """Set single elements of arrays and keep the others, which can't be read before the initialisation mode."""
    for start in starts:
        if not start.is_whole:
            element = start.elements[0]
            whole = np.zeros(math.prod(element.variable.shape))
            buffer = VariableBuffer(instance, [element.variable], whole)
            buffer.get()
            whole[element.offset : element.offset + 1] = element.type.slots(start.values, instance.texts)
            buffer.set()
