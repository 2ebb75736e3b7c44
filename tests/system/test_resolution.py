"""What a system becomes when its names are resolved: conversions on paper, what may be set, what may stand in it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cosim import SetupError, System
from cosim.system.resolution import ResolvedSystem, resolve, resolve_start_value
from cosim.system.system import AsWritten
from cosim.system.variables import Ports
from tests.support.descriptions import fmi2, ports


def resolved_for(order: str, system: System, descriptions: dict[str, Ports]) -> ResolvedSystem:
    return resolve(system, descriptions, needs_levels=order == "sequential")


# Connections


def resolved(source: str, target: str, order: str = "sequential", **connection: Any) -> ResolvedSystem:
    """`a.y` connected to `b.u`, each given as `Type attribute=value ...`."""
    system = System()
    for name in "ab":
        system.add(name, f"{name}.fmu")
    system.connect("a.y", "b.u", **connection)
    here = ports(a=fmi2(f"y output {source}"), b=fmi2(f"u input {target}", guid="{b}"))
    return resolved_for(order, system, here)


def transformed(source: str, target: str, **connection: Any) -> tuple[float, float]:
    """Factor and offset of a connection between two real variables."""
    (link,) = resolved(f"Real {source}", f"Real {target}", **connection).links
    assert (link.source_component, link.source.name) == ("a", "y")
    assert (link.target_component, link.target.name) == ("b", "u")
    return link.factor, link.offset


@pytest.mark.parametrize(
    ("source", "target", "connection", "expected"),
    [
        ("unit=degC", "unit=K", {}, (1.0, 273.15)),
        ("unit=K", "unit=degC", {}, (1.0, -273.15)),
        ("unit=degC", "unit=degF", {}, (1.8, 32.0)),
        ("unit=degF", "unit=degC", {}, (1.0 / 1.8, -32.0 / 1.8)),
        # the factor of the connection scales the converted number, its offset is in the unit of the input
        ("unit=degC", "unit=K", {"factor": 2.0}, (2.0, 546.3)),
        ("unit=degC", "unit=K", {"factor": 2.0, "offset": -5.0}, (2.0, 541.3)),
        ("unit=degC", "unit=degF", {"factor": -0.5, "offset": 1.0}, (-0.9, -15.0)),
        ("unit=degC", "unit=degC", {"factor": 2.0, "offset": -5.0}, (2.0, -5.0)),
        # a difference has no zero
        ("unit=K", "declaredType=Difference", {}, (1.0, 0.0)),
        ("unit=degF", "declaredType=Difference", {"factor": 3.0, "offset": 1.0}, (3.0 / 1.8, 1.0)),
        ("unit=K", "declaredType=Temperature", {}, (1.0, -273.15)),
        # of the source it is not asked
        ("declaredType=Difference", "unit=K", {}, (1.0, 273.15)),
        # without a unit at one end the number is taken as it is
        ("", "unit=K", {"factor": 2.0, "offset": 1.0}, (2.0, 1.0)),
        ("unit=degC", "", {"factor": 2.0, "offset": 1.0}, (2.0, 1.0)),
    ],
)
def test_units_and_factor_make_one_transformation(
    source: str, target: str, connection: dict[str, float], expected: tuple[float, float]
) -> None:
    assert transformed(source, target, units="convert", **connection) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_units_that_are_ignored_change_nothing() -> None:
    for target in ("K", "m", "strange"):
        assert transformed("unit=degC", f"unit={target}", units="ignore", factor=3.0, offset=1.0) == (3.0, 1.0)


@pytest.mark.parametrize("target", ["degC", "degF"])
def test_units_of_one_quantity_are_not_equal(target: str) -> None:
    with pytest.raises(SetupError, match=f"units 'K' and '{target}' don't match; .*units='convert'"):
        transformed("unit=K", f"unit={target}")


def test_two_names_of_one_unit_are_equal() -> None:
    assert transformed("unit=K", "unit=kelvin", factor=2.0) == (2.0, 0.0)
    # for a difference degC is a K
    assert transformed("unit=K", "declaredType=Difference") == (1.0, 0.0)


@pytest.mark.parametrize("units", ["equal", "convert"])
@pytest.mark.parametrize(("source", "target"), [("K", "m"), ("K", "strange"), ("strange", "K")])
def test_units_of_other_quantities_or_of_none_are_refused(source: str, target: str, units: str) -> None:
    with pytest.raises(SetupError, match=f"units '{source}' and '{target}' don't match; give both ends one unit"):
        transformed(f"unit={source}", f"unit={target}", units=units)


def test_a_unit_without_a_definition_of_its_base_is_that_of_its_name() -> None:
    assert transformed("unit=strange", "unit=strange") == (1.0, 0.0)


@pytest.mark.parametrize("factor", [np.nan, np.inf, -np.inf])
def test_a_factor_that_is_no_number_is_refused_whatever_the_units(factor: float) -> None:
    with pytest.raises(SetupError, match=r"factor .* is not a finite number"):
        transformed("unit=degC", "unit=K", units="ignore", factor=factor)


@pytest.mark.parametrize("kind", ["Integer", "Boolean", "Enumeration declaredType=Mode"])
@pytest.mark.parametrize("connection", [{"factor": 2.0}, {"offset": 1.0}, {"factor": 2.0, "offset": 1.0}])
def test_only_real_values_are_transformed(kind: str, connection: dict[str, float]) -> None:
    with pytest.raises(SetupError, match="values can't be transformed; only real ones take a factor and an offset"):
        resolved(kind, kind, **connection)
    assert len(resolved(kind, kind).links) == 1
    assert len(resolved(kind, kind, factor=1.0, offset=0.0).links) == 1


ENUMERATION = "Enumeration declaredType=Mode"
CONVERTED = [
    ("Integer", "Real"),
    ("Boolean", "Real"),
    ("Boolean", "Integer"),
    ("Integer", "Boolean"),
    ("Integer", ENUMERATION),
    (ENUMERATION, "Integer"),
]
TYPES = ["Real", "Integer", "Boolean", ENUMERATION, "String"]


@pytest.mark.parametrize("source", TYPES)
@pytest.mark.parametrize("target", TYPES)
def test_values_are_converted_where_that_is_exact_and_else_refused(source: str, target: str) -> None:
    kinds = " and ".join(kind.partition(" ")[0].lower() for kind in (source, target))
    if source == target or (source, target) in CONVERTED:
        (link,) = resolved(source, target).links
        narrows = (source, target) not in (("Boolean", "Integer"), (ENUMERATION, "Integer"))
        assert link.converts == (source != target and narrows)
    else:
        with pytest.raises(SetupError, match=rf"'a.y' -> 'b.u': {kinds} don't match; connect values of one type"):
            resolved(source, target)


# Start values


def set_to(variable: str, value: Any, name: str = "v") -> list[Any]:
    """Start values of the elements of a name."""
    found = resolve_start_value(Ports("c", fmi2(*variable.split("; "))), name, value)
    assert found.component == "c"
    assert len(found.elements) == len(found.values)
    return list(found.values)


@pytest.mark.parametrize(
    "variable",
    [
        "v parameter Real",
        "v parameter Real initial=exact",
        "v parameter Real initial=approx",
        "v output Real initial=exact variability=continuous",
        "v output Real initial=approx variability=continuous",
        "v local Real initial=approx variability=continuous",
        "v input Real",
    ],
)
def test_what_can_be_set(variable: str) -> None:
    assert set_to(variable, 3.0) == [3.0]


@pytest.mark.parametrize(
    ("variable", "causality"),
    [
        ("v output Real initial=calculated variability=continuous", "output"),
        ("v local Real initial=calculated variability=continuous", "local"),
        ("v calculatedParameter Real initial=calculated", "calculatedParameter"),
        ("v output Real initial=exact variability=constant", "output"),
        ("v local Real initial=exact variability=constant", "local"),
    ],
)
def test_what_can_not_be_set(variable: str, causality: str) -> None:
    message = rf"^start value of 'c.v': {causality} variables can't be set; set parameters and inputs only$"
    with pytest.raises(SetupError, match=message):
        set_to(variable, 3.0)


REAL, WHOLE = "v input Real", "v input Integer"
VECTOR = "v[1] input Real; v[2] input Real; v[3] input Real"


def test_numbers_of_vectors() -> None:
    assert set_to(VECTOR, [1, 2.5, 3], "v") == [1.0, 2.5, 3.0]
    assert set_to(VECTOR, 7.0, "v") == set_to(VECTOR, [7.0], "v") == [7.0] * 3
    assert set_to(VECTOR, np.array([[1.0], [2.0], [3.0]]), "v") == [1.0, 2.0, 3.0]
    assert set_to(VECTOR, 4, "v[2]") == [4.0]
    for values in ([1.0, 2.0], [1.0] * 4, []):
        with pytest.raises(SetupError, match=rf"'c.v': {len(values)} values were given for 3$"):
            set_to(VECTOR, values, "v")
    for place in range(3):
        bad = [0.0, 0.0, 0.0]
        bad[place] = np.inf
        with pytest.raises(SetupError, match="inf is not a finite number"):
            set_to(VECTOR, bad, "v")


@pytest.mark.parametrize("text", ["1,2.5,3", "[1, 2.5, 3]", "[[1], [2.5], [3]]", " 1 , 2.5 , 3 "])
def test_a_list_that_was_typed_is_a_vector(text: str) -> None:
    assert set_to(VECTOR, AsWritten(text), "v") == [1.0, 2.5, 3.0]
    assert set_to(VECTOR, AsWritten("4"), "v") == [4.0] * 3
    with pytest.raises(SetupError, match=r"'c.v': 2 values were given for 3$"):
        set_to(VECTOR, AsWritten("1,2"), "v")
    with pytest.raises(SetupError, match=r"'c.v': 'x' is not a value of type Real$"):
        set_to(VECTOR, AsWritten("1,x,3"), "v")
    assert set_to("v input String", AsWritten("1,2"), "v") == ["1,2"]
    with pytest.raises(SetupError, match="'1,2' is not a value of type Real"):
        set_to(REAL, AsWritten("1,2"), "v")


@pytest.mark.parametrize(
    ("variable", "value", "expected"),
    [
        (REAL, np.float32(0.5), 0.5),
        (REAL, 2**40, 2.0**40),
        (WHOLE, True, 1.0),  # an integer may be a switch
        (WHOLE, 2.0, 2.0),
        (WHOLE, -(2**31), -(2.0**31)),
        (WHOLE, 2**31 - 1, 2.0**31 - 1.0),
        ("v input Enumeration declaredType=Mode", 2, 2.0),
        ("v input Boolean", True, 1.0),
        ("v input Boolean", False, 0.0),
        ("v input Boolean", 1, 1.0),
        ("v input Boolean", "false", 0.0),
        ("v input Boolean", "true", 1.0),
        ("v input String", "text", "text"),
        ("v input String", "", ""),
        ("v input Real min=-1 max=2", -1, -1.0),
        ("v input Real min=-1 max=2", 2, 2.0),
        ("v input Real max=2", -1e300, -1e300),
        ("v input Real min=-1", 1e300, 1e300),
    ],
)
def test_values_that_fit(variable: str, value: Any, expected: float | str) -> None:
    assert set_to(variable, value) == [expected]


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        (REAL, True, "True is not a number or a list of numbers"),
        (REAL, np.bool_(False), ".*False.* is not a number or a list of numbers"),
        (REAL, [True], r"\[True\] is not a number or a list of numbers"),
        (REAL, 10**400, "10+ is not a number or a list of numbers"),
        (WHOLE, 2.5, "2.5 is not a value of type Integer"),
        (WHOLE, 2**31, "2147483648 is not a value of type Integer"),
        (WHOLE, -(2**31) - 1, "-2147483649 is not a value of type Integer"),
        ("v input Enumeration declaredType=Mode", 1.5, "1.5 is not a value of type Enumeration"),
        ("v input Boolean", 2, "2 is not a value of type Boolean"),
        ("v input Boolean", 0.5, "0.5 is not a value of type Boolean"),
        ("v input String", 3, "3 is not a value of type String"),
        ("v input Real min=-1 max=2", -1.001, r"-1.001 is out of bounds; it must be between -1.0 and 2.0$"),
        ("v input Real min=-1 max=2", 2.001, r"2.001 is out of bounds; it must be between -1.0 and 2.0$"),
        ("v input Real min=-1", -1.001, r"-1.001 is out of bounds; it must be at least -1.0$"),
        ("v input Real max=2", 2.001, r"2.001 is out of bounds; it must be between -inf and 2.0$"),
        ("v input Integer min=1 max=3", 4, r"4 is out of bounds; it must be between 1 and 3$"),
    ],
)
def test_values_that_do_not_fit(variable: str, value: Any, message: str) -> None:
    with pytest.raises(SetupError, match=f"start value of 'c.v': {message}"):
        set_to(variable, value)


# Feeding and levels


def pair(order: str, *connections: tuple[str, str]) -> ResolvedSystem:
    """Two components with `y` and the inputs `u` and `v`, on which `y` depends at once."""
    system = System()
    start = {f"{name}.{i}" for name in "ab" for i in "uv"} - {target for _, target in connections}
    for name in "ab":
        system.add(name, f"{name}.fmu", start={i: 0.0 for i in "uv" if f"{name}.{i}" in start})
    for source, target in connections:
        system.connect(source, target)
    variables = "y output Real", "u input Real", "v input Real"
    here = ports(a=fmi2(*variables, feedthrough=True), b=fmi2(*variables, guid="{b}", feedthrough=True))
    return resolved_for(order, system, here)


@pytest.mark.parametrize("order", ["sequential", "parallel"])
def test_levels_follow_the_connections(order: str) -> None:
    levels = pair(order, ("a.y", "b.v")).levels
    assert levels == {("a", "u"): 0, ("a", "v"): 0, ("a", "y"): 0, ("b", "u"): 0, ("b", "v"): 1, ("b", "y"): 1}


def test_an_input_on_which_nothing_depends_has_a_level_too() -> None:
    system = System()
    system.add("a", "a.fmu", start={"u": 0.0, "v": 0.0})
    system.add("b", "b.fmu", start={"u": 0.0})
    system.connect("a.y", "b.v")
    variables = "y output Real", "u input Real", "v input Real"
    here = ports(a=fmi2(*variables), b=fmi2(*variables, guid="{b}"))
    levels = resolved_for("sequential", system, here).levels
    assert levels == {("a", "u"): 0, ("a", "v"): 0, ("a", "y"): 0, ("b", "u"): 0, ("b", "v"): 1, ("b", "y"): 0}


@pytest.mark.parametrize(
    ("source", "depends_on"),
    [
        ("x local Real variability=continuous", {"u"}),
        ("x local Real variability=fixed", set()),
        ("x calculatedParameter Real variability=tunable", set()),
    ],
)
def test_what_a_source_that_is_no_output_depends_on(source: str, depends_on: set[str]) -> None:
    system = System()
    system.add("a", "a.fmu", start={"u": 0.0})
    system.add("b", "b.fmu")
    system.connect("a.x", "b.u")
    here = ports(a=fmi2("u input Real", source), b=fmi2("u input Real", guid="{b}"))
    assert resolved_for("sequential", system, here).feedthrough["a"] == {"x": depends_on}


def test_only_the_parallel_order_has_no_levels_in_a_loop() -> None:
    loop = ("a.y", "b.v"), ("b.y", "a.u")
    assert pair("parallel", *loop).levels is None
    with pytest.raises(SetupError, match=r"algebraic loop .*order='parallel'"):
        pair("sequential", *loop)


def test_an_input_that_nothing_feeds_is_named_and_no_other() -> None:
    system = System()
    system.add("a", "a.fmu", start={"v": 0.0})
    known = ports(a=fmi2("y output Real", "u input Real", "v input Real", "w parameter Real"))
    assert resolve(system, known, needs_levels=False).kept == ("a.u",)
    with pytest.raises(SetupError, match=r"^nothing feeds input 'a.u'; connect it"):
        resolve(system, known, needs_levels=False, strict_inputs=True)


@pytest.mark.parametrize("every", [1, 3])
def test_a_signal_is_sampled_when_its_component_communicates(every: int) -> None:
    system = System()
    system.add("a", "a.fmu", every=every)
    system.drive("a.u", lambda t: t, breakpoints=[0.5, 0.75], vectorized=True)
    (drive,) = resolved_for("parallel", system, ports(a=fmi2("u[1] input Real", "u[2] input Real"))).drives
    assert (drive.component, [e.name for e in drive.targets], drive.every) == ("a", ["u[1]", "u[2]"], every)
    assert (drive.breakpoints, drive.vectorized, drive.added, drive.function(3.0)) == ((0.5, 0.75), True, False, 3.0)
