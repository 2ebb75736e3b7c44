"""CasADi's elementary operations: as C and Python write them, and as numpy computes them for the check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fmu_export.errors import TraceError, needs
from fmu_export.modelling.tables import Table
from fmu_export.trace.instructions import operations_of

with needs("export"):
    import casadi as ca


class Operation(NamedTuple):
    """An elementary operation: how C and Python write it, and what that computes for many points at once."""

    text: str
    values: Callable[..., Any]
    #: Whether it never rounds.
    exact: bool = False
    #: Whether it has an edge where its operands are equal; such operations do not round.
    compares: bool = False


def _chosen(condition: Any, a: Any) -> Any:
    return np.where(condition != 0.0, a, -0.0)


def _minimum(a: Any, b: Any) -> Any:
    return np.where(a < b, a, np.where(b <= a, b, a + b))


def _maximum(a: Any, b: Any) -> Any:
    return np.where(a > b, a, np.where(b >= a, b, a + b))


def _sign(a: Any) -> Any:
    return np.where(a > 0.0, 1.0, np.where(a < 0.0, -1.0, np.where(a == 0.0, 0.0, a)))


#: {0} and {1} are the operands in the text.
OPERATIONS: dict[int, Operation] = {
    ca.OP_ASSIGN: Operation("{0}", lambda a: a, exact=True),
    ca.OP_ADD: Operation("{0} + {1}", np.add),
    ca.OP_SUB: Operation("{0} - {1}", np.subtract),
    ca.OP_MUL: Operation("{0} * {1}", np.multiply),
    ca.OP_DIV: Operation("{0} / {1}", np.divide),
    ca.OP_NEG: Operation("-{0}", np.negative, exact=True),
    ca.OP_INV: Operation("1.0 / {0}", lambda a: 1.0 / a),
    ca.OP_SQ: Operation("{0} * {0}", lambda a: a * a),
    ca.OP_TWICE: Operation("2.0 * {0}", lambda a: 2.0 * a, exact=True),
    ca.OP_SQRT: Operation("sqrt({0})", np.sqrt),
    ca.OP_POW: Operation("pow({0}, {1})", np.power),
    ca.OP_CONSTPOW: Operation("pow({0}, {1})", np.power),
    ca.OP_EXP: Operation("exp({0})", np.exp),
    ca.OP_LOG: Operation("log({0})", np.log),
    ca.OP_SIN: Operation("sin({0})", np.sin),
    ca.OP_COS: Operation("cos({0})", np.cos),
    ca.OP_TAN: Operation("tan({0})", np.tan),
    ca.OP_ASIN: Operation("asin({0})", np.arcsin),
    ca.OP_ACOS: Operation("acos({0})", np.arccos),
    ca.OP_ATAN: Operation("atan({0})", np.arctan),
    ca.OP_ATAN2: Operation("atan2({0}, {1})", np.arctan2),
    ca.OP_HYPOT: Operation("hypot({0}, {1})", np.hypot),
    ca.OP_FABS: Operation("fabs({0})", np.fabs, exact=True),
    ca.OP_TANH: Operation("tanh({0})", np.tanh),
    ca.OP_EQ: Operation("({0} == {1})", lambda a, b: 1.0 * (a == b), compares=True),
    ca.OP_LT: Operation("({0} < {1})", lambda a, b: 1.0 * (a < b), compares=True),
    ca.OP_LE: Operation("({0} <= {1})", lambda a, b: 1.0 * (a <= b), compares=True),
    ca.OP_NE: Operation("({0} != {1})", lambda a, b: 1.0 * (a != b), compares=True),
    ca.OP_NOT: Operation("({0} == 0.0)", lambda a: 1.0 * (a == 0.0), exact=True),
    ca.OP_AND: Operation("(({0} != 0.0) * ({1} != 0.0))", lambda a, b: 1.0 * ((a != 0.0) & (b != 0.0)), exact=True),
    ca.OP_OR: Operation(
        "((({0} != 0.0) + ({1} != 0.0)) != 0.0)", lambda a, b: 1.0 * ((a != 0.0) | (b != 0.0)), exact=True
    ),
    ca.OP_FLOOR: Operation("floor({0})", np.floor, exact=True),
    ca.OP_CEIL: Operation("ceil({0})", np.ceil, exact=True),
    ca.OP_SINH: Operation("sinh({0})", np.sinh),
    ca.OP_COSH: Operation("cosh({0})", np.cosh),
    ca.OP_SIGN: Operation("sign({0})", _sign, exact=True),
    ca.OP_FMIN: Operation("minimum({0}, {1})", _minimum, compares=True),
    ca.OP_FMAX: Operation("maximum({0}, {1})", _maximum, compares=True),
    ca.OP_IF_ELSE_ZERO: Operation("chosen({0}, {1})", _chosen, exact=True),
    ca.OP_ASINH: Operation("asinh({0})", np.arcsinh),
    ca.OP_ACOSH: Operation("acosh({0})", np.arccosh),
    ca.OP_ATANH: Operation("atanh({0})", np.arctanh),
    ca.OP_LOG1P: Operation("log1p({0})", np.log1p),
    ca.OP_EXPM1: Operation("expm1({0})", np.expm1),
    ca.OP_FMOD: Operation("fmod({0}, {1})", np.fmod, exact=True),
    ca.OP_COPYSIGN: Operation("copysign({0}, {1})", np.copysign, exact=True),
}

#: Functions of C and of Python's module `math` that only some models need.
SELDOM = {
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_LOG1P: "log1p",
    ca.OP_EXPM1: "expm1",
    ca.OP_FMOD: "fmod",
    ca.OP_COPYSIGN: "copysign",
}


class Helper(NamedTuple):
    """A function that neither language has, or not with numpy's answer to NaN: here too NaN stays NaN.

    What is not chosen is -0.0, which leaves every number as it is that it is added to.
    """

    c: str
    python: str


HELPERS = {
    ca.OP_SIGN: Helper(
        "static double sign(double a) { return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a == 0.0 ? 0.0 : a; }",
        "def sign(a):\n    return 1.0 if a > 0.0 else -1.0 if a < 0.0 else 0.0 if a == 0.0 else a",
    ),
    ca.OP_FMIN: Helper(
        "static double minimum(double a, double b) { return a < b ? a : b <= a ? b : a + b; }",
        "def minimum(a, b):\n    return a if a < b else b if b <= a else a + b",
    ),
    ca.OP_FMAX: Helper(
        "static double maximum(double a, double b) { return a > b ? a : b >= a ? b : a + b; }",
        "def maximum(a, b):\n    return a if a > b else b if b >= a else a + b",
    ),
    ca.OP_IF_ELSE_ZERO: Helper(
        "static double chosen(double condition, double a) { return condition != 0.0 ? a : -0.0; }",
        "def chosen(condition, a):\n    return a if condition != 0.0 else -0.0",
    ),
}

_NAMES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}


#: How calls of a table are written, by the number of operands: its number, the variables, and for their change the
#: change of each, that of the number first.
CALLS = {
    2: "table_value({0}, {1})",
    4: "table_slope({0}, {1}) * {3}",
    3: "table_value_2({0}, {1}, {2})",
    6: "table_change_2({0}, {1}, {2}, {4}, {5})",
}


def number_of(index: int, table: Table) -> float:
    """The number that calls of a table have; a half tells that it is over two variables."""
    return index + 0.5 * (table.n_variables - 1)


def is_adjoint(operands: Sequence[Any], number: float) -> bool:
    """Whether a call of the table with this number is that of its adjoint: variables and the weight of its value."""
    return len(operands) == (3 if number == int(number) else 4)


def call_of(table: Table, operands: Sequence[Any]) -> Any:
    """What such a call computes, for many points at once."""
    where = operands[1 : 1 + table.n_variables]
    if len(operands) == 1 + table.n_variables:
        return table(*where)
    changes = operands[2 + table.n_variables :]
    return sum(slope * change for slope, change in zip(table.slopes(*where), changes, strict=True))


def template(operation: int, function: str, n_operands: int = 0) -> str:
    """How an operation is written; a call has the number of its operands.

    Raises
    ------
    TraceError
        There is no way yet; the message names the function of the model.
    """
    if operation == ca.OP_CALL and n_operands in CALLS:
        return CALLS[n_operands]
    if operation not in OPERATIONS:
        raise TraceError(
            f"{function}: CasADi's operation {_NAMES.get(operation, operation)} has no template; "
            "write the equation with others, or add it to fmu_export/trace/operations.py"
        )
    return OPERATIONS[operation].text


def helpers(functions: Iterable[ca.Function]) -> list[Helper]:
    """Those that functions use."""
    used = set().union(*map(operations_of, functions))
    return [helper for operation, helper in HELPERS.items() if operation in used]
