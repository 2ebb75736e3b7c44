"""A run that is stepped by hand: read and set values at a communication point, go on, read again."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence, Set
from numbers import Real
from typing import Any

import numpy as np

from cosim.errors import SetupError, positive_whole
from cosim.fmi.event_mode import EventBuffer, EventInstance
from cosim.fmi.instance import CallFailed, Instance
from cosim.fmi.model_exchange import ModelExchangeInstance
from cosim.fmi.variable_buffer import VariableBuffer
from cosim.master.failures import Failing, InterruptedInCall, SimulationError, SimulationInterrupted
from cosim.master.function_instance import FunctionInstance
from cosim.master.interrupts import DeferredInterrupt
from cosim.master.recording import Growing, Marks
from cosim.master.run import Grid, Run
from cosim.master.state import RunState
from cosim.master.value_layout import ValueLayout
from cosim.results.results import Results
from cosim.system.resolution import ResolvedSystem, resolve_start_value, split
from cosim.system.variables import Element, variables_of

#: By how many steps the time of `advance_to` may miss a whole number of them, for rounding.
_STEP_TOLERANCE = 1e-6


class _Quantity:
    """A scalar or a vector of a component, found once by its name."""

    def __init__(
        self,
        component: str,
        variable: str,
        elements: Sequence[Element],
        layout: ValueLayout,
        instance: Instance,
        obstacle: str,
    ) -> None:
        self.component, self.variable = component, variable
        self.elements = elements
        self.obstacle = obstacle
        self.is_scalar = len(elements) == 1 and variable == elements[0].name
        self.is_tunable = elements[0].variable.variability == "tunable"
        self.type = elements[0].type
        self.texts = instance.texts
        known = [layout.positions.get((component, e.name)) for e in elements]
        self.positions = None if None in known else np.array(known)
        variables = variables_of(elements)
        self._whole = np.zeros(sum(math.prod(v.shape or (1,)) for v in variables))
        self.is_clocked = elements[0].is_clocked or self.type.kind == "clock"
        timing = elements[0].timing
        self._buffer = (
            EventBuffer(instance, variables, self._whole, timing)
            if isinstance(instance, EventInstance) and timing
            else VariableBuffer(instance, variables, self._whole)
        )
        self._enters_event_mode = instance if timing and isinstance(instance, ModelExchangeInstance) else None
        # a single element of an array of FMI 3.0 is set by way of the whole array
        self._own = slice(elements[0].offset, elements[0].offset + len(elements))
        bounds = [(e.variable.min, e.variable.max) for e in elements]
        self.is_checked = self.type.kind != "real" or any(b != (None, None) for b in bounds)

    @property
    def is_settable(self) -> bool:
        """Whether it can be set between two steps."""
        return not self.obstacle

    def get(self) -> np.ndarray:
        """Slots (n,) as the FMU has them."""
        self._buffer.get()
        return self._whole[self._own].copy()

    def set(self, slots: Any) -> None:
        """Hand slots (n,) to the FMU."""
        if self._enters_event_mode is not None:
            self._enters_event_mode.enter_event_mode()
        if len(self._whole) > len(self.elements):
            self._buffer.get()
        self._whole[self._own] = slots
        self._buffer.set()

    def value(self, slots: np.ndarray) -> Any:
        """The value of slots (n,) for a user: a number or a text of a scalar, an array (n,) of a vector."""
        values = slots if self.type.kind == "real" else self.type.from_slots(slots, self.texts)
        return values.tolist()[0] if self.is_scalar else values


class SteppedRun:
    """A run that stands at a communication point until it is told to go on; made by `Simulation.start`.

    Values have been exchanged at the communication point where it stands. A run in which nothing is set gives the same
    numbers, to the last bit, as `Simulation.run`.

    Examples
    --------
    >>> from cosim import Simulation
    >>> with Simulation(system) as simulation, simulation.start(step_size=1e-3) as run:
    ...     while run.time < 0.01:
    ...         run.step()
    ...     x = run["plant.x_E"]
    """

    def __init__(
        self,
        run: Run,
        system: ResolvedSystem,
        layout: ValueLayout,
        instances: Mapping[str, Instance],
        grid: Grid,
        recorder: Growing,
        record_every: int,
        results: Results,
        interrupt: DeferredInterrupt,
        *,
        exchanges_by_level: bool,
        described: Mapping[str, Any],
    ) -> None:
        self._described = described
        self._run = run
        self._system = system
        self._layout = layout
        self._instances = instances
        self._grid = grid
        self._recorder = recorder
        self._record_every = record_every
        self._results = results
        self._interrupt = interrupt
        self._exchanges_by_level = exchanges_by_level
        self._point = 0
        self._quantities: dict[str, _Quantity] = {}
        self._set_since: set[str] = set()
        self._ended = False
        for instance in instances.values():
            if isinstance(instance, FunctionInstance):
                instance.is_stepped = True
        self._exchange()

    def __repr__(self) -> str:
        return f"SteppedRun: at t = {self.time:.9g} s, {'ended' if self._ended else 'running'}"

    @property
    def time(self) -> float:
        """Time (s) of the communication point where the run stands."""
        return self._grid.time(self._point)

    @property
    def point(self) -> int:
        """Number of this communication point, from 0 at the start time on."""
        return self._point

    @property
    def is_interrupted(self) -> bool:
        """Whether Ctrl-C has come."""
        return self._interrupt.requested

    @property
    def has_ended(self) -> bool:
        """Whether the run can't go on."""
        return self._ended

    @property
    def marks(self) -> Marks:
        """Variables that were not finite in rows that are not kept here."""
        return self._run.marks

    @property
    def step_size(self) -> float:
        """Communication step (s)."""
        return self._grid.step_size

    @property
    def results(self) -> Results:
        """The records so far, including this communication point if it is one to record."""
        self._exchange_again()
        time, values = self._recorder.result()
        if self._point % self._record_every == 0 and not self._ended:
            time, values = np.append(time, self.time), np.vstack([values, self._run.recorded_now()])
        info = {**self._results.info, "stop_time": self.time, "status": "completed" if self._ended else "running"}
        return self._handed_over(time, values, info)

    def __getitem__(self, name: str) -> Any:
        """Value of a scalar, or array (n,) of a vector, `component.variable`, at this communication point.

        Raises
        ------
        SetupError
            There is no such variable, or its type can't be read.
        SimulationError
            An FMU fails.
        """
        quantity = self._quantity(name)
        if self._interrupt.at_once or quantity.positions is None:
            self._check_running()
        self._exchange_again()
        if quantity.positions is None:
            if quantity.is_clocked:
                raise SetupError(f"'{name}' can be read when its clock ticks only; record it")
            with self._failing(quantity.component):
                return quantity.value(quantity.get())
        return quantity.value(self._run.values[quantity.positions])

    def __setitem__(self, name: str, value: Any) -> None:
        """Set an input that nothing feeds, or a tunable parameter, from this communication point on.

        Raises
        ------
        SetupError
            FMI does not allow it, something feeds the input, or the value does not fit.
        SimulationError
            The FMU refuses the value.
        """
        self._check_running()
        quantity = self._quantity(name)
        if not quantity.is_settable:
            raise SetupError(f"'{name}' can't be set during a run: {quantity.obstacle}")
        slots = self._slots(quantity, value)
        with self._failing(quantity.component):
            quantity.set(slots)
        if quantity.positions is not None:
            self._run.values[quantity.positions] = slots
        self._set_since.add(quantity.component)
        if quantity.is_tunable and self._exchanges_by_level:
            self._run.forget_history()  # outputs jump at this point; in parallel order others see that at the next one

    def step(self, n: int = 1) -> None:
        """Go on by n communication steps, and exchange values there.

        Raises
        ------
        SetupError
            n is not a positive whole number, or the stop time lies before.
        SimulationError
            An FMU failed; its `results` hold what had been recorded.
        SimulationInterrupted
            Ctrl-C came since the last step; its `results` hold what had been recorded.
        """
        self._check_running()
        steps = positive_whole(n)
        if steps is None:
            raise SetupError(f"step({n!r}): must be a positive whole number of steps")
        end = self._point + steps
        if end > self._grid.last_point:
            raise SetupError(f"step({n}) at t = {self.time:.9g} s: goes beyond the stop time {self._stop_time:.9g} s")
        self._go_on_to(end)

    def _go_on_to(self, end: int) -> None:
        """Step to a communication point ahead."""
        self._exchange_again()
        try:
            self._point = self._run.advance(self._recorder, self._point, end, self._record_every)
        except (SimulationError, InterruptedInCall) as error:
            raise self._ended_by(error) from error.__cause__
        if self._run.ended_by is not None:
            self._ended = True
            self._run.terminate(self.time)
        if self._interrupt.requested:
            raise SimulationInterrupted(self.time, self._all_recorded("interrupted"))

    def advance_to(self, time: float) -> None:
        """Go on to a communication point at a time (s); does nothing where the run stands there.

        Raises
        ------
        SetupError
            The time lies before this communication point or beyond the stop time, or is not one of a communication
            point.
        SimulationError, SimulationInterrupted
            As `step`.
        """
        if not isinstance(time, Real) or not math.isfinite(time):
            raise SetupError(f"advance_to({time!r}): must be a finite time (s)")
        exact = (float(time) - self.time) / self.step_size
        if exact < -_STEP_TOLERANCE:
            raise SetupError(
                f"advance_to({time!r}): the run is at t = {self.time:.9g} s already; restore a saved state to go back"
            )
        n = round(exact)
        if abs(exact - n) > _STEP_TOLERANCE * max(1, n):
            raise SetupError(
                f"advance_to({time!r}): no communication point; those around it are at "
                f"{self._grid.time(self._point + math.floor(exact)):.9g} s and "
                f"{self._grid.time(self._point + math.ceil(exact)):.9g} s"
            )
        if n == 0:
            return
        self._check_running()
        if self._point + n > self._grid.last_point:
            raise SetupError(f"advance_to({time!r}): lies beyond the stop time {self._stop_time:.9g} s")
        self._go_on_to(self._point + n)

    def save(self) -> RunState:
        """The state of the run at this communication point, its recorded rows included.

        `RunState.write` and `RunState.read` take it to another process.

        Raises
        ------
        SetupError
            The FMU of a component can't save or serialise its state; the message names the component.
        """
        self._check_running()
        self._exchange_again()
        fmus = {}
        for component, instance in self._instances.items():
            try:
                fmus[component] = instance.save_state()
            except CallFailed as error:
                what = f"component '{component}': its {instance.noun} {error}"
                raise SetupError(f"{what}; the run can't be saved") from error
        _, recorded = self._recorder.result()
        values = self._run.values.copy()
        history, texts = self._run.history(), self._run.texts.values
        return RunState(self._made_with(), self._point, fmus, values, history, recorded.copy(), texts)

    def restore(self, state: RunState) -> None:
        """Go back, or on, to where a run stood when its state was saved, by this process or another one.

        Signals are functions of time, so the run goes on with those of this run.

        Raises
        ------
        SetupError
            The state belongs to a run that was made with something else, which the message names, or an FMU can't
            take it.
        """
        self._check_running()
        if not isinstance(state, RunState):
            raise SetupError(f"restore({type(state).__name__}): give a RunState, from save() or RunState.read")
        if differs := state.differences(self._made_with()):
            other = "; other ".join(differs)
            raise SetupError(f"the state is that of another run (other {other}); start the run as that one was started")
        if state.point > self._grid.last_point:
            raise SetupError(f"the state lies at t = {self._grid.time(state.point):.9g} s, beyond the stop time")
        for component, instance in self._instances.items():
            try:
                instance.restore_state(state.fmus[component])
            except CallFailed as error:
                what = f"component '{component}': its {instance.noun} {error}"
                raise SetupError(f"{what}; the run can't be restored") from error
        self._run.texts.take_over(state.texts)
        self._set_since = set()
        self._point = state.point
        self._recorder.replace(state.recorded)
        self._run.stand_at(state.point, state.values, state.history)

    @property
    def _stop_time(self) -> float:
        return self._grid.time(self._grid.last_point)

    def _made_with(self) -> dict[str, Any]:
        info = self._results.info
        return {
            **self._described,
            "fmus": {name: fmu["sha256"] for name, fmu in info["fmus"].items()},
            "tolerances": {name: fmu["tolerance"] for name, fmu in info["fmus"].items()},
            "functions": info.get("functions", {}),
            "order": info["order"],
            "extrapolation": info["extrapolation"],
            "step_size": info["step_size"],
            "start_time": info["start_time"],
            "record_every": info["record_every"],
            "names": list(self._results.names),
        }

    def end(self) -> None:
        """Record where the run stands and terminate the FMUs; leaving the context does so too."""
        if self._ended:
            return
        self._exchange_again()
        self._run.record(self._recorder, self._point, self._record_every)
        self._ended = True
        self._run.terminate(self.time)

    # Within

    def _check_running(self) -> None:
        if self._ended:
            by = self._run.ended_by
            why = "" if by is None else f": the FMU of '{by.component}' ended the simulation at t = {by.time:.9g} s"
            raise SetupError(f"the run has ended{why}; start another one")
        if self._interrupt.at_once:
            raise SetupError("the run is in the middle of a step; a function called there can use its inputs only")

    def _failing(self, component: str) -> Failing:
        return Failing(component, self.time, self._instances[component])

    def _all_recorded(self, status: str) -> Results:
        time, values = self._recorder.result()
        return self._handed_over(time, values, {**self._results.info, "status": status})

    def hand_over(self, times: np.ndarray, slots: np.ndarray, results: Results) -> None:
        """Give results rows that were recorded: times (n,), and values (n, columns) as the loop has them."""
        self._run.hand_over(times, slots, results)

    def _handed_over(self, time: np.ndarray, slots: np.ndarray, info: dict[str, Any]) -> Results:
        results = Results(time, list(self._results.names), np.empty((0, 0)), info)
        self._run.hand_over(time, slots.copy(), results)
        return results

    def _quantity(self, name: str) -> _Quantity:
        if name not in self._quantities:
            if not isinstance(name, str):
                raise SetupError(f"{name!r} is not the name of a variable; write 'component.variable'")
            port, variable = split(name, self._system.ports)
            named = port.find(variable)
            elements = [port.original(element) for element in named]
            if elements != named:  # an alias
                own = elements[0]
                variable = own.name if variable == named[0].name else own.variable.name
            if not elements[0].is_exchanged:
                fmi_type = elements[0].variable.type
                raise SetupError(f"'{name}' is of type {fmi_type}, which can't be read or set during a run")
            component = port.component
            obstacle = why_not_settable(component, elements, self._system.fed)
            instance = self._instances[component]
            self._quantities[name] = _Quantity(component, variable, elements, self._layout, instance, obstacle)
        return self._quantities[name]

    def _slots(self, quantity: _Quantity, value: Any) -> Any:
        """Slots (n,) of values that fit the variable; plain real arrays take the short way."""
        if not quantity.is_checked and not isinstance(value, str | bool):
            try:
                numbers = np.asarray(value, dtype=float)
            except (TypeError, ValueError):
                numbers = np.array(np.nan)
            n = len(quantity.elements)
            if numbers.shape == ((n,) if numbers.ndim else ()) and math.isfinite(float(numbers.sum())):
                return numbers
        values = resolve_start_value(self._system.ports[quantity.component], quantity.variable, value, "value").values
        return quantity.type.slots(values, quantity.texts)

    def _exchange_again(self) -> None:
        """Propagate the values that were set to all values with direct feedthrough, at this communication point."""
        if self._set_since and not self._ended:
            components = None if self._exchanges_by_level else self._set_since
            self._set_since = set()
            self._exchange(components)

    def _exchange(self, components: Collection[str] | None = None) -> None:
        try:
            self._run.exchange(self._point, components)
        except (SimulationError, InterruptedInCall) as error:  # values of two exchanges would be mixed
            raise self._ended_by(error) from error.__cause__

    def _ended_by(self, error: SimulationError | InterruptedInCall) -> SimulationError | SimulationInterrupted:
        """The error for the user, with what had been recorded; the run can't go on."""
        self._ended = True
        if isinstance(error, InterruptedInCall):
            return SimulationInterrupted(error.time, self._all_recorded("interrupted"))
        error.results = self._all_recorded("failed")
        return error


def why_not_settable(component: str, elements: Sequence[Element], fed: Set[tuple[str, str]]) -> str:
    """Why a variable can't be set between two steps; empty when it can."""
    for element in elements:
        variable = element.variable
        if (component, element.name) in fed:
            return "a connection or a signal feeds it"
        if variable.type == "Clock" or element.is_clocked:
            return "clocks, and what is set when they tick, are fed by a signal or a connection (System.drive)"
        if variable.causality != "input" and not element.is_tunable:
            what = f"{variable.variability or 'continuous'} {variable.causality}"
            return f"it is a {what}; FMI allows inputs and tunable parameters only"
    return ""
