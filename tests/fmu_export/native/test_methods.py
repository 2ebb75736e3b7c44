"""The integration methods in C, step by step: their order, the Jacobian, the LU factors, what can't be solved.

Oracles are scipy's DOP853 and dense linear algebra of numpy.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from ctypes import c_double, c_int
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fmu_export.modelling.model import Model, Solver
from fmu_export.native import implicit
from fmu_export.native.backend import _adapter_sources
from fmu_export.native.c_source import model_sources
from fmu_export.native.implicit import implicit_parts
from fmu_export.native.toolchain import compile_library, host_target
from fmu_export.package.interface import interface_of
from fmu_export.trace.trace import trace
from tests.support import SUPPORT
from tests.support.native_fmus import doubles, require_compiler
from tests.support.stiff_models import diffusion, model, robertson, smooth

pytestmark = pytest.mark.slow  # what the solvers come to is tested in test_solvers.py by default

BOTH = pytest.mark.parametrize("solver", ["dopri5", "rodas4"])
ORDER = {"dopri5": 5, "rodas4": 4}


class Method:
    """The method of a model, compiled from the sources of its FMU."""

    def __init__(self, folder: Path, of: Model) -> None:
        require_compiler()
        traced = trace(of)
        interface = interface_of(traced)
        adapter = {n: s for n, s in _adapter_sources("fmi2", of.solver).items() if not n.startswith("fmi2")}
        sources = adapter | model_sources(traced, interface, "{}")
        sources["method_steps.c"] = (SUPPORT / "method_steps.c").read_bytes()
        library = folder / f"{of.name}{host_target().suffix}"
        library.write_bytes(compile_library(sources, "method", strict=True))
        self._library = ctypes.CDLL(str(library))
        self._library.method_steps.restype = c_double
        self._parameters = doubles([v.start or 0.0 for v in interface.variables[: interface.n_parameters]])
        self.n_u = interface.n_inputs

    def steps(
        self, n: int, time: float, h: float, x: Sequence[float], u: Sequence[float] = (), rate: Sequence[float] = ()
    ) -> tuple[np.ndarray, float]:
        """States after n steps of length h, and the estimated error of the last one."""
        states = doubles(x)
        inputs = doubles([*u, 0.0]), doubles([*(rate or [0.0] * len(u)), 0.0])
        error = self._library.method_steps(c_int(n), c_double(time), c_double(h), states, *inputs, self._parameters)
        return np.array(states), error

    def solve(self, jacobian: np.ndarray, shift: float, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solution of (shift I - J) x = b, and what it leaves of b."""
        x, residual = doubles(b), doubles(b)
        self._library.solve(doubles([*jacobian, 0.0]), c_double(shift), doubles(b), x, residual)
        return np.array(x), np.array(residual)


Compile = Callable[[Model], Method]


@pytest.fixture
def compiled(tmp_path: Path) -> Compile:
    return lambda of: Method(tmp_path, of)


def exact(of: Model, start: Sequence[float], end: float, u: Callable[[float], Sequence[float]]) -> np.ndarray:
    p = of.parameters.starts
    solution = solve_ivp(
        lambda t, x: of.derivatives(t, x, np.array(u(t)), p), (0.0, end), start, "DOP853", rtol=1e-13, atol=1e-14
    )
    assert solution.success
    return np.array(solution.y[:, -1])


@BOTH
@pytest.mark.parametrize("rate", [0.0, 0.4], ids=["held input", "linear input"])
def test_the_error_falls_with_the_order_of_the_method(compiled: Compile, solver: Solver, rate: float) -> None:
    of = smooth(solver)
    method = compiled(of)
    expected = exact(of, [1.0, -1.0], 2.0, lambda t: [0.5 + rate * t])
    errors = [
        np.abs(method.steps(n, 0.0, 2.0 / n, [1.0, -1.0], [0.5], [rate])[0] - expected).max() for n in (10, 20, 40)
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"errors {errors}, orders {orders}")
    assert (np.abs(orders - ORDER[solver]) < 0.4).all()
    assert errors[-1] < 1e-6


@BOTH
def test_the_estimate_is_of_one_order_less(compiled: Compile, solver: Solver) -> None:
    """The error of one step is h times its order's power: order 4 or 3 in the solution is 5 or 4 in one step."""
    method = compiled(smooth(solver))
    estimates = [method.steps(1, 0.3, h, [1.0, -1.0], [0.5], [0.4])[1] for h in (0.2, 0.1, 0.05)]
    assert all(e > 0.0 for e in estimates)
    assert (np.abs(np.log2(np.array(estimates[:-1]) / estimates[1:]) - ORDER[solver]) < 0.4).all()


@BOTH
def test_a_polynomial_of_the_time_is_integrated_exactly(compiled: Compile, solver: Solver) -> None:
    """As x' = 4 t^3: of degree less than the order, so one long step is right; needs the derivative by the time."""
    of = model("Power", ("x",), (0.0,), lambda t, x, u, p: np.reshape(4.0 * t**3, (1,)), solver)
    states, _ = compiled(of).steps(1, 1.0, 2.0, [1.0])
    assert states[0] == pytest.approx(81.0, rel=1e-14)


def test_a_stiff_component_is_damped_at_once(compiled: Compile) -> None:
    """L-stability: x' = -1e8 x is (nearly) at rest after one step of 1 s."""
    of = model("Decay", ("x",), (1.0,), lambda t, x, u, p: -1e8 * x, "rodas4")
    assert abs(compiled(of).steps(1, 0.0, 1.0, [1.0])[0][0]) < 1e-6


