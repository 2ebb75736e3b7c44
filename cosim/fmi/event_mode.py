"""An instance of an FMU of FMI 3.0 with clocks, whose events the importer handles in its event mode.

The standard requires the event mode for FMUs with clocks. Values of clocked variables are got and set while one of
their clocks is active, and other discrete inputs and tunable parameters, when they change, in the event mode.
"""

from __future__ import annotations

import ctypes
import json
import math
import struct
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import fmpy.fmi3 as fmi3
import numpy as np
from fmpy.model_description import ModelDescription, ModelVariable

from cosim.fmi.instance import CallFailed, ExperimentSetup, Instance, StepStatus, function_address
from cosim.fmi.messages import Messages
from cosim.fmi.shared_library import Library, Loader
from cosim.fmi.types import Texts
from cosim.fmi.variable_buffer import VariableBuffer

#: Updates of discrete states at one time after which they are taken to go on forever.
MOST_UPDATES = 1000

#: Steps in a row that an FMU may end for an event where it began them.
_MOST_STANDSTILLS = 100

#: Times nearer to each other than this part of a communication step are the same, for rounding.
_SAME = 1e-6

_WARNING, _ERROR = 1, 3

#: fmi3IntervalQualifier
_CHANGED = 2

#: `Element.timing` of clocks, and of what changes in the event mode; that of clocked variables are their clocks.
CLOCK, DISCRETE = "clock", "discrete"

_Step = ctypes.CFUNCTYPE(
    ctypes.c_int,
    *(ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool),
    *(ctypes.c_void_p, ctypes.POINTER(ctypes.c_bool), ctypes.c_void_p, ctypes.POINTER(ctypes.c_double)),
)


def is_time_based(variable: ModelVariable) -> bool:
    """Whether a variable is a clock that ticks at times that its FMU gives."""
    is_input_clock = variable.type == "Clock" and variable.causality == "input"
    return bool(is_input_clock and variable.intervalVariability != "triggered")


def has_settable_interval(variable: ModelVariable) -> bool:
    """Whether a variable is a clock whose interval its importer chooses."""
    return is_time_based(variable) and variable.intervalVariability in ("fixed", "tunable")


def set_intervals(description: ModelDescription, start: Mapping[str, Any]) -> None:
    """Give clocks in a model description the intervals (s) that start values say.

    Values that are no intervals are left to whoever checks start values.
    """
    for variable in description.modelVariables:
        if variable.name in start and has_settable_interval(variable):
            with suppress(TypeError, ValueError, OverflowError):
                variable.intervalDecimal, variable.intervalCounter = float(start[variable.name]), None


def uses_events(description: ModelDescription) -> bool:
    """Whether an FMU has clocks, and the event mode that they need."""
    interface = description.coSimulation
    return bool(
        description.fmiMajorVersion == 3
        and getattr(interface, "hasEventMode", False)
        and any(v.type == "Clock" for v in description.modelVariables)
    )


def timing_of(variable: ModelVariable) -> str:
    """When values of a variable of an FMU that uses events are exchanged.

    `CLOCK`, `DISCRETE`, the value references of its clocks, or empty: at any time.
    """
    if variable.type == "Clock":
        return CLOCK
    if variable.clocks:
        return " ".join(sorted(str(clock.valueReference) for clock in variable.clocks))
    is_tunable = variable.causality == "parameter" and variable.variability == "tunable"
    return DISCRETE if is_tunable or (variable.causality == "input" and variable.variability == "discrete") else ""


@dataclass
class _Timer:
    """The next tick of a time-based clock: at `origin + count * interval` (s), or never."""

    origin: float = math.inf
    interval: float = 0.0
    count: int = 0

    @property
    def time(self) -> float:
        return self.origin + self.count * self.interval

    def advance(self) -> None:
        """After a tick: a clock that is not periodic must be told its next one."""
        self.count += 1
        if not self.interval:
            self.origin = math.inf


