"""The co-simulation master: set-up and clean-up around a run (see `stepping`)."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from cosim.errors import SetupError
from cosim.exchange import Exchange, Order, sample
from cosim.failures import Failing
from cosim.instance import Batch, CallFailed, Instance
from cosim.interrupts import DeferredInterrupt
from cosim.load import LoadedFMU, load
from cosim.ports import KINDS, Element, Ports, variables_of
from cosim.resolve import ResolvedSystem, resolve, split
from cosim.results import Results
from cosim.stepping import Run
from cosim.system import System

#: By how many steps the stop time may miss a whole number of them, for rounding.
_STEP_TOLERANCE = 1e-6


#: More steps than this is taken for a mistake.
_MOST_STEPS = 1e10


def simulate(
    system: System,
    stop_time: float,
    step_size: float,
    *,
    start_time: float = 0.0,
    order: Order = "sequential",
    record: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Results:
    """Couple the FMUs of a system at a fixed communication step.

    Communication points are `start_time + i * step_size`. Inputs are held between them. See `cosim.exchange` for the
    two orders and their delays.

    Parameters
    ----------
    system : System
        Components, connections and signals.
    stop_time, step_size, start_time : float
        In s; the duration must be a whole number of steps.
    order : {"sequential", "parallel"}
        Order in which values are exchanged.
    record : sequence of str, optional
        Names `component.variable`, scalars or vectors; all inputs and outputs by default.
    progress : callable, optional
        Called now and then with the simulated time (s).

    Returns
    -------
    Results
        One row for each communication point, the start included.

    Raises
    ------
    SetupError
        The system can't be simulated as described; nothing has run.
    SimulationError
        An FMU failed; its `results` hold what had been recorded.
    SimulationInterrupted
        Ctrl-C; its `results` hold what had been recorded.
    """
    steps = _number_of_steps(start_time, stop_time, step_size)
    if order not in ("sequential", "parallel"):
        raise SetupError(f"order {order!r} is unknown; use 'sequential' or 'parallel'")
    if not system.components:
        raise SetupError("the system has no components; add one with System.add")
    began = clock.perf_counter()
    fmus = {name: load(name, component.fmu) for name, component in system.components.items()}
    ports = {name: Ports(name, fmu.description) for name, fmu in fmus.items()}
    resolved = resolve(system, ports, order)
    recorded = _recorded(record, ports)
    _check_signals(resolved, start_time)
    with DeferredInterrupt() as interrupt, _instances(resolved, fmus) as instances:
        exchange = Exchange(resolved, instances, order, recorded)
        run = Run(resolved, instances, exchange, interrupt, progress)
        run.initialize(start_time)
        results = Results(
            time=np.empty(0),
            names=[f"{component}.{element.name}" for component, element in recorded],
            values=np.empty((0, len(recorded))),
            info={
                "step_size": step_size,
                "stop_time": stop_time,
                "start_time": start_time,
                "order": order,
                "fmus": {name: {"path": str(f.path), "sha256": f.sha256} for name, f in fmus.items()},
                "parameters": _parameters(ports, instances, start_time),
            },
        )
        return run.loop(start_time, step_size, steps, results, began)


def _number_of_steps(start_time: float, stop_time: float, step_size: float) -> int:
    for name, value in (("start time", start_time), ("stop time", stop_time), ("step", step_size)):
        if not math.isfinite(value):
            raise SetupError(f"{name} {value} s is not a finite number")
    if step_size <= 0.0:
        raise SetupError(f"step {step_size!r} s must be positive")
    if stop_time <= start_time:
        raise SetupError(f"stop time {stop_time!r} s must be later than the start time {start_time!r} s")
    exact = (stop_time - start_time) / step_size
    if exact > _MOST_STEPS:
        raise SetupError(f"{exact:.3g} steps of {step_size!r} s are too many; make the step longer")
    if start_time + step_size == start_time or stop_time - step_size == stop_time:
        raise SetupError(f"a step of {step_size!r} s is too short to be told apart at t = {stop_time!r} s")
    steps = round(exact)
    if steps < 1 or abs(exact - steps) > _STEP_TOLERANCE:
        lower, upper = (start_time + n * step_size for n in (math.floor(exact), math.ceil(exact)))
        near = f"{upper:.9g} s" if math.floor(exact) < 1 else f"{lower:.9g} s or {upper:.9g} s"
        raise SetupError(
            f"the duration {stop_time - start_time:.9g} s is not a whole number of steps of {step_size!r} s; "
            f"stop at {near}, or change the step"
        )
    return steps


def _recorded(record: Sequence[str] | None, ports: Mapping[str, Ports]) -> list[tuple[str, Element]]:
    if record is None:
        return [
            (component, element)
            for component, port in ports.items()
            for causality in ("input", "output")
            for element in port.of_causality(causality)
            if element.kind in KINDS.values()
        ]
    if isinstance(record, str):
        raise SetupError(f"record = {record!r} must be a list of names: [{record!r}]")
    chosen: dict[tuple[str, str], tuple[str, Element]] = {}
    for path in record:
        port, name = split(path, ports)
        for element in port.find(name):
            if element.kind not in KINDS.values():
                raise SetupError(f"'{path}' is of type {element.kind} and can't be recorded")
            chosen[port.component, element.name] = (port.component, element)
    return list(chosen.values())


def _check_signals(resolved: ResolvedSystem, start_time: float) -> None:
    for drive in resolved.drives:
        try:
            sample(drive, start_time, f"{drive.component}.{drive.targets[0].name}")
        except CallFailed as error:
            raise SetupError(f"{error} (at t = {start_time!r} s)") from error


@contextmanager
def _instances(resolved: ResolvedSystem, fmus: Mapping[str, LoadedFMU]) -> Iterator[dict[str, Instance]]:
    """Unpack each FMU file once and instantiate all components; all is freed and removed at the end."""
    with ExitStack() as stack:
        folders: dict[str, Path] = {}
        instances: dict[str, Instance] = {}
        for name, fmu in fmus.items():
            if fmu.sha256 not in folders:
                # an FMU whose library is still in use can't be removed on Windows; that must not hide the results
                folder = Path(stack.enter_context(TemporaryDirectory(prefix="cosim_", ignore_cleanup_errors=True)))
                try:
                    fmu.unpack(folder)
                except SetupError as error:
                    raise SetupError(f"component '{name}': {error}") from error
                folders[fmu.sha256] = folder
        for name, fmu in fmus.items():
            try:
                instances[name] = Instance(name, folders[fmu.sha256], fmu.description)
            except CallFailed as error:
                raise SetupError(f"component '{name}': {fmu.path} {error}") from error
            stack.callback(instances[name].close)
        yield {name: instances[name] for name in resolved.components}


def _parameters(ports: Mapping[str, Ports], instances: Mapping[str, Instance], time: float) -> dict[str, float]:
    """Values of all real parameters, as the FMUs report them."""
    values: dict[str, float] = {}
    for component, port in ports.items():
        elements = [e for e in port.of_causality("parameter") if e.variable.type in ("Real", "Float64")]
        if elements:
            buffer = np.zeros(len(elements))
            with Failing(component, time, instances[component]):
                Batch(instances[component], variables_of(elements), buffer).get()
            values.update({f"{component}.{e.name}": v for e, v in zip(elements, buffer.tolist(), strict=True)})
    return values
