"""The native flavours, FMI 2.0 and 3.0: C code traced from the model, for importers without Python.

Each archive has both interfaces, model exchange and co-simulation, and its own sources.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import Literal

from fmu_export.errors import ArgumentError, MissingExtra
from fmu_export.modelling.model import Solver
from fmu_export.modelling.model_class import AnyModel, flat_model
from fmu_export.native.adjoint_source import adjoint_source
from fmu_export.native.c_source import model_sources
from fmu_export.native.elementary import licences
from fmu_export.native.step_control import step_control_source
from fmu_export.native.toolchain import Target, ToolchainError, Unit, compile_library, host_target
from fmu_export.package import description_fmi2, description_fmi3
from fmu_export.package.archive import write_archive
from fmu_export.package.bill_of_materials import bill_of_materials
from fmu_export.package.interface import Interface, interface_of
from fmu_export.package.metadata import NO_METADATA, Metadata, licence_members
from fmu_export.package.references import Reference, reference_members
from fmu_export.package.start_values import MEMBER, start_values_text
from fmu_export.package.tables import table_members
from fmu_export.progress import Progress
from fmu_export.trace.trace import TracedModel, trace

_COMMON_2 = {
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}
_COMMON_3 = {
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "providesDirectionalDerivatives": "true",
    "providesAdjointDerivatives": "true",
}

#: Attributes of the interfaces, by flavour, of a model without events and sampling.
_INTERFACES = {
    "fmi2": {
        "ModelExchange": {"completedIntegratorStepNotNeeded": "true", **_COMMON_2},
        "CoSimulation": {
            "canHandleVariableCommunicationStepSize": "true",
            "canInterpolateInputs": "true",
            "maxOutputDerivativeOrder": "1",
            **_COMMON_2,
        },
    },
    "fmi3": {
        "ModelExchange": {"needsCompletedIntegratorStep": "false", **_COMMON_3},
        "CoSimulation": {
            "canHandleVariableCommunicationStepSize": "true",
            "providesIntermediateUpdate": "true",
            "maxOutputDerivativeOrder": "1",
            **_COMMON_3,
        },
    },
}

#: The model-independent adapter, how it reads files, the integration method, a face for each version, and the headers
#: of the standard that it needs.
_CORE = ("core.h", "core.c", "types.c", "co_simulation.c")
_FILES = ("start_values.c", "uri.h", "uri.c")
_METHODS: dict[Solver, tuple[str, ...]] = {
    "rk4": ("fixed_step.h", "rk4.c"),
    "rk43": ("adaptive.c", "fixed_step.h", "rk4.c", "rk43.h"),
    "dopri5": ("adaptive.c", "dopri5.c", "dormand_prince.h"),
    "rodas4": ("adaptive.c", "rodas4.c", "sparse_lu.h"),
}
_EVENTS, _TABLES, _TABLE_FILES = ("events.c",), ("table.h", "table.c"), ("table_file.c",)
_FACES = {"fmi2": ("fmi2.c",), "fmi3": ("fmi3.c", "adjoint.c")}
_HEADERS = {
    "fmi2": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "fmi3": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}


#: Stands for the GUID in the sources and the description, of which it is the fingerprint.
_NO_GUID = "{" + 32 * "0" + "}"


def build_native(
    model: AnyModel,
    folder: str | PathLike[str],
    flavour: Literal["fmi2", "fmi3"],
    targets: Sequence[Target] | None = None,
    page: str | None = None,
    figures: Mapping[str, bytes] | None = None,
    unchecked: bool = False,
    metadata: Metadata = NO_METADATA,
    sources: bool = True,
    reference: Reference | bool = True,
    arrays: bool = False,
) -> Path:
    """Write `<folder>/<model name>.fmu`.

    The same sources, compiled by the same compilers, give the same bytes.

    Parameters
    ----------
    model : Model or ModelClass
    folder : path
    flavour : {"fmi2", "fmi3"}
        FMI version.
    targets : sequence of Target, optional
        Platforms to compile for by zig; by default this machine, with its own compiler. Those that the FMI version has
        no place for are left out.
    page : str, optional
        The model's page in Markdown, for the documentation in the archive; without it there is none.
    figures : mapping of str to bytes, optional
        The pictures that the page shows, by file name.
    unchecked : bool, optional
        Build it also where the traced equations are not compared with what numpy computes, or differ; the model
        description says so in `generationTool`.
    metadata : Metadata, optional
        Author, version, copyright and licence.
    sources : bool, optional
        False leaves the C sources out of the archive, which is then for the platforms of its binaries only.
    reference : Reference or bool, optional
        The run that the FMU brings along with its results (fmi-ls-ref); by default from its start values, if the model
        runs from there. False for none.
    arrays : bool, optional
        Vectors and matrices become arrays, which FMI 3.0 has, and not scalars for their elements, as in other flavours.

    Raises
    ------
    ArgumentError
        The flavour is none of the two, or arrays are asked for in FMI 2.0.
    DocumentationError
        A figure of the page is missing, an equation can't be typeset, or the reference run can't be made or is not
        finite.
    TraceError
        The model can't be traced, or its trace computes something else than numpy.
    ToolchainError
        There is no C compiler, or it fails.
    OSError
        The file can't be written; an older one is unchanged.
    """
    model = flat_model(model)
    if flavour not in _FACES:
        raise ArgumentError(f"{model.name}: flavour is {flavour!r}; it must be 'fmi2' or 'fmi3'")
    if arrays and flavour == "fmi2":
        raise ArgumentError(f"{model.name}: FMI 2.0 has no arrays; build the fmi3 flavour, or leave out arrays=True")
    with Progress(f"{model.name}, {flavour}") as progress, _no_collection():
        progress.stage = "tracing"
        traced = trace(model, unchecked)
        tool = "C code, equations unchecked" if unchecked else "C code"
        interface = replace(interface_of(traced), arrays=arrays)
        progress.stage = "writing C"
        adapter = _adapter_sources(flavour, model.solver, hybrid=not model.is_continuous, tables=bool(traced.tables))
        interfaces = _INTERFACES[flavour] if model.is_continuous else _hybrid_interfaces(flavour)
        code = adapter | _model_sources(traced, interface, flavour, _NO_GUID)
        c_files = sorted(name for name in code if name.endswith(".c"))
        arguments = model, interface, _NO_GUID, interfaces, tool
        if flavour == "fmi2":
            unstamped = description_fmi2.model_description(*arguments, c_files if sources else (), metadata)
        else:
            unstamped = description_fmi3.model_description(*arguments, metadata)
        digest = hashlib.sha256(unstamped)
        data = table_members(traced.tables)
        for name, source in sorted((code | data).items()):
            digest.update(name.encode() + source)
        guid = "{" + digest.hexdigest()[:32] + "}"
        code["model.h"] = code["model.h"].replace(_NO_GUID.encode(), guid.encode())
        binaries = {}
        for target in targets if targets is not None else [host_target()]:
            place = target.fmi2_folder if flavour == "fmi2" else target.fmi3_folder
            if place is None:
                continue
            progress.stage = f"compiling for {target.name}"
            name = f"binaries/{place}/{model.name}{target.suffix}"
            compiled_for = target if targets is not None else None
            binaries[name] = compile_library(code, model.name, compiled_for, units=_units(code, flavour))
        if not binaries:
            raise ToolchainError("FMI 2.0 has no place for binaries of this machine; build the fmi3 flavour")
        progress.stage = "writing the archive"
        members = {
            "modelDescription.xml": unstamped.replace(_NO_GUID.encode(), guid.encode()),
            MEMBER: start_values_text(interface),
            **data,
            **binaries,
            **licence_members(metadata),
            **licences(code),
        }
        if sources:
            members |= {f"sources/{name}": source for name, source in code.items()}
        if page is not None:
            from fmu_export.package.documentation import documentation_members

            members |= documentation_members(model, interface, page, flavour, figures, metadata, sources, unchecked)
        if sources and flavour == "fmi3":
            members["sources/buildDescription.xml"] = description_fmi3.build_description(model, c_files)
        if reference is not False:
            runs_here = targets is None or host_target() in targets
            asked_for = None if reference is True else reference
            members |= reference_members(model, interface, asked_for, members if runs_here else None, unchecked)
        members |= bill_of_materials(model.name, metadata, members)
        path = Path(folder) / f"{model.name}.fmu"
        write_archive(path, members)
    return path


@contextmanager
def _no_collection() -> Iterator[None]:
    """A time without collection of garbage: a build has hardly any, and looking for it takes a tenth of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _hybrid_interfaces(flavour: str) -> dict[str, dict[str, str]]:
    """Attributes of the interfaces of a model with events or sampling."""
    name = {"fmi2": "completedIntegratorStepNotNeeded", "fmi3": "needsCompletedIntegratorStep"}[flavour]
    needed = {"fmi2": "false", "fmi3": "true"}[flavour]
    interfaces = _INTERFACES[flavour]
    return interfaces | {"ModelExchange": interfaces["ModelExchange"] | {name: needed}}


