"""The pythonfmu flavour: an FMI 2.0 co-simulation FMU that computes the model in the importer's Python process.

pythonfmu gives the binary that embeds Python. The rest is ours: straight-line code traced from the model, the slave
around it, the model description. All modules carry a fingerprint of their content in their name, because the FMUs of
one process share `sys.modules`: two versions of an FMU then never run each other's code, and no installed package or
imported checkout can stand in for the archive's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from importlib.metadata import version
from importlib.resources import files
from os import PathLike
from pathlib import Path

from fmu_export import modelling
from fmu_export.errors import ArgumentError
from fmu_export.modelling.internal_steps import MOST_INTERNAL_STEPS
from fmu_export.modelling.model import Model, Solver
from fmu_export.modelling.model_class import AnyModel, flat_model
from fmu_export.package.archive import write_archive
from fmu_export.package.bill_of_materials import bill_of_materials
from fmu_export.package.description_fmi2 import model_description
from fmu_export.package.interface import Interface, interface_of
from fmu_export.package.metadata import NO_METADATA, Metadata, licence_members
from fmu_export.package.references import Reference, reference_members
from fmu_export.package.start_values import MEMBER, start_values_text
from fmu_export.pythonfmu.binary import binaries, licence
from fmu_export.trace.straight_line import python_source
from fmu_export.trace.trace import TracedModel, trace

#: Attributes of CoSimulation. needsExecutionTool means a separate program, which there is none: Python is embedded.
_OPTIONS = {
    "canHandleVariableCommunicationStepSize": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "canNotUseMemoryManagementFunctions": "true",
    "needsExecutionTool": "false",
}

_ENTRY = '''"""Entry of the FMU {name}; generated, do not edit."""

import ctypes

from {package} import {modules}
from {package}.slave import Fmi2Slave

# pythonfmu 0.7.0 runs this file at every instantiation and then drops a reference to this dictionary that it does not
# own; without this line it is freed at the second instantiation.
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))


class {name}(Fmi2Slave):
'''

_SOLVERS = ("rk4", "rk43")

#: The traced functions that the slave calls, with their arguments.
_ARGUMENTS = {
    "initial_state": ("p",),
    "outputs": ("t", "x", "u", "p"),
    "step": ("t", "x", "u", "p", "h"),
    "start_margins": ("p",),
    "step_margins": ("t", "x", "u", "p"),
}

#: Those that a solver calls besides.
_ARGUMENTS_OF: dict[Solver, dict[str, tuple[str, ...]]] = {"rk43": {"defect": ("t", "x", "u", "p", "h", "stages")}}

#: Modules that the class of a solver has besides `equations` and `interface`.
_MODULES_OF: dict[Solver, tuple[str, ...]] = {"rk43": ("internal_steps",)}


def build_pythonfmu(
    model: AnyModel,
    folder: str | PathLike[str],
    page: str | None = None,
    figures: Mapping[str, bytes] | None = None,
    unchecked: bool = False,
    metadata: Metadata = NO_METADATA,
    reference: Reference | bool = True,
) -> Path:
    """Write `<folder>/<model name>.fmu`; the same sources give the same bytes.

    Parameters
    ----------
    model : Model or ModelClass
    folder : path
    page : str, optional
        The model's page in Markdown, for the documentation in the archive; without it there is none.
    figures : mapping of str to bytes, optional
        The pictures that the page shows, by file name.
    unchecked : bool, optional
        Build it also where the traced equations are not compared with what numpy computes, or differ; the model
        description says so in `generationTool`.
    metadata : Metadata, optional
        Author, version, copyright and licence.
    reference : Reference or bool, optional
        The run that the FMU brings along with its results (fmi-ls-ref); by default from its start values, if the model
        runs from there. False for none.

    Raises
    ------
    DocumentationError
        A figure of the page is missing, an equation can't be typeset, or the reference run can't be made or is not
        finite.
    ArgumentError
        The model has discrete states, events or variables that are no reals, or another solver than "rk4" and "rk43".
    TraceError
        The model can't be traced, or its trace computes something else than numpy.
    OSError
        The file can't be written; an older one is unchanged.
    BinariesMissing
        The installed pythonfmu has no binaries.
    """
    model = flat_model(model)
    if not model.is_continuous:
        raise ArgumentError(
            f"{model.name}: the pythonfmu flavour takes continuous models, without discrete states and events; build "
            "an FMU with build_native"
        )
    if model.solver not in _SOLVERS:
        raise ArgumentError(
            f"{model.name}: the pythonfmu flavour has no solver {model.solver!r}, only 'rk4' and 'rk43'; build "
            "an FMU with build_native"
        )
    layouts = (model.parameters, model.inputs, model.outputs, model.locals)
    if typed := [v for layout in layouts for v in layout.variables if v.type != "real"]:
        raise ArgumentError(
            f"{model.name}: '{typed[0].name}' is of type {typed[0].type}; the pythonfmu flavour takes reals only, "
            "build an FMU with build_native"
        )
    traced = trace(model, unchecked)
    interface = interface_of(traced)
    # without its guid the description holds nothing that depends on the fingerprint
    unstamped = _description(model, interface, "", unchecked, metadata)
    modules = _modules(traced, interface)
    entry_source = _entry_source(model.solver)
    digest = hashlib.sha256(unstamped + entry_source.encode())
    for name in sorted(modules):
        digest.update(name.encode() + modules[name])
    fingerprint = digest.hexdigest()
    package = f"{model.name}_{fingerprint[:16]}"
    entry = f"{package}_entry"
    modules["interface.py"] += f"FINGERPRINT = {fingerprint!r}\n".encode()
    path = Path(folder) / f"{model.name}.fmu"
    members = {
        "modelDescription.xml": _description(model, interface, _guid(fingerprint), unchecked, metadata),
        "resources/slavemodule.txt": entry.encode(),
        f"resources/{entry}.py": entry_source.format(name=model.name, package=package).encode(),
        **{f"resources/{package}/{name}": source for name, source in modules.items()},
        MEMBER: start_values_text(interface),
        **binaries(model.name),
        "documentation/licenses/pythonfmu.txt": licence(),
        **licence_members(metadata),
    }
    if page is not None:
        from fmu_export.package.documentation import documentation_members

        members |= documentation_members(model, interface, page, "pythonfmu", figures, metadata, unchecked=unchecked)
    if reference is not False:
        asked_for = None if reference is True else reference
        members |= reference_members(model, interface, asked_for, None, unchecked)
    write_archive(path, members | bill_of_materials(model.name, metadata, members))
    return path


def _description(model: Model, interface: Interface, guid: str, unchecked: bool, metadata: Metadata) -> bytes:
    tool = f"PythonFMU {version('pythonfmu')}" + (", equations unchecked" if unchecked else "")
    return model_description(model, interface, guid, {"CoSimulation": _OPTIONS}, tool, metadata=metadata)


def _guid(fingerprint: str) -> str:
    parts = (fingerprint[:8], fingerprint[8:12], fingerprint[12:16], fingerprint[16:20], fingerprint[20:32])
    return "{" + "-".join(parts) + "}"


def _modules(traced: TracedModel, interface: Interface) -> dict[str, bytes]:
    solver = traced.model.solver
    arguments_of = _ARGUMENTS | _ARGUMENTS_OF.get(solver, {})
    functions = [(getattr(traced, name), arguments) for name, arguments in arguments_of.items()]
    return {
        "__init__.py": b"",
        "equations.py": python_source(functions, traced.tables).encode(),
        "interface.py": _interface_source(traced.model, interface).encode(),
        **{
            f"{name}.py": Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8").encode()
            for name in ("slave", "life_cycle")
        },
        **{f"{name}.py": files(modelling).joinpath(f"{name}.py").read_bytes() for name in _MODULES_OF.get(solver, ())},
    }


def _entry_source(solver: Solver) -> str:
    """The entry module, but for names."""
    modules = ("equations", "interface", *_MODULES_OF.get(solver, ()))
    return _ENTRY.replace("{modules}", ", ".join(modules)) + "".join(f"    {name} = {name}\n" for name in modules)


def _interface_source(model: Model, interface: Interface) -> str:
    parameters = interface.variables[: interface.n_parameters]
    limits = tuple(
        (float("-inf") if v.min is None else v.min, float("inf") if v.max is None else v.max) for v in parameters
    )
    return (
        f'"""Interface of {model.name}, generated from the model; do not edit."""\n\n'
        "from math import inf\n\n"
        f"NAMES = {tuple(v.name for v in interface.variables)!r}\n"
        f"MOST_INTERNAL_STEPS = {MOST_INTERNAL_STEPS}\n"
        f"N_PARAMETERS = {interface.n_parameters}\n"
        f"N_INPUTS = {interface.n_inputs}\n"
        f"LIMITS = {limits!r}\n"
        f"TUNABLE = {tuple(i for i, v in enumerate(parameters) if v.variability == 'tunable')!r}\n"
        f"START_REQUIREMENTS = {tuple(r.message for r in model.requirements if r.at == 'start')!r}\n"
        f"NOMINALS = {interface.nominals!r}\n"
        f"STEP_REQUIREMENTS = {tuple(r.message for r in model.requirements if r.at == 'step')!r}\n"
    )
