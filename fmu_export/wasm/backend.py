"""The WebAssembly flavour: C code traced from the model, for browsers and other hosts of WebAssembly.

A module is the same C as the native FMUs, with its own face and without a C library: it imports nothing, and computes
the same bits. It is not an FMU: FMI's layered standard for WebAssembly is a draft, whose FMUs hold a component of
the Component Model, which no browser instantiates, and which zig does not make.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Any

from fmu_export.errors import ArgumentError
from fmu_export.modelling.model import Model
from fmu_export.modelling.model_class import AnyModel, flat_model
from fmu_export.modelling.tables import Table
from fmu_export.native.backend import core_sources
from fmu_export.native.c_source import model_sources
from fmu_export.native.toolchain import compile_module
from fmu_export.package.archive import replacing
from fmu_export.package.description_common import DISTRIBUTION, package_version
from fmu_export.package.interface import Interface, ScalarVariable, interface_of
from fmu_export.progress import Progress
from fmu_export.trace.trace import TracedModel, trace

#: The file that is written beside a module, by which JavaScript loads it.
SCRIPT = "model.js"

#: The section of a module that describes it.
_SECTION = "model"

#: Headers of C's library that the adapter includes.
_HEADERS = ("errno.h", "locale.h", "math.h", "stdio.h", "stdlib.h", "string.h")


@dataclass(frozen=True)
class WasmModel:
    """A model as WebAssembly.

    Attributes
    ----------
    name : str
    code : bytes
        The module without its description.
    description : mapping
        What a host has to know: variables with units, limits and start values, the experiment, the data of tables; of
        what JSON can write.
    """

    name: str
    code: bytes
    description: Mapping[str, Any]

    @property
    def module(self) -> bytes:
        """The module with its description, in a custom section."""
        name, text = _SECTION.encode(), json.dumps(self.description, ensure_ascii=False, separators=(",", ":"))
        content = _leb128(len(name)) + name + text.encode()
        return self.code + b"\0" + _leb128(len(content)) + content


def read_module(path: str | PathLike[str]) -> WasmModel:
    """A module that `build_wasm` has written.

    Raises
    ------
    ArgumentError
        The file is no such module.
    OSError
        It can't be read.
    """
    content, at = Path(path).read_bytes(), 8
    if content[:4] == b"\0asm":
        while at < len(content):
            size, begin = _number(content, at + 1)
            n, first = _number(content, begin)
            if content[at] == 0 and content[first : first + n] == _SECTION.encode():
                description = json.loads(content[first + n : begin + size])
                return WasmModel(description["name"], content[:at], description)
            at = begin + size
    raise ArgumentError(f"{path}: no WebAssembly module with a model; build it with build_wasm")


def script(*, exports: bool = True) -> str:
    """The JavaScript by which a page or another host loads a module and runs it, and which imports nothing.

    It is an ES module; without `exports` a plain script, as workers take it that are made of a page's text.
    """
    text = (files(__package__) / "assets" / SCRIPT).read_text(encoding="utf-8")
    return text if exports else re.sub(r"^export ", "", text, flags=re.MULTILINE)


def build_wasm(model: AnyModel, folder: str | PathLike[str], unchecked: bool = False) -> Path:
    """Write `<folder>/<model name>.wasm`, and beside it `model.js`, by which JavaScript loads it.

    Needs the package ziglang. The module imports nothing and describes itself.

    Parameters
    ----------
    model : Model or ModelClass
    folder : path
    unchecked : bool, optional
        Build it also where the traced equations are not compared with what numpy computes, or differ.

    Raises
    ------
    TraceError
        The model can't be traced, or its trace computes something else than numpy.
    ToolchainError
        ziglang is not installed, or refuses the sources.
    OSError
        A file can't be written; older ones are unchanged.
    """
    made = wasm_model(model, unchecked)
    path = Path(folder) / f"{made.name}.wasm"
    path.parent.mkdir(parents=True, exist_ok=True)
    for file, content in ((path, made.module), (path.with_name(SCRIPT), script().encode())):
        with replacing(file) as stream:
            stream.write(content)
    return path


def wasm_model(model: AnyModel, unchecked: bool = False) -> WasmModel:
    """Trace and compile a model.

    Parameters
    ----------
    model, unchecked
        As `build_wasm` takes them.

    Raises
    ------
    TraceError
        As `build_wasm`.
    ToolchainError
        As `build_wasm`.
    """
    model = flat_model(model)
    with Progress(f"{model.name}, wasm") as progress:
        progress.stage = "tracing"
        traced = trace(model, unchecked)
        interface = interface_of(traced)
        progress.stage = "writing C"
        sources = wasm_sources(traced, interface)
        progress.stage = "compiling"
        code = compile_module(sources, model.name)
    tool = f"{DISTRIBUTION} {package_version()} (WebAssembly{', equations unchecked' * unchecked})"
    return WasmModel(model.name, code, _description(model, traced, interface, tool))


def wasm_sources(traced: TracedModel, interface: Interface) -> dict[str, bytes]:
    """The C of a module by file name, headers of C's library included."""
    model = traced.model
    own = files(__package__) / "c"
    return {
        **core_sources(model.solver, hybrid=not model.is_continuous, tables=bool(traced.tables)),
        **model_sources(traced, interface, ""),
        **{name: (own / name).read_bytes() for name in ("module.c", "freestanding.h", "freestanding.c")},
        **dict.fromkeys(_HEADERS, b'#include "freestanding.h"\n'),
    }


def _description(model: Model, traced: TracedModel, interface: Interface, tool: str) -> dict[str, Any]:
    experiment = model.default_experiment
    return {
        "name": model.name,
        "description": model.description,
        "tool": tool,
        "solver": model.solver if model.states else None,
        "experiment": {
            "startTime": experiment.start_time,
            "stopTime": experiment.stop_time,
            "stepSize": experiment.step_size,
        },
        "variables": [_variable(v) for v in interface.variables],
        "declared": [
            {"name": e.name, "reference": e.reference, "shape": list(e.shape), "description": e.description}
            for e in interface.declared
        ],
        "tables": [_table(table) for table in traced.tables],
    }


def _variable(v: ScalarVariable) -> dict[str, Any]:
    """What is known of a variable; of what it has not, there is no entry."""
    fields = {
        "name": v.name,
        "causality": v.causality,
        "variability": v.variability,
        "type": v.type,
        "unit": v.unit,
        "description": v.description or None,
        "start": v.start,
        "min": v.min,
        "max": v.max,
        "items": [list(item) for item in v.items] or None,
    }
    return {k: value for k, value in fields.items() if value is not None and value not in (math.inf, -math.inf)}


def _table(table: Table) -> dict[str, Any]:
    """Its name, and its data as the module has them: breakpoints of each variable, values."""
    arrays = (*table.breakpoints, table.values)
    return {
        "name": table.name,
        "size": [len(table.x), table.values.shape[1] if table.n_variables == 2 else 1],
        "data": [number for array in arrays for number in array.ravel().tolist()],
    }


def _number(content: bytes, at: int) -> tuple[int, int]:
    """A length that WebAssembly has written, and where what follows begins."""
    number = shift = 0
    while True:
        number |= (content[at] & 0x7F) << shift
        shift, at = shift + 7, at + 1
        if content[at - 1] < 0x80:
            return number, at


def _leb128(number: int) -> bytes:
    """A length as WebAssembly writes it."""
    found = bytearray()
    while True:
        number, low = number >> 7, number & 0x7F
        found.append(low | 0x80 * (number > 0))
        if not number:
            return bytes(found)
