"""Solvers of native FMUs in co-simulation: accuracy with default settings, step size, tolerance, states, refusals.

Oracles are scipy's Radau, DOP853 and matrix exponential, and closed solutions.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from fmu_export import ArgumentError, CompositionError, build_pythonfmu, compose
from fmu_export.modelling.model import DefaultExperiment, Model, Requirement, Solver
from fmu_export.modelling.variables import Variable
from tests.support.built_fmus import Built
from tests.support.native_fmus import DISCARD, ERROR, FLAVOURS, OK, Host
from tests.support.stiff_models import diffusion, model, robertson, smooth, van_der_pol
from tests.support.tiny_models import GAIN, INTEGRATOR, LAG

#: The solvers stand below the faces of FMI, which other tests are about.
BOTH = pytest.mark.parametrize(
    "flavour", [FLAVOURS[0], *(pytest.param(f, marks=pytest.mark.slow) for f in FLAVOURS[1:])]
)
ADAPTIVE = pytest.mark.parametrize("solver", [pytest.param("rk43", marks=pytest.mark.slow), "dopri5", "rodas4"])
WARNING = 1

ROBERTSON, VAN_DER_POL = robertson(), van_der_pol()


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    return Built(tmp_path_factory.mktemp("solvers"))


@cache
def radau(of: Model, *times: float) -> np.ndarray:
    """States at the times (n, n_x), orders of magnitude beyond what is asked of the FMUs."""
    p = of.parameters.starts
    solution = solve_ivp(
        lambda t, x: of.derivatives(t, x, of.inputs.starts, p),
        (0.0, times[-1]),
        of.initial_state(p),
        method="Radau",
        rtol=1e-12,
        atol=1e-16,
        t_eval=times,
    )
    assert solution.success
    return np.array(solution.y.T)


# Accuracy with default settings


@BOTH
def test_robertson_is_right_in_one_step(built: Built, flavour: str) -> None:
    """Each of the three, of order 1, 1e-5 and 1, to 1e-6 of itself; after 40 s, then at 1e5 s."""
    of = ROBERTSON
    expected = radau(of, 40.0, 1e5)
    # Hairer, Wanner, section IV.10: values at 40 s that are printed everywhere
    np.testing.assert_allclose(expected[0], [0.7158270688, 0.9185534765e-5, 0.2841637457], rtol=1e-8)
    with built.host(of, flavour) as host:
        host.run_up()
        host.must(host.step(0.0, 40.0))
        np.testing.assert_allclose(host.get(of.states), expected[0], rtol=1e-6)
        host.must(host.step(40.0, 1e5 - 40.0))
        np.testing.assert_allclose(host.get(of.states), expected[1], rtol=1e-6)


@BOTH
@pytest.mark.slow
def test_van_der_pol_is_right_in_steps_of_a_second(built: Built, flavour: str) -> None:
    """Over more than a period of 1614 s; in the jumps, of a few milliseconds, the speed is 1300."""
    of, times = VAN_DER_POL, np.arange(1.0, 2001.0)
    expected = radau(of, *times)
    found = []
    with built.host(of, flavour) as host:
        host.run_up()
        for t in times:
            host.must(host.step(float(t) - 1.0, 1.0))
            found.append(host.get(of.states))
    error = np.abs(np.array(found) - expected)
    print(f"largest errors {error.max(axis=0)}, of the state at the end {error[-1] / np.abs(expected[-1])}")
    assert expected[:, 0].min() < -1.9
    assert (error.max(axis=0) < 1e-6 * np.abs(expected).max(axis=0)).all()
    np.testing.assert_allclose(found[-1], expected[-1], rtol=1e-6)


@ADAPTIVE
def test_a_smooth_model_is_right_in_long_and_in_short_steps(built: Built, solver: Solver) -> None:
    of = smooth(solver)
    expected = solve_ivp(
        lambda t, x: of.derivatives(t, x, [0.5], []), (0.0, 10.0), [1.0, -1.0], "DOP853", rtol=1e-13, atol=1e-14
    ).y[:, -1]
    for n in (1, 7, 1000):
        with built.host(of) as host:
            host.run_up()
            for i in range(n):
                host.must(host.step(10.0 * i / n, 10.0 / n))
            np.testing.assert_allclose(host.get(of.states), expected, rtol=1e-6)


@ADAPTIVE
def test_linear_inputs_are_integrated_as_such(built: Built, solver: Solver) -> None:
    """The input rises with a known slope; one communication step is many internal ones, each with its own input."""
    of = smooth(solver)
    expected = solve_ivp(
        lambda t, x: of.derivatives(t, x, [0.5 + 0.4 * t], []),
        (0.0, 5.0),
        [1.0, -1.0],
        "DOP853",
        rtol=1e-13,
        atol=1e-14,
    ).y[:, -1]
    with built.host(of) as host:
        host.run_up()
        host.must(host.set({"u": 0.5}))
        host.must(host.set_rates({"u": 0.4}))
        host.must(host.step(0.0, 5.0))
        np.testing.assert_allclose(host.get(of.states), expected, rtol=1e-6)
        assert host.get(["u"]) == [pytest.approx(2.5)]


@ADAPTIVE
def test_linear_systems_of_all_kinds_are_right(built: Built, solver: Solver) -> None:
    """Random ones of five states, damped and oscillating, dense and sparse, some with time constants down to 1e-7 s."""
    n = 5
    of = Model(
        name="Linear",
        parameters=[Variable("A", size=(n, n)), Variable("x_0", size=n)],
        inputs=[Variable("u", size=n)],
        outputs=[Variable("x", size=n)],
        states=["x"],
        initial_state=lambda p: p[n * n :],
        derivatives=lambda t, x, u, p: np.reshape(p[: n * n], (n, n)) @ x + u,
        solver=solver,
    )
    tried = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        speed = 10.0 ** rng.uniform(0.0, 7.0 if solver == "rodas4" else 2.5)
        vectors = np.linalg.qr(rng.standard_normal((n, n)))[0] + 0.3 * rng.standard_normal((n, n))
        if np.linalg.cond(vectors) > 30.0:
            continue  # the rounding of the matrix alone would show
        modes = np.diag(-(speed ** rng.uniform(0.0, 1.0, n)))
        modes[0, 1], modes[1, 0] = (w := rng.uniform(0.0, 30.0)), -w
        matrix = vectors @ modes @ np.linalg.inv(vectors)
        if seed % 4 == 0:
            matrix[rng.random((n, n)) < 0.5] = 0.0
        start, u, step = rng.standard_normal(n), (seed % 2) * rng.standard_normal(n), 10.0 ** rng.uniform(-2.0, 1.0)
        if np.linalg.eigvals(matrix).real.max() * step > 5.0:
            continue  # it grows beyond all measure
        tried += 1
        with built.host(of) as host:
            host.must(host.set({f"A[{i + 1},{j + 1}]": matrix[i, j] for i in range(n) for j in range(n)}))
            host.must(host.set({f"{name}[{i + 1}]": v[i] for name, v in (("x_0", start), ("u", u)) for i in range(n)}))
            host.run_up()
            for k in range(3):
                host.must(host.step(k * step, step))
            found = host.get([f"x[{i + 1}]" for i in range(n)])
        whole = expm(3.0 * step * np.block([[matrix, np.eye(n)], [np.zeros((n, 2 * n))]]))
        expected = whole[:n, :n] @ start + whole[:n, n:] @ u
        size = max(np.abs(expected).max(), np.abs(start).max())
        rtol = 1e-5 if solver == "rk43" else 1e-6  # as FMUs have it by default
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=rtol * size, err_msg=f"seed {seed}")
    assert tried > 20


def test_heat_in_a_plate_is_right(built: Built) -> None:
    """200 states whose Jacobian fills in elimination; the solution is a matrix exponential."""
    of = diffusion("rodas4")
    start = of.initial_state(np.zeros(0))
    matrix = np.stack([of.derivatives(0.0, e, [], []) for e in np.eye(200)], axis=1)
    with built.host(of) as host:
        host.run_up()
        for t, h in ((0.0, 0.01), (0.01, 0.09), (0.1, 0.4)):
            host.must(host.step(t, h))
            expected = expm(matrix * (t + h)) @ start
            np.testing.assert_allclose(host.get(of.states), expected, rtol=0.0, atol=1e-6 * expected.max())


@ADAPTIVE
def test_an_importer_can_give_inputs_inside_a_step(built: Built, solver: Solver) -> None:
    """FMI 3.0: u(t) = 0.5 + sin t over 5 s, asked for where the FMU wants it; steps are as long as that allows."""
    of = smooth(solver)
    expected = solve_ivp(
        lambda t, x: of.derivatives(t, x, [0.5 + np.sin(t)], []),
        (0.0, 5.0),
        [1.0, -1.0],
        "DOP853",
        rtol=1e-13,
        atol=1e-14,
    ).y[:, -1]
    asked: list[float] = []

    def give_inputs(time: float) -> None:
        asked.append(time)
        host.must(host.set({"u": 0.5 + np.sin(time)}))

    with built.host(of, "fmi3", intermediate_update=give_inputs) as host:
        host.run_up()
        host.must(host.set({"u": 0.5}))
        host.must(host.step(0.0, 5.0))
        np.testing.assert_allclose(host.get(of.states), expected, rtol=1e-6)
    assert all(0.0 < t <= 5.0 for t in asked)


# Step size


@ADAPTIVE
def test_a_jump_of_an_input_is_met_by_shorter_steps(built: Built, solver: Solver) -> None:
    """Long at rest, so that steps have grown; then the input jumps, and the lag of 1 ms answers within one step."""
    of = replace(LAG, name="FastLag", solver=solver)
    with built.host(of) as host:
        host.run_up({"T": 1e-3, "u": 0.0})
        host.must(host.step(0.0, 100.0))
        host.must(host.set({"u": 1.0}))
        host.must(host.step(100.0, 2e-3))
        assert host.get(["x"]) == [pytest.approx(1.0 - np.exp(-2.0), rel=1e-6)]


@ADAPTIVE
def test_the_step_size_goes_on_and_is_part_of_the_state(built: Built, solver: Solver) -> None:
    """One instance is saved, restored, serialised and reset; its bits are those of one that just runs."""
    of = smooth(solver)

    def run(host: Host, first: int, last: int) -> list[float]:
        for i in range(first, last):
            host.must(host.step(0.3 * i, 0.3))
        return host.get(of.states)

    with built.host(of) as plain, built.host(of) as other:
        plain.run_up()
        half, expected = run(plain, 0, 5), run(plain, 5, 10)
        other.run_up()
        assert run(other, 0, 5) == half
        state, data = other.save(), other.save_bytes()
        assert run(other, 5, 10) == expected
        other.must(other.restore(state))
        assert other.get(of.states) == half
        assert run(other, 5, 10) == expected
        other.must(other.call("Reset"))
        other.must(other.restore_bytes(data))
        assert run(other, 5, 10) == expected
        other.forget(state)
        other.must(other.call("Reset"))
        other.run_up()
        assert run(other, 0, 5) == half


def test_a_jump_within_steps_that_need_no_estimate_is_met(built: Built) -> None:
    """A lag of 20 ms in steps of 1 ms, much shorter than allowed; it becomes one of 50 us, which 1 ms can't do."""
    of = model("Sudden", ("x",), (0.0,), lambda t, x, u, p: (u[0] - x) / u[1], "rk43", inputs={"u": 1.0, "T": 0.02})
    with built.host(of) as host:
        host.run_up()
        for i in range(100):
            host.must(host.step(i * 1e-3, 1e-3))
        assert host.get(["x"]) == [pytest.approx(1.0 - np.exp(-5.0), rel=1e-7)]
        before = host.get(["x"])[0]
        host.must(host.set({"u": 2.0, "T": 5e-5}))
        host.must(host.step(0.1, 1e-4))
        assert host.get(["x"]) == [pytest.approx(2.0 - (2.0 - before) * np.exp(-2.0), rel=1e-5)]


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_rk43_makes_the_steps_of_rk4_where_it_is_told_so_and_where_they_are_short(built: Built, flavour: str) -> None:
    """Bit for bit; steps of 1 s, which are too long, are shortened only where they may be."""

    def run(solver: Solver, values: dict[str, float], step: float) -> list[float]:
        with built.host(smooth(solver), flavour) as host:
            host.run_up(values)
            for i in range(8):
                host.must(host.step(i * step, step))
            return host.get(smooth(solver).states)

    assert run("rk43", {}, 1e-3) == run("rk4", {}, 1e-3)
    fixed = run("rk4", {"max_step": 0.05}, 1.0)
    assert run("rk43", {"rtol": 0.0, "max_step": 0.05}, 1.0) == fixed
    whole = run("rk4", {"max_step": 1.0}, 1.0)
    assert run("rk43", {"rtol": 0.0}, 1.0) == whole
    chosen = run("rk43", {}, 1.0)
    assert chosen != whole
    np.testing.assert_allclose(chosen, run("rk4", {}, 1.0), rtol=1e-5)


