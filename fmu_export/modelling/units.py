"""Units as FMI describes them: exponents of the SI base units, and display units.

A unit is a product of coherent SI units, written as in Modelica: `N.m`, `rad/s2`, `N.m/(rad.s)`, `s-1`, `1`.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Unit:
    """A unit with its SI base exponents.

    `display` maps the name of a display unit to the factor that turns a value in this unit into it.
    """

    name: str
    exponents: dict[str, int]
    display: dict[str, float] = field(default_factory=dict)


#: Exponents of the base units (FMI's order) in each coherent unit.
_SYMBOLS: dict[str, dict[str, int]] = {
    **{base: {base: 1} for base in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "Hz": {"s": -1},
    "C": {"s": 1, "A": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "F": {"kg": -1, "m": -2, "s": 4, "A": 2},
    "Wb": {"kg": 1, "m": 2, "s": -2, "A": -1},
    "T": {"kg": 1, "s": -2, "A": -1},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
}

_DEGREES = 180.0 / math.pi

_DISPLAY = {
    "m": {"mm": 1e3},
    "rad": {"deg": _DEGREES},
    "rad/s": {"deg/s": _DEGREES},
    "rad/s2": {"deg/s2": _DEGREES},
}


def unit(name: str) -> Unit:
    """Look a unit up.

    Raises
    ------
    ValueError
        It is no product of SI units as it is written.
    """
    total: Counter[str] = Counter()
    for symbol, power in _factors(name).items():
        for base, exponent in _SYMBOLS[symbol].items():
            total[base] += power * exponent
    return Unit(name, {base: total[base] for base in _SYMBOLS if total[base]}, _DISPLAY.get(name, {}))


def rate_unit(name: str) -> str:
    """Unit of the time derivative of a quantity in a unit.

    >>> [rate_unit(name) for name in ("rad", "rad/s", "1", "rad.s", "N.m")]
    ['rad/s', 'rad/s2', 's-1', 'rad', 'N.m/s']

    Raises
    ------
    ValueError
        As `unit`.
    """
    factors = _factors(name)
    factors["s"] -= 1
    above = [_power(symbol, n) for symbol, n in factors.items() if n > 0]
    below = [_power(symbol, -n if above else n) for symbol, n in factors.items() if n < 0]
    if not above:
        return ".".join(below) or "1"
    return ".".join(above) + ("/" + below[0] if len(below) == 1 else f"/({'.'.join(below)})" if below else "")


def _power(symbol: str, exponent: int) -> str:
    return symbol if exponent == 1 else f"{symbol}{exponent}"


def _factors(name: str) -> Counter[str]:
    """Symbol -> exponent."""
    factors: Counter[str] = Counter()
    above, _, below = name.partition("/")
    below = below[1:-1] if below.startswith("(") and below.endswith(")") else below
    for part, sign in ((above, 1), (below, -1)):
        for factor in part.split(".") if part else ():
            found = re.fullmatch(r"([A-Za-z]+)(-?[1-9])?", factor)
            if found and found[1] in _SYMBOLS:
                factors[found[1]] += sign * int(found[2] or 1)
            elif factor != "1":
                raise _unknown(name, factor)
    if not above or name.endswith(("/", "/()")):
        raise _unknown(name, name)
    return factors


def _unknown(name: str, factor: str) -> ValueError:
    return ValueError(
        f"unit '{name}': '{factor}' is not defined; write a product of {', '.join(_SYMBOLS)}, as N.m/(rad.s) or s-1, "
        "or 1 for no unit"
    )
