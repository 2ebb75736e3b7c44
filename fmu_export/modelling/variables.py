"""The variables that a model declares, and their order in flat arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Literal, get_args

import numpy as np

from fmu_export.errors import ArgumentError
from fmu_export.modelling.names import LONGEST_NAME, check_text, check_variable_name
from fmu_export.modelling.units import conversion, unit

#: A flat array of floats, or of symbols while a back end traces the model.
Array = Any


Type = Literal["real", "integer", "boolean", "enumeration", "string"]

#: The largest magnitude of an integer in FMI 2.0, and of Int32 in FMI 3.0.
_LARGEST_INTEGER = 2**31 - 1


@dataclass(frozen=True)
class Variable:
    """A scalar, a vector or a matrix that a model declares.

    Parameters
    ----------
    name : str
        The paper's symbol in ASCII, for example ``theta_a``. Dots are levels of hierarchy.
    unit : str, optional
        Product of symbols, as ``N.m``, ``rad/s2``, ``km/h`` or ``degC`` (`fmu_export.modelling.units`); ``"1"`` for
        dimensionless. The functions of the model get and give values in this unit; a state's derivative is in this
        unit per second.
    description : str, optional
        One line for the users of other tools.
    size : int or tuple of int, optional
        Length of a vector, whose elements are named ``name[1]`` ..., or shape of an array, whose elements are named
        ``name[1,1]``, ``name[1,2]`` ... and stand row by row; None for a scalar.
    start : number, bool, str or array of them, optional
        Start value of a parameter, an input or a discrete state, one for all elements or one an element. Of an
        enumeration the name or the value of an item, of a string one of its texts; by default 0, false, or the first.
    min, max : float, optional
        Smallest and largest admissible value (both inclusive), of reals and integers.
    tunable : bool, optional
        Whether a parameter may change during a run, between two steps; the states go on from where they are.
    display_unit : str, optional
        Unit in which tools show the values; of the same kind as `unit`.
    nominal : float, optional
        Positive magnitude that values usually have, 1 by default; integrators weigh errors of states by it.
    type : {"real", "integer", "boolean", "enumeration", "string"}, optional
        In the functions of a model all values are floats: a Boolean is 0 or 1, an enumeration the value of its item, a
        string the position of its text in `items`, which begins with 0. What is not a real changes at events, at
        sampling instants and with inputs, and not continuously.
    items : sequence of str or mapping of str to int, optional
        Names of the items of an enumeration, with values 1, 2, ... or those of the mapping; the texts that a string can
        be.

    Raises
    ------
    ArgumentError
        The name is not a structured name of FMI, the unit is not known, a number is not finite or does not fit, a start
        value is none of the type.
    """

    name: str
    unit: str = "1"
    description: str = ""
    size: int | tuple[int, ...] | None = None
    start: Any = None
    min: float | None = None
    max: float | None = None
    tunable: bool = False
    display_unit: str | None = None
    nominal: float | None = None
    type: Type = "real"
    items: Any = ()

    def __post_init__(self) -> None:
        check_variable_name(self.name)
        here = f"variable '{self.name}'"
        check_text(f"{here}: the description", self.description)
        try:
            conversion(self.unit, self.unit if self.display_unit is None else self.display_unit)
            unit(self.unit)
        except (ArgumentError, TypeError, AttributeError) as error:
            raise ArgumentError(f"{here}: {error}") from None
        self._set("size", _size(here, self.size))
        if self.size is not None and self.name.endswith("]"):
            raise ArgumentError(f"{here}: an array's name has no index of its own; its elements get them")
        if not isinstance(self.tunable, bool | np.bool):
            raise ArgumentError(f"{here}: tunable is {self.tunable!r}; it must be True or False")
        self._check_type(here)
        self._set("min", _limit(here, "min", self.min, -math.inf))
        self._set("max", _limit(here, "max", self.max, math.inf))
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ArgumentError(f"{here}: min {self.min!r} is greater than max {self.max!r}")
        if self.nominal is not None:
            self._set("nominal", number(here, "nominal", self.nominal))
            if not self.nominal > 0.0:
                raise ArgumentError(f"{here}: nominal is {self.nominal!r}; it must be positive")
        self._set("start", self._starts(here))

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)  # frozen for all others

    def _check_type(self, here: str) -> None:
        if self.type not in get_args(Type):
            raise ArgumentError(f"{here}: type is {self.type!r}; it must be one of {', '.join(get_args(Type))}")
        self._set("items", _items(here, self.type, self.items))
        if self.type != "real" and (self.unit, self.display_unit, self.nominal) != ("1", None, None):
            raise ArgumentError(f"{here}: only a real has a unit, a display unit and a nominal value, no {self.type}")
        if self.type not in ("real", "integer") and (self.min, self.max) != (None, None):
            raise ArgumentError(f"{here}: only reals and integers have min and max, no {self.type}")
        for what in ("min", "max") if self.type == "integer" else ():
            if getattr(self, what) is not None and number(here, what, getattr(self, what)) % 1.0:
                raise ArgumentError(f"{here}: {what} is {getattr(self, what)!r}, which is not whole")

    def _starts(self, here: str) -> float | tuple[float, ...]:
        start = self.start
        if start is None:
            start = self.items[0][1] if self.type in ("enumeration", "string") else 0.0
        try:
            values = np.asarray(start, dtype=object if self.type != "real" else None)
        except ValueError:  # rows of different lengths
            raise ArgumentError(f"{here}: the rows of the start value have different lengths") from None
        if values.ndim == 0:
            return self.number_of(values.item(), f"{here}: the start value")
        if values.size != self.n_elements or (values.ndim > 1 and values.shape != self.shape):
            raise ArgumentError(f"{here} has {_elements(self.shape)} but {_elements(values.shape, 'start value')}")
        return tuple(self.number_of(value, f"{here}: a start value") for value in values.ravel().tolist())

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the value: () of a scalar, (n,) of a vector."""
        return () if self.size is None else (self.size,) if isinstance(self.size, int) else self.size

    @property
    def n_elements(self) -> int:
        """Number of scalars."""
        return math.prod(self.shape)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the elements, as importers of an FMU see them, row by row."""
        if self.size is None:
            return (self.name,)
        return tuple(f"{self.name}[{','.join(str(i + 1) for i in where)}]" for where in np.ndindex(self.shape))

    @property
    def starts(self) -> tuple[float, ...]:
        """Start values of the elements."""
        return self.start if isinstance(self.start, tuple) else (self.start,) * self.n_elements

    def number_of(self, value: Any, what: str) -> float:
        """The number that stands for a value of this type in the arrays of a model; `what` it is, for the message.

        Raises
        ------
        ArgumentError
            It is not a value of this type.
        """
        if isinstance(value, str) and self.type in ("enumeration", "string"):
            for name, position in self.items:
                if name == value:
                    return float(position)
            raise ArgumentError(f"{what} is {value!r}; it must be one of {', '.join(repr(n) for n, _ in self.items)}")
        found = number_or_nan(value)
        if not math.isfinite(found):
            raise ArgumentError(f"{what} is {value!r}, which is not a finite number")
        if self.type == "integer" and (found % 1.0 or abs(found) > _LARGEST_INTEGER):
            raise ArgumentError(f"{what} is {value!r}, which is not a whole number of 32 bits")
        if self.type == "boolean" and found not in (0.0, 1.0):
            raise ArgumentError(f"{what} is {value!r}, which is neither true nor false")
        if self.items and found not in {position for _, position in self.items}:
            raise ArgumentError(f"{what} is {value!r}; its items are {', '.join(f'{n} = {i}' for n, i in self.items)}")
        return found

    def check_starts(self, what: str) -> None:
        """Refuse start values outside the limits; `what` has them, for the message.

        Raises
        ------
        ArgumentError
        """
        lower, upper = (-math.inf if self.min is None else self.min), (math.inf if self.max is None else self.max)
        for name, start in zip(self.names, self.starts, strict=True):
            if not lower <= start <= upper:
                raise ArgumentError(
                    f"{what} '{name}': the start value {start!r} is outside [{lower!r}, {upper!r}], its min and max"
                )


def _elements(shape: tuple[int, ...], what: str = "element") -> str:
    n = " x ".join(map(str, shape)) if shape else "1"
    return f"{n} {what}s"


def _size(here: str, size: Any) -> int | tuple[int, ...] | None:
    if size is None:
        return None
    sizes = tuple(size) if isinstance(size, list | tuple | np.ndarray) and np.ndim(size) == 1 else (size,)
    whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1 for n in sizes)
    if not sizes or not whole:
        raise ArgumentError(
            f"{here}: size is {size!r}; give the number of elements or the shape, each at least 1, or None for a scalar"
        )
    return int(sizes[0]) if len(sizes) == 1 else tuple(map(int, sizes))


def _items(here: str, type_: Type, items: Any) -> tuple[tuple[str, int], ...]:
    """Names or texts with their numbers."""
    if type_ not in ("enumeration", "string"):
        if items:
            raise ArgumentError(f"{here}: only an enumeration and a string have items, no {type_}")
        return ()
    if isinstance(items, Mapping):
        pairs = tuple(items.items())
    elif not isinstance(items, str) and all(isinstance(item, tuple) for item in items):
        pairs = tuple(items)  # as they are kept
    else:
        pairs = tuple((item, i) for i, item in enumerate(items, start=int(type_ == "enumeration")))
    if not pairs or isinstance(items, str):
        raise ArgumentError(f"{here}: {'an enumeration' if type_ == 'enumeration' else 'a string'} needs items: texts")
    for name, position in pairs:
        check_text(f"{here}: an item", name)
        if isinstance(position, bool) or not isinstance(position, int) or abs(position) > _LARGEST_INTEGER:
            raise ArgumentError(f"{here}: the value {position!r} of item '{name}' is not a whole number of 32 bits")
        if len(name) > LONGEST_NAME or (type_ == "enumeration" and not name):
            raise ArgumentError(f"{here}: an item is a text of 1 to {LONGEST_NAME} characters, not {name[:20]!r}")
    for what, found in (("names", [n for n, _ in pairs]), ("values", [i for _, i in pairs])):
        if len(set(found)) != len(found):
            raise ArgumentError(f"{here}: the {what} of the items are not unique")
    return pairs


def number_or_nan(value: Any) -> float:
    """A number as float; NaN for what is none, such as a text."""
    try:
        return math.nan if isinstance(value, str | bytes) else float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def number(here: str, what: str, value: Any) -> float:
    """A finite number as float.

    Raises
    ------
    ArgumentError
        It is none.
    """
    found = number_or_nan(value)
    if not math.isfinite(found):
        raise ArgumentError(f"{here}: {what} is {value!r}, which is not a finite number")
    return found


def _limit(here: str, what: str, value: Any, none: float) -> float | None:
    return None if value is None or value == none else number(here, what, value)


class Layout:
    """The order of named variables in a flat array."""

    def __init__(self, variables: Sequence[Variable] = ()) -> None:
        self.variables = tuple(variables)
        for v in self.variables:
            if not isinstance(v, Variable):
                raise ArgumentError(f"a Layout is made of Variables, and {v!r} is not one")
        check_unique([v.name for v in self.variables])
        self.names = tuple(name for v in self.variables for name in v.names)
        check_unique(self.names)
        self.starts = np.array([s for v in self.variables for s in v.starts])
        self._slices: dict[str, slice | int] = {}
        self._shapes = {v.name: v.shape for v in self.variables if len(v.shape) > 1}
        position = 0
        for v in self.variables:
            end = position + v.n_elements
            self._slices[v.name] = position if v.size is None else slice(position, end)
            position = end

    def __len__(self) -> int:
        return len(self.names)

    def unpack(self, flat: Array) -> SimpleNamespace:
        """Name the parts of a flat array: scalars, (size,) vectors and arrays of their shape."""
        parts = {name: flat[where] for name, where in self._slices.items()}
        parts |= {name: parts[name].reshape(shape) for name, shape in self._shapes.items()}
        return SimpleNamespace(**parts)

    def pack(self, **parts: Array) -> Array:
        """Join named parts to a flat array (n,), arrays row by row.

        Raises
        ------
        TypeError
            A declared part is missing, or an undeclared one is given.
        ArgumentError
            An array has another shape than is declared.
        """
        if parts.keys() != self._slices.keys():
            wrong = ", ".join(sorted(parts.keys() ^ self._slices.keys()))
            raise TypeError(f"parts and declared variables differ in: {wrong}")
        for v in self.variables:
            if len(v.shape) > 1 and np.shape(parts[v.name]) != v.shape:
                raise ArgumentError(f"'{v.name}' has the shape {np.shape(parts[v.name])}; {v.shape} is declared")
        return np.concatenate([np.reshape(parts[v.name], (v.n_elements,)) for v in self.variables])


def check_unique(names: Sequence[str], where: str = "") -> None:
    """Refuse a name that is there twice.

    Raises
    ------
    ArgumentError
    """
    if len(set(names)) != len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise ArgumentError(f"{where}variable names are not unique: {', '.join(twice)}")
