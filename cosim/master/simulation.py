"""A system that is set up once and run many times."""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from cosim.errors import SetupError, nearest, positive_whole
from cosim.fmi.fmu_file import LoadedFMU, load
from cosim.fmi.instance import INITIALIZING, CallFailed, ExperimentSetup
from cosim.fmi.interfaces import AUTO_INTERFACE, INTERFACES, MODEL_EXCHANGE, is_model_exchange, used_interface
from cosim.fmi.isolation.limits import Limits
from cosim.fmi.isolation.process import can_isolate, check_platform
from cosim.fmi.message_log import Log, LogWriter
from cosim.fmi.messages import Messages, summary
from cosim.fmi.structure import depends_on_start_values, is_size
from cosim.fmi.types import Texts
from cosim.fmi.variable_buffer import VariableBuffer
from cosim.loop.binding import loop_library
from cosim.loop.current_calls import is_at, watched_calls
from cosim.loop.team import Threads, checked_threads
from cosim.master.checkpoint import Checkpoint, CheckpointedRun
from cosim.master.coupling.algorithm import AUTO, VARIABLE, algorithm, most_iterations
from cosim.master.coupling.coupling_tolerance import (
    MOST_VALUES,
    ToleranceSearch,
    checked_tolerance,
    compared_names,
)
from cosim.master.coupling.extrapolated_inputs import extrapolated_inputs
from cosim.master.coupling.input_orders import order_taken
from cosim.master.coupling.iterated_steps import Iterated, Iteration, iteration_of_steps, why_not_repeated
from cosim.master.coupling.model_exchange import ModelExchangeGroup, Solver, check_components, group_of
from cosim.master.coupling.starting_blocks import steps_of_block, why_no_block
from cosim.master.coupling.variable_steps import (
    DEFAULT_TOLERANCE,
    Compared,
    VariablePlan,
    VariableRun,
    check_any_step,
)
from cosim.master.failures import Failing, InterruptedInCall, SimulationError, SimulationInterrupted
from cosim.master.interrupts import DeferredInterrupt
from cosim.master.loaded_components import LoadedComponents, setting_up
from cosim.master.operations import Exchange
from cosim.master.pacing import Pacer
from cosim.master.recording import (
    Growing,
    InMemory,
    Marks,
    NonFinite,
    Observed,
    PassedOn,
    RecordedColumns,
    Recorder,
    Sink,
)
from cosim.master.refusals import Refusals, function_for_derivatives, lacking_of
from cosim.master.run import Grid, Run
from cosim.master.sampling import Samples, sample
from cosim.master.steering import SteeredRun, Steering
from cosim.master.stepping import SteppedRun, why_not_settable
from cosim.master.value_layout import ValueLayout
from cosim.results.results import Results
from cosim.system.resolution import Drive, StartValue, resolve, resolve_start_value, split
from cosim.system.system import Signal, System
from cosim.system.variables import LARGE, Element, Ports, variables_of

if TYPE_CHECKING:
    pass

#: By how many steps the stop time may miss a whole number of them, for rounding.
_STEP_TOLERANCE = 1e-6

#: More steps than this is taken for a mistake.
_MOST_STEPS = 1e10

#: A signal of a run with checkpoints is known again by so many of its values; by fewer, if it gives one at a time.
_FINGERPRINTED = 20_000

#: Relative tolerance that an FMU is told which fails when it is told none.
_ASSUMED_TOLERANCE = 1e-6

#: Samples of signals that are kept where each step has its own.
_FEW_SAMPLES = 100

#: Of a signal, so many breakpoints are said.
_MOST_BREAKPOINTS = 100

#: Communication points of a run without an end.
_MOST_POINTS = int(_MOST_STEPS)


