"""Idioms of numpy in models: what is built is what numpy computes, the rest is refused."""

from __future__ import annotations

import subprocess
import sys
import time
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmu_export.errors import TraceError
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.pythonfmu.backend import build_pythonfmu
from fmu_export.trace.check import ROUNDING, Program
from fmu_export.trace.straight_line import python_source
from fmu_export.trace.trace import trace
from tests.support.idioms import IDIOMS, Idiom, composed
from tests.support.more_idioms import MORE_IDIOMS
from tests.support.random_programs import programs

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


def within(found: np.ndarray, expected: np.ndarray, bound: np.ndarray) -> bool:
    return bool((np.abs(found - expected) <= bound).all())


def values_beside(function, x: np.ndarray, t: float) -> np.ndarray:
    """What numpy computes a rounding error beside a point: at a jump the trace may be on its other side."""
    rng = np.random.default_rng(6)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        places = x * (1.0 + 1e-12 * rng.uniform(-1.0, 1.0, (40, 4)))
        return np.array([np.asarray(function(place, t), dtype=float).ravel() for place in places])


def agrees(function, traced) -> bool:
    """Whether trace and generated Python give numpy's values, where these are finite, at points of its own."""
    namespace: dict = {}
    exec(python_source([(traced.outputs, ("t", "x", "u", "p"))], traced.tables), namespace)
    program = Program(traced.outputs, traced.tables)
    rng = np.random.default_rng(5)
    places = [rng.uniform(-3.0, 3.0, 4) if k % 2 else rng.integers(-6, 7, 4) / 2.0 for k in range(1, 60)]
    x, t = np.array([START, *places]), np.arange(60) / 7.0
    points = t, np.zeros((60, 0)), x, np.zeros((60, 0))
    by_trace, bounds = program(points)[0].T, None
    compared = 0
    for k in range(60):
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                expected = np.asarray(function(x[k].copy(), float(t[k])), dtype=float).ravel()
            except (ArithmeticError, ValueError):
                continue
        found = [by_trace[k]]
        with suppress(ArithmeticError, ValueError):  # math raises an error where numpy gives NaN or infinity
            found.append(np.array(namespace["outputs"](float(t[k]), [], x[k].tolist(), [])))
        finite = np.isfinite(expected)
        compared += int(finite.any())
        bound = (1e-10 * np.abs(expected) + 1e-13)[finite]
        if not all(within(f[finite], expected[finite], bound) for f in found):  # where terms cancel, rounding may count
            bounds = program.rounding(points) if bounds is None else bounds
            bound += ROUNDING * bounds[finite, k]
        if not all(within(f[finite], expected[finite], bound) for f in found):
            beside = values_beside(function, x[k], float(t[k]))[:, finite]
            if not all((np.abs(f[finite] - beside) <= 1e-9 * (1.0 + np.abs(beside))).any(axis=0).all() for f in found):
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


@pytest.mark.slow
@pytest.mark.parametrize("code", MORE_IDIOMS)
def test_each_of_many_more_idioms_is_equal_or_refused(code: str) -> None:
    idiom = Idiom("further", code.replace("\\n", "\n"), "equal")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        is_equal_or_refused(idiom)


@pytest.mark.parametrize(
    "examples", [pytest.param(40, id="40 examples"), pytest.param(1500, id="1500 examples", marks=pytest.mark.slow)]
)
def test_idioms_after_each_other_are_equal_or_refused(examples: int) -> None:
    """Each idiom takes the result of the one before; some of those that are refused are among them."""

    @settings(max_examples=examples, deadline=None, derandomize=True, database=None)
    @given(st.lists(st.integers(0, len(IDIOMS) - 1), min_size=2, max_size=4))
    def composed_are(which: list[int]) -> None:
        is_equal_or_refused(composed([IDIOMS[i] for i in which]))

    composed_are()


