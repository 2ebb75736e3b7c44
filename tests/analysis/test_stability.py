"""Transition matrices and stable steps: against recurrences by hand, multistep methods, and coupled FMUs."""

from __future__ import annotations

import math
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.linalg

from cosim import SetupError, System, simulate
from cosim.analysis import (
    LinearComponent,
    LinearSystem,
    growth_along,
    largest_stable_step,
    largest_stable_step_along,
    spectral_radius,
    transition_matrix,
)
from cosim.analysis.stability import exponential
from cosim.errors import ArgumentError
from cosim.master.coupling import algorithm
from cosim.master.coupling.algorithm import Order
from tests.support.tiny_models import GAIN, LAG, build

INTEGRATOR = LinearComponent([[0.0]], [[1.0]], [[1.0]], [[0.0]], ["u"], ["x"])
LOOP = [("i.x", "g.u"), ("g.y", "i.u")]


def gain(K: float) -> LinearComponent:
    return LinearComponent((), (), (), [[K]], ["u"], ["y"])


def feedback(K: float) -> LinearSystem:
    """Couple an integrator and a gain to x' = -K x."""
    return LinearSystem({"i": INTEGRATOR, "g": gain(-K)}, LOOP)


def eigenvalues(matrix: np.ndarray) -> np.ndarray:
    """Those that are not zero, in an order of their own."""
    values = np.linalg.eigvals(matrix)
    return np.sort_complex(values[np.abs(values) > 1e-9])


def roots(*coefficients: float) -> np.ndarray:
    return np.sort_complex(np.roots(coefficients))


# The test equation x' = -K x, a = K h


@pytest.mark.parametrize("a", [0.2, 0.9, 3.0])
@pytest.mark.parametrize(
    ("order", "extrapolation", "polynomial"),
    [
        ("sequential", "hold", lambda a: (1, a - 1)),  # x+ = x - a x
        ("parallel", "hold", lambda a: (1, -1, a)),  # x+ = x - a x_1, of the step before
        ("sequential", "linear", lambda a: (1, 1.5 * a - 1, -0.5 * a)),  # x+ = x - a (3 x - x_1) / 2
        # the gain's input is extrapolated to 2 x_1 - x_2 when its output is read
        ("parallel", "linear", lambda a: (1, -1, 3 * a, -2.5 * a, 0.5 * a)),
    ],
)
def test_eigenvalues_are_the_roots_of_the_recurrence_by_hand(order, extrapolation, polynomial, a):
    h = 0.25
    matrix = transition_matrix(feedback(a / h), h, order=order, extrapolation=extrapolation)
    np.testing.assert_allclose(eigenvalues(matrix), roots(*polynomial(a)), atol=1e-9)


@pytest.mark.parametrize(
    ("extrapolation", "limit"), [("hold", 2.0), ("linear", 1.0), ("auto", 1.0), ("quadratic", 6 / 11), ("cubic", 0.3)]
)
def test_gauss_seidel_of_an_integrator_is_adams_bashforth(extrapolation, limit):
    """An integrator steps a polynomial exactly: the limits are those of these methods on the real axis."""
    K = 5.0
    assert largest_stable_step(feedback(K), extrapolation=extrapolation) == pytest.approx(limit / K, rel=2e-4)


def test_eigenvalues_of_the_quadratic_extrapolation_are_those_of_adams_bashforth_3():
    a, h = 0.4, 0.1
    matrix = transition_matrix(feedback(a / h), h, extrapolation="quadratic")
    expected = roots(1, 23 / 12 * a - 1, -16 / 12 * a, 5 / 12 * a)
    np.testing.assert_allclose(eigenvalues(matrix), expected, atol=1e-9)


def test_an_order_that_is_registered_is_analysed_as_it_arranges(monkeypatch):
    def sets_first(sets, gets):
        return [op for operations in (*sets.values(), *gets.values()) for op in operations]

    monkeypatch.setitem(algorithm.ORDERS, "late", Order("late", "", "", sets_first, needs_levels=False))
    a, h = 0.3, 0.5
    matrix = transition_matrix(feedback(a / h), h, order="late", extrapolation="hold")
    np.testing.assert_allclose(eigenvalues(matrix), roots(1, -1, 0, a), atol=1e-9)  # x+ = x - a x_2


