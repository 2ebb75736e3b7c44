"""Algorithms of co-simulation, by name: an order of exchange, and what inputs do between communication points.

Both are data: the master builds its table of operations from them, the stability analysis interprets the same data, and
the command line takes its choices from the registries. `docs/extending.md` says how to add one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from cosim.errors import SetupError, positive_whole

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
    auto : str
        Extrapolation that is the default, where FMUs can; elsewhere inputs are linear or held.
    """

    name: str
    known_as: str
    text: str
    arrange: Callable[[Levelled, Levelled], list[Any]]
    needs_levels: bool
    auto: str = "linear"


@dataclass(frozen=True)
class Extrapolation:
    """A polynomial through what is known of a connected input, which it follows between two communication points.

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
    rate_weights : tuple of tuple of float
        The same for the first derivatives of the input, times h, that the FMU which gives it knows; empty where none
        are used.
    is_watched : bool
        Each input goes straight, as by linear extrapolation, unless the polynomial has recently predicted its values at
        least four times as well.
    """

    name: str
    known_as: str
    text: str
    weights: tuple[tuple[float, ...], ...] = ()
    start: str = ""
    rate_weights: tuple[tuple[float, ...], ...] = ()
    is_watched: bool = False

    @property
    def degree(self) -> int:
        """Degree of the polynomial."""
        return len(self.weights)

    @property
    def points(self) -> int:
        """Number of values that it goes by, that of this communication point included."""
        return len(self.weights[0]) if self.weights else 1

    @property
    def uses_rates(self) -> bool:
        """Whether it goes by derivatives of outputs, too."""
        return bool(self.rate_weights)

    @property
    def starting_steps(self) -> int:
        """Steps whose ends must be known for it to have its order; 0 where its first step has it already."""
        if self.degree < 2:
            return 0
        return 1 if self.uses_rates else self.degree

    def used(self, known: int) -> Extrapolation:
        """The extrapolation that is used while `known` values are known, at least 1."""
        return self if known >= self.points else EXTRAPOLATIONS[self.start].used(known)


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

#: In place of the name of an extrapolation: the default, that of the order where FMUs can, else linear, else held.
AUTO = "auto"

#: In place of a communication step: as long as the coupling error allows.
VARIABLE = "variable"

#: In place of a number of iterations: as many as "auto" allows, for algebraic loops only; steps are not repeated.
LOOPS = "loops"

#: Iterations that "auto" allows, at a communication point and of a step.
MOST_ITERATIONS = 50

#: What integrates components in model exchange, by name; see `cosim.master.coupling.model_exchange.Solver`.
SOLVERS = (AUTO, "rk4", "dopri5", "cvode")

#: Derivatives of inputs of a higher order than this are passed to no FMU.
MOST_DEGREE = 3


def register(entry: Order | Extrapolation) -> None:
    """Add an order or an extrapolation to those that can be named.

    Parameters
    ----------
    entry : Order or Extrapolation
        Its name must be new.

    Raises
    ------
    SetupError
        The name is taken, or the weights of an extrapolation are no table of as many columns as its rows need.
    """
    registry: dict[str, Any] = ORDERS if isinstance(entry, Order) else EXTRAPOLATIONS
    if entry.name in registry or entry.name == AUTO:
        raise SetupError(f"{type(entry).__name__.lower()} '{entry.name}' is registered already; choose another name")
    if isinstance(entry, Extrapolation) and entry.weights:
        _check_weights(entry)
    registry[entry.name] = entry


def _check_weights(entry: Extrapolation) -> None:
    least = 1 if entry.uses_rates else 2
    if any(len(row) != entry.points for row in entry.weights) or entry.points < least:
        raise SetupError(
            f"extrapolation '{entry.name}': all rows of weights must have the same length, at least {least}"
        )
    if entry.uses_rates and [len(row) for row in entry.rate_weights] != [entry.points] * entry.degree:
        raise SetupError(f"extrapolation '{entry.name}': rate_weights must have the shape of weights, or be empty")
    needs_start = entry.points > 1
    if needs_start and (entry.start not in EXTRAPOLATIONS or EXTRAPOLATIONS[entry.start].points >= entry.points):
        raise SetupError(f"extrapolation '{entry.name}': start must name a registered one that needs fewer values")
    if entry.degree > MOST_DEGREE:
        raise SetupError(f"extrapolation '{entry.name}': its degree is {entry.degree}, more than {MOST_DEGREE}")
    if needs_start and EXTRAPOLATIONS[entry.start].degree > entry.degree:
        raise SetupError(f"extrapolation '{entry.name}': start must name a registered one of no higher degree")
    if entry.is_watched and entry.points < 3:
        raise SetupError(f"extrapolation '{entry.name}': one that is watched needs at least 3 values")
    if needs_start and EXTRAPOLATIONS[entry.start].uses_rates and not entry.uses_rates:
        raise SetupError(f"extrapolation '{entry.name}': start must name a registered one that uses no derivatives")