def test_a_step_size_from_nowhere_would_show(built: Built) -> None:
    """Else the test above would prove little: who comes to 1.5 s by other steps has other last digits."""
    of = smooth("rodas4")
    with built.host(of) as host, built.host(of) as other:
        host.run_up()
        for i in range(5):
            host.must(host.step(0.3 * i, 0.3))
        other.run_up()
        other.must(other.step(0.0, 1.5))
        assert other.get(of.states) != host.get(of.states)
        np.testing.assert_allclose(other.get(of.states), host.get(of.states), rtol=1e-6)


@ADAPTIVE
def test_max_step_is_a_limit(built: Built, solver: Solver) -> None:
    """A pulse of 10 ms in 100 s of rest: steps that long pass over it, steps of 5 ms see it."""
    of = model(
        "Pulse",
        ("x",),
        (0.0,),
        lambda t, x, u, p: np.reshape(np.exp(-(((t - 50.0) / 0.01) ** 2)), (1,)),
        solver,
    )
    expected = 0.01 * np.sqrt(np.pi)
    for max_step, factor in ((1e300, 0.0), (5e-3, 1.0)):
        with built.host(of) as host:
            host.run_up({"max_step": max_step})
            host.must(host.step(0.0, 100.0))
            assert host.get(["x"]) == [pytest.approx(factor * expected, rel=1e-6, abs=1e-12)]


