"""The diagram of a system, worked out on paper.

A component is 60 mm wide and 5 mm high for each connector and one more; lines are 3 mm apart, and 12 mm from all else.
"""

from __future__ import annotations

from collections.abc import Sequence

from cosim.ssp.format.diagram import Box, arrange

Wire = tuple[tuple[str, str], tuple[str, str]]


def wires(*pairs: str) -> list[Wire]:
    """From `a.y b.u`."""
    found: list[Wire] = []
    for pair in pairs:
        source, target = (end.split(".") for end in pair.split())
        found.append(((source[0], source[1]), (target[0], target[1])))
    return found


def connectors(**names: str) -> dict[str, list[str]]:
    """Connectors of components."""
    return {component: text.split() for component, text in names.items()}


def columns(components: Sequence[str], *pairs: str) -> dict[str, float]:
    """Column of each component, by its left edge: there are no more than two lines between."""
    diagram = arrange({c: ["u", "v"] for c in components}, {c: ["y", "z"] for c in components}, wires(*pairs))
    left = sorted({box.x1 for box in diagram.boxes.values()})
    return {c: left.index(box.x1) for c, box in diagram.boxes.items()}


def test_a_chain() -> None:
    diagram = arrange(connectors(a="", b="u", c="u"), connectors(a="y", b="y", c=""), wires("a.y b.u", "b.y c.u"))
    # 24 mm before a column, in which a line stands in the middle
    assert diagram.boxes == {"a": Box(24, -10, 84, 0), "b": Box(108, -10, 168, 0), "c": Box(192, -10, 252, 0)}
    assert diagram.canvas == Box(-12, -22, 276, 12)
    assert diagram.lines == [[(96, -5), (96, -5)], [(180, -5), (180, -5)]]
    assert diagram.connectors == {
        ("a", "y"): (1.0, 0.5),
        ("b", "u"): (0.0, 0.5),
        ("b", "y"): (1.0, 0.5),
        ("c", "u"): (0.0, 0.5),
    }


def test_heights_are_those_of_the_longer_side_and_a_column_goes_down() -> None:
    diagram = arrange(connectors(a="u v w", b=""), connectors(a="y", b="p q"), [])
    assert diagram.boxes == {"a": Box(24, -20, 84, 0), "b": Box(24, -47, 84, -32)}
    assert diagram.canvas == Box(-12, -59, 108, 12)
    assert diagram.connectors["a", "w"] == (0.0, 0.25)
    assert diagram.connectors["a", "y"] == (1.0, 0.75)
    assert diagram.connectors["b", "q"][0] == 1.0
    assert abs(diagram.connectors["b", "q"][1] - 1 / 3) < 1e-12


def test_columns_are_distances_from_what_nothing_feeds() -> None:
    assert columns("abc", "a.y b.u", "b.y c.u") == {"a": 0, "b": 1, "c": 2}
    assert columns("cba", "a.y b.u", "b.y c.u") == {"a": 0, "b": 1, "c": 2}
    # the shortest way counts
    assert columns("abc", "a.y b.u", "b.y c.u", "a.z c.v") == {"a": 0, "b": 1, "c": 1}
    assert columns("abcd", "a.y b.u", "b.y c.u", "c.y d.u") == {"a": 0, "b": 1, "c": 2, "d": 3}
    # in a circle the first one begins; who feeds itself only is fed by nobody
    assert columns("abc", "a.y b.u", "b.y c.u", "c.y a.u") == {"a": 0, "b": 1, "c": 2}
    assert columns("ab", "a.y a.u", "a.z b.u") == {"a": 0, "b": 1}
    # a circle that no other reaches stands with the first ones
    assert columns("abc", "b.y c.u", "c.y b.u") == {"a": 0, "b": 0, "c": 0}


def test_lines_that_fall_turn_off_from_below_and_lines_that_rise_from_above() -> None:
    """So that none crosses another: outputs at -5, -10, -15 mm, inputs 5 mm lower or higher."""
    falling = arrange(
        connectors(a="", b="s t u v"), connectors(a="x y z", b=""), wires("a.x b.t", "a.y b.u", "a.z b.v")
    )
    assert falling.lines == [[(102, -5), (102, -10)], [(99, -10), (99, -15)], [(96, -15), (96, -20)]]
    # three lines need 6 mm more
    assert falling.boxes["b"] == Box(84 + 30, -25, 174, 0)
    rising = arrange(connectors(a="", b="s t u"), connectors(a="w x y z", b=""), wires("a.x b.s", "a.y b.t", "a.z b.u"))
    assert rising.lines == [[(96, -10), (96, -5)], [(99, -15), (99, -10)], [(102, -20), (102, -15)]]


def test_lines_back_run_above_all() -> None:
    """Two of them: the upper output on the lower level. They leave in the gap behind and come in the one before."""
    diagram = arrange(connectors(a="u v", b="w"), connectors(a="y", b="p q"), wires("b.p a.v", "b.q a.u", "a.y b.w"))
    assert diagram.boxes == {"a": Box(27, -15, 87, 0), "b": Box(111, -15, 171, 0)}
    assert diagram.lines == [
        [(183, -5), (183, 12), (15, 12), (15, -10)],
        [(186, -10), (186, 15), (12, 15), (12, -5)],
        [(99, -5), (99, -5)],
    ]
    assert diagram.canvas == Box(-12, -27, 171 + 27, 27)


def test_lines_past_a_column_run_above_too() -> None:
    diagram = arrange(
        connectors(a="", b="u", c="u v"), connectors(a="y", b="y z", c="y"), wires("a.y b.u", "b.y c.u", "c.y c.v")
    )
    # c feeds itself: out behind it, in before it, on the right of what comes from the left
    assert diagram.lines[2] == [(183 + 72 + 12, -5), (267, 12), (183, 12), (183, -10)]
    assert diagram.lines[1] == [(180, -5), (180, -5)]
