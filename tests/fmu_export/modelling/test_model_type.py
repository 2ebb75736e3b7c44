"""Variables and layouts: names, start values, and the order of parts in a flat array."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.errors import ArgumentError
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.trace.trace import trace
from plant_fmu.model import MODEL as PLANT
from trajectory_fmu.model import MODEL as TRAJECTORY

SCALAR = Variable("k", "1", "A scalar", start=12.0)
VECTOR = Variable("tau", "N.m", "A vector", size=3, start=(1.0, 2.0, 3.0))
OTHER = Variable("S", "s-1", "One start for all", size=2, start=7.0)


def test_names_of_scalars_and_vectors():
    assert SCALAR.names == ("k",)
    assert VECTOR.names == ("tau[1]", "tau[2]", "tau[3]")
    assert Variable("v", "1", "A vector of one element is still a vector", size=1).names == ("v[1]",)


def test_one_start_value_holds_for_all_elements():
    assert SCALAR.starts == (12.0,)
    assert OTHER.starts == (7.0, 7.0)
    assert VECTOR.starts == (1.0, 2.0, 3.0)
    assert Variable("v", "1", "Start zero by default", size=2).starts == (0.0, 0.0)


def test_start_values_are_plain_floats_whose_text_round_trips():
    v = Variable("v", "1", "Given as numpy and int", size=3, start=(np.float64(0.1), 2, np.float32(0.5)))
    assert [type(s) for s in v.starts] == [float] * 3
    assert [float(repr(s)) for s in v.starts] == [0.1, 2.0, 0.5]


@pytest.mark.parametrize(("size", "start"), [(3, (1.0, 2.0)), (2, (1.0, 2.0, 3.0)), (None, (1.0, 2.0)), (2, ())])
def test_wrong_number_of_start_values_is_refused_with_name_and_numbers(size, start):
    with pytest.raises(ValueError, match=rf"'v' has {size or 1} elements but {len(start)} start values"):
        Layout([Variable("v", "1", "", size=size, start=start)])


def test_duplicate_names_are_refused():
    with pytest.raises(ValueError, match=r"not unique: k$"):
        Layout([SCALAR, SCALAR])
    with pytest.raises(ValueError, match=r"not unique"):  # an element's name taken by a scalar
        Layout([VECTOR, Variable("tau[2]", "N.m", "")])


def test_layout_orders_variables_as_declared():
    layout = Layout([VECTOR, SCALAR, OTHER])
    assert len(layout) == 6
    assert layout.names == ("tau[1]", "tau[2]", "tau[3]", "k", "S[1]", "S[2]")
    np.testing.assert_array_equal(layout.starts, [1, 2, 3, 12, 7, 7])


def test_unpack_gives_scalars_and_vectors():
    parts = Layout([VECTOR, SCALAR, OTHER]).unpack(np.arange(6.0))
    np.testing.assert_array_equal(parts.tau, [0, 1, 2])
    assert np.ndim(parts.k) == 0
    assert parts.k == 3
    np.testing.assert_array_equal(parts.S, [4, 5])


@given(st.lists(st.one_of(st.none(), st.integers(1, 5)), max_size=6), st.randoms(use_true_random=False))
def test_pack_undoes_unpack_whatever_the_order_of_the_keywords(sizes, random):
    layout = Layout([Variable(f"v{i}", "1", "", size=size) for i, size in enumerate([*sizes, None])])
    flat = np.array([random.uniform(-1, 1) for _ in range(len(layout))])
    parts = list(vars(layout.unpack(flat)).items())
    random.shuffle(parts)
    np.testing.assert_array_equal(layout.pack(**dict(parts)), flat)


def test_pack_names_missing_and_undeclared_parts():
    layout = Layout([VECTOR, SCALAR])
    with pytest.raises(TypeError, match=r"differ in: tau$"):
        layout.pack(k=1.0)
    with pytest.raises(TypeError, match=r"differ in: z$"):
        layout.pack(k=1.0, tau=np.zeros(3), z=0.0)


def test_pack_refuses_a_part_of_the_wrong_length():
    with pytest.raises(ValueError, match="reshape"):
        Layout([VECTOR, SCALAR]).pack(tau=np.zeros(2), k=1.0)


def test_empty_layout():
    layout = Layout([])
    assert len(layout) == 0
    assert layout.names == ()
    assert layout.starts.shape == (0,)
    assert vars(layout.unpack(np.zeros(0))) == {}


@pytest.mark.parametrize("model", [PLANT, CONTROLLER, TRAJECTORY], ids=lambda m: m.name)
def test_states_are_outputs_and_layouts_do_not_overlap(model):
    assert set(model.state_layout.names) <= set(model.outputs.names)
    names = [*model.parameters.names, *model.inputs.names, *model.outputs.names]
    assert len(set(names)) == len(names)


def test_what_a_model_does_not_need_can_be_left_out():
    gain = Model(
        name="Gain",
        inputs=Layout([Variable("u")]),
        outputs=Layout([Variable("y", "N.m")]),
        output_values=lambda t, x, u, p: 2.0 * u,
    )
    assert (gain.description, gain.states, len(gain.parameters)) == ("", (), 0)
    assert gain.default_experiment == DefaultExperiment(stop_time=1.0, step_size=0.01)
    traced = trace(gain)
    assert traced.initial_state([]).shape == (0, 1)
    assert traced.derivatives(0.0, [], [3.0], []).shape == (0, 1)
    assert traced.outputs(0.0, [], [3.0], []).full().tolist() == [[6.0]]
    decay = Model(
        name="Decay",
        outputs=Layout([Variable("x")]),
        states=("x",),
        initial_state=lambda p: np.ones(1),
        derivatives=lambda t, x, u, p: -x,
    )
    assert trace(decay).outputs(0.0, [0.3], [], []).full().tolist() == [[0.3]]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"derivatives": lambda t, x, u, p: x}, "M: there are states, but no initial_state; give the function"),
        ({"initial_state": lambda p: np.zeros(1)}, "M: there are states, but no derivatives; give the function"),
        (
            {"initial_state": lambda p: np.zeros(1), "derivatives": lambda t, x, u, p: x, "outputs": "xy"},
            "M: 'y' has no value; give output_values",
        ),
    ],
)
def test_what_a_model_needs_can_not_be_left_out(options, message):
    outputs = Layout([Variable(name) for name in options.pop("outputs", "x")])
    with pytest.raises(ArgumentError) as caught:
        Model(**{"name": "M", "outputs": outputs, "states": ("x",)} | options)
    assert str(caught.value) == message
