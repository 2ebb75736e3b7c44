"""C of what chooses internal steps: the numbers and formulas that `internal_steps` has in Python."""

from __future__ import annotations

from fmu_export.errors import needs
from fmu_export.modelling import internal_steps
from fmu_export.modelling.model import Solver
from fmu_export.native.expressions import expression
from fmu_export.trace.symbols.expressions import as_written

with needs("export"):
    import casadi as ca

_NUMBERS = ("MOST_GROWTH", "MOST_SHRINKAGE", "RETREAT", "LEAST_STEP", "LEAST_ERROR")
_NUMBERS_OF: dict[Solver, tuple[str, ...]] = {"rk43": ("SHARE", "MUCH_SHORTER", "ONE_OF")}


def step_control_source(solver: Solver) -> bytes:
    """The header `step_control.h`, for a solver that estimates its error."""
    size, nominal, rtol, share, error = (ca.SX.sym(name) for name in ("size", "nominal", "rtol", "share", "error"))
    with as_written():
        formulas = {
            "allowance": ((size, nominal, rtol, share), internal_steps.allowance(size, nominal, rtol, share)),
            "small_change": ((size, nominal), internal_steps.small_change(size, nominal)),
            "factor_of": ((error,), internal_steps.factor_of(error, ca.sqrt)),
        }
    lines = [f"#define {name} {getattr(internal_steps, name)!r}" for name in _NUMBERS + _NUMBERS_OF.get(solver, ())]
    for name, (arguments, value) in formulas.items():
        head = ", ".join(f"double {argument}" for argument in arguments)
        written = expression(value, {str(argument): str(argument) for argument in arguments})
        lines.append(f"static inline double {name}({head}) {{ return {written}; }}")
    return ("\n".join([_HEAD, *lines, "", "#endif"]) + "\n").encode()


_HEAD = """/* Generated from internal_steps.py, which explains it; do not edit. */
#ifndef STEP_CONTROL_H
#define STEP_CONTROL_H

#include <math.h>
"""
