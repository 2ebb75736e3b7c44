"""Several connected models as one `Model`, so that one FMU holds a whole system.

Variables are named `component.variable`; the dot is a level of hierarchy in FMI's structured names. Nothing is
exchanged in steps: inputs are equal to the outputs that feed them at all times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fmu_export.errors import ArgumentError, ModelError
from fmu_export.modelling.model import DefaultExperiment, Event, Model, ModelFunction, Requirement, Sampled, Solver
from fmu_export.modelling.model_class import AnyModel, flat_model
from fmu_export.modelling.names import check_identifier
from fmu_export.modelling.units import conversion
from fmu_export.modelling.variables import Array, Layout, Variable
from fmu_export.trace.trace import feedthrough

#: Source of a scalar input: ("input", position in the whole) or (component, position in its outputs).
_Source = tuple[str, int]
_OUTSIDE = ""


class CompositionError(ModelError, ValueError):
    """Models can't be connected as asked; the message says where and why."""


def compose(
    name: str,
    description: str,
    components: Mapping[str, AnyModel],
    connections: Iterable[tuple[str, str]],
    default_experiment: DefaultExperiment,
    solver: Solver | None = None,
) -> Model:
    """Connect models to one model.

    Parameters
    ----------
    name, description : str
        Of the whole.
    components : mapping
        Name of a component -> its `Model` or `ModelClass`.
    connections : iterable of (str, str)
        (output, input), both `component.variable`, whole variables of one size whose units measure the same; values
        are converted where the units differ. At most one connection feeds an input; those that nothing feeds are the
        inputs of the whole.
    default_experiment : DefaultExperiment
        Of the whole.
    solver : {"rk4", "rk43", "dopri5", "rodas4"}, optional
        What integrates the whole; by default what integrates all of its components that have states.

    Returns
    -------
    Model
        Its parameters, outputs, locals, states, events, samples and requirements are those of all components, in the
        order of `components`. Samples of one instant all see the values before it, also those that other components
        change then.

    Raises
    ------
    CompositionError
        A component's name is not an identifier, a connection is wrong, there is an algebraic loop, or the components
        have different solvers and none is chosen.
    """
    for component in components:
        try:
            check_identifier("component", component)
        except ArgumentError as error:
            raise CompositionError(str(error)) from None
    models = {component: flat_model(model) for component, model in components.items()}
    fed = _fed_inputs(models, connections)
    inputs = Layout([v for component, m in models.items() for v in _prefixed(component, m.inputs) if v.name not in fed])
    states = _slices(len(model.state_layout) for model in models.values())
    discrete = _slices(len(model.discrete) for model in models.values())
    parameters = _slices(len(model.parameters) for model in models.values())
    sources = {component: _sources(component, model, models, fed, inputs) for component, model in models.items()}
    wiring = _Wiring(
        components={
            component: _Component(model, next(states), next(discrete), next(parameters))
            for component, model in models.items()
        },
        sources=sources,
        conversions={n: _conversions(model, sources[n], models) for n, model in models.items()},
        schedule=_schedule(models, sources),
    )

    is_discrete = any(len(model.discrete) for model in models.values())

    def flat(f: Callable[..., Any]) -> Callable[..., Any]:
        """A function of (t, x, z, u, p) as the whole takes it: without z if it has no discrete states."""
        return f if is_discrete else lambda t, x, u, p: f(t, x, np.zeros(0), u, p)

    def of_one(n: str, f: Callable[..., Any]) -> Callable[..., Any]:
        """A function of a component, of the values of the whole."""
        component = wiring.components[n]
        return lambda t, x, z, u, p: component.call(f, t, x, z, wiring.inputs(t, x, z, u, p)[n], p)

    def derivatives(t: Any, x: Array, z: Array, u: Array, p: Array) -> Array:
        inputs_of = wiring.inputs(t, x, z, u, p)
        return np.concatenate(
            [c.call(c.model.derivatives, t, x, z, inputs_of[n], p) for n, c in wiring.components.items()]
        )

    def output_values(t: Any, x: Array, z: Array, u: Array, p: Array) -> Array:
        inputs_of = wiring.inputs(t, x, z, u, p)
        values = [
            (c.call(c.model.output_values, t, x, z, inputs_of[n], p), len(c.model.outputs), len(c.model.returned))
            for n, c in wiring.components.items()
        ]
        return np.concatenate([*(v[:n] for v, n, _ in values), *(v[n:] for v, n, all_ in values if all_ > n)])

    def margin(n: str, requirement: Requirement) -> ModelFunction:
        if requirement.at == "step":
            return flat(of_one(n, requirement.margin))
        component = wiring.components[n]
        starts = component.model.inputs.starts  # depends on parameters only, and there is no state yet
        return flat(lambda t, x, z, u, p: component.call(requirement.margin, t, x, z, starts, p))

    def reset(n: str, event: Event) -> Callable[..., Any]:
        component, changed = wiring.components[n], of_one(n, event.reset)

        def value(t: Any, x: Array, z: Array, u: Array, p: Array) -> Any:
            new = changed(t, x, z, u, p)
            own_x, own_z = new if len(component.model.discrete) else (new, z[component.z])
            after = _replaced(x, component.x, own_x)
            return (after, _replaced(z, component.z, own_z)) if is_discrete else after

        return flat(value)

    def update(n: str, sampled: Sampled) -> Callable[..., Any]:
        where, changed = wiring.components[n].z, of_one(n, sampled.update)
        return lambda t, x, z, u, p: _replaced(z, where, changed(t, x, z, u, p))

    def prefixed(group: Callable[[Model], Layout]) -> Layout:
        return Layout([v for n, m in models.items() for v in _prefixed(n, group(m))])

    def time(n: str, value: float | str) -> float | str:
        return f"{n}.{value}" if isinstance(value, str) else value

    def initial(start: Callable[[Model], Callable[[Array], Array]]) -> Callable[[Array], Array]:
        return lambda p: np.concatenate([start(c.model)(p[c.p]) for c in wiring.components.values()])

    return Model(
        name=name,
        description=description,
        parameters=prefixed(lambda m: m.parameters),
        inputs=inputs,
        outputs=prefixed(lambda m: m.outputs),
        locals=prefixed(lambda m: m.locals),
        states=tuple(f"{n}.{state}" for n, m in models.items() for state in m.states),
        initial_state=initial(lambda m: m.initial_state),
        derivatives=flat(derivatives),
        output_values=flat(output_values),
        default_experiment=default_experiment,
        solver=_common_solver(name, models) if solver is None else solver,
        requirements=tuple(
            replace(r, message=f"{n}: {r.message}", margin=margin(n, r))
            for n, m in models.items()
            for r in m.requirements
        ),
        discrete=prefixed(lambda m: m.discrete),
        initial_discrete=initial(lambda m: m.initial_discrete_state) if is_discrete else None,
        events=tuple(
            replace(e, name=f"{n}.{e.name}", indicator=flat(of_one(n, e.indicator)), reset=reset(n, e))
            for n, m in models.items()
            for e in m.events
        ),
        sampled=tuple(
            replace(s, name=f"{n}.{s.name}", update=update(n, s), period=time(n, s.period), offset=time(n, s.offset))
            for n, m in models.items()
            for s in m.sampled
        ),
    )


