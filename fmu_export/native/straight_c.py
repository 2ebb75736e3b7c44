"""A traced graph as straight-line C: an assignment for each operation that is used more than once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from fmu_export.errors import needs
from fmu_export.native.expressions import SCALARS, applied, operand, without_parentheses
from fmu_export.trace.graph import SINES, Graph

with needs("export"):
    import casadi as ca

#: Longer expressions get a variable of their own.
_LONGEST = 90


def straight_statements(graph: Graph, arguments: Sequence[str]) -> list[str]:
    """The statements that compute `y` from arguments with these names."""
    return _Writer(graph, arguments).write()


class _Writer:
    """What one function has of expressions and lines."""

    def __init__(self, graph: Graph, arguments: Sequence[str]) -> None:
        self.graph, self.arguments = graph, arguments
        self.texts: dict[int, str] = {}
        self.lines = [f"y[{i}] = 0.0;" for i in range(graph.n_results) if i not in graph.results]
        self.n_variables = 0

    def write(self) -> list[str]:
        """The statements: before each batch of sines and cosines what their angles need, at last the rest."""
        for number, angles in enumerate(_batches(self.graph), 1):
            needed = set(angles)
            for position in range(max(angles), -1, -1):
                if position in needed and position not in self.texts and not self.graph.nodes[position].is_leaf:
                    needed.update(self.graph.nodes[position].operands)
            self._write_nodes(sorted(needed))
            names = [f"{name}{number}" for name in ("angle", "sine", "cosine")]
            self.lines.append("double " + ", ".join(f"{name}[{len(angles)}]" for name in names) + ";")
            for k, angle in enumerate(angles):
                self.lines.append(f"{names[0]}[{k}] = {without_parentheses(self.texts[angle])};")
                for operation, name in zip(SINES, names[1:], strict=True):
                    if (operation, angle) in self.graph.sines:
                        self.texts[self.graph.sines[operation, angle]] = f"{name}[{k}]"
            self.lines.append(f"sines({len(angles)}, {', '.join(names)});")
        self._write_nodes(range(len(self.graph.nodes)))
        for i, position in sorted(self.graph.results.items()):
            self.lines.append(f"y[{i}] = {without_parentheses(self.texts[position])};")
        return self.lines

    def _write_nodes(self, positions: Iterable[int]) -> None:
        for position in positions:
            node = self.graph.nodes[position]
            if position in self.texts:
                continue
            if node.operation == ca.OP_CONST:
                self.texts[position] = operand(node.value)
            elif node.operation == ca.OP_INPUT:
                name = self.arguments[node.operands[0]]
                self.texts[position] = name if name in SCALARS else f"{name}[{node.operands[1]}]"
            else:
                text = applied(node.operation, [self.texts[i] for i in node.operands], self.graph.name)
                if self.graph.uses[position] == 1 and len(text) < _LONGEST:
                    self.texts[position] = f"({text})"
                else:
                    self.texts[position] = f"w{self.n_variables}"
                    self.lines.append(f"const double w{self.n_variables} = {text};")
                    self.n_variables += 1


def _batches(graph: Graph) -> list[list[int]]:
    """Angles of which sines and cosines can be taken together: those that depend on none, then on the first, ..."""
    if not graph.sines:
        return []
    depths: list[int] = []
    batches: dict[int, list[int]] = {}
    for node in graph.nodes:
        depth = 0 if node.is_leaf else max(depths[i] for i in node.operands)
        depths.append(depth + (node.operation in SINES))
    for angle in sorted(graph.angles):
        batches.setdefault(depths[angle], []).append(angle)
    return [batches[depth] for depth in sorted(batches)]
