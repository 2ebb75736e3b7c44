"""Levels of a dependency graph, against a brute-force definition; circular graphs are found, with their path."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.system.levels import AlgebraicLoop, Node, levels

Graph = dict[Node, set[Node]]


def node(i: int) -> Node:
    return (f"c{i // 3}", f"v{i}")


@st.composite
def acyclic_graphs(draw: st.DrawFn) -> tuple[Graph, set[Node]]:
    """Random graphs in which a node depends on nodes of smaller rank only; the dictionary is shuffled."""
    n = draw(st.integers(1, 14))
    rank = draw(st.permutations(range(n)))
    edges = draw(st.sets(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda e: e[0] > e[1])))
    keys = draw(st.sets(st.integers(0, n - 1)))  # of the others, those without feeders are no keys of the mapping
    feeds: Graph = {node(rank[i]): set() for i in keys}
    for high, low in edges:
        feeds.setdefault(node(rank[high]), set()).add(node(rank[low]))
    inputs = {node(i) for i in draw(st.sets(st.integers(0, n - 1)))}
    return feeds, inputs


def brute_force(of: Node, feeds: Graph, inputs: set[Node]) -> int:
    """Largest number of inputs that have a feeder, over all paths that end in a node."""
    feeders = feeds.get(of, set())
    return max((brute_force(f, feeds, inputs) + (of in inputs) for f in feeders), default=0)


def is_cycle(path: list[Node], feeds: Graph) -> bool:
    steps = itertools.pairwise(path)
    return len(path) > 1 and path[0] == path[-1] and all(a in feeds.get(b, set()) for a, b in steps)


@settings(deadline=None)
@given(acyclic_graphs())
def test_levels_are_the_longest_chain_of_fed_inputs(graph):
    feeds, inputs = graph
    result = levels(feeds, inputs)
    assert result.keys() == feeds.keys() | {f for feeders in feeds.values() for f in feeders}
    assert result == {n: brute_force(n, feeds, inputs) for n in result}


@settings(deadline=None)
@given(acyclic_graphs())
def test_every_value_is_computed_before_it_is_needed(graph):
    feeds, inputs = graph
    result = levels(feeds, inputs)
    for target, feeders in feeds.items():
        for feeder in feeders:
            # within a level inputs are set first, so an input must stand above the outputs that feed it
            assert result[feeder] + 1 <= result[target] if target in inputs else result[feeder] <= result[target]


@settings(deadline=None)
@given(acyclic_graphs(), st.data())
def test_a_planted_cycle_is_found_and_its_path_is_one(graph, data):
    feeds, inputs = graph
    planted = data.draw(st.lists(st.integers(0, 13), min_size=1, max_size=6, unique=True))
    for i, j in zip(planted, [*planted[1:], planted[0]], strict=True):
        feeds.setdefault(node(j), set()).add(node(i))
    with pytest.raises(AlgebraicLoop) as found:
        levels(feeds, inputs)
    path = found.value.path
    assert is_cycle(path, feeds)
    assert len(set(path)) == len(path) - 1  # once around
    assert str(found.value) == " -> ".join(f"{c}.{v}" for c, v in path)


def test_the_cycle_check_of_these_tests_can_fail():
    feeds = {node(1): {node(0)}, node(0): {node(1)}}
    assert is_cycle([node(0), node(1), node(0)], feeds)
    assert not is_cycle([node(0), node(2), node(0)], feeds)
    assert not is_cycle([node(0), node(1)], feeds)
    assert not is_cycle([node(0)], feeds)


def test_the_path_of_a_loop_follows_the_values():
    # a.y feeds b.u, b.y depends on b.u, b.y feeds a.u, a.y depends on a.u
    feeds = {("b", "u"): {("a", "y")}, ("b", "y"): {("b", "u")}, ("a", "u"): {("b", "y")}, ("a", "y"): {("a", "u")}}
    with pytest.raises(AlgebraicLoop) as found:
        levels(feeds, {("a", "u"), ("b", "u")})
    assert is_cycle(found.value.path, feeds)
    assert len(found.value.path) == 5


@pytest.mark.parametrize("downwards", [False, True])
def test_a_chain_of_5000_components_is_no_recursion(downwards):
    n = 5000
    order = range(n - 1, -1, -1) if downwards else range(n)
    feeds: Graph = {}
    for i in order:
        feeds[f"c{i}", "u"] = {(f"c{i - 1}", "y")} if i else set()
        feeds[f"c{i}", "y"] = {(f"c{i}", "u")}
    inputs = {(f"c{i}", "u") for i in range(n)}
    result = levels(feeds, inputs)
    assert all(result[f"c{i}", v] == i for i in range(n) for v in "uy")


def test_a_loop_of_5000_components_is_no_recursion():
    n = 5000
    feeds = {(f"c{i}", "y"): {(f"c{(i - 1) % n}", "y")} for i in range(n)}
    with pytest.raises(AlgebraicLoop) as found:
        levels(feeds, set())
    assert len(found.value.path) == n + 1


def test_a_diamond_of_many_layers_takes_no_exponential_time():
    feeds: Graph = {}
    for i in range(1, 400):
        for side in "lr":
            feeds[f"c{i}", side] = {(f"c{i - 1}", "l"), (f"c{i - 1}", "r")}
    assert levels(feeds, set(feeds))["c399", "l"] == 399
