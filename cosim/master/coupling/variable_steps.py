"""Variable communication steps: as long as the coupling error allows, by step doubling.

Each step is taken twice: as one, and, after all components have gone back, as two halves. Their difference says how
wrong they are; where that is too much, the components go back once more and take a shorter one. What the two halves
come to is kept. A PI controller chooses the next step.

A step is the whole run, or the time between two points at which signals jump, halved so many times: times are the same
to the last bit whatever the steps on the way, and nothing jumps within a step unless an FMU does.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.errors import SetupError
from cosim.fmi.instance import Instance
from cosim.loop.iterated_step import KeptState
from cosim.master.failures import Failing, InterruptedInCall, SimulationError, SimulationInterrupted
from cosim.master.function_instance import FunctionInstance
from cosim.master.recording import Sink
from cosim.master.run import Grid, Run
from cosim.master.sampling import Samples
from cosim.results.results import Results

#: Coupling error that is kept by default, relative to the largest magnitude of each variable.
DEFAULT_TOLERANCE = 1e-4

#: A step may make its share of the whole error, by its length, and at least this part of it.
_LEAST_SHARE = 1e-3

#: The longest step, the first one and the shortest one, in parts of the run.
_LONGEST, _FIRST, _SHORTEST = 1.0 / 20.0, 1.0 / 1000.0, 1e-10

#: Safety factor and exponents of the PI controller, and by how much a step may change.
_SAFETY, _INTEGRAL, _PROPORTIONAL = 0.9, 0.7, 0.4
_LEAST_CHANGE, _GREATEST_CHANGE = 0.2, 4.0

#: Steps are believed to have an error of this order at most: at the start less is known.
_BELIEVED = 2

#: After a step that an FMU could not take the next one is so many times as long.
_AFTER_FAILURE = 0.25

#: A variable that an FMU says nothing of is not smaller than this part of its nominal value, 1, as errors count.
_PART_OF_NOMINAL = 0.01

#: Breakpoints nearer than this part of the run are one.
_SAME = 1e-9

#: So many grids have their samples at hand.
_GRIDS = 4

#: Rows go to a sink, and progress is reported, so often (rows, s).
_ROWS, _REPORT = 10_000, 0.05


@dataclass(frozen=True)
class Compared:
    """What steps are compared by: names, positions among all values, nominal values."""

    names: Sequence[str]
    positions: np.ndarray
    nominal: np.ndarray


@dataclass(frozen=True)
class VariablePlan:
    """A run with variable steps.

    Attributes
    ----------
    start_time, stop_time : float
        In s.
    tolerance : float
        Largest coupling error, relative to the largest magnitude of each variable.
    breakpoints : sequence of float
        Times (s) at which signals jump or bend.
    order : int
        By which power of the step the coupling error falls, when enough is known.
    record_every : int
        Record at every so many of the communication points.
    samples : callable
        samples(grid) -> samples of the signals.
    """

    start_time: float
    stop_time: float
    tolerance: float
    breakpoints: Sequence[float]
    order: int
    record_every: int
    samples: Callable[[Grid], Samples]

    def segments(self) -> list[tuple[float, float]]:
        """Times (s) between which nothing jumps."""
        near = _SAME * (self.stop_time - self.start_time)
        times = [self.start_time]
        times += [b for b in sorted(set(self.breakpoints)) if self.start_time + near < b < self.stop_time - near]
        kept = [t for i, t in enumerate(times) if i == 0 or t - times[i - 1] > near]
        return list(zip(kept, [*kept[1:], self.stop_time], strict=True))

    def first_grid(self) -> Grid:
        """The communication points of the run, as if all steps were as the first one."""
        start, stop = self.segments()[0]
        level = _level((stop - start) / (_FIRST * (self.stop_time - self.start_time)))
        return _grid(start, stop, level)


def _level(number_of_steps: float) -> int:
    """How often a segment is halved for at least so many steps."""
    return max(0, math.ceil(math.log2(number_of_steps)))


def _grid(start: float, stop: float, level: int) -> Grid:
    return Grid(start, (stop - start) / 2**level, 2**level, stop)


class _Point:
    """A communication point that all components can go back to."""

    def __init__(self, run: Run, instances: Mapping[str, Instance]) -> None:
        self._run, self._instances = run, instances
        self._states: dict[str, KeptState] = {}
        self._of_functions: dict[str, bytes] = {}
        self._values = self._history = np.empty(0)
        for name, instance in instances.items():
            if not isinstance(instance, FunctionInstance):
                self._states[name] = instance.kept_state()

    def keep(self, time: float) -> None:
        """Keep where all components are."""
        for name, instance in self._instances.items():
            with Failing(name, time, instance):
                if isinstance(instance, FunctionInstance):
                    self._of_functions[name] = instance.save_state()
                else:
                    instance.keep(self._states[name])
        self._values, self._history = self._run.values.copy(), self._run.history()

    def go_back(self, time: float) -> None:
        """Have all components where they were."""
        for name, instance in self._instances.items():
            with Failing(name, time, instance):
                if isinstance(instance, FunctionInstance):
                    instance.restore_state(self._of_functions[name])
                else:
                    instance.go_back(self._states[name])
        self._run.take_over(self._values, self._history)


class VariableRun:
    """A run with variable steps, whose FMUs have been initialised.

    Parameters
    ----------
    run : Run
    instances : mapping
        Component -> instance.
    plan : VariablePlan
    compared : Compared
    results : Results
        Without rows.
    sink : callable, optional
        Takes times and slots of rows, which are then not kept.
    stop : callable
        Whether Ctrl-C has come.
    """

    def __init__(
        self,
        run: Run,
        instances: Mapping[str, Instance],
        plan: VariablePlan,
        compared: Compared,
        results: Results,
        sink: Sink | None,
        stop: Callable[[], bool],
    ) -> None:
        self._run, self._plan, self._compared, self._results = run, plan, compared, results
        self._sink, self._stop = sink, stop
        self._point = _Point(run, instances)
        self._duration = plan.stop_time - plan.start_time
        self._part = 2.0 ** min(plan.order, _BELIEVED) - 1.0  # differences over the error of two halves
        self._sizes = _PART_OF_NOMINAL * compared.nominal
        self._times: list[float] = []
        self._rows: list[np.ndarray] = []
        self._n_points = self._rejected = self._failed = 0
        self._steps: list[float] = []  # lengths (s) of those that were kept
        self._worst = np.zeros(len(compared.names))  # how often each variable decided
        self._spacing = 0.0  # of the values that extrapolation knows, in s; 0 where it knows none
        self._wanted = _FIRST * self._duration
        self._last_error = 1.0
        self._reported = -math.inf
        self._samples: dict[Grid, Samples] = {}

    def to_end(self, progress: Callable[[float], None] | None) -> Results:
        """Step to the end; the results have all recorded rows however the run ends.

        Raises
        ------
        SimulationError
            An FMU failed, or no step keeps the coupling error.
        SimulationInterrupted
            Ctrl-C.
        """
        began, time = clock.perf_counter(), self._plan.start_time
        try:
            for i, (start, stop) in enumerate(self._plan.segments()):
                time = start
                if i == 0:
                    self._begin()
                for time in self._through(start, stop):
                    if progress is not None and clock.perf_counter() - self._reported > _REPORT:
                        progress(time)
                        self._reported = clock.perf_counter()
            self._run.terminate(time)
        except SimulationError as error:
            error.results = self._finished("failed", began)
            raise
        except InterruptedInCall as stop_:
            self._run.terminate(stop_.time)
            raise SimulationInterrupted(stop_.time, self._finished("interrupted", began)) from None
        if self._stop():
            raise SimulationInterrupted(time, self._finished("interrupted", began))
        return self._finished("completed", began)

    def _begin(self) -> None:
        grid = self._plan.first_grid()
        self._run.go_by(grid, self._plan.samples(grid), 0)
        self._run.exchange(0)
        self._record(grid.start_time)
        self._learn_sizes()

    def _through(self, start: float, stop: float) -> Iterator[float]:
        """Steps from one time (s) to another; yields the times to which they came."""
        done, whole = 0, 1 << 60  # parts of the segment, of which a step at a level is a power of two
        least = _SHORTEST * self._duration
        while done < whole:
            if self._stop():
                return
            level = _level((stop - start) / min(self._wanted, _LONGEST * self._duration))
            while done % (whole >> level):  # a longer step begins at multiples of its length
                level += 1
            length = (stop - start) / 2**level
            if length < least and self._last_error > 1.0:
                self._give_up(start + done / whole * (stop - start))
            error = self._tried(start, stop, level, done // (whole >> level))
            if error <= 1.0:
                done += whole >> level
                self._steps.append(length)
                yield start + done / whole * (stop - start)
            else:
                self._rejected += 1
            self._choose(length, error)

    def _choose(self, length: float, error: float) -> None:
        """The next length, by a step's error over what it may make."""
        p = self._plan.order
        if not math.isfinite(error):
            self._wanted = _AFTER_FAILURE * length
        else:
            last = self._last_error if error <= 1.0 and self._last_error <= 1.0 else error
            bounded = max(error, 1e-6)
            change = _SAFETY * bounded ** (-_INTEGRAL / p) * max(last, 1e-6) ** (_PROPORTIONAL / p)
            if error > 1.0:
                change = min(_SAFETY * error ** (-1.0 / p), 0.5)
            self._wanted = length * min(max(change, _LEAST_CHANGE), _GREATEST_CHANGE)
        self._last_error = error

    def _give_up(self, time: float) -> None:
        worst = self._compared.names[int(np.argmax(self._worst))]
        raise SimulationError(
            worst.partition(".")[0],
            time,
            f"no communication step keeps a coupling error of {self._plan.tolerance:g}, the shortest is "
            f"{_SHORTEST * self._duration:.3g} s; '{worst}' has the largest; allow more (coupling_tolerance)",
            "",
        )

    # One step

    def _tried(self, start: float, stop: float, level: int, number: int) -> float:
        """The error of a step over what it may make; where it is at most 1, the run stands at the end of the step.

        Infinite where an FMU could not take the step.
        """
        run = self._run
        grid, halved = _grid(start, stop, level), _grid(start, stop, level + 1)
        time = grid.time(number)
        run.go_by(grid, self._samples_at(grid), number)
        self._point.keep(time)
        spacing, recorded = self._spacing, (len(self._times), self._n_points)
        try:
            self._spaced(grid.step_size)
            run.step_to(number + 1)
            whole = run.values[self._compared.positions].copy()
            self._point.go_back(time)
            run.go_by(halved, self._samples_at(halved), 2 * number)
            self._spacing = spacing
            self._spaced(halved.step_size)
            for half in (2 * number, 2 * number + 1):
                run.step_to(half + 1)
                self._record(halved.time(half + 1))
        except SimulationError:
            if not run.may_try_again or grid.step_size < _SHORTEST * self._duration:
                raise
            self._failed += 1
            error = math.inf
        else:
            error = self._error(whole, grid.step_size)
        if error > 1.0:
            del self._times[recorded[0] :], self._rows[recorded[0] :]
            self._n_points = recorded[1]
            self._point.go_back(time)
            self._spacing = spacing
            return error
        self._learn_sizes()
        self._pass_on()
        return error

    def _samples_at(self, grid: Grid) -> Samples:
        """Samples of the signals at the points of a grid; those of the last ones serve again."""
        samples = self._samples.pop(grid, None) or self._plan.samples(grid)
        self._samples[grid] = samples
        if len(self._samples) > _GRIDS:
            del self._samples[next(iter(self._samples))]
        return samples

    def _spaced(self, step: float) -> None:
        """Have extrapolation know values at a distance of the step ahead."""
        if self._spacing not in (0.0, step):
            self._run.space_history(step / self._spacing, self._spacing)
        self._spacing = step

    def _error(self, whole: np.ndarray, step: float) -> float:
        halves = self._run.values[self._compared.positions]
        with np.errstate(all="ignore"):
            sizes = np.maximum(self._sizes, np.abs(halves))
            errors = np.abs(whole - halves) / self._part / sizes
        if not np.isfinite(errors).all():
            return math.inf
        worst = int(np.argmax(errors))
        self._worst[worst] += 1
        return float(errors[worst] / (self._plan.tolerance * max(step / self._duration, _LEAST_SHARE)))

    def _learn_sizes(self) -> None:
        self._sizes = np.maximum(self._sizes, np.abs(self._run.values[self._compared.positions]))

    # What is recorded

    def _record(self, time: float) -> None:
        if self._n_points % self._plan.record_every == 0:
            self._times.append(time)
            self._rows.append(self._run.recorded_at(time))
        self._n_points += 1

    def _pass_on(self, *, at_end: bool = False) -> None:
        if self._sink is not None and self._rows and (at_end or len(self._rows) >= _ROWS):
            self._sink(np.array(self._times), np.array(self._rows))
            self._times.clear()
            self._rows.clear()

    def _finished(self, status: str, began: float) -> Results:
        self._pass_on(at_end=True)
        columns = len(self._results.names)
        rows = np.array(self._rows) if self._rows else np.empty((0, columns))
        self._run.hand_over(np.array(self._times), rows.reshape(-1, columns), self._results)
        steps = np.array(self._steps)
        by = {n: int(k) for n, k in zip(self._compared.names, self._worst, strict=True) if k}
        self._results.info |= {
            "status": status,
            "loop_time_s": clock.perf_counter() - began,
            "variable_steps": {
                "tolerance": self._plan.tolerance,
                "steps": len(steps),
                "rejected": self._rejected,
                "not_taken": self._failed,
                "shortest": float(steps.min()) if len(steps) else None,
                "longest": float(steps.max()) if len(steps) else None,
                "limited_by": dict(sorted(by.items(), key=lambda item: -item[1])),
            },
        }
        return self._results


def check_any_step(instances: Mapping[str, Instance]) -> None:
    """Whether all FMUs take steps of any length.

    Raises
    ------
    SetupError
        One doesn't.
    """
    for name, instance in instances.items():
        if not isinstance(instance, FunctionInstance) and not instance.takes_any_step:
            raise SetupError(
                f"step_size = 'variable': the FMU of component '{name}' takes steps of one length only "
                "(canHandleVariableCommunicationStepSize)"
            )
