"""The inputs of a case: what its file says, between rows too."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cosim.regression.case import Between, Case, CaseError
from cosim.system.variables import Element, Ports


def input_function(time: np.ndarray, values: np.ndarray, between: Between) -> Callable[[np.ndarray], np.ndarray]:
    """Values of an input over time; where rows have the same time it jumps, and has the value after the jump there."""
    slack = 1e-9 * max(float(np.ptp(time)), 1e-300)  # for rounding of the communication points

    def held(t: np.ndarray) -> np.ndarray:
        return values[np.maximum(np.searchsorted(time, t + slack, side="right") - 1, 0)]

    def linear(t: np.ndarray) -> np.ndarray:
        left = np.clip(np.searchsorted(time, t, side="right") - 1, 0, len(time) - 1)
        right = np.minimum(left + 1, len(time) - 1)
        span = time[right] - time[left]
        share = np.divide(t - time[left], span, out=np.zeros_like(t), where=span > 0.0)
        between: np.ndarray = values[left] + np.clip(share, 0.0, 1.0) * (values[right] - values[left])
        return between

    return held if between == "hold" else linear


def input_elements(ports: Ports, names: list[str], case: Case) -> list[Element]:
    """Elements of inputs by name.

    Raises
    ------
    CosimError
        A name is none of an input, or that of a whole vector.
    """
    elements: list[Element] = []
    for name in names:
        found = ports.find(name)
        if len(found) != 1 or found[0].variable.causality != "input":
            raise CaseError(f"{case.inputs_path}: '{name}' is not an input of the FMU, or not a single element of one")
        elements += found
    return elements
