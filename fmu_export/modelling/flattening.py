"""From a class of declarations to the flat model: what its methods take and return, as flat arrays."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fmu_export.errors import ArgumentError, ModelError
from fmu_export.modelling.declarations import (
    KINDS,
    Declaration,
    EveryMark,
    RequireMark,
    WhenMark,
    declared_variables,
    marked_methods,
    meant,
)
from fmu_export.modelling.model import DefaultExperiment, Event, Model, Requirement, Sampled, Solver
from fmu_export.modelling.variables import Array, Layout, Variable

#: Frames of the traceback that lie here are none of the model's.
_PACKAGE = Path(__file__).parents[1]


@dataclass(frozen=True)
class Settings:
    """What the keywords of a class say about its model."""

    name: str
    description: str
    experiment: DefaultExperiment
    solver: Solver


def flatten(cls: type, settings: Settings, starts: Mapping[str, Any]) -> tuple[dict[str, Any], Model]:
    """The values at the start, by name, and the flat model of a class, with start values by name.

    Raises
    ------
    ArgumentError
        A name is unknown, or what a method returns does not fit.
    """
    flat = _Flattening(cls, settings, starts)
    model = flat.model()
    return flat.values_at_start(model), model


class _Flattening:
    """A class, and its variables by what they become."""

    def __init__(self, cls: type, settings: Settings, starts: Mapping[str, Any]) -> None:
        self.cls, self.settings = cls, settings
        self.declared, self.marked = declared_variables(cls), marked_methods(cls)
        self.booleans = {d.name for d in self.declared.values() if d.is_boolean}
        parameters = [d.variable() for d in self._of("parameter")]
        computed = self._initial_names(Layout(parameters))
        for d in self._of("state", "discrete"):
            if d.name not in computed:
                start = f"Start of {d.name}" + (f": {d.description}" if d.description else "")
                parameters.append(d.variable(f"{d.name}_start", description=start))
                self.booleans |= {f"{d.name}_start"} if d.is_boolean else set()
        inputs = [d.variable() for d in self._of("input")]
        parameters, inputs = self._with_starts(starts, parameters, inputs)
        self.parameters, self.inputs = Layout(parameters), Layout(inputs)
        self.states = Layout([d.variable() for d in self._of("state")])
        self.discrete = Layout([d.variable() for d in self._of("discrete")])
        self.outputs = Layout([d.variable() for d in self.declared.values() if d.is_output])
        self.locals = Layout([d.variable() for d in self._of("state", "local") if d.kind == "local" or not d.is_output])
        self.computed = Layout([d.variable() for d in self._of("output", "local")])

    def _of(self, *kinds: str) -> list[Declaration]:
        return [d for d in self.declared.values() if d.kind in kinds]

    def _initial_names(self, parameters: Layout) -> set[str]:
        """The states whose start `initial` computes."""
        m = self._new("initial", vars(parameters.unpack(parameters.starts)))
        with np.errstate(all="ignore"), self._running("initial"):
            returned = m.initial()
        return set(returned) if isinstance(returned, Mapping) else set()

    def _with_starts(self, starts: Mapping[str, Any], *groups: list[Variable]) -> tuple[list[Variable], ...]:
        known = [v.name for variables in groups for v in variables]
        for name in starts:
            if name not in known:
                hint = f"; did you mean '{name}_start'" if f"{name}_start" in known else meant(name, known)
                raise ArgumentError(
                    f"{self.cls.__name__}({name}=...): there is no parameter or input '{name}'{hint}; known are "
                    f"{', '.join(known)}"
                )
        return tuple([self._with_start(v, starts[v.name]) if v.name in starts else v for v in vs] for vs in groups)

    def _with_start(self, v: Variable, start: Any) -> Variable:
        try:
            return replace(v, start=start)
        except ArgumentError as error:
            raise ArgumentError(f"{self.cls.__name__}({v.name}=...): {error}") from None

    # What a method takes

    def _new(self, method: str, values: Mapping[str, Any]) -> Any:
        m: Any = object.__new__(self.cls)
        shown = {n: v != 0.0 if n in self.booleans else v for n, v in values.items()}
        vars(m).update(shown, _method=method, _flat=values)
        return m

    def namespace(self, method: str, p: Array, now: tuple[Any, Array, Array, Array] | None = None) -> Any:
        """The values that are known when a method is called: parameters, and of one instant (t, x, z, u)."""
        values = dict(vars(self.parameters.unpack(p)))
        if now is not None:
            t, x, z, u = now
            for layout, flat in ((self.states, x), (self.discrete, z), (self.inputs, u)):
                values.update(vars(layout.unpack(flat)))
            values["t"] = t
        return self._new(method, values)

    def _function(self, method: str, returned: Callable[[Any, Any], Any]) -> Callable[..., Any]:
        """The flat function of a method, from what it returns and the namespace that it got."""
        empty = np.zeros(0)

        def with_discrete(t: Any, x: Array, z: Array, u: Array, p: Array) -> Any:
            m = self.namespace(method, p, (t, x, z, u))
            return returned(getattr(m, method)(), m)

        def without(t: Any, x: Array, u: Array, p: Array) -> Any:
            return with_discrete(t, x, empty, u, p)

        return with_discrete if len(self.discrete) else without

    # What it returns

    def _packed(
        self, method: str, returned: Any, layout: Layout, what: str, before: Mapping[str, Any] | None = None
    ) -> Array:
        """What a method returns as a flat array; what it leaves out stays as before, or must not be left out."""
        where = f"{self.cls.__name__}.{method}"
        values = {}
        for v in layout.variables:
            if v.name in returned:
                values[v.name] = self._checked(where, v, returned[v.name])
            elif before is not None:
                values[v.name] = before[v.name]
            else:
                raise ArgumentError(f"{where}: the {what} of '{v.name}' is missing in what it returns")
        return layout.pack(**values) if values else np.zeros(0)

    def _check_names(self, method: str, returned: Any, names: Iterable[str], what: str) -> None:
        where = f"{self.cls.__name__}.{method}"
        if not isinstance(returned, Mapping):
            raise ArgumentError(f"{where}: it returns {type(returned).__name__}; return a dictionary, as dict(...)")
        names = tuple(names)
        for name in returned:
            if name not in names and name not in self.declared:
                raise ArgumentError(f"{where}: it returns '{name}', which is not declared{meant(str(name), names)}")
            if name not in names:
                is_a = KINDS[self.declared[name].kind]
                raise ArgumentError(f"{where}: it returns '{name}', which is {is_a}; this method returns {what} only")

    def _checked(self, where: str, v: Variable, value: Any) -> Any:
        """A returned value of the declared shape and type."""
        if isinstance(value, list | tuple):
            value = np.array(value)
        kind = getattr(getattr(value, "dtype", None), "kind", None) or np.asarray(value).dtype.kind
        if kind not in "biuf":
            raise ArgumentError(
                f"{where}: '{v.name}' is neither a number nor an array of numbers, but {type(value).__name__}"
            )
        shape, expected = np.shape(value), v.shape
        if shape != expected:
            raise ArgumentError(
                f"{where}: '{v.name}' is declared {_shape(expected)}, but what it returns is {_shape(shape)}"
            )
        if v.name in self.booleans and kind != "b":
            raise ArgumentError(
                f"{where}: '{v.name}' is declared as Boolean, but what it returns is a number; return a comparison, "
                "True or False"
            )
        return value * 1.0 if kind == "b" else value

    @contextmanager
    def _running(self, method: str) -> Iterator[None]:
        """Context in which a method runs with the start values: what Python raises there becomes one line."""
        try:
            yield
        except ModelError:
            raise
        except Exception as error:
            said = " ".join(f"{type(error).__name__}: {error}".split())
            own = [f for f in traceback.extract_tb(error.__traceback__) if _PACKAGE not in Path(f.filename).parents]
            line = f" ({Path(own[0].filename).name}, line {own[0].lineno})" if own else ""
            raise ArgumentError(
                f"{self.cls.__name__}.{method}: with the start values it fails{line}: {said}; correct the method, or "
                "the start values"
            ) from error

    # The flat model

    def model(self) -> Model:
        states = [v.name for v in self.states.variables]
        discrete = [v.name for v in self.discrete.variables]
        outputs = [v.name for v in self.computed.variables]
        marks = self.marked.items()

        def start(layout: Layout, p: Array) -> Array:
            m = self.namespace("initial", p)
            returned = m.initial()
            self._check_names("initial", returned, (*states, *discrete), "states")
            own = {v.name: vars(m)["_flat"].get(f"{v.name}_start") for v in layout.variables}
            return self._packed("initial", returned, layout, "value", own)

        def derivatives(returned: Any, m: Any) -> Array:  # noqa: ARG001
            self._check_names("derivatives", returned, states, "derivatives of states")
            return self._packed("derivatives", returned, self.states, "derivative")

        def output_values(returned: Any, m: Any) -> Array:
            self._check_names("outputs", returned, outputs, "outputs and locals that are not states")
            computed = self._packed("outputs", returned, self.computed, "value")
            values = vars(m)["_flat"] | vars(self.computed.unpack(computed))
            wanted = Layout([*self.outputs.variables, *(v for v in self.locals.variables if v.name not in states)])
            return wanted.pack(**{v.name: values[v.name] for v in wanted.variables}) if len(wanted) else np.zeros(0)

        def reset(name: str) -> Callable[[Any, Any], Any]:
            def changed(returned: Any, m: Any) -> Any:
                self._check_names(name, returned, (*states, *discrete), "states")
                x = self._packed(name, returned, self.states, "value", vars(m)["_flat"])
                return (x, self._packed(name, returned, self.discrete, "value", vars(m)["_flat"])) if discrete else x

            return changed

        def update(name: str) -> Callable[[Any, Any], Any]:
            def changed(returned: Any, m: Any) -> Any:
                self._check_names(name, returned, discrete, "discrete states")
                return self._packed(name, returned, self.discrete, "value", vars(m)["_flat"])

            return changed

        return Model(
            name=self.settings.name,
            description=self.settings.description,
            parameters=self.parameters,
            inputs=self.inputs,
            outputs=self.outputs,
            states=tuple(states),
            initial_state=lambda p: start(self.states, p),
            derivatives=self._function("derivatives", derivatives),
            output_values=self._function("outputs", output_values),
            default_experiment=self.settings.experiment,
            solver=self.settings.solver,
            requirements=tuple(
                Requirement(k.message, self._margin(name, k.at), k.at)
                for name, k in marks
                if isinstance(k, RequireMark)
            ),
            locals=self.locals,
            discrete=self.discrete,
            initial_discrete=(lambda p: start(self.discrete, p)) if discrete else None,
            events=tuple(
                Event(name, self._indicator(name, k.indicator), self._function(name, reset(name)), k.direction)
                for name, k in marks
                if isinstance(k, WhenMark)
            ),
            sampled=tuple(
                Sampled(name, self._function(name, update(name)), self._time(k.period), self._time(k.offset))
                for name, k in marks
                if isinstance(k, EveryMark)
            ),
        )

    def _scalar(self, method: str, value: Any) -> Any:
        if np.shape(value) != ():
            raise ArgumentError(
                f"{self.cls.__name__}.{method}: one number is asked for, but it is an array of shape {np.shape(value)}"
            )
        return value

    def _margin(self, method: str, at: str) -> Callable[..., Any]:
        if at == "step":
            return self._function(method, lambda value, m: self._scalar(method, value))
        return lambda *arguments: self._scalar(method, getattr(self.namespace(method, arguments[-1]), method)())

    def _indicator(self, method: str, indicator: Callable[[Any], Any]) -> Callable[..., Any]:
        def value(t: Any, x: Array, *rest: Array) -> Any:
            z, u, p = rest if len(rest) == 3 else (np.zeros(0), *rest)
            return self._scalar(method, indicator(self.namespace(method, p, (t, x, z, u))))

        return value

    def _time(self, value: Any) -> Any:
        return value.name if isinstance(value, Declaration) else value

    def values_at_start(self, model: Model) -> dict[str, Any]:
        """The values at the start; all methods run once, so that what is wrong with their names is found now."""
        p, u, t = model.parameters.starts, model.inputs.starts, model.default_experiment.start_time
        with np.errstate(all="ignore"):
            with self._running("initial"):
                x, z = model.initial_state(p), model.initial_discrete_state(p)
            now = (t, x, z, u, p) if len(z) else (t, x, u, p)
            requirements = [name for name, k in self.marked.items() if isinstance(k, RequireMark)]
            for method, f in (
                *(("derivatives", model.derivatives), ("outputs", model.output_values)),
                *((name, r.margin) for name, r in zip(requirements, model.requirements, strict=True)),
                *((e.name, f) for e in model.events for f in (e.indicator, e.reset)),
                *((s.name, s.update) for s in model.sampled),
            ):
                with self._running(method):
                    f(*now)
        return dict(vars(self.namespace("", p, (t, x, z, u))))


def _shape(shape: tuple[int, ...]) -> str:
    return f"with shape {shape}" if shape else "as a scalar"
