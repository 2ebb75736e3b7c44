"""Units against the definitions of the SI, written out in base units."""

from __future__ import annotations

import math

import pytest

from fmu_export.modelling.units import conversion, rate_unit, unit

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
    assert unit("m").display == {"mm": (1000.0, 0.0)}
    assert unit("rad").display == {"deg": (math.degrees(1.0), 0.0)}
    assert unit("rad/s").display == {"deg/s": (math.degrees(1.0), 0.0)}
    assert unit("rad/s2").display == {"deg/s2": (math.degrees(1.0), 0.0)}
    assert unit("N.m").display == unit("m/s").display == unit("1").display == {}


@pytest.mark.parametrize("name", ["", "/", "m/", "m/()", ".", "m.", "m0", "m10", "m 2", "wibble", "m/s/s", "(m)"])
def test_what_is_no_unit(name: str) -> None:
    with pytest.raises(ValueError, match="is not defined; write a product of kg, m, s, A, K, mol, cd, rad, N"):
        unit(name)


#: Factor and offset to the base unit, and the base, from the definitions: BIPM brochure (table 8), NIST SP 811.
OTHERS = {
    "degC": (1.0, 273.15, "K"),
    "degF": (5.0 / 9.0, 459.67 * 5.0 / 9.0, "K"),
    "bar": (1e5, 0.0, "Pa"),
    "mbar": (100.0, 0.0, "Pa"),
    "kN": (1000.0, 0.0, "N"),
    "kN.m": (1000.0, 0.0, "N.m"),
    "km/h": (1.0 / 3.6, 0.0, "m/s"),
    "rpm": (math.pi / 30.0, 0.0, "rad/s"),
    "rev/min": (math.pi / 30.0, 0.0, "rad/s"),
    "%": (0.01, 0.0, "1"),
    "%/min": (0.01 / 60.0, 0.0, "1/s"),
    "deg": (math.pi / 180.0, 0.0, "rad"),
    "deg/s": (math.pi / 180.0, 0.0, "rad/s"),
    "min": (60.0, 0.0, "s"),
    "h": (3600.0, 0.0, "s"),
    "d": (86400.0, 0.0, "s"),
    "min-1": (1.0 / 60.0, 0.0, "Hz"),
    "L": (1e-3, 0.0, "m3"),
    "l/min": (1e-3 / 60.0, 0.0, "m3/s"),
    "kW": (1000.0, 0.0, "W"),
    "MW.h": (3.6e9, 0.0, "J"),
    "kWh": (3.6e6, 0.0, "J"),
    "mm": (1e-3, 0.0, "m"),
    "um2": (1e-12, 0.0, "m2"),
    "g/cm3": (1000.0, 0.0, "kg/m3"),
    "t": (1000.0, 0.0, "kg"),
    "mA": (1e-3, 0.0, "A"),
    "kOhm": (1e3, 0.0, "Ohm"),
    "uF": (1e-6, 0.0, "F"),
    "MHz": (1e6, 0.0, "Hz"),
    "mmol/L": (1.0, 0.0, "mol/m3"),
    "psi": (0.45359237 * 9.80665 / 0.0254**2, 0.0, "Pa"),
    "ft": (0.3048, 0.0, "m"),
    "degC/s": (1.0, 0.0, "K/s"),
    "W/(m2.degC)": (1.0, 0.0, "W/(m2.K)"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_units_with_factor_and_offset(name: str) -> None:
    factor, offset, base = OTHERS[name]
    found = unit(name)
    assert found.factor == pytest.approx(factor, rel=4e-16)
    assert found.offset == pytest.approx(offset, rel=4e-16)
    assert found.exponents == unit(base).exponents
    assert conversion(name, base) == (found.factor, found.offset)
    back = conversion(base, name)
    assert back == (pytest.approx(1.0 / factor, rel=4e-16), pytest.approx(-offset / factor, rel=4e-16))
    rate = unit(rate_unit(name))
    assert (rate.factor, rate.offset) == (found.factor, 0.0)  # a rate has no offset
    assert rate.exponents == unit(rate_unit(base)).exponents


def test_conversions() -> None:
    assert conversion("degF", "degC") == (5.0 / 9.0, -160.0 / 9.0)
    assert conversion("degC", "degC") == (1.0, 0.0)
    assert conversion("J", "N.m") == (1.0, 0.0)
    with pytest.raises(ValueError, match="the units differ: bar and m"):
        conversion("bar", "m")


@pytest.mark.parametrize(
    "name", ["dB", "Min", "Nm", "Nm/rad", "PS", "count", "bit", "G", "USD", "Km", "mdegC", "e", "kg_", "degC degC"]
)
def test_units_that_are_something_else_or_that_fmi_cannot_express(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^unit '{name}': '.*' (is not defined|can mean other things); write "):
        unit(name)
