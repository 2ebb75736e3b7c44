"""Scenarios: systems and their runs as TOML files."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used, since numpy takes a while to import.
_MODULES = {
    "MEASURES": "cosim.scenario.metrics",
    "Metric": "cosim.scenario.metrics",
    "SHAPES": "cosim.scenario.signals",
    "Scenario": "cosim.scenario.scenario",
    "ScenarioComponent": "cosim.scenario.scenario",
    "ScenarioError": "cosim.scenario.scenario",
    "ScenarioFamily": "cosim.scenario.family",
    "Shape": "cosim.scenario.signals",
    "families": "cosim.scenario.family",
    "load_scenario": "cosim.scenario.reading",
    "replaced": "cosim.scenario.own_fmus",
}

__all__ = [
    "MEASURES",
    "SHAPES",
    "Metric",
    "Scenario",
    "ScenarioComponent",
    "ScenarioError",
    "ScenarioFamily",
    "Shape",
    "families",
    "load_scenario",
    "replaced",
]

if TYPE_CHECKING:
    from cosim.scenario.family import ScenarioFamily, families
    from cosim.scenario.metrics import MEASURES, Metric
    from cosim.scenario.own_fmus import replaced
    from cosim.scenario.reading import load_scenario
    from cosim.scenario.scenario import Scenario, ScenarioComponent, ScenarioError
    from cosim.scenario.signals import SHAPES, Shape
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.scenario' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
