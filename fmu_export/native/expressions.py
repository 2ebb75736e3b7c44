"""Expressions of a traced graph as C: literals, operations, tables of constants."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence

from fmu_export.errors import needs
from fmu_export.native.elementary import FUNCTIONS, PREFIX
from fmu_export.trace.operations import template

with needs("export"):
    import casadi as ca

#: Arguments that are numbers; all others are arrays.
SCALARS = ("t", "h")


def literal(value: float) -> str:
    """A C literal that reads back bit for bit."""
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return value.hex() if value != int(value) or abs(value) > 1e15 else repr(value)


def operand(value: float) -> str:
    """A literal as it may stand in an expression."""
    text = literal(value)
    return f"({text})" if text.startswith("-") else text


def applied(operation: int, operands: Sequence[str], function: str) -> str:
    """An operation as C, to be put in parentheses inside another."""
    text = template(operation, function, len(operands)).format(*operands)
    return PREFIX + text if operation in FUNCTIONS else text


def without_parentheses(text: str) -> str:
    """An expression without the parentheses around the whole of it."""
    depth = 0
    for i, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return text[1:-1] if text.startswith("(") and i == len(text) - 1 else text
    return text


def expression(value: ca.SX, places: Mapping[str, str]) -> str:
    """One scalar expression as C, with names in place of its symbols."""
    symbols = ca.symvar(value)
    f = ca.Function("expression", symbols, [value])
    work: dict[int, str] = {}
    written = ""
    for k in range(f.n_instructions()):
        operation, operands, targets = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_CONST:
            work[targets[0]] = repr(f.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            work[targets[0]] = places[str(symbols[operands[0]])]
        elif operation == ca.OP_OUTPUT:
            written = work[operands[0]]
        else:
            work[targets[0]] = f"({template(operation, f.name()).format(*(work[i] for i in operands))})"
    return written


class Tables:
    """Constants of a model's equations that loops count through; equal ones stand once in the source."""

    def __init__(self, names: Mapping[tuple[str, ...], str] | None = None) -> None:
        self._names = dict(names or {})

    def copy(self) -> Tables:
        """Tables to which others can be added on trial."""
        return Tables(self._names)

    def adopt(self, other: Tables) -> None:
        """Become what a copy has become."""
        self._names = other._names

    def name(self, values: Iterable[float]) -> str:
        """Name of the table of these values."""
        return self._names.setdefault(tuple(map(literal, values)), f"table{len(self._names)}")

    @property
    def size(self) -> int:
        """Number of characters."""
        return len(self.source())

    def source(self) -> str:
        """The tables as C."""
        return "".join(
            f"static const double {name}[{len(values)}] = {{{', '.join(values)}}};\n"
            for values, name in self._names.items()
        )


#: Characters of a C literal: no quote, no backslash, no ? or < of trigraphs and digraphs.
_PLAIN = re.compile(r"[ !#-;=>@-\[\]-~]*")


def c_string(text: str) -> str:
    """A C literal of a text in UTF-8; what is not plain in every C is written by its octal number."""
    if _PLAIN.fullmatch(text):
        return f'"{text}"'
    return '"' + "".join(chr(b) if _PLAIN.fullmatch(chr(b)) else f"\\{b:03o}" for b in text.encode()) + '"'
