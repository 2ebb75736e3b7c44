"""In what order values are exchanged at a communication point.

Each output and input gets a level. Level 0: outputs without direct feedthrough, and inputs fed by signals. An input is
one level above the output that feeds it; an output is on the highest level of the inputs it depends on directly. Level
by level, inputs are set and outputs got: then every value at a communication point belongs to that very point.
"""

from __future__ import annotations

from collections.abc import Mapping, Set

from cosim.errors import CosimError

#: A variable of the system: (component, variable).
Node = tuple[str, str]


class AlgebraicLoop(CosimError):
    """Outputs depend on themselves at the same instant; `path` runs once around the loop."""

    def __init__(self, path: list[Node]) -> None:
        super().__init__(" -> ".join(".".join(node) for node in path))
        self.path = path


def levels(feeds: Mapping[Node, set[Node]], inputs: Set[Node]) -> dict[Node, int]:
    """Level of every node.

    Parameters
    ----------
    feeds : mapping
        For each input the outputs that feed it, for each output the inputs it depends on directly. Nodes that are not
        a key are fed by nothing.
    inputs : set
        The nodes that are inputs.

    Raises
    ------
    AlgebraicLoop
        The dependencies are circular.
    """
    level: dict[Node, int] = {}
    for start in feeds:
        _visit(start, feeds, inputs, level)
    return level


def _visit(start: Node, feeds: Mapping[Node, set[Node]], inputs: Set[Node], level: dict[Node, int]) -> None:
    """Depth first, without recursion: chains of many hundred components are no loop."""
    path: list[Node] = []
    on_path: set[Node] = set()
    stack = [start]
    while stack:
        node = stack[-1]
        if node in level:
            stack.pop()
            continue
        if path and path[-1] == node:  # all that feeds it is done
            level[node] = max((level[n] + (node in inputs) for n in feeds.get(node, ())), default=0)
            on_path.remove(path.pop())
            stack.pop()
            continue
        path.append(node)
        on_path.add(node)
        for feeder in sorted(feeds.get(node, ())):
            if feeder in on_path:
                loop = path[path.index(feeder) :]
                raise AlgebraicLoop([feeder, *reversed(loop)])
            if feeder not in level:
                stack.append(feeder)
