"""Write a traced function as straight-line Python that needs nothing but the module `math`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fmu_export.errors import needs
from fmu_export.modelling.tables import Table
from fmu_export.trace.operations import SELDOM, helpers, template

with needs("export"):
    import casadi as ca

HEADER = (
    '"""Equations, generated from the model by tracing; do not edit."""\n\n'
    "from math import acos, asin, atan, atan2, ceil, cos, cosh, exp, fabs, floor, hypot, inf, log, nan, pow, "
    "sin, sinh, sqrt, tan, tanh\n"
)


#: What calls of tables become; derivatives are not written as Python.
_LOOKUP = """from bisect import bisect_right


def _interval(points, v):
    return min(max(bisect_right(points, v) - 1, 0), len(points) - 2)


def table_value(table, v):
    x, y = TABLES[int(table)]
    if v != v:
        return v
    if v >= x[-1]:
        return y[-1]
    if v <= x[0]:
        return y[0]
    i = _interval(x, v)
    if x[i] == v:
        return y[i]
    return (y[i + 1] - y[i]) / (x[i + 1] - x[i]) * (v - x[i]) + y[i]


def table_value_2(table, v, w):
    x, y, z = TABLES[int(table)]
    if v != v or w != w:
        return v + w
    i, j = _interval(x, v), _interval(y, w)
    s = (min(max(v, x[0]), x[-1]) - x[i]) / (x[i + 1] - x[i])
    r = (min(max(w, y[0]), y[-1]) - y[j]) / (y[j + 1] - y[j])
    low, high = z[i], z[i + 1]
    return (1.0 - s) * ((1.0 - r) * low[j] + r * low[j + 1]) + s * ((1.0 - r) * high[j] + r * high[j + 1])
"""


def python_source(functions: Sequence[tuple[ca.Function, Sequence[str]]], tables: Sequence[Table] = ()) -> str:
    """Source of a module with one Python function for each traced one.

    Parameters
    ----------
    functions : sequence of (function, argument names)
        Scalar arguments come as floats, the others as sequences of floats. Each returns a list of floats.
    tables : sequence of Table
        The lookup tables that the functions call.
    """
    used = {f.instruction_id(k) for f, _ in functions for k in range(f.n_instructions())}
    seldom = sorted(name for operation, name in SELDOM.items() if operation in used)
    header = HEADER + (f"from math import {', '.join(seldom)}\n" if seldom else "")
    own = [helper.python + "\n" for helper in helpers(f for f, _ in functions)]
    if tables:
        data = "".join(f"    {_data(table)!r},\n" for table in tables)
        own.insert(0, f"{_LOOKUP}\n\nTABLES = (\n{data})\n")
    return header + "".join("\n\n" + source for source in (*own, *(_function_source(f, n) for f, n in functions)))


def _data(table: Table) -> tuple[Any, ...]:
    return tuple(array.tolist() for array in (*table.breakpoints, table.values))


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
            lines.append(
                (f"w{targets[0]}", template(operation, f.name(), len(operands)).format(*(f"w{i}" for i in operands)))
            )
    return [*((f"y{i}", zero) for i, zero in assignments.items()), *lines]
