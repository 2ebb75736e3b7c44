"""Up to which order an FMU takes derivatives of its inputs: FMI 2.0 has no attribute for it, so it is tried.

Some FMUs take all and use the first ones only. From the state in which it begins, an FMU makes the same step again and
again, each time with derivatives of one order: where its outputs are those of a step without, it ignores that order.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence

import numpy as np

from cosim.fmi.instance import CallFailed, Instance
from cosim.fmi.variable_buffer import VariableBuffer
from cosim.master.refusals import function_for_derivatives
from cosim.system.variables import Element, variables_of

#: By how much inputs change over the step.
_CHANGE = 1e-3


def order_taken(
    instance: Instance, inputs: Sequence[Element], outputs: Sequence[Element], degree: int, time: float, step: float
) -> int | None:
    """Order of derivatives of its inputs, at most `degree`, up to which an FMU takes note of them.

    It stands at the start of a run, and can't be used for one afterwards.

    Parameters
    ----------
    instance : Instance
    inputs, outputs : sequence of Element
        Real ones, the inputs those that it can interpolate.
    degree : int
    time, step : float
        In s.

    Returns
    -------
    int or None
        None where that can't be told: it can't go back, a step fails, or no derivative of an input changes an output.
    """
    references = [variable.valueReference for variable in variables_of(inputs)]
    n = len(references) * degree
    all_references = (ctypes.c_uint32 * n)(*(references * degree))
    orders = (ctypes.c_int32 * n)(*(d for d in range(1, degree + 1) for _ in references))
    seen: list[bytes] = []
    try:
        kept = instance.kept_state()
        instance.keep(kept)
        for order in range(degree + 1):
            slots = np.zeros(len(outputs))
            derivative = _CHANGE * math.factorial(order) / step**order
            values = (ctypes.c_double * n)(*(derivative if o == order else 0.0 for o in orders))
            instance.call(function_for_derivatives(instance.version), all_references, n, orders, values)
            instance.call(instance.step_function, time, step, 1)
            VariableBuffer(instance, variables_of(outputs), slots).get()
            seen.append(slots.tobytes())
            instance.go_back(kept)
    except CallFailed:
        return None
    ignored = [order for order in range(1, degree + 1) if seen[order] == seen[0]]
    return None if 1 in ignored else min(ignored, default=degree + 1) - 1
