"""Write a traced function as straight-line Python that needs nothing but the module `math`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from fmu_export.errors import needs
from fmu_export.modelling.tables import Table
from fmu_export.trace.instructions import operations_of
from fmu_export.trace.operations import SELDOM, helpers, template

with needs("export"):
    import casadi as ca

HEADER = (
    '"""Equations, generated from the model by tracing; do not edit."""\n\n'
    "from math import acos, asin, atan, atan2, ceil, cos, cosh, exp, fabs, floor, hypot, inf, log, nan, pow, "
    "sin, sinh, sqrt, tan, tanh\n"
)


#: A value that is assigned, in an expression; a number; what needs no brackets in an expression.
_WORK = re.compile(r"\b(w\d+)\b")
_NUMBER = re.compile(r"[\d.e+]+(?:e-\d+)?")
_ATOM = re.compile(r"[\w.]+(?:\[\d+\])?|[a-z_0-9]+\([^()]*\)")

#: Expressions are nested no deeper.
_DEEPEST = 30

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
    used = set().union(*(operations_of(f) for f, _ in functions))
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
    assignments = _nested(statements(f, argument_names, repr))
    lines += [f"    {target} = {expression}" for target, expression in assignments]
    lines.append(f"    return [{', '.join(f'y{i}' for i in range(f.numel_out(0)))}]")
    return "\n".join(lines) + "\n"


@dataclass
class _Value:
    """An assignment of a value: of its expression, the text between the values that it is made of."""

    target: str
    texts: list[str]
    operands: list[_Value]
    uses: int = 0
    depth: int = 1

    @property
    def is_constant(self) -> bool:
        return not self.operands and _NUMBER.fullmatch(self.texts[0]) is not None

    @property
    def is_written_where_used(self) -> bool:
        return self.is_constant or (self.uses == 1 and self.depth <= _DEEPEST and self.target[0] != "y")

    def read(self) -> list[_Value]:
        """The assigned values that the expression reads."""
        found = []
        for operand in self.operands:
            found += operand.read() if operand.is_written_where_used else [operand]
        return found

    def expression(self) -> str:
        """The expression, with those in place that are used here only."""
        parts = [self.texts[0]]
        for operand, text in zip(self.operands, self.texts[1:], strict=True):
            if not operand.is_written_where_used:
                parts.append(operand.target)
            else:
                inner = operand.expression()
                parts.append(inner if _ATOM.fullmatch(inner) else f"({inner})")
            parts.append(text)
        return "".join(parts)


def _nested(assignments: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """The same assignments, with values that are used once written where they are used: Python stores and loads less.

    What is computed, and so each bit, stays the same.
    """
    current: dict[str, _Value] = {}
    values: list[_Value] = []
    for target, expression in assignments:
        operands = [current[name] for name in _WORK.findall(expression)]
        for operand in operands:
            operand.uses += 1
        value = _Value(target, _WORK.split(expression)[::2], operands)
        current[target] = value
        values.append(value)
    for value in values:  # when it is known how often each is used
        value.depth = 1 + max((o.depth for o in value.operands if o.is_written_where_used), default=0)
    assigned = [value for value in values if not value.is_written_where_used]
    last_use = {id(read): i for i, value in enumerate(assigned) for read in value.read()}
    free: list[str] = []  # few names: Python takes longer from the 257th on
    n_names = 0
    found = []
    for i, value in enumerate(assigned):
        expression = value.expression()
        free += [read.target for read in {id(r): r for r in value.read()}.values() if last_use[id(read)] == i]
        if value.target[0] == "w":
            if not free:
                free.append(f"w{n_names}")
                n_names += 1
            value.target = free.pop()
        found.append((value.target, expression))
    return found


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
