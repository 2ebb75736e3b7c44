"""Run one FMU alone, under the inputs of a case, by either of its interfaces."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cosim.coupling import Coupling
from cosim.errors import CosimError
from cosim.load import LoadedFMU, read_fmu
from cosim.ports import KINDS, Element, Ports
from cosim.regression.case import Between, Case, CaseError
from cosim.regression.experiment import Experiment, experiment_of
from cosim.regression.tolerances import Interface, vector_of
from cosim.results import Results
from cosim.simulation import Simulation
from cosim.system import System

_COMPONENT = "fmu"


class RunError(CosimError):
    """An FMU could not be run to its end."""


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
        raise RunError(f"{fmu.path}: has neither a co-simulation nor a model exchange interface")
    return found


def run(case: Case, path: Path, interface: Interface) -> Results:
    """Results of an FMU under the inputs of a case: the signals of its reference, as far as the FMU has them.

    All outputs where the case has no reference yet. `info["units"]` has their units.

    Raises
    ------
    CosimError
        The case or the FMU can't be read, they don't fit each other, or the FMU fails.
    """
    fmu = read_fmu(path, f"case '{case.name}': {path}")
    if interface not in interfaces_of(fmu):
        raise RunError(f"{path}: has no {interface.replace('_', ' ')} interface")
    ports = Ports(_COMPONENT, fmu.description)
    known = {element.name: element for element in ports.all_elements() if element.kind in KINDS.values()}
    if case.reference_path.is_file():
        wanted = [known[name] for name in case.reference().names if name in known]
    else:
        wanted = [known[e.name] for e in ports.of_causality("output") if e.name in known]
    if not wanted:
        raise CaseError(f"case '{case.name}': {path} has none of the signals of the reference")
    experiment = experiment_of(case, fmu.description)
    runner = _co_simulation if interface == "co_simulation" else _model_exchange
    time, values = runner(case, case.between, fmu, ports, experiment, wanted)
    units = {e.name: unit.name if (unit := ports.unit(e)) is not None else _bare_unit(e) for e in wanted}
    return Results(time, [e.name for e in wanted], values, {"units": units})


def _bare_unit(element: Element) -> str:
    """The unit that a variable names without defining it; often so in FMUs of other tools."""
    declared = element.variable.declaredType
    return element.variable.unit or (declared.unit if declared is not None else None) or ""


def input_function(time: np.ndarray, values: np.ndarray, between: Between) -> Callable[[np.ndarray], np.ndarray]:
    """Values of an input over time; where rows have the same time it jumps, and has the value after the jump there."""
    slack = 1e-9 * max(float(np.ptp(time)), 1e-300)  # for rounding of the communication points

    def held(t: np.ndarray) -> np.ndarray:
        return values[np.maximum(np.searchsorted(time, t + slack, side="right") - 1, 0)]

    def linear(t: np.ndarray) -> np.ndarray:
        left = np.clip(np.searchsorted(time, t, side="right") - 1, 0, len(time) - 1)
        right = np.minimum(left + 1, len(time) - 1)
        span = time[right] - time[left]
        share = np.divide(t - time[left], span, out=np.zeros_like(t), where=span > 0.0)
        return values[left] + np.clip(share, 0.0, 1.0) * (values[right] - values[left])

    return held if between == "hold" else linear


def _co_simulation(
    case: Case, between: Between, fmu: LoadedFMU, ports: Ports, experiment: Experiment, wanted: list[Element]
) -> tuple[np.ndarray, np.ndarray]:
    inputs = case.inputs() or Results(np.zeros(1), [], np.zeros((1, 0)))
    system = System()
    system.add(_COMPONENT, fmu.path, start=_held_inputs(ports, {*inputs.names, *case.start}) | dict(case.start))
    for i, name in enumerate(inputs.names):
        (element,) = _inputs(ports, [name], case)
        time = inputs.time
        jumps = np.unique(time[1:][np.diff(time) == 0.0])
        function = input_function(time, inputs.values[:, i], between if element.kind == "real" else "hold")
        system.drive(f"{_COMPONENT}.{name}", function, breakpoints=jumps.tolist(), vectorized=True)
    record = [f"{_COMPONENT}.{element.name}" for element in wanted]
    coupling: Coupling = "auto" if between == "linear" else "hold"
    with Simulation(system, coupling=coupling, record=record) as simulation:
        results = simulation.run(
            experiment.stop_time,
            experiment.step_size,
            start_time=experiment.start_time,
            record_every=experiment.every,
        )
    return results.time, results.values


def _model_exchange(
    case: Case, between: Between, fmu: LoadedFMU, ports: Ports, experiment: Experiment, wanted: list[Element]
) -> tuple[np.ndarray, np.ndarray]:
    from fmpy import simulate_fmu

    signals = _structured_inputs(case, between, ports)
    start = _start_values(case, ports)
    said: list[str] = []

    def keep(_environment: Any, _name: Any, status: int, _category: Any, message: bytes) -> None:
        if status:  # fmi2OK is 0
            said.append(message.decode(errors="replace"))

    logger = {"logger": keep} if fmu.description.fmiMajorVersion == 2 else {}
    with TemporaryDirectory(prefix="cosim_", ignore_cleanup_errors=True) as folder:
        fmu.unpack(Path(folder))
        try:
            table = simulate_fmu(
                folder,
                validate=False,
                fmi_type="ModelExchange",
                solver="CVode",
                start_time=experiment.start_time,
                stop_time=experiment.stop_time,
                relative_tolerance=experiment.solver_tolerance,
                output_interval=experiment.interval,
                record_events=False,
                start_values=start,
                input=signals,
                output=[element.variable.name for element in wanted],
                model_description=fmu.description,
                **logger,
            )
        except Exception as error:  # fmpy raises bare exceptions here
            why = " ".join(" ".join([str(error), *said[-1:]]).split())
            raise RunError(f"{fmu.path}: model exchange with CVode failed: {why}") from error
    columns = [np.asarray(table[e.variable.name], dtype=float).reshape(len(table), -1)[:, e.offset] for e in wanted]
    return _on_grid(table["time"], experiment), np.column_stack(columns)


def _on_grid(time: np.ndarray, experiment: Experiment) -> np.ndarray:
    """Times (s) of rows without the solver's rounding."""
    grid = experiment.start_time + np.arange(len(time)) * experiment.interval
    return np.where(np.isclose(time, grid, rtol=1e-9, atol=1e-9 * experiment.interval), grid, time)