@contextmanager
def _collecting_garbage_later() -> Iterator[None]:
    """Context in which Python does not look for garbage: a system of many FMUs makes many objects, and all stay."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


class Simulation:
    """A system with its FMUs loaded, to be run as often as needed.

    Every run is what a first run would be, bit for bit. An instance of an FMU whose annotation says that its reset is
    complete, as that of this project's FMUs does, is reset between two runs, and any other is made anew; the results
    say which (`info["fmus"]`).

    Parameters
    ----------
    system : System
        Components, connections and signals.
    order : str
        Order in which values are exchanged at a communication point: "sequential" (Gauss-Seidel) or "parallel"
        (Jacobi); see `cosim.master.coupling.algorithm`.
    extrapolation : str
        What connected inputs do between communication points: "hold" (zero-order hold), "linear" (first-order hold,
        linear extrapolation), or another one of `cosim.master.coupling.algorithm`; "auto" is "adaptive" in sequential
        order where the FMUs can, else linear, and else holds.
    record : sequence of str, optional
        Names `component.variable`, scalars or vectors; all inputs and outputs by default.
    build : bool
        Whether to compile the C sources of FMUs that have no binary for this machine.
    strict_inputs : bool
        An input that nothing feeds and that has no start value in the system is an error; by default it keeps the start
        value of its FMU, and the summary names it.
    log : Log or str, optional
        Which messages of the FMUs are written, and where to, or the level alone; none are by default. However that is,
        results count warnings and have the first message of each kind (`info["messages"]`).
    threads : int or "auto"
        Threads that step components at the same time; results are equal to the last bit. "auto" measures whether that
        is faster than one component after the other. FMUs that run Python, and components with events, stay in one.
    interface : str
        Interface of the FMUs of components that do not choose one (`System.add`): "co-simulation", "model-exchange", or
        "auto", which is co-simulation where an FMU has it and else model exchange. Components in model exchange are
        integrated together, and are coupled exactly.
    solver : str
        What integrates them: "rk4", with a fixed step, "dopri5", with error control by the tolerance, or "cvode", for
        stiff equations. "auto" is rk4 where model exchange was chosen, and dopri5 where an FMU has nothing else.
    solver_step : float, optional
        Step (s) of a fixed method, which divides the communication step; that itself by default.
    iterations : int, "auto" or "loops", optional
        Solve algebraic loops at the start and at each communication point, by so many iterations of Newton's method at
        most; "auto" allows 50. By default a system with an algebraic loop is refused. And repeat each step, by so many
        iterations at most, until the inputs of all components have gone to what comes out at its end; with "auto" up to
        50, and a step that is not solved is an error. FMUs must be able to save their state. "loops" solves algebraic
        loops only.
    profile : bool
        Measure how long the steps and the exchange of each component take, at one communication point in 61; results
        say it (`info["profile"]`).
    isolate : bool or sequence of str
        Whether all FMUs live in processes of their own, or those of which components, besides those that the system
        isolates; see `System.add`.
    limits : Limits, optional
        Limits of isolated FMUs.
    scheduler : str, optional
        Address of the scheduler of a Dask cluster, on whose workers FMUs live that have a place (`System.add`); by
        default that of the configuration of Dask.
    terminate_late : bool
        Whether FMUs are told that a run is over, and results say how that went, when another one begins or the
        simulation is closed, and not at once: an FMU that crashes then costs nothing that was saved before.

    Raises
    ------
    SetupError
        The system can't be simulated as described; nothing has run.

    Examples
    --------
    >>> with Simulation(system) as simulation:
    ...     for alpha in (1.0, 2.0):
    ...         results = simulation.run(15.0, 1e-3, start={"controller.alpha": alpha})
    """

    @_collecting_garbage_later()
    def __init__(
        self,
        system: System,
        *,
        order: str = "sequential",
        extrapolation: str = AUTO,
        record: Sequence[str] | None = None,
        build: bool = False,
        strict_inputs: bool = False,
        log: Log | str | None = None,
        threads: Threads = 1,
        profile: bool = False,
        interface: str = AUTO_INTERFACE,
        solver: str = AUTO,
        solver_step: float | None = None,
        isolate: bool | Sequence[str] = False,
        limits: Limits | None = None,
        iterations: int | str | None = None,
        scheduler: str | None = None,
        terminate_late: bool = False,
    ) -> None:
        chosen = algorithm(order, extrapolation)
        self._threads = checked_threads(threads)
        self._profile = profile
        self._terminate_late = terminate_late
        self._most_iterations = most_iterations(iterations)
        if self._most_iterations and not chosen.order.needs_levels:
            raise SetupError(
                f"iterations = {iterations!r}: order '{order}' breaks algebraic loops by a delay and solves none; "
                "leave iterations out, or use order='sequential'"
            )
        if interface not in INTERFACES:
            raise SetupError(f"interface {interface!r} is unknown; {nearest(str(interface), INTERFACES)}")
        if not system.components:
            raise SetupError("the system has no components; add one with System.add")
        loop_library()
        self._system = dataclasses.replace(system, signals=list(system.signals))
        self._order = order
        self._fmus = _loaded(system, interface)
        self._limits = Limits() if limits is None else limits
        self._places = {name: component.place for name, component in system.components.items() if component.place}
        if scheduler is not None and not self._places:
            raise SetupError(f"scheduler {scheduler}: no component has a place there; give one its place (--place)")
        isolated = self._to_isolate(isolate)
        for name, fmu in self._fmus.items():
            if name in self._places:  # its machine has a look
                continue
            with setting_up(name, fmu.path):
                fmu.check_binary(build=build)
        self._functions = {name: c.function for name, c in system.components.items() if c.function is not None}
        descriptions = {name: fmu.description for name, fmu in self._fmus.items()}
        asked = [(c.interface or interface) == MODEL_EXCHANGE for c in system.components.values() if c.fmu]
        with_equations = [is_model_exchange(description) for description in descriptions.values()]
        chosen_interface = all(a for a, used in zip(asked, with_equations, strict=True) if used)
        asked_solver = Solver(solver, solver_step)
        self._solver = asked_solver.chosen(interface_chosen=chosen_interface)
        descriptions |= {name: function.description() for name, function in self._functions.items()}
        self._ports: dict[str, Ports] = {}
        known: dict[int, Ports] = {}
        for name, component in system.components.items():
            description = descriptions[name]
            port = known.get(id(description))  # FMUs with one description have equal variables
            self._ports[name] = Ports(name, description, component.start) if port is None else port.of_another(name)
            known[id(description)] = self._ports[name]
        self._resolved = resolve(
            system,
            self._ports,
            needs_levels=chosen.order.needs_levels,
            strict_inputs=strict_inputs,
            tears=self._most_iterations > 0,
        )
        check_components(self._resolved, asked_solver)
        self._iterated, self._not_iterated = iteration_of_steps(iterations), ""
        if self._iterated.most and (why := why_not_repeated(self._resolved, self._functions)):
            if not self._resolved.torn:
                raise SetupError(f"iterations = {iterations!r}: steps can't be repeated: {why}")
            self._iterated, self._not_iterated = Iteration(), why
        self._texts = Texts()
        self._algorithm = chosen
        self._recorded, self._records_all = _recorded(record, self._ports), record is None
        self._large = _large(self._ports) if record is None else []
        self._refusals = Refusals()
        self._orders_found: dict[str, int | None] = {}
        self._lay_out()
        self._components = LoadedComponents(
            self._fmus,
            self._functions,
            self._ports,
            isolated,
            self._texts,
            *self._taking_messages(log),
            limits=self._limits,
            places=self._places,
            scheduler=scheduler,
            build=build,
            threads=self._threads,
        )
        self._used = False
        self._occupied_by = ""
        self._samples: tuple[Any, Samples] | None = None
        self._group: ModelExchangeGroup | None = None

    def _to_isolate(self, isolate: bool | Sequence[str]) -> frozenset[str]:
        """Components whose FMUs live in processes of their own.

        An FMU that allows one instance in a process has its second one in another, where the platform can do that.

        Raises
        ------
        SetupError
            There is no such component, or the platform can't isolate FMUs.
        """
        own = {name for name, c in self._system.components.items() if c.isolate or c.place is not None}
        asked = set(self._fmus) if isolate is True else set(isolate or ())
        for name in sorted(asked - set(self._fmus)):
            raise SetupError(f"isolate: there is no component '{name}' with an FMU; {nearest(name, self._fmus)}")
        if own | asked:
            check_platform()
        elif self._limits != Limits():
            raise SetupError("limits are for isolated FMUs, and none is isolated; isolate some (option --isolated)")
        alone: set[str] = set()
        again: set[str] = set()
        for name, fmu in self._fmus.items():
            if name not in own | asked and used_interface(fmu.description).canBeInstantiatedOnlyOncePerProcess:
                (again.add(name) if fmu.sha256 in alone else alone.add(fmu.sha256))
        return frozenset(own | asked | (again if can_isolate() else set()))

    def isolate(self) -> None:
        """Have all FMUs live in processes of their own; before the simulation is entered.

        Raises
        ------
        SetupError
            The simulation is open, or the platform can't isolate FMUs.
        """
        if self._components.is_open:
            raise SetupError("the simulation is open; isolate its FMUs before")
        self._components.isolated = self._to_isolate(isolate=True)

    def _lay_out(self) -> None:
        """Decide what is extrapolated and recorded, and where all values stand, by what the FMUs have not refused."""
        orders = {name: fmu.input_derivative_order for name, fmu in self._fmus.items()}
        orders |= {name: order for name, order in self._orders_found.items() if order is not None}
        self._extrapolated = extrapolated_inputs(self._resolved, self._algorithm, self._refusals.derivatives, orders)
        needed = 0 if self._iterated.most else steps_of_block(self._resolved, self._extrapolated)
        self._no_block = why_no_block(self._resolved, self._functions) if needed else ""
        self._steps_of_block = 0 if self._no_block else needed
        recorded = [(c, e) for c, e in self._recorded if f"{c}.{e.name}" not in self._refusals.outputs]
        self._layout = ValueLayout(self._resolved, recorded, self._extrapolated)
        self._names = [f"{component}.{element.name}" for component, element in recorded]
        self._columns = RecordedColumns(self._names, [e.type for _, e in recorded], self._texts)
        units = {n: self._ports[c].unit(e) for n, (c, e) in zip(self._names, recorded, strict=True)}
        self._units = {name: unit.name for name, unit in units.items() if unit is not None}
        self._exchange: Exchange | None = None

    def _taking_messages(self, log: Log | str | None) -> tuple[LogWriter | None, dict[str, Messages]]:
        """The log, if there is one, and what takes the messages of each component."""
        if isinstance(log, str):
            log = Log(log)
        offered = {name: [c.name for c in fmu.description.logCategories] for name, fmu in self._fmus.items()}
        if log is not None:
            log.check_categories(offered.values())
        writer = None if log is None or log.level == "none" else LogWriter(log)
        self._log = writer
        asked = {name: None if log is None else log.asked_of(names) for name, names in offered.items()}
        return writer, {name: Messages(name, writer, asked[name]) for name in self._fmus}

    @property
    def names(self) -> list[str]:
        """Names `component.variable` of what is recorded."""
        return list(self._names)

    @property
    def types(self) -> dict[str, str]:
        """Name -> type of what is recorded and no real number: int64, uint64, bool, string or binary."""
        return self._columns.types

    @property
    def units(self) -> dict[str, str]:
        """Name -> unit of what is recorded, as far as the FMUs say."""
        return dict(self._units)

    @property
    def settable(self) -> dict[str, dict[str, Any]]:
        """Real inputs that nothing feeds, and tunable parameters: name -> start "value", "unit", "min", "max"."""
        found = {}
        given = {
            (s.component, e.name): v for s in self._resolved.starts for e, v in zip(s.elements, s.values, strict=True)
        }
        for component, port in self._ports.items():
            for element in port.all_elements():
                if element.kind == "real" and not why_not_settable(component, [element], self._resolved.fed):
                    unit = port.unit(element)
                    found[f"{component}.{element.name}"] = {
                        "value": given.get((component, element.name), _number(element.variable.start, element.offset)),
                        "unit": "" if unit is None else unit.name,
                        "min": _number(element.variable.min),
                        "max": _number(element.variable.max),
                    }
        return found

    # Instances

    def __enter__(self) -> Simulation:
        """Unpack each FMU file once and instantiate all components.

        Raises
        ------
        SetupError
            An FMU can't be unpacked or instantiated, or the simulation is open already.
        """
        if self._components.is_open:
            raise SetupError("the simulation is open already; make another one of the same system")
        self._exchange, self._used = None, False
        self._components.open(self._extrapolated.elements)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free all instances and remove what was unpacked; the simulation can be entered again."""
        self._components.close()
        self._exchange = None

    def moving_log(self, to: Callable[[], Path]) -> AbstractContextManager[None]:
        """Context in which the file of the log, if there is one, may be moved to the path that `to` then gives."""
        return nullcontext() if self._log is None else self._log.moving(to)

    def _fresh_exchange(self) -> Exchange:
        """Instances as they are after their instantiation, and the table of operations for them."""
        if self._used and not self._components.renew(self._extrapolated.elements):
            self._exchange = None
        self._used = True
        if self._exchange is None:
            self._do_without_absent()
            try:
                self._group = group_of(
                    self._resolved, self._components.instances, self._extrapolated, self._solver, self._most_iterations
                )
                self._exchange = Exchange(
                    self._resolved,
                    self._components.instances,
                    self._extrapolated,
                    self._layout,
                    self._group,
                    self._most_iterations,
                    self._iterated,
                    self._steps_of_block,
                )
                if self._group is not None:
                    self._group.attach(self._exchange, self._layout)
            except CallFailed as error:
                raise SetupError(f"an FMU {error}") from error
            try:
                self._exchange.start_in_blocks()
            except CallFailed as error:
                self._no_block, self._steps_of_block = f"an FMU {error}", 0
        self._exchange.begin()
        return self._exchange

    # What FMUs refuse

    def _do_without_absent(self) -> None:
        """Hold inputs of FMUs that lack the function for their derivatives; leave out outputs that none can read.

        Raises
        ------
        SetupError
            Derivatives, which are asked for, can't be set.
        """
        found = Refusals()
        for component in self._extrapolated.elements:
            instance = self._components.instances[component]
            name = function_for_derivatives(instance.version)
            takes = instance.version == 3 or self._ports[component].is_model_exchange or not instance.lacks(name)
            if component not in self._fmus or takes:
                continue
            lacks = f"it lacks the function {name.replace('fmi1', 'fmi')}"
            if self._algorithm.demanded:
                raise SetupError(
                    f"the FMU of component '{component}' says that it interpolates inputs, but {lacks}; use "
                    "extrapolation='hold' (option --extrapolation hold)"
                )
            found.derivatives[component] = lacks
        recorded: dict[str, list[Element]] = {}
        for component, element in self._recorded if self._records_all else ():
            recorded.setdefault(component, []).append(element)
        for component, elements in recorded.items():
            if component in self._fmus and (lacking := lacking_of(self._components.instances[component], elements)):
                found.outputs |= self._that_nothing_needs(component, lacking)
        self._do_without(found)

    def _that_nothing_needs(self, component: str, refused: Mapping[str, str]) -> dict[str, str]:
        """Names of refused outputs that were to be recorded only; none if the FMU gives no output at all then."""
        outputs = {e.name for e in self._ports[component].of_causality("output") if e.is_exchanged}
        gone = {name.partition(".")[2] for name in self._refusals.outputs if name.startswith(f"{component}.")}
        feeding = {k.source.name for k in self._resolved.links if k.source_component == component}
        if feeding & set(refused) or not outputs - gone - set(refused):
            return {}
        recorded = {e.name for c, e in self._recorded if c == component} - gone
        return {f"{component}.{name}": why for name, why in refused.items() if name in recorded}

    def _do_without(self, found: Refusals) -> bool:
        """Lay the system out again where an FMU has refused something; whether it has."""
        if not found.about():
            return False
        self._refusals.derivatives |= found.derivatives
        self._refusals.outputs |= found.outputs
        self._lay_out()
        return True

    # Runs

    def run(
        self,
        stop_time: float,
        step_size: float | str,
        *,
        start_time: float = 0.0,
        start: Mapping[str, Any] | None = None,
        signals: Sequence[Signal] = (),
        tolerance: float | None = None,
        record_every: int = 1,
        sink: Sink | None = None,
        realtime: float | None = None,
        progress: Callable[[float], None] | None = None,
        checkpoint: Checkpoint | None = None,
        nonfinite: NonFinite = "mark",
        observe: Sink | None = None,
        steering: Steering | None = None,
        coupling_tolerance: float | None = None,
    ) -> Results:
        """Couple the FMUs at a fixed communication step, from their start values.

        Communication points are `start_time + i * step_size`.

        Parameters
        ----------
        stop_time, step_size, start_time : float
            In s; the duration must be a whole number of steps. "variable" takes steps that are as long as the coupling
            tolerance allows, 1e-4 by default: each is taken as one and as two halves, whose difference says the error;
            FMUs must be able to save their state. `info["variable_steps"]` has numbers and lengths of steps.
        start : mapping, optional
            Start values `component.variable` of this run, besides those of the system.
        signals : sequence of Signal
            Signals of this run, in place of those that feed the same targets in the system.
        tolerance : float, optional
            Relative tolerance that the FMUs are told; that of the default experiment of each by default.
        record_every : int
            Record at every so many communication points, the first included.
        sink : callable, optional
            Takes times (n,) and values (n, columns) chunk by chunk instead of the results, for runs that are too long
            for memory.
        realtime : float, optional
            Simulated seconds in a second, 1 for real time; as fast as possible by default.
        progress : callable, optional
            Called now and then with the simulated time (s).
        checkpoint : Checkpoint, optional
            Keeps the state of the run on the disk as it goes on, to resume it; all FMUs must be able to save theirs.
        nonfinite : str
            What becomes of a run with a recorded output that is NaN or infinite: "error" ends it there, "mark" goes on,
            and the results say which output, from when on, and in how many rows (`info["nonfinite"]`). An output that
            is connected must be finite in any case.
        observe : callable, optional
            Takes times (n,) and values (n, columns) of further rows, some 20 times a second, beside whatever keeps
            them; both are only valid during the call.
        steering : Steering, optional
            Commands for the run as it goes on: values to set, pause, stop; `info["commands"]` has what was done.
        coupling_tolerance : float, optional
            Largest coupling error, relative to the largest magnitude of each variable: the results are those of the
            longest communication step that keeps it, which runs with several steps show, `step_size` first. Those that
            feed other components count, or what is recorded where that was chosen. `info["coupling"]` has the step,
            the estimated error, and what was tried. With variable steps each keeps its share of it.

        Returns
        -------
        Results
            One row for each recorded communication point, those from before the run was resumed included.

        Raises
        ------
        SetupError
            The run can't be made as described; nothing has run.
        SimulationError
            An FMU or a function failed; its `results` hold what had been recorded.
        SimulationInterrupted
            Ctrl-C; its `results` hold what had been recorded.
        """
        record_every = _checked_record_every(record_every)
        if step_size == VARIABLE:
            once = {"realtime": realtime, "checkpoint": checkpoint, "observe": observe, "steering": steering}
            _refuse(once | {"profile": self._profile or None}, "step_size = 'variable': {} needs a fixed step")
            return self._run_variable(
                start_time,
                stop_time,
                DEFAULT_TOLERANCE if coupling_tolerance is None else checked_tolerance(coupling_tolerance),
                start or {},
                signals,
                tolerance,
                record_every,
                sink,
                progress,
                nonfinite,
            )
        if isinstance(step_size, str):
            raise SetupError(f"step_size = {step_size!r} must be a number (s), or '{VARIABLE}'")
        if coupling_tolerance is not None:
            once = {"sink": sink, "realtime": realtime, "checkpoint": checkpoint, "observe": observe}
            once |= {"steering": steering, "record_every": None if record_every == 1 else record_every}
            _refuse(once, "a coupling tolerance takes several runs, and {} is for one")
            number_of_steps(start_time, stop_time, step_size)
            run_with = partial(
                self.run,
                stop_time,
                start_time=start_time,
                start=start,
                signals=signals,
                tolerance=tolerance,
                progress=progress,
                nonfinite=nonfinite,
            )
            feeding = [f"{k.source_component}.{k.source.name}" for k in self._resolved.links]
            real = [name for name in self._names if name not in self.types]
            compared = compared_names(real, feeding, chosen=not self._records_all)
            most_steps = MOST_VALUES // max(1, len(self._names))
            return ToleranceSearch(
                run_with, compared, stop_time - start_time, step_size, coupling_tolerance, most_steps
            ).found()
        began, names = clock.perf_counter(), self.names
        grid = Grid(start_time, step_size, number_of_steps(start_time, stop_time, step_size), stop_time)
        samples, starts = self._prepared(grid, start or {}, signals)
        experiments = self._experiments(grid, tolerance)
        if nonfinite not in get_args(NonFinite):
            raise SetupError(f"nonfinite = {nonfinite!r} must be one of {', '.join(map(repr, get_args(NonFinite)))}")
        pacer = None if realtime is None else Pacer(realtime)
        if checkpoint is not None and (observe is not None or steering is not None):
            raise SetupError("a run with checkpoints can't be observed or steered; leave out one of them")
        if steering is not None:
            with self._stepping(grid, samples, starts, record_every, experiments, nonfinite) as (run, growing, results):
                self._check_sink(sink, names)
                slots = None if sink is None else self._slot_sink(sink, run.marks)
                steered = SteeredRun(run, growing, grid, results, steering, observe, slots, self._columns.values)
                with self._components.process.while_fmus_are_called():
                    return steered.to_end(progress, pacer)
        if checkpoint is not None:
            self._check_states()
            times = self._times(grid, record_every)
            known = partial(_fingerprints, self._drives(signals), grid)
            with self._stepping(grid, samples, starts, record_every, experiments, nonfinite) as (run, growing, results):
                self._check_sink(sink, names)
                slots = None if sink is None else self._slot_sink(sink, run.marks)
                kept = CheckpointedRun(run, growing, grid, record_every, results, times, known, checkpoint, slots)
                with self._components.process.while_fmus_are_called():
                    return kept.to_end(progress, pacer)
        with (
            self._occupied("a run of this simulation is going on") as interrupt,
            self._components.process.while_fmus_are_called(),
        ):
            loop, results = self._begun(samples, starts, grid, record_every, experiments, interrupt, nonfinite)
            self._check_sink(sink, names)
            recorder = self._recorder(grid, record_every, sink, loop.marks)
            if observe is not None:
                recorder = Observed(recorder, self._times(grid, record_every), self._columns.values, observe)
            with _timed(results, began):
                return loop.loop(recorder, record_every, results, progress, pacer)

    def _run_variable(
        self,
        start_time: float,
        stop_time: float,
        coupling_tolerance: float,
        start: Mapping[str, Any],
        signals: Sequence[Signal],
        tolerance: float | None,
        record_every: int,
        sink: Sink | None,
        progress: Callable[[float], None] | None,
        nonfinite: NonFinite,
    ) -> Results:
        """A run with variable steps; see `run`."""
        began, names = clock.perf_counter(), self.names
        number_of_steps(start_time, stop_time, stop_time - start_time)  # times that make sense
        if why := why_not_repeated(self._resolved, self._functions, to_other_points=True):
            raise SetupError(f"step_size = '{VARIABLE}': steps can't be repeated: {why}")
        check_any_step(self._components.instances)
        drives = self._drives(signals)
        iterated = Iterated(self._resolved, self._extrapolated, self._layout)
        plan = VariablePlan(
            start_time,
            stop_time,
            coupling_tolerance,
            [b for drive in drives for b in drive.breakpoints],
            self._order_of_coupling(iterated),
            record_every,
            partial(self._new_samples, drives, most=_FEW_SAMPLES),
        )
        samples, starts = self._prepared(plan.first_grid(), start, signals)
        whole = Grid(start_time, stop_time - start_time, 1, stop_time)
        compared = self._compared()
        with (
            self._occupied("a run of this simulation is going on") as interrupt,
            self._components.process.while_fmus_are_called(),
        ):
            experiments = self._experiments(whole, tolerance)
            run, results = self._begun(
                samples, starts, plan.first_grid(), record_every, experiments, interrupt, nonfinite
            )
            results.info |= {"step_size": VARIABLE, "stop_time": stop_time}
            self._check_sink(sink, names)
            slots = None if sink is None else self._slot_sink(sink, run.marks)
            steps = VariableRun(
                run, self._components.instances, plan, compared, results, slots, lambda: bool(interrupt.requested)
            )
            with _timed(results, began):
                return steps.to_end(progress)

    def _order_of_coupling(self, iterated: Iterated) -> int:
        """By which power of the step the coupling error falls: that of the input that is extrapolated worst."""
        held = [2 if self._iterated.most else 1] * bool(iterated.held)
        polynomials = [e.degree + 1 for e in self._extrapolated.moving.values()]
        return min([*held, *polynomials], default=1)

    def _compared(self) -> Compared:
        """What steps are compared by: outputs that feed others, or what is recorded where that was chosen.

        Raises
        ------
        SetupError
            There is nothing to compare.
        """
        sources = [(k.source_component, k.source) for k in self._resolved.links]
        elements = {
            f"{component}.{element.name}": (component, element)
            for component, element in (sources if self._records_all else self._recorded)
            if element.kind == "real" and (component, element.name) in self._layout.positions
        }
        if not elements:
            raise SetupError(
                f"step_size = '{VARIABLE}': nothing real is connected, so there is no coupling error; give a number"
            )
        positions = [self._layout.positions[c, e.name] for c, e in elements.values()]
        nominal = [_number(e.variable.nominal) or 1.0 for _, e in elements.values()]
        return Compared(list(elements), np.array(positions), np.abs(np.array(nominal)))

    @contextmanager
    def start(
        self,
        step_size: float,
        *,
        start_time: float = 0.0,
        stop_time: float | None = None,
        start: Mapping[str, Any] | None = None,
        signals: Sequence[Signal] = (),
        tolerance: float | None = None,
        record_every: int = 1,
    ) -> Iterator[SteppedRun]:
        """A run that is stepped by hand, as a context; the FMUs are terminated at its end.

        Parameters
        ----------
        step_size, start_time : float
            In s.
        stop_time : float, optional
            Time (s) beyond which the run can't be stepped; without an end by default.
        start, signals, tolerance, record_every
            As in `run`.

        Yields
        ------
        SteppedRun
            It stands at the start time, where values have been exchanged.

        Raises
        ------
        SetupError
            The run can't be made as described; nothing has run.
        SimulationError
            An FMU failed in its initialisation.

        Examples
        --------
        >>> with Simulation(system) as simulation, simulation.start(step_size=1e-3) as run:
        ...     run.step(10)
        ...     print(f"{run.time:g} s, {len(run['plant.theta_a'])} angles")
        0.01 s, 3 angles
        """
        record_every = _checked_record_every(record_every)
        last = _MOST_POINTS if stop_time is None else number_of_steps(start_time, stop_time, step_size)
        if stop_time is None:
            number_of_steps(start_time, start_time + step_size, step_size)  # a step that makes sense
        grid = Grid(start_time, step_size, last, stop_time)
        samples, starts = self._prepared(grid, start or {}, signals)
        experiments = self._experiments(grid, tolerance)
        with self._stepping(grid, samples, starts, record_every, experiments) as (run, _, _):
            yield run
            run.end()

    @contextmanager
    def _stepping(
        self,
        grid: Grid,
        samples: Samples,
        starts: Sequence[StartValue],
        record_every: int,
        experiments: dict[str, ExperimentSetup],
        nonfinite: NonFinite = "mark",
    ) -> Iterator[tuple[SteppedRun, Growing, Results]]:
        """A run to be stepped, what it records to, and results without rows."""
        with self._occupied("a run of this simulation is being stepped") as interrupt:
            with self._components.process.while_fmus_are_called():  # not while the caller goes on
                loop, results = self._begun(samples, starts, grid, record_every, experiments, interrupt, nonfinite)
            growing = Growing(self._times(grid, record_every), len(self._names))
            run = SteppedRun(
                loop,
                self._resolved,
                self._layout,
                self._components.instances,
                grid,
                growing,
                record_every,
                results,
                interrupt,
                exchanges_by_level=self._extrapolated.algorithm.order.needs_levels,
                described=self._described(starts),
            )
            yield run, growing, results

    @contextmanager
    def _occupied(self, what: str) -> Iterator[DeferredInterrupt]:
        """Context of a run, in which no other one can begin: a function that it calls might try that."""
        self._occupied_by = what
        try:
            with watched_calls(), DeferredInterrupt() as interrupt:
                self._components.interrupt = interrupt
                yield interrupt
        finally:
            self._components.interrupt = None
            is_at(None)
            self._occupied_by = ""

    def _described(self, starts: Sequence[StartValue]) -> dict[str, Any]:
        """Properties of the system that a state must match, besides those in the results."""
        return {
            "components": {name: component.every for name, component in self._resolved.components.items()},
            "iterations": [self._most_iterations, self._iterated.most],
            "start_values": {
                f"{start.component}.{element.name}": value.hex() if isinstance(value, bytes) else value
                for start in starts
                if not start.is_large
                for element, value in zip(start.elements, start.values, strict=True)
            }
            | {
                f"{s.component}.{s.elements[0].variable.name}": hashlib.sha256(bytes(s.values)).hexdigest()
                for s in starts
                if s.is_large
            },
            "connections": {
                f"{k.target_component}.{k.target.name}": [f"{k.source_component}.{k.source.name}", k.factor, k.offset]
                for k in self._resolved.links
            },
        }

    def _check_states(self) -> None:
        """Whether all FMUs say that they can save their state.

        Raises
        ------
        SetupError
            One can't.
        """
        if any(port.is_model_exchange for port in self._ports.values()):
            self._solver.check_states()
        for name, fmu in self._fmus.items():
            try:
                self._components.instances[name].check_states()
            except CallFailed as error:
                raise SetupError(f"component '{name}': {fmu.path} {error}; run without checkpoints") from error

    def _prepared(
        self, grid: Grid, start: Mapping[str, Any], signals: Sequence[Signal]
    ) -> tuple[Samples, list[StartValue]]:
        """Samples of the signals and start values of a run."""
        if not self._components.is_open:
            raise SetupError("the simulation is not open; use it in a with statement")
        if self._occupied_by:
            raise SetupError(f"{self._occupied_by}; end it first, or make another simulation")
        if any(port.is_model_exchange for port in self._ports.values()):
            self._solver.steps_in(grid.step_size)
        extra = self._extra_starts(start)
        given = {node for s in extra for node in s.nodes}
        # a vector of this run replaces what the system gives for its elements
        starts = [s for s in self._resolved.starts if not s.is_replaced(given)]
        return self._samples_of(self._drives(signals), grid), [*starts, *extra]

    def _experiments(self, grid: Grid, tolerance: float | None) -> dict[str, ExperimentSetup]:
        """Start time, stop time and tolerance that the FMU of each component is told.

        Raises
        ------
        SetupError
            The tolerance makes no sense.
        """
        if tolerance is not None and not (math.isfinite(tolerance) and tolerance > 0.0):
            raise SetupError(f"tolerance {tolerance!r} must be a positive number; it is the relative one of the FMUs")
        return {
            name: ExperimentSetup(
                grid.start_time,
                grid.told_stop_time(self._resolved.components[name].every),
                self._fmus[name].tolerance if tolerance is None and name in self._fmus else tolerance,
            )
            for name in self._ports
        }

    def _begun(
        self,
        samples: Samples,
        starts: Sequence[StartValue],
        grid: Grid,
        record_every: int,
        experiments: dict[str, ExperimentSetup],
        interrupt: DeferredInterrupt,
        nonfinite: NonFinite,
    ) -> tuple[Run, Results]:
        """A run whose FMUs have been initialised, and its results without rows.

        An FMU that fails without a tolerance is told one: some need it without saying so in their description. Inputs
        of an FMU that refuses their derivatives are held, and outputs that it refuses to give are left out, where
        nobody has asked for either.
        """
        first: SimulationError | None = None
        assumed: list[str] = []
        while True:
            is_at(grid.start_time)
            exchange = self._fresh_exchange()
            run = Run(
                self._components.instances,
                exchange,
                samples,
                grid,
                interrupt,
                self._columns,
                self._threads,
                self._group,
                profile=self._profile,
                nonfinite=nonfinite,
                postpone=self._components.postpone if self._terminate_late else None,
                restore_process=self._components.process.restore,
            )
            try:
                run.initialize(starts, experiments)
                if self._has_tried_orders(grid):
                    continue
                tried = {} if self._algorithm.demanded else run.refused_derivatives()
            except InterruptedInCall as stop:
                results = self._nothing_yet(grid, record_every, experiments, assumed, samples.drives, starts)
                results.info["status"] = "interrupted"
                raise SimulationInterrupted(stop.time, results) from None
            except SimulationError as error:
                if self._records_all and self._do_without(self._refused_outputs(run)):
                    continue
                first = first or error
                setup = experiments.get(error.component)
                failed = error.__cause__
                may_lack_it = isinstance(failed, CallFailed) and failed.function in INITIALIZING
                if setup is None or setup.tolerance is not None or not may_lack_it:
                    raise first from first.__cause__
                experiments[error.component] = dataclasses.replace(setup, tolerance=_ASSUMED_TOLERANCE)
                assumed.append(error.component)
            else:
                if not self._do_without(Refusals(tried)):
                    return run, self._nothing_yet(grid, record_every, experiments, assumed, samples.drives, starts)

    def _has_tried_orders(self, grid: Grid) -> bool:
        """Find out which orders of derivatives FMUs take that don't say it; whether one had to be tried for that.

        Raises
        ------
        SetupError
            One ignores derivatives that are asked for.
        """
        untried = [name for name in self._extrapolated.assumed if name not in self._orders_found]
        for name in untried:
            moving = self._extrapolated.moving
            degree = max(each.degree for (component, _), each in moving.items() if component == name)
            inputs = [e for e in self._extrapolated.elements[name] if (name, e.name) in moving]
            outputs = [e for e in self._ports[name].of_causality("output") if e.kind == "real" and e.is_exchanged]
            step = grid.step_size * self._resolved.components[name].every
            instance = self._components.instances[name]
            found = order_taken(instance, inputs, outputs, degree, grid.start_time, step)
            if found is not None and found < degree:
                raise SetupError(
                    f"component '{name}': its FMU ignores derivatives of its inputs from order {found + 1} on, and "
                    f"they have the degree {degree}; use extrapolation = '{AUTO}' or 'linear' for what feeds it"
                )
            self._orders_found[name] = found
        if untried:
            self._lay_out()
        return bool(untried)

    def _refused_outputs(self, run: Run) -> Refusals:
        """Outputs without which a run could begin that has failed to."""
        component, refused = run.refused_outputs()
        return Refusals(outputs=self._that_nothing_needs(component, refused) if refused else {})

    def _check_sink(self, sink: Sink | None, names: Sequence[str]) -> None:
        """Whether a sink gets what it was told that it would.

        Raises
        ------
        SetupError
            FMUs have refused some of it.
        """
        if sink is not None and (lost := sorted(set(names) - set(self._names))):
            name, why = lost[0], self._refusals.outputs[lost[0]]
            raise SetupError(
                f"the FMU of component '{name.partition('.')[0]}' does not give '{name}' ({why}), which a sink was to "
                "get; run again without it (Simulation.names has changed), or say what to record"
            )

    def _nothing_yet(
        self,
        grid: Grid,
        record_every: int,
        experiments: Mapping[str, ExperimentSetup],
        assumed: Sequence[str],
        drives: Sequence[Drive],
        starts: Sequence[StartValue],
    ) -> Results:
        """Results without rows, that say how the run is made."""
        info = {
            "step_size": grid.step_size,
            "stop_time": grid.stop_time,
            "start_time": grid.start_time,
            "order": self._order,
            "extrapolation": self._extrapolated.summary(),
            "inputs_kept": list(self._resolved.kept),
            **({"inputs_driven": [s.target for s in self._system.signals]} if self._system.signals else {}),
            **({"arrays_not_recorded": self._large} if self._large else {}),
            **({"steps_not_iterated": self._not_iterated} if self._not_iterated else {}),
            **({"order_found": found} if (found := {n: o for n, o in self._orders_found.items() if o}) else {}),
            **({"starts_not_iterated": self._no_block} if self._no_block else {}),
            **({"clocks_without_source": list(self._resolved.unticked)} if self._resolved.unticked else {}),
            "record_every": record_every,
            "units": dict(self._units),
            "fmus": {
                name: {
                    "path": str(f.path),
                    "sha256": f.sha256,
                    "instance": "reset" if name in self._components.reset else "new",
                    "tolerance": experiments[name].tolerance,
                    **({"event_mode": True} if self._components.instances[name].uses_events else {}),
                    **({"interface": MODEL_EXCHANGE} if self._ports[name].is_model_exchange else {}),
                    **({"isolated": True} if name in self._components.isolated else {}),
                    **({"place": self._places[name]} if name in self._places else {}),
                }
                for name, f in self._fmus.items()
            },
            "connections": {c.target: c.source for c in self._system.connections},
            **self._said_breakpoints(drives),
            "parameters": self._parameters(grid.start_time),
            "start_values": _said(starts),
            **self._refusals.about(),
            **summary(self._components.messages.values()),
        }
        if assumed:
            info["tolerance_assumed"] = list(assumed)
        if self._functions:
            info["functions"] = {name: function.qualified_name for name, function in self._functions.items()}
        return Results(np.empty(0), list(self._names), np.empty((0, len(self._names))), info)

    def _said_breakpoints(self, drives: Sequence[Drive]) -> dict[str, Any]:
        """Where signals jump or bend (s), the first times of each."""
        targets = (s.target for s in self._system.signals)
        found = {t: list(d.breakpoints[:_MOST_BREAKPOINTS]) for t, d in zip(targets, drives, strict=True)}
        known = {target: times for target, times in found.items() if times}
        return {"breakpoints": known} if known else {}

    def _extra_starts(self, start: Mapping[str, Any]) -> list[StartValue]:
        starts = []
        for path, value in start.items():
            port, name = split(path, self._ports)
            resolved = resolve_start_value(port, name, value)
            if not resolved.feeds_none_of(self._resolved.fed):
                raise SetupError(f"start value of '{path}' would have no effect: a connection or a signal feeds it")
            self._check_sizes(resolved)
            if resolved.is_interval:
                raise SetupError(
                    f"start value of '{path}': a simulation keeps the intervals of clocks; give it in System.add"
                )
            starts.append(resolved)
        return starts

    def _check_sizes(self, start: StartValue) -> None:
        """Whether a start value of a run leaves the sizes as they are, which the whole simulation is laid out for.

        Raises
        ------
        SetupError
            It would change one.
        """
        variable = start.elements[0].variable
        if not start.is_structural or not is_size(variable, self._ports[start.component].description):
            return
        own = self._resolved.components[start.component].start
        size = int(own.get(variable.name, variable.start))
        if start.values[0] != size:
            raise SetupError(
                f"start value of '{start.component}.{variable.name}': sizes of arrays follow it, and it is {size} in "
                f"this system; give {start.values[0]} in System.add (start={{{variable.name!r}: {start.values[0]}}})"
            )

    def _drives(self, signals: Sequence[Signal]) -> tuple[Drive, ...]:
        drives = dict(zip((s.target for s in self._system.signals), self._resolved.drives, strict=True))
        for signal in signals:
            if signal.target not in drives:
                hint = nearest(signal.target, drives)
                raise SetupError(f"signals: no signal of the system feeds '{signal.target}'; {hint}")
            drives[signal.target] = dataclasses.replace(
                drives[signal.target],
                function=signal.function_for(len(drives[signal.target].targets)),
                breakpoints=signal.breakpoints,
                vectorized=signal.vectorized,
            )
        return tuple(drives.values())

    def _samples_of(self, drives: tuple[Drive, ...], grid: Grid) -> Samples:
        """Samples of the run before serve again for the same signals at the same points."""
        for drive in drives:
            _, failure = sample(drive, np.array([grid.start_time]), texts=self._texts)
            if failure is not None:
                raise SetupError(f"{failure} (at t = {grid.start_time!r} s)")
        if self._samples is not None:
            known, samples = self._samples
            if known == (drives, grid) and samples.first == 0 and samples.failure is None:
                return samples
        samples = self._new_samples(drives, grid)
        self._samples = ((drives, grid), samples)
        return samples

    def _new_samples(self, drives: tuple[Drive, ...], grid: Grid, **kept: int) -> Samples:
        ahead = self._iterated.most > 0  # what is exchanged at the end of a step
        ahead = ahead or any((d.component, e.name) in self._extrapolated.moving for d in drives for e in d.targets)
        reach = max(self._steps_of_block, *(c.every for c in self._resolved.components.values()))
        inside = ahead and any(each.degree > 1 for each in self._extrapolated.moving.values())
        return Samples(
            drives,
            grid.start_time,
            grid.step_size,
            grid.last_point,
            reach,
            ahead=ahead or self._steps_of_block > 0,
            inside=inside,
            texts=self._texts,
            **kept,
        )

    def _recorder(self, grid: Grid, record_every: int, sink: Sink | None, marks: Marks) -> Recorder:
        rows, columns = grid.last_point // record_every + 1, len(self._names)
        times = self._times(grid, record_every)
        if sink is None:
            return InMemory(times, rows, columns)
        return PassedOn(times, rows, columns, self._slot_sink(sink, marks))

    def _slot_sink(self, sink: Sink, marks: Marks) -> Sink:
        """Takes what the loop records, marks what is not finite, and gives a sink its values."""

        def pass_on(times: np.ndarray, slots: np.ndarray) -> None:
            marks.look(times, slots)
            sink(times, self._columns.values(slots))

        return pass_on

    @staticmethod
    def _times(grid: Grid, record_every: int) -> Callable[[int, int], np.ndarray]:
        """Times (n,) of the rows first ... end - 1."""

        def times(first: int, end: int) -> np.ndarray:
            return grid.start_time + np.arange(first, end) * record_every * grid.step_size

        return times

    def _parameters(self, time: float) -> dict[str, float]:
        """Values of all real parameters, as the FMUs report them."""
        values: dict[str, float] = {}
        for component, port in self._ports.items():
            names = (n for n in port.names_of("parameter") if port.variables[n].type in ("Real", "Float64"))
            elements = [e for n in names for e in port.elements_of(n) if len(port.elements_of(n)) <= LARGE]
            if elements:
                buffer = np.zeros(len(elements))
                instance = self._components.instances[component]
                with Failing(component, time, instance):
                    VariableBuffer(instance, variables_of(elements), buffer).get()
                values.update({f"{component}.{e.name}": v for e, v in zip(elements, buffer.tolist(), strict=True)})
        return values


