"""The instructions of a traced function, read from CasADi once, for each takes four calls."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple
from weakref import WeakKeyDictionary

from fmu_export.errors import needs

with needs("export"):
    import casadi as ca


class Instruction(NamedTuple):
    """An operation on places of the work array.

    Parameters
    ----------
    operation : int
        CasADi's number of it.
    operands, targets : tuple of int
        Places that are read and written; of `OP_INPUT` the argument and the element that are read, of `OP_OUTPUT` the
        result and the element that are written.
    value : float
        Of a constant.
    """

    operation: int
    operands: tuple[int, ...]
    targets: tuple[int, ...]
    value: float


#: Of the functions that live; the code writers ask in turn.
_known: WeakKeyDictionary[ca.Function, tuple[Instruction, ...]] = WeakKeyDictionary()


def instructions(f: ca.Function) -> tuple[Instruction, ...]:
    """The instructions of a function of scalar operations (SX), in their order."""
    found = _known.get(f)
    if found is None:
        found = _known[f] = tuple(_read(f))
    return found


def _read(f: ca.Function) -> Iterator[Instruction]:
    operation_of, operands_of, targets_of, constant = (
        f.instruction_id,
        f.instruction_input,
        f.instruction_output,
        ca.OP_CONST,
    )
    for k in range(f.n_instructions()):
        if (operation := operation_of(k)) == constant:
            yield Instruction(operation, (), tuple(targets_of(k)), f.instruction_constant(k))
        else:
            yield Instruction(operation, tuple(operands_of(k)), tuple(targets_of(k)), 0.0)


def operations_of(f: ca.Function) -> set[int]:
    """The operations that a function uses."""
    return {operation for operation, *_ in instructions(f)}
