"""Algebraic loops, solved at the start and at each communication point."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim import Results, SetupError, Simulation, SimulationError, System, simulate
from fmu_export.modelling.model import Model
from fmu_export.modelling.variables import Variable
from fmu_export.native.backend import build_native
from tests.support.compilation import shared_compilation
from tests.support.native_fmus import require_compiler
from tests.support.small_fmus import redescribed


def loop(first: Callable[..., Any], second: Callable[..., Any], size: int | None = None) -> System:
    """Two functions that feed each other."""
    system = System()
    shape = {"u": size} if size else ["u"]
    outputs = {"y": size} if size else ["y"]
    system.add_function("p", first, inputs=shape, outputs=outputs)
    system.add_function("q", second, inputs=shape, outputs=outputs)
    system.connect("p.y", "q.u")
    system.connect("q.y", "p.u")
    return system


@pytest.mark.parametrize("gain", [0.5, 1.0, 2.0, 10.0, 100.0, 1000.0, -0.5, -3.0])
def test_a_scalar_loop_of_any_gain_is_solved(gain: float) -> None:
    """Y = K (1 + t - y), where a plain iteration diverges from K = 1 on."""
    results = simulate(loop(lambda t, u: gain * u, lambda t, u: 1.0 + t - u), 0.5, 0.1, iterations="auto")
    np.testing.assert_allclose(results["p.y"], gain * (1.0 + results.time) / (1.0 + gain), rtol=1e-9)
    assert results.info["iterations"]["points"] == 7  # that of the initialisation, too
    assert results.info["iterations"]["largest_residual"] < 1e-10


def test_a_loop_that_is_not_linear_is_solved_with_few_exchanges() -> None:
    """Y = cos(y + t): the Jacobian of one point serves the next ones."""
    results = simulate(loop(lambda t, u: np.cos(u), lambda t, u: u + t), 1.0, 0.01, iterations="auto")
    np.testing.assert_allclose(results["p.y"], np.cos(results["p.y"] + results.time), atol=1e-9)
    assert results.info["iterations"]["exchanges"] < 4 * 101


def test_a_run_that_goes_on_from_a_state_counts_on() -> None:
    system = loop(lambda t, u: np.cos(u), lambda t, u: u + t)
    with Simulation(system, iterations="auto") as simulation:
        expected = simulation.run(1.0, 0.1)
        with simulation.start(0.1) as begun:
            begun.step(4)
            state = begun.save()
    with Simulation(system, iterations="auto") as simulation, simulation.start(0.1) as resumed:
        resumed.restore(state)
        resumed.step(6)
        assert resumed.results.info["iterations"] == expected.info["iterations"]


@pytest.mark.parametrize("n", range(3, 13, 3))
def test_vectors_are_solved(n: int) -> None:
    rng = np.random.default_rng(n)
    a, b = (rng.normal(size=(n, n)) / np.sqrt(n) for _ in range(2))
    shift = rng.normal(size=n)
    system = loop(lambda t, u: np.tanh(a @ u), lambda t, u: b @ u + shift, n)
    results = simulate(system, 0.1, 0.1, iterations="auto")
    y = np.array([results[f"p.y[{i + 1}]"][-1] for i in range(n)])
    np.testing.assert_allclose(y, np.tanh(a @ (b @ y + shift)), atol=1e-9)
    assert len(results.info["iterations"]["torn"]) == n


def test_a_solution_beyond_a_fold_is_found() -> None:
    """From y = 0 the residual of y = 5 arctan(y - 7) + 12 falls up to y = 5, rises, and is zero at 19.4."""
    results = simulate(loop(lambda t, u: 5.0 * np.arctan(u - 7.0), lambda t, u: u + 12.0), 0.1, 0.1, iterations="auto")
    u = results["q.y"]
    np.testing.assert_allclose(u, 5.0 * np.arctan(u - 7.0) + 12.0, rtol=1e-9)
    assert u[-1] > 19.0


def test_steep_vectors_are_solved_where_newton_is_lost() -> None:
    """Outputs are bounded, so that there is a solution; their slopes are so steep that most of these defeat Newton."""
    rng = np.random.default_rng(0)
    for _ in range(10):
        n = int(rng.integers(3, 13))
        a, b, shift = rng.normal(size=(n, n)), rng.normal(size=(n, n)), rng.normal(size=n)
        system = loop(lambda t, u, a=a: np.tanh(a @ u), lambda t, u, b=b, shift=shift: b @ u + shift, n)
        results = simulate(system, 0.1, 0.1, iterations="auto", record=["p.y"])
        y = results.values[-1]
        np.testing.assert_allclose(y, np.tanh(a @ (b @ y + shift)), atol=1e-8)


def test_a_loop_without_a_solution_is_named_with_its_residual() -> None:
    with pytest.raises(SimulationError, match=r"loop through 'p\.y' has no solution that 50 iterations .* residual"):
        simulate(loop(lambda t, u: u**2 + 1.0, lambda t, u: u), 0.1, 0.1, iterations="auto")
    with pytest.raises(SimulationError, match="no solution that 1 iterations"):
        simulate(loop(lambda t, u: np.exp(-u), lambda t, u: u), 0.1, 0.1, iterations=1)


def test_what_makes_no_sense_is_refused() -> None:
    system = loop(lambda t, u: 0.5 * u, lambda t, u: u)
    with pytest.raises(SetupError, match=r"algebraic loop .*iterations='auto'"):
        simulate(system, 0.1, 0.1)
    with pytest.raises(SetupError, match="iterations = 0 must be a positive whole number, or 'auto'"):
        simulate(system, 0.1, 0.1, iterations=0)
    with pytest.raises(SetupError, match="solves none"):
        simulate(system, 0.1, 0.1, iterations="auto", order="parallel")
    whole = System()
    for name in "pq":
        whole.add_function(name, lambda t, u: int(u), inputs={"u": int}, outputs={"y": int})
    whole.connect("p.y", "q.u")
    whole.connect("q.y", "p.u")
    with pytest.raises(SetupError, match="only connections between real values can be iterated"):
        simulate(whole, 0.1, 0.1, iterations="auto")


def test_a_system_without_a_loop_gives_the_same_bits() -> None:
    def system() -> System:
        made = System()
        made.add_function("p", lambda t, u: np.sin(u), inputs=["u"], outputs=["y"], start={"u": 0.3})
        made.add_function("q", lambda t, u: u**2, inputs=["u"], outputs=["y"])
        made.connect("p.y", "q.u")
        return made

    with_it, without = simulate(system(), 1.0, 0.1, iterations="auto"), simulate(system(), 1.0, 0.1)
    np.testing.assert_array_equal(with_it.values, without.values)
    assert "iterations" not in with_it.info


#: x' = u, and y = x + u / 2 depends on u at once.
LEAKY = Model(
    name="Leaky",
    inputs=[Variable("u")],
    outputs=[Variable("y"), Variable("x")],
    parameters=[Variable("x_start", start=1.0)],
    states=["x"],
    initial_state=lambda p: p,
    derivatives=lambda t, x, u, p: u,
    output_values=lambda t, x, u, p: np.stack([x[0] + 0.5 * u[0], x[0]]),
)


@pytest.fixture(scope="module")
def leaky(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require_compiler()
    with shared_compilation():
        return build_native(LEAKY, tmp_path_factory.mktemp("leaky"), "fmi2")


def test_rates_in_an_algebraic_loop_are_not_known(leaky: Path) -> None:
    """Inputs in it go straight by default; whoever demands more is told why not."""
    system = System()
    system.add("a", leaky, {"x_start": 1.0})
    system.add("b", leaky, {"x_start": 0.5})
    system.connect("a.y", "b.u", factor=0.5)
    system.connect("b.y", "a.u", factor=-0.5)
    found = simulate(system, 0.02, 0.01, iterations="loops").info["extrapolation"]
    assert found["linear"] == ["a.u", "b.u"]
    with pytest.raises(SetupError, match=r"the derivative of 'b.u' is not known, because 'a.y' is a part of an"):
        simulate(system, 0.02, 0.01, iterations="loops", extrapolation="hermite")


def test_directional_derivatives_give_the_jacobian_where_all_fmus_have_them(leaky: Path, tmp_path: Path) -> None:
    """Steep connections: u_1 = -30 y_2 and u_2 = 20 y_1; with a function between them there are differences only."""

    def run(first: Path, *, with_function: bool = False) -> Results:
        system = System()
        system.add("a", first, {"x_start": 1.0})
        system.add("b", leaky, {"x_start": 0.5})
        system.connect("a.y", "b.u", factor=20.0, offset=1.0)
        if with_function:
            system.add_function("f", lambda t, u: -30.0 * u, inputs=["u"], outputs=["y"])
            system.connect("b.y", "f.u")
            system.connect("f.y", "a.u")
        else:
            system.connect("b.y", "a.u", factor=-30.0)
        return simulate(system, 0.02, 0.01, iterations="loops", record=["a.y", "b.y", "a.x", "b.x"])

    directed, differences = run(leaky), run(leaky, with_function=True)
    text = 'providesDirectionalDerivative="true"'
    silent = run(redescribed(leaky, tmp_path / "silent.fmu", {text: ""}))
    found = [results.info["iterations"] for results in (directed, differences, silent)]
    assert [each["jacobian"] for each in found] == ["directional derivatives", "differences", "differences"]
    # y = x + u / 2, so y_1 + 15 y_2 = x_1 and y_2 - 10 y_1 = x_2 + 1 / 2
    x, y = (np.array([directed[f"a.{n}"], directed[f"b.{n}"]]) for n in "xy")
    exact = np.linalg.solve(np.array([[1.0, 15.0], [-10.0, 1.0]]), x + np.array([[0.0], [0.5]]))
    np.testing.assert_allclose(y, exact, rtol=1e-9)
    np.testing.assert_allclose(directed.values, silent.values, rtol=1e-8)
    np.testing.assert_allclose(directed.values, differences.values, rtol=1e-8)
    assert found[0]["largest_residual"] < 1e-10
    assert found[0]["iterations"] <= 2 * found[0]["points"]  # it is linear
    assert found[0]["exchanges"] <= found[2]["exchanges"]


@pytest.mark.parametrize("interface", ["model-exchange", "co-simulation"])
def test_a_loop_of_fmus_is_solved_in_each_stage_or_at_each_point(leaky: Path, interface: str) -> None:
    """Two of them with u_1 = -y_2, u_2 = y_1: a linear system of its own, whose solution turns and decays."""
    system = System()
    system.add("a", leaky, {"x_start": 1.0}, interface=interface)
    system.add("b", leaky, {"x_start": 0.0}, interface=interface)
    system.connect("b.y", "a.u", factor=-1.0)
    system.connect("a.y", "b.u")
    # y = x + u / 2, u = (-y_2, y_1)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    matrix = turn @ np.linalg.inv(np.eye(2) - 0.5 * turn)
    with Simulation(system, iterations="auto", extrapolation="linear") as simulation:
        results = simulation.run(2.0, 0.01)
        with simulation.start(0.01) as run:
            run.step(50)
            state = run.save()
            run.step(10)
            run.restore(state)
            run.step(150)
            np.testing.assert_array_equal(run.results.values, results.values)
    x = np.column_stack([results["a.x"], results["b.x"]])
    u = np.column_stack([results["a.u"], results["b.u"]])
    np.testing.assert_allclose(u, x @ matrix.T, atol=1e-9)
    step = sum(np.linalg.matrix_power(0.01 * matrix, k) / np.prod(np.arange(1, k + 1)) for k in range(5))
    expected = [np.array([1.0, 0.0])]
    for _ in results.time[1:]:
        expected.append(step @ expected[-1])
    np.testing.assert_allclose(x, expected, atol=1e-9 if interface == "model-exchange" else 2e-4)
