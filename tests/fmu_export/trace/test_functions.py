"""numpy functions with arguments that the table of idioms leaves out, values and shapes; and what a trace knows."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from fmu_export.errors import TraceError
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.trace.check import Program
from fmu_export.trace.straight_line import python_source
from fmu_export.trace.trace import TracedModel, trace

POINTS = np.array([[0.3, -1.2, 2.5, 0.7], [-2.0, 0.0, 0.5, 1.0], [1.0, 1.0, -3.0, 123.4], [0.5, 2.0, -0.5, -7.9]])
WHOLE = "(x * 3).astype(int)"
SQUARE = "x.reshape(2, 2)"
CUBE = "np.stack([x, -x, x * x]).reshape(3, 2, 2)"

CODES = {
    "norm": [
        *(
            f"np.linalg.norm({of})"
            for of in (
                "x, keepdims=True",
                f"{SQUARE}, keepdims=True",
                f"{SQUARE}, 'fro', keepdims=True",
                f"{SQUARE}, axis=0",
                f"{SQUARE}, axis=1, keepdims=True",
                f"{SQUARE}, 1, axis=0",
                f"{SQUARE}, 1, axis=1, keepdims=True",
                f"{SQUARE}, np.inf, axis=0, keepdims=True",
                f"{SQUARE}, -np.inf, axis=1",
                "x, 2, keepdims=True",
                "x, -np.inf",
            )
        ),
        *(f"np.linalg.vector_norm({of})" for of in (SQUARE, f"{SQUARE}, axis=0", f"{SQUARE}, axis=1", "x, ord=1")),
    ],
    "sort": [f"np.sort({of})" for of in (SQUARE, f"{SQUARE}, axis=0", f"{SQUARE}, axis=None")]
    + [f"np.sort({CUBE}, axis={axis})" for axis in (0, 1, 2, -1, -2)],
    "median": [f"np.median({of})" for of in ("x", SQUARE, f"{SQUARE}, axis=0", f"{CUBE}, axis=0", f"{CUBE}, axis=1")],
    "places": [
        f"np.{f}({of})" for f in ("argmax", "argmin") for of in ("x", SQUARE, f"{SQUARE}, axis=0", f"{CUBE}, axis=1")
    ],
    "round": [f"np.round({of})" for of in ("x", "x, 2", "x * 100, -1", "x * 1000, -2")],
    "array": [f"np.{f}(x[0])" for f in ("array", "asarray", "atleast_1d", "atleast_2d")]
    + ["np.array(x, ndmin=2)", "np.array([x, x])", "np.array([[x[0]], [2.0]])"],
    "interp": [
        f"np.interp(x, [0.5], [2.0]{ends})" for ends in ("", ", left=-1.0", ", right=x[1]", ", left=x[0], right=7.0")
    ],
    "division": [
        f"{a} {sign} np.array([2{dot}, -2{dot}, 3{dot}, 5{dot}])"
        for a, dot in ((WHOLE, ""), ("x", ".0"), (WHOLE, ".5"))
        for sign in ("//", "%")
    ]
    + [f"{WHOLE} {sign} np.array([0, 1, 0, -1])" for sign in ("//", "%")],
    "powers": [f"np.clip({WHOLE}, -99, 99) ** {n}" for n in (0, 1, 2, 3)],
    "index": [
        f"x[{key}]"
        for key in ("np.array([0, 2])", "np.array([True, False, True, False])", "[1, 2]", "np.argmax([1, 3])")
    ]
    + [f"{SQUARE}[[0, 1], [1, 0]]"],
    "steps": ["np.heaviside(x, 0.25)", "x.astype(int).astype(float) / 4"],
}


def model_of(function: Callable[[Any], Any], **changed: Any) -> Model:
    """A model without states whose outputs are a function of its input x (4,)."""
    size = max(np.size(function(POINTS[0])), 1)
    given: dict[str, Any] = {
        "name": "Function",
        "inputs": Layout([Variable("x", size=4, start=tuple(POINTS[0]))]),
        "outputs": Layout([Variable("y", size=size)]),
        "output_values": lambda t, x, u, p: function(u),
        "default_experiment": DefaultExperiment(1.0, 0.1),
    }
    return Model(**given | changed)


@pytest.mark.parametrize("kind", CODES)
def test_values_and_shapes_are_those_of_numpy(kind: str) -> None:
    functions = [eval(f"lambda x: {code}", {"np": np}) for code in CODES[kind]]

    def with_shape(x: Any) -> Any:
        values = [f(x) for f in functions]
        shapes = [np.array(np.shape(value), dtype=float) for value in values]
        return np.concatenate([*(np.ravel(value) * 1.0 for value in values), *shapes])

    with np.errstate(all="ignore"):
        expected = [with_shape(x) for x in POINTS]
        traced = trace(model_of(with_shape))
    n, none = len(POINTS), np.zeros((len(POINTS), 0))
    found, _ = Program(traced.outputs, traced.tables)((np.zeros(n), none, POINTS, none))
    np.testing.assert_allclose(found.T, expected, rtol=1e-13, atol=1e-300)


@pytest.mark.parametrize("key", ["(x > 0.0).astype(int)", "x.astype(int)[:2]"])
def test_arrays_of_symbols_are_no_indices(key: str) -> None:
    with pytest.raises(TraceError, match=r"values can't be indices; use np\.where, np\.select or np\.interp"):
        trace(model_of(eval(f"lambda x: x[{key}]", {"np": np})))


def test_a_trace_knows_what_depends_on_what_directly() -> None:
    """Derivatives and outputs depend on the inputs, states and parameters that their equations name."""
    traced: TracedModel = trace(
        Model(
            name="Dependent",
            parameters=[Variable("a", start=1.0), Variable("b", start=2.0), Variable("c", start=3.0)],
            inputs=[Variable("u", start=0.5), Variable("v", start=0.25)],
            outputs=[Variable("y"), Variable("z")],
            locals=[Variable("p"), Variable("q")],
            states=["p", "q"],
            initial_state=lambda p: np.stack([p[0], p[1]]),
            derivatives=lambda t, x, u, p: np.stack([p[2] * x[1] + u[0], p[0] * p[1] - x[1]]),
            output_values=lambda t, x, u, p: np.stack([x[1] * u[1], p[1] * x[0] + x[1]]),
            default_experiment=DefaultExperiment(1.0, 0.1),
        )
    )
    assert traced.derivative_parameter_dependencies() == [[2], [0, 1]]
    assert traced.output_parameter_dependencies() == [[], [1], [], []]
    assert traced.output_dependencies() == [[1], [], [], []]
    assert traced.output_state_dependencies() == [[1], [0, 1], [0], [1]]


def test_a_model_is_tried_at_values_that_it_declares() -> None:
    """No parameter or input leaves its limits, or is something else than whole where it is to be."""
    seen: list[tuple[float, ...]] = []

    def output(t: Any, x: Any, u: Any, p: Any) -> Any:
        if type(p[0]) is np.float64:  # else it is a symbol
            seen.append((float(p[0]), float(p[1]), float(u[0]), float(u[1])))
        return np.stack([p[0] + p[1] + u[0] + u[1]])

    trace(
        Model(
            name="Limited",
            parameters=[Variable("low", start=1.5, min=1.0, max=2.0), Variable("whole", start=3, type="integer")],
            inputs=[Variable("u", start=-5.0, min=-10.0, max=-4.0), Variable("free", start=1.0)],
            outputs=[Variable("y")],
            output_values=output,
            default_experiment=DefaultExperiment(1.0, 0.1),
        )
    )
    low, whole, u, free = np.array(seen).T
    assert len(seen) > 100
    assert ((low >= 1.0) & (low <= 2.0)).all()
    assert ((u >= -10.0) & (u <= -4.0)).all()
    assert (whole == np.rint(whole)).all()
    # of all magnitudes where nothing is declared
    assert np.abs(free).max() > 1e6
    assert 0.0 < np.abs(free[free != 0.0]).min() < 1e-2
    for values in (low, whole, u):  # and they are not always the same
        assert len(np.unique(values)) > 9


def test_bounds_of_rounding_errors_are_propagated_to_both_sides() -> None:
    """Of exp(x + 0.1), by hand: half a unit of the sum, carried through exp both ways, and that of exp."""
    x = ca.SX.sym("x", 1)
    f = ca.Function("f", [ca.SX.sym("t"), x, ca.SX.sym("u", 0), ca.SX.sym("p", 0)], [ca.exp(x + 0.1)])
    at = np.array([30.0, 1.7])
    none = np.zeros((2, 0))
    (bound,) = Program(f).rounding((np.zeros(2), at[:, None], none, none))
    total = at + 0.1
    unit = 2.3e-16
    off = total * unit
    carried = np.abs(np.exp(total + off) - np.exp(total)) + np.abs(np.exp(total - off) - np.exp(total))
    np.testing.assert_allclose(bound, np.exp(total) * unit + carried, rtol=1e-12)


def test_whole_numbers_are_exact_as_long_as_they_are_told_apart() -> None:
    x = ca.SX.sym("x", 1)
    f = ca.Function("f", [ca.SX.sym("t"), x, ca.SX.sym("u", 0), ca.SX.sym("p", 0)], [x * 3.0])
    at = np.array([7.0, 1e6, 3e15, 0.3, 3.1e15, 1e17])
    none = np.zeros((6, 0))
    (bound,) = Program(f).rounding((np.zeros(6), at[:, None], none, none))
    exact = [True, True, True, False, False, False]  # 3 * 3.1e15 is above 2^53
    np.testing.assert_allclose(bound, np.where(exact, 0.0, 3.0 * at * 2.3e-16), rtol=1e-12)


def test_long_chains_are_written_in_lines_that_python_can_parse() -> None:
    def chain(x: Any) -> Any:
        value = x[0]
        for k in range(400):
            value = np.sin(value) + 0.001 * k
        return np.stack([value])

    traced = trace(model_of(chain))
    source = python_source([(traced.outputs, ("t", "x", "u", "p"))], traced.tables)
    depths = [max(_depths(line)) for line in source.splitlines() if line]
    assert 3 < max(depths) < 60
    namespace: dict[str, Any] = {}
    exec(source, namespace)
    assert math.isclose(namespace["outputs"](0.0, [], [0.3, 0.0, 0.0, 0.0], [])[0], chain([0.3])[0], rel_tol=1e-12)


def _depths(line: str) -> list[int]:
    depth, found = 0, [0]
    for character in line:
        depth += {"(": 1, ")": -1}.get(character, 0)
        found.append(depth)
    return found
