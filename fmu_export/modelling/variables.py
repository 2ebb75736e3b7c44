"""The variables that a model declares, and their order in flat arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from fmu_export.errors import ArgumentError
from fmu_export.modelling.names import check_text, check_variable_name
from fmu_export.modelling.units import conversion, unit

#: A flat array of floats, or of symbols while a back end traces the model.
Array = Any


@dataclass(frozen=True)
class Variable:
    """A scalar or a vector that a model declares.

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
    size : int, optional
        Length of a vector, whose elements are named ``name[1]`` ...; None for a scalar.
    start : float or sequence of float, optional
        Start value of a parameter or an input, one number for all elements or one an element.
    min, max : float, optional
        Smallest and largest admissible value (both inclusive).
    tunable : bool, optional
        Whether a parameter may change during a run, between two steps; the states go on from where they are.
    display_unit : str, optional
        Unit in which tools show the values; of the same kind as `unit`.
    nominal : float, optional
        Positive magnitude that values usually have, 1 by default; integrators weigh errors of states by it.

    Raises
    ------
    ArgumentError
        The name is no structured name of FMI, the unit is not known, a number is not finite or does not fit.
    """

    name: str
    unit: str = "1"
    description: str = ""
    size: int | None = None
    start: float | Sequence[float] | np.ndarray = 0.0
    min: float | None = None
    max: float | None = None
    tunable: bool = False
    display_unit: str | None = None
    nominal: float | None = None

    def __post_init__(self) -> None:
        check_variable_name(self.name)
        here = f"variable '{self.name}'"
        check_text(f"{here}: the description", self.description)
        try:
            conversion(self.unit, self.unit if self.display_unit is None else self.display_unit)
            unit(self.unit)
        except (ValueError, TypeError, AttributeError) as error:
            raise ArgumentError(f"{here}: {error}") from None
        self._set("size", _size(here, self.size))
        if self.size is not None and self.name.endswith("]"):
            raise ArgumentError(f"{here}: a vector's name has no index of its own; its elements get them")
        self._set("min", _limit(here, "min", self.min, -math.inf))
        self._set("max", _limit(here, "max", self.max, math.inf))
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ArgumentError(f"{here}: min {self.min!r} is greater than max {self.max!r}")
        if self.nominal is not None:
            self._set("nominal", number(here, "nominal", self.nominal))
            if not self.nominal > 0.0:
                raise ArgumentError(f"{here}: nominal is {self.nominal!r}; it must be positive")
        self._set("start", _starts(here, self.start, self.size or 1))

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)  # frozen for all others

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the elements, as importers of an FMU see them."""
        return (self.name,) if self.size is None else tuple(f"{self.name}[{i + 1}]" for i in range(self.size))

    @property
    def starts(self) -> tuple[float, ...]:
        """Start values of the elements."""
        return self.start if isinstance(self.start, tuple) else (self.start,) * (self.size or 1)  # type: ignore[return-value]

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


def _size(here: str, size: Any) -> int | None:
    if size is None:
        return None
    if isinstance(size, bool) or not isinstance(size, (int, np.integer)) or size < 1:
        raise ArgumentError(f"{here}: size is {size!r}; give the number of elements, at least 1, or None for a scalar")
    return int(size)


def number(here: str, what: str, value: Any) -> float:
    """A finite number as float.

    Raises
    ------
    ArgumentError
        It is none.
    """
    try:
        found = math.nan if isinstance(value, str) else float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not math.isfinite(found):
        raise ArgumentError(f"{here}: {what} is {value!r}, which is no finite number")
    return found


def _limit(here: str, what: str, value: Any, none: float) -> float | None:
    return None if value is None or value == none else number(here, what, value)


def _starts(here: str, start: Any, n: int) -> float | tuple[float, ...]:
    if np.ndim(start) == 0:
        return number(here, "the start value", start)
    if np.ndim(start) != 1 or len(start) != n:
        raise ArgumentError(f"{here} has {n} elements but {np.size(start)} start values")
    return tuple(number(here, "a start value", s) for s in start)


class Layout:
    """The order of named variables in a flat array."""

    def __init__(self, variables: Sequence[Variable] = ()) -> None:
        self.variables = tuple(variables)
        for v in self.variables:
            if not isinstance(v, Variable):
                raise ArgumentError(f"a Layout is made of Variables, and {v!r} is none")
        check_unique([v.name for v in self.variables])
        self.names = tuple(name for v in self.variables for name in v.names)
        check_unique(self.names)
        self.starts = np.array([s for v in self.variables for s in v.starts])
        self._slices: dict[str, slice | int] = {}
        position = 0
        for v in self.variables:
            end = position + (v.size or 1)
            self._slices[v.name] = position if v.size is None else slice(position, end)
            position = end

    def __len__(self) -> int:
        return len(self.names)

    def unpack(self, flat: Array) -> SimpleNamespace:
        """Name the parts of a flat array: scalars and (size,) vectors."""
        return SimpleNamespace(**{name: flat[where] for name, where in self._slices.items()})

    def pack(self, **parts: Array) -> Array:
        """Join named parts to a flat array (n,).

        Raises
        ------
        TypeError
            A declared part is missing, or an undeclared one is given.
        """
        if parts.keys() != self._slices.keys():
            wrong = ", ".join(sorted(parts.keys() ^ self._slices.keys()))
            raise TypeError(f"parts and declared variables differ in: {wrong}")
        return np.concatenate([np.reshape(parts[v.name], (v.size or 1,)) for v in self.variables])


def check_unique(names: Sequence[str], where: str = "") -> None:
    """Refuse a name that is there twice.

    Raises
    ------
    ArgumentError
    """
    if len(set(names)) != len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise ArgumentError(f"{where}variable names are not unique: {', '.join(twice)}")
