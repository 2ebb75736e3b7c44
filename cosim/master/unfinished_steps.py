"""Communication steps that an FMU did not finish: it ends the simulation, discards a step, or is still computing."""

from __future__ import annotations

import ctypes
import time as clock
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from cosim.fmi.instance import CallFailed, Instance, StepStatus
from cosim.loop.binding import Extrapolated, Operation, loop_library
from cosim.master.failures import InterruptedInCall

#: A discarded step is repeated in steps that are shorter by at most 2 to this power.
_MOST_HALVINGS = 10

#: Times nearer to each other than this part of a step are the same, for rounding.
_SAME = 1e-9

#: How often (s) an FMU that computes by itself is asked whether it is ready, at most.
_LONGEST_WAIT = 1e-3


@dataclass(frozen=True)
class EndedBy:
    """The component whose FMU ended the simulation, and the time (s) that it had reached."""

    component: str
    time: float


class UnfinishedSteps:
    """Finishes the steps of FMUs that did not do so at once.

    Parameters
    ----------
    instances : mapping
        Component -> instance.
    stop : callable
        Whether to wait no longer.

    Attributes
    ----------
    repeated : Counter
        Component -> number of communication steps that it discarded, and that were repeated in shorter steps.
    """

    def __init__(self, instances: Mapping[str, Instance], stop: Callable[[], bool]) -> None:
        self._instances = instances
        self._stop = stop
        self.repeated: Counter[str] = Counter()

    def finish(
        self, component: str, status: StepStatus, time: float, step: float, inputs: Iterable[Operation]
    ) -> EndedBy | None:
        """Finish a step from a time (s) that a component's FMU returned from with a status.

        Parameters
        ----------
        component : str
        status : StepStatus
        time, step : float
            Communication point and communication step (s).
        inputs : iterable of Operation
            EXTRAPOLATE operations of the component.

        Returns
        -------
        EndedBy or None
            The FMU ended the simulation.

        Raises
        ------
        CallFailed
            The step can't be finished.
        InterruptedInCall
            Ctrl-C came before it was.
        """
        instance = self._instances[component]
        status = self._awaited(instance, status, time)
        if status.is_done:
            return None
        if status.has_ended:
            return EndedBy(component, status.reached)
        if not instance.takes_any_step or not status.is_discarded:
            raise instance.failure(instance.step_function, status.code)
        self.repeated[component] += 1
        return self._in_short_steps(component, time, step, max(time, status.reached), list(inputs))

    def _in_short_steps(
        self, component: str, time: float, step: float, reached: float, inputs: list[Operation]
    ) -> EndedBy | None:
        instance = self._instances[component]
        end = time + step
        length = (end - reached) / (2.0 if reached <= time else 1.0)
        while end - reached > _SAME * step:
            length = min(length, end - reached)
            for operation in inputs:
                _move(instance, operation, reached - time)
            status = self._awaited(instance, instance.do_step(reached, length), time)
            if status.is_done:
                reached += length
            elif status.has_ended:
                return EndedBy(component, status.reached)
            elif not status.is_discarded:
                raise instance.failure(instance.step_function, status.code)
            elif status.reached > reached + _SAME * step:
                reached = status.reached
            else:
                length /= 2.0
                if length < step / 2.0**_MOST_HALVINGS:
                    raise CallFailed(
                        f"{instance.step_function} did not finish the step of {step:.9g} s from t = {time:.9g} s on, "
                        f"nor steps of {2.0 * length:.3g} s; try another communication step"
                    )
            if self._stop():
                raise InterruptedInCall(time)
        return None

    def _awaited(self, instance: Instance, status: StepStatus, time: float) -> StepStatus:
        """The status of a step from a time (s) on, once the FMU has computed it."""
        wait = 0.0
        while status.is_pending:
            if self._stop():
                instance.cancel_step()
                raise InterruptedInCall(time)
            clock.sleep(wait)
            wait = min(2.0 * wait + 1e-6, _LONGEST_WAIT)
            status = instance.step_status()
        return status


def _move(instance: Instance, operation: Operation, since: float) -> None:
    """Set extrapolated inputs of an FMU of FMI 2.0 some time (s) after a communication point, with their derivatives.

    An FMU of FMI 3.0 asks for them.
    """
    if operation.version != 2 or since == 0.0:
        return
    inputs, n = Extrapolated.from_address(operation.data), operation.n
    loop_library().loop_evaluate_all(inputs, since, n)
    references, values = (ctypes.cast(array, ctypes.c_void_p) for array in (operation.references, inputs.buffer))
    instance.call("fmi2SetReal", references, n, values)
    derivatives = ctypes.c_void_p((values.value or 0) + n * ctypes.sizeof(ctypes.c_double))
    orders = ctypes.cast(inputs.orders, ctypes.c_void_p)
    instance.call("fmi2SetRealInputDerivatives", references, n * inputs.degree, orders, derivatives)
