"""Structural parameters of FMI 3.0: sizes of arrays that follow them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fmpy.model_description import ModelDescription, ModelVariable


def is_structural(variable: ModelVariable) -> bool:
    """Whether a variable can be set in the configuration mode only."""
    return bool(variable.causality == "structuralParameter")


def is_size(variable: ModelVariable, description: ModelDescription) -> bool:
    """Whether the size of an array follows a variable."""
    reference = variable.valueReference
    return any(d.valueReference == reference for v in description.modelVariables for d in v.dimensions)


def resize(description: ModelDescription, start: Mapping[str, Any]) -> None:
    """Give all arrays of a model description the shapes that they have with start values of structural parameters.

    Values that are no sizes are left to whoever checks start values.
    """
    sizes = {}
    for variable in description.modelVariables:
        if is_structural(variable) and variable.name in start:
            try:
                sizes[variable.valueReference] = max(0, int(start[variable.name]))
            except (TypeError, ValueError, OverflowError):
                continue
    for variable in description.modelVariables if sizes else ():
        pairs = zip(variable.dimensions, variable.shape or (), strict=False)
        variable.shape = tuple(sizes.get(dimension.valueReference, known) for dimension, known in pairs)


def depends_on_start_values(description: ModelDescription) -> bool:
    """Whether start values change what the description says: sizes of arrays, and intervals of clocks."""
    return any(v.causality == "structuralParameter" or v.type == "Clock" for v in description.modelVariables)
