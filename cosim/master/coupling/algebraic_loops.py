"""Algebraic loops, solved at the start and at each communication point by iteration over the exchange.

Around such a loop outputs depend on themselves at the same instant, so that no order of exchange can compute them. Some
of its connections are torn: what they carry is assumed, the exchange is performed in order, and the assumption is
mended until the torn outputs are what was assumed. Newton's method does that, with damped steps; its Jacobian comes
from directional derivatives where all FMUs of the loop give them, and else from differences. It is learned on by
Broyden's updates, and serves the next points as long as it does well. Where that finds nothing, solutions are followed
from what was assumed first, while the outputs gain influence bit by bit. The compiled loop does the work, see
cosim/loop/algebraic_loop.c.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from cosim.loop.algebraic_loop import NO_SOLUTION, AlgebraicLoop, Direction, algebraic_loop_library
from cosim.loop.arena import Arena
from cosim.loop.binding import Operation, OperationKind
from cosim.master.coupling.algorithm import MOST_ITERATIONS
from cosim.system.resolution import Link

#: Relative residual at which a loop is solved.
_TOLERANCE = 1e-10

#: What is counted over a run.
_COUNTS = ("n_points", "n_iterations", "n_exchanges")


class TornExchange:
    """Solves the algebraic loops of one exchange.

    Parameters
    ----------
    torn : sequence of Link
        What is torn.
    assumed, sources : sequence of int
        Positions of the assumed values, and of the outputs that they stand for.
    values : array
        Of the exchange.
    most : int
        Iterations at a communication point.
    arena : Arena
    """

    def __init__(
        self,
        torn: Sequence[Link],
        assumed: Sequence[int],
        sources: Sequence[int],
        values: np.ndarray,
        most: int,
        arena: Arena,
    ) -> None:
        self._values = values
        self._torn = tuple(torn)
        self._assumed = tuple(assumed)
        self._loop = arena.structure(AlgebraicLoop)
        n = len(assumed)
        self._loop.positions = arena.integers([*assumed, *sources])
        for name in ("residuals", "tried", "step", "assumed", "outputs", "origin"):
            setattr(self._loop, name, arena.zeros(n))
        self._loop.way = arena.zeros((n + 1) * (2 * n + 6))
        for name in ("jacobian", "factors"):
            setattr(self._loop, name, arena.zeros(n * n))
        self._loop.n, self._loop.most, self._loop.tolerance = n, most, _TOLERANCE
        self._loop.follows = most >= MOST_ITERATIONS  # not where somebody wants few iterations
        self._first = 0

    def operation(self) -> Operation:
        """What is to be done behind the exchange."""
        function = algebraic_loop_library().solve_algebraic_loop
        return Operation(
            kind=OperationKind.GROUP,
            every=1,
            version=3,
            function=ctypes.cast(function, ctypes.c_void_p).value,
            data=ctypes.addressof(self._loop),
        )

    def attach(self, operations: Any, codes: Any, first: int, n: int) -> None:
        """Have the exchange: some operations of a table."""
        self._first = first
        self._loop.operations = ctypes.cast(
            ctypes.addressof(operations) + first * ctypes.sizeof(Operation), ctypes.POINTER(Operation)
        )
        self._loop.codes = ctypes.cast(
            ctypes.addressof(codes) + first * ctypes.sizeof(ctypes.c_uint32), ctypes.POINTER(ctypes.c_uint32)
        )
        self._loop.n_operations = n

    def direct(self, directions: Sequence[Direction], arena: Arena) -> None:
        """Have the Jacobian come from directional derivatives, by the chain rule through the exchange."""
        loop = self._loop
        loop.directions = arena.structure(Direction * len(directions))
        for i, direction in enumerate(directions):
            loop.directions[i] = direction
        loop.n_directions, loop.n_values = len(directions), len(self._values)
        loop.changes = arena.zeros(len(self._values))

    def begin(self) -> None:
        """Begin a run."""
        loop = self._loop
        loop.is_directed = loop.n_directions > 0
        loop.has_jacobian = loop.n_points = loop.n_iterations = loop.n_exchanges = 0
        loop.largest_residual = loop.residual = 0.0

    @property
    def components(self) -> list[str]:
        """Components whose outputs are torn."""
        return list(dict.fromkeys(link.source_component for link in self._torn))

    @property
    def failed_row(self) -> int:
        """Row of the table whose operation failed."""
        return int(self._first + self._loop.failed_operation)

    def failure(self, status: int) -> str:
        """What went wrong, where it was no operation; else empty."""
        if status != NO_SOLUTION:
            return ""
        names = [f"'{k.source_component}.{k.source.name}'" for k in self._torn]
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        return (
            f"the algebraic loop through {', '.join(names[:3])}{more} has no solution that {self._loop.most} "
            f"iterations could find: its residual is {self._loop.residual:.3g} of what it carries; start it nearer to "
            "one (start values of these outputs), allow more iterations, or break it (order='parallel', as an option "
            "--order parallel)"
        )

    def numbers(self) -> list[float]:
        """What of it belongs to the state of a run."""
        jacobian = (self._loop.jacobian[i] for i in range(self._loop.n**2))
        return [
            float(self._loop.has_jacobian),
            float(self._loop.is_directed),
            *jacobian,
            *self._values[list(self._assumed)].tolist(),
            *(float(getattr(self._loop, name)) for name in _COUNTS),
            self._loop.largest_residual,
        ]

    def restore(self, numbers: list[float]) -> None:
        """Take what `numbers` gave, and more, from the front of a list."""
        self._loop.has_jacobian, self._loop.is_directed = int(numbers.pop(0)), int(numbers.pop(0))
        for i in range(self._loop.n**2):
            self._loop.jacobian[i] = numbers.pop(0)
        for position in self._assumed:
            self._values[position] = numbers.pop(0)
        for name in _COUNTS:
            setattr(self._loop, name, int(numbers.pop(0)))
        self._loop.largest_residual = numbers.pop(0)

    def summary(self) -> dict[str, Any]:
        """For people: what was torn, and what it took."""
        loop = self._loop
        return {
            "torn": [
                f"{k.source_component}.{k.source.name} -> {k.target_component}.{k.target.name}" for k in self._torn
            ],
            "points": loop.n_points,
            "iterations": loop.n_iterations,
            "exchanges": loop.n_exchanges,
            "largest_residual": loop.largest_residual,
            "jacobian": "directional derivatives" if loop.is_directed else "differences",
        }


def first_guesses(torn: Iterable[Link], positions: Mapping[tuple[str, str], int]) -> dict[int, float]:
    """Position of each assumed value -> the start value of its output, as far as the FMU has one."""
    found = {}
    for link in torn:
        start = link.source.variable.start
        values = start if isinstance(start, (list, tuple)) else str(start or "0").split()
        value = values[link.source.offset] if link.source.offset < len(values) else values[0]
        try:
            found[positions[link.source_component, link.source.name]] = float(value)
        except ValueError:
            continue
    return found