def simulate(
    system: System,
    stop_time: float,
    step_size: float | str,
    *,
    start_time: float = 0.0,
    order: str = "sequential",
    extrapolation: str = AUTO,
    record: Sequence[str] | None = None,
    strict_inputs: bool = False,
    tolerance: float | None = None,
    record_every: int = 1,
    sink: Sink | None = None,
    realtime: float | None = None,
    progress: Callable[[float], None] | None = None,
    build: bool = False,
    checkpoint: Checkpoint | None = None,
    log: Log | str | None = None,
    threads: Threads = 1,
    profile: bool = False,
    nonfinite: NonFinite = "mark",
    observe: Sink | None = None,
    steering: Steering | None = None,
    coupling_tolerance: float | None = None,
    interface: str = AUTO_INTERFACE,
    solver: str = AUTO,
    solver_step: float | None = None,
    isolate: bool | Sequence[str] = False,
    limits: Limits | None = None,
    iterations: int | str | None = None,
    scheduler: str | None = None,
) -> Results:
    """Couple the FMUs of a system at a fixed communication step, or at variable ones.

    Set up, run once, clean up; parameters, results and errors are those of `Simulation` and `Simulation.run`.
    """
    with Simulation(
        system,
        order=order,
        extrapolation=extrapolation,
        record=record,
        strict_inputs=strict_inputs,
        build=build,
        log=log,
        threads=threads,
        profile=profile,
        interface=interface,
        solver=solver,
        solver_step=solver_step,
        isolate=isolate,
        limits=limits,
        iterations=iterations,
        scheduler=scheduler,
    ) as simulation:
        return simulation.run(
            stop_time,
            step_size,
            start_time=start_time,
            tolerance=tolerance,
            record_every=record_every,
            sink=sink,
            realtime=realtime,
            progress=progress,
            checkpoint=checkpoint,
            nonfinite=nonfinite,
            observe=observe,
            steering=steering,
            coupling_tolerance=coupling_tolerance,
        )