class EventInstance(Instance):
    """See the module; between two calls from the master the instance is in step mode.

    Attributes
    ----------
    is_pending : bool
        It is in event mode, and its discrete states are to be updated.
    ticked : set of int
        Value references of the clocks that have ticked at this communication point, or since the one before.
    between : int
        Number of events that were handled between communication points.
    """

    uses_events = True

    def __init__(
        self,
        name: str,
        folder: Path,
        description: ModelDescription,
        asks_for_inputs: Sequence[int] = (),
        texts: Texts | None = None,
        messages: Messages | None = None,
        file: str = "",
        load: Loader = Library.of,
    ) -> None:
        super().__init__(name, folder, description, asks_for_inputs, texts, messages, file, load)
        self._clocks = {v.valueReference: v for v in reversed(description.modelVariables) if v.type == "Clock"}
        self._timed = {r: v for r, v in self._clocks.items() if is_time_based(v)}
        self._buffers: list[EventBuffer] = []
        self._step_callback = _Step(self._step)
        self._error: CallFailed | None = None
        self.tolerance = 0.0
        self._forget()

    def _forget(self) -> None:
        self.mode = "instantiated"
        self.is_pending = False
        self.has_ended = False
        self.last_set: dict[str, str] = {}  # value references -> slots, of what changes in event mode
        self.ticked: set[int] = set()
        self.between = 0
        self.time: float | None = None  # of the communication point that was begun last
        self._ticked_between: set[int] = set()
        self._late: set[int] = set()  # clocks whose ticks others see at the next exchange
        self._active: dict[int, bool] = {}  # at this super-dense instant, as far as known
        self._timers = {reference: _Timer() for reference in self._timed}
        self._next_event = math.inf
        self._due = math.inf  # the earliest of these times
        self._event_needed = False
        self._now = 0.0

    # Initialisation

    def enter_initialization_mode(self, experiment: ExperimentSetup) -> None:
        """See `Instance`."""
        self._forget()
        super().enter_initialization_mode(experiment)
        self.mode, self._now = "initialization", experiment.start_time

    def exit_initialization_mode(self) -> None:
        """See `Instance`; the instance is then in event mode."""
        for reference, clock in self._timed.items():
            self._begin_clock(reference, clock)
        super().exit_initialization_mode()
        self._schedule()
        self.mode, self.is_pending = "event", True

    def _begin_clock(self, reference: int, clock: ModelVariable) -> None:
        kind = clock.intervalVariability
        if kind in ("changing", "countdown"):
            interval, qualifier = self._interval(reference)
            if qualifier == _CHANGED or (kind == "changing" and qualifier):
                self._timers[reference] = _Timer(self._now + interval)
            return
        known, shift = _described(clock)
        interval = self._interval(reference)[0] if known is None else known
        if known is None:
            shift = self._shift(reference)
        elif kind in ("fixed", "tunable"):
            self._tell_interval(reference, clock, interval, shift)
        if not (math.isfinite(interval) and interval > 0.0 and math.isfinite(shift)):
            remedy = ""
            if has_settable_interval(clock):
                remedy = f"; give it one: System.add(..., start={{'{clock.name}': 0.1}}), --set {clock.name}=0.1"
            raise CallFailed(
                f"clock '{clock.name}' has no usable interval: {interval:.9g} s, first after {shift:.9g} s{remedy}"
            )
        self._timers[reference] = _Timer(self._now + shift, interval)

    def _tell_interval(self, reference: int, clock: ModelVariable, interval: float, shift: float) -> None:
        references = _references([reference])
        if clock.supportsFraction and clock.intervalCounter is not None:
            resolution = (ctypes.c_uint64 * 1)(clock.resolution)
            self.call(
                "fmi3SetIntervalFraction", references, 1, (ctypes.c_uint64 * 1)(clock.intervalCounter), resolution
            )
            if shift:
                self.call("fmi3SetShiftFraction", references, 1, (ctypes.c_uint64 * 1)(clock.shiftCounter), resolution)
            return
        self.call("fmi3SetIntervalDecimal", references, 1, (ctypes.c_double * 1)(interval))
        if shift:
            self.call("fmi3SetShiftDecimal", references, 1, (ctypes.c_double * 1)(shift))

    def _interval(self, reference: int) -> tuple[float, int]:
        """Interval (s) of a clock, and how its FMU qualifies it."""
        qualifier = (fmi3.fmi3IntervalQualifier * 1)()
        if self._clocks[reference].supportsFraction:
            counter, resolution = (ctypes.c_uint64 * 1)(), (ctypes.c_uint64 * 1)()
            self.call("fmi3GetIntervalFraction", _references([reference]), 1, counter, resolution, qualifier)
            return counter[0] / (resolution[0] or 1), qualifier[0]
        interval = (ctypes.c_double * 1)()
        self.call("fmi3GetIntervalDecimal", _references([reference]), 1, interval, qualifier)
        return interval[0], qualifier[0]

    def _shift(self, reference: int) -> float:
        if self._clocks[reference].supportsFraction:
            counter, resolution = (ctypes.c_uint64 * 1)(), (ctypes.c_uint64 * 1)()
            self.call("fmi3GetShiftFraction", _references([reference]), 1, counter, resolution)
            return counter[0] / (resolution[0] or 1)
        shift = (ctypes.c_double * 1)()
        self.call("fmi3GetShiftDecimal", _references([reference]), 1, shift)
        return shift[0]

    # Events at a communication point

    def begin_point(self, time: float, step: float) -> None:
        """Begin the exchange at a communication point (s): enter the event mode if anything is due there."""
        self.tolerance = _SAME * step
        if time != self.time:
            self.time, self.ticked, self._ticked_between = time, self._ticked_between, set()
        self._now = time
        self._begin_event()

    def begin_again(self) -> None:
        """Begin another super-dense instant at this time."""
        if self.mode == "event":
            self._activate_due()

    def _begin_event(self) -> None:
        if self._is_due():
            self.change()
            self._activate_due()
        elif self.mode == "event":
            self.is_pending = True

    def change(self) -> None:
        """Be in event mode, where what follows is an event."""
        if self.mode == "step":
            self.call("fmi3EnterEventMode")
            self.mode = "event"
        self.is_pending = True

    def _activate_due(self) -> None:
        due = [r for r, timer in self._timers.items() if timer.time <= self._now + self.tolerance]
        for reference in due:
            self._timers[reference].advance()
        self._schedule()
        self.activate(due)

    def _schedule(self) -> None:
        self._due = min((self._next_event, *(timer.time for timer in self._timers.values())))

    def activate(self, references: Sequence[int]) -> None:
        """Have input clocks tick."""
        if not references:
            return
        self.change()
        n = len(references)
        self.call("fmi3SetClock", _references(references), n, (fmi3.fmi3Clock * n)(*[True] * n))
        self._active.update(dict.fromkeys(references, True))
        self.ticked.update(references)

    def is_active(self, reference: int) -> bool:
        """Whether a clock is active at this super-dense instant."""
        if self.mode != "event":
            return False
        if reference not in self._active:
            clock = self._clocks[reference]
            asked = clock.causality != "input" and (not clock.clocks or self.are_active(_clocks_of(clock)))
            self._active[reference] = asked and self._ask_clock(reference)
        return self._active[reference]

    def are_active(self, references: Iterable[int]) -> bool:
        """Whether one of some clocks is active."""
        return any(self.is_active(reference) for reference in references)

    def _ask_clock(self, reference: int) -> bool:
        value = (fmi3.fmi3Clock * 1)()
        self.call("fmi3GetClock", _references([reference]), 1, value)
        if value[0]:
            self.ticked.add(reference)
        return bool(value[0])

    def ticks_for_others(self, reference: int) -> bool:
        """Whether others see a tick of a clock in this exchange."""
        is_active = self.is_active(reference)
        if reference in self._late:
            self._late.remove(reference)
            return True
        return is_active

    def read_again(self) -> None:
        """Read what depends on inputs that were set after it was read; ticks reach others in the next exchange."""
        known = {reference for reference, active in self._active.items() if active}
        self._active = dict.fromkeys(known, True)
        self._late.update(reference for reference in self._ticks() if reference not in known)
        self._read_clocked()

    def _ticks(self) -> set[int]:
        """Active clocks of the FMU that are recorded or connected."""
        return {reference for buffer in self._buffers for reference in buffer.ticks()}

    def _read_clocked(self) -> None:
        for buffer in self._buffers:
            if buffer.reads and buffer.timing != CLOCK:
                buffer.get()

    def update(self) -> None:
        """End a super-dense instant: update the discrete states, and learn when clocks tick next."""
        changed = [r for r in self._timed if self._active.get(r) and self._clocks[r].intervalVariability == "changing"]
        needed, ended, defined = ctypes.c_bool(), ctypes.c_bool(), ctypes.c_bool()
        nominals, states, time = ctypes.c_bool(), ctypes.c_bool(), ctypes.c_double()
        told = (needed, ended, nominals, states, defined, time)
        self.call("fmi3UpdateDiscreteStates", *(ctypes.byref(value) for value in told))
        self._active.clear()
        self._event_needed = False
        self.has_ended = self.has_ended or ended.value
        # an event that is due now is this one; if it is not, the FMU says so at its next step
        self._next_event = time.value if defined.value and time.value > self._now + self.tolerance else math.inf
        for reference, clock in self._timed.items():
            kind = clock.intervalVariability
            is_told = kind == "tunable" and _described(clock)[0] is None
            if reference in changed or kind == "countdown" or is_told:
                self._learn_interval(reference, kind)
        self._schedule()
        self.is_pending = (needed.value or self._is_due()) and not self.has_ended

    def _learn_interval(self, reference: int, kind: str) -> None:
        interval, qualifier = self._interval(reference)
        if kind == "changing" and qualifier:
            self._timers[reference] = _Timer(self._now + interval)
        elif qualifier == _CHANGED:
            periodic = kind == "tunable"
            self._timers[reference] = _Timer(self._now + interval, interval if periodic else 0.0)

    def leave(self) -> None:
        """Be in step mode."""
        if self.mode == "event":
            self.call("fmi3EnterStepMode")
            self.mode = "step"
            self._active.clear()

    def settle(self) -> None:
        """Handle an event alone, with inputs as they are."""
        for _ in range(MOST_UPDATES):
            for buffer in self._buffers:
                if not buffer.reads and buffer.timing not in (CLOCK, DISCRETE):
                    buffer.set()
            self._late |= self._ticks()
            self._read_clocked()
            self.update()
            if not self.is_pending:
                self.leave()
                return
            self._activate_due()
        raise self.endless()

    def endless(self) -> CallFailed:
        """The error for discrete states that are never done."""
        return CallFailed(f"its discrete states still need an update after {MOST_UPDATES} at t = {self._now:.9g} s")

    # Steps

    @property
    def step_address(self) -> int:
        """Address of a function as fmi3DoStep, that handles events on the way."""
        return function_address(self._step_callback)

    def _step(
        self,
        _instance: int,
        time: float,
        step: float,
        _no_set_state: bool,
        _event: Any,
        ended: Any,
        _early: Any,
        last: Any,
    ) -> int:
        return self.guarded(lambda: self._take_step(time, step, ended, last))

    def _take_step(self, time: float, step: float, ended: Any, last: Any) -> int:
        status = self.do_step(time, step)
        ended[0], last[0] = status.has_ended, status.reached
        return status.code

    def guarded(self, work: Callable[[], int | None]) -> int:
        """Status of FMI of a piece of work; `failure` gives its error."""
        try:
            return work() or 0
        except CallFailed as error:
            self._error = error
        except Exception as error:  # no exception may leave what C calls
            self._error = CallFailed(f"{type(error).__name__}: {error}")
            self._error.__cause__ = error
        return self._error.status

    def failure(self, function: str, status: int) -> CallFailed:
        """See `Instance`; the error of what was done within a call, if it came from there."""
        error, self._error = self._error, None
        return error or super().failure(function, status)

    def do_step(self, time: float, step: float) -> StepStatus:
        """See `Instance`; events on the way, as ticks of clocks, are handled with inputs as they are."""
        self._now = time
        if self.mode == "event":
            self.settle()
        end, standstills = time + step, 0
        while not self.has_ended and end - self._now > _SAME * step:
            if self._is_due():
                self._handle_between()
                continue
            goal = self._next_stop(end, step)
            code, event, ended, early, reached = self._call_step(self._now, goal - self._now)
            if code > _WARNING:
                return StepStatus(code, has_ended=False, reached=reached)
            if ended:
                return StepStatus(code, has_ended=True, reached=reached)
            standstills = standstills + 1 if early and reached <= self._now else 0
            if standstills > _MOST_STANDSTILLS:
                raise CallFailed(f"{self.step_function} does not get beyond t = {self._now:.9g} s")
            self._now = reached if early else goal
            self._event_needed = self._event_needed or event
        return StepStatus(0, has_ended=self.has_ended, reached=self._now if self.has_ended else end)

    def _is_due(self) -> bool:
        return self._event_needed or self._due <= self._now + self.tolerance

    def _next_stop(self, end: float, step: float) -> float:
        """Where a part of a communication step ends: at what is due before its end (s)."""
        stop = self._due
        if stop >= end - _SAME * step:
            return end
        if not self.takes_any_step:
            raise CallFailed(
                f"it has an event at t = {stop:.9g} s, between communication points, and takes steps of one length "
                "only (canHandleVariableCommunicationStepSize); choose a communication step that meets its events"
            )
        return stop

    def _handle_between(self) -> None:
        self.between += 1
        before, self.ticked = self.ticked, set()
        self._begin_event()
        self.settle()
        self._ticked_between |= self.ticked
        self.ticked = before

    def _call_step(self, time: float, step: float) -> tuple[int, bool, bool, bool, float]:
        event, ended, early = ctypes.c_bool(), ctypes.c_bool(), ctypes.c_bool()
        reached = ctypes.c_double(time)
        told = (ctypes.byref(event), ctypes.byref(ended), ctypes.byref(early), ctypes.byref(reached))
        code = self._function(self.step_function)(self._component, time, step, True, *told)
        if code == _WARNING:
            self.messages.warned(self.step_function)
        return code, event.value, ended.value, early.value, reached.value

    # Buffers and states

    def forget_buffers(self) -> None:
        """Forget the buffers of an exchange that is no more."""
        self._buffers.clear()

    def keep_buffer(self, buffer: EventBuffer) -> None:
        """Have clocked values of a buffer exchanged at ticks between communication points, too."""
        self._buffers.append(buffer)

    def reset(self) -> None:
        """See `Instance`."""
        super().reset()
        self._forget()

    def save_state(self) -> bytes:
        """See `Instance`; with the times of clocks and events."""
        if self.mode == "event":
            self.settle()
        own = {
            "time": self.time,
            "now": self._now,
            "ticked": [sorted(self.ticked), sorted(self._ticked_between), sorted(self._late)],
            "timers": {str(reference): asdict(timer) for reference, timer in self._timers.items()},
            "next_event": self._next_event,
            "event_needed": self._event_needed,
            "tolerance": self.tolerance,
            "between": self.between,
            "last_set": self.last_set,
        }
        head = json.dumps(own).encode()
        return struct.pack("<q", len(head)) + head + super().save_state()

    def restore_state(self, data: bytes) -> None:
        """See `Instance`."""
        (length,) = struct.unpack_from("<q", data)
        own = json.loads(data[8 : 8 + length])
        super().restore_state(data[8 + length :])
        self._forget()
        self.mode = "step"
        self.time, self._now, self.tolerance = own["time"], own["now"], own["tolerance"]
        self.ticked, self._ticked_between, self._late = (set(references) for references in own["ticked"])
        self._timers = {int(reference): _Timer(**timer) for reference, timer in own["timers"].items()}
        self._next_event, self._event_needed = own["next_event"], own["event_needed"]
        self._schedule()
        self.between, self.last_set = own["between"], own["last_set"]


