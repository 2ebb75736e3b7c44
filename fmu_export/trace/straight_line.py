"""Write a traced function as straight-line Python that needs nothing but the module `math`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fmu_export.errors import needs
from fmu_export.trace.operations import SELDOM, helpers, template

with needs("export"):
    import casadi as ca

HEADER = (
    '"""Equations, generated from the model by tracing; do not edit."""\n\n'
    "from math import acos, asin, atan, atan2, ceil, cos, cosh, exp, fabs, floor, hypot, inf, log, nan, pow, "
    "sin, sinh, sqrt, tan, tanh\n"
)


def python_source(functions: Sequence[tuple[ca.Function, Sequence[str]]]) -> str:
    """Source of a module with one Python function for each traced one.

    Parameters
    ----------
    functions : sequence of (function, argument names)
        Scalar arguments come as floats, the others as sequences of floats. Each returns a list of floats.
    """
    used = {f.instruction_id(k) for f, _ in functions for k in range(f.n_instructions())}
    seldom = sorted(name for operation, name in SELDOM.items() if operation in used)
    header = HEADER + (f"from math import {', '.join(seldom)}\n" if seldom else "")
    own = [helper.python + "\n" for helper in helpers(f for f, _ in functions)]
    return header + "".join("\n\n" + source for source in (*own, *(_function_source(f, n) for f, n in functions)))


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
        else:
            lines.append((f"w{targets[0]}", template(operation, f.name()).format(*(f"w{i}" for i in operands))))
    return [*((f"y{i}", zero) for i, zero in assignments.items()), *lines]
