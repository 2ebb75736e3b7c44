"""What an FMU brings along to be tried by: an experiment and its results, after FMI's layered standard for references.

The standard (fmi-ls-ref 1.0.0-beta.1, based on FMI 2.0 and 3.0; its text still has the version 1.0.0-alpha.1 in the
manifest) puts a manifest into `extra/org.fmi-standard.fmi-ls-ref`, which says what each file is for. The experiment has
the Modelica Association's format (ma-hs-experiments).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from fmu_export.errors import ArgumentError, DocumentationError
from fmu_export.modelling.functions import rk4_defect, rk4_step
from fmu_export.modelling.internal_steps import InternalSteps, NoRates, TooManySteps
from fmu_export.modelling.model import Model, Solver
from fmu_export.modelling.names import check_text
from fmu_export.modelling.variables import Array, Layout
from fmu_export.package.archive import write_archive
from fmu_export.package.description_common import to_bytes
from fmu_export.package.evaluation import Functions, functions_of
from fmu_export.package.interface import ADAPTIVE_OR_FIXED, Interface, text_of

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"

_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
_SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"

#: A run that nobody has asked for is kept short: communication steps, and integration steps of a fixed length.
_MOST_ROWS, _MOST_STEPS = 50, 100

#: Solvers whose steps are made here.
_BY_EQUATIONS: tuple[Solver, ...] = ("rk4", "rk43")

#: Relative tolerance of an importer's solver that comes as near as the steps of the FMU.
_TOLERANCE = "1e-09"

#: A file of results with more rows would be larger than the FMU.
_MOST_ROWS_ASKED_FOR = 100_000


@dataclass(frozen=True)
class Reference:
    """A run of the FMU alone that it brings along, for whoever wants to know whether it runs as it should.

    Inputs are constant: importers differ in when changing ones take effect.

    Parameters
    ----------
    inputs : mapping, optional
        Input -> value, or values of a vector; the others keep their start values.
    parameters : mapping, optional
        Parameter -> value, or values of a vector; the others keep their start values.
    stop_time, step_size : float, optional
        End of the run and communication step (s); by default the first steps of the default experiment, at most 50.
    name : str, optional
        Of the experiment.
    description : str, optional

    Raises
    ------
    ArgumentError
        The name or the description is no line of printable text.
    """

    inputs: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
    parameters: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
    stop_time: float | None = None
    step_size: float | None = None
    name: str = "reference"
    description: str = "The model alone, with constant inputs"

    def __post_init__(self) -> None:
        for what in ("name", "description"):
            check_text(f"reference: {what}", getattr(self, what))


#: The run that an FMU brings along if nothing is said: from its start values, with the inputs there.
FROM_START_VALUES = Reference(MappingProxyType({}), MappingProxyType({}))


@dataclass(frozen=True, eq=False)
class _Run:
    """Times (rows,) (s) and outputs (rows, n_y) of a run."""

    time: Array
    outputs: Array


def reference_members(
    model: Model,
    interface: Interface,
    reference: Reference | None,
    archive: Mapping[str, bytes] | None,
    unchecked: bool = False,
) -> dict[str, bytes]:
    """Members of an archive for the run that it brings along; the same arguments give the same bytes.

    Parameters
    ----------
    model, interface : Model, Interface
    reference : Reference, optional
        None for `FROM_START_VALUES`, and for no members at all where the model does not run from there.
    archive : mapping, optional
        The members that there are so far, with a library for this machine: they are run for models with events and
        for other solvers than "rk4" and "rk43", whose results are not computed here.
    unchecked : bool, optional
        Whether the traced equations were not compared with what numpy computes.

    Raises
    ------
    DocumentationError
        The run can't be made as described, or its results are not finite.
    """
    asked_for = reference is not None
    reference = FROM_START_VALUES if reference is None else reference
    here = f"{model.name}: reference"
    if texts := [v.name for v in model.inputs.variables if v.type == "string" and v.name in reference.inputs]:
        raise DocumentationError(f"{here}: input '{texts[0]}' is a string, which stimuli don't hold; leave it out")
    try:
        u = _values(f"{here}: input", model.inputs, reference.inputs)
        p = _values(f"{here}: parameter", model.parameters, reference.parameters)
        start, step, rows = _grid(here, model, interface, reference, asked_for=asked_for)
        run = _run(here, model, interface, u, p, (start, step, rows), reference, archive, unchecked)
    except DocumentationError:
        if asked_for:
            raise
        return {}
    return {} if run is None and not asked_for else _members(model, reference, run, (start, start + step * rows, step))


def _values(here: str, layout: Layout, given: Mapping[str, float | Sequence[float]]) -> Array:
    """Start values of a layout, with those that are given in their places."""
    found = layout.starts.copy()
    places = {name: i for i, name in enumerate(layout.names)}
    for name, value in given.items():
        variable = next((v for v in layout.variables if v.name == name), None)
        if variable is None:
            known = ", ".join(v.name for v in layout.variables) or "none"
            raise DocumentationError(f"{here} '{name}': the model has no such one; it has {known}")
        if variable.type != "real":
            try:
                for element, number in zip(variable.names, replace(variable, start=value).starts, strict=True):
                    found[places[element]] = number
            except ArgumentError as error:
                raise DocumentationError(f"{here} '{name}': {error}") from None
            continue
        numbers = (
            np.broadcast_to(np.asarray(value, dtype=float), (len(variable.names),)) if _fits(value, variable) else None
        )
        if numbers is None or not np.isfinite(numbers).all():
            raise DocumentationError(f"{here} '{name}' is {value!r}; give {len(variable.names)} finite numbers")
        for element, number in zip(variable.names, numbers.tolist(), strict=True):
            found[places[element]] = number
    return np.asarray(found, dtype=float)


def _fits(value: Any, variable: Any) -> bool:
    return np.shape(value) in ((), (len(variable.names),))


def _grid(
    here: str, model: Model, interface: Interface, reference: Reference, *, asked_for: bool
) -> tuple[float, float, int]:
    """Start time, communication step (s) and number of steps."""
    experiment = model.default_experiment
    start, step = experiment.start_time, reference.step_size or experiment.step_size
    if not (math.isfinite(step) and step > 0.0):
        raise DocumentationError(f"{here}: step_size is {step!r}; it must be positive")
    stop = experiment.stop_time if reference.stop_time is None else reference.stop_time
    rows = round((stop - start) / step) if math.isfinite(stop) else 0
    if rows < 1:
        raise DocumentationError(f"{here}: stop_time is {stop!r}; the run must have at least one step of {step!r} s")
    if reference.stop_time is None:
        internal = _internal_steps(model, interface, step)
        rows = min(rows, _MOST_ROWS, max(1, _MOST_STEPS // internal))
        if internal > _MOST_STEPS and not asked_for:
            raise DocumentationError(f"{here}: a communication step has {internal} internal ones")
    elif rows > _MOST_ROWS_ASKED_FOR:
        raise DocumentationError(f"{here}: {rows} steps are too many; end earlier or take longer steps")
    return start, step, rows


def _internal_steps(model: Model, interface: Interface, step: float) -> int:
    """Number of steps of the Runge-Kutta method in a communication step, as the FMU has it."""
    longest = next((v.start for v in interface.variables if v.name == "max_step"), None)
    if longest is None or model.solver not in _BY_EQUATIONS:
        return 1
    return max(1, math.ceil(step / longest - 1e-6))


def _run(
    here: str,
    model: Model,
    interface: Interface,
    u: Array,
    p: Array,
    grid: tuple[float, float, int],
    reference: Reference,
    archive: Mapping[str, bytes] | None,
    unchecked: bool,
) -> _Run | None:
    """The run; None where it can't be made here."""
    if model.is_continuous and model.solver in _BY_EQUATIONS:
        internal = _internal_steps(model, interface, grid[1])
        run = _by_equations(model, tuple(u.tolist()), tuple(p.tolist()), grid, internal, interface.nominals, unchecked)
    elif archive is None:
        return None
    else:
        run = _by_fmu(here, model, interface, reference, (u, p), grid, archive)
    if not np.isfinite(run.outputs).all():
        raise DocumentationError(f"{here}: the results are not finite; choose other inputs or an earlier end")
    return run


