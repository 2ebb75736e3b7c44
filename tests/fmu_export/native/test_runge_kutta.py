"""The integrator's step as C computes what `rk4_step` computes with the model's numpy functions."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.modelling.functions import rk4_defect, rk4_step
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.native.c_source import c_function
from fmu_export.native.elementary import declarations, elementary_sources
from fmu_export.native.runge_kutta import defect_source, runge_kutta_source
from fmu_export.native.toolchain import compile_library, host_target
from fmu_export.trace.trace import trace
from plant_fmu.model import MODEL as PLANT

#: Its rates are sums and products that numpy and C round alike, and depend on time, states, inputs and parameters.
POLYNOMIAL = Model(
    name="Polynomial",
    description="Rates that both languages round alike",
    parameters=Layout([Variable("a", "1", "Parameter", size=2, start=(0.7, -0.3))]),
    inputs=Layout([Variable("u", "1", "Input", size=2)]),
    outputs=Layout([Variable("x", "1", "State", size=3)]),
    states=("x",),
    initial_state=lambda p: np.stack([p[0], p[1], p[0]]),
    derivatives=lambda t, x, u, p: np.stack([x[1] * u[0] + t, p[1] * x[2] - x[0] * x[1], u[1] + t * p[0]]),
    output_values=lambda t, x, u, p: x,
    default_experiment=DefaultExperiment(1.0, 0.1),
)


def compiled(model: Model, folder: Path):
    """`model_step` and `model_defect` in C, and what is traced of the model."""
    traced = trace(model)
    rates = c_function(traced.rates, ("t", "x", "u", "p"))
    source = (
        "#include <math.h>\n#ifdef _WIN32\n#define SHOWN __declspec(dllexport)\n#else\n"
        '#define SHOWN __attribute__((visibility("default")))\n#endif\n' + declarations([traced.rates]) + rates
    )
    source += f"SHOWN\n{runge_kutta_source(traced.rates)}SHOWN\n{defect_source(traced.rates)}"
    path = folder / f"step{host_target().suffix}"
    path.write_bytes(compile_library({"step.c": source.encode(), **elementary_sources(source.encode())}, "step"))
    return traced, ctypes.CDLL(str(path))


def c_step(model: Model, folder: Path):
    traced, library = compiled(model, folder)

    def call(t, x, u, p, h, u_rate, k1):
        given = [np.ascontiguousarray(v, dtype=float) for v in (x, u + h / 2.0 * u_rate, u + h * u_rate, p, k1)]
        y, stages = np.full(len(x), np.nan), np.full((3, traced.rates.numel_out(0)), np.nan)
        pointers = [v.ctypes.data_as(ctypes.c_void_p) for v in (*given, y, stages)]
        library.model_step(ctypes.c_double(t), ctypes.c_double(h), *pointers)
        return y, stages[:, : len(x)]

    return call


def kept(derivatives, stages: list[np.ndarray]):
    """Derivatives that go to a list, too."""

    def call(*arguments):
        stages.append(np.asarray(derivatives(*arguments), dtype=float))
        return stages[-1]

    return call


@pytest.mark.parametrize("model", [POLYNOMIAL, PLANT, CONTROLLER], ids=lambda m: m.name)
def test_step_is_that_of_numpy(model: Model, tmp_path: Path) -> None:
    step = c_step(model, tmp_path)
    rng = np.random.default_rng(5)
    p, x = model.parameters.starts, model.initial_state(model.parameters.starts)
    for _ in range(20):
        t, h = rng.uniform(0.0, 10.0), rng.uniform(1e-4, 1e-2)
        u, u_rate = rng.uniform(-0.5, 0.5, (2, len(model.inputs)))
        at = x + rng.uniform(-0.01, 0.01, len(x))
        k1 = model.derivatives(t, at, u, p)
        stages: list[np.ndarray] = []
        found, found_stages = step(t, at, u, p, h, u_rate, k1)
        expected = rk4_step(kept(model.derivatives, stages), t, at, u, p, h, u_rate, k1)
        np.testing.assert_allclose(found_stages, stages, rtol=1e-10, atol=1e-10)
        assert np.abs(expected - at).max() > 1e-6
        if model is POLYNOMIAL:
            np.testing.assert_array_equal(found, expected)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


def test_inputs_move_within_a_step(tmp_path: Path) -> None:
    """The integral of an input that rises linearly is exact, which a held input's is not."""
    step = c_step(POLYNOMIAL, tmp_path)
    zero, p = np.zeros(3), np.array([0.0, 0.0])
    y, _ = step(0.0, zero, np.array([0.0, 2.0]), p, 0.5, np.array([0.0, 8.0]), np.array([0.0, 0.0, 2.0]))
    assert y[2] == 2.0 * 0.5 + 8.0 * 0.5**2 / 2.0


def test_defect_is_that_of_numpy(tmp_path: Path) -> None:
    """And the rates behind it are those after a quarter of the step, of which the margins are checked."""
    traced, library = compiled(POLYNOMIAL, tmp_path)
    rng = np.random.default_rng(6)
    p = POLYNOMIAL.parameters.starts
    for _ in range(20):
        (t, h), x, u = rng.uniform(0.1, 1.0, 2), rng.uniform(-1.0, 1.0, 3), rng.uniform(-1.0, 1.0, 2)
        stages = rng.uniform(-1.0, 1.0, (4, 3))
        at_quarter: list[np.ndarray] = []
        expected = rk4_defect(kept(POLYNOMIAL.derivatives, at_quarter), t, x, u, p, h, [*stages])
        rates, found = np.full(traced.rates.numel_out(0), np.nan), np.full(3, np.nan)
        pointers = [v.ctypes.data_as(ctypes.c_void_p) for v in (x, u, p, stages[0], stages[1:], rates, found)]
        library.model_defect(ctypes.c_double(t), ctypes.c_double(h), *pointers)
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal([rates], at_quarter)


def test_defect_falls_by_the_fourth_power() -> None:
    """Of a step that is one by Simpson's rule, where the rates depend on time only."""
    sizes = []
    for h in (0.4, 0.2, 0.1):
        stages: list[np.ndarray] = []
        rates, nothing = kept(lambda t, x, u, p: np.cos(t) + 0.0 * x, stages), np.zeros(0)
        rk4_step(rates, 1.0, np.zeros(1), nothing, nothing, h)
        (defect,) = rk4_defect(rates, 1.0, np.zeros(1), nothing, nothing, h, stages[:4])
        sizes.append(abs(defect))
    orders = np.log2(np.divide(sizes[:-1], sizes[1:]))
    assert np.all(np.abs(orders - 4.0) < 0.2), orders