def _held_inputs(ports: Ports, given: set[str]) -> dict[str, float | str]:
    """Start values of the inputs that a case says nothing of, as the model description has them."""
    held: dict[str, float | str] = {}
    for element in ports.of_causality("input"):
        start = str(element.variable.start or "")
        if given & {element.name, vector_of(element.name)}:
            continue
        if element.kind == "String":
            held[element.name] = start
        elif start and element.kind in KINDS.values():
            texts = start.split()  # of an array: one an element, or one for all
            text = texts[min(element.offset, len(texts) - 1)]
            held[element.name] = float({"true": "1", "false": "0"}.get(text, text))
    return held


def _inputs(ports: Ports, names: list[str], case: Case) -> list[Element]:
    """Elements of inputs by name."""
    elements = []
    for name in names:
        found = ports.find(name)
        if len(found) != 1 or found[0].variable.causality != "input":
            raise CaseError(f"{case.inputs_path}: '{name}' is no input of the FMU, or not one element of it")
        elements += found
    return elements


def _structured_inputs(case: Case, between: Between, ports: Ports) -> np.ndarray | None:
    """Inputs in fmpy's form: one field a variable; a held input has two rows where it changes."""
    inputs = case.inputs()
    if inputs is None or not inputs.names:
        return None
    elements = _inputs(ports, inputs.names, case)
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
        elements = ports.find(name)
        if elements[0].variable.shape:
            start[elements[0].variable.name] = np.ravel(value).tolist()
            continue
        values = value if isinstance(value, list) else [value] * len(elements)
        if len(values) != len(elements):
            raise CaseError(f"{case.tolerances_path}: start: '{name}' has {len(elements)} elements, not {len(values)}")
        start |= {element.name: one for element, one in zip(elements, values, strict=True)}
    return start
