"""Several connected models as one `Model`, so that one FMU holds a whole system.

Variables are named `part.variable`; FMI's structured names take the dot for a level of hierarchy. Between the parts
nothing is sampled: the composed model is the continuous system.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmu_export.errors import ModelError
from fmu_export.modelling.model import Array, DefaultExperiment, Layout, Model, ModelFunction, Requirement, Variable
from fmu_export.trace.trace import feedthrough

#: Where the value of a scalar input comes from: ("input", position in the whole) or (part, position in its outputs).
_Source = tuple[str, int]
_OUTSIDE = ""


class CompositionError(ModelError, ValueError):
    """Models can't be connected as asked; the message says where and why."""


def compose(
    name: str,
    description: str,
    parts: Mapping[str, Model],
    connections: Iterable[tuple[str, str]],
    default_experiment: DefaultExperiment,
) -> Model:
    """Connect models to one model.

    Parameters
    ----------
    name, description : str
        Of the whole.
    parts : mapping
        Name of a part -> its model.
    connections : iterable of (str, str)
        (output, input), both `part.variable`, whole variables of one size and unit. Each input is fed once at most;
        those that nothing feeds are the inputs of the whole.
    default_experiment : DefaultExperiment
        Of the whole.

    Returns
    -------
    Model
        Its parameters, outputs, states and requirements are those of all parts, in the order of `parts`.

    Raises
    ------
    CompositionError
        A part's name is no identifier, a connection is wrong, or there is an algebraic loop.
    """
    for part in parts:
        if not part.isidentifier():
            raise CompositionError(f"part {part!r}: the name must be an identifier, since variables are named by it")
    fed = _fed_inputs(parts, connections)
    inputs = Layout([v for part, m in parts.items() for v in _prefixed(part, m.inputs) if v.name not in fed])
    states = _slices(len(model.state_layout) for model in parts.values())
    parameters = _slices(len(model.parameters) for model in parts.values())
    sources = {part: _sources(part, model, parts, fed, inputs) for part, model in parts.items()}
    wiring = _Wiring(
        parts={part: _Part(model, next(states), next(parameters)) for part, model in parts.items()},
        sources=sources,
        schedule=_schedule(parts, sources),
    )

    def derivatives(t: Any, x: Array, u: Array, p: Array) -> Array:
        inputs_of = wiring.inputs(t, x, u, p)
        return np.concatenate(
            [part.model.derivatives(t, x[part.x], inputs_of[n], p[part.p]) for n, part in wiring.parts.items()]
        )

    def output_values(t: Any, x: Array, u: Array, p: Array) -> Array:
        inputs_of = wiring.inputs(t, x, u, p)
        return np.concatenate(
            [part.model.output_values(t, x[part.x], inputs_of[n], p[part.p]) for n, part in wiring.parts.items()]
        )

    def margin(n: str, requirement: Requirement) -> ModelFunction:
        part = wiring.parts[n]

        def value(t: Any, x: Array, u: Array, p: Array) -> Any:
            if requirement.at == "start":  # depends on parameters only, and there is no state yet
                return requirement.margin(t, x[part.x], part.model.inputs.starts, p[part.p])
            inputs_of = wiring.inputs(t, x, u, p)
            return requirement.margin(t, x[part.x], inputs_of[n], p[part.p])

        return value

    return Model(
        name=name,
        description=description,
        parameters=Layout([v for part, m in parts.items() for v in _prefixed(part, m.parameters)]),
        inputs=inputs,
        outputs=Layout([v for part, m in parts.items() for v in _prefixed(part, m.outputs)]),
        states=tuple(f"{part}.{state}" for part, m in parts.items() for state in m.states),
        initial_state=lambda p: np.concatenate([part.model.initial_state(p[part.p]) for part in wiring.parts.values()]),
        derivatives=derivatives,
        output_values=output_values,
        default_experiment=default_experiment,
        requirements=tuple(
            replace(r, message=f"{part}: {r.message}", margin=margin(part, r))
            for part, m in parts.items()
            for r in m.requirements
        ),
    )


@dataclass(frozen=True)
class _Part:
    """A model, and where its states and parameters are in those of the whole."""

    model: Model
    x: slice
    p: slice