def _fingerprints(drives: Sequence[Drive], grid: Grid, last_point: int) -> dict[str, str]:
    """Target -> hash of the values of its signal at communication points up to the last one, not at all of them."""
    found: dict[str, str] = {}
    for drive in drives:
        n = _FINGERPRINTED if drive.vectorized else _FINGERPRINTED // 100
        points = np.unique(np.linspace(0, last_point, n).astype(np.int64))
        texts, times = Texts(), grid.start_time + points * grid.step_size
        slots = np.empty((0, len(drive.targets)))
        while len(slots) < len(times):  # a slow signal comes bit by bit
            block, failure = sample(drive, times[len(slots) :], texts=texts)
            slots = np.vstack([slots, block])
            if failure is not None:
                break
        name = f"{drive.component}.{drive.targets[0].name}"
        found[name] = hashlib.sha256(f"{found.get(name)} {texts.values!r}".encode() + slots.tobytes()).hexdigest()
    return found


@contextmanager
def _timed(results: Results, began: float) -> Iterator[None]:
    try:
        yield
    finally:
        results.info["wall_time_s"] = clock.perf_counter() - began


def _number(text: Any, offset: int = 0) -> float | None:
    """A finite number that a description has, at a place in a list; None where it has none."""
    parts = str("" if text is None else text).split()
    try:
        number = float(parts[min(offset, len(parts) - 1)])
    except (IndexError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _loaded(system: System, interface: str) -> dict[str, LoadedFMU]:
    """The FMU of each component; a file that several have is read once, unless start values change its description.

    Raises
    ------
    SetupError
        A file is missing, or can't be read.
    """
    found: dict[str, LoadedFMU] = {}
    read: dict[tuple[Path, str], LoadedFMU] = {}
    for name, component in system.components.items():
        if component.fmu is None:
            continue
        key = (component.fmu, component.interface or interface)
        fmu = read.get(key) or load(name, *key)
        if not depends_on_start_values(fmu.description):
            read[key] = fmu
        found[name] = fmu
    return found


def _refuse(options: Mapping[str, object], why: str) -> None:
    """Refuse options of a run that are given; `why` has a place for the name."""
    for name, value in options.items():
        if value is not None:
            raise SetupError(f"{why.format(name)}; leave out one of them")


def _checked_record_every(record_every: object) -> int:
    steps = positive_whole(record_every)
    if steps is None:
        raise SetupError(f"record_every = {record_every!r} must be a positive whole number of steps")
    if steps >= _MOST_STEPS:
        raise SetupError(f"record_every must be below {_MOST_STEPS:g} steps; no run has so many")
    return steps


def number_of_steps(start_time: float, stop_time: float, step_size: float) -> int:
    """Number of steps (s) from start to stop time (s).

    Raises
    ------
    SetupError
        The times make no sense, or the duration is not a whole number of steps.
    """
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


def _said(starts: Sequence[StartValue]) -> dict[str, Any]:
    """Start values as JSON can have them: items of enumerations by their names, binary values by digits of base 16."""
    found: dict[str, Any] = {}
    for start in starts:
        for element, value in zip(start.elements if len(start.elements) <= LARGE else (), start.values, strict=False):
            names = {number: name for name, number in element.items.items()}
            said = value.hex() if isinstance(value, bytes) else names.get(value, value) if names else value
            found[f"{start.component}.{element.name}"] = said
    return found


def _large(ports: Mapping[str, Ports]) -> list[str]:
    """Inputs and outputs that are recorded only where a user names them or elements of them."""
    return [
        f"{component}.{name}"
        for component, port in ports.items()
        for causality in ("input", "output")
        for name in port.names_of(causality)
        if len(port.elements_of(name)) > LARGE
    ]


def _recorded(record: Sequence[str] | None, ports: Mapping[str, Ports]) -> list[tuple[str, Element]]:
    if record is None:
        return [
            (component, element)
            for component, port in ports.items()
            for causality in ("input", "output")
            for name in port.names_of(causality)
            for element in (port.elements_of(name) if len(port.elements_of(name)) <= LARGE else ())
            if element.is_exchanged
        ]
    if isinstance(record, str):
        raise SetupError(f"record = {record!r} must be a list of names: [{record!r}]")
    chosen: dict[tuple[str, str], tuple[str, Element]] = {}
    for path in record:
        port, name = split(path, ports)
        for element in port.find(name):
            if not element.is_exchanged:
                raise SetupError(f"'{path}' is of type {element.variable.type} and can't be recorded")
            chosen[port.component, element.name] = (port.component, element)
    return list(chosen.values())
