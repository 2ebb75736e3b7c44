"""The functions of a model, for runs that an FMU brings along."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmu_export.modelling.functions import numeric
from fmu_export.modelling.model import Model
from fmu_export.modelling.variables import Array
from fmu_export.trace.trace import trace


@dataclass(frozen=True)
class Functions:
    """Initial states of (p), derivatives and outputs of (t, x, u, p); outputs without the locals."""

    initial_state: Callable[..., Array]
    derivatives: Callable[..., Array]
    outputs: Callable[..., Array]


def functions_of(model: Model, *, unchecked: bool = False) -> Functions:
    """The traced functions, which take a hundredth of the time of the author's own.

    The author's own where the trace was not compared with them, and where there are lookup tables, which the graphs
    only name.
    """
    n_y = len(model.outputs)  # locals follow them
    traced = trace(model, unchecked)
    if unchecked or traced.tables:
        outputs = numeric(model.output_values)
        return Functions(
            numeric(model.initial_state), numeric(model.derivatives), lambda *arguments: outputs(*arguments)[:n_y]
        )
    outputs = _evaluated(traced.outputs)
    return Functions(
        _evaluated(traced.initial_state), _evaluated(traced.derivatives), lambda *arguments: outputs(*arguments)[:n_y]
    )


def _evaluated(function: Any) -> Callable[..., Array]:
    """A CasADi function of dense columns, without its conversion of arguments, which takes longer than it."""
    evaluation = buffer, _ = function.buffer()  # the second does not keep the first alive
    arguments = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
    result = np.zeros(function.numel_out(0))
    for i, argument in enumerate(arguments):
        if argument.size:
            buffer.set_arg(i, argument.data)
    if result.size:
        buffer.set_res(0, result.data)

    def call(*values: Any) -> Array:
        for argument, value in zip(arguments, values, strict=True):
            argument[:] = value
        evaluation[1]()
        return result.copy()

    return call