register(
    Order(
        "sequential",
        "Gauss-Seidel",
        "outputs reach the inputs that they feed at the same communication point, also through direct feedthrough",
        _sequential,
        needs_levels=True,
        auto="adaptive",
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


def _over(*rows: tuple[int, tuple[int, ...]]) -> tuple[tuple[float, ...], ...]:
    """Weights, each row whole numbers over one denominator."""
    return tuple(tuple(number / denominator for number in numbers) for denominator, numbers in rows)


register(
    Extrapolation(
        "quadratic",
        "quadratic extrapolation",
        "a parabola through the last three values",
        _over((2, (3, -4, 1)), (1, (1, -2, 1))),
        start="linear",
    )
)
register(
    Extrapolation(
        "cubic",
        "cubic extrapolation",
        "a cubic through the last four values",
        _over((6, (11, -18, 9, -2)), (1, (2, -5, 4, -1)), (1, (1, -3, 3, -1))),
        start="quadratic",
    )
)
# those by least squares go through the last value, or inputs would jump; they grow less where a loop oscillates
register(
    Extrapolation(
        "quadratic-least-squares",
        "smoothed quadratic extrapolation",
        "a parabola through the last value, by least squares along the three before",
        _over((38, (42, -31, -26, 15)), (19, (10, -11, -8, 9))),
        start="quadratic",
    )
)
register(
    Extrapolation(
        "cubic-least-squares",
        "smoothed cubic extrapolation",
        "a cubic through the last value, by least squares along the four before",
        _over((414, (625, -706, -183, 398, -134)), (23, (30, -51, -4, 41, -16)), (69, (35, -71, 3, 67, -34))),
        start="cubic",
    )
)
register(
    Extrapolation(
        "tangent",
        "first-order Taylor extrapolation",
        "from the last value on at the rate that its FMU gives",
        _over((1, (0,))),
        rate_weights=_over((1, (1,))),
    )
)
register(
    Extrapolation(
        "hermite",
        "cubic Hermite extrapolation",
        "a cubic through the last two values and the rates there that their FMU gives",
        _over((1, (0, 0)), (1, (-6, 6)), (1, (-12, 12))),
        start="tangent",
        rate_weights=_over((1, (1, 0)), (1, (4, 2)), (1, (6, 6))),
    )
)
register(
    Extrapolation(
        "hermite-least-squares",
        "smoothed cubic Hermite extrapolation",
        "a cubic through the last value, by least squares along the two before and the rates of all three",
        _over((93, (25, -22, -3)), (31, (-22, 2, 20)), (31, (-26, 8, 18))),
        start="hermite",
        rate_weights=_over((558, (497, -112, 5)), (31, (54, -34, 22)), (93, (121, -98, 109))),
    )
)


register(
    Extrapolation(
        "adaptive",
        "smoothed cubic Hermite extrapolation where it predicts values better than a line",
        "as hermite-least-squares where that has lately been four times as good a prediction as a line, else linear",
        EXTRAPOLATIONS["hermite-least-squares"].weights,
        start="hermite",
        rate_weights=EXTRAPOLATIONS["hermite-least-squares"].rate_weights,
        is_watched=True,
    )
)


@cache
def spacing(ratio: float, known: int) -> np.ndarray:
    """Weights (known, known + 1) of values at 0, -1, ... -known, which give those of their polynomial at -ratio, ..."""
    nodes = np.vander(-np.arange(known + 1.0), increasing=True)
    wanted = np.vander(-ratio * np.arange(1.0, known + 1.0), known + 1, increasing=True)
    return np.asarray(wanted @ np.linalg.inv(nodes))


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
        One of `EXTRAPOLATIONS`; "auto" is "adaptive" in sequential order where the FMUs can, else linear, and else
        holds.

    Raises
    ------
    SetupError
        A name is unknown; the message offers those that are known.
    """
    if order not in ORDERS:
        raise SetupError(f"order {order!r} is unknown; use {_choices(ORDERS)}")
    return Algorithm(ORDERS[order], *extrapolation_named(extrapolation, ORDERS[order]))


def extrapolation_named(name: str, order: Order) -> tuple[Extrapolation, bool]:
    """The extrapolation of this name in an order, and whether an FMU that can't is an error, which it isn't for "auto".

    Raises
    ------
    SetupError
        The name is unknown; the message offers those that are known.
    """
    if name != AUTO and name not in EXTRAPOLATIONS:
        raise SetupError(f"extrapolation {name!r} is unknown; use '{AUTO}', {_choices(EXTRAPOLATIONS)}")
    return EXTRAPOLATIONS[order.auto if name == AUTO else name], name != AUTO


def most_iterations(iterations: int | str | None) -> int:
    """Number of iterations at a communication point at most; 0 where algebraic loops are not solved.

    Raises
    ------
    SetupError
        The number makes no sense.
    """
    if iterations is None:
        return 0
    if iterations in (AUTO, LOOPS):
        return MOST_ITERATIONS
    if (number := positive_whole(iterations)) is None:
        raise SetupError(f"iterations = {iterations!r} must be a positive whole number, or '{AUTO}' or '{LOOPS}'")
    return number


def fixed(step_size: float | str, who: str) -> float:
    """A communication step (s), for those who take no variable one.

    Raises
    ------
    SetupError
        It is variable.
    """
    if isinstance(step_size, str):
        raise SetupError(f"{who} a fixed communication step, not '{step_size}'; give one (step_size, or --step)")
    return step_size


def _choices(registry: Mapping[str, Order] | Mapping[str, Extrapolation]) -> str:
    """Names with what the literature calls them: "'sequential' (Gauss-Seidel) or 'parallel' (Jacobi)"."""
    *others, last = (f"'{entry.name}' ({entry.known_as})" for entry in registry.values())
    return f"{', '.join(others)} or {last}" if others else last