def matrix_of(of: Model, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian's entries in the order of the FMU, and the matrix, by complex steps through the numpy functions."""
    parts, p, u = implicit_parts(trace(of)), of.parameters.starts, of.inputs.starts
    entries = np.array(parts.jacobian(0.5, x, u, p).full().ravel())
    columns = [of.derivatives(0.5, x + 1e-30j * e, u, p).imag / 1e-30 for e in np.eye(len(x))]
    return entries, np.stack(columns, axis=1)


@pytest.mark.parametrize("of", [smooth("rodas4"), robertson(), diffusion("rodas4")], ids=lambda m: m.name)
def test_linear_systems_are_those_of_dense_algebra(compiled: Compile, of: Model) -> None:
    n = len(of.states)
    rng = np.random.default_rng(5)
    x, b = rng.uniform(0.1, 1.0, n), rng.standard_normal(n)
    entries, dense = matrix_of(of, x)
    method = compiled(of)
    for shift in (1e-2, 3.0, 1e6):
        found, residual = method.solve(entries, shift, b)
        expected = np.linalg.solve(shift * np.eye(n) - dense, b)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-13 * np.abs(expected).max())
        size = np.abs(found).max() * (shift + np.abs(entries).max())
        assert np.abs(residual).max() < 1e-13 * size


def test_the_plate_fills(compiled: Compile) -> None:
    """Else the test above would say little of fill."""
    parts = implicit_parts(trace(diffusion("rodas4")))
    assert parts.sizes["N_JACOBIAN"] == 5 * 200 - 2 * (10 + 20)
    assert 1.5 * parts.sizes["N_JACOBIAN"] < parts.sizes["N_FACTORS"] < 6000


@pytest.mark.parametrize("of", [smooth("rodas4"), robertson(), diffusion("rodas4")], ids=lambda m: m.name)
@pytest.mark.slow
def test_a_jacobian_by_directions_is_the_one_that_is_written_out(
    compiled: Compile, of: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    n = len(of.states)
    x, u = np.random.default_rng(6).uniform(0.1, 1.0, n), of.inputs.starts
    written = compiled(of).steps(3, 0.0, 1e-3, x, u)[0]
    monkeypatch.setattr(implicit, "MOST_WRITTEN", 0)
    other = replace(of, name=f"{of.name}ByDirections")
    parts = implicit_parts(trace(other))
    colours = np.array(parts.colours)
    pattern = np.array(trace(other).derivatives.jac_sparsity(0, 1).get_triplet())
    for row in range(n):
        seen = colours[pattern[1][pattern[0] == row]]
        assert len(set(seen)) == len(seen)
    assert colours.max() + 1 <= 7
    np.testing.assert_allclose(compiled(other).steps(3, 0.0, 1e-3, x, u)[0], written, rtol=1e-12, atol=1e-15)


def test_the_derivative_by_the_time_has_that_of_the_inputs() -> None:
    of = smooth("rodas4")
    found = implicit_parts(trace(of)).time_derivative(0.7, [2.0, 3.0], [0.5], [], [0.25]).full().ravel()
    np.testing.assert_allclose(found, [-np.sin(0.7) - 2.0 * 0.25, 0.0], rtol=1e-15)


def test_elimination_that_loses_digits_halves_the_step(compiled: Compile) -> None:
    """With shift = 4 / h near J[0, 0] and J[1, 1] the first pivot is none, though the matrix is regular."""

    def derivatives(t: Any, x: Any, u: Any, p: Any) -> Any:
        return np.stack([1.1 * x[0] + 0.7 * x[1], 0.9 * x[0] + 1.1 * x[1]])

    method = compiled(model("Pivot", ("x", "y"), (1.0, 1.0), derivatives, "rodas4"))
    for nearly in (1.0, 1.0 + 3e-12):
        assert method.steps(1, 0.0, 4.0 / 1.1 * nearly, [1.0, 1.0])[1] == 16.0
    assert method.steps(1, 0.0, 3.0, [1.0, 1.0])[1] != 16.0
    assert 0.0 < method.steps(1, 0.0, 0.01, [1.0, 1.0])[1] < 1.0


@pytest.mark.parametrize(
    ("name", "derivatives", "start", "expected"),
    [
        ("Singular", lambda t, x, u, p: np.stack([x[1] - x[0], x[0] - x[1]]), (1.0, 0.0), None),
        ("Constant", lambda t, x, u, p: np.array([2.0, -3.0]) + 0.0 * x, (1.0, 0.0), (1.2, -0.3)),
        ("Nothing", lambda t, x, u, p: 0.0 * x, (1.0, 5.0), (1.0, 5.0)),
    ],
)
@BOTH
def test_jacobians_that_are_singular_or_zero(
    compiled: Compile, solver: Solver, name: str, derivatives: Any, start: Any, expected: Any
) -> None:
    method = compiled(model(name, ("x", "y"), start, derivatives, solver))
    found, _ = method.steps(10, 0.0, 0.01, start)
    if expected is None:
        expected = 0.5 + 0.5 * np.exp(-0.2), 0.5 - 0.5 * np.exp(-0.2)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_an_infinite_derivative_of_a_derivative_is_left_out(compiled: Compile) -> None:
    """At x = 0 of x' = 1 - sqrt(x) the root has no derivative: the step is one without that entry."""
    of = model("Root", ("x",), (0.0,), lambda t, x, u, p: 1.0 - np.sqrt(x), "rodas4")
    found, _ = compiled(of).steps(1, 0.0, 1e-6, [0.0])
    assert found[0] == pytest.approx(1e-6, rel=2e-3)