def test_a_stable_system_may_have_no_stable_step():
    """The oscillator x' = v, v' = -x by the explicit Euler method: the radius is sqrt(1 + h^2)."""
    negative = LinearComponent([[0.0]], [[-1.0]], [[1.0]], [[0.0]], ["u"], ["x"])
    oscillator = LinearSystem({"x": INTEGRATOR, "v": negative}, [("v.x", "x.u"), ("x.x", "v.u")])
    assert spectral_radius(oscillator, 0.1, extrapolation="hold") == pytest.approx(math.hypot(1.0, 0.1), rel=1e-12)
    with pytest.raises(ArgumentError, match=r"unstable even at a communication step of 0\.0001 s"):
        largest_stable_step(oscillator, extrapolation="hold")


def test_a_system_without_feedback_is_stable_at_any_step():
    lag = LinearComponent([[-1.0]], [[1.0]], [[1.0]], [[0.0]], ["u"], ["x"])
    assert largest_stable_step(LinearSystem({"a": lag, "b": lag}, [("a.x", "b.u")])) == math.inf


# Several states, inputs and outputs


def random_loop(seed: int, points: tuple[int, ...] = ()) -> LinearSystem:
    """Plant (4 states, 3 inputs, 6 outputs without feedthrough) and controller (2 states) with feedthrough."""
    generator = np.random.default_rng(seed)

    def random(*shape: int) -> np.ndarray:
        return generator.standard_normal((*points, *shape))

    y, u = [f"y[{i}]" for i in range(1, 7)], [f"u[{i}]" for i in range(1, 4)]
    plant = LinearComponent(random(4, 4), random(4, 3), random(6, 4), np.zeros((*points, 6, 3)), u, y)
    controller = LinearComponent(random(2, 2), random(2, 6), random(3, 2), random(3, 6), y, u)
    return LinearSystem({"p": plant, "c": controller}, [("p.y", "c.y"), ("c.u", "p.u")])


def zero_order_hold(component: LinearComponent, step: float) -> tuple[np.ndarray, np.ndarray]:
    n, m = component.B.shape
    transition = scipy.linalg.expm(np.block([[component.A, component.B], [np.zeros((m, n + m))]]) * step)
    return transition[:n, :n], transition[:n, n:]


@pytest.mark.parametrize("step", [0.05, 0.7])
def test_held_inputs_give_the_closed_forms_of_both_orders(step):
    system = random_loop(1)
    P, K = system.components["p"], system.components["c"]
    (A, B), (A_c, B_c) = zero_order_hold(P, step), zero_order_hold(K, step)
    sequential = np.block([[A + B @ K.D @ P.C, B @ K.C], [B_c @ P.C, A_c]])
    matrix = transition_matrix(system, step, extrapolation="hold")
    np.testing.assert_allclose(matrix, sequential, rtol=1e-12, atol=1e-12)
    # the delayed measurement is a state: u = C_c x_c + D_c y of the step before
    parallel = np.block([[A, B @ K.C, B @ K.D], [B_c @ P.C, A_c, np.zeros((2, 6))], [P.C, np.zeros((6, 8))]])
    matrix = transition_matrix(system, step, order="parallel", extrapolation="hold")
    np.testing.assert_allclose(eigenvalues(matrix), eigenvalues(parallel), rtol=1e-7, atol=1e-9)


def test_short_steps_follow_the_continuous_loop_whatever_the_algorithm():
    system, h = random_loop(2), 1e-5
    for order in ("sequential", "parallel"):
        for extrapolation in ("hold", "linear"):
            z = eigenvalues(transition_matrix(system, h, order=order, extrapolation=extrapolation))
            near_one = np.log(z[np.abs(z - 1.0) < 0.1]) / h
            assert len(near_one) == 6
            np.testing.assert_allclose(np.sort_complex(near_one), np.sort_complex(system.poles()), rtol=2e-3, atol=1e-3)


def test_leading_axes_are_so_many_systems():
    family = random_loop(3, points=(5,))
    for order, extrapolation in (("sequential", "linear"), ("parallel", "hold")):
        radii = spectral_radius(family, 0.1, order=order, extrapolation=extrapolation)
        assert radii.shape == (5,)
        for i in range(5):
            components = {
                name: LinearComponent(c.A[i], c.B[i], c.C[i], c.D[i], c.inputs, c.outputs)
                for name, c in family.components.items()
            }
            alone = spectral_radius(
                LinearSystem(components, family.connections), 0.1, order=order, extrapolation=extrapolation
            )
            assert radii[i] == pytest.approx(float(alone), rel=1e-9)