class EventBuffer(VariableBuffer):
    """Variables of an `EventInstance` that are not exchanged at any time.

    Parameters
    ----------
    instance : EventInstance
    variables : sequence of ModelVariable
        Of one type, and of one timing.
    slots : array (n,) of float64
    timing : str
        See `timing_of`.
    reads : bool
        Whether they are read, and not set.
    """

    def __init__(
        self,
        instance: EventInstance,
        variables: Sequence[ModelVariable],
        slots: np.ndarray,
        timing: str,
        *,
        reads: bool = False,
    ) -> None:
        super().__init__(instance, variables, slots)
        self.timing, self.reads = timing, reads
        self._events = instance
        self._clocks = [] if timing in (CLOCK, DISCRETE) else _clocks_of(variables[0])
        self._name = " ".join(map(str, self.references))

    @property
    def address(self) -> int | None:
        """Values go by way of Python."""
        return None

    def function_address(self, name: str) -> int:
        """Address of a function by which the compiled loop gets or sets the values, by way of Python."""
        move = self.get if name == self.getter_name else self.set
        passed = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_size_t)
        self._moving = ctypes.CFUNCTYPE(ctypes.c_int, *passed)(lambda *_: self._events.guarded(move))
        return function_address(self._moving)

    def get(self) -> None:
        """See `VariableBuffer`; values that can't be read now stay as they were."""
        if self.timing == CLOCK:
            self._own[:] = [self._events.ticks_for_others(reference) for reference in self.references]
        elif self.timing == DISCRETE or self._is_open:
            super().get()

    def set(self) -> None:
        """See `VariableBuffer`; clocks tick where the value is true."""
        if self.timing == CLOCK:
            if self._events.mode in ("event", "step"):
                ticking = [r for r, value in zip(self.references, self._own.tolist(), strict=True) if value]
                self._events.activate(ticking)
        elif self.timing != DISCRETE:
            if self._is_open:
                super().set()
        else:
            now = self._own.tobytes().hex()
            if now != self._events.last_set.get(self._name):
                if self._events.mode == "step":
                    self._events.change()
                elif self._events.mode == "event":
                    self._events.is_pending = True
                super().set()
                self._events.last_set[self._name] = now

    def ticks(self) -> Collection[int]:
        """Those of its clocks that are active."""
        if not self.reads or self.timing != CLOCK:
            return ()
        return [
            r for r in self.references if self._events._clocks[r].causality != "input" and self._events.is_active(r)
        ]

    @property
    def _is_open(self) -> bool:
        return self._events.mode == "initialization" or self._events.are_active(self._clocks)


def _references(references: Sequence[int]) -> Any:
    return (fmi3.fmi3ValueReference * len(references))(*references)


def _clocks_of(variable: ModelVariable) -> list[int]:
    return [clock.valueReference for clock in variable.clocks or ()]


def _described(clock: ModelVariable) -> tuple[float | None, float]:
    """Interval and shift (s) that the model description gives; no interval where the FMU must be asked."""
    if clock.intervalCounter is not None and clock.resolution:
        return clock.intervalCounter / clock.resolution, (clock.shiftCounter or 0) / clock.resolution
    return clock.intervalDecimal, clock.shiftDecimal or 0.0