def _replaced(flat: Array, where: slice, part: Array) -> Array:
    """A flat array with another part."""
    return np.concatenate([flat[: where.start], part, flat[where.stop :]])


def _common_solver(name: str, components: Mapping[str, Model]) -> Solver:
    solvers = {component: model.solver for component, model in components.items() if model.states}
    if len(set(solvers.values())) > 1:
        said = ", ".join(f"{component}: {solver}" for component, solver in solvers.items())
        raise CompositionError(f"{name}: the components have different solvers ({said}); choose one by solver=")
    return next(iter(solvers.values()), "rk4")


@dataclass(frozen=True)
class _Component:
    """A model, and where its states, discrete states and parameters are in those of the whole."""

    model: Model
    x: slice
    z: slice
    p: slice

    def call(self, f: Callable[..., Any], t: Any, x: Array, z: Array, u: Array, p: Array) -> Any:
        """A function of the model, of its own inputs and of the other values of the whole."""
        discrete = (z[self.z],) if len(self.model.discrete) else ()
        return f(t, x[self.x], *discrete, u, p[self.p])


@dataclass(frozen=True)
class _Wiring:
    """The components, the source of each scalar input and the line that converts it, and the order of evaluation."""

    components: Mapping[str, _Component]
    sources: Mapping[str, tuple[_Source, ...]]
    conversions: Mapping[str, tuple[tuple[float, float], ...]]
    schedule: tuple[str, ...]

    def inputs(self, t: Any, x: Array, z: Array, u: Array, p: Array) -> dict[str, Array]:
        """Inputs of each component, by evaluating the components that the schedule names, one after the other.

        Start values replace inputs that are not known yet: no output that the schedule takes from a component at that
        place depends on them.
        """
        outputs: dict[str, Array] = {}
        for n in self.schedule:
            component = self.components[n]
            outputs[n] = component.call(component.model.output_values, t, x, z, self._inputs_of(n, u, outputs), p)
        return {n: self._inputs_of(n, u, outputs) for n in self.components}

    def _inputs_of(self, n: str, u: Array, outputs: Mapping[str, Array]) -> Array:
        starts = self.components[n].model.inputs.starts
        values = [
            u[i]
            if source == _OUTSIDE
            else self._converted(n, j, outputs[source][i])
            if source in outputs
            else starts[j]
            for j, (source, i) in enumerate(self.sources[n])
        ]
        return np.stack(values) if values else starts

    def _converted(self, n: str, j: int, value: Any) -> Any:
        """The value that feeds a scalar input, in the unit of the input."""
        factor, offset = self.conversions[n][j]
        value = value if factor == 1.0 else factor * value
        return value if offset == 0.0 else value + offset