# Tolerance


@BOTH
@ADAPTIVE
def test_the_importers_tolerance_replaces_the_parameter(built: Built, flavour: str, solver: Solver) -> None:
    of = smooth(solver)
    expected = solve_ivp(
        lambda t, x: of.derivatives(t, x, [0.5], []), (0.0, 10.0), [1.0, -1.0], "DOP853", rtol=1e-13, atol=1e-14
    ).y[:, -1]

    def run(rtol: float, tolerance: float | None = None) -> float:
        with built.host(of, flavour) as host:
            host.must(host.set({"rtol": rtol}))
            host.must(host.enter(tolerance=tolerance))
            host.must(host.exit())
            host.must(host.step(0.0, 10.0))
            assert host.get(["rtol"]) == [rtol]
            return float(np.abs(np.array(host.get(of.states)) / expected - 1.0).max())

    loose, tight = run(1e-2), run(1e-9)
    assert tight < 1e-9
    assert loose > 1e-5
    assert run(1e-2, 1e-9) == tight
    assert run(1e-9, 1e-2) == loose


@BOTH
def test_a_tolerance_out_of_range_is_said(built: Built, flavour: str) -> None:
    of = van_der_pol()
    with built.host(of, flavour) as host:
        assert host.enter(tolerance=1e-15) == WARNING
        assert "the relative tolerance 1e-15 is not between 1e-11 and 0.1: 1e-11 is used" in host.messages
        host.must(host.exit())
        host.must(host.step(0.0, 1.0))
    for wrong in (0.0, -1.0, float("nan")):
        with built.host(of, flavour) as host:
            assert host.enter(tolerance=wrong) == ERROR
            assert "is not positive" in host.messages[-1]


