"""Regression of FMUs: run them with fixed inputs and compare the results with references.

>>> from cosim.regression import Tolerances, compare
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used, since pytest loads the plugin of this package in every session.
_MODULES = {
    "Case": "cosim.regression.case",
    "CaseError": "cosim.regression.case",
    "Comparison": "cosim.regression.comparison",
    "FmuRegression": "cosim.regression.fixture",
    "FunnelError": "cosim.regression.funnel",
    "Outcome": "cosim.regression.outcome",
    "RunError": "cosim.regression.case",
    "Tolerance": "cosim.regression.tolerances",
    "ToleranceError": "cosim.regression.tolerances",
    "Tolerances": "cosim.regression.tolerances",
    "check": "cosim.regression.outcome",
    "compare": "cosim.regression.comparison",
    "compare_signals": "cosim.regression.comparison",
    "find_cases": "cosim.regression.case",
}

__all__ = [
    "Case",
    "CaseError",
    "Comparison",
    "FmuRegression",
    "FunnelError",
    "Outcome",
    "RunError",
    "Tolerance",
    "ToleranceError",
    "Tolerances",
    "check",
    "compare",
    "compare_signals",
    "find_cases",
]

if TYPE_CHECKING:
    from cosim.regression.case import Case, CaseError, RunError, find_cases
    from cosim.regression.comparison import Comparison, compare, compare_signals
    from cosim.regression.fixture import FmuRegression
    from cosim.regression.funnel import FunnelError
    from cosim.regression.outcome import Outcome, check
    from cosim.regression.tolerances import Tolerance, ToleranceError, Tolerances
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.regression' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
