"""The length of a vector, for models: it can be differentiated everywhere."""

from __future__ import annotations

from typing import Any

import numpy as np

from fmu_export.model import Array


def norm(v: Array) -> Any:
    """Euclidean norm of a vector (n,).

    At v = 0, where the norm has a kink, the derivative of its square root is 1/0, and importers that ask an FMU for
    directional derivatives would get NaN. Written as below, the derivative along any direction is 0 there, which is
    what central differences give.
    """
    square = v @ v
    return square / np.sqrt(square + (square == 0.0))
