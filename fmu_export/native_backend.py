"""The native flavours, FMI 2.0 and 3.0: C code traced from the model, for importers without Python.

Each archive has both interfaces, model exchange and co-simulation, and its own sources.
"""

from __future__ import annotations

import hashlib
from importlib.resources import files
from pathlib import Path
from typing import Literal

import fmpy

from fmu_export import description_fmi2, description_fmi3
from fmu_export.archive import write_archive
from fmu_export.c_source import model_sources
from fmu_export.interface import interface_of
from fmu_export.model import Model
from fmu_export.start_values import MEMBER, start_values_text
from fmu_export.toolchain import ToolchainError, compile_library, host_target
from fmu_export.trace import trace

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
}

#: Attributes of the interfaces, by flavour.
_INTERFACES = {
    "fmi2": {
        "ModelExchange": {"completedIntegratorStepNotNeeded": "true", **_COMMON_2},
        "CoSimulation": {
            "canHandleVariableCommunicationStepSize": "true",
            "canInterpolateInputs": "true",
            **_COMMON_2,
        },
    },
    "fmi3": {
        "ModelExchange": {"needsCompletedIntegratorStep": "false", **_COMMON_3},
        "CoSimulation": {"canHandleVariableCommunicationStepSize": "true", **_COMMON_3},
    },
}

_DESCRIPTIONS = {"fmi2": description_fmi2.model_description, "fmi3": description_fmi3.model_description}

#: The model-independent adapter, its face for each version, and the headers of the standard that it needs.
_ADAPTER = ("core.h", "core.c", "uri.h", "uri.c")
_FACES = {"fmi2": "fmi2.c", "fmi3": "fmi3.c"}
_HEADERS = {
    "fmi2": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "fmi3": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}


def build_native(model: Model, folder: Path, flavour: Literal["fmi2", "fmi3"]) -> Path:
    """Write `<folder>/<model name>.fmu` with a binary for this machine.

    The same sources, compiled by the same compiler, give the same bytes.

    Raises
    ------
    ToolchainError
        There is no C compiler, or it fails.
    OSError
        The file can't be written; an older one is unchanged.
    """
    traced = trace(model)
    interface = interface_of(traced)

    def description(guid: str) -> bytes:
        return _DESCRIPTIONS[flavour](model, interface, guid, _INTERFACES[flavour], "C code")

    adapter = _adapter_sources(flavour)
    digest = hashlib.sha256(description(guid=""))
    for name, source in sorted((adapter | model_sources(traced, interface, guid="")).items()):
        digest.update(name.encode() + source)
    guid = "{" + digest.hexdigest()[:32] + "}"
    sources = adapter | model_sources(traced, interface, guid)
    target = host_target()
    binaries = target.fmi2_folder if flavour == "fmi2" else target.fmi3_folder
    if binaries is None:
        raise ToolchainError(f"FMI 2.0 has no place for binaries of {target.name}; build the fmi3 flavour")
    path = folder / f"{model.name}.fmu"
    write_archive(
        path,
        {
            "modelDescription.xml": description(guid),
            MEMBER: start_values_text(interface),
            f"binaries/{binaries}/{model.name}{target.suffix}": compile_library(sources, model.name),
            **{f"sources/{name}": source for name, source in sources.items()},
        },
    )
    return path


def _adapter_sources(flavour: str) -> dict[str, bytes]:
    adapter = files("fmu_export") / "c_adapter"
    headers = Path(fmpy.__file__).parent / "c-code"
    return {name: (adapter / name).read_bytes() for name in (*_ADAPTER, _FACES[flavour])} | {
        name: (headers / name).read_bytes() for name in _HEADERS[flavour]
    }