@lru_cache(64)  # the same for all flavours
def _by_equations(
    model: Model,
    u: tuple[float, ...],
    p: tuple[float, ...],
    grid: tuple[float, float, int],
    internal: int,
    nominals: tuple[float, ...],
    unchecked: bool,
) -> _Run:
    """The run without the FMU, with the steps that the FMU makes."""
    start, step, rows = grid
    inputs, parameters = np.array(u), np.array(p)
    functions = functions_of(model, unchecked=unchecked)

    def holds(time: float, x: Array, at: str) -> None:
        for requirement in model.requirements:
            if requirement.at == at and not requirement.margin(time, x, inputs, parameters) > 0.0:
                raise DocumentationError(f"{model.name}: reference: t = {time:.9g} s: {requirement.message}")

    with_estimate = _steps_with_estimate(model, functions, inputs, parameters, step, nominals)
    with np.errstate(all="ignore"):
        holds(start, np.empty(0), "start")
        x = functions.initial_state(parameters)
        times, outputs = [start], [functions.outputs(start, x, inputs, parameters)]
        h = step / internal
        for row in range(1, rows + 1):
            if model.solver == "rk43":
                holds(times[-1], x, "step")
                x = with_estimate(times[-1], x)
            for i in range(internal if model.states and model.solver == "rk4" else 0):
                time = times[-1] + i * h
                holds(time, x, "step")
                x = rk4_step(functions.derivatives, time, x, inputs, parameters, h)
            times.append(start + row * step)
            outputs.append(functions.outputs(times[-1], x, inputs, parameters))
    return _Run(np.array(times), np.array(outputs, dtype=float).reshape(rows + 1, len(model.outputs)))