def test_the_exponential_is_scipys():
    generator = np.random.default_rng(4)
    for size, scale in ((1, 0.3), (5, 1e-6), (7, 2.0), (9, 8.0)):
        matrices = generator.standard_normal((3, size, size)) * scale
        expected = scipy.linalg.expm(matrices)
        assert np.abs(exponential(matrices) - expected).max() < 1e-12 * np.abs(expected).max()
    assert (exponential(np.zeros((2, 3, 3))) == np.eye(3)).all()
    assert exponential(np.zeros((0, 0))).shape == (0, 0)


# Communication points of their own


@pytest.mark.parametrize("extrapolation", ["hold", "linear"])
def test_a_gain_that_is_called_every_second_step_is_held_in_between(extrapolation):
    """The integrator gets a value every second step, and so can't extrapolate: x+ = x - 2 a x over two steps."""
    system = LinearSystem({"i": INTEGRATOR, "g": gain(-4.0)}, LOOP, every={"g": 2})
    matrix = transition_matrix(system, 0.1, extrapolation=extrapolation)
    np.testing.assert_allclose(eigenvalues(matrix), [1.0 - 2.0 * 0.4], atol=1e-12)
    assert largest_stable_step(system, extrapolation=extrapolation) == pytest.approx(0.25, rel=2e-4)


def test_two_components_that_step_half_as_often_are_one_step_of_twice_the_length():
    slow = LinearSystem({"i": INTEGRATOR, "g": gain(-4.0)}, LOOP, every={"i": 2, "g": 2})
    for order in ("sequential", "parallel"):
        radius = spectral_radius(slow, 0.05, order=order)
        assert radius == pytest.approx(float(spectral_radius(feedback(4.0), 0.1, order=order)), rel=1e-12)


# FMUs


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_fmus_are_stable_below_the_largest_step_and_not_above(tmp_path: Path, order: str) -> None:
    T, K = 0.5, 6.0
    build(tmp_path, LAG, GAIN)
    lag = LinearComponent([[-1 / T]], [[1 / T]], [[1.0]], [[0.0]], ["u"], ["x"])
    limit = largest_stable_step(LinearSystem({"i": lag, "g": gain(-K)}, LOOP), order=order, extrapolation="hold")
    system = System()
    system.add("i", tmp_path / "Lag.fmu", start={"x_start": 1.0, "T": T})
    system.add("g", tmp_path / "Gain.fmu", start={"K": -K, "u[2]": 0.0})
    system.connect("i.x", "g.u[1]")
    system.connect("g.y[1]", "i.u")
    for factor, is_stable in ((0.97, True), (1.03, False)):
        h = factor * limit
        late = np.abs(simulate(system, 400 * h, h, order=order)["i.x"][-20:]).max()
        assert (late < 1e-2) if is_stable else (late > 1e2)


# Paths


def scalar_path(rates: np.ndarray) -> LinearSystem:
    """Couple to x' = a x, a changing along a path, as an integrator and a gain."""
    n = len(rates)
    i = LinearComponent(*(np.full((n, 1, 1), v) for v in (0.0, 1.0, 1.0, 0.0)), ["u"], ["x"])
    g = LinearComponent(np.zeros((n, 0, 0)), (), (), rates.reshape(n, 1, 1), ["u"], ["y"])
    return LinearSystem({"i": i, "g": g}, LOOP)


def test_growth_along_a_path_is_that_of_its_unstable_piece():
    """Four pieces of 1 s, ten steps each: by 1 + a h a step, and only in the second piece more than 1."""
    rates = np.array([-1.0, 3.0, -2.0, -4.0])
    growth = growth_along(scalar_path(rates), 0.1, 4.0, extrapolation="hold")
    assert growth == pytest.approx(1.3**10, rel=1e-12)
    rates = np.array([-1.0, 3.0, 1.0, -4.0])
    growth = growth_along(scalar_path(rates), 0.1, 4.0, extrapolation="hold")
    assert growth == pytest.approx(1.3**10 * 1.1**10, rel=1e-12)


def test_a_path_is_stable_despite_a_short_unstable_piece():
    """|1 - K h| is above 1 in one piece of a quarter of the time; it is made up for until the growth is the limit."""
    system = scalar_path(np.array([-1.0, -1.0, -10.0, -1.0]))
    assert largest_stable_step(system, extrapolation="hold") == pytest.approx(0.2, rel=2e-4)
    assert growth_along(system, 1e-4, 4.0, extrapolation="hold") == 1.0
    for growth in (3.0, 5.0):
        along = largest_stable_step_along(system, 4.0, extrapolation="hold", growth=growth)
        assert 0.2 < along < 0.3
        for step, allowed in ((0.999 * along, True), (1.001 * along, False)):
            assert (growth_along(system, step, 4.0, extrapolation="hold") <= growth) == allowed


