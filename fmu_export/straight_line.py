"""Write a traced function as straight-line Python that needs nothing but the module `math`."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

#: Python for CasADi's elementary operations; {0} and {1} are the operands.
_TEMPLATES = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_SQRT: "sqrt({0})",
    ca.OP_POW: "pow({0}, {1})",
    ca.OP_CONSTPOW: "pow({0}, {1})",
    ca.OP_EXP: "exp({0})",
    ca.OP_LOG: "log({0})",
    ca.OP_SIN: "sin({0})",
    ca.OP_COS: "cos({0})",
    ca.OP_TAN: "tan({0})",
    ca.OP_ASIN: "asin({0})",
    ca.OP_ACOS: "acos({0})",
    ca.OP_ATAN: "atan({0})",
    ca.OP_ATAN2: "atan2({0}, {1})",
    ca.OP_HYPOT: "hypot({0}, {1})",
    ca.OP_FABS: "fabs({0})",
    ca.OP_TANH: "tanh({0})",
}

HEADER = (
    '"""Equations, generated from the model by tracing; do not edit."""\n\n'
    "from math import acos, asin, atan, atan2, cos, exp, fabs, hypot, inf, log, nan, pow, sin, sqrt, tan, tanh\n"
)


def python_source(functions: Sequence[tuple[ca.Function, Sequence[str]]]) -> str:
    """Source of a module with one Python function for each traced one.

    Parameters
    ----------
    functions : sequence of (function, argument names)
        Scalar arguments come as floats, the others as sequences of floats. Each returns a list of floats.
    """
    return HEADER + "".join("\n\n" + _function_source(f, names) for f, names in functions)


def _function_source(f: ca.Function, argument_names: Sequence[str]) -> str:
    lines = [f"def {f.name()}({', '.join(argument_names)}):"]
    results = ["0.0"] * f.numel_out(0)
    for k in range(f.n_instructions()):
        operation, operands, targets = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_CONST:
            lines.append(f"    w{targets[0]} = {f.instruction_constant(k)!r}")
        elif operation == ca.OP_INPUT:
            argument, index = operands
            name = argument_names[argument]
            scalar = f.numel_in(argument) == 1 and name in ("t", "h")
            lines.append(f"    w{targets[0]} = {name}" + ("" if scalar else f"[{index}]"))
        elif operation == ca.OP_OUTPUT:
            name = f"y{targets[1]}"
            lines.append(f"    {name} = w{operands[0]}")
            results[targets[1]] = name
        elif operation in _TEMPLATES:
            expression = _TEMPLATES[operation].format(*(f"w{i}" for i in operands))
            lines.append(f"    w{targets[0]} = {expression}")
        else:
            raise NotImplementedError(
                f"{f.name()}: CasADi operation {operation} has no Python template; add it to _TEMPLATES"
            )
    lines.append(f"    return [{', '.join(results)}]")
    return "\n".join(lines) + "\n"
