"""Algorithms of co-simulation, by name: an order of exchange, and what inputs do between communication points.

Both are data: the master builds its table of operations from them, the stability analysis interprets the same data, and
the command line takes its choices from the registries. `docs/extending.md` says how to add one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cosim.errors import SetupError

#: Operations of one kind by level: sets[level] feed inputs, gets[level] read outputs; see `cosim.system.levels`.
Levelled = Mapping[int, Sequence[Any]]


@dataclass(frozen=True)
class Order:
    """An order in which values are exchanged at a communication point.

    Attributes
    ----------
    name : str
    known_as : str
        What the literature calls it.
    text : str
        One line for people.
    arrange : callable
        arrange(sets, gets) -> the operations of a communication point, in order. `sets` and `gets` map each level to
        its operations.
    needs_levels : bool
        It can't run a system with an algebraic loop, whose levels are unknown.
    """

    name: str
    known_as: str
    text: str
    arrange: Callable[[Levelled, Levelled], list[Any]]
    needs_levels: bool


@dataclass(frozen=True)
class Extrapolation:
    """A polynomial through the last values of a connected input, which it follows between two communication points.

    Attributes
    ----------
    name : str
    known_as : str
        What the literature calls it.
    text : str
        One line for people.
    weights : tuple of tuple of float
        Row d - 1 gives the d-th derivative of the input by time, times h^d for a step of h: the sum of weight j times
        the value j steps ago. No row: the input is held.
    start : str
        Extrapolation that is used while fewer values than weights are known: at the start and after a jump.
    """

    name: str
    known_as: str
    text: str
    weights: tuple[tuple[float, ...], ...] = ()
    start: str = ""

    @property
    def degree(self) -> int:
        """Degree of the polynomial."""
        return len(self.weights)

    @property
    def points(self) -> int:
        """Number of values that it goes through, that of this communication point included."""
        return len(self.weights[0]) if self.weights else 1

    def weights_of(self, known: int) -> tuple[tuple[float, ...], ...]:
        """Weights of the extrapolation that is used while `known` values are known, at least 1."""
        return self.weights if known >= self.points else EXTRAPOLATIONS[self.start].weights_of(known)


def _sequential(sets: Levelled, gets: Levelled) -> list[Any]:
    """Level by level: what an output is at a communication point reaches the others at that very point."""
    return [op for level in sorted({*sets, *gets}) for op in (*sets.get(level, ()), *gets.get(level, ()))]


def _parallel(sets: Levelled, gets: Levelled) -> list[Any]:
    """All outputs are read, then all inputs are set."""
    return [op for operations in (*gets.values(), *sets.values()) for op in operations]


#: Orders by name; the first is the default.
ORDERS: dict[str, Order] = {}

#: Extrapolations by name.
EXTRAPOLATIONS: dict[str, Extrapolation] = {}

#: In place of the name of an extrapolation: the default, which is linear where the FMU can and else held.
AUTO = "auto"

#: The extrapolation that `AUTO` stands for where an FMU can.
_AUTO_MEANS = "linear"


def register(entry: Order | Extrapolation) -> None:
    """Add an order or an extrapolation to those that can be named.

    Raises
    ------
    SetupError
        The name is taken, or the weights of an extrapolation are no table of as many columns as its rows need.
    """
    registry: dict[str, Any] = ORDERS if isinstance(entry, Order) else EXTRAPOLATIONS
    if entry.name in registry or entry.name == AUTO:
        raise SetupError(f"{type(entry).__name__.lower()} '{entry.name}' is registered already; choose another name")
    if isinstance(entry, Extrapolation) and entry.weights:
        if any(len(row) != entry.points for row in entry.weights) or entry.points < 2:
            raise SetupError(f"extrapolation '{entry.name}': all rows of weights must have the same length, at least 2")
        if entry.start not in EXTRAPOLATIONS or EXTRAPOLATIONS[entry.start].points >= entry.points:
            raise SetupError(f"extrapolation '{entry.name}': start must name a registered one that needs fewer values")
    registry[entry.name] = entry


register(
    Order(
        "sequential",
        "Gauss-Seidel",
        "outputs reach the inputs that they feed at the same communication point, also through direct feedthrough",
        _sequential,
        needs_levels=True,
    )
)
register(
    Order(
        "parallel",
        "Jacobi",
        "all outputs are read, then all inputs are set: a step more of delay for each direct feedthrough on the way",
        _parallel,
        needs_levels=False,
    )
)
register(Extrapolation("hold", "zero-order hold", "inputs keep their value over the step"))
register(
    Extrapolation(
        "linear",
        "first-order hold, linear extrapolation",
        "inputs go on as from the last communication point to this one",
        weights=((1.0, -1.0),),
        start="hold",
    )
)


def can_be_extrapolated(own: int, source: int) -> bool:
    """Whether an input has a new value at each communication point of its component; else it is held.

    Parameters
    ----------
    own, source : int
        Every how many communication steps its component, and what feeds it, have a communication point.
    """
    return own % source == 0


@dataclass(frozen=True)
class Algorithm:
    """An order of exchange and an extrapolation; see `algorithm`.

    Attributes
    ----------
    order : Order
    extrapolation : Extrapolation
        Where an FMU can; else inputs are held.
    demanded : bool
        An FMU that can't is an error.
    """

    order: Order
    extrapolation: Extrapolation
    demanded: bool


def algorithm(order: str = "sequential", extrapolation: str = AUTO) -> Algorithm:
    """The algorithm of these names.

    Parameters
    ----------
    order : str
        One of `ORDERS`: "sequential" (Gauss-Seidel) or "parallel" (Jacobi).
    extrapolation : str
        One of `EXTRAPOLATIONS`: "hold" (zero-order hold) or "linear" (first-order hold); "auto" is linear where the FMU
        can, and else holds.

    Raises
    ------
    SetupError
        A name is unknown; the message offers those that are known.
    """
    if order not in ORDERS:
        raise SetupError(f"order {order!r} is unknown; use {_choices(ORDERS)}")
    if extrapolation != AUTO and extrapolation not in EXTRAPOLATIONS:
        raise SetupError(f"extrapolation {extrapolation!r} is unknown; use '{AUTO}', {_choices(EXTRAPOLATIONS)}")
    demanded = extrapolation != AUTO
    return Algorithm(ORDERS[order], EXTRAPOLATIONS[extrapolation if demanded else _AUTO_MEANS], demanded)


def _choices(registry: Mapping[str, Order] | Mapping[str, Extrapolation]) -> str:
    """Names with what the literature calls them: "'sequential' (Gauss-Seidel) or 'parallel' (Jacobi)"."""
    *others, last = (f"'{entry.name}' ({entry.known_as})" for entry in registry.values())
    return f"{', '.join(others)} or {last}" if others else last