def test_a_tolerance_is_that_of_one_run(built: Built) -> None:
    """Who sets up again without one, and who resets, has the parameter again."""
    of = smooth("dopri5")
    found = []
    for again in (lambda h: h.call("SetupExperiment", 0, 0.0, 0.0, 0, 0.0), lambda h: h.call("Reset"), None):
        with built.host(of) as host:
            if again:
                host.must(host.call("SetupExperiment", 1, 0.1, 0.0, 0, 0.0))
                host.must(again(host))
            host.run_up()
            host.must(host.step(0.0, 10.0))
            found.append(host.get(of.states))
    assert found[0] == found[1] == found[2]


def test_a_fixed_step_takes_any_tolerance(built: Built) -> None:
    with built.host(replace(LAG, name="FixedLag")) as host:
        host.must(host.enter(tolerance=1e-15))
        host.must(host.exit())


@ADAPTIVE
def test_errors_are_weighed_by_the_nominal_value(built: Built, solver: Solver) -> None:
    """A charge of 1e-9 C that decays: small beside 1, the nominal value of a state that has none."""

    def error(nominal: float | None) -> float:
        of = model("Charge" if nominal else "Plain", ("q",), (1e-9,), lambda t, x, u, p: -x * (1.0 + x / 1e-9), solver)
        of = replace(of, outputs=[replace(of.outputs.variables[0], nominal=nominal)])
        with built.host(of) as host:
            host.run_up()
            host.must(host.step(0.0, 3.0))
            expected = 1e-9 / (2.0 * np.exp(3.0) - 1.0)  # of q' = -q - q^2 / q_0
            return abs(host.get(["q"])[0] / expected - 1.0)

    assert error(1e-9) < 1e-6 < 1e-4 < error(None)


