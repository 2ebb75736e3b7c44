"""What the body of a `ModelClass` consists of: declared variables, and marks of its methods."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import numpy as np

from fmu_export.errors import ArgumentError
from fmu_export.modelling.variables import Type, Variable

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    #: A start value: a number, a Boolean, an item of an enumeration, a text, or an array.
    Start: TypeAlias = ArrayLike | IntEnum

_Method = TypeVar("_Method", bound=Callable[..., Any])

#: Names that no variable can have, since they mean something else.
_TAKEN = ("t", "model", "derivatives", "outputs", "initial")

#: Names of methods that somebody may expect to be called, and those of the methods that are.
_MISTAKEN = {
    "derivative": "derivatives",
    "output": "outputs",
    "output_values": "outputs",
    "initial_state": "initial",
    "initial_discrete": "initial",
}

#: What each kind of variable is called in messages.
KINDS = {
    "parameter": "a parameter",
    "input": "an input",
    "state": "a state",
    "discrete": "a discrete state",
    "output": "an output",
    "local": "a local variable",
}


Kind = Literal["parameter", "input", "state", "discrete", "output", "local"]


@dataclass(frozen=True, eq=False)
class Declaration:
    """A variable of a `ModelClass`; `name` is that of the class attribute, `options` are those of its `Variable`."""

    kind: Kind
    is_output: bool
    options: dict[str, Any]
    name: str = field(default="", init=False)

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "name", self.name or name)  # the one that the class gives it

    def __get__(self, instance: Any, owner: type) -> Any:
        """On the class the declaration; in a method the value, which the instance has, if it is known there."""
        if instance is None:
            return self
        raise ArgumentError(
            f"{instance!r}: '{self.name}' is {KINDS[self.kind]}, whose value is not known there; compute it from what "
            + ("is: parameters" if "t" not in vars(instance) else "is: states, inputs, parameters, m.t")
        )

    @property
    def description(self) -> str:
        """The line for users of other tools."""
        return str(self.options["description"])

    @property
    def is_boolean(self) -> bool:
        """Whether its values are Booleans."""
        return self.options.get("type") == "boolean"

    def variable(self, name: str | None = None, **changes: Any) -> Variable:
        """What the flat model declares, by another name or with other options if they are given."""
        return Variable(name or self.name, **(self.options | changes))


def _declaration(kind: Kind, is_output: bool, start: Any, **options: Any) -> Declaration:
    if isinstance(start, str) and not options.get("items"):
        raise ArgumentError(
            f"{kind}: the start value {start!r} is not a number; write {kind}(0.0, {start!r}) for a unit"
        )
    if isinstance(start, IntEnum):
        options |= {"type": "enumeration", "items": {item.name: item.value for item in type(start)}}
    elif options.get("type") is None:
        text = isinstance(start, str)
        options["type"] = "string" if text else "boolean" if np.asarray(start).dtype.kind == "b" else "real"
    if options.get("size") is None and np.ndim(start) > 0:
        options["size"] = np.shape(start)
    return Declaration(kind, is_output, {"start": start, **options})


def parameter(
    start: Start,
    unit: str = "1",
    description: str = "",
    *,
    size: int | tuple[int, ...] | None = None,
    min: float | None = None,
    max: float | None = None,
    nominal: float | None = None,
    display_unit: str | None = None,
    tunable: bool = False,
    type: Type | None = None,
    items: Any = (),
) -> Any:
    """Declare a parameter of a `ModelClass`.

    Parameters
    ----------
    start : number, bool, item of an IntEnum or str, or array of numbers or bool
        Its value, unless the importer or a keyword of the class gives another; an array declares an array.
    unit : str, optional
        As of `Variable`; ``"1"`` for dimensionless.
    description : str, optional
        One line for the users of other tools.
    size : int or tuple of int, optional
        Number of elements of a vector, or shape of an array, with one start value for all.
    min, max : float, optional
        Smallest and largest admissible value.
    nominal, display_unit : float and str, optional
        As of `Variable`.
    tunable : bool, optional
        Whether it may change during a run, between two steps.
    type, items : optional
        As of `Variable`. By default that of the start value: a bool makes a Boolean, an item of an `enum.IntEnum` an
        enumeration, a text of `items` a string; all numbers make reals.
    """
    options: dict[str, Any] = {
        "min": min,
        "max": max,
        "nominal": nominal,
        "display_unit": display_unit,
        "tunable": tunable,
    }
    options |= {"unit": unit, "description": description, "size": size, "type": type, "items": items}
    return _declaration("parameter", False, start, **options)


def input(
    start: Start = 0.0,
    unit: str = "1",
    description: str = "",
    *,
    size: int | tuple[int, ...] | None = None,
    min: float | None = None,
    max: float | None = None,
    nominal: float | None = None,
    display_unit: str | None = None,
    type: Type | None = None,
    items: Any = (),
) -> Any:
    """Declare an input of a `ModelClass`; arguments as of `parameter`."""
    options: dict[str, Any] = {"min": min, "max": max, "nominal": nominal, "display_unit": display_unit}
    options |= {"unit": unit, "description": description, "size": size, "type": type, "items": items}
    return _declaration("input", False, start, **options)


def state(
    start: ArrayLike = 0.0,
    unit: str = "1",
    description: str = "",
    *,
    size: int | tuple[int, ...] | None = None,
    min: float | None = None,
    max: float | None = None,
    nominal: float | None = None,
    display_unit: str | None = None,
    output: bool = True,
) -> Any:
    """Declare a continuous state of a `ModelClass`, whose derivative `derivatives` returns.

    The state `h` starts at the parameter `h_start`, which is added with this start value, unit, smallest and largest
    value, unless `initial` computes the start from other parameters. Other arguments as of `parameter`.

    Parameters
    ----------
    output : bool, optional
        Whether it is an output, too; else it is a local variable of the FMU.
    """
    options: dict[str, Any] = {"min": min, "max": max, "nominal": nominal, "display_unit": display_unit}
    options |= {"unit": unit, "description": description, "size": size, "type": "real"}
    return _declaration("state", output, start, **options)


def discrete(
    start: Start = 0.0,
    unit: str = "1",
    description: str = "",
    *,
    size: int | tuple[int, ...] | None = None,
    min: float | None = None,
    max: float | None = None,
    nominal: float | None = None,
    display_unit: str | None = None,
    output: bool = True,
    type: Type | None = None,
    items: Any = (),
) -> Any:
    """Declare a discrete state of a `ModelClass`, which changes at events and sampling instants only.

    It starts at a parameter, as a `state` does. A Boolean can become a comparison, `True` or `False`, and `&`, `|`, `~`
    and `np.where` take it. Other arguments as of `parameter`.

    Parameters
    ----------
    output : bool, optional
        Whether it is an output, too; else it is a local variable of the FMU.
    """
    options: dict[str, Any] = {"min": min, "max": max, "nominal": nominal, "display_unit": display_unit}
    options |= {"unit": unit, "description": description, "size": size, "type": type, "items": items}
    return _declaration("discrete", output, start, **options)


def output(
    unit: str = "1",
    description: str = "",
    *,
    size: int | tuple[int, ...] | None = None,
    nominal: float | None = None,
    display_unit: str | None = None,
    type: Type = "real",
    items: Any = (),
) -> Any:
    """Declare an output of a `ModelClass`, whose value `outputs` returns.

    Parameters
    ----------
    unit : str, optional
        As of `Variable`; ``"1"`` for dimensionless.
    description : str, optional
        One line for the users of other tools.
    size : int or tuple of int, optional
        Number of elements of a vector, or shape of an array.
    nominal, display_unit : float and str, optional
        As of `Variable`.
    type, items : optional
        As of `Variable`.
    """
    options = {"unit": unit, "description": description, "size": size, "nominal": nominal, "display_unit": display_unit}
    return _declaration("output", True, None, **options, type=type, items=items)


def local(
    unit: str = "1",
    description: str = "",
    *,
    size: int | tuple[int, ...] | None = None,
    nominal: float | None = None,
    display_unit: str | None = None,
    type: Type = "real",
    items: Any = (),
) -> Any:
    """Declare a local variable of a `ModelClass`, whose value `outputs` returns; other FMUs can't be connected to it.

    Arguments as of `output`.
    """
    options = {"unit": unit, "description": description, "size": size, "nominal": nominal, "display_unit": display_unit}
    return _declaration("local", False, None, **options, type=type, items=items)


@dataclass(frozen=True)
class WhenMark:
    """What `when` has been given."""

    indicator: Callable[[Any], Any]
    direction: Literal["falling", "rising", "both"]


@dataclass(frozen=True)
class EveryMark:
    """What `every` has been given."""

    period: Any
    offset: Any


@dataclass(frozen=True)
class RequireMark:
    """What `require` has been given."""

    message: str
    at: Literal["start", "step"]


#: Attribute of a method that has what its decorator was given.
MARK = "__fmu_export_mark__"


class _Decorator:
    """What marks a method; in the body of a class it is left where its argument was forgotten."""

    def __init__(self, mark: Any, usage: str) -> None:
        self.mark, self.usage = mark, usage

    def __call__(self, method: _Method) -> _Method:
        if hasattr(method, MARK):
            raise ArgumentError(
                f"{method.__qualname__}: a method has one of @when, @every and @require; write two methods"
            )
        setattr(method, MARK, self.mark)
        return method


def when(
    indicator: Callable[[Any], Any], direction: Literal["falling", "rising", "both"] = "falling"
) -> Callable[[_Method], _Method]:
    """Declare, above a method of a `ModelClass`, that it returns the states that change at an event.

    Parameters
    ----------
    indicator : callable
        Of the values `m`, as ``lambda m: m.h``; the event is where it crosses zero.
    direction : {"falling", "rising", "both"}, optional
        As of `Event`.
    """
    if not callable(indicator):
        raise ArgumentError(f"when: the indicator {indicator!r} is not a function; write when(lambda m: ...)")
    if direction not in ("falling", "rising", "both"):
        raise ArgumentError(f'when: direction={direction!r}; write "falling", "rising" or "both"')
    return _Decorator(WhenMark(indicator, direction), "@when(lambda m: ...)")


def every(period: Any, offset: Any = 0.0) -> Callable[[_Method], _Method]:
    """Declare, above a method of a `ModelClass`, that it returns the discrete states that change at sampling instants.

    Parameters
    ----------
    period, offset : float or parameter, optional
        As of `Sampled`, in seconds: instants are offset, offset + period, ... A parameter of the class is given as it
        is declared, as ``every(T)``, or by its name.
    """
    return _Decorator(EveryMark(period, offset), "@every(period)")


def require(message: str, at: Literal["start", "step"] = "step") -> Callable[[_Method], _Method]:
    """Declare, above a method of a `ModelClass` that returns a scalar, that it must stay positive.

    Parameters
    ----------
    message : str
        What is wrong where it is not, and the remedy.
    at : {"start", "step"}
        As of `Requirement`: "start" depends on parameters only.
    """
    if at not in ("start", "step"):
        raise ArgumentError(f'require: at={at!r}; write "start" or "step"')
    return _Decorator(RequireMark(message, at), "@require(message)")


def meant(name: str, known: Iterable[str]) -> str:
    """The end of a message on an unknown name: the known name that is close to it, if there is one."""
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean '{close[0]}'" if close else ""


def declared_variables(cls: type) -> dict[str, Declaration]:
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
                try:
                    value.variable()
                except ArgumentError as error:
                    raise ArgumentError(f"{cls.__name__}: {error}") from None
                found[name] = value
            elif name in found and value is None:
                del found[name]
            elif name in found:
                raise ArgumentError(
                    f"{cls.__name__}: {owner.__name__}.{name} hides {KINDS[found[name].kind]}; redeclare it, as "
                    f"{name} = {found[name].kind}(...), or leave it out by None"
                )
    return found


def marked_methods(cls: type) -> dict[str, Any]:
    """Methods of a class with a mark, in the order of definition: name -> mark."""
    found: dict[str, Any] = {}
    for owner in reversed(cls.__mro__):
        for name, value in vars(owner).items():
            if isinstance(value, _Decorator):
                raise ArgumentError(
                    f"{cls.__name__}.{name}: the method needs {value.usage} above it, with its argument"
                )
            if name in _MISTAKEN and inspect.isfunction(value):
                raise ArgumentError(f"{cls.__name__}.{name}: nothing calls it; the method is {_MISTAKEN[name]}(m)")
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