def test_a_deviation_that_grows_slowly_but_never_decays_is_unstable():
    with pytest.raises(ArgumentError):
        largest_stable_step_along(scalar_path(np.full(4, 0.1)), 4.0)
    assert growth_along(scalar_path(np.full(4, 0.1)), 0.1, 4.0) < 2.0


def test_a_path_needs_points():
    with pytest.raises(SetupError, match="one leading axis"):
        largest_stable_step_along(feedback(1.0), 1.0)


# What is refused


def test_an_algebraic_loop_needs_an_order_without_levels():
    system = LinearSystem({"a": gain(0.5), "b": gain(-0.8)}, [("a.y", "b.u"), ("b.y", "a.u")])
    with pytest.raises(SetupError, match=r"'sequential' can't couple the algebraic loop .*a\.u.*parallel"):
        transition_matrix(system, 0.1)
    radius = spectral_radius(system, 0.1, order="parallel", extrapolation="hold")
    assert radius == pytest.approx(math.sqrt(0.5 * 0.8), rel=1e-12)


def test_poles_around_an_algebraic_loop_solve_it():
    """With x' = u and u = -x + 0.5 u the loop is x' = -2 x."""
    mixed = LinearComponent((), (), (), [[-1.0, 0.5]], ["x", "u"], ["y"])
    system = LinearSystem({"i": INTEGRATOR, "m": mixed}, [("i.x", "m.x"), ("m.y", "m.u"), ("m.y", "i.u")])
    np.testing.assert_allclose(system.poles(), [-2.0], rtol=1e-12)
    singular = LinearComponent((), (), (), [[-1.0, 1.0]], ["x", "u"], ["y"])
    system = LinearSystem({"i": INTEGRATOR, "m": singular}, [("i.x", "m.x"), ("m.y", "m.u"), ("m.y", "i.u")])
    with pytest.raises(SetupError, match=r"algebraic loop .*m\.u.* has no single solution"):
        system.poles()


@pytest.mark.parametrize("step", [0.0, -0.1, math.nan, math.inf])
def test_a_step_must_be_positive(step):
    with pytest.raises(SetupError, match="positive number of seconds"):
        transition_matrix(feedback(1.0), step)


def test_an_unknown_algorithm_is_refused():
    with pytest.raises(SetupError, match="order 'serial' is unknown"):
        largest_stable_step(feedback(1.0), order="serial")
    with pytest.raises(SetupError, match="extrapolation 'linaer' is unknown"):
        transition_matrix(feedback(1.0), 0.1, extrapolation="linaer")


@pytest.mark.parametrize(
    ("connections", "every", "message"),
    [
        ([("j.x", "g.u")], {}, "there is no component 'j'"),
        ([("i.z", "g.u")], {}, "component 'i' has no output 'z'"),
        ([("i.x", "g.y")], {}, "component 'g' has no input 'y'"),
        ([*LOOP, ("i.x", "i.u")], {}, "'i.u' is fed twice"),
        ([("w.v", "g.u")], {}, "'w.v' with 2 elements can't feed 'g.u' with 1"),
        (LOOP, {"j": 2}, "every: there is no component 'j'"),
        (LOOP, {"i": 0}, "component 'i': every = 0 must be a positive whole number"),
        (LOOP, {"i": True}, "component 'i': every = True must be"),
    ],
)
def test_what_a_system_can_not_be_is_named(connections, every, message):
    wide = LinearComponent((), (), (), np.zeros((2, 0)), [], ["v[1]", "v[2]"])
    with pytest.raises(SetupError, match=message):
        LinearSystem({"i": INTEGRATOR, "g": gain(1.0), "w": wide}, connections, every)


@pytest.mark.parametrize(
    ("matrices", "message"),
    [
        (([[0.0]], [[1.0, 2.0]], [[1.0]], [[0.0]]), r"B has the shape \(1, 2\) and must have \(1, 1\)"),
        (([[0.0]], [1.0], [[1.0]], [[0.0]]), r"B has the shape \(1,\)"),
        (([[0.0]], [[1.0]], [[math.nan]], [[0.0]]), "C has values that are not finite"),
        (([[0.0, 1.0]], [[1.0]], [[1.0]], [[0.0]]), "A has the shape"),
    ],
)
def test_matrices_that_do_not_fit_are_named(matrices, message):
    with pytest.raises(SetupError, match=message):
        LinearComponent(*matrices, ["u"], ["y"])