def _model_sources(traced: TracedModel, interface: Interface, flavour: str, guid: str) -> dict[str, bytes]:
    more = {"model_adjoint.c": adjoint_source(traced)} if flavour == "fmi3" else {}
    return model_sources(traced, interface, guid, more)


def _adapter_sources(
    flavour: str, solver: Solver = "rk4", *, hybrid: bool = False, tables: bool = False
) -> dict[str, bytes]:
    headers = _headers()
    own = (*_FILES, *_TABLE_FILES * tables, *_FACES[flavour])
    return (
        core_sources(solver, hybrid=hybrid, tables=tables)
        | {name: _adapter_source(name) for name in own}
        | {name: (headers / name).read_bytes() for name in _HEADERS[flavour]}
    )


@cache
def _headers() -> Path:
    """Folder of the headers of the standard, which FMPy brings along; it takes a while to import, and need not be."""
    found = find_spec("fmpy")
    if found is None or found.origin is None:
        raise MissingExtra("export", "fmpy")
    return Path(found.origin).parent / "c-code"


def _units(code: Mapping[str, bytes], flavour: str) -> list[Unit]:
    """What runs in a step, what translates calls or runs at the start, and what no step calls of the model's C."""
    steps = dict.fromkeys((*_CORE, *(name for method in _METHODS.values() for name in method), *_EVENTS, *_TABLES))
    seldom = _FACES[flavour] + _FILES + _TABLE_FILES
    present = [tuple(name for name in names if name.endswith(".c") and name in code) for names in (steps, seldom)]
    # the loops over states of the Runge-Kutta methods of fixed order stand in the model's own source
    has_loops = not {"dopri5.c", "rodas4.c"}.isdisjoint(present[0])
    adjoint = [Unit(("model_adjoint.c",), level=1)] if "model_adjoint.c" in code else []
    return [Unit(present[0], level=3 if has_loops else 2), Unit(present[1], level=1), *adjoint]


def core_sources(solver: Solver, *, hybrid: bool, tables: bool) -> dict[str, bytes]:
    """What every face stands on, by file name: values, communication steps, the integration method, events, tables."""
    names = (*_CORE, *_EVENTS * hybrid, *_TABLES * tables, *_METHODS[solver])
    control = {"step_control.h": step_control_source(solver)} if "adaptive.c" in names else {}
    return {name: _adapter_source(name) for name in names} | control


def _adapter_source(name: str) -> bytes:
    return (files("fmu_export.native") / "c_adapter" / name).read_bytes()
