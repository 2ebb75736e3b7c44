"""Run one FMU alone, under the inputs of a case, by either of its interfaces."""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.errors import nearest
from cosim.fmi.fmu_file import LoadedFMU, read_fmu
from cosim.fmi.isolation.limits import Limits
from cosim.master.simulation import Simulation
from cosim.regression.case import Between, Case, CaseError, Method, RunError
from cosim.regression.experiment import Experiment, experiment_of
from cosim.regression.inputs import input_elements, input_function
from cosim.regression.model_exchange import model_exchange
from cosim.regression.tolerances import Interface
from cosim.results.flat_arrays import with_names_of
from cosim.results.results import Results
from cosim.system.system import System
from cosim.system.variables import Element, Ports

_COMPONENT = "fmu"


class ScheduledOnly(RunError):
    """An FMU can only be run by scheduled execution."""


def interfaces_of(fmu: LoadedFMU) -> list[Interface]:
    """Interfaces that an FMU can be run by.

    Raises
    ------
    RunError
        It has none of them.
    """
    found: list[Interface] = []
    if fmu.description.coSimulation is not None:
        found.append("co_simulation")
    if fmu.description.modelExchange is not None:
        found.append("model_exchange")
    if not found:
        if getattr(fmu.description, "scheduledExecution", None) is not None:
            raise ScheduledOnly(f"{fmu.path}: has scheduled execution only, which is not run; export co-simulation too")
        raise RunError(f"{fmu.path}: has neither a co-simulation nor a model exchange interface")
    return found


@dataclass(frozen=True)
class RunOptions:
    """Options of a run that the results do not depend on.

    Attributes
    ----------
    build : bool
        Compile the C sources of an FMU that has no binary for this machine.
    log : str, optional
        Level of the messages of the FMU that go to Python's logger `cosim.messages`; see `cosim.Log`.
    isolate : bool
        The FMU lives in a process of its own.
    limits : Limits, optional
        Limits of the isolated FMU.
    timeout : float
        Longest time (s) that the run may take.
    """

    build: bool = False
    log: str | None = None
    isolate: bool = False
    limits: Limits | None = None
    timeout: float = math.inf


def run(
    case: Case,
    path: Path,
    interface: Interface,
    method: Method = "CVode",
    options: RunOptions = RunOptions(),
) -> Results:
    """Results of an FMU under the inputs of a case: the signals of its reference, as far as the FMU has them.

    All outputs where the case has no reference. `info["units"]` has their units. `method` integrates in model exchange,
    which has no texts.

    Raises
    ------
    CosimError
        The case or the FMU can't be read, they don't fit each other, or the FMU fails.
    """
    fmu = read_fmu(path, f"case '{case.name}': {path}")
    if interface not in interfaces_of(fmu):
        raise RunError(f"{path}: has no {interface.replace('_', ' ')} interface")
    fmu.check_binary(build=options.build)
    ports = Ports(_COMPONENT, fmu.description, case.start)
    known = {
        element.name: element
        for element in ports.all_elements()
        if element.is_exchanged and not (element.type.is_text and interface == "model_exchange")
    }
    if case.reference_path.is_file():
        reference = with_names_of(case.reference(), known)
        wanted = [known[name] for name in reference.names if name in known]
    else:
        wanted = [known[e.name] for e in ports.of_causality("output") if e.name in known and not e.type.is_text]
    if not wanted:
        names = case.reference().names if case.reference_path.is_file() else []
        hint = f", such as '{names[0]}'; {nearest(names[0], known)}" if names else ""
        raise CaseError(f"case '{case.name}': {path} has none of the signals to compare{hint}")
    experiment = experiment_of(case, fmu.description)
    if interface == "co_simulation":
        results = _co_simulation(case, case.between, fmu, ports, experiment, wanted, options)
    else:
        time, values = model_exchange(case, case.between, fmu, ports, experiment, wanted, method, options)
        results = Results(time, [], values)
    units = {e.name: unit.name if (unit := ports.unit(e)) is not None else _bare_unit(e) for e in wanted}
    typed = {e.name: results.typed[n] for e in wanted if (n := f"{_COMPONENT}.{e.name}") in results.typed}
    return Results(results.time, [e.name for e in wanted], results.values, {"units": units}, typed)


def _bare_unit(element: Element) -> str:
    """The unit that a variable names without defining it; often so in FMUs of other tools."""
    declared = element.variable.declaredType
    return element.variable.unit or (declared.unit if declared is not None else None) or ""


def _co_simulation(
    case: Case,
    between: Between,
    fmu: LoadedFMU,
    ports: Ports,
    experiment: Experiment,
    wanted: list[Element],
    options: RunOptions,
) -> Results:
    began = clock.monotonic()

    def check_time(_: float) -> None:
        if clock.monotonic() - began > options.timeout:
            raise RunError(f"{fmu.path}: did not end within {options.timeout:g} s; allow more with --fmu-timeout")

    inputs = case.inputs() or Results(np.zeros(1), [], np.zeros((1, 0)))
    inputs = with_names_of(inputs, [element.name for element in ports.of_causality("input")])
    system = System()
    system.add(_COMPONENT, fmu.path, start=case.start)
    for i, name in enumerate(inputs.names):
        (element,) = input_elements(ports, [name], case)
        time = inputs.time
        jumps = np.unique(time[1:][np.diff(time) == 0.0])
        function = input_function(time, inputs.values[:, i], between if element.kind == "real" else "hold")
        system.drive(f"{_COMPONENT}.{name}", function, breakpoints=jumps.tolist(), vectorized=True)
    record = [f"{_COMPONENT}.{element.name}" for element in wanted]
    extrapolation = "auto" if between == "linear" else "hold"
    with Simulation(
        system,
        extrapolation=extrapolation,
        record=record,
        build=options.build,
        log=options.log,
        isolate=options.isolate,
        limits=options.limits,
    ) as simulation:
        return simulation.run(
            experiment.stop_time,
            experiment.step_size,
            start_time=experiment.start_time,
            record_every=experiment.every,
            tolerance=experiment.tolerance,
            progress=check_time,
        )