# What can't be integrated


@ADAPTIVE
@BOTH
def test_a_requirement_that_is_violated_inside_a_step(built: Built, solver: Solver, flavour: str) -> None:
    """As x' = -1 from 1, it happens at 1 s. The state stays that before the step."""
    of = model(
        "Emptying",
        ("x",),
        (1.0,),
        lambda t, x, u, p: -1.0 + 0.0 * x,
        solver,
        requirements=(Requirement("the tank is empty: fill it", lambda t, x, u, p: x[0]),),
    )
    with built.host(of, flavour) as host:
        host.run_up()
        host.must(host.step(0.0, 0.5))
        before = host.get(["x"])
        assert host.tried(lambda: host.step(0.5, 2.0)) == DISCARD
        time, _, reason = host.messages[-1].partition(" s: ")
        assert float(time.removeprefix("t = ")) == pytest.approx(1.0, abs=1e-6)
        assert reason == "the tank is empty: fill it"
        assert host.get(["x"]) == before == [pytest.approx(0.5)]
        host.must(host.step(0.5, 0.25))
        assert host.get(["x"]) == [pytest.approx(0.25)]


@ADAPTIVE
def test_derivatives_that_are_not_finite_end_in_a_message(built: Built, solver: Solver) -> None:
    """As x' = -1 - sqrt(x) from 1, there is no root after 2 - 2 ln 2 s; with an input that keeps x up it goes on."""
    of = model("Root", ("x",), (1.0,), lambda t, x, u, p: u - 1.0 - np.sqrt(x), solver, inputs={"u": 0.0})
    with built.host(of) as host:
        host.run_up()
        assert host.tried(lambda: host.step(0.0, 2.0)) == DISCARD
        time, _, reason = host.messages[-1].partition(" s: ")
        assert float(time.removeprefix("t = ")) == pytest.approx(2.0 - 2.0 * np.log(2.0), abs=1e-6)
        assert reason.startswith("the derivatives are not finite")
        assert host.get(["x"]) == [1.0]
        host.must(host.set({"u": 3.0}))
        host.must(host.step(0.0, 60.0))
        assert host.get(["x"]) == [pytest.approx(4.0, rel=1e-6)]