def _schedule(components: Mapping[str, Model], sources: Mapping[str, tuple[_Source, ...]]) -> tuple[str, ...]:
    """Which components to evaluate in which order, some more than once, until all connected outputs are known.

    Raises
    ------
    CompositionError
        There is an algebraic loop.
    """
    dependencies = {n: feedthrough(model) for n, model in components.items()}
    unknown = {source for wanted in sources.values() for source in wanted if source[0] != _OUTSIDE}
    schedule: list[str] = []
    while unknown:
        before = len(unknown)
        for n in components:
            found = {
                (n, i)
                for i, on in enumerate(dependencies[n])
                if (n, i) in unknown and not any(sources[n][j] in unknown for j in on)
            }
            if found:
                schedule.append(n)
                unknown -= found
        if len(unknown) == before:
            loop = ", ".join(sorted(f"{n}.{components[n].outputs.names[i]}" for n, i in unknown))
            raise CompositionError(
                f"algebraic loop: each of {loop} depends directly on another of them; break the loop by a state"
            )
    return tuple(schedule)


def _fed_inputs(components: Mapping[str, Model], connections: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Input -> output of the connections, checked."""
    outputs = {v.name: v for component, m in components.items() for v in _prefixed(component, m.outputs)}
    inputs = {v.name: v for component, m in components.items() for v in _prefixed(component, m.inputs)}
    fed: dict[str, str] = {}
    for source, target in connections:
        here = f"connection {source} -> {target}"
        for end, kind, known in ((source, "output", outputs), (target, "input", inputs)):
            if end not in known:
                raise CompositionError(f"{here}: there is no {kind} '{end}'; known are {', '.join(known) or 'none'}")
        ends = outputs[source], inputs[target]
        if ends[0].size != ends[1].size:
            raise CompositionError(f"{here}: the sizes differ: {ends[0].size} and {ends[1].size}")
        if ends[0].type != ends[1].type:
            raise CompositionError(f"{here}: the types differ: {ends[0].type} and {ends[1].type}")
        if ends[0].items != ends[1].items:
            raise CompositionError(f"{here}: the items differ: {ends[0].items} and {ends[1].items}")
        try:
            conversion(ends[0].unit, ends[1].unit)
        except ValueError as error:
            raise CompositionError(f"{here}: {error}") from None
        if target in fed:
            raise CompositionError(f"{here}: {fed[target]} feeds this input already")
        fed[target] = source
    return fed


def _sources(
    component: str, model: Model, components: Mapping[str, Model], fed: Mapping[str, str], inputs: Layout
) -> tuple[_Source, ...]:
    """Where the scalar inputs of a component come from."""
    found: list[_Source] = []
    for v in model.inputs.variables:
        path = f"{component}.{v.name}"
        if path in fed:
            owner, _, output = fed[path].partition(".")
            found += [(owner, i) for i in _positions(components[owner].outputs, output)]
        else:
            found += [(_OUTSIDE, i) for i in _positions(inputs, path)]
    return tuple(found)


def _conversions(
    model: Model, sources: tuple[_Source, ...], components: Mapping[str, Model]
) -> tuple[tuple[float, float], ...]:
    """Factor and offset of the scalar inputs of a component."""
    units = {n: _units(m.outputs) for n, m in components.items()}
    return tuple(
        (1.0, 0.0) if owner == _OUTSIDE else conversion(units[owner][i], own)
        for (owner, i), own in zip(sources, _units(model.inputs), strict=True)
    )


def _units(layout: Layout) -> list[str]:
    return [v.unit for v in layout.variables for _ in v.names]


def _positions(layout: Layout, name: str) -> list[int]:
    positions = vars(layout.unpack(np.arange(len(layout))))[name]
    return [int(i) for i in np.ravel(positions)]


def _prefixed(component: str, layout: Layout) -> list[Variable]:
    return [replace(v, name=f"{component}.{v.name}") for v in layout.variables]


def _slices(lengths: Iterable[int]) -> Iterator[slice]:
    end = 0
    for n in lengths:
        yield slice(end, end + n)
        end += n
