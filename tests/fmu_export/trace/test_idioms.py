"""Idioms of numpy in models: what is built is what numpy computes, the rest is refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fmu_export.errors import TraceError
from fmu_export.modelling.model import DefaultExperiment, Layout, Model, Variable
from fmu_export.trace.straight_line import python_source
from fmu_export.trace.trace import trace
from tests.support.idioms import IDIOMS, Idiom

START = (0.3, -1.2, 2.5, 0.7)


def model_of(idiom: Idiom) -> Model:
    """A model without states whose output is a function of its input x (4,) and the time."""
    with np.errstate(all="ignore"):
        try:
            n = max(np.size(idiom.function(np.array(START), 0.0)), 1)
        except Exception:  # numpy refuses it itself
            n = 4
    function = idiom.function  # another one: nothing is kept in it yet
    return Model(
        name="Idiom",
        description="Idiom",
        parameters=Layout([]),
        inputs=Layout([Variable("x", "1", "x", size=4, start=START)]),
        outputs=Layout([Variable("y", "1", "y", size=n)]),
        states=(),
        initial_state=lambda p: np.zeros(0),
        derivatives=lambda t, x, u, p: np.zeros(0),
        output_values=lambda t, x, u, p: function(u, t),
        default_experiment=DefaultExperiment(stop_time=1.0, step_size=0.1),
    )


def agrees(function, traced) -> bool:
    """Whether the generated Python gives numpy's values, where these are finite, at points of its own."""
    namespace: dict = {}
    exec(python_source([(traced.outputs, ("t", "x", "u", "p"))]), namespace)
    rng = np.random.default_rng(5)
    compared = 0
    for k in range(60):
        x = rng.uniform(-3.0, 3.0, 4) if k % 2 else rng.integers(-6, 7, 4) / 2.0
        x, t = np.array(START) if k == 0 else x, float(k) / 7.0
        with np.errstate(all="ignore"):
            try:
                expected = np.asarray(function(x.copy(), t), dtype=float).ravel()
                found = np.array(namespace["outputs"](t, [], x.tolist(), []))
            except (ArithmeticError, ValueError):
                continue  # math raises an error where numpy gives NaN or infinity
        finite = np.isfinite(expected)
        compared += int(finite.any())
        if not np.allclose(found[finite], expected[finite], rtol=1e-10, atol=1e-13):
            return False
    assert compared
    return True


@pytest.mark.parametrize("idiom", IDIOMS, ids=lambda i: f"{i.kind}: {i.code}".replace("\n", "; "))
def test_each_idiom_is_equal_or_refused(idiom: Idiom) -> None:
    if idiom.expected == "equal":
        assert agrees(idiom.function, trace(model_of(idiom)))
    else:
        with pytest.raises(TraceError, match=r"^Idiom: ") as caught:
            trace(model_of(idiom))
        assert "\n" not in str(caught.value)


def test_the_page_is_that_of_the_table() -> None:
    docs = Path(__file__).parents[3] / "docs"
    code = f"import sys; sys.path.insert(0, {str(docs)!r}); from make_numpy_page import page; print(page(), end='')"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, encoding="utf-8")
    assert found.stdout == (docs / "numpy.md").read_text(encoding="utf-8")
