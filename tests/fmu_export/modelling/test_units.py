"""Units against the definitions of the SI, written out in base units."""

from __future__ import annotations

import math

import pytest

from fmu_export.modelling.units import rate_unit, unit

#: Exponents of kg, m, s, A, K, mol, cd, rad (SI brochure, table 4).
SI = {
    "1": (0, 0, 0, 0, 0, 0, 0, 0),
    "kg": (1, 0, 0, 0, 0, 0, 0, 0),
    "m": (0, 1, 0, 0, 0, 0, 0, 0),
    "s": (0, 0, 1, 0, 0, 0, 0, 0),
    "A": (0, 0, 0, 1, 0, 0, 0, 0),
    "K": (0, 0, 0, 0, 1, 0, 0, 0),
    "mol": (0, 0, 0, 0, 0, 1, 0, 0),
    "cd": (0, 0, 0, 0, 0, 0, 1, 0),
    "rad": (0, 0, 0, 0, 0, 0, 0, 1),
    "Hz": (0, 0, -1, 0, 0, 0, 0, 0),
    "N": (1, 1, -2, 0, 0, 0, 0, 0),
    "Pa": (1, -1, -2, 0, 0, 0, 0, 0),
    "J": (1, 2, -2, 0, 0, 0, 0, 0),
    "W": (1, 2, -3, 0, 0, 0, 0, 0),
    "C": (0, 0, 1, 1, 0, 0, 0, 0),
    "V": (1, 2, -3, -1, 0, 0, 0, 0),
    "F": (-1, -2, 4, 2, 0, 0, 0, 0),
    "Ohm": (1, 2, -3, -2, 0, 0, 0, 0),
    "Wb": (1, 2, -2, -1, 0, 0, 0, 0),
    "T": (1, 0, -2, -1, 0, 0, 0, 0),
    "H": (1, 2, -2, -2, 0, 0, 0, 0),
}
BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def exponents(name: str) -> tuple[int, ...]:
    found = unit(name).exponents
    assert set(found) <= set(BASES)
    assert 0 not in found.values()
    return tuple(found.get(base, 0) for base in BASES)


@pytest.mark.parametrize("name", SI)
def test_units_of_the_si(name: str) -> None:
    assert exponents(name) == SI[name]
    assert unit(name).name == name


@pytest.mark.parametrize(
    ("product", "same"),
    [
        ("N.m", "J"),
        ("J/s", "W"),
        ("V.A", "W"),
        ("Wb/A", "H"),
        ("Wb/m2", "T"),
        ("C/V", "F"),
        ("V/A", "Ohm"),
        ("N/m2", "Pa"),
        ("s-1", "Hz"),
        ("1/s", "Hz"),
        ("kg.m/s2", "N"),
        ("J/(A.s)", "V"),
        ("m/m", "1"),
        ("m.m-1", "1"),
    ],
)
def test_products_that_are_units_themselves(product: str, same: str) -> None:
    assert exponents(product) == exponents(same)


@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("m", "m/s"),
        ("m/s", "m/s2"),
        ("1", "s-1"),
        ("s-1", "s-2"),
        ("s", "1"),
        ("s2", "s"),
        ("rad.s", "rad"),
        ("rad.s2", "rad.s"),
        ("N.m", "N.m/s"),
        ("N.m/rad", "N.m/(rad.s)"),
        ("kg.m2", "kg.m2/s"),
        ("1/m", "m-1.s-1"),
    ],
)
def test_rates(name: str, rate: str) -> None:
    assert rate_unit(name) == rate
    per_second = tuple(n - (base == "s") for base, n in zip(BASES, exponents(name), strict=True))
    assert exponents(rate) == per_second


def test_display_units_are_how_often_they_go_into_one() -> None:
    assert unit("m").display == {"mm": 1000.0}
    assert unit("rad").display == {"deg": math.degrees(1.0)}
    assert unit("rad/s").display == {"deg/s": math.degrees(1.0)}
    assert unit("rad/s2").display == {"deg/s2": math.degrees(1.0)}
    assert unit("N.m").display == unit("m/s").display == unit("1").display == {}


@pytest.mark.parametrize("name", ["", "/", "m/", "m/()", ".", "m.", "m0", "m10", "m 2", "M", "newton", "m/s/s", "(m)"])
def test_what_is_no_unit(name: str) -> None:
    with pytest.raises(ValueError, match="is not defined; write a product of kg, m, s, A, K, mol, cd, rad, N"):
        unit(name)