@ADAPTIVE
def test_a_solution_without_bound_ends_in_a_message(built: Built, solver: Solver) -> None:
    """As x' = x^2 from 1 it is 1 / (1 - t)."""
    of = model("Explosion", ("x",), (1.0,), lambda t, x, u, p: x * x, solver)
    with built.host(of) as host:
        host.run_up()
        host.must(host.step(0.0, 0.5))
        before = host.get(["x"])
        assert host.step(0.5, 1.0) == DISCARD
        time, _, reason = host.messages[-1].partition(" s: ")
        assert float(time.removeprefix("t = ")) == pytest.approx(1.0, abs=1e-6)
        assert reason.startswith("no internal step is short enough")
        assert host.get(["x"]) == before == [pytest.approx(2.0, rel=1e-6)]


@pytest.mark.parametrize(
    ("solver", "values", "remedy"),
    [
        ("rk4", {}, 'or export the model with solver="dopri5" or, if it is stiff, "rodas4"'),
        ("dopri5", {}, 'export a stiff model with solver="rodas4"'),
        ("rodas4", {"max_step": 1e-4}, 'export a model that is not stiff with solver="dopri5"'),
    ],
)
def test_too_many_internal_steps_end_in_a_message(
    built: Built, solver: Solver, values: dict[str, float], remedy: str
) -> None:
    of = robertson(solver)
    with built.host(of) as host:
        host.run_up(values)
        assert host.step(0.0, 1e4) == DISCARD
        assert "max_step" in host.messages[-1]
        assert remedy in host.messages[-1]
        assert host.get(of.states) == [1.0, 0.0, 0.0]


def test_a_fixed_step_that_is_too_long_for_a_stiff_model_is_named(built: Built) -> None:
    of = robertson("rk4")
    with built.host(of) as host:
        host.run_up()
        assert host.step(0.0, 40.0) == DISCARD
        assert "the state is no longer finite" in host.messages[-1]
        assert "max_step (0.001 s)" in host.messages[-1]
        assert 'solver="rodas4"' in host.messages[-1]


@ADAPTIVE
def test_a_model_that_does_nothing_arrives_in_a_few_steps(built: Built, solver: Solver) -> None:
    of = model("Nothing", ("x", "y"), (0.0, 3.0), lambda t, x, u, p: 0.0 * x, solver)
    with built.host(of) as host:
        host.run_up()
        host.must(host.step(0.0, 1e12))
        assert host.get(["x", "y"]) == [0.0, 3.0]


# The archive


@BOTH
@pytest.mark.parametrize("solver", ["rk4", "rk43", "dopri5", "rodas4"])
def test_an_archive_holds_the_method_that_it_needs(built: Built, flavour: str, solver: Solver) -> None:
    fmu = built.fmu(van_der_pol(solver), flavour)
    assert validate_fmu(str(fmu)) == []
    with zipfile.ZipFile(fmu) as archive:
        sources = {Path(name).name for name in archive.namelist() if name.startswith("sources/")}
    methods = {
        "rk4": {"rk4.c"},
        "rk43": {"adaptive.c", "rk4.c", "rk43.h"},
        "dopri5": {"adaptive.c", "dopri5.c"},
        "rodas4": {"adaptive.c", "rodas4.c", "sparse_lu.h"},
    }
    assert sources & set.union(*methods.values()) == methods[solver]


