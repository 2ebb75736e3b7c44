"""The functions of a model that change states at once, by events and sampling, as functions of (t, x, z, u, p)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from fmu_export.errors import TraceError, needs
from fmu_export.modelling.model import Event, Model, Sampled
from fmu_export.trace.symbols.context import column

with needs("export"):
    import casadi as ca


@dataclass(frozen=True)
class Change:
    """A function of a model that an event or a sampler calls.

    `parts(t, x, z, u, p)` returns arrays that together have these elements; each is of the states, of the discrete
    states or a scalar, as `sizes` says. `name` is that of the traced function, `called` what messages call it.
    """

    name: str
    called: str
    parts: Callable[..., tuple[Any, ...]]
    sizes: tuple[int, ...]
    elements: tuple[str, ...]

    def traced(self, *arguments: Any) -> ca.SX:
        """What it returns for symbols, as a column."""
        columns = [column(v, self.called, n) for v, n in zip(self.parts(*arguments), self.sizes, strict=True)]
        return ca.vertcat(ca.SX(0, 1), *columns)

    def computed(self, *arguments: Any) -> np.ndarray:
        """What it returns for numbers, as one array."""
        values = [np.asarray(v, dtype=float) for v in self.parts(*arguments)]
        for value, n in zip(values, self.sizes, strict=True):
            if value.shape != (n,) and not (value.shape == () and n == 1):
                raise TraceError(f"{self.called} returns an array of shape {value.shape} in numpy; ({n},) is declared")
        return np.concatenate([np.zeros(0), *(v.reshape(-1) for v in values)])


def changes(model: Model) -> list[Change]:
    """What changes states at once: initial discrete states, indicators, resets `reset_0` ..., updates `update_0` ...

    Raises
    ------
    TraceError
        A reset returns something else than the states, or states and discrete states.
    """
    if model.is_continuous:
        return []
    x, z = model.state_layout.names, model.discrete.names
    found = [
        Change("initial_discrete", "initial_discrete", partial(_initial, model), (len(z),), z),
        Change(
            "indicators",
            "the indicators of events",
            partial(_indicators, model),
            (1,) * len(model.events),
            tuple(f"'{event.name}'" for event in model.events),
        ),
    ]
    for i, event in enumerate(model.events):
        called = f"the reset of '{event.name}'"
        sizes = (len(x), len(z)) if z else (len(x),)
        found.append(Change(f"reset_{i}", called, partial(_reset, model, event, called), sizes, (*x, *z)))
    for i, sampled in enumerate(model.sampled):
        called = f"the update of '{sampled.name}'"
        found.append(Change(f"update_{i}", called, partial(_update, model, sampled), (len(z),), z))
    return found


def instants(model: Model, p: ca.SX) -> ca.SX:
    """Period and offset of each sampler, one after the other, for the parameters p."""
    values = [value for sampled in model.sampled for value in (sampled.period, sampled.offset)]
    return ca.vertcat(ca.SX(0, 1), *(p[model.parameters.names.index(v)] if isinstance(v, str) else v for v in values))


def _initial(model: Model, t: Any, x: Any, z: Any, u: Any, p: Any) -> tuple[Any, ...]:  # noqa: ARG001
    return (model.initial_discrete_state(p),)


def _indicators(model: Model, *arguments: Any) -> tuple[Any, ...]:
    return tuple(event.indicator(*model.arguments(*arguments)) for event in model.events)


def _reset(model: Model, event: Event, called: str, *arguments: Any) -> tuple[Any, ...]:
    after = event.reset(*model.arguments(*arguments))
    if not len(model.discrete):
        return (after,)
    if not isinstance(after, tuple) or len(after) != 2:
        raise TraceError(
            f"{model.name}: {called} must return a pair: the states and the discrete states after the event"
        )
    return after


def _update(model: Model, sampled: Sampled, *arguments: Any) -> tuple[Any, ...]:
    return (sampled.update(*model.arguments(*arguments)),)


@dataclass(frozen=True)
class Influence:
    """Which inputs and parameters states depend on at one instant, by events and samplers.

    `inputs` and `parameters` have a set of indices for each state, then for each discrete state.
    """

    inputs: tuple[frozenset[int], ...]
    parameters: tuple[frozenset[int], ...]


def influence(model: Model, functions: Mapping[str, ca.Function], initial: ca.Function | None = None) -> Influence:
    """Follow inputs and parameters through the functions of events and samplers.

    Parameters
    ----------
    model, functions : Model, mapping
        The traced functions of `changes`, by name.
    initial : casadi.Function, optional
        (p) -> the states at the start: then what these depend on counts too, as at the initialisation.
    """
    n_x, names = len(model.state_layout), model.parameters.names
    before = rows(initial.jac_sparsity(0, 0)) if initial else []
    inputs: list[set[int]] = [set() for _ in range(n_x + len(model.discrete))]
    parameters = [set(before[i]) if before else set() for i in range(len(inputs))]

    def through(f: ca.Function, first: int, cause: _Cause, states: bool) -> None:
        """Add to the elements from `first` on, if f changes them, what they depend on and what causes the change."""
        for i, own in enumerate(_causes(f, n_x)):
            if not _is_unchanged(f, first + i, i, n_x):
                read = (*cause.states, *(own.states if states else ()))
                inputs[first + i].update(cause.inputs, own.inputs, *(inputs[j] for j in read))
                parameters[first + i].update(cause.parameters, own.parameters, *(parameters[j] for j in read))

    for k, sampled in enumerate(model.sampled):
        times = tuple(names.index(v) for v in (sampled.period, sampled.offset) if isinstance(v, str))
        # samplers see the states as they were before
        through(functions[f"update_{k}"], n_x, _Cause((), times, ()), states=initial is not None)
    size = -1
    while size != (size := sum(map(len, (*inputs, *parameters)))):
        for k, cause in enumerate(_causes(functions["indicators"], n_x)):
            through(functions[f"reset_{k}"], 0, cause, states=True)
    return Influence(tuple(map(frozenset, inputs)), tuple(map(frozenset, parameters)))


@dataclass(frozen=True)
class _Cause:
    """Indices of inputs and parameters, and of states with the discrete ones behind."""

    inputs: Sequence[int]
    parameters: Sequence[int]
    states: Sequence[int]


def _causes(f: ca.Function, n_x: int) -> list[_Cause]:
    """What each element of a function of (t, x, u, p, z) depends on directly."""
    none: list[list[int]] = [[] for _ in range(f.numel_out(0))]
    found = [rows(f.jac_sparsity(0, i)) if i < f.n_in() else none for i in (1, 2, 3, 4)]
    return [_Cause(u, p, [*x, *(n_x + j for j in z)]) for x, u, p, z in zip(*found, strict=True)]


def _is_unchanged(f: ca.Function, state: int, row: int, n_x: int) -> bool:
    """Whether an element that a function returns is the state itself."""
    arguments = f.sx_in()
    own = arguments[1][state] if state < n_x else arguments[4][state - n_x]
    return bool(ca.is_equal(f(*arguments)[row], own))


def rows(sparsity: ca.Sparsity) -> list[list[int]]:
    """Column indices of the structural nonzeros of each row."""
    found: list[list[int]] = [[] for _ in range(sparsity.size1())]
    for row, place in zip(*sparsity.get_triplet(), strict=True):
        found[row].append(place)
    return [sorted(r) for r in found]