def test_a_name_that_is_given_twice_is_refused():
    with pytest.raises(SetupError, match="'u' is named twice"):
        LinearComponent((), (), (), np.zeros((1, 2)), ["u", "u"], ["y"])


def test_vectors_are_connected_in_the_order_of_their_indices():
    reverse = LinearComponent((), (), (), [[0.0, 3.0], [5.0, 0.0]], ["v[2]", "v[1]"], ["w[2]", "w[1]"])
    system = LinearSystem({"a": reverse, "b": reverse}, [("a.w", "b.v")])
    assert system.sources == {("b", "v[1]"): ("a", "w[1]"), ("b", "v[2]"): ("a", "w[2]")}


# Iterated steps


@pytest.mark.parametrize(
    ("name", "implicit", "explicit"),
    [
        ("hold", [1.0, 0.5], [1.0, -0.5]),
        ("linear", [1.0, 0.5], [1.0, -0.5]),
        ("tangent", [1.0, 0.5], [1.0, -0.5]),
        ("hermite", [1.0, 0.5, 1.0 / 12.0], [1.0, -0.5, 1.0 / 12.0]),
        ("adaptive", [1.0, 0.5, 1.0 / 12.0], [1.0, -0.5, 1.0 / 12.0]),
    ],
)
def test_an_iterated_step_is_an_implicit_one(name: str, implicit: list[float], explicit: list[float]) -> None:
    """Of x' = -K x: the trapezoidal rule, and with rates the approximant of Pade of exp(-K h)."""
    system = feedback(3.0)
    for h in (0.1, 1.0, 10.0):
        powers = [(3.0 * h) ** k for k in range(len(implicit))]
        expected = np.dot(explicit, powers) / np.dot(implicit, powers)
        radius = spectral_radius(system, h, extrapolation=name, iterated=True)
        assert radius == pytest.approx(abs(expected), rel=1e-12)
    assert largest_stable_step(system, extrapolation=name, iterated=True, longest=1e3) == math.inf


@pytest.mark.parametrize(
    ("name", "weights"),
    [("quadratic", [5.0, 8.0, -1.0]), ("cubic-least-squares", [9.0, 19.0, -5.0, 1.0])],
)
def test_an_iterated_step_by_values_is_that_of_adams_and_moulton(name: str, weights: list[float]) -> None:
    system = feedback(3.0)
    h = 0.7
    b = 3.0 * h * np.array(weights) / sum(weights)
    roots = np.roots([1.0 + b[0], b[1] - 1.0, *b[2:]])
    radius = spectral_radius(system, h, extrapolation=name, iterated=True)
    assert radius == pytest.approx(np.abs(roots).max(), rel=1e-10)


def test_what_is_not_iterated_is_refused() -> None:
    parts = {"i": INTEGRATOR, "g": gain(-3.0)}
    with pytest.raises(SetupError, match="order 'parallel' does not iterate steps"):
        spectral_radius(feedback(3.0), 0.1, order="parallel", iterated=True)
    with pytest.raises(SetupError, match="component 'g' has a communication step of its own"):
        spectral_radius(LinearSystem(parts, LOOP, {"g": 2}), 0.1, iterated=True)


# python-control


def test_a_state_space_of_python_control_is_a_component():
    plant = control.tf2ss(control.tf([6.0], [0.5, 1.0]), inputs="u", outputs="x")
    system = LinearSystem({"i": LinearComponent.from_state_space(plant), "g": gain(-1.0)}, LOOP)
    np.testing.assert_allclose(system.poles(), control.poles(control.feedback(plant, 1)), rtol=1e-12)
    assert system.poles() == pytest.approx([-14.0])


def test_only_a_state_space_in_continuous_time_is_a_component():
    with pytest.raises(SetupError, match=r"sampled every 0\.1 s"):
        LinearComponent.from_state_space(control.ss(0.5, 1.0, 1.0, 0.0, dt=0.1))
    with pytest.raises(SetupError, match="TransferFunction is not a state space"):
        LinearComponent.from_state_space(control.tf([1.0], [1.0, 1.0]))
