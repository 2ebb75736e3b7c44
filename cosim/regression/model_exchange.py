"""Model exchange: FMPy's solvers, CVode or Euler's explicit method, run one FMU alone."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.errors import SetupError
from cosim.fmi.fmu_file import LoadedFMU
from cosim.fmi.isolation.library import IsolatedLibrary
from cosim.fmi.isolation.limits import Limits
from cosim.fmi.message_log import Log, LogWriter
from cosim.fmi.messages import Messages
from cosim.fmi.model_exchange import model_exchange_instance
from cosim.fmi.shared_library import Library, Loader
from cosim.fmi.unpacking import folder_for_fmus
from cosim.loop.current_calls import watched_calls
from cosim.regression.case import Between, Case, CaseError, Method, RunError
from cosim.regression.experiment import Experiment
from cosim.regression.inputs import input_elements
from cosim.system.resolution import resolve_start_value
from cosim.system.variables import Element, Ports

if TYPE_CHECKING:
    from cosim.regression.run import RunOptions


def model_exchange(
    case: Case,
    between: Between,
    fmu: LoadedFMU,
    ports: Ports,
    experiment: Experiment,
    wanted: list[Element],
    method: Method,
    options: RunOptions,
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) in s and values (n, len(wanted)) under the inputs of a case.

    Raises
    ------
    CosimError
        The inputs or start values don't fit the FMU, or the run fails.
    """
    from fmpy import simulate_fmu

    signals = _structured_inputs(case, between, ports)
    start = _start_values(case, ports)
    messages = Messages(fmu.path.stem, None if options.log is None else LogWriter(Log(options.log)))
    load: Loader = Library.of
    if options.isolate:
        load = partial(IsolatedLibrary.starting, messages=messages, limits=options.limits or Limits())
    with watched_calls(), folder_for_fmus() as folder:
        fmu.unpack(Path(folder), build=options.build)
        steps = _euler_steps(case, fmu, experiment.interval) if method == "Euler" else 1
        outputs = [element.variable.name for element in wanted]
        try:
            with model_exchange_instance(Path(folder), fmu.description, messages, load) as instance:
                last = _keep_last_row(instance, fmu, outputs)
                table = simulate_fmu(
                    folder,
                    validate=False,
                    fmi_type="ModelExchange",
                    solver=method,
                    start_time=experiment.start_time,
                    stop_time=experiment.stop_time,
                    relative_tolerance=experiment.solver_tolerance,
                    output_interval=experiment.interval / steps,
                    step_size=experiment.interval / steps,
                    timeout=None if math.isinf(options.timeout) else options.timeout,
                    record_events=False,
                    start_values=start,
                    input=signals,
                    output=outputs,
                    model_description=fmu.description,
                    fmu_instance=instance,
                )
        except Exception as error:  # fmpy raises bare exceptions here
            why = " ".join(f"{error} {messages.last()}".split())
            raise RunError(f"{fmu.path}: model exchange with {method} failed: {why}") from error
    table = table[::steps]  # fmpy's Euler does one step a row
    if len(last) and last["time"][-1] > table["time"][-1] + 1e-9 * experiment.interval:  # the FMU has ended the run
        table = np.concatenate([table, last])
    columns = [np.asarray(table[e.variable.name], dtype=float).reshape(len(table), -1)[:, e.offset] for e in wanted]
    return _on_grid(table["time"], experiment), np.column_stack(columns)


def _keep_last_row(instance: Any, fmu: LoadedFMU, outputs: list[str]) -> np.ndarray:
    """A table for the row at the end of the run, which fmpy leaves out where the FMU ends it."""
    from fmpy.simulation import Recorder

    recorder = Recorder(fmu=instance, modelDescription=fmu.description, variableNames=outputs)
    table = np.zeros(0, dtype=np.dtype(recorder.cols))
    set_time, terminate = instance.setTime, instance.terminate
    reached = [0.0]

    def keep_time(time: float) -> Any:
        reached[0] = time
        return set_time(time)

    def keep_row() -> Any:
        recorder.sample(reached[0])
        table.resize(1, refcheck=False)
        table[:] = recorder.result()
        return terminate()

    instance.setTime, instance.terminate = keep_time, keep_row
    return table


def _euler_steps(case: Case, fmu: LoadedFMU, interval: float) -> int:
    """Steps of Euler's method from row to row, by the step of the case, of the FMU's own co-simulation, or one."""
    own = getattr(fmu.description.coSimulation, "fixedInternalStepSize", None)
    step = case.solver_step or float(own or 0.0) or interval
    return max(1, math.ceil(interval / step - 1e-6))


def _on_grid(time: np.ndarray, experiment: Experiment) -> np.ndarray:
    """Times (s) of rows without the solver's rounding."""
    grid = experiment.start_time + np.arange(len(time)) * experiment.interval
    return np.where(np.isclose(time, grid, rtol=1e-9, atol=1e-9 * experiment.interval), grid, time)


def _structured_inputs(case: Case, between: Between, ports: Ports) -> np.ndarray | None:
    """Inputs in fmpy's form: one field a variable; a held input has two rows where it changes."""
    inputs = case.inputs()
    if inputs is None or not inputs.names:
        return None
    elements = input_elements(ports, inputs.names, case)
    time, values = inputs.time, inputs.values
    if between == "hold":
        last = np.append(np.diff(time) > 0.0, True)
        time, values = time[last], values[last]
        time, values = np.repeat(time, 2)[1:], np.repeat(values, 2, axis=0)[:-1]
    variables = {e.variable.name: e.variable for e in elements}
    table = np.zeros(len(time), dtype=[("time", float), *((n, float, v.shape or ()) for n, v in variables.items())])
    table["time"] = time
    for name, variable in variables.items():
        mine = {e.offset: i for i, e in enumerate(elements) if e.variable.name == name}
        size = int(np.prod(variable.shape)) if variable.shape else 1
        if len(mine) != size:
            raise CaseError(f"{case.inputs_path}: has {len(mine)} of the {size} elements of '{name}'; give all")
        table[name] = values[:, [mine[k] for k in range(size)]].reshape(table[name].shape)
    return table


def _start_values(case: Case, ports: Ports) -> dict[str, Any]:
    """Start values in fmpy's form: one a variable."""
    start: dict[str, Any] = {}
    for name, value in case.start.items():
        try:
            given = resolve_start_value(ports, name, value)
        except SetupError as error:
            raise CaseError(f"{case.tolerances_path}: {error}") from error
        if given.elements[0].variable.shape:
            start[given.elements[0].variable.name] = list(given.values)
            continue
        start |= {element.name: one for element, one in zip(given.elements, given.values, strict=True)}
    return start