@dataclass(frozen=True)
class _Wiring:
    """The parts, where the value of each scalar input of each part comes from, and how to find all of them."""

    parts: Mapping[str, _Part]
    sources: Mapping[str, tuple[_Source, ...]]
    schedule: tuple[str, ...]

    def inputs(self, t: Any, x: Array, u: Array, p: Array) -> dict[str, Array]:
        """Inputs of each part, by evaluating the parts that the schedule names, one after the other.

        What is not known yet is replaced by start values: no output that the schedule takes from a part at that place
        depends on them.
        """
        outputs: dict[str, Array] = {}
        for n in self.schedule:
            part = self.parts[n]
            outputs[n] = part.model.output_values(t, x[part.x], self._inputs_of(n, u, outputs), p[part.p])
        return {n: self._inputs_of(n, u, outputs) for n in self.parts}

    def _inputs_of(self, n: str, u: Array, outputs: Mapping[str, Array]) -> Array:
        starts = self.parts[n].model.inputs.starts
        values = [
            u[i] if source == _OUTSIDE else outputs[source][i] if source in outputs else start
            for (source, i), start in zip(self.sources[n], starts, strict=True)
        ]
        return np.stack(values) if values else starts


def _schedule(parts: Mapping[str, Model], sources: Mapping[str, tuple[_Source, ...]]) -> tuple[str, ...]:
    """Which parts to evaluate in which order, some more than once, until all connected outputs are known.

    Raises
    ------
    CompositionError
        There is an algebraic loop.
    """
    dependencies = {n: feedthrough(model) for n, model in parts.items()}
    unknown = {source for wanted in sources.values() for source in wanted if source[0] != _OUTSIDE}
    schedule: list[str] = []
    while unknown:
        before = len(unknown)
        for n in parts:
            found = {
                (n, i)
                for i, on in enumerate(dependencies[n])
                if (n, i) in unknown and not any(sources[n][j] in unknown for j in on)
            }
            if found:
                schedule.append(n)
                unknown -= found
        if len(unknown) == before:
            loop = ", ".join(sorted(f"{n}.{parts[n].outputs.names[i]}" for n, i in unknown))
            raise CompositionError(
                f"algebraic loop: each of {loop} depends directly on another of them; break the loop by a state"
            )
    return tuple(schedule)


def _fed_inputs(parts: Mapping[str, Model], connections: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Input -> output of the connections, checked."""
    outputs = {v.name: v for part, m in parts.items() for v in _prefixed(part, m.outputs)}
    inputs = {v.name: v for part, m in parts.items() for v in _prefixed(part, m.inputs)}
    fed: dict[str, str] = {}
    for source, target in connections:
        here = f"connection {source} -> {target}"
        for end, kind, known in ((source, "output", outputs), (target, "input", inputs)):
            if end not in known:
                raise CompositionError(f"{here}: there is no {kind} '{end}'; known are {', '.join(known)}")
        for what in ("size", "unit"):
            ends = getattr(outputs[source], what), getattr(inputs[target], what)
            if ends[0] != ends[1]:
                raise CompositionError(f"{here}: the {what}s differ: {ends[0]} and {ends[1]}")
        if target in fed:
            raise CompositionError(f"{here}: {fed[target]} feeds this input already")
        fed[target] = source
    return fed


def _sources(
    part: str, model: Model, parts: Mapping[str, Model], fed: Mapping[str, str], inputs: Layout
) -> tuple[_Source, ...]:
    """Where the scalar inputs of a part come from."""
    found: list[_Source] = []
    for v in model.inputs.variables:
        path = f"{part}.{v.name}"
        if path in fed:
            owner, _, output = fed[path].partition(".")
            found += [(owner, i) for i in _positions(parts[owner].outputs, output)]
        else:
            found += [(_OUTSIDE, i) for i in _positions(inputs, path)]
    return tuple(found)


def _positions(layout: Layout, name: str) -> list[int]:
    positions = vars(layout.unpack(np.arange(len(layout))))[name]
    return [int(i) for i in np.ravel(positions)]


def _prefixed(part: str, layout: Layout) -> list[Variable]:
    return [replace(v, name=f"{part}.{v.name}") for v in layout.variables]


def _slices(lengths: Iterable[int]) -> Iterator[slice]:
    end = 0
    for n in lengths:
        yield slice(end, end + n)
        end += n
