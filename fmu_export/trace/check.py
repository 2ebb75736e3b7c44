"""The check of traced functions against the numpy functions that they were traced from.

What is exported is the trace, so a trace that computes something else is refused before a build. Both are evaluated at
the start values, at random points, where arguments are zero, halves, constants of the equations or each other's values,
and on both sides of the edges of comparisons. The trace is evaluated as C and Python will: instruction by
instruction, for many points at once.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from fmu_export.errors import TraceError, needs
from fmu_export.modelling.model import Model
from fmu_export.modelling.tables import Table
from fmu_export.trace.instructions import instructions
from fmu_export.trace.operations import OPERATIONS, call_of
from fmu_export.trace.symbols.refusal import place_of_function

with needs("export"):
    import casadi as ca

#: Values that differ by less are equal: rounding in another order of operations.
RELATIVE_TOLERANCE = 1e-11
#: Differences below this many bounds of the rounding errors are no differences: what cancels keeps few digits.
ROUNDING = 1e3
#: Whole numbers below it are exact.
MOST_WHOLE = 2.0**53
#: Points at which numpy is evaluated: so many for a graph without instructions, half of it for one of the usual size,
#: and so on. They follow from the model alone, so that the verdict is the same on every machine.
MOST_POINTS, FEWEST_POINTS, USUAL_SIZE = 360, 24, 600

#: Arguments of one point: time (), states (n_x,), inputs (n_u,), parameters (n_p,); or of many, with a further axis.
Points = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class Program:
    """The instructions of a traced function, to be evaluated for many points at once."""

    def __init__(self, f: ca.Function, tables: Sequence[Table] = ()) -> None:
        self.tables = tables
        self.n_work, self.n_out = f.sz_w(), f.numel_out(0)
        self.instructions = instructions(f)

    @property
    def constants(self) -> list[float]:
        """The numbers in the equations."""
        return sorted({c for operation, _, _, c in self.instructions if operation == ca.OP_CONST})

    def __call__(self, points: Points) -> tuple[np.ndarray, list[np.ndarray]]:
        """Results (n_out, n), and of each comparison left side minus right side (n,)."""
        work: list[Any] = [0.0] * max(self.n_work, 1)
        result = np.zeros((self.n_out, len(points[0])))
        margins = []
        with np.errstate(all="ignore"):
            for operation, operands, targets, constant in self.instructions:
                if operation == ca.OP_CONST:
                    work[targets[0]] = np.float64(constant)
                elif operation == ca.OP_INPUT:
                    argument = points[operands[0]]
                    work[targets[0]] = argument if argument.ndim == 1 else argument[:, operands[1]]
                elif operation == ca.OP_OUTPUT:
                    result[targets[1]] = work[operands[0]]
                else:
                    values = [work[i] for i in operands]
                    if operation != ca.OP_CALL and OPERATIONS[operation].compares:
                        margins.append(np.broadcast_to(values[0] - values[1], result.shape[1:]))
                    work[targets[0]] = self.apply(operation, *values)
        return result, margins

    def apply(self, operation: int, *values: Any) -> Any:
        """What an operation computes."""
        if operation == ca.OP_CALL:
            return call_of(self.tables[int(values[0])], values)
        return OPERATIONS[operation].values(*values)

    def rounding(self, points: Points) -> np.ndarray:
        """Bounds (n_out, n) of the rounding errors, by propagating those of each instruction."""
        work: list[Any] = [0.0] * max(self.n_work, 1)
        errors: list[Any] = [None] * max(self.n_work, 1)  # None is exact
        bounds = np.zeros((self.n_out, len(points[0])))
        with np.errstate(all="ignore"):
            for operation, operands, targets, constant in self.instructions:
                if operation == ca.OP_OUTPUT:
                    bounds[targets[1]] = 0.0 if errors[operands[0]] is None else errors[operands[0]]
                    continue
                error: Any = None
                value: Any
                if operation == ca.OP_CONST:
                    value = np.float64(constant)
                elif operation == ca.OP_INPUT:
                    argument = points[operands[0]]
                    value = argument if argument.ndim == 1 else argument[:, operands[1]]
                else:
                    values = [work[i] for i in operands]
                    apply = partial(self.apply, operation)
                    value = apply(*values)
                    if operation == ca.OP_CALL:
                        error = 1e-15 * np.abs(self.tables[int(values[0])].values).max()
                    elif not (OPERATIONS[operation].exact or OPERATIONS[operation].compares):
                        error = np.where(_is_exact(operation, values, value), 0.0, np.abs(value) * 2.3e-16)
                    for i, operand in enumerate(operands):
                        for side in (-1.0, 1.0) if errors[operand] is not None else ():
                            near = values.copy()
                            near[i] = values[i] + side * errors[operand]
                            error = (0.0 if error is None else error) + np.abs(apply(*near) - value)
                work[targets[0]], errors[targets[0]] = value, error
        return np.where(np.isnan(bounds), np.inf, bounds)


def _is_exact(operation: int, values: Sequence[Any], value: Any) -> Any:
    """Where a result needs no rounding."""
    if operation in (ca.OP_ADD, ca.OP_SUB):
        a, b = values[0], values[1] if operation == ca.OP_ADD else -values[1]
        return (value - a == b) & (value - b == a)
    whole = np.abs(value) < MOST_WHOLE
    for v in (*values, value):
        whole = whole & (v == np.floor(v))
    return whole


@dataclass(frozen=True)
class Checked:
    """A function of a model and its trace: `numpy(t, x, u, p)` and what it is called, element by element."""

    name: str
    numpy: Callable[[Any, Any, Any, Any], Any]
    traced: ca.Function
    elements: tuple[str, ...]


def check_against_numpy(model: Model, functions: Sequence[Checked], tables: Sequence[Table] = ()) -> None:
    """Compare traced functions of (t, x, u, p) with those that they were traced from.

    Raises
    ------
    TraceError
        They differ at some point, numpy gives different values for equal arguments, changes its arguments, or an
        output has the name of a state and is something else.
    """
    functions = [f for f in functions if f.elements]
    if not functions:
        return
    joined = ca.Function(
        "joined",
        functions[0].traced.sx_in(),
        [ca.vertcat(*(f.traced(*functions[0].traced.sx_in()) for f in functions))],
    )
    program = Program(joined, tables)
    check = _Check(model, functions, program)
    start = check.start()
    n = max(FEWEST_POINTS, MOST_POINTS * USUAL_SIZE // (USUAL_SIZE + len(program.instructions)))
    pools = [check.candidates(start, seed) for seed in range(1 + n // 192)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        first = check.values(_row(start, 0))
        check.compare(start)
        left = n - check.compare(check.chosen(pools[0].kinks, n // 4))
        left -= check.compare(check.edges(pools[0].all, n // 6))
        for pool in pools:
            left -= check.compare(check.chosen(pool.random, max(left, 0)))
        check.same_again(_row(start, 0), first)
    if not check.compared:
        raise TraceError(
            f"{model.name}: the equations can't be checked, since numpy has no finite values at any point tried"
            f"{check.failure}; correct the start values, or build with unchecked=True"
        )


@dataclass(frozen=True)
class _Pool:
    random: Points
    kinks: Points

    @property
    def all(self) -> Points:
        return tuple(np.concatenate(pair) for pair in zip(self.random, self.kinks, strict=True))  # type: ignore[return-value]


class _Check:
    """What the parts of one check share."""

    def __init__(self, model: Model, functions: Sequence[Checked], program: Program) -> None:
        self.model, self.functions, self.program = model, functions, program
        states = (*model.state_layout.names, *model.discrete.names)  # discrete states follow the others here
        self.sizes = len(states), len(model.inputs), len(model.parameters)
        self.compared = False
        self.failure = ""
        self.limits = _limits(model)
        first = 1 + len(model.state_layout)
        declared = [v for layout in (model.inputs, model.parameters) for v in layout.variables for _ in v.names]
        self.others = [(first + i, v) for i, v in enumerate(declared) if v.type != "real"]
        outputs = list(model.returned.names)
        self.states = [(outputs.index(s), i) for i, s in enumerate(states) if s in outputs]

    def start(self) -> Points:
        """The start values, as one point."""
        p, u = self.model.parameters.starts, self.model.inputs.starts
        try:
            with np.errstate(all="ignore"):
                parts = self.model.initial_state(p.copy()), self.model.initial_discrete_state(p.copy())
                x = np.concatenate([np.asarray(part, dtype=float).ravel() for part in parts]).reshape(self.sizes[0])
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            x = np.zeros(self.sizes[0])
        t = np.array([float(self.model.default_experiment.start_time)])
        return t, x[None], np.array(u, dtype=float)[None], np.array(p, dtype=float)[None]

    def candidates(self, start: Points, seed: int) -> _Pool:
        """Points from which those are chosen that numpy is evaluated at."""
        rng = np.random.default_rng(seed)
        n = 192
        centre = np.concatenate([np.nan_to_num(a.ravel()) for a in start])
        flat = np.tile(centre, (n, 1))
        near = rng.uniform(-1.0, 1.0, flat.shape)
        flat[:64] += near[:64] * (0.05 * np.abs(centre) + 0.02 * (centre == 0.0))
        flat[64:128] += near[64:128] * (np.abs(centre) + 2.0)
        flat[128:] = 10.0 ** rng.uniform(-4.0, 8.0, flat[128:].shape) * np.sign(near[128:])
        few = rng.random(flat[128:].shape) < max(0.5, 1.0 / max(flat.shape[1], 1))
        flat[128:] = np.where(few, flat[128:], np.tile(centre, (n - 128, 1)))
        flat = rng.permutation(self.within_limits(flat), axis=0)
        numbers = [c for c in self.program.constants if abs(c) < 1e300]
        special = np.unique([*(k / 2.0 for k in range(-7, 8)), *numbers, *(-c for c in numbers)])
        kinks = flat.copy()
        which = rng.random(kinks.shape) < rng.choice([0.15, 0.5, 1.0], (n, 1))
        values = rng.choice(special, kinks.shape)
        values = np.where(rng.random(kinks.shape) < 0.1, values * (1.0 + 1e-9 * near), values)
        values = np.where((values == 0.0) & (near < 0.0), -0.0, values)
        kinks = np.where(which, values, kinks)
        ties = rng.random(kinks.shape) < 0.15
        kinks = np.where(ties, np.take_along_axis(kinks, rng.integers(kinks.shape[1], size=kinks.shape), 1), kinks)
        return _Pool(self.split(flat), self.split(self.within_limits(kinks)))

    def within_limits(self, flat: np.ndarray) -> np.ndarray:
        """Parameters and inputs moved to values that they are declared to have; time not before 0."""
        clipped: np.ndarray = np.clip(flat, *self.limits)
        for column, v in self.others:
            if v.items:
                numbers = np.array([number for _, number in v.items], dtype=float)
                clipped[:, column] = numbers[np.nan_to_num(np.abs(clipped[:, column])).astype(int) % len(numbers)]
            else:
                clipped[:, column] = np.rint(clipped[:, column]) if v.type == "integer" else clipped[:, column] > 0.0
        return clipped

    def split(self, flat: np.ndarray) -> Points:
        """Points (n, 1 + n_x + n_u + n_p) by arguments."""
        n_x, n_u, _ = self.sizes
        return flat[:, 0], flat[:, 1 : 1 + n_x], flat[:, 1 + n_x : 1 + n_x + n_u], flat[:, 1 + n_x + n_u :]

    def chosen(self, points: Points, n: int) -> Points:
        """Points at which the trace is finite, and some at which it is not."""
        values, _ = self.program(points)
        finite = np.isfinite(values).all(axis=0)
        good, others = np.flatnonzero(finite), np.flatnonzero(~finite)
        rows = [*good[: n - min(len(others), n // 4)], *others[: n // 4]]
        return _rows_of(points, rows)

    def edges(self, points: Points, n: int) -> Points:
        """Both sides of the edge of each comparison, by bisection between points on different sides."""
        flat = _flat(points)
        values, margins = self.program(points)
        finite = np.isfinite(values).all(axis=0)
        pairs = []
        for i, margin in enumerate(margins):
            below = np.flatnonzero((margin < 0.0) & finite)
            above = np.flatnonzero((margin > 0.0) & finite)
            if len(below) and len(above):
                pairs.append((i, below[0], above[0]))
        pairs = pairs[:n]
        if not pairs:
            return _rows_of(points, [])
        which, low, high = (np.array(column) for column in zip(*pairs, strict=True))
        a, b = flat[low], flat[high]
        rows = np.arange(len(pairs))
        for _ in range(min(60, 60_000 // max(len(self.program.instructions), 1))):
            middle = 0.5 * (a + b)
            margin = np.stack(self.program(self.split(middle))[1])[which, rows]
            a = np.where((margin < 0.0)[:, None], middle, a)
            b = np.where((margin < 0.0)[:, None], b, middle)
        return self.split(np.concatenate([a, b]))

    def values(self, point: Sequence[Any]) -> np.ndarray | None:
        """What numpy computes at a point, or None where it raises an error."""
        t, x, u, p = point
        results = []
        with np.errstate(all="ignore"):
            for f in self.functions:
                arguments = float(t), x.copy(), u.copy(), p.copy()
                try:
                    value = np.asarray(f.numpy(*arguments), dtype=float)
                except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
                    self.failure = f" ({f.name}: {error})"
                    return None
                for name, before, after in zip("xup", (x, u, p), arguments[1:], strict=True):
                    if before.tobytes() != after.tobytes():
                        raise TraceError(
                            f"{self.model.name}: {self.named(f)} changes its argument {name}; change {name}.copy()"
                        )
                if value.shape != (len(f.elements),) and not (value.shape == () and len(f.elements) == 1):
                    raise TraceError(
                        f"{self.model.name}: {self.named(f)} returns an array of shape {value.shape} in numpy; "
                        f"({len(f.elements)},) is declared"
                    )
                results.append(value.reshape(-1))
        return np.concatenate(results)

    def same_again(self, point: Sequence[Any], first: np.ndarray | None) -> None:
        """Refuse functions whose values are others when they are called again."""
        again = self.values(point)
        if first is None or again is None:
            return
        for i in np.flatnonzero(~((first == again) | (np.isnan(first) & np.isnan(again)))):
            name, element = self.element(int(i))
            raise TraceError(
                f"{self.model.name}: {name}, element {element}: called twice with the same arguments numpy computes "
                f"{first[i]!r}, then {again[i]!r}; a function may depend on its arguments only, not on np.random, "
                "clocks, counters or what an earlier call has left; make it a parameter, an input or a state"
            )

    def named(self, f: Checked) -> str:
        """A function with the place of its definition."""
        return place_of_function(f.numpy) + f.name

    def element(self, i: int) -> tuple[str, str]:
        """Function, with its place, and element of a position in the joined results."""
        for f in self.functions:
            if i < len(f.elements):
                return self.named(f), f.elements[i]
            i -= len(f.elements)
        raise IndexError(i)

    def compare(self, points: Points) -> int:
        """Refuse what differs at one of the points; their number."""
        found, _ = self.program(points)
        results = [self.values(_row(points, k)) for k in range(len(points[0]))]
        rows = [k for k, result in enumerate(results) if result is not None]
        if not rows:
            return len(results)
        points, found = _rows_of(points, rows), found[:, rows]
        expected = np.stack([r for r in results if r is not None], axis=1)
        finite = np.isfinite(expected)
        self.compared |= bool(finite.all(axis=0).any())
        with np.errstate(all="ignore"):
            scale = np.maximum(np.abs(expected), np.where(np.isfinite(found), np.abs(found), 0.0))
            wrong = finite & ~(np.abs(found - expected) <= RELATIVE_TOLERANCE * scale) & self.defined(expected)
            others = self.other_states(expected, points[1])
            for columns in (wrong, others):
                if (which := np.flatnonzero(columns.any(axis=0))).size:
                    bounds = ROUNDING * self.program.rounding(_rows_of(points, which.tolist()))
                    gap = found if columns is wrong else self.as_states(expected, points[1])
                    columns[:, which] &= ~(np.abs(gap - expected)[:, which] <= bounds)
        for i, k in np.argwhere(others):
            _, element = self.element(int(i))
            raise TraceError(
                f"{self.model.name}: output_values, element {element}: the output has the name of a state, which is "
                f"{float(self.as_states(expected, points[1])[i, k])!r}, but numpy computes {float(expected[i, k])!r}; "
                "give the output another name"
            )
        for i, k in np.argwhere(wrong):
            self.refuse(int(i), expected[i, k], found[i, k], _row(points, int(k)))
        return len(results)

    def defined(self, expected: np.ndarray) -> np.ndarray:
        """Which results the model answers for: all where its requirements hold, and else the requirements alone.

        Where one is violated the equations need make no sense, and rounding can be all that they give.
        """
        requirements = np.array([f.name == "requirements" for f in self.functions for _ in f.elements])
        holds = (expected[requirements] > 0.0).all(axis=0)
        defined: np.ndarray = requirements[:, None] | holds
        return defined

    def as_states(self, expected: np.ndarray, x: np.ndarray) -> np.ndarray:
        """The results with the states themselves in place of the outputs that have their names."""
        result, first = expected.copy(), 0
        for f in self.functions:
            if f.name == "output_values":
                for output, state in self.states:
                    result[first + output] = x[:, state]
            first += len(f.elements)
        return result

    def other_states(self, expected: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Where outputs with the name of a state differ from it."""
        states = self.as_states(expected, x)
        same: np.ndarray = np.abs(expected - states) <= RELATIVE_TOLERANCE * np.abs(states)
        others: np.ndarray = np.isfinite(expected) & ~same
        return others

    def refuse(self, i: int, expected: float, found: float, point: Sequence[Any]) -> None:
        """Say what differs, where, and why that may be."""
        name, element = self.element(i)
        where = ", ".join(
            f"{n} = {np.array2string(np.asarray(v), threshold=6, precision=4)}".replace("\n", "")
            for n, v in zip("txup", point, strict=True)
            if np.size(v)
        )
        if not np.isfinite(found):
            cause = "there the equations have no finite value, such as a division by 0 in a branch that is not taken"
        elif abs(found) >= MOST_WHOLE and found == np.floor(found) and expected == np.floor(expected):
            cause = (
                "whole numbers beyond 2^53, which numpy keeps in 64 bits; compute with floats, or bound them by np.clip"
            )
        else:
            cause = "a value that was fixed while tracing, or a numpy function that acts otherwise on symbols"
        raise TraceError(
            f"{self.model.name}: {name}, element {element}: numpy computes {float(expected)!r}, the traced equations "
            f"{float(found)!r} at {where}; likely cause: {cause}; write it with what the page "
            "'numpy that can be traced' lists, or build with unchecked=True"
        )


def _limits(model: Model) -> tuple[np.ndarray, np.ndarray]:
    n_x = len(model.state_layout)
    low, high = [0.0] + [-np.inf] * n_x, [np.inf] * (1 + n_x)
    for layout in (model.discrete, model.inputs, model.parameters):
        for v in layout.variables:
            low += [-np.inf if v.min is None else v.min] * v.n_elements
            high += [np.inf if v.max is None else v.max] * v.n_elements
    return np.array(low), np.array(high)


def _flat(points: Points) -> np.ndarray:
    return np.concatenate([points[0][:, None], *points[1:]], axis=1)


def _rows_of(points: Points, rows: Sequence[int]) -> Points:
    index = np.array(rows, dtype=int)
    return points[0][index], points[1][index], points[2][index], points[3][index]


def _row(points: Points, k: int) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
    return points[0][k], points[1][k], points[2][k], points[3][k]
