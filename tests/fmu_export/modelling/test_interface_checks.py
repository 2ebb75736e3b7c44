"""What a model, its variables and its functions must be is checked when they are made, in one line that names them."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fmu_export.errors import ArgumentError
from fmu_export.modelling.model import DefaultExperiment, Model, Requirement
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.trace.composition import CompositionError, compose
from tests.support.tiny_models import INTEGRATOR


def model(**changes: Any) -> Model:
    """A tank with one parameter, one input and one state, with changes."""
    arguments: dict[str, Any] = {
        "name": "Tank",
        "description": "A tank",
        "parameters": [Variable("A", "m2", start=2.0)],
        "inputs": [Variable("inflow", "m3/s")],
        "outputs": [Variable("level", "m"), Variable("flows", "m3/s", size=2)],
        "states": ["level"],
        "initial_state": lambda p: np.zeros(1),
        "derivatives": lambda t, x, u, p: u / p,
        "output_values": lambda t, x, u, p: np.concatenate([x, u, 2.0 * u]),
        "default_experiment": DefaultExperiment(10.0, 0.1),
    }
    return Model(**(arguments | changes))


def refusal(**changes: Any) -> str:
    with pytest.raises(ArgumentError) as caught:
        model(**changes)
    said = str(caught.value)
    assert "\n" not in said
    return said


def test_lists_arrays_and_tuples_are_taken_alike() -> None:
    made = model(parameters=(Variable("A", "m2", size=2, start=np.array([1.0, 2.0])),), requirements=[])
    assert made.parameters.names == ("A[1]", "A[2]")
    assert made.states == ("level",)
    assert made.requirements == ()
    assert isinstance(made.inputs, Layout)
    for starts in ([1, 2], (1.0, 2.0), np.array([1, 2]), np.array([1.0, 2.0], dtype=np.float32), range(1, 3)):
        v = Variable("v", size=np.int64(2), start=starts)
        assert v.starts == (1.0, 2.0)
        assert all(type(s) is float for s in v.starts)
    assert hash(Variable("v", size=2, start=[1, 2])) == hash(Variable("v", size=2, start=(1.0, 2.0)))
    assert Variable("v", size=np.array([2, 3])).size == Variable("v", size=[2, 3]).size == (2, 3)
    hash(made)  # traces are kept by their models


@pytest.mark.parametrize(
    "name",
    [
        *("", "../evil", "a/b", "a\\b", "C:evil", "a.b", "a b", "1a", "a-b", "Größe", "a\n", "a\0", " a"),
        *("double", "int", "restrict", "_Bool", "class", "main", "lambda", "None", "fmi2DoStep", "fmi3GetFloat64"),
        *("CON", "nul", "com1", "A" * 101),
        *(None, 7, b"Tank"),
    ],
)
def test_names_of_models_are_identifiers(name: Any) -> None:
    assert refusal(name=name).startswith(f"model: the name {name!r} ")


@pytest.mark.parametrize("name", ["Tank", "_x", "T1", "doubles", "fmi", "A" * 100])
def test_identifiers_are_taken(name: str) -> None:
    assert model(name=name).name == name


@pytest.mark.parametrize("name", ["../evil", "a.b", "double", "grösse", ""])
def test_names_of_components_are_identifiers(name: str) -> None:
    with pytest.raises(CompositionError, match=f"^component: the name {re.escape(repr(name))} "):
        compose("Whole", "", {name: INTEGRATOR}, [], DefaultExperiment(1.0, 0.1))


@pytest.mark.parametrize(
    "name",
    [
        *(
            "",
            "a b",
            "a\tb",
            "a\n",
            "a.",
            ".a",
            "a..b",
            "1a",
            "a[0",
            "a[]",
            "a[1, 2]",
            "a[x]",
            "a[1][2]",
            "a-b",
            "winkel_ä",
        ),
        *("der(a)", "time", "'a b'", "a = b", "a" * 201, "<a>", 'a"b', None, 3),
    ],
)
def test_names_of_variables_are_structured_names(name: Any) -> None:
    with pytest.raises(ArgumentError, match=f"^variable {re.escape(repr(name))}: the name "):
        Variable(name)


@pytest.mark.parametrize("name", ["a", "_a1", "a.b", "a[1].b[2,3]", "A.time", "der", "a" * 200])
def test_structured_names_are_taken(name: str) -> None:
    assert Variable(name).names == (name,)


@pytest.mark.parametrize(
    ("group", "variables", "twice"),
    [
        ("inputs", [Variable("A")], "A"),
        ("outputs", [Variable("level"), Variable("inflow")], "inflow"),
        ("inputs", [Variable("flows")], "flows"),
        ("inputs", [Variable("flows[2]")], r"flows\[2\]"),
        ("inputs", [Variable("A", size=3)], "A"),
    ],
)
def test_names_are_unique_in_all_groups(group: str, variables: list[Variable], twice: str) -> None:
    assert re.fullmatch(f"Tank: variable names are not unique: {twice}", refusal(**{group: variables}))


def test_names_that_the_exporter_adds_are_its_own() -> None:
    assert "'max_step': every FMU with states has a parameter of this name" in refusal(inputs=[Variable("max_step")])
    stateless = {"states": (), "initial_state": lambda p: p[:0], "derivatives": lambda t, x, u, p: x}
    assert model(parameters=[Variable("max_step")], **stateless).parameters.names == ("max_step",)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"start": math.nan}, "variable 'k': the start value is nan, which is not a finite number"),
        ({"start": math.inf}, "variable 'k': the start value is inf, which is not a finite number"),
        ({"start": "1.0"}, "variable 'k': the start value is '1.0', which is not a finite number"),
        ({"start": [1.0, math.nan], "size": 2}, "variable 'k': a start value is nan, which is not a finite number"),
        ({"start": [[1.0, 2.0]], "size": 2}, "variable 'k' has 2 elements but 1 x 2 start values"),
        ({"min": math.nan}, "variable 'k': min is nan, which is not a finite number"),
        ({"max": -math.inf}, "variable 'k': max is -inf, which is not a finite number"),
        ({"min": 2.0, "max": 1.0}, "variable 'k': min 2.0 is greater than max 1.0"),
        (
            {"size": 0},
            "variable 'k': size is 0; give the number of elements or the shape, each at least 1, or None for a scalar",
        ),
        ({"size": -1}, "variable 'k': size is -1; give the number"),
        ({"size": 2.0}, "variable 'k': size is 2.0; give the number"),
        ({"tunable": "yes"}, "variable 'k': tunable is 'yes'; it must be True or False"),
        ({"size": True}, "variable 'k': size is True; give the number"),
        ({"unit": "wibble"}, "variable 'k': unit 'wibble': 'wibble' is not defined"),
        ({"unit": "K", "display_unit": "bar"}, "variable 'k': the units differ: K and bar"),
        ({"unit": "K", "display_unit": "wibble"}, "variable 'k': unit 'wibble': 'wibble' is not defined"),
        ({"unit": None}, "variable 'k': "),
        ({"description": "two\nlines"}, r"variable 'k': the description has the character '\n'"),
        ({"description": "\x00"}, r"variable 'k': the description has the character '\x00'"),
        ({"description": None}, "variable 'k': the description is None, which is not a text"),
    ],
)
def test_numbers_and_texts_of_a_variable(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        Variable(**({"name": "k"} | changes))
    assert str(caught.value).startswith(said)


def test_infinite_limits_are_none() -> None:
    v = Variable("k", min=-math.inf, max=math.inf)
    assert v.min is None
    assert v.max is None


@pytest.mark.parametrize("group", ["parameter", "input"])
@pytest.mark.parametrize(
    ("variable", "said"),
    [
        (Variable("k", start=3.0, max=2.0), "'k': the start value 3.0 is outside [-inf, 2.0], its min and max"),
        (Variable("k", min=1.0), "'k': the start value 0.0 is outside [1.0, inf], its min and max"),
        (Variable("k", size=2, start=(1, 0), min=1, max=4), "'k[2]': the start value 0.0 is outside [1.0, 4.0]"),
    ],
)
def test_start_values_are_within_the_limits(group: str, variable: Variable, said: str) -> None:
    assert refusal(**{f"{group}s": [variable]}).startswith(f"Tank: {group} {said}")


def test_outputs_have_no_start_values_to_check() -> None:
    assert model(outputs=[Variable("level", "m", min=1.0), Variable("flows", size=2)]).states == ("level",)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"states": ("height",)},
            "Tank: state 'height' is neither an output nor a local; declare one of this name, known are level",
        ),
        ({"states": ("level", "level")}, "Tank: states: variable names are not unique: level"),
        ({"states": "level"}, "Tank: states is 'level'; give a tuple of names of outputs"),
        ({"states": 3}, "Tank: states is 3; give a tuple of names of outputs"),
        ({"states": None}, "Tank: states is None; give a tuple"),
        ({"inputs": Variable("u")}, "Tank: inputs is Variable("),
        ({"inputs": ["u"]}, "Tank: inputs: a Layout is made of Variables, and 'u' is not one"),
        ({"inputs": [Variable("u"), Variable("u")]}, "Tank: inputs: variable names are not unique: u"),
        ({"outputs": [Variable("level", tunable=True)]}, "Tank: 'level' is not a parameter; only parameters can be"),
        ({"requirements": [lambda t, x, u, p: 1.0]}, "Tank: requirements is "),
        ({"derivatives": None}, "Tank: derivatives is not a function"),
        ({"initial_state": np.zeros(1)}, "Tank: initial_state is not a function"),
        ({"default_experiment": 10.0}, "Tank: default_experiment is 10.0, no DefaultExperiment"),
        ({"description": "a\x07"}, r"Tank: the description has the character '\x07'"),
    ],
)
def test_parts_of_a_model(changes: dict[str, Any], said: str) -> None:
    assert refusal(**changes).startswith(said)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((0.0, 0.1), "stop_time 0.0 is not after start_time 0.0"),
        ((1.0, 0.1, 2.0), "stop_time 1.0 is not after start_time 2.0"),
        ((1.0, 0.0), "step_size 0.0 is not positive"),
        ((1.0, -1.0), "step_size -1.0 is not positive"),
        ((math.inf, 0.1), "stop_time is inf, which is not a finite number"),
        ((1.0, math.nan), "step_size is nan, which is not a finite number"),
        ((1.0, 0.1, None), "start_time is None, which is not a finite number"),
    ],
)
def test_default_experiments(arguments: tuple[Any, ...], said: str) -> None:
    with pytest.raises(ArgumentError, match=re.escape(f"default experiment: {said}")):
        DefaultExperiment(*arguments)


def test_integers_of_an_experiment_become_floats() -> None:
    experiment = DefaultExperiment(10, np.float32(0.5))  # type: ignore[arg-type]
    assert repr(experiment) == "DefaultExperiment(stop_time=10.0, step_size=0.5, start_time=0.0)"


def test_requirements() -> None:
    with pytest.raises(ArgumentError, match="at is 'now'; it must be 'start' or 'step'"):
        Requirement("m", lambda t, x, u, p: 1.0, at="now")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="the message of a requirement has the character"):
        Requirement("two\nlines", lambda t, x, u, p: 1.0)


def test_an_output_with_the_name_of_a_state_is_the_state() -> None:
    """It is refused where it is something else, and traced as the state even where nothing is compared."""
    from fmu_export.errors import TraceError
    from fmu_export.trace.trace import trace

    other = replace(INTEGRATOR, output_values=lambda t, x, u, p: 3.0 * x)
    with pytest.raises(TraceError, match=r"element x: the output has the name of a state, which is .*another name"):
        trace(other)
    assert float(trace(other, unchecked=True).outputs(0.0, 5.0, 0.0, [0.0, 1.0])) == 5.0
