"""Starting blocks: steps that are computed together where a polynomial knows too little to have its order.

At the start, and after what jumps, an input has one value, and one rate, to go by. Its first step would be of a lower
order than all others, and what it leaves in slow states stays. Where all components can go back, the steps that the
polynomial lacks are tried: one where rates are known, else as many as its degree. The values that come out at their
ends say how the inputs should have gone; all go back and try again, until nothing changes. Then the run goes on from
where it was, with what has been found. The compiled loop does the work, see cosim/loop/starting_block.c.
"""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from cosim.fmi.instance import CallFailed, Instance
from cosim.loop.arena import Arena
from cosim.loop.binding import Extrapolated
from cosim.loop.iterated_step import Doing, KeptState
from cosim.loop.starting_block import StartingBlock, check_starting_block
from cosim.master.coupling.extrapolated_inputs import ExtrapolatedInputs
from cosim.master.coupling.iterated_steps import functions_of_states, why_not_repeated
from cosim.system.resolution import ResolvedSystem


def steps_of_block(system: ResolvedSystem, extrapolated: ExtrapolatedInputs) -> int:
    """Number of steps that connected inputs lack until all of them have the order of their polynomials."""
    moving = extrapolated.moving
    used = [moving.get((k.target_component, k.target.name)) for k in system.links if not system.couples_equations(k)]
    return max((each.starting_steps for each in used if each is not None), default=0)


def why_no_block(system: ResolvedSystem, functions: Collection[str]) -> str:
    """Why the steps of a system are not tried, in words that begin with a component; empty where they are."""
    for name in functions:  # they may count their calls, or draw numbers
        return f"component '{name}' is a function, which is called once at each communication point"
    if system.torn:
        link = system.torn[0]
        return f"component '{link.target_component}' is a part of an algebraic loop"
    return why_not_repeated(system, {})


_COUNTS = ("n_blocks", "n_not_found", "n_trials")


class StartingBlocks:
    """The starting blocks of a system.

    Parameters
    ----------
    instances : mapping
        Component -> instance.
    inputs : sequence of Extrapolated
        All that is extrapolated, in the order of the steps.
    steps : int
        Steps of a block.
    n_values : int
        Number of all values.
    arena : Arena

    Raises
    ------
    CallFailed
        The state of an FMU can't be kept.
    """

    def __init__(
        self, instances: Mapping[str, Instance], inputs: Sequence[Extrapolated], steps: int, n_values: int, arena: Arena
    ) -> None:
        check_starting_block()
        self._components = list(instances)
        self._instances = instances
        kept = [instance.kept_state() for instance in instances.values()]
        block = self._block = arena.structure(StartingBlock)
        block.states = arena.structure(KeptState * len(kept))
        for i, state in enumerate(kept):
            block.states[i] = state
        block.first = ctypes.pointer(next(each for each in inputs if each.ahead))
        block.rows, block.before = (arena.zeros((steps + 1) * n_values) for _ in range(2))
        block.known, block.refused = (arena.integers([0] * len(inputs)) for _ in range(2))
        block.n_values, block.n_states, block.steps = n_values, len(kept), steps
        block.failed = -1

    @property
    def states(self) -> Any:
        """The kept states, one of each component."""
        return self._block.states

    @property
    def address(self) -> int:
        """Where the loop finds it."""
        return ctypes.addressof(self._block)

    def begin(self) -> None:
        """Begin a run."""
        block = self._block
        block.n_blocks = block.n_not_found = block.n_trials = block.status = 0
        block.failed = -1

    def numbers(self) -> list[float]:
        """What of it belongs to the state of a run: how many there were, and what they took."""
        return [float(getattr(self._block, name)) for name in _COUNTS]

    def restore(self, numbers: list[float]) -> None:
        """Take what `numbers` gave, and more, from the front of a list."""
        for name in _COUNTS:
            setattr(self._block, name, int(numbers.pop(0)))

    def summary(self) -> dict[str, Any] | None:
        """For people: how many there were, and what they took; None without any."""
        block = self._block
        if not block.n_blocks:
            return None
        return {
            "blocks": block.n_blocks,
            "steps": block.steps,
            "trials": block.n_trials,
            "not_found": block.n_not_found,
        }

    def failure(self) -> tuple[str, CallFailed] | None:
        """Component that could not go back, and what it said; None where all could."""
        block = self._block
        if block.failed < 0:
            return None
        name = self._components[block.failed]
        instance = self._instances[name]
        return name, instance.failure(functions_of_states(instance)[Doing.GOING_BACK], block.status)
