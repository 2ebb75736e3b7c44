"""A traced graph as straight-line C: an assignment for each operation that is used more than once."""

from __future__ import annotations

from collections.abc import Sequence

from fmu_export.errors import needs
from fmu_export.native.expressions import SCALARS, applied, operand, without_parentheses
from fmu_export.trace.graph import Graph

with needs("export"):
    import casadi as ca

#: Longer expressions get a variable of their own.
_LONGEST = 90


def straight_statements(graph: Graph, arguments: Sequence[str]) -> list[str]:
    """The statements that compute `y` from arguments with these names."""
    texts: dict[int, str] = {}
    lines = [f"y[{i}] = 0.0;" for i in range(graph.n_results) if i not in graph.results]
    n_variables = 0
    for position, node in enumerate(graph.nodes):
        if node.operation == ca.OP_CONST:
            texts[position] = operand(node.value)
        elif node.operation == ca.OP_INPUT:
            name = arguments[node.operands[0]]
            texts[position] = name if name in SCALARS else f"{name}[{node.operands[1]}]"
        else:
            text = applied(node.operation, [texts[i] for i in node.operands], graph.name)
            if graph.uses[position] == 1 and len(text) < _LONGEST:
                texts[position] = f"({text})"
            else:
                texts[position] = f"w{n_variables}"
                lines.append(f"const double w{n_variables} = {text};")
                n_variables += 1
    return lines + [
        f"y[{i}] = {without_parentheses(texts[position])};" for i, position in sorted(graph.results.items())
    ]
