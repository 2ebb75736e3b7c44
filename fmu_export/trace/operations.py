"""CasADi's elementary operations, as C and Python write them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from fmu_export.errors import TraceError, needs

with needs("export"):
    import casadi as ca


#: What C and Python write alike; {0} and {1} are the operands.
TEMPLATES = {
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
    ca.OP_NE: "({0} != {1})",
    ca.OP_NOT: "({0} == 0.0)",
    ca.OP_AND: "(({0} != 0.0) * ({1} != 0.0))",
    ca.OP_OR: "((({0} != 0.0) + ({1} != 0.0)) != 0.0)",
    ca.OP_FLOOR: "floor({0})",
    ca.OP_CEIL: "ceil({0})",
    ca.OP_SINH: "sinh({0})",
    ca.OP_COSH: "cosh({0})",
    ca.OP_SIGN: "sign({0})",
    ca.OP_FMIN: "minimum({0}, {1})",
    ca.OP_FMAX: "maximum({0}, {1})",
    ca.OP_IF_ELSE_ZERO: "chosen({0}, {1})",
    ca.OP_ASINH: "asinh({0})",
    ca.OP_ACOSH: "acosh({0})",
    ca.OP_ATANH: "atanh({0})",
    ca.OP_LOG1P: "log1p({0})",
    ca.OP_EXPM1: "expm1({0})",
    ca.OP_FMOD: "fmod({0}, {1})",
    ca.OP_COPYSIGN: "copysign({0}, {1})",
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
    """A function that neither language has, or not with numpy's answer to NaN: here too NaN stays NaN."""

    c: str
    python: str


HELPERS = {
    ca.OP_SIGN: Helper(
        "static double sign(double a) { return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a; }",
        "def sign(a):\n    return 1.0 if a > 0.0 else -1.0 if a < 0.0 else a",
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
        "static double chosen(double condition, double a) { return condition != 0.0 ? a : 0.0; }",
        "def chosen(condition, a):\n    return a if condition != 0.0 else 0.0",
    ),
}

_NAMES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}


def template(operation: int, function: str) -> str:
    """How an operation is written.

    Raises
    ------
    TraceError
        There is no way yet; the message names the function of the model.
    """
    if operation not in TEMPLATES:
        raise TraceError(
            f"{function}: CasADi's operation {_NAMES.get(operation, operation)} has no template; "
            "write the equation with others, or add it to fmu_export/trace/operations.py"
        )
    return TEMPLATES[operation]


def helpers(functions: Iterable[ca.Function]) -> list[Helper]:
    """Those that functions use."""
    used = {f.instruction_id(k) for f in functions for k in range(f.n_instructions())}
    return [helper for operation, helper in HELPERS.items() if operation in used]
