"""The graph of a traced function: operations on constants, elements of arguments and other operations, each once."""

from __future__ import annotations

from typing import NamedTuple

from fmu_export.errors import needs
from fmu_export.trace.instructions import instructions
from fmu_export.trace.operations import is_adjoint

with needs("export"):
    import casadi as ca


#: Operations that are computed for many angles at once, sine and cosine together.
SINES = (ca.OP_SIN, ca.OP_COS)


_LEAVES = (ca.OP_CONST, ca.OP_INPUT)


class Node(NamedTuple):
    """A constant, an element of an argument, or an operation.

    Parameters
    ----------
    operation : int
        CasADi's number of the operation, `OP_CONST` and `OP_INPUT` included.
    operands : tuple of int
        Positions of the operands among the nodes; of an input its argument and the element.
    value : float
        Of a constant.
    """

    operation: int
    operands: tuple[int, ...] = ()
    value: float = 0.0

    @property
    def is_leaf(self) -> bool:
        """Whether nothing has to be computed."""
        return self.operation in _LEAVES


class Graph:
    """Nodes in an order in which they can be computed, equal ones once, and which of them the results are.

    Parameters
    ----------
    f : casadi.Function
        Of scalar operations (SX), with one result.
    """

    def __init__(self, f: ca.Function) -> None:
        self.name: str = f.name()
        self.nodes: list[Node] = []
        #: Node of each result that is not zero by structure.
        self.results: dict[int, int] = {}
        self.n_results: int = f.numel_out(0)
        found: dict[object, int] = {}
        work: dict[int, int] = {}

        def add(node: Node) -> int:
            # 0.0 and -0.0 are two
            position = found.setdefault(node.value.hex() if node.operation == ca.OP_CONST else node, len(self.nodes))
            if position == len(self.nodes):
                self.nodes.append(node)
            return position

        for operation, inputs, targets, value in instructions(f):
            if operation == ca.OP_CONST:
                work[targets[0]] = add(Node(operation, (), value))
            elif operation == ca.OP_INPUT:
                work[targets[0]] = add(Node(operation, inputs))
            elif operation == ca.OP_OUTPUT:
                self.results[targets[1]] = work[inputs[0]]
            elif operation == ca.OP_ASSIGN:
                work[targets[0]] = work[inputs[0]]
            elif operation == ca.OP_CALL and is_adjoint(
                values := [work[i] for i in inputs], self.nodes[values[0]].value
            ):
                number, *variables, weight = values
                zero = add(Node(ca.OP_CONST, (), 0.0))
                for i, target in enumerate(targets):  # the changes along each variable, by the weight of the value
                    changes = [weight if j == i else zero for j in range(len(variables))]
                    if target >= 0:
                        work[target] = add(Node(operation, (number, *variables, zero, *changes)))
            else:
                (target,) = targets
                work[target] = add(Node(operation, tuple(work[i] for i in inputs)))
        #: How often a node is an operand or a result; a square names its operand twice.
        self.uses = [0] * len(self.nodes)
        for node in self.nodes:
            if not node.is_leaf:
                for operand in node.operands:
                    self.uses[operand] += 1 + (node.operation == ca.OP_SQ)
        for position in self.results.values():
            self.uses[position] += 1

        #: Node of each sine and cosine by operation and angle.
        self.sines = {(n.operation, n.operands[0]): k for k, n in enumerate(self.nodes) if n.operation in SINES}

    @property
    def angles(self) -> set[int]:
        """Nodes of which a sine or cosine is taken."""
        return {angle for _, angle in self.sines}