@pytest.mark.parametrize(
    "examples", [pytest.param(60, id="60 examples"), pytest.param(2500, id="2500 examples", marks=pytest.mark.slow)]
)
def test_random_programs_are_equal_or_refused(examples: int) -> None:
    built = 0

    @settings(
        max_examples=examples, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(programs())
    def programs_are(program: Idiom) -> None:
        nonlocal built
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            built += is_equal_or_refused(program)

    programs_are()
    assert built > examples / 3


def is_equal_or_refused(idiom: Idiom) -> bool:
    """Whether it is equal."""
    try:
        traced = trace(model_of(idiom))
    except TraceError as error:
        found = str(error)
    else:
        assert agrees(idiom.function, traced)
        return True
    assert "\n" not in found
    return False


def test_an_fmu_that_was_not_checked_says_so(tmp_path: Path) -> None:
    """A clock is frozen while tracing: refused, or built on request, and then the file tells."""
    frozen = Idiom("outside", "x + time.time()", "refused")
    with pytest.raises(TraceError, match="traced twice"):
        build_pythonfmu(model_of(frozen), tmp_path)
    for unchecked, idiom in ((True, frozen), (False, Idiom("equal", "2.0 * x", "equal"))):
        path = build_pythonfmu(model_of(idiom), tmp_path, unchecked=unchecked)
        with ZipFile(path) as archive:
            assert ("equations unchecked" in archive.read("modelDescription.xml").decode()) == unchecked


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("x if x[0] > 0 else -x", r"<branch>:2: an `if`.*np.where"),
        ("x * math.sin(t)", r"<branch>:2: math.*np.sin"),
        ("y = x * 2\nx[0] = 1.0\nreturn y", r"<branch>:3: an argument .* is changed.*copy"),
        ("np.unique(x)", r"<branch>:2: np.unique can't be traced; see the page"),
        ("np.add(x, 1.0, where=x > 0)", r"<branch>:2: np.add with where= .*use np.where"),
        ("np.average(x, returned=True)", r"<branch>:2: np.average with these arguments \(returned\)"),
        ("C[0] = x[0]\nreturn x", r"<branch>:2: .*an array of numbers.*make the array by np.zeros"),
        ("import statistics\nreturn statistics.median(x)", r"<branch>:3: an `if`"),
        ("x << 1", r"<branch>:2: <<.*multiply"),
        ("x.sort()\nreturn x", r"<branch>:2: .*\.sort of an array can't be traced"),
        ("{}[3]", r"<branch>:2: 3, while tracing.*the page"),
        ("None", r"output_values returns something other than an array of numbers: NoneType"),
        ("kept.append(1)\nreturn x * len(kept)", "traced twice, the equations differ"),
        ("np.outer(x, C)", r"output_values returns an array of shape \(4, 4\)"),
    ],
)
def test_a_refusal_names_place_and_remedy(code: str, said: str) -> None:
    with pytest.raises(TraceError, match=f"^Idiom: .*{said}"):
        trace(model_of(Idiom("branch", code, "refused")))


def test_a_difference_names_element_values_and_cause() -> None:
    """A branch on the type that no symbol can know: found by comparison."""
    function = Idiom("type", "x if type(x) is np.ndarray else 2.0 * x", "refused")
    with pytest.raises(
        TraceError, match=r"output_values, element y\[1\]: numpy computes 0.3, .* 0.6 at .*likely cause"
    ):
        trace(model_of(function))


def test_the_points_of_the_check_follow_from_the_model_alone() -> None:
    """A slow machine checks at the same points as a fast one."""
    points: list[list[np.ndarray]] = []
    for pause in (0.0, 0.001):
        seen: list[np.ndarray] = []

        def output_values(t, x, u, p, seen=seen, pause=pause):
            if isinstance(t, float) and type(u) is np.ndarray:
                seen.append(np.array([t, *u]))
                time.sleep(pause)
            return np.where(u > 0.7, np.sin(u), u * t)

        trace(replace(model_of(Idiom("points", "x", "equal")), output_values=output_values))
        points.append(seen)
    assert len(points[0]) > 100
    assert np.array_equal(*points)


@pytest.mark.parametrize("other", ["x + 1e-3", "2.0 * x", "np.abs(x)"])
def test_an_output_with_the_name_of_a_state_must_be_the_state(other: str) -> None:
    function = Idiom("state", other, "refused").function
    model = replace(
        model_of(Idiom("state", "x", "equal")),
        outputs=Layout([Variable("y", "1", "y", size=4)]),
        states=("y",),
        initial_state=lambda p: np.zeros(4),
        derivatives=lambda t, x, u, p: -x,
        output_values=lambda t, x, u, p: function(x, t),
    )
    with pytest.raises(TraceError, match=r"element y\[\d\]: the output has the name of a state.* another name"):
        trace(model)


def test_the_page_is_that_of_the_table() -> None:
    docs = Path(__file__).parents[3] / "docs"
    code = f"import sys; sys.path.insert(0, {str(docs)!r}); from make_numpy_page import page; print(page(), end='')"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, encoding="utf-8")
    assert found.stdout == (docs / "numpy.md").read_text(encoding="utf-8")
