"""Conversion between units of FMUs, which define theirs by base units, a factor and an offset."""

from __future__ import annotations

from fmpy.model_description import BaseUnit, Unit

from cosim.errors import CosimError


class UnitsDiffer(CosimError):
    """Two units don't measure the same."""


def conversion(source: Unit, target: Unit, *, relative: bool) -> tuple[float, float]:
    """Factor and offset with which a number in one unit becomes one in another: target = factor * source + offset.

    Parameters
    ----------
    source, target : Unit
        A value in a unit is `unit.factor * value + unit.offset` in the base unit (FMI 2.0.4, 2.2.2).
    relative : bool
        The value is a difference (`relativeQuantity`), to which offsets don't apply.

    Raises
    ------
    UnitsDiffer
        The base units are not the same, or unknown while the names differ.
    """
    if source.name == target.name:
        return 1.0, 0.0
    a, b = source.baseUnit, target.baseUnit
    if a is None or b is None or _exponents(a) != _exponents(b):
        raise UnitsDiffer(f"units '{source.name}' and '{target.name}' don't match; convert one of them in its FMU")
    factor = float(a.factor) / float(b.factor)
    offset = 0.0 if relative else (float(a.offset) - float(b.offset)) / float(b.factor)
    return factor, offset


def _exponents(unit: BaseUnit) -> tuple[float, ...]:
    exponents = (unit.kg, unit.m, unit.s, unit.A, unit.K, unit.mol, unit.cd, unit.rad)
    return tuple(float(e) for e in exponents)
