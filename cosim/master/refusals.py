"""What FMUs refuse though their descriptions promise it: found before a run begins, which then does without.

An FMU that has refused something is made anew, for FMI lets no instance go on after an error.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cosim.fmi.instance import CallFailed, Instance
from cosim.fmi.types import FMI_TYPES
from cosim.fmi.variable_buffer import VariableBuffer
from cosim.master.value_layout import Transfer
from cosim.system.variables import Element, variables_of


@dataclass
class Refusals:
    """Refusals that were found so far, with what the FMU did.

    Attributes
    ----------
    derivatives : dict
        Component -> how its FMU refuses derivatives of its inputs.
    outputs : dict
        `component.variable` -> how its FMU refuses to give it.
    """

    derivatives: dict[str, str] = field(default_factory=dict)
    outputs: dict[str, str] = field(default_factory=dict)

    def about(self) -> dict[str, Any]:
        """Entries of the results."""
        entries = {"derivatives_refused": dict(self.derivatives), "not_recorded": dict(self.outputs)}
        return {name: entry for name, entry in entries.items() if entry}


def function_for_derivatives(version: int) -> str:
    """Name of the function that takes derivatives of inputs, of a version of FMI before 3.0."""
    return f"fmi{version}SetRealInputDerivatives"


def refused_of(instance: Instance, transfer: Transfer) -> dict[str, str]:
    """Elements of a transfer that an FMU does not give when it is asked for each variable alone, and what it does."""
    refused = {}
    for variable in variables_of(transfer.elements):
        elements = [e for e in transfer.elements if e.variable.name == variable.name]
        try:
            VariableBuffer(instance, [variable], np.zeros(len(elements))).get()
        except CallFailed as error:
            refused.update({e.name: str(error) for e in elements})
    return refused


def lacking_of(instance: Instance, elements: Iterable[Element]) -> dict[str, str]:
    """Elements that can't be read, for the library has no function that reads them."""
    lacking = {}
    for element in elements:
        word, _ = FMI_TYPES[element.variable.type].functions[instance.version]
        if element.kind != "clock" and instance.lacks(f"fmi{instance.version}Get{word}"):
            lacking[element.name] = f"it lacks the function fmi{instance.version}Get{word}".replace("fmi1", "fmi")
    return lacking