@pytest.mark.parametrize("solver", ["rk4", "rk43", "dopri5", "rodas4"])
def test_the_parameters_are_those_of_the_solver(built: Built, solver: Solver) -> None:
    variables = fmpy.read_model_description(str(built.fmu(van_der_pol(solver)))).modelVariables
    found = {v.name: (float(v.start), v.min, v.max) for v in variables if v.causality == "parameter"}
    if solver == "rk4":
        assert found == {"mu": (1000.0, None, None), "max_step": (1e-3, "1e-09", None)}
    else:
        assert found == {
            "mu": (1000.0, None, None),
            "rtol": (1e-5, "0.0", "0.1") if solver == "rk43" else (1e-6, "1e-11", "0.1"),
            "max_step": (1e300, "1e-09", None),
        }


def test_model_exchange_is_the_same_with_every_solver(built: Built) -> None:
    def derivatives(solver: Solver) -> list[float]:
        with built.host(van_der_pol(solver), kind="ModelExchange") as host:
            host.run_up().continuous()
            host.must(host.set_states([0.3, -7.0]))
            status, values = host.try_derivatives(2)
            assert status == OK
            return values

    assert derivatives("rk4") == derivatives("dopri5") == derivatives("rodas4") == [-7.0, 1000.0 * 0.91 * -7.0 - 0.3]


def test_fmpy_runs_it(built: Built) -> None:
    found = fmpy.simulate_fmu(
        str(built.fmu(robertson())), stop_time=40.0, output_interval=40.0, fmi_type="CoSimulation"
    )
    np.testing.assert_allclose([found[n][-1] for n in "abc"], [0.7158270688, 0.9185534765e-5, 0.2841637457], rtol=1e-6)


# Refusals


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(LAG, solver="cvode"), "Lag: solver is 'cvode'; known are rk4, rk43, dopri5, rodas4"),
        (lambda: replace(GAIN, solver="rodas4"), "Gain: a model without states has nothing to integrate"),
        (
            lambda: model("Taken", ("x",), (1.0,), lambda t, x, u, p: x, "dopri5", {"rtol": 1.0}),
            "Taken: parameter 'rtol': every FMU with",
        ),
    ],
)
def test_solvers_that_make_no_sense_are_refused(make: Callable[[], Model], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        make()


def test_a_model_with_rk4_may_have_a_parameter_rtol() -> None:
    model("Free", ("x",), (1.0,), lambda t, x, u, p: x, "rk4", {"rtol": 1.0})


@pytest.mark.parametrize("solver", ["dopri5", "rodas4"])
def test_the_pythonfmu_flavour_names_those_that_can(tmp_path: Path, solver: Solver) -> None:
    with pytest.raises(ArgumentError, match=f"VanDerPol: the pythonfmu flavour has no solver '{solver}'.*build_native"):
        build_pythonfmu(van_der_pol(solver), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_composition_has_one_solver() -> None:
    def whole(*solvers: Solver, **options: Any) -> Model:
        parts = {f"c{i}": replace(INTEGRATOR, solver=s) for i, s in enumerate(solvers)}
        return compose("Whole", "Parts", {**parts, "gain": GAIN}, [], DefaultExperiment(1.0, 0.1), **options)

    assert whole("rodas4", "rodas4").solver == "rodas4"
    assert whole("rk4").solver == "rk4"
    assert whole("rodas4", "rk4", solver="dopri5").solver == "dopri5"
    with pytest.raises(CompositionError, match=r"different solvers \(c0: rodas4, c1: rk4\); choose one by solver="):
        whole("rodas4", "rk4")
