"""Units as FMI describes them: exponents of the SI base units, factor and offset, and display units.

A unit is a product of symbols, written as in Modelica: `N.m`, `rad/s2`, `N.m/(rad.s)`, `s-1`, `km/h`, `degC`, `1`. The
coherent SI units are known here; all others (kN, bar, rpm, %) come from the table of the library pint.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from typing import Any

from fmu_export.errors import ArgumentError, needs


@dataclass(frozen=True)
class Unit:
    """A unit with its SI base exponents.

    A value in it is `factor * value + offset` in the base unit. `display` maps the name of a display unit to factor and
    offset that turn a value in this unit into it.
    """

    name: str
    exponents: Mapping[str, int]
    factor: float = 1.0
    offset: float = 0.0
    display: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Symbol:
    """What a symbol or a product stands for; its numbers are exact, so that products are rounded once."""

    exponents: Mapping[str, int]
    factor: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)


#: FMI's order.
_BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

#: The coherent units.
_SYMBOLS: dict[str, _Symbol] = {
    symbol: _Symbol(exponents)
    for symbol, exponents in {
        **{base: {base: 1} for base in _BASES},
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
    }.items()
}

_DEGREES = 180.0 / math.pi

_DISPLAY = {
    "m": {"mm": (1e3, 0.0)},
    "rad": {"deg": (_DEGREES, 0.0)},
    "rad/s": {"deg/s": (_DEGREES, 0.0)},
    "rad/s2": {"deg/s2": (_DEGREES, 0.0)},
}

#: pint's names of FMI's base units; the gram comes with a factor.
_PINT_BASES = dict(
    zip(("kilogram", "meter", "second", "ampere", "kelvin", "mole", "candela", "radian"), _BASES, strict=True)
)
#: The units that prefixes go with: pint also reads "Min" as a million inches.
_PREFIXED = frozenset(
    "meter gram second ampere kelvin mole candela radian newton joule watt pascal hertz coulomb volt ohm farad weber "  # noqa: SIM905
    "tesla henry siemens bar liter metric_ton watt_hour ampere_hour electron_volt calorie volt_ampere lumen lux "
    "sievert gray katal revolutions_per_minute".split()
)
#: What pint reads as something else than engineers write, with what to write.
_MISREAD = {"Nm": "N.m", "PS": "hp or kW", "e": "1", "c": "1", "u": "kg"}
#: Symbols that pint has under another name.
_ALIASES = ("@alias ohm = Ohm", "@alias turn = rev", "@alias volt_ampere = var")


@cache
def unit(name: str) -> Unit:
    """Look a unit up.

    Raises
    ------
    ArgumentError
        A symbol is not known, or the unit is no product of symbols as it is written.
    MissingExtra
        A symbol is no coherent SI unit, and pint is not installed.
    """
    product = _product(name)
    display = _DISPLAY.get(name, {})
    return Unit(name, product.exponents, float(product.factor), float(product.offset), display)


def conversion(source: str, target: str) -> tuple[float, float]:
    """Factor and offset that turn a value in one unit into one in another: target = factor * source + offset.

    Raises
    ------
    ArgumentError
        They don't measure the same, or as `unit`.
    MissingExtra
        As `unit`.
    """
    if source == target:
        return 1.0, 0.0
    if target in _DISPLAY.get(source, {}):
        return _DISPLAY[source][target]
    a, b = _product(source), _product(target)
    if a.exponents != b.exponents:
        raise ArgumentError(f"the units differ: {source} and {target}")
    return float(a.factor / b.factor), float((a.offset - b.offset) / b.factor)


@cache
def _product(name: str) -> _Symbol:
    total: Counter[str] = Counter()
    factor, offset = Fraction(1), Fraction(0)
    factors = _factors(name)
    for text, power in factors.items():
        symbol = _symbol(text)
        assert symbol is not None  # _factors has checked it
        factor *= symbol.factor**power
        for base, exponent in symbol.exponents.items():
            total[base] += power * exponent
        if list(factors.values()) == [1]:  # in a product it is a difference: degC/s, W/(m2.degC)
            offset = symbol.offset
    return _Symbol({base: total[base] for base in _BASES if total[base]}, factor, offset)


def rate_unit(name: str) -> str:
    """Unit of the time derivative of a quantity in a unit.

    >>> [rate_unit(name) for name in ("rad", "rad/s", "1", "rad.s", "N.m", "degC")]
    ['rad/s', 'rad/s2', 's-1', 'rad', 'N.m/s', 'degC/s']

    Raises
    ------
    ArgumentError
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
            found = re.fullmatch(r"([A-Za-z%]+)(-?[1-9])?", factor)
            if factor == "1":
                continue
            if found is None:
                raise _unknown(name, factor)
            if _symbol(found[1]) is None:
                raise _unknown(name, found[1])
            factors[found[1]] += sign * int(found[2] or 1)
    if not above or name.endswith(("/", "/()")):
        raise _unknown(name, name)
    return factors


def _unknown(name: str, factor: str) -> ArgumentError:
    if factor in _MISREAD:
        return ArgumentError(f"unit '{name}': '{factor}' can mean other things; write {_MISREAD[factor]}")
    return ArgumentError(
        f"unit '{name}': '{factor}' is not defined; write a product of {', '.join(_SYMBOLS)} and others such as kN, "
        "bar, degC, rpm, h or %, as N.m/(rad.s), km/h or s-1, or 1 for no unit"
    )


@cache
def _symbol(text: str) -> _Symbol | None:
    """What a symbol stands for; None for one that is not known or that FMI can't express."""
    if text in _SYMBOLS:
        return _SYMBOLS[text]
    if text in _MISREAD:
        return None
    table = _table()
    name = "percent" if text == "%" else text
    try:
        prefix, found, _ = table.parse_unit_name(name)[0]
        zero, one = (table.Quantity(Fraction(n), name).to_base_units() for n in (0, 1))
        exponents = {_PINT_BASES[base]: int(power) for base, power in one.unit_items() if power == int(power)}
    except (LookupError, AttributeError, TypeError, ValueError):
        return None  # not known, or logarithmic (dB)
    if len(exponents) != len(list(one.unit_items())) or (prefix and found not in _PREFIXED):
        return None
    return _Symbol(exponents, Fraction(one.magnitude - zero.magnitude), Fraction(zero.magnitude))


@cache
def _table() -> Any:
    with needs("export"):
        import pint
    table: Any = pint.UnitRegistry(non_int_type=Fraction)
    for alias in _ALIASES:
        table.define(alias)
    return table
