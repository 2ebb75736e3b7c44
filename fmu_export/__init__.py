"""Export of FMI-free models: one `Model`, many back ends (FMUs, python-control)."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used, since casadi and python-control take a while to import.
_MODULES = {
    "ArgumentError": "fmu_export.errors",
    "BinariesMissing": "fmu_export.pythonfmu.binary",
    "CompositionError": "fmu_export.trace.composition",
    "DefaultExperiment": "fmu_export.modelling.model",
    "DocumentationError": "fmu_export.errors",
    "Event": "fmu_export.modelling.model",
    "Layout": "fmu_export.modelling.variables",
    "Metadata": "fmu_export.package.metadata",
    "MissingExtra": "fmu_export.errors",
    "Model": "fmu_export.modelling.model",
    "ModelClass": "fmu_export.modelling.model_class",
    "ModelError": "fmu_export.errors",
    "Reference": "fmu_export.package.references",
    "Requirement": "fmu_export.modelling.model",
    "Sampled": "fmu_export.modelling.model",
    "StartValueError": "fmu_export.package.start_values",
    "Table": "fmu_export.modelling.tables",
    "TableError": "fmu_export.package.tables",
    "ToolchainError": "fmu_export.native.toolchain",
    "TraceError": "fmu_export.errors",
    "Variable": "fmu_export.modelling.variables",
    "build_native": "fmu_export.native.backend",
    "build_pythonfmu": "fmu_export.pythonfmu.backend",
    "build_script": "fmu_export.pythonfmu.script",
    "build_wasm": "fmu_export.wasm.backend",
    "compose": "fmu_export.trace.composition",
    "discrete": "fmu_export.modelling.declarations",
    "every": "fmu_export.modelling.declarations",
    "input": "fmu_export.modelling.declarations",
    "local": "fmu_export.modelling.declarations",
    "output": "fmu_export.modelling.declarations",
    "parameter": "fmu_export.modelling.declarations",
    "require": "fmu_export.modelling.declarations",
    "state": "fmu_export.modelling.declarations",
    "to_control": "fmu_export.control_backend",
    "when": "fmu_export.modelling.declarations",
    "write_start_values": "fmu_export.package.start_values",
    "write_table": "fmu_export.package.tables",
}

__all__ = [
    "ArgumentError",
    "BinariesMissing",
    "CompositionError",
    "DefaultExperiment",
    "DocumentationError",
    "Event",
    "Layout",
    "Metadata",
    "MissingExtra",
    "Model",
    "ModelClass",
    "ModelError",
    "Reference",
    "Requirement",
    "Sampled",
    "StartValueError",
    "Table",
    "TableError",
    "ToolchainError",
    "TraceError",
    "Variable",
    "build_native",
    "build_pythonfmu",
    "build_script",
    "build_wasm",
    "compose",
    "discrete",
    "every",
    "input",
    "local",
    "output",
    "parameter",
    "require",
    "state",
    "to_control",
    "when",
    "write_start_values",
    "write_table",
]

if TYPE_CHECKING:
    from fmu_export.control_backend import to_control
    from fmu_export.errors import ArgumentError, DocumentationError, MissingExtra, ModelError, TraceError
    from fmu_export.modelling.declarations import discrete, every, input, local, output, parameter, require, state, when
    from fmu_export.modelling.model import DefaultExperiment, Event, Model, Requirement, Sampled
    from fmu_export.modelling.model_class import ModelClass
    from fmu_export.modelling.tables import Table
    from fmu_export.modelling.variables import Layout, Variable
    from fmu_export.native.backend import build_native
    from fmu_export.native.toolchain import ToolchainError
    from fmu_export.package.metadata import Metadata
    from fmu_export.package.references import Reference
    from fmu_export.package.start_values import StartValueError, write_start_values
    from fmu_export.package.tables import TableError, write_table
    from fmu_export.pythonfmu.backend import build_pythonfmu
    from fmu_export.pythonfmu.binary import BinariesMissing
    from fmu_export.pythonfmu.script import build_script
    from fmu_export.trace.composition import CompositionError, compose
    from fmu_export.wasm.backend import build_wasm
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'fmu_export' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
