"""Stability of a co-simulation: the transition matrix of linear components that an algorithm couples.

The very operations that the master performs at a communication point and to the next one are interpreted linearly: the
order arranges them and the weights of the extrapolation (`cosim.master.coupling.algorithm`) say how an input goes on.
What the system carries on are the states of the components, the values of their outputs and inputs, and the past values
that the extrapolation needs. Getting outputs, setting inputs and stepping a component are each a linear map of these;
their product over a communication step is the transition matrix. A component is stepped exactly, by a matrix
exponential: what an FMU's own integrator adds is not looked at.

A constant system is stable when the eigenvalues of this matrix lie inside the unit circle. A system that changes along
a path may recover from a short piece where they do not, but not from every such piece. There the matrices of the steps
are multiplied, from many points of the path on, and what counts is by how much a deviation grows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cosim.analysis.linear import LinearComponent, LinearSystem, Node
from cosim.errors import ArgumentError, SetupError
from cosim.master.coupling.algorithm import AUTO, EXTRAPOLATIONS, Algorithm, algorithm, can_be_extrapolated

#: Between which steps (s) the largest stable one is searched by default.
SHORTEST, LONGEST = 1e-4, 1.0

#: Steps that are looked at for a decade, and the relative accuracy to which the limit is then found.
_PER_DECADE = 20
_ACCURACY = 1e-4


#: From how many points of a path on a deviation is followed.
_STARTS = 32

#: Order of the approximation of the matrix exponential.
_PADE = 6


def largest_stable_step(
    system: LinearSystem,
    *,
    order: str = "sequential",
    extrapolation: str = AUTO,
    iterated: bool = False,
    shortest: float = SHORTEST,
    longest: float = LONGEST,
) -> float:
    """Largest communication step at which a co-simulation is stable, and is so at shorter ones.

    Parameters
    ----------
    system : LinearSystem
        With leading axes all of its systems have to be stable.
    order : str
        "sequential" (Gauss-Seidel) or "parallel" (Jacobi), or another registered one.
    extrapolation : str
        "hold" (zero-order hold) or "linear" (first-order hold, linear extrapolation), or another registered one.
        "auto" is analysed as linear, and so is "adaptive", the default of `Simulation`, which falls back to lines.
    iterated : bool
        Each step is repeated until inputs go to what comes out at its end, as `Simulation(iterations="auto")` does;
        "adaptive" and "auto" then follow cubics.
    shortest, longest : float
        Between which steps (s) to search.

    Returns
    -------
    float
        The step (s), to four digits; infinite where the system is stable up to the longest one.

    Raises
    ------
    ArgumentError
        The system is unstable even at the shortest step.
    SetupError
        The algorithm is unknown or can't couple the system.
    """
    chosen = algorithm(order, extrapolation)
    return search(lambda step: stable(system, chosen, step, iterated=iterated), shortest, longest)


def largest_stable_step_along(
    system: LinearSystem,
    duration: float,
    *,
    order: str = "sequential",
    extrapolation: str = AUTO,
    iterated: bool = False,
    growth: float = 3.0,
    shortest: float = SHORTEST,
    longest: float = LONGEST,
) -> float:
    """Largest communication step at which a co-simulation is stable along a path, and is so at shorter ones.

    Stable means that a deviation decays over the whole path (the spectral radius of the product of all transition
    matrices is below 1; on a periodic path its eigenvalues are the Floquet multipliers), and that nowhere it grows to
    more than `growth` times what it grows to with the shortest step, which is as good as the continuous system.

    Parameters
    ----------
    system : LinearSystem
        Linearised along the path, with one leading axis: the points that stand for equally long pieces of it.
    duration : float
        Of the path (s).
    growth : float
        How much more a deviation may grow than with the shortest step.
    order, extrapolation, iterated, shortest, longest
        As in `largest_stable_step`.

    Returns
    -------
    float
        The step (s), to four digits; infinite where the system is stable up to the longest one.

    Raises
    ------
    ArgumentError
        The system is unstable even at the shortest step.
    SetupError
        The algorithm is unknown or can't couple the system.
    """
    chosen = algorithm(order, extrapolation)
    bound = growth * _growth(
        _pieces(_Interpreter(system, chosen, shortest, iterated=iterated), duration), system.states
    )

    def is_stable(step: float) -> bool:
        pieces = _pieces(_Interpreter(system, chosen, step, iterated=iterated), duration)
        return bool(_radius(_product(pieces)) < 1.0) and _growth(pieces, system.states) <= bound

    return search(is_stable, shortest, longest)


def growth_along(
    system: LinearSystem,
    step: float,
    duration: float,
    *,
    order: str = "sequential",
    extrapolation: str = AUTO,
    iterated: bool = False,
) -> float:
    """By what factor a deviation of the states grows at most, from any point of a path to any later one.

    Measured by the Euclidean norm of all states. Parameters and errors are those
    of `largest_stable_step_along` and `transition_matrix`.
    """
    interpreter = _Interpreter(system, algorithm(order, extrapolation), step, iterated=iterated)
    return _growth(_pieces(interpreter, duration), system.states)


def _pieces(interpreter: _Interpreter, duration: float) -> np.ndarray:
    """Transition matrices (points, n, n) over the pieces of a path: the steps that begin in each, multiplied."""
    matrices = interpreter.transition()
    if matrices.ndim != 3:
        raise SetupError("a path needs matrices with one leading axis, the points of the path")
    ends = np.arange(len(matrices) + 1) * (duration / len(matrices) / interpreter.period)
    steps = np.diff(np.ceil(ends - 1e-9).astype(int))
    pieces = np.empty_like(matrices)
    with np.errstate(over="ignore", invalid="ignore"):
        for count in np.unique(steps):
            pieces[steps == count] = np.linalg.matrix_power(matrices[steps == count], int(count))
    return pieces


def _product(pieces: np.ndarray) -> np.ndarray:
    """Transition matrix (n, n) over the whole path."""
    product = np.eye(pieces.shape[-1])
    with np.errstate(over="ignore", invalid="ignore"):
        for piece in pieces:
            product = piece @ product
    return product


def _growth(pieces: np.ndarray, states: int) -> float:
    """Largest norm of the transition matrix of the states, from any of at most 32 starts to any later point."""
    starts = np.unique(np.linspace(0, len(pieces) - 1, min(len(pieces), _STARTS)).astype(int))
    size = pieces.shape[-1]
    products = np.broadcast_to(np.eye(size)[:, :states], (len(starts), size, states)).copy()
    reached = np.zeros((len(pieces), len(starts), states, states))
    with np.errstate(over="ignore", invalid="ignore"):
        for i, piece in enumerate(pieces):
            begun = starts <= i
            products[begun] = piece @ products[begun]
            reached[i, begun] = products[begun, :states]
    if not np.isfinite(reached).all():
        return math.inf
    return float(np.linalg.norm(reached, 2, axis=(-2, -1)).max(initial=1.0))


def search(is_stable: Callable[[float], bool], shortest: float = SHORTEST, longest: float = LONGEST) -> float:
    """Largest step (s) up to which a criterion holds, as `largest_stable_step` says."""
    count = max(2, 1 + math.ceil(_PER_DECADE * math.log10(longest / shortest)))
    steps = np.geomspace(shortest, longest, count)
    first_unstable = next((i for i, step in enumerate(steps) if not is_stable(float(step))), None)
    if first_unstable is None:
        return math.inf
    if first_unstable == 0:
        raise ArgumentError(
            f"the coupled system is unstable even at a communication step of {shortest:g} s; stabilise it, or look at "
            "shorter steps"
        )
    lower, upper = float(steps[first_unstable - 1]), float(steps[first_unstable])
    while upper / lower > 1.0 + _ACCURACY:
        middle = math.sqrt(lower * upper)
        lower, upper = (middle, upper) if is_stable(middle) else (lower, middle)
    return lower


def stable(system: LinearSystem, chosen: Algorithm, step: float, *, iterated: bool = False) -> bool:
    """Whether all eigenvalues of all transition matrices lie inside the unit circle."""
    return bool((_radius(_Interpreter(system, chosen, step, iterated=iterated).transition()) < 1.0).all())


def spectral_radius(
    system: LinearSystem, step: float, *, order: str = "sequential", extrapolation: str = AUTO, iterated: bool = False
) -> np.ndarray:
    """Largest magnitude (...,) of the eigenvalues of the transition matrix; below 1 the co-simulation is stable.

    Parameters and errors are those of `transition_matrix`.
    """
    return _radius(transition_matrix(system, step, order=order, extrapolation=extrapolation, iterated=iterated))


def _radius(matrix: np.ndarray) -> np.ndarray:
    if not np.isfinite(matrix).all():  # of a product that overflowed
        return np.full(matrix.shape[:-2], math.inf)
    radius: np.ndarray = np.abs(np.linalg.eigvals(matrix)).max(axis=-1, initial=0.0)
    return radius


def transition_matrix(
    system: LinearSystem, step: float, *, order: str = "sequential", extrapolation: str = AUTO, iterated: bool = False
) -> np.ndarray:
    """Transition matrix (..., n, n) of a co-simulation over one communication step.

    With components that have communication points of their own it is that over their common period.

    Parameters
    ----------
    system : LinearSystem
    step : float
        Communication step (s).
    order, extrapolation, iterated
        As in `largest_stable_step`.

    Returns
    -------
    array (..., n, n)
        Of what the co-simulation carries from a step to the next: first the states in the order of the components, then
        outputs, inputs and past inputs of which something depends on the values of the step before.

    Raises
    ------
    SetupError
        The step isn't positive, or the algorithm is unknown or can't couple the system.
    """
    return _Interpreter(system, algorithm(order, extrapolation), step, iterated=iterated).transition()


@dataclass(frozen=True)
class _Transfer:
    """Getting outputs, or setting connected inputs, of a component."""

    component: str
    names: tuple[str, ...]
    sets: bool


class _Interpreter:
    """Performs the operations of an algorithm on a linear system, one linear map after the other.

    The carried values stand in a vector; operations change a matrix (..., n, n) of such vectors side by side. It begins
    as the identity and ends as the transition matrix.
    """

    def __init__(self, system: LinearSystem, chosen: Algorithm, step: float, *, iterated: bool = False) -> None:
        if not (step > 0.0 and math.isfinite(step)):
            raise SetupError(f"step = {step!r} must be a positive number of seconds")
        self._system = system
        self._step = step
        self._iterated = iterated
        # one that is watched leaves the choice to the run; it falls back to this, which is linear, unless steps end
        # where inputs went: then it goes by them
        watched = chosen.extrapolation.is_watched and not iterated
        self._extrapolation = EXTRAPOLATIONS["linear"] if watched else chosen.extrapolation
        self._every = {name: system.every.get(name, 1) for name in system.components}
        if system.levels is None and chosen.order.needs_levels:
            raise SetupError(
                f"order '{chosen.order.name}' can't couple the algebraic loop {system.algebraic_loop()}; use an order "
                "that needs no levels, as 'parallel'"
            )
        if iterated and not chosen.order.needs_levels:
            raise SetupError(f"order '{chosen.order.name}' does not iterate steps; use 'sequential'")
        if iterated and (slow := [name for name, every in self._every.items() if every > 1]):
            raise SetupError(f"steps can't be iterated: component '{slow[0]}' has a communication step of its own")
        sets, gets = self._levelled(sets=True), self._levelled(sets=False)
        self._at_point: list[_Transfer] = chosen.order.arrange(sets, gets)
        self._positions: dict[tuple[str, str, str], int] = {}
        self._lay_out()
        self._leading = np.broadcast_shapes(*(c.A.shape[:-2] for c in system.components.values()))
        self._steps = {name: self._exact_step(name, c) for name, c in system.components.items()}

    def _levelled(self, *, sets: bool) -> dict[int, list[_Transfer]]:
        """Transfers by level: one for each component and level, as the master has them."""
        system = self._system
        groups: dict[int, dict[str, list[str]]] = {}
        fed = set(system.sources)
        feeding = set(system.sources.values())
        for name, component in system.components.items():
            names = component.inputs if sets else component.outputs
            for variable in names:
                if (name, variable) in (fed if sets else feeding):
                    level = 0 if system.levels is None else system.levels[name, variable]
                    groups.setdefault(level, {}).setdefault(name, []).append(variable)
        return {
            level: [_Transfer(name, tuple(names), sets) for name, names in of_component.items()]
            for level, of_component in sorted(groups.items())
        }

    def _lay_out(self) -> None:
        """Positions of the carried values, by ("state", component, number) or ("output" and so on, component, name)."""
        system = self._system
        keys = [
            ("state", name, str(i)) for name, component in system.components.items() for i in range(component.states)
        ]
        keys += [("output", *node) for node in dict.fromkeys(system.sources.values())]
        keys += [("input", *node) for node in system.sources]
        moving = [node for node in system.sources if self._is_extrapolated(node)]
        past = range(1, self._extrapolation.points)
        keys += [(f"past {j}", *node) for j in past for node in moving]
        if self._extrapolation.uses_rates:
            keys += [("output rate", *node) for node in dict.fromkeys(system.sources[node] for node in moving)]
            keys += [(f"rate {j}", *node) for j in (0, *past) for node in moving]
        if self._iterated:
            keys += [("ahead", *node) for node in system.sources]
            if self._extrapolation.uses_rates and self._extrapolation.degree > 2:
                keys += [("rate ahead", *node) for node in moving]
        self._positions = {key: i for i, key in enumerate(keys)}

    def _is_extrapolated(self, node: Node) -> bool:
        """Whether an input is, as the master decides: one that gets a value too seldom is held."""
        own, source = self._every[node[0]], self._every[self._system.sources[node][0]]
        return self._extrapolation.degree > 0 and can_be_extrapolated(own, source)

    @property
    def period(self) -> float:
        """Time (s) that the transition matrix spans."""
        return self._step * math.lcm(*self._every.values())

    def transition(self) -> np.ndarray:
        """Transition matrix over the common period of the components, without what it carries in vain."""
        size = len(self._positions)
        values = np.broadcast_to(np.eye(size), (*self._leading, size, size)).copy()
        if self._iterated:
            return _essential(self._solved(values), self._system.states)
        for point in range(math.lcm(*self._every.values())):
            for transfer in self._at_point:
                if point % self._every[transfer.component] == 0:
                    (self._set if transfer.sets else self._get)(transfer, values)
            present = [name for name, every in self._every.items() if point % every == 0]
            if self._extrapolation.uses_rates:
                self._exchange_rates(present, values)
            for name in present:
                self._step_component(name, values)
        return _essential(values, self._system.states)

    def _solved(self, values: np.ndarray) -> np.ndarray:
        """The matrix of a step that is followed by an exchange, where inputs went to what that says."""
        for name in self._system.components:
            self._step_component(name, values)
        for transfer in self._at_point:
            (self._set if transfer.sets else self._get)(transfer, values)
        if self._extrapolation.uses_rates:
            self._exchange_rates(list(self._system.components), values)
        said = {"ahead": "input", "rate ahead": "rate 0"}
        ahead = [key for key in self._positions if key[0] in said]
        n = len(self._positions) - len(ahead)
        found = values[..., [self._positions[said[key[0]], *key[1:]] for key in ahead], :]
        solution = np.linalg.solve(np.eye(len(ahead)) - found[..., n:], found[..., :n])
        return np.asarray(values[..., :n, :n] + values[..., :n, n:] @ solution)

    def _at(self, kind: str, component: str, names: Sequence[str]) -> list[int]:
        return [self._positions[kind, component, name] for name in names]

    def _get(self, transfer: _Transfer, values: np.ndarray) -> None:
        name, component = transfer.component, self._system.components[transfer.component]
        rows = [component.outputs.index(n) for n in transfer.names]
        states, inputs = self._states_of(name), self._fed(name)
        columns = [component.inputs.index(n) for n in inputs]
        outputs = component.C[..., rows, :] @ values[..., states, :]
        if columns:
            outputs = (
                outputs + component.D[..., rows, :][..., columns] @ values[..., self._at("input", name, inputs), :]
            )
        values[..., self._at("output", name, transfer.names), :] = outputs

    def _set(self, transfer: _Transfer, values: np.ndarray) -> None:
        sources = [self._system.sources[transfer.component, n] for n in transfer.names]
        from_outputs = [self._positions["output", *source] for source in sources]
        values[..., self._at("input", transfer.component, transfer.names), :] = values[..., from_outputs, :]

    def _exchange_rates(self, present: Sequence[str], values: np.ndarray) -> None:
        """Derivatives of outputs, scaled by the steps of the components that they feed, level by level."""
        system = self._system
        nodes: dict[int, list[tuple[bool, Node]]] = {}
        for node, source in system.sources.items():
            if self._is_extrapolated(node) and node[0] in present:
                for is_input, key in ((True, node), (False, source)):
                    nodes.setdefault(0 if system.levels is None else system.levels[key], []).append((is_input, key))
        for _, of_level in sorted(nodes.items()):
            for is_input, node in sorted(of_level, reverse=True):  # inputs before outputs
                if is_input:
                    source = system.sources[node]
                    step = self._step * self._every[node[0]]
                    values[..., self._positions["rate 0", *node], :] = (
                        step * values[..., self._positions["output rate", *source], :]
                    )
                else:
                    values[..., self._positions["output rate", *node], :] = self._output_rate(node, values)

    def _output_rate(self, node: Node, values: np.ndarray) -> np.ndarray:
        """Derivative of an output by time (1/s): C (A x + B u) + D u', with the u' that are known."""
        name, component = node[0], self._system.components[node[0]]
        row = [component.outputs.index(node[1])]
        inputs = self._fed(name)
        columns = [component.inputs.index(n) for n in inputs]
        states = component.A @ values[..., self._states_of(name), :]
        states = states + component.B[..., columns] @ values[..., self._at("input", name, inputs), :]
        rate = component.C[..., row, :] @ states
        moving = self._moving(name)
        columns = [component.inputs.index(n) for n in moving]
        step = self._step * self._every[name]
        rate = rate + component.D[..., row, :][..., columns] @ values[..., self._at("rate 0", name, moving), :] / step
        return np.asarray(rate[..., 0, :])

    def _moving(self, name: str) -> list[str]:
        """Inputs of a component that are extrapolated."""
        return [n for n in self._fed(name) if self._is_extrapolated((name, n))]

    def _states_of(self, name: str) -> list[int]:
        return self._at("state", name, [str(i) for i in range(self._system.components[name].states)])

    def _fed(self, name: str) -> list[str]:
        return [n for n in self._system.components[name].inputs if (name, n) in self._system.sources]

    def _step_component(self, name: str, values: np.ndarray) -> None:
        """States and inputs at the end of the step; inputs go on as the extrapolation says."""
        states, inputs = self._states_of(name), self._at("input", name, self._fed(name))
        moving = self._moving(name)
        past = [self._at(f"past {j}", name, moving) for j in range(1, self._extrapolation.points)]
        known = [self._at("input", name, moving), *past]
        rates = [
            self._at(f"rate {j}", name, moving)
            for j in range(self._extrapolation.points if self._extrapolation.uses_rates else 0)
        ]
        series = [values[..., states, :], values[..., inputs, :]]
        if self._iterated and not moving:  # they are held, at the mean of both ends
            series[1] = 0.5 * (series[1] + values[..., self._at("ahead", name, self._fed(name)), :])
        weights: list[tuple[float, ...]] = []
        if moving:
            weights = self._to_the_end() if self._iterated else self._onwards()
        if self._iterated:
            known.append(self._at("ahead", name, moving))
            if self._extrapolation.uses_rates and self._extrapolation.degree > 2:
                rates.append(self._at("rate ahead", name, moving))
        for row in weights:
            # scaled by step^d: the exponential below is that of a step of 1
            derivative = np.zeros_like(series[1])
            of_moving = [inputs.index(position) for position in known[0]]
            terms = zip(row, (*known, *rates), strict=True)
            derivative[..., of_moving, :] = sum(w * values[..., at, :] for w, at in terms)
            series.append(derivative)
        if self._iterated:
            rates = rates[: self._extrapolation.points]
        before = values[..., known[0], :]
        after = self._steps[name] @ np.concatenate(series, axis=-2)
        for newer, older in reversed(list(pairwise(rates))):
            values[..., older, :] = values[..., newer, :]
        for newer, older in reversed(list(pairwise(past))):
            values[..., older, :] = values[..., newer, :]
        if past:
            values[..., past[0], :] = before
        values[..., [*states, *inputs], :] = after

    def _onwards(self) -> list[tuple[float, ...]]:
        """Weights of known values and rates, by which an extrapolation goes on: a row for each derivative."""
        of_rates = self._extrapolation.rate_weights or ((),) * self._extrapolation.degree
        return [(*w, *more) for w, more in zip(self._extrapolation.weights, of_rates, strict=True)]

    def _to_the_end(self) -> list[tuple[float, ...]]:
        """The same of a polynomial to the value at the end of the step, which is behind the known ones, and its rate.

        As cosim/loop/iterated_step.c has it: through the last values, or the rates at both ends.
        """
        degree, points = self._extrapolation.degree, self._extrapolation.points
        by_rates = self._extrapolation.uses_rates and degree > 1
        nodes = [0.0, *(() if by_rates else (-float(j) for j in range(1, degree))), 1.0]
        columns = [0, *(() if by_rates else range(1, degree)), points]
        powers = np.arange(1, degree + 1)
        rows = [[x**k for k in powers] for x in nodes[1:]]  # of values, less the one at 0
        if by_rates:
            rows.append([float(k == 1) for k in powers])
            rows += [[float(k) for k in powers]] * (degree > 2)
        inverse = np.linalg.inv(np.array(rows))
        n_rates = (points + (degree > 2)) if by_rates else points * self._extrapolation.uses_rates
        weights = np.zeros((degree, points + 1 + n_rates))
        for i, column in enumerate(columns[1:]):
            weights[:, column] += inverse[:, i]
            weights[:, 0] -= inverse[:, i]
        if by_rates:
            weights[:, points + 1] = inverse[:, 1]
            if degree > 2:
                weights[:, points + 1 + points] = inverse[:, 2]
        factorials = np.array([math.factorial(k) for k in powers])
        return [tuple(row) for row in weights * factorials[:, None]]

    def _exact_step(self, name: str, component: LinearComponent) -> np.ndarray:
        """Map (..., n + m, n + m + m degree) of states, inputs and their scaled derivatives to those a step later.

        The inputs are polynomials of time: with their derivatives they are states of a larger linear system.
        """
        columns = [component.inputs.index(n) for n in self._fed(name)]
        n, m = component.states, len(columns)
        moving = any(self._is_extrapolated((name, i)) for i in self._fed(name))
        degree = self._extrapolation.degree if moving else 0
        h = self._step * self._every[name]
        generator = np.zeros((*component.A.shape[:-2], n + m * (degree + 1), n + m * (degree + 1)))
        generator[..., :n, :n] = component.A * h
        generator[..., :n, n : n + m] = component.B[..., columns] * h
        for d in range(degree):
            first = n + m * d
            generator[..., first : first + m, first + m : first + 2 * m] = np.eye(m)
        return exponential(generator)[..., : n + m, :]


def exponential(matrix: np.ndarray) -> np.ndarray:
    """Exponential of matrices (..., n, n), all at once: scaling and squaring with the Pade approximant of order 6.

    After Golub and Van Loan, Matrix Computations, algorithm 9.3.1: with a norm of at most 1/2 after scaling the
    relative error is 3e-16. SciPy's takes the matrices one by one, which costs ten times as much, and needs SciPy.
    """
    largest = float(np.abs(matrix).sum(axis=-2).max(initial=0.0))
    squarings = max(0, math.ceil(math.log2(2.0 * largest))) if largest > 0.0 else 0
    scaled = matrix / 2.0**squarings
    numerator = np.broadcast_to(np.eye(matrix.shape[-1]), matrix.shape).copy()
    denominator, power, weight = numerator.copy(), numerator, 1.0
    for k in range(1, _PADE + 1):
        weight *= (_PADE - k + 1) / (k * (2 * _PADE - k + 1))
        power = power @ scaled
        numerator = numerator + weight * power
        denominator = denominator + (-1) ** k * weight * power
    result = np.linalg.solve(denominator, numerator)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(squarings):
            result = result @ result
    return result


def _essential(matrix: np.ndarray, states: int) -> np.ndarray:
    """Without carried values that nothing depends on: each stands for an eigenvalue of 0."""
    needed = np.ones(matrix.shape[-1], dtype=bool)
    while True:
        read = (matrix[..., needed, :] != 0.0).any(axis=tuple(range(matrix.ndim - 1)))
        read[:states] = True
        if (needed <= read).all():
            return matrix[..., needed, :][..., needed]
        needed &= read
