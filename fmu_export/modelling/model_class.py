"""A model as a class: variables are attributes, equations are methods that return what they compute by name.

The class stands above the flat `Model`: it makes one, whose functions put flat arrays under their names, call the
methods, and put what they return into the declared order.
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NoReturn, TypeAlias

import numpy as np

from fmu_export.errors import ArgumentError
from fmu_export.modelling.declarations import KINDS, MARK, Declaration, RequireMark
from fmu_export.modelling.model import DEFAULT_EXPERIMENT, DefaultExperiment, Model, Requirement
from fmu_export.modelling.variables import Array, Layout, Variable

#: Names that no variable can have, since they mean something else.
_TAKEN = ("t", "model", "derivatives", "outputs", "initial")


@dataclass(frozen=True)
class _Settings:
    """What the keywords of a class say."""

    name: str
    description: str
    experiment: DefaultExperiment


class _FlatModel:
    """`model()` of a class and of its instances."""

    def __get__(self, instance: ModelClass | None, owner: type[ModelClass]) -> Callable[[], Model]:
        if instance is not None:
            return lambda: vars(instance)["_model"]
        if "_instance" not in vars(owner):  # one for all back ends, which keep what they traced
            owner._instance = owner()
        return lambda: vars(owner._instance)["_model"]


class ModelClass:
    """Base of models that are written as classes.

    Class attributes made by `parameter`, `input`, `state` and `output` are its variables. Methods give the equations:
    `derivatives`, `outputs` and `initial`, and others marked by `require`. Their argument, `m` or `self`, has the
    values: `m.h` is a number, or an array (n,) of a vector, and `m.t` the time (s). They return a dictionary of what
    they compute, and must be pure: values come from `m` and go into the dictionary.

    Calling the class with parameters or inputs by keyword gives them other start values. `build_native` and all else
    that takes a `Model` also takes the class or such an instance of it; `model()` gives the `Model`.

    Parameters
    ----------
    name : str, optional
        Keyword of the class: name of the model and of its FMU; the name of the class by default.
    description : str, optional
        Keyword of the class; the first line of its docstring by default.
    start_time, stop_time, step_size : float, optional
        Keywords of the class: the `DefaultExperiment`, of 1 s in steps of 10 ms by default.

    Raises
    ------
    ArgumentError
        A declaration, or what a method returns, does not fit: unknown or missing names, wrong shapes, values that are
        not known there.

    Examples
    --------
    >>> from fmu_export import ModelClass, input, parameter, state
    >>> class Tank(ModelClass, stop_time=100.0):
    ...     '''A tank that runs empty.'''
    ...     area = parameter(0.5, "m2")
    ...     level = state(4.0, "m")
    ...     inflow = input(0.0, "m3/s")
    ...
    ...     def derivatives(m):
    ...         return dict(level=(m.inflow - 0.01 * np.sqrt(m.level)) / m.area)
    ...
    >>> float(Tank(area=0.01).derivatives()["level"])
    -2.0
    >>> Tank.model().parameters.names
    ('area', 'level_start')
    """

    #: Time (s).
    t: Any
    model = _FlatModel()

    _settings: ClassVar[_Settings]
    _instance: ClassVar[ModelClass]

    def __init_subclass__(
        cls,
        *,
        name: str | None = None,
        description: str | None = None,
        start_time: float | None = None,
        stop_time: float | None = None,
        step_size: float | None = None,
    ) -> None:
        super().__init_subclass__()
        inherited = getattr(cls, "_settings", None)
        before = inherited.experiment if inherited else DEFAULT_EXPERIMENT
        times = {"start_time": start_time, "stop_time": stop_time, "step_size": step_size}
        own_text = vars(cls).get("__doc__")
        text = inspect.cleandoc(own_text).partition("\n")[0] if own_text else ""
        cls._settings = _Settings(
            name=name or cls.__name__,
            description=description or text or (inherited.description if inherited else ""),
            experiment=replace(before, **{k: float(v) for k, v in times.items() if v is not None}),
        )
        _declared(cls)

    def __init__(self, **starts: Any) -> None:
        values, model = _flatten(type(self), starts)
        vars(self).update(values, _model=model, _method="")

    def derivatives(self) -> dict[str, Any]:
        """Derivative of each state, per second."""
        return {}

    def outputs(self) -> dict[str, Any]:
        """Value of each output that is no state."""
        return {}

    def initial(self) -> dict[str, Any]:
        """Values at the start of states that depend on parameters; others start at their own parameter."""
        return {}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # a protocol that somebody asks for
            raise AttributeError(name)
        known = [n for n in (*vars(self), *_declared(type(self))) if not n.startswith("_")]
        raise ArgumentError(f"{self!r}: there is no '{name}'{_meant(name, known)}")

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        raise ArgumentError(f"{self!r}: '{name}' can't be set; return what changes, as dict({name}=...)")

    def __repr__(self) -> str:
        method = vars(self).get("_method")
        return f"{type(self).__name__}.{method}" if method else f"{type(self).__name__}()"


#: What can be exported: a flat model, a class, or an instance of a class with other start values.
AnyModel: TypeAlias = Model | ModelClass | type[ModelClass]


def flat_model(model: AnyModel) -> Model:
    """The flat model of a class or of an instance of it; a flat model is one already."""
    return model if isinstance(model, Model) else model.model()


def _meant(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean '{close[0]}'" if close else ""


def _declared(cls: type[ModelClass]) -> dict[str, Declaration]:
    """Variables of a class and of those that it inherits from, in the order of declaration.

    Raises
    ------
    ArgumentError
        A name is taken, one declaration stands for two variables, or something else hides a declaration.
    """
    found: dict[str, Declaration] = {}
    for owner in reversed(cls.__mro__):
        for name, value in vars(owner).items():
            if isinstance(value, Declaration):
                if name in _TAKEN or name.startswith("_"):
                    raise ArgumentError(f"{cls.__name__}: a variable can't have the name '{name}'; take another")
                if value.name != name:
                    raise ArgumentError(f"{cls.__name__}: '{name}' and '{value.name}' are one declaration; write two")
                found[name] = value
            elif name in found and value is None:
                del found[name]
            elif name in found:
                raise ArgumentError(
                    f"{cls.__name__}: {owner.__name__}.{name} hides {KINDS[found[name].kind]}; declare it anew, as "
                    f"{name} = {found[name].kind}(...), or leave it out by None"
                )
    return found


def _marked(cls: type[ModelClass]) -> dict[str, Any]:
    """Methods of a class with a mark, in the order of definition: name -> mark."""
    found: dict[str, Any] = {}
    for owner in reversed(cls.__mro__):
        for name, value in vars(owner).items():
            if hasattr(value, MARK):
                found[name] = getattr(value, MARK)
            elif name in found and value is None:
                del found[name]
            elif name in found:
                raise ArgumentError(
                    f"{cls.__name__}: {owner.__name__}.{name} hides a method that is marked; mark it too, or leave it "
                    f"out by {name} = None"
                )
    return found


@dataclass
class _Parts:
    """The variables of a class by what they become in the flat model."""

    cls: type[ModelClass]
    declared: dict[str, Declaration]
    parameters: Layout
    inputs: Layout
    states: Layout
    outputs: Layout
    computed: Layout
    times: dict[str, Any] = field(default_factory=dict)

    def namespace(self, method: str, p: Array, t: Any = None, x: Array = None, u: Array = None) -> ModelClass:
        """What a method gets: the values that are known when it is called."""
        m = object.__new__(self.cls)
        values = vars(m)
        values["_method"] = method
        values.update(vars(self.parameters.unpack(p)))
        if x is not None:
            values.update(vars(self.states.unpack(x)), t=t)
        if u is not None:
            values.update(vars(self.inputs.unpack(u)))
        return m

    def packed(self, method: str, returned: Any, layout: Layout, before: Mapping[str, Any] | None = None) -> Array:
        """What a method returns as a flat array; what it leaves out stays as before, or must not be left out.

        Raises
        ------
        ArgumentError
            It returns no dictionary, an unknown name, not all names, or a value of another shape.
        """
        where, names = f"{self.cls.__name__}.{method}", [v.name for v in layout.variables]
        if not isinstance(returned, Mapping):
            raise ArgumentError(f"{where}: it returns {type(returned).__name__}; return a dictionary, as dict(...)")
        self._check_names(where, method, returned, names)
        values = {}
        for v in layout.variables:
            if v.name in returned:
                values[v.name] = _checked(where, v, returned[v.name])
            elif before is not None:
                values[v.name] = before[v.name]
            else:
                what = "derivative" if method == "derivatives" else "value"
                raise ArgumentError(f"{where}: the {what} of '{v.name}' is missing in what it returns")
        return layout.pack(**values) if values else np.zeros(0)

    def _check_names(self, where: str, method: str, returned: Mapping[str, Any], names: list[str]) -> None:
        for name in returned:
            if name in names:
                continue
            wanted = {"derivatives": "derivatives of states", "outputs": "outputs that are no states"}
            here = wanted.get(method, "states")
            if name not in self.declared:
                raise ArgumentError(f"{where}: it returns '{name}', which is not declared{_meant(str(name), names)}")
            is_a = KINDS[self.declared[name].kind]
            raise ArgumentError(f"{where}: it returns '{name}', which is {is_a}; this method returns {here} only")


def _checked(where: str, v: Variable, value: Any) -> Any:
    """A returned value of the declared shape."""
    if isinstance(value, list | tuple):
        value = np.array(value)
    kind = getattr(getattr(value, "dtype", None), "kind", None) or np.asarray(value).dtype.kind
    if kind not in "biuf":
        raise ArgumentError(f"{where}: '{v.name}' is no number and no array of numbers, but {type(value).__name__}")
    shape, expected = np.shape(value), () if v.size is None else (v.size,)
    if shape != expected:
        raise ArgumentError(
            f"{where}: '{v.name}' is declared {_shape(expected)}, but what it returns is {_shape(shape)}"
        )
    return value


def _shape(shape: tuple[int, ...]) -> str:
    return f"with shape {shape}" if shape else "as a scalar"


def _flatten(cls: type[ModelClass], starts: Mapping[str, Any]) -> tuple[dict[str, Any], Model]:
    """The values at the start, by name, and the flat model of a class."""
    if cls is ModelClass:
        raise ArgumentError("ModelClass has no variables; write a class that inherits from it")
    settings, declared, marked = cls._settings, _declared(cls), _marked(cls)

    def of(*kinds: str) -> list[Declaration]:
        return [d for d in declared.values() if d.kind in kinds]

    computed_starts = _initial_names(cls, declared)
    variables = [d.variable() for d in of("parameter")]
    for d in of("state"):
        if d.name not in computed_starts:
            start = f"Start of {d.name}" + (f": {d.description}" if d.description else "")
            variables.append(d.variable(f"{d.name}_start", description=start))
    inputs = [d.variable() for d in of("input")]
    variables, inputs = _with_starts(cls, starts, variables, inputs)
    parts = _Parts(
        cls=cls,
        declared=declared,
        parameters=Layout(variables),
        inputs=Layout(inputs),
        states=Layout([d.variable() for d in of("state")]),
        outputs=Layout([d.variable(start=0.0) for d in declared.values() if d.is_output]),
        computed=Layout([d.variable() for d in of("output")]),
    )

    def initial_state(p: Array) -> Array:
        m = parts.namespace("initial", p)
        own = {v.name: vars(m).get(f"{v.name}_start") for v in parts.states.variables}
        return parts.packed("initial", m.initial(), parts.states, own)

    def derivatives(t: Any, x: Array, u: Array, p: Array) -> Array:
        m = parts.namespace("derivatives", p, t, x, u)
        return parts.packed("derivatives", m.derivatives(), parts.states)

    def output_values(t: Any, x: Array, u: Array, p: Array) -> Array:
        m = parts.namespace("outputs", p, t, x, u)
        computed = parts.computed.unpack(parts.packed("outputs", m.outputs(), parts.computed))
        values = vars(parts.states.unpack(x)) | vars(computed)
        values = {v.name: values[v.name] for v in parts.outputs.variables}
        return parts.outputs.pack(**values) if values else np.zeros(0)

    def margin(name: str, at: str) -> Callable[..., Any]:
        def value(t: Any, x: Array, u: Array, p: Array) -> Any:
            m = parts.namespace(name, p, t, x, u) if at == "step" else parts.namespace(name, p)
            found = getattr(m, name)()
            if np.shape(found) != ():
                raise ArgumentError(f"{cls.__name__}.{name}: it returns {_shape(np.shape(found))}; return a scalar")
            return found

        return value

    model = Model(
        name=settings.name,
        description=settings.description,
        parameters=parts.parameters,
        inputs=parts.inputs,
        outputs=parts.outputs,
        states=tuple(v.name for v in parts.states.variables),
        initial_state=initial_state,
        derivatives=derivatives,
        output_values=output_values,
        default_experiment=settings.experiment,
        requirements=tuple(
            Requirement(mark.message, margin(name, mark.at), mark.at)
            for name, mark in marked.items()
            if isinstance(mark, RequireMark)
        ),
    )
    return vars(_at_start(model, parts)), model


def _initial_names(cls: type[ModelClass], declared: Mapping[str, Declaration]) -> set[str]:
    """The states whose start `initial` computes."""
    parameters = Layout([d.variable() for d in declared.values() if d.kind == "parameter"])
    m = object.__new__(cls)
    vars(m).update(vars(parameters.unpack(parameters.starts)), _method="initial")
    with np.errstate(all="ignore"):
        returned = m.initial()
    return set(returned) if isinstance(returned, Mapping) else set()


def _with_starts(
    cls: type[ModelClass], starts: Mapping[str, Any], *groups: list[Variable]
) -> tuple[list[Variable], ...]:
    """Variables with other start values."""
    known = [v.name for variables in groups for v in variables]
    for name in starts:
        if name not in known:
            raise ArgumentError(
                f"{cls.__name__}({name}=...): there is no parameter or input '{name}'{_meant(name, known)}; known are "
                f"{', '.join(known)}"
            )
    return tuple([_with_start(cls, v, starts[v.name]) if v.name in starts else v for v in vs] for vs in groups)


def _with_start(cls: type[ModelClass], v: Variable, start: Any) -> Variable:
    values = np.asarray(start)
    if values.dtype.kind not in "biuf" or values.shape not in ((), () if v.size is None else (v.size,)):
        expected = "a number" if v.size is None else f"a number or {v.size} of them"
        raise ArgumentError(f"{cls.__name__}({v.name}=...): {start!r} is not {expected}")
    return replace(v, start=tuple(values.tolist()) if values.ndim else values.item())


def _at_start(model: Model, parts: _Parts) -> ModelClass:
    """The values at the start; all methods run once, so that what is wrong with their names is found now."""
    p, u, t = model.parameters.starts, model.inputs.starts, model.default_experiment.start_time
    with np.errstate(all="ignore"):
        x = model.initial_state(p)
        for f in (model.derivatives, model.output_values, *(r.margin for r in model.requirements)):
            f(t, x, u, p)
    return parts.namespace("", p, t, x, u)
