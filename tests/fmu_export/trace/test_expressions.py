"""Expressions of the trace, each alone: what numpy computes, for symbols, constants and negatives alike."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import pytest

from fmu_export.trace.symbols import expressions
from fmu_export.trace.symbols.expressions import as_written

X, Y = ca.SX.sym("x"), ca.SX.sym("y")

#: Argument forms: the expression of a symbol, and its value by that of the symbol.
FORMS: dict[str, Callable[[Any], Any]] = {"symbol": lambda s: s, "negative": lambda s: -s}
CONSTANTS = (0.0, 1.0, -1.0, 2.5)

SPECIAL = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 7.75, 1e9 + 0.5, 1e-9, math.inf)
NUMBERS = (*SPECIAL, *(-v for v in SPECIAL), math.nan)


def evaluated(expression: Any, x: Any, y: Any = 0.0) -> np.ndarray:
    """An expression of x and y for many values."""
    f = ca.Function("f", [X, Y], [expression])
    return np.array([float(f(*pair)) for pair in np.broadcast(x, y)])


def traced(f: Callable[..., Any], *arguments: Any) -> Any:
    with as_written():
        return f(*arguments)


def forms(symbol: Any, value: float) -> list[tuple[str, Any, float]]:
    """Name, expression and value of an argument: a symbol, its negative, and constants."""
    with as_written():
        of_symbol = [(name, form(symbol), form(value)) for name, form in FORMS.items()]
    return [*of_symbol, *((str(c), ca.SX(c), c) for c in CONSTANTS)]


@pytest.mark.parametrize("name", ["plus", "minus", "times", "divided"])
def test_arithmetic_of_symbols_negatives_and_constants(name: str) -> None:
    x, y = 1.3, -0.7
    f = getattr(expressions, name)
    exact = {"plus": np.add, "minus": np.subtract, "times": np.multiply, "divided": np.divide}[name]
    cases = list(product(forms(X, x), forms(Y, y)))
    assert len(cases) == 36
    for (one, a, left), (other, b, right) in cases:
        if name == "divided" and right == 0.0:
            continue
        found = evaluated(traced(f, a, b), x, y)
        assert found == exact(left, right), (name, one, other)
    with as_written():
        assert evaluated(traced(f, X, X), x) == exact(x, x)
        assert evaluated(traced(f, -X, -X), x) == exact(-x, -x)


def test_terms_and_factors_that_change_nothing_are_left_out() -> None:
    zero, one, two = ca.SX(0.0), ca.SX(1.0), ca.SX(2.0)
    for found in (
        traced(expressions.plus, X, zero),
        traced(expressions.plus, zero, X),
        traced(expressions.minus, X, zero),
        traced(expressions.times, one, X),
        traced(expressions.times, X, one),
        traced(expressions.divided, X, one),
    ):
        assert ca.is_equal(found, X)
    for found in (traced(expressions.times, zero, X), traced(expressions.times, X, zero)):
        assert found.is_constant()
        assert float(found) == 0.0
    # signs come first, so that what differs in its sign only is computed once
    with as_written():
        negative = -X
    for found in (
        traced(expressions.times, negative, Y),
        traced(expressions.times, Y, negative),
        traced(expressions.times, two, negative),
        traced(expressions.times, ca.SX(-1.0), X),
        traced(expressions.divided, negative, Y),
        traced(expressions.divided, Y, negative),
        traced(expressions.minus, zero, X),
        traced(expressions.minus, negative, Y),
    ):
        assert found.is_op(ca.OP_NEG)
    for found in (traced(expressions.plus, Y, negative), traced(expressions.plus, negative, Y)):
        assert found.is_op(ca.OP_SUB)
    assert traced(expressions.minus, Y, negative).is_op(ca.OP_ADD)
    assert traced(expressions.times, X, X).is_op(ca.OP_SQ)
    # the square of a root is not its operand, which may be negative
    assert np.isnan(evaluated(traced(lambda: expressions.squared(ca.sqrt(X))), -1.0)).all()


@pytest.mark.parametrize("n", [*range(-4, 9), 16, 100, -100, 101, 0.5, -0.5, 1.5])
def test_powers(n: float) -> None:
    x = np.array([0.3, 1.0, 1.07, 2.0])
    np.testing.assert_allclose(evaluated(traced(expressions.power, X, ca.SX(n)), x), x**n, rtol=1e-13)
    if n == int(n):
        np.testing.assert_allclose(evaluated(traced(expressions.power, X, ca.SX(n)), -x), (-x) ** n, rtol=1e-13)


def test_powers_that_are_products_and_roots() -> None:
    def operations(n: Any) -> list[int]:
        f = ca.Function("f", [X, Y], [traced(expressions.power, X, n)])
        kinds = [f.instruction_id(k) for k in range(f.n_instructions())]
        return [k for k in kinds if k not in (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)]

    assert operations(ca.SX(0.5)) == [ca.OP_SQRT]
    assert operations(ca.SX(0.0)) == operations(ca.SX(1.0)) == []
    assert operations(ca.SX(4.0)) == [ca.OP_SQ, ca.OP_SQ]
    assert operations(ca.SX(3.0)) == [ca.OP_SQ, ca.OP_MUL]
    assert set(operations(ca.SX(100.0))) == {ca.OP_SQ, ca.OP_MUL}
    for general in (ca.SX(101.0), ca.SX(-101.0), ca.SX(1.5), Y):
        assert set(operations(general)) <= {ca.OP_POW, ca.OP_CONSTPOW}
        assert operations(general)
    np.testing.assert_allclose(evaluated(traced(expressions.power, X, Y), 1.7, 2.3), 1.7**2.3, rtol=1e-15)


ONE_ARGUMENT: dict[str, Callable[[Any], Any]] = {
    "truncated": np.trunc,
    "is_nan": np.isnan,
    "rint": np.rint,
    "log2": np.log2,
    "log10": np.log10,
    "cbrt": np.cbrt,
}

TWO_ARGUMENTS: dict[str, Callable[[Any, Any], Any]] = {
    "mod": np.mod,
    "floor_divide": np.floor_divide,
    "fmin": np.fmin,
    "fmax": np.fmax,
    "heaviside": np.heaviside,
    "logaddexp": np.logaddexp,
    "xor": lambda a, b: np.logical_xor(a != 0.0, b != 0.0),
}


@pytest.mark.parametrize("name", ONE_ARGUMENT)
def test_functions_of_one_argument(name: str) -> None:
    x = np.array(NUMBERS)
    found = evaluated(traced(getattr(expressions, name), X), x)
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(found, ONE_ARGUMENT[name](x), rtol=1e-14, err_msg=name)


@pytest.mark.parametrize("name", TWO_ARGUMENTS)
def test_functions_of_two_arguments(name: str) -> None:
    finite = name in ("mod", "floor_divide")  # what is left of infinity is the platform's
    numbers = [v for v in NUMBERS if not (finite and math.isinf(v))]
    x, y = (a.ravel() for a in np.meshgrid(numbers, numbers))
    found = evaluated(traced(getattr(expressions, name), X, Y), x, y)
    with np.errstate(all="ignore"):
        expected = TWO_ARGUMENTS[name](x, y)
    if name == "logaddexp":  # numpy has the larger of two infinities; here their difference is none
        kept = np.isfinite(x) & np.isfinite(y)
        found, expected = found[kept], expected[kept]
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-300, err_msg=name)


@pytest.mark.parametrize("name", ["whole_mod", "whole_floor_divide"])
def test_divisions_of_whole_numbers(name: str) -> None:
    whole = [-7, -6, -2, -1, 0, 1, 3, 6, 7]
    x, y = (a.ravel() for a in np.meshgrid(whole, whole))
    found = evaluated(traced(getattr(expressions, name), X, Y), x, y)
    with np.errstate(all="ignore"):
        expected = (np.mod if name == "whole_mod" else np.floor_divide)(x, y)
    np.testing.assert_array_equal(found, expected)


def test_a_choice_takes_one_of_two_values() -> None:
    x = np.array([-1.0, 0.0, 2.0, math.nan])
    np.testing.assert_array_equal(
        evaluated(traced(lambda: expressions.either(X < 0.0, Y, 7.0)), x, 3.0), [3.0, 7.0, 7.0, 7.0]
    )
    np.testing.assert_array_equal(evaluated(traced(lambda: expressions.either(X < 0.0, 1.0 / X, 0.0)), 0.0), [0.0])
    for condition, chosen in ((1.0, X), (0.0, Y), (True, X), (False, Y)):
        assert ca.is_equal(traced(expressions.either, condition, X, Y), chosen)


def test_expressions_are_kept_as_written_inside_the_context_only() -> None:
    def simplifies() -> bool:
        return bool((X / X).is_constant())

    assert simplifies()
    with as_written():
        assert not simplifies()
        with as_written(False):
            assert simplifies()
        assert not simplifies()
        with pytest.raises(ZeroDivisionError), as_written(False):
            raise ZeroDivisionError
        assert not simplifies()
    assert simplifies()


def test_what_a_number_is() -> None:
    assert expressions.is_number(ca.SX(2.0))
    assert not expressions.is_number(X)
