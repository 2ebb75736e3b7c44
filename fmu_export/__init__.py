"""Export of FMI-free models: one `Model`, many back ends (FMUs, python-control)."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used, since casadi and python-control take a while to import.
_MODULES = {
    "DefaultExperiment": "fmu_export.modelling.model",
    "Layout": "fmu_export.modelling.model",
    "Model": "fmu_export.modelling.model",
    "Requirement": "fmu_export.modelling.model",
    "Variable": "fmu_export.modelling.model",
    "build_native": "fmu_export.native.backend",
    "build_pythonfmu": "fmu_export.pythonfmu.backend",
    "build_script": "fmu_export.pythonfmu.script",
    "to_control": "fmu_export.control_backend",
}

__all__ = [
    "DefaultExperiment",
    "Layout",
    "Model",
    "Requirement",
    "Variable",
    "build_native",
    "build_pythonfmu",
    "build_script",
    "to_control",
]

if TYPE_CHECKING:
    from fmu_export.control_backend import to_control
    from fmu_export.modelling.model import DefaultExperiment, Layout, Model, Requirement, Variable
    from fmu_export.native.backend import build_native
    from fmu_export.pythonfmu.backend import build_pythonfmu
    from fmu_export.pythonfmu.script import build_script
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'fmu_export' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
