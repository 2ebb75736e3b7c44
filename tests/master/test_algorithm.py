"""Algorithms by name: what can be registered, and what is refused."""

from __future__ import annotations

import pytest

from cosim import SetupError
from cosim.master.coupling import algorithm as algorithms
from cosim.master.coupling.algorithm import AUTO, EXTRAPOLATIONS, ORDERS, Extrapolation, Order, algorithm, register

PARABOLA = ((1.5, -2.0, 0.5), (1.0, -2.0, 1.0))


@pytest.fixture(autouse=True)
def registries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies: what a test registers is gone after it."""
    for name in ("ORDERS", "EXTRAPOLATIONS"):
        monkeypatch.setattr(algorithms, name, dict(getattr(algorithms, name)))


def order(name: str) -> Order:
    return Order(name, "", "", lambda sets, gets: [], needs_levels=False)


def test_what_is_registered_can_be_named() -> None:
    register(order("backwards"))
    register(Extrapolation("parabola", "", "", PARABOLA, start="linear"))
    chosen = algorithm("backwards", "parabola")
    assert (chosen.order.name, chosen.extrapolation.name, chosen.demanded) == ("backwards", "parabola", True)
    assert (chosen.extrapolation.degree, chosen.extrapolation.points) == (2, 3)


def test_until_enough_values_are_known_others_start() -> None:
    register(Extrapolation("parabola", "", "", PARABOLA, start="linear"))
    used = algorithms.EXTRAPOLATIONS["parabola"].used
    assert [used(known).weights for known in (1, 2, 3, 4)] == [(), ((1.0, -1.0),), PARABOLA, PARABOLA]


@pytest.mark.parametrize(
    "entry", [order("parallel"), order(AUTO), Extrapolation("hold", "", ""), Extrapolation(AUTO, "", "")]
)
def test_a_name_that_is_taken_is_refused(entry: Order | Extrapolation) -> None:
    with pytest.raises(SetupError, match=rf"^\w+ '{entry.name}' is registered already; choose another name$"):
        register(entry)


@pytest.mark.parametrize("weights", [((1.5, -2.0, 0.5), (1.0, -2.0)), ((1.0,),)])
def test_rows_of_weights_have_one_length_of_at_least_2(weights: tuple[tuple[float, ...], ...]) -> None:
    with pytest.raises(SetupError, match=r"^extrapolation 'wrong': all rows of weights must have the same length, at"):
        register(Extrapolation("wrong", "", "", weights, start="hold"))


@pytest.mark.parametrize("start", ["", "unknown", "parabola"])
def test_what_starts_an_extrapolation_is_registered_and_needs_fewer_values(start: str) -> None:
    register(Extrapolation("parabola", "", "", PARABOLA, start="linear"))
    with pytest.raises(SetupError, match=r"^extrapolation 'wrong': start must name a registered one that needs fewer"):
        register(Extrapolation("wrong", "", "", PARABOLA, start=start))


def test_the_default_is_adaptive_in_sequential_order_and_linear_in_parallel_order() -> None:
    assert next(iter(ORDERS)) == "sequential"
    chosen = algorithm()
    assert (chosen.order, chosen.extrapolation) == (ORDERS["sequential"], EXTRAPOLATIONS["adaptive"])
    assert algorithm("parallel").extrapolation is EXTRAPOLATIONS["linear"]
    assert not chosen.demanded


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("gauss", AUTO), r"^order 'gauss' is unknown; use .*'sequential' \(Gauss-Seidel\) or 'parallel' \(Jacobi\)$"),
        (("parallel", "spline"), r"^extrapolation 'spline' is unknown; use 'auto', 'hold' \(zero-order hold\)"),
    ],
)
def test_an_unknown_name_is_answered_with_those_that_are_known(names: tuple[str, str], message: str) -> None:
    with pytest.raises(SetupError, match=message):
        algorithm(*names)
