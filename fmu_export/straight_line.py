"""Write a traced function as straight-line Python that needs nothing but the module `math`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

#: CasADi's elementary operations, which C and Python write alike; {0} and {1} are the operands.
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
    ca.OP_EQ: "({0} == {1})",
    ca.OP_LT: "({0} < {1})",
    ca.OP_LE: "({0} <= {1})",
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
    lines += [f"    {target} = {expression}" for target, expression in statements(f, argument_names, repr)]
    lines.append(f"    return [{', '.join(f'y{i}' for i in range(f.numel_out(0)))}]")
    return "\n".join(lines) + "\n"


def statements(f: ca.Function, argument_names: Sequence[str], literal: Callable[[float], str]) -> list[tuple[str, str]]:
    """The instructions of a traced function as assignments (target, expression), in C and Python alike.

    Results are assigned to `y0`, `y1`, ...; of the arguments `t` and `h` are scalars, the others arrays.

    Raises
    ------
    NotImplementedError
        The function uses an operation that has no template.
    """
    assignments = dict.fromkeys(range(f.numel_out(0)), "0.0")
    lines = []
    for k in range(f.n_instructions()):
        operation, operands, targets = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_CONST:
            lines.append((f"w{targets[0]}", literal(f.instruction_constant(k))))
        elif operation == ca.OP_INPUT:
            name, index = argument_names[operands[0]], operands[1]
            lines.append((f"w{targets[0]}", name if name in ("t", "h") else f"{name}[{index}]"))
        elif operation == ca.OP_OUTPUT:
            del assignments[targets[1]]
            lines.append((f"y{targets[1]}", f"w{operands[0]}"))
        elif operation in _TEMPLATES:
            lines.append((f"w{targets[0]}", _TEMPLATES[operation].format(*(f"w{i}" for i in operands))))
        else:
            raise NotImplementedError(f"{f.name()}: CasADi operation {operation} has no template; add it to _TEMPLATES")
    return [*((f"y{i}", zero) for i, zero in assignments.items()), *lines]
