"""A model as a class: variables are attributes, equations are methods that return what they compute by name.

The class stands above the flat `Model`: it makes one, whose functions put flat arrays under their names, call the
methods, and put what they return into the declared order.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeAlias

from fmu_export.errors import ArgumentError
from fmu_export.modelling.declarations import MARK, Declaration, declared_variables, marked_methods, meant
from fmu_export.modelling.flattening import Settings, flatten
from fmu_export.modelling.model import DEFAULT_EXPERIMENT, Model, Solver


class _FlatModel:
    """`model()` of a class and of its instances."""

    def __get__(self, instance: ModelClass | None, owner: type[ModelClass]) -> Callable[[], Model]:
        if instance is not None:
            return lambda: vars(instance)["_model"]
        if "_instance" not in vars(owner):  # one for all back ends, which keep what they traced
            owner._instance = owner()
        return lambda: vars(owner._instance)["_model"]


class _Body(dict[str, Any]):
    """The body of a class while it runs, in which a variable or a marked method has its name alone."""

    def __init__(self, owner: str) -> None:
        super().__init__()
        self.owner = owner

    def __setitem__(self, name: str, value: Any) -> None:
        before = self.get(name)
        if isinstance(before, Declaration) or hasattr(before, MARK):
            raise ArgumentError(f"{self.owner}: '{name}' is defined twice in the class; rename one")
        super().__setitem__(name, value)


class _ModelMeta(type):
    """Makes the bodies of classes."""

    @classmethod
    def __prepare__(cls, name: str, bases: tuple[type, ...], /, **_: Any) -> _Body:
        return _Body(name)


if TYPE_CHECKING:  # a metaclass would have them accept any keyword of a class
    _Base = object
else:
    _Base = _ModelMeta("_Base", (), {})


class ModelClass(_Base):
    """Base of models that are written as classes.

    Class attributes made by `parameter`, `input`, `state`, `discrete` and `output` are its variables. Methods give the
    equations: `derivatives`, `outputs` and `initial`, and others marked by `when`, `every` and `require`. Their
    argument, `m` or `self`, has the values: `m.h` is a number, or an array (n,) of a vector, and `m.t` the time (s).
    They return a dictionary of what they compute or change, and must be pure: values come from `m` and go into the
    dictionary.

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
    solver : {"rk4", "rk43", "dopri5", "rodas4"}, optional
        Keyword of the class: as of `Model`.

    Raises
    ------
    ArgumentError
        A declaration, or what a method returns, does not fit: unknown or missing names, wrong shapes, values that are
        not known there.

    Examples
    --------
    >>> import numpy as np
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

    _settings: ClassVar[Settings]
    _instance: ClassVar[ModelClass]

    def __init_subclass__(
        cls,
        *,
        name: str | None = None,
        description: str | None = None,
        start_time: float | None = None,
        stop_time: float | None = None,
        step_size: float | None = None,
        solver: Solver | None = None,
    ) -> None:
        super().__init_subclass__()
        inherited = getattr(cls, "_settings", None)
        before = inherited.experiment if inherited else DEFAULT_EXPERIMENT
        times = {"start_time": start_time, "stop_time": stop_time, "step_size": step_size}
        try:
            experiment = replace(before, **{k: v for k, v in times.items() if v is not None})
        except ArgumentError as error:
            raise ArgumentError(f"{cls.__name__}: {error}") from None
        own_text = vars(cls).get("__doc__")
        text = inspect.cleandoc(own_text).partition("\n")[0] if own_text else ""
        cls._settings = Settings(
            name=name or cls.__name__,
            description=description or text or (inherited.description if inherited else ""),
            experiment=experiment,
            solver=solver or (inherited.solver if inherited else "rk4"),
        )
        declared_variables(cls)
        marked_methods(cls)

    def __init__(self, **starts: Any) -> None:
        cls = type(self)
        if cls is ModelClass:
            raise ArgumentError("ModelClass has no variables; write a class that inherits from it")
        values, model = flatten(cls, cls._settings, starts)
        vars(self).update(values, _model=model, _method="")

    def derivatives(self) -> dict[str, Any]:
        """Derivative of each state, per second."""
        return {}

    def outputs(self) -> dict[str, Any]:
        """Value of each output and of each local variable that is not a state."""
        return {}

    def initial(self) -> dict[str, Any]:
        """Values at the start of states that depend on parameters; others start at their own parameter."""
        return {}

    if not TYPE_CHECKING:  # which knows the declared names, and finds others

        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):  # a protocol that somebody asks for
                raise AttributeError(name)
            known = [n for n in (*vars(self), *declared_variables(type(self))) if not n.startswith("_")]
            raise ArgumentError(f"{self!r}: there is no '{name}'{meant(name, known)}")

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
