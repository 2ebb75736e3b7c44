"""One run of instantiated FMUs: initialisation, then the stepping loop."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from cosim.errors import SetupError
from cosim.exchange import Exchange, Operation
from cosim.failures import Failing, SimulationError, SimulationInterrupted
from cosim.instance import Batch, Instance
from cosim.interrupts import DeferredInterrupt
from cosim.ports import variables_of
from cosim.resolve import ResolvedSystem
from cosim.results import Results
from cosim.system import Component

#: Communication points between two reports of progress.
_CHUNK = 100


class Run:
    """One run of instantiated FMUs."""

    def __init__(
        self,
        resolved: ResolvedSystem,
        instances: Mapping[str, Instance],
        exchange: Exchange,
        interrupt: DeferredInterrupt,
        progress: Callable[[float], None] | None,
    ) -> None:
        self._resolved = resolved
        self._instances = instances
        self._exchange = exchange
        self._interrupt = interrupt
        self._progress = progress

    def initialize(self, start_time: float) -> None:
        """Set start values and run all FMUs through their initialisation mode."""
        for component, instance in self._instances.items():
            with Failing(component, start_time, instance):
                self._set_start_values(component, instance)
                instance.enter_initialization_mode(start_time)
                self._set_start_elements(component, instance)
        for operation in self._exchange.at_start:
            self._perform(operation, start_time)
        for component, instance in self._instances.items():
            with Failing(component, start_time, instance):
                instance.exit_initialization_mode()

    def _set_start_values(self, component: str, instance: Instance) -> None:
        for start in self._resolved.starts:
            if start.component != component:
                continue
            variable = start.elements[0].variable
            if start.elements[0].kind == "String":
                instance.set_strings(variable, start.values[0])
                continue
            values = np.array(start.values)
            if len(start.elements) == 1 and variable.shape:
                continue
            Batch(instance, variables_of(start.elements), values).set()

    def _set_start_elements(self, component: str, instance: Instance) -> None:
        """Set single elements of arrays and keep the others, which can't be read before the initialisation mode."""
        for start in self._resolved.starts:
            element = start.elements[0]
            if start.component == component and len(start.elements) == 1 and element.variable.shape:
                whole = np.zeros(math.prod(element.variable.shape))
                batch = Batch(instance, [element.variable], whole)
                batch.get()
                whole[element.offset] = start.values[0]
                batch.set()

    def _perform(self, operation: Operation, time: float) -> None:
        with Failing(operation.component, time, self._instances[operation.component]):
            operation.run(time)

    def loop(self, start_time: float, step_size: float, steps: int, results: Results, began: float) -> Results:
        """Step to the end; the results are cut to the recorded rows however the loop ends."""
        times, rows = self._allocate(steps)
        recorded = 0
        loop_began = clock.perf_counter()

        def finish(status: str) -> Results:
            results.time, results.values = times[:recorded], rows[:recorded]
            results.info["status"] = status
            results.info["loop_time_s"] = clock.perf_counter() - loop_began
            results.info["wall_time_s"] = clock.perf_counter() - began
            return results

        components = list(self._resolved.components.values())
        exchange, values, positions = self._exchange, self._exchange.values, self._exchange.recorded_positions
        try:
            for i in range(steps + 1):
                time = times[i] = start_time + i * step_size
                if self._interrupt.requested:
                    self._terminate(time)
                    raise SimulationInterrupted(time, finish("interrupted"))
                for operation in exchange.at_point:
                    if i % operation.every == 0:
                        self._perform(operation, time)
                rows[i] = values[positions]
                recorded = i + 1
                if self._progress is not None and i % _CHUNK == 0:
                    self._progress(time)
                if i < steps:
                    self._step(components, i, time, step_size)
            self._terminate(time)
        except SimulationError as error:
            error.results = finish("failed")
            raise
        if self._interrupt.requested:
            raise SimulationInterrupted(time, finish("interrupted"))
        if self._progress is not None:
            self._progress(time)
        return finish("completed")

    def _allocate(self, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Room for the times and for the recorded values of all communication points."""
        columns = len(self._exchange.recorded_positions)
        try:
            return np.empty(steps + 1), np.empty((steps + 1, columns))
        except MemoryError:
            size = 8 * (steps + 1) * (columns + 1) / 1e9
            raise SetupError(
                f"{columns} values at {steps + 1} communication points need {size:.3g} GB of memory; "
                "make the step longer, or record less"
            ) from None

    def _terminate(self, time: float) -> None:
        for component, instance in self._instances.items():
            with Failing(component, time, instance):
                instance.terminate()

    def _step(self, components: Sequence[Component], i: int, time: float, step_size: float) -> None:
        for component in components:
            if i % component.every == 0:
                instance = self._instances[component.name]
                with Failing(component.name, time, instance):
                    instance.do_step(time, component.every * step_size)
