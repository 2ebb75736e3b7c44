"""Expressions that compute what numpy computes.

CasADi would take `x` for `(x + y) - y`, and 1 for `x / x` and for `x == x`, where numpy rounds, or has NaN. While the
author's functions run it leaves expressions as they are written (`as_written`); what is simplified here instead gives
the same for all finite values: terms that are 0, factors 0 and 1, signs. A product with 0 is 0 so that equations do not
depend on what their matrices have zeros for; numpy's NaN for `0 * inf`, and the sign of a zero, get lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from fmu_export.errors import needs

with needs("export"):
    import casadi as ca


@contextmanager
def as_written(yes: bool = True) -> Iterator[None]:
    """Context in which CasADi keeps operations as they are written, or (False) simplifies them."""
    before = ca.GlobalOptions.getSimplificationOnTheFly()
    ca.GlobalOptions.setSimplificationOnTheFly(not yes)
    try:
        yield
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(before)


def is_number(value: Any) -> bool:
    """Whether an expression is a number."""
    return bool(value.is_constant())


def _is_negative(a: Any) -> bool:
    """Whether an expression is the negative of another."""
    return bool(a.is_op(ca.OP_NEG))


def plus(a: Any, b: Any) -> Any:
    """A sum; a difference where one of the terms is a negative."""
    if b.is_constant() and float(b) == 0.0:
        return a
    if a.is_constant() and float(a) == 0.0:
        return b
    if _is_negative(b):
        return a - b.dep(0)
    return b - a.dep(0) if _is_negative(a) else a + b


def minus(a: Any, b: Any) -> Any:
    """A difference."""
    if b.is_constant() and float(b) == 0.0:
        return a
    if a.is_constant() and float(a) == 0.0:
        return -b
    if _is_negative(b):
        return plus(a, b.dep(0))
    return -(a.dep(0) + b) if _is_negative(a) else a - b


def times(a: Any, b: Any) -> Any:
    """A product; signs come first, so that products which differ in the sign only are computed once."""
    if b.is_constant():
        a, b = b, a
    if a.is_constant():
        factor = float(a)
        if factor in (0.0, 1.0, -1.0):
            return ca.SX(0.0) if factor == 0.0 else b if factor == 1.0 else -b
    elif _is_negative(a):
        return -times(a.dep(0), b)
    if _is_negative(b):
        return -times(a, b.dep(0))
    return squared(a) if a is b else a * b


def squared(a: Any) -> Any:
    """A square, which CasADi has as an operation of its own, with a shorter derivative."""
    if a.is_op(ca.OP_SQRT):  # where it is NaN the square is, too
        return a * a
    with as_written(False):
        return a * a


def divided(a: Any, b: Any) -> Any:
    """A quotient; signs come first."""
    if b.is_constant() and float(b) == 1.0:
        return a
    if _is_negative(a):
        return -divided(a.dep(0), b)
    return -divided(a, b.dep(0)) if _is_negative(b) else a / b


def power(a: Any, b: Any) -> Any:
    """A power, by products and roots where the exponent is a whole number or a half."""
    if not is_number(b):
        return a**b
    n = float(b)
    if n == 0.5:
        return ca.sqrt(a)
    if n != int(n) or abs(n) > 100:
        return a**b
    return _whole_power(a, int(n))


def _whole_power(a: Any, n: int) -> Any:
    if n == 0:
        return ca.SX(1.0)
    if n < 0:
        return 1.0 / _whole_power(a, -n)
    if n == 1:
        return a
    if n % 2:
        return a * _whole_power(a, n - 1)
    root = _whole_power(a, n // 2)
    return squared(root)


def either(condition: Any, a: Any, b: Any) -> Any:
    """`a` where a condition holds, else `b`; values of the other one do not matter, not even NaN."""
    condition, a, b = _expression(condition), _expression(a), _expression(b)
    if is_number(condition):
        return a if float(condition) else b
    return ca.if_else(condition, a, b)  # as it is written: a sum of both, of which one is -0.0


def _expression(value: Any) -> Any:
    return value if type(value) is ca.SX else ca.SX(value)


def truncated(a: Any) -> Any:
    """An expression rounded towards zero."""
    return either(a < 0.0, ca.ceil(a), ca.floor(a))


def is_nan(a: Any) -> Any:
    """Whether an expression is NaN: it is in no order with infinity."""
    return ca.logic_not(a <= ca.inf)


def rint(a: Any) -> Any:
    """An expression rounded to the nearest whole number, halves to even ones."""
    below = ca.floor(a)
    rest = a - below
    half = below * 0.5
    odd = half != ca.floor(half)
    up = ca.logic_or(rest > 0.5, ca.logic_and(rest == 0.5, odd))
    return ca.copysign(below + up, a)


def mod(a: Any, b: Any) -> Any:
    """What is left of a division that rounds down; it has the sign of the divisor."""
    rest = ca.fmod(a, b)
    other_side = either(b < 0.0, rest > 0.0, rest < 0.0)
    return either(rest == 0.0, ca.copysign(0.0, b), either(other_side, rest + b, rest))


def floor_divide(a: Any, b: Any) -> Any:
    """A quotient rounded down, as numpy computes it."""
    quotient = (a - mod(a, b)) / b
    below = ca.floor(quotient)
    return either(b == 0.0, a / b, either(quotient - below > 0.5, below + 1.0, below))


def whole_mod(a: Any, b: Any) -> Any:
    """What is left of a division of whole numbers; 0 for a division by 0."""
    return either(b == 0.0, 0.0, mod(a, b))


def whole_floor_divide(a: Any, b: Any) -> Any:
    """A quotient of whole numbers, rounded down; 0 for a division by 0."""
    return either(b == 0.0, 0.0, (a - mod(a, b)) / b)


def xor(a: Any, b: Any) -> Any:
    """Whether one of two expressions is not 0."""
    return (a != 0.0) != (b != 0.0)


def fmin(a: Any, b: Any) -> Any:
    """The smaller of two expressions, of which NaN loses."""
    return either(is_nan(a), b, either(is_nan(b), a, ca.fmin(a, b)))


def fmax(a: Any, b: Any) -> Any:
    """The larger of two expressions, of which NaN loses."""
    return either(is_nan(a), b, either(is_nan(b), a, ca.fmax(a, b)))


def heaviside(a: Any, b: Any) -> Any:
    """A step from 0 to 1, with `b` at 0."""
    return either(is_nan(a), a, either(a == 0.0, b, a > 0.0))


def logaddexp(a: Any, b: Any) -> Any:
    """The logarithm of a sum of exponentials."""
    return either(a == b, a + np.log(2.0), ca.fmax(a, b) + ca.log1p(ca.exp(-ca.fabs(a - b))))


def log2(a: Any) -> Any:
    """The logarithm to base 2."""
    return ca.log(a) / float(np.log(2.0))


def log10(a: Any) -> Any:
    """The logarithm to base 10."""
    return ca.log(a) / float(np.log(10.0))


def cbrt(a: Any) -> Any:
    """The cubic root, with the sign of `a`."""
    return ca.copysign(ca.fabs(a) ** (1.0 / 3.0), a)
