"""Regression of FMUs: run them under fixed inputs and hold the results against references.

>>> from cosim.regression import Tolerances, compare
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.regression.case import Case, find_cases
    from cosim.regression.comparison import Comparison, compare, compare_signals
    from cosim.regression.outcome import Outcome, check
    from cosim.regression.tolerances import Tolerance, ToleranceError, Tolerances

#: Name -> module; loaded when first used, since pytest loads the plugin of this package in every session.
_MODULES = {
    "Case": "case",
    "Comparison": "comparison",
    "Outcome": "outcome",
    "Tolerance": "tolerances",
    "ToleranceError": "tolerances",
    "Tolerances": "tolerances",
    "check": "outcome",
    "compare": "comparison",
    "compare_signals": "comparison",
    "find_cases": "case",
}

__all__ = [
    "Case",
    "Comparison",
    "Outcome",
    "Tolerance",
    "ToleranceError",
    "Tolerances",
    "check",
    "compare",
    "compare_signals",
    "find_cases",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'cosim.regression' has no attribute {name!r}")
    return getattr(import_module(f"cosim.regression.{_MODULES[name]}"), name)
