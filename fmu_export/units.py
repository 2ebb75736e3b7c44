"""The units models may use, as FMI describes them: exponents of the SI base units, and display units."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Unit:
    """A unit with its SI base exponents.

    `display` maps the name of a display unit to the factor that turns a value in this unit into it.
    """

    name: str
    exponents: dict[str, int]
    display: dict[str, float] = field(default_factory=dict)


_DEGREES = 180.0 / math.pi

UNITS = {
    u.name: u
    for u in (
        Unit("1", {}),
        Unit("s", {"s": 1}),
        Unit("s-1", {"s": -1}),
        Unit("m", {"m": 1}, {"mm": 1e3}),
        Unit("kg", {"kg": 1}),
        Unit("kg.m2", {"kg": 1, "m": 2}),
        Unit("J", {"kg": 1, "m": 2, "s": -2}),
        Unit("N.m", {"kg": 1, "m": 2, "s": -2}),
        Unit("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        Unit("rad", {"rad": 1}, {"deg": _DEGREES}),
        Unit("rad/s", {"rad": 1, "s": -1}, {"deg/s": _DEGREES}),
        Unit("rad/s2", {"rad": 1, "s": -2}, {"deg/s2": _DEGREES}),
    )
}


#: Unit of the time derivative of a quantity, by its unit.
_RATES = {"1": "s-1", "rad": "rad/s", "rad/s": "rad/s2"}


def rate_unit(name: str) -> str:
    """Unit of the time derivative of a quantity in a unit.

    Raises
    ------
    ValueError
        It is not defined here.
    """
    if name not in _RATES:
        raise ValueError(f"the unit of a rate of '{name}' is not defined; add it to fmu_export/units.py")
    return _RATES[name]


def unit(name: str) -> Unit:
    """Look a unit up.

    Raises
    ------
    ValueError
        The unit is not defined here.
    """
    if name not in UNITS:
        raise ValueError(f"unit '{name}' is not defined; known are {', '.join(UNITS)} (add it to fmu_export/units.py)")
    return UNITS[name]
