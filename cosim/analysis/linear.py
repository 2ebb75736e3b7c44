"""Linear components with named inputs and outputs, and how they are connected.

All matrices may have leading axes, the same ones or none: the analysis is then made for each of a family of systems at
once, as for the points of a path along which a nonlinear system was linearised.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from cosim.errors import SetupError, nearest, positive_whole
from cosim.system.levels import AlgebraicLoop, levels

#: A variable of the system: (component, variable).
Node = tuple[str, str]

_ELEMENT = re.compile(r"(.*)\[\d+\]")


@dataclass(frozen=True, init=False, eq=False)
class LinearComponent:
    """A component x' = A x + B u, y = C x + D u, in continuous time.

    Parameters
    ----------
    A : array (..., n, n)
        In 1/s; empty for a component without states.
    B : array (..., n, m)
    C : array (..., p, n)
    D : array (..., p, m)
        An element that isn't zero is a direct feedthrough.
    inputs, outputs : sequence of str
        Names of the m inputs and p outputs. Elements of a vector are `name[1]`, `name[2]`, ..., and are connected
        together by `name`.

    Raises
    ------
    SetupError
        The matrices don't fit each other or the names, hold values that are not finite, or a name is given twice.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __init__(self, A: Any, B: Any, C: Any, D: Any, inputs: Iterable[str], outputs: Iterable[str]) -> None:
        names_in, names_out = tuple(inputs), tuple(outputs)
        m, p = len(names_in), len(names_out)
        n = np.shape(A)[-1] if np.size(A) else 0
        for names in (names_in, names_out):
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise SetupError(f"linear component: '{twice}' is named twice; give each variable a name of its own")
        for name, value, shape in (("A", A, (n, n)), ("B", B, (n, m)), ("C", C, (p, n)), ("D", D, (p, m))):
            object.__setattr__(self, name, _matrix(name, value, shape))
        object.__setattr__(self, "inputs", names_in)
        object.__setattr__(self, "outputs", names_out)

    @classmethod
    def from_state_space(cls, system: Any) -> LinearComponent:
        """The component that a `control.StateSpace` describes, with the names of its signals.

        Raises
        ------
        SetupError
            It is not a state space in continuous time.
        """
        if not all(hasattr(system, name) for name in ("A", "B", "C", "D", "input_labels", "output_labels")):
            raise SetupError(f"{type(system).__name__} is not a state space; linearise it first, by control.linearize")
        if getattr(system, "dt", None) not in (0, None):
            raise SetupError(f"the state space is sampled every {system.dt} s; give it in continuous time")
        return cls(system.A, system.B, system.C, system.D, system.input_labels, system.output_labels)

    @property
    def states(self) -> int:
        """Number of states."""
        return int(self.A.shape[-1])


