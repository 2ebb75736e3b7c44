"""Models that switch, limit and look up: traced to Python and C they compute what numpy computes."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca
import fmpy
import numpy as np
import pytest

from fmu_export import DefaultExperiment, Layout, Model, Variable, build_native
from fmu_export.errors import TraceError
from fmu_export.trace.straight_line import python_source
from fmu_export.trace.trace import trace
from tests.support.native_fmus import DEFAULT_FLAVOUR

POINTS = [(a, b) for a in (-2.0, -0.5, -0.0, 0.0, 0.3, 0.5, 1.7) for b in (-0.5, 0.0, 0.3)]
SIZE = len(POINTS)
A, B = (np.array(column) for column in zip(*POINTS, strict=True))


#: What a controller may need beyond smooth functions, each of two vectors.
SWITCHING = {
    "limit": lambda a, b: np.clip(a, -0.5, 0.5),
    "smaller": lambda a, b: np.minimum(a, b),
    "larger": lambda a, b: np.maximum(a, b),
    "sign": lambda a, b: np.sign(a),
    "abs": lambda a, b: np.abs(a),
    "where": lambda a, b: np.where(a > b, 2.0 * a, b - 1.0),
    "both": lambda a, b: np.where(np.logical_and(a > 0.0, b > 0.0), a, b),
    "either": lambda a, b: np.where(np.logical_or(a > 0.0, b > 0.0), a, b),
    "differ": lambda a, b: np.where(a != b, a, 7.0),
    "not": lambda a, b: np.where(np.logical_not(a > b), a, 7.0),
    "quantised": lambda a, b: np.floor(10.0 * a) / 10.0,
    "dead zone": lambda a, b: np.where(np.abs(a) < 0.4, 0.0, a - 0.4 * np.sign(a)),
    "table": lambda a, b: np.interp(a, [-1.0, 0.0, 2.0], [3.0, 1.0, -1.0]),
}


def model_of(**outputs) -> Model:
    """Outputs of two input vectors a and b, without states."""
    return Model(
        name="Switching",
        description="Switching",
        parameters=Layout([]),
        inputs=Layout([Variable(n, "1", n, size=SIZE) for n in "ab"]),
        outputs=Layout([Variable(name, "1", name, size=SIZE) for name in outputs]),
        states=(),
        initial_state=lambda p: np.zeros(0),
        derivatives=lambda t, x, u, p: np.zeros(0),
        output_values=lambda t, x, u, p: np.concatenate([f(u[:SIZE], u[SIZE:]) for f in outputs.values()]),
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.01),
    )


@pytest.mark.parametrize("name", SWITCHING)
def test_in_python(name):
    f = SWITCHING[name]
    namespace = {}
    exec(python_source([(trace(model_of(y=f)).outputs, ("t", "x", "u", "p"))]), namespace)
    np.testing.assert_array_equal(namespace["outputs"](0.0, [], [*A, *B], []), f(A, B))


@pytest.mark.skipif(DEFAULT_FLAVOUR != "fmi2", reason="there is no C compiler")
def test_in_c(tmp_path):
    path = build_native(model_of(**{f"y{i}": f for i, f in enumerate(SWITCHING.values())}), tmp_path, "fmi2")
    starts = {f"{n}[{i + 1}]": v for n, values in (("a", A), ("b", B)) for i, v in enumerate(values.tolist())}
    found = fmpy.simulate_fmu(str(path), stop_time=0.1, start_values=starts, fmi_type="CoSimulation")
    for i, (name, f) in enumerate(SWITCHING.items()):
        column = [found[f"y{i}[{k + 1}]"][-1] for k in range(SIZE)]
        np.testing.assert_array_equal(column, f(A, B), err_msg=name)


def test_helpers_keep_nan():
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    value = ca.vertcat(ca.fmin(a, b), ca.fmax(a, b), ca.sign(a + b))
    namespace = {}
    exec(python_source([(ca.Function("f", [a, b], [value]), ["a", "b"])]), namespace)
    assert np.isnan(namespace["f"]([math.nan], [1.0])).all()
    assert np.isnan(namespace["f"]([1.0], [math.nan])).all()
    assert namespace["f"]([1.0], [2.0]) == [1.0, 2.0, 1.0]


@pytest.mark.parametrize(
    ("outputs", "message"),
    [
        (lambda t, x, u, p: u if u[0] > 0 else -u, r"Switching: .*test_switching.py:\d+: an `if`, .* np.where"),
        (lambda t, x, u, p: u * max(u[0], u[1]), "np.maximum"),
        (lambda t, x, u, p: u[:2].reshape(1, 2), r"Switching: output_values returns an array of shape \(1, 2\)"),
        (lambda t, x, u, p: u * math.sin(t), r"Switching: .*test_switching.py:\d+: math.*, .* np.sin"),
    ],
)
def test_what_cannot_be_traced_is_said_with_the_remedy(outputs, message):
    model = replace(model_of(y=lambda a, b: a), inputs=Layout([Variable("u", "1", "u", size=SIZE)]))
    with pytest.raises(TraceError, match=message):
        trace(replace(model, output_values=outputs))
