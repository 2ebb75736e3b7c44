"""The graph of a traced function: operations on constants, elements of arguments and other operations, each once."""

from __future__ import annotations

from dataclasses import dataclass

from fmu_export.errors import needs

with needs("export"):
    import casadi as ca


@dataclass(frozen=True)
class Node:
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
        return self.operation in (ca.OP_CONST, ca.OP_INPUT)


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
        found: dict[tuple[object, ...], int] = {}
        work: dict[int, int] = {}
        for k in range(f.n_instructions()):
            operation = f.instruction_id(k)
            if operation == ca.OP_CONST:
                node = Node(operation, (), f.instruction_constant(k))
                key: tuple[object, ...] = operation, node.value.hex()  # 0.0 and -0.0 are two
            else:
                inputs = f.instruction_input(k)
                if operation == ca.OP_OUTPUT:
                    self.results[f.instruction_output(k)[1]] = work[inputs[0]]
                    continue
                if operation == ca.OP_ASSIGN:
                    work[f.instruction_output(k)[0]] = work[inputs[0]]
                    continue
                operands = tuple(inputs) if operation == ca.OP_INPUT else tuple(work[i] for i in inputs)
                node, key = Node(operation, operands), (operation, operands)
            position = found.setdefault(key, len(self.nodes))
            if position == len(self.nodes):
                self.nodes.append(node)
            (target,) = f.instruction_output(k)
            work[target] = position
        #: How often a node is an operand or a result; a square names its operand twice.
        self.uses = [0] * len(self.nodes)
        for node in self.nodes:
            if not node.is_leaf:
                for operand in node.operands:
                    self.uses[operand] += 1 + (node.operation == ca.OP_SQ)
        for position in self.results.values():
            self.uses[position] += 1

    @property
    def operations(self) -> set[int]:
        """What is computed in it."""
        return {node.operation for node in self.nodes if not node.is_leaf}
