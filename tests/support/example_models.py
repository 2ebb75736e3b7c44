"""The models of examples/models: built once a session, and run by several importers."""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import fmpy
import numpy as np

from cosim import System, simulate
from fmu_export import ModelClass, build_native
from tests.support.bare_host import fresh

FOLDER = Path(__file__).parents[2] / "examples" / "models"

#: Values at times (n,): name of a variable -> (n,), or (n, ...) of an array.
Values = dict[str, np.ndarray]


@dataclass(frozen=True)
class Example:
    """An experiment with a model, and its solution by other means.

    `tolerance` and `tolerance_me` bound the differences of values in co-simulation and in model exchange, relative to
    the largest value of a variable. `inputs` are functions of time that change at communication points only. Model
    exchange ends at `stop_me`, if there is one, and asks for values `rows_me` times in a step.
    """

    module: str
    stop: float
    step: float
    solution: Callable[[np.ndarray], Values]
    tolerance: float
    tolerance_me: float
    start: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, Callable[[float], float]] = field(default_factory=dict)
    stop_me: float | None = None
    rows_me: int = 1

    @cached_property
    def expected(self) -> Values:
        """The solution at the communication points."""
        return self.solution(self.times)

    @property
    def times(self) -> np.ndarray:
        """The communication points."""
        return np.arange(round(self.stop / self.step) + 1) * self.step


def load(module: str) -> ModuleType:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(f"example_{module}", FOLDER / f"{module}.py")
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


@cache
def model_of(module: str) -> type[ModelClass]:
    """The class of an example, the same for both flavours."""
    loaded = load(module)
    (found,) = (c for c in vars(loaded).values() if inspect.isclass(c) and c.__module__ == loaded.__name__)
    assert issubclass(found, ModelClass)
    return found


def build(module: str, folder: Path, flavour: str) -> None:
    """Build the FMU of an example as <folder>/<module>.fmu."""
    build_native(model_of(module), folder, flavour).rename(folder / f"{module}.fmu")  # type: ignore[arg-type]


def elements(name: str, shape: tuple[int, ...]) -> list[str]:
    """Names of the scalars of a variable, row by row."""
    return [f"{name}[{','.join(str(i + 1) for i in where)}]" if shape else name for where in np.ndindex(shape)]


def _together(columns: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]]) -> Values:
    """Columns of scalars as variables."""
    return {
        name: np.column_stack([np.asarray(columns[n], dtype=float) for n in elements(name, shape)]).reshape(-1, *shape)
        for name, shape in shapes.items()
    }


def by_fmpy(fmu: Path, example: Example, shapes: Mapping[str, tuple[int, ...]], kind: str) -> Values:
    """FMPy: co-simulation, or model exchange by CVode; names of variables -> their shapes."""
    start = {}
    for name, value in example.start.items():
        start |= dict(zip(elements(name, np.shape(value)), np.ravel(value), strict=True))
    signals = None
    if example.inputs:
        columns = [example.times, *(np.vectorize(f, otypes=[float])(example.times) for f in example.inputs.values())]
        signals = np.rec.fromarrays(columns, names=["time", *example.inputs])
    outputs = [n for name, shape in shapes.items() for n in elements(name, shape)]
    rows = example.rows_me if kind == "ModelExchange" else 1
    table = fmpy.simulate_fmu(
        str(fmu),
        stop_time=example.stop,
        step_size=example.step,
        output_interval=example.step / rows,
        start_values=start,
        input=signals,
        output=outputs,
        fmi_type=kind,
        relative_tolerance=1e-10 if kind == "ModelExchange" else None,
        record_events=False,
    )
    table = table[::rows]
    np.testing.assert_allclose(table["time"], example.times, atol=1e-9)
    return _together({n: table[n] for n in outputs}, shapes)


def by_our_master(fmu: Path, example: Example, shapes: Mapping[str, tuple[int, ...]], *, solver: str = "") -> Values:
    """The master of this project, in co-simulation, or in model exchange by a solver."""
    system = System()
    system.add("model", fmu, start=dict(example.start))
    for name, f in example.inputs.items():
        system.drive(f"model.{name}", f)
    by_equations = {"interface": "model-exchange", "solver": solver, "tolerance": 1e-10}
    results = simulate(system, example.stop, example.step, **(by_equations if solver else {}))  # type: ignore[arg-type]
    return _together(
        {n: results[f"model.{n}"] for name, shape in shapes.items() for n in elements(name, shape)}, shapes
    )


#: Ecos steps one FMU, with inputs set before each step, in a process of its own.
_BY_ECOS = """
import ctypes
from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

EcosLib.set_log_level("err")
kinds = {"real": "real", "integer": "integer", "enumeration": "integer", "boolean": "bool"}
with EcosSimulationStructure() as structure:
    structure.add_model("model", A.fmu)
    structure.add_parameter_set("start", {f"model::{name}": value for name, value in A.start.items()})
    with EcosSimulation(structure=structure, step_size=A.step) as simulation:

        def found():
            return [getattr(simulation, "get_" + kinds[A.types[n]])(f"model::{n}") for n in A.outputs]

        simulation.init(parameter_set="start")
        rows = [found()]
        for row in A.inputs:
            for name, value in row.items():
                simulation.set_real(f"model::{name}", value)
            simulation.step()
            rows.append(found())
        simulation.terminate()
report(rows)
"""


def by_ecos(fmu: Path, example: Example, shapes: Mapping[str, tuple[int, ...]], folder: Path) -> Values:
    """Ecos, an importer of its own: co-simulation, with values at the communication points."""
    types = {v.name: _type(v.type) for v in fmpy.read_model_description(str(fmu)).modelVariables}
    start: dict[str, Any] = {}
    for name, value in example.start.items():
        values = zip(elements(name, np.shape(value)), np.ravel(value), strict=True)
        start |= {n: float(v) if types[n] == "real" else v.item() for n, v in values}
    start |= {name: f(0.0) for name, f in example.inputs.items()}
    outputs = [n for name, shape in shapes.items() for n in elements(name, shape)]
    rows = fresh(
        folder,
        _BY_ECOS,
        fmu=fmu,
        start=start,
        step=example.step,
        outputs=outputs,
        types=types,
        inputs=[{name: float(f(t)) for name, f in example.inputs.items()} for t in example.times[:-1]],
    )
    return _together(dict(zip(outputs, np.transpose(np.array(rows, dtype=float)), strict=True)), shapes)


def _type(fmi_type: str) -> str:
    """The type of a variable in either version."""
    known = {"Real": "real", "Float64": "real", "Boolean": "boolean", "Enumeration": "enumeration", "String": "string"}
    return known.get(fmi_type, "integer")
