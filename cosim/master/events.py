"""Events at a communication point: clocks tick, discrete states are updated, values are exchanged again.

Components whose FMUs have clocks take part. Their events at a communication point are handled in passes: all values are
exchanged, then the discrete states of the FMUs in event mode are updated; until none of them needs another update. The
last pass exchanges the values that then hold, and these are recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cosim.fmi.event_mode import MOST_UPDATES, EventInstance
from cosim.fmi.instance import function_address
from cosim.loop.binding import Called, Operation, OperationKind
from cosim.master.failures import Failing

_OK, _ERROR = 0, 3


class Events:
    """Handles the events of a system, called by the loop before and after the exchange at a communication point.

    Parameters
    ----------
    instances : mapping
        Component -> instance, of those that use events.
    every : mapping
        Component -> at how many communication points it takes part once.
    values : array (n,)
        Of the system.
    clocks : mapping
        (component, value reference of a clock) -> positions of its values.
    reads_again : bool
        Whether outputs are read before inputs are set.
    """

    def __init__(
        self,
        instances: Mapping[str, EventInstance],
        every: Mapping[str, int],
        values: np.ndarray,
        clocks: Mapping[tuple[str, int], list[int]],
        *,
        reads_again: bool,
    ) -> None:
        self._instances = instances
        self._every = every
        self._all_take_part = all(every[name] == 1 for name in instances)
        self._ticks = values.view(np.int64)
        self._clocks = clocks
        self._reads_again = reads_again
        self._raised: BaseException | None = None
        self._callbacks = (Called(self._calling(self._begin)), Called(self._calling(self._finish)))

    def attach(self, point: Callable[[], int], step_size: float, exchange: Callable[[int], None]) -> None:
        """Have the run of which the events are.

        Parameters
        ----------
        point : callable
            Gives the communication point where the run stands.
        step_size : float
            In s.
        exchange : callable
            Exchanges values again at a communication point.
        """
        self._point, self._step_size, self._exchange = point, step_size, exchange

    @property
    def operations(self) -> tuple[Operation, Operation]:
        """What the loop is to perform before and after the exchange, but after signals have been sampled."""
        begin, finish = (
            Operation(kind=OperationKind.CALL, every=1, version=3, function=function_address(callback))
            for callback in self._callbacks
        )
        return begin, finish

    def raised(self) -> BaseException:
        """What has ended the last call; it is then forgotten."""
        error, self._raised = self._raised, None
        assert error is not None
        return error

    def _calling(self, work: Callable[[float], None]) -> Callable[[float], int]:
        def call(time: float) -> int:
            try:
                work(time)
            except BaseException as error:
                self._raised = error
                return _ERROR
            return _OK

        return call

    def _present(self) -> Mapping[str, EventInstance]:
        """Components that take part in this communication point."""
        if self._all_take_part:
            return self._instances
        point = self._point()
        return {name: i for name, i in self._instances.items() if point % self._every[name] == 0}

    def _begin(self, time: float) -> None:
        for component, instance in self._present().items():
            if instance.time == time:  # an exchange again: what ticked here has ticked
                self._clear(component)
            with Failing(component, time, instance):
                instance.begin_point(time, self._step_size)

    def _finish(self, time: float) -> None:
        present = self._present()
        if not any(instance.is_pending or instance.ticked for instance in present.values()):
            return
        for _ in range(MOST_UPDATES):
            pending = {name: instance for name, instance in present.items() if instance.is_pending}
            if not pending:
                break
            for component, instance in pending.items():
                with Failing(component, time, instance):
                    if self._reads_again:
                        instance.read_again()
                    instance.update()
            for component, instance in present.items():
                self._clear(component)
                with Failing(component, time, instance):
                    instance.begin_again()
            self._exchange(self._point())
        else:
            component, instance = next(iter(pending.items()))
            with Failing(component, time, instance):
                raise instance.endless()
        for component, instance in present.items():
            with Failing(component, time, instance):
                instance.leave()
        for (component, reference), positions in self._clocks.items():
            if component in present and reference in present[component].ticked:  # the others are at 0 already
                self._ticks[positions] = 1

    def _clear(self, component: str) -> None:
        """No clock of a component ticks by the values as they are."""
        for (name, _), positions in self._clocks.items():
            if name == component:
                self._ticks[positions] = 0


def events_of(
    instances: Mapping[str, Any],
    every: Mapping[str, int],
    values: np.ndarray,
    clocks: Mapping[tuple[str, int], list[int]],
    *,
    reads_again: bool,
) -> Events | None:
    """The events of a system, None where no component has any; parameters as those of `Events`."""
    own = {name: instance for name, instance in instances.items() if isinstance(instance, EventInstance)}
    return Events(own, every, values, clocks, reads_again=reads_again) if own else None
