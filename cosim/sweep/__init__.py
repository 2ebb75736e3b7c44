"""Sweeps: many runs of a system. A design says which, Dask runs them on all cores or a cluster, Parquet keeps the rows.

A `Study` says what a point of the design means; that of scenarios of any system is here.

>>> from cosim.sweep import Levels, Range, design
>>> points = design("sobol", [Range("controller.alpha", 0.5, 3.0), Levels("seed", (1, 2, 3))], points=8)
>>> len(points)
8
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used, since Dask and Arrow take a while to import.
_MODULES = {
    "Levels": "cosim.sweep.points",
    "PlannedRun": "cosim.sweep.study",
    "Points": "cosim.sweep.points",
    "Range": "cosim.sweep.points",
    "Rows": "cosim.sweep.batch",
    "ScenarioStudy": "cosim.sweep.scenarios",
    "Study": "cosim.sweep.study",
    "SweepError": "cosim.sweep.errors",
    "SweepSummary": "cosim.sweep.store",
    "check": "cosim.sweep.scenarios",
    "design": "cosim.sweep.points",
    "read": "cosim.sweep.store",
    "scenario_study": "cosim.sweep.scenarios",
    "sweep": "cosim.sweep.engine",
}

__all__ = [
    "Levels",
    "PlannedRun",
    "Points",
    "Range",
    "Rows",
    "ScenarioStudy",
    "Study",
    "SweepError",
    "SweepSummary",
    "check",
    "design",
    "read",
    "scenario_study",
    "sweep",
]

if TYPE_CHECKING:
    from cosim.sweep.batch import Rows
    from cosim.sweep.engine import sweep
    from cosim.sweep.errors import SweepError
    from cosim.sweep.points import Levels, Points, Range, design
    from cosim.sweep.scenarios import ScenarioStudy, check, scenario_study
    from cosim.sweep.store import SweepSummary, read
    from cosim.sweep.study import PlannedRun, Study
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.sweep' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