def _steps_with_estimate(
    model: Model, functions: Functions, u: Array, p: Array, step: float, nominals: tuple[float, ...]
) -> Callable[[float, Array], Array]:
    """A function (t, x) -> states a communication step later, in the internal steps of rk43."""
    steps = InternalSteps()
    rtol, max_step = (v.start for v in ADAPTIVE_OR_FIXED)

    def stepped(t: float, x: list[float], h: float) -> list[float]:
        stages: list[Array] = []

        def derivatives(*arguments: Any) -> Array:
            stages.append(functions.derivatives(*arguments))
            return stages[-1]

        end = rk4_step(derivatives, t, np.array(x), u, p, h)
        found: list[float] = np.concatenate([end, *stages]).tolist()
        return found

    def checked(t: float, x: Array, u: Array, p: Array) -> Array:
        if not all(r.margin(t, x, u, p) > 0.0 for r in model.requirements if r.at == "step"):
            raise NoRates
        return functions.derivatives(t, x, u, p)

    def defect(t: float, x: list[float], h: float, stages: list[float]) -> list[float]:
        found: list[float] = rk4_defect(checked, t, np.array(x), u, p, h, [*np.reshape(stages, (4, -1))]).tolist()
        return found

    def advanced(t: float, x: Array) -> Array:
        try:
            return np.array(steps.advance(stepped, defect, x.tolist(), (t, step), (rtol, max_step), nominals))
        except TooManySteps as error:
            raise DocumentationError(f"{model.name}: reference: {error}") from None

    return advanced