def _matrix(name: str, value: Any, shape: tuple[int, int]) -> np.ndarray:
    matrix = np.asarray(value, dtype=float)
    if matrix.size == 0 and 0 in shape:
        leading = matrix.shape[:-2] if matrix.ndim > 2 else ()
        return np.zeros((*leading, *shape))
    if matrix.ndim < 2 or matrix.shape[-2:] != shape:
        raise SetupError(
            f"linear component: {name} has the shape {matrix.shape} and must have {shape}, after leading axes, to fit "
            "the states, inputs and outputs"
        )
    if not np.isfinite(matrix).all():
        raise SetupError(f"linear component: {name} has values that are not finite")
    return matrix


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Linear components and the connections between them.

    Inputs that nothing feeds stay at their value and are left out of the analysis, as signals are: neither changes
    whether the system is stable.

    Attributes
    ----------
    components : mapping
        Name -> component.
    connections : sequence of (str, str)
        Source and target as `component.variable`; a vector is connected element by element.
    every : mapping
        Component -> number of communication steps between two of its communication points; 1 by default.

    Raises
    ------
    SetupError
        A connection names what isn't there, vectors have different sizes, an input is fed twice, or a number of steps
        isn't a positive whole one.
    """

    components: Mapping[str, LinearComponent]
    connections: Sequence[tuple[str, str]]
    every: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for component, every in self.every.items():
            if component not in self.components:
                raise SetupError(f"every: there is no component '{component}'; {nearest(component, self.components)}")
            if positive_whole(every) is None:
                raise SetupError(f"component '{component}': every = {every!r} must be a positive whole number of steps")
        _ = self.sources  # connections are checked at once

    @property
    def states(self) -> int:
        """Number of states of all components."""
        return sum(component.states for component in self.components.values())

    @cached_property
    def sources(self) -> dict[Node, Node]:
        """Input -> the output that feeds it, elements each."""
        sources: dict[Node, Node] = {}
        for source, target in self.connections:
            outputs, inputs = self._elements(source, "output"), self._elements(target, "input")
            if len(outputs) != len(inputs):
                raise SetupError(
                    f"'{source}' with {len(outputs)} elements can't feed '{target}' with {len(inputs)}; connect the "
                    "elements one by one"
                )
            for output, fed in zip(outputs, inputs, strict=True):
                if fed in sources:
                    raise SetupError(f"'{'.'.join(fed)}' is fed twice; remove one of the connections to it")
                sources[fed] = output
        return sources

    def _elements(self, path: str, kind: str) -> list[Node]:
        """An output or input, or all elements of a vector."""
        component, _, name = path.partition(".")
        if component not in self.components:
            raise SetupError(f"'{path}': there is no component '{component}'; {nearest(component, self.components)}")
        known = getattr(self.components[component], f"{kind}s")
        found = [n for n in known if n == name]
        if not found:
            vector = [n for n in known if (match := _ELEMENT.fullmatch(n)) and match[1] == name]
            found = sorted(vector, key=lambda n: int(n[len(name) + 1 : -1]))
        if not found:
            raise SetupError(f"component '{component}' has no {kind} '{name}'; {nearest(name, known)}")
        return [(component, n) for n in found]

    @cached_property
    def levels(self) -> dict[Node, int] | None:
        """Level of each connected input and each output, see `cosim.system.levels`; None with an algebraic loop."""
        try:
            return levels(self._feeds(), set(self.sources))
        except AlgebraicLoop:
            return None

    def algebraic_loop(self) -> str:
        """The algebraic loop, for messages; empty if there is none."""
        try:
            levels(self._feeds(), set(self.sources))
        except AlgebraicLoop as error:
            return str(error)
        return ""

    def _feeds(self) -> dict[Node, set[Node]]:
        feeds: dict[Node, set[Node]] = {target: {source} for target, source in self.sources.items()}
        for name, component in self.components.items():
            through = (component.D != 0.0).any(axis=tuple(range(component.D.ndim - 2)))
            for i, output in enumerate(component.outputs):
                inputs = ((name, component.inputs[j]) for j in np.flatnonzero(through[i]))
                feeds[name, output] = {node for node in inputs if node in self.sources}
        return feeds

    def poles(self) -> np.ndarray:
        """Poles (..., n) in 1/s of the system coupled without a communication step.

        Raises
        ------
        SetupError
            An algebraic loop has no solution, or not one only.
        """
        return np.linalg.eigvals(self.closed_loop())

    def closed_loop(self) -> np.ndarray:
        """Matrix A (..., n, n) in 1/s of the system coupled without a communication step, x' = A x.

        The states stand in the order of the components.

        Raises
        ------
        SetupError
            An algebraic loop has no solution, or not one only.
        """
        A, B, C, D = (self._side_by_side(name) for name in "ABCD")
        outputs = {node: i for i, node in enumerate(self._nodes("outputs"))}
        K = np.zeros((B.shape[-1], C.shape[-2]))  # u = K y
        for i, node in enumerate(self._nodes("inputs")):
            if node in self.sources:
                K[i, outputs[self.sources[node]]] = 1.0
        try:
            matrix: np.ndarray = A + B @ np.linalg.solve(np.eye(len(K)) - K @ D, K @ C)
        except np.linalg.LinAlgError:
            raise SetupError(f"the algebraic loop {self.algebraic_loop()} has no single solution") from None
        return matrix

    def _nodes(self, kind: str) -> list[Node]:
        return [(name, n) for name, component in self.components.items() for n in getattr(component, kind)]

    def _side_by_side(self, name: str) -> np.ndarray:
        """The matrices of this name of all components along the diagonal of one."""
        blocks = [getattr(component, name) for component in self.components.values()]
        rows, columns = (np.cumsum([0, *(b.shape[axis] for b in blocks)]) for axis in (-2, -1))
        leading = np.broadcast_shapes(*(b.shape[:-2] for b in blocks))
        matrix = np.zeros((*leading, rows[-1], columns[-1]))
        for block, (top, bottom), (left, right) in zip(blocks, pairwise(rows), pairwise(columns), strict=True):
            matrix[..., top:bottom, left:right] = block
        return matrix