def _by_fmu(
    here: str,
    model: Model,
    interface: Interface,
    reference: Reference,
    values_of: tuple[Array, Array],
    grid: tuple[float, float, int],
    archive: Mapping[str, bytes],
) -> _Run:
    """The run by the FMU itself."""
    from fmpy import simulate_fmu  # takes a while to import

    start, step, rows = grid
    starts: dict[str, Any] = {}
    layouts, given_of = (model.inputs, model.parameters), (reference.inputs, reference.parameters)
    for layout, values, given in zip(layouts, values_of, given_of, strict=True):
        for v in (v for v in layout.variables if v.name in given and v.type != "string"):
            first = layout.names.index(v.names[0])
            own = values[first : first + v.n_elements]
            if interface.arrays:
                starts[v.name] = own.reshape(v.shape)
            else:
                starts |= dict(zip(v.names, own.tolist(), strict=True))
    shown = [v for v in model.outputs.variables if v.type != "string"]
    with TemporaryDirectory(prefix="reference-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / f"{model.name}.fmu"
        write_archive(path, dict(archive))
        said: list[str] = []
        try:
            found = simulate_fmu(
                str(path),
                validate=False,
                fmi_type="CoSimulation",
                start_time=start,
                stop_time=start + rows * step,
                output_interval=step,
                start_values=starts,
                output=[v.name for v in shown] if interface.arrays else [name for v in shown for name in v.names],
                logger=_keeping(said),
            )
        except Exception as error:  # FMPy raises bare exceptions
            raise DocumentationError(f"{here}: {said[-1] if said else error}") from error
    rows_found = len(found)
    columns = [
        np.asarray(found[name], dtype=float).reshape(rows_found, -1)
        if v.type != "string"
        else np.zeros((rows_found, v.n_elements))  # which FMPy does not record
        for v in model.outputs.variables
        for name in ((v.name,) if interface.arrays or v.type == "string" else v.names)
    ]
    return _Run(np.asarray(found["time"]), np.column_stack([np.empty((len(found), 0)), *columns]))


def _keeping(said: list[str]) -> Callable[..., None]:
    """A logger for FMPy, of both versions of FMI, that keeps messages."""

    def keep(*arguments: Any) -> None:
        said.append(arguments[-1].decode("utf-8", "replace"))

    return keep


# Files


def _members(
    model: Model, reference: Reference, run: _Run | None, times: tuple[float, float, float]
) -> dict[str, bytes]:
    files: dict[str, bytes] = {}
    start, stop, step = times
    experiments = ET.Element("Experiments", name=f"Smoke tests of {model.name}")
    experiment = ET.SubElement(experiments, "Experiment", name=reference.name, description=reference.description)
    if model.states and model.is_continuous and model.solver in _BY_EQUATIONS:  # for importers' solvers
        experiment.set("tolerance", _TOLERANCE)
    ET.SubElement(experiment, "TransientSimulation", startTime=repr(start), stopTime=repr(stop), stepSize=repr(step))
    related = [("application/x-ma-hs-experiments", "experiments.exp", "experiment/smoke-test", reference.description)]
    if reference.parameters:
        files["parameters.ssv"] = _parameter_set(model.parameters, reference.parameters)
        ET.SubElement(experiment, "Parameters", source="parameters.ssv")
        related.append(
            ("application/x-ssp-parameter-set", "parameters.ssv", "parameter", "Parameters of the experiment")
        )
    if reference.inputs:
        names = [n for v in model.inputs.variables if v.name in reference.inputs for n in v.names]
        values = _values("", model.inputs, reference.inputs)
        row = [values[model.inputs.names.index(name)] for name in names]
        files["inputs.csv"] = _csv(names, np.array([start, stop]), np.array([row, row]))
        ET.SubElement(experiment, "Stimuli", source="inputs.csv")
    if run is not None:
        # importers don't record strings as results
        shown = [v.type != "string" for v in model.outputs.variables for _ in v.names]
        names = [name for name, is_shown in zip(model.outputs.names, shown, strict=True) if is_shown]
        files["results.csv"] = _csv(names, run.time, run.outputs[:, np.array(shown, dtype=bool)])
        ET.SubElement(experiment, "References", source="results.csv")
        related.append(("text/csv", "results.csv", "result", "Results of the experiment"))
    files["experiments.exp"] = to_bytes(experiments)
    files["fmi-ls-manifest.xml"] = _manifest(related)
    return {
        **{f"{FOLDER}/{name}": content for name, content in files.items()},
        "documentation/fmi-ls-ref.txt": _notes(reference, run is not None).encode(),
    }


def _csv(names: Sequence[str], time: Array, values: Array) -> bytes:
    """A line of quoted names, then a line a row, with 12 digits: beyond them platforms differ."""
    header = ",".join(f'"{name}"' for name in ("time", *names))
    rows = (",".join(f"{value:.12g}" for value in (t, *row)) for t, row in zip(time, values.tolist(), strict=True))
    return ("\n".join([header, *rows]) + "\n").encode()


def _parameter_set(layout: Layout, given: Mapping[str, float | Sequence[float]]) -> bytes:
    """An SSV (SSP 1.0) with the given values of parameters."""
    ET.register_namespace("ssv", _SSV)
    root = ET.Element(f"{{{_SSV}}}ParameterSet", {"version": "1.0", "name": "parameters"})
    parameters = ET.SubElement(root, f"{{{_SSV}}}Parameters")
    values = _values("", layout, given)
    for variable in layout.variables:
        for name in variable.names if variable.name in given else ():
            parameter = ET.SubElement(parameters, f"{{{_SSV}}}Parameter", name=name)
            value = float(values[layout.names.index(name)])
            text = text_of(variable.type, value, variable.items)
            if variable.type == "enumeration":  # by its name
                text = next(item for item, number in variable.items if number == value)
            ET.SubElement(parameter, f"{{{_SSV}}}{variable.type.capitalize()}", value=text)
    return to_bytes(root)


def _manifest(related: Sequence[tuple[str, str, str, str]]) -> bytes:
    ET.register_namespace("fmi-ls", _NAMESPACE)
    root = ET.Element(
        "fmiReferences",
        {
            f"{{{_NAMESPACE}}}fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
            f"{{{_NAMESPACE}}}fmi-ls-version": "1.0.0-beta.1",
            f"{{{_NAMESPACE}}}fmi-ls-description": (
                "Layered Standard providing information on related files included in an FMU."
            ),
        },
    )
    for kind, source, role, description in related:
        ET.SubElement(root, "Related", type=kind, source=source, role=role, description=description)
    return to_bytes(root)


def _notes(reference: Reference, has_results: bool) -> str:
    what = (
        "Its outputs are to be those of results.csv, at the communication step of the experiment: to 1e-6 of the range "
        "of a\nsignal in co-simulation, and as near as the importer's solver comes in model exchange."
        if has_results
        else "It has no results: the FMU has to run to its end with finite outputs."
    )
    return (
        f"The experiment '{reference.name}' in {FOLDER}\n(layered standard fmi-ls-ref 1.0.0-beta.1) is a smoke "
        f"test: {reference.description}.\nInputs are constant from the start time on. {what}\n"
    )
