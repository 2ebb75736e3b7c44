"""Names and types of variables: what stands under a name, in which order, and what its type can hold."""

from __future__ import annotations

import zipfile
from io import BytesIO

import pytest
from fmpy import read_model_description
from fmpy.model_description import ModelDescription, ModelVariable

from cosim import SetupError, System
from cosim.errors import ArgumentError
from cosim.fmi.types import FMI_TYPES
from cosim.system.resolution import Link
from cosim.system.system import Connection
from cosim.system.variables import Element, ElementArray, Ports, variables_of
from tests.support.descriptions import fmi2

#: Smallest and largest value of the integer types of C.
RANGES = {
    "Int8": (-128, 127),
    "UInt8": (0, 255),
    "Int16": (-32768, 32767),
    "UInt16": (0, 65535),
    "Int32": (-2147483648, 2147483647),
    "UInt32": (0, 4294967295),
    "Int64": (-9223372036854775808, 9223372036854775807),
    "UInt64": (0, 18446744073709551615),
}


def fmi3(*variables: str) -> Ports:
    """A component from `name Type size size ...`, all inputs."""
    items = "".join(
        f'<{kind} name="{name}" valueReference="{k}" causality="input" variability="discrete" start="0">'
        + "".join(f'<Dimension start="{n}"/>' for n in sizes)
        + f"</{kind}>"
        for k, (name, kind, *sizes) in enumerate((v.split() for v in variables), start=1)
    )
    text = (
        '<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="t"><CoSimulation modelIdentifier="M"/>'
        f"<ModelVariables>{items}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w") as out:
        out.writestr("modelDescription.xml", text)
    return Ports("c", read_model_description(archive, validate=False))


# Types


@pytest.mark.parametrize("kind", RANGES)
def test_integers_of_fmi_3_hold_what_their_bits_hold(kind: str) -> None:
    (element,) = fmi3(f"v {kind}").find("v")
    lower, upper = RANGES[kind]
    assert element.kind == "integer"
    assert [element.value(number) for number in (lower, upper, 0, 1.0)] == [lower, upper, 0, 1]
    assert not any(
        fits(element, n) for n in (lower - 1, upper + 1, float(2 * upper), 0.5, "1", b"1", None, float("inf"))
    )


def fits(element: Element, value: object) -> bool:
    try:
        element.value(value)
    except ArgumentError:
        return False
    return True


@pytest.mark.parametrize("kind", ["Integer", "Enumeration declaredType=Mode"])
def test_integers_and_enumerations_of_fmi_2_have_32_bits(kind: str) -> None:
    (element,) = Ports("c", fmi2(f"v input {kind}")).find("v")
    assert element.kind == kind.partition(" ")[0].lower()
    if element.kind == "integer":  # an enumeration has its items
        assert all(fits(element, number) for number in (-2147483648.0, 2147483647.0, 0.0))
    assert not any(fits(element, number) for number in (-2147483649.0, 2147483648.0, 1.5))


def test_reals_hold_any_number_and_booleans_two() -> None:
    ports = Ports("c", fmi2("r input Real", "b input Boolean"))
    (real,), (boolean,) = ports.find("r"), ports.find("b")
    assert all(fits(real, number) for number in (-1e308, 0.5, 5e-324))
    assert [number for number in (-1.0, 0.0, 0.5, 1.0, 2.0) if fits(boolean, number)] == [0.0, 1.0]


def test_kinds_of_all_types_that_can_be_exchanged() -> None:
    kinds = {name: known.kind for name, known in FMI_TYPES.items()}
    others = {name: name.lower() for name in ("Boolean", "Enumeration", "String", "Binary", "Clock")}
    reals = dict.fromkeys(("Real", "Float64", "Float32"), "real")
    assert kinds == reals | dict.fromkeys((*RANGES, "Integer"), "integer") | others
    (clock,) = fmi3("s Clock").find("s")
    assert (clock.kind, clock.is_exchanged) == ("clock", False)


@pytest.mark.parametrize("source", RANGES)
@pytest.mark.parametrize("target", RANGES)
def test_a_link_between_integers_carries_what_both_types_hold(source: str, target: str) -> None:
    """A link that can't fail is a copy, unless one end alone is kept without a sign."""
    (a,), (b,) = fmi3(f"v {source}").find("v"), fmi3(f"v {target}").find("v")
    link = Link("a", a, "b", b, 1.0, 0.0)
    (smallest, largest), (lower, upper) = RANGES[source], RANGES[target]
    fits_always = lower <= smallest and largest <= upper
    assert link.converts == (not fits_always or [source, target].count("UInt64") == 1)
    for number in (smallest, largest, lower - 1, lower, 0, upper, upper + 1):
        assert link.carries(number) == (lower <= number <= upper)


@pytest.mark.parametrize(("target", "digits"), [("Float32", 24), ("Float64", 53)])
def test_a_link_carries_whole_numbers_that_are_exact_as_real_ones(target: str, digits: int) -> None:
    (a,), (b,) = fmi3("v Int64").find("v"), fmi3(f"v {target}").find("v")
    link = Link("a", a, "b", b, 1.0, 0.0)
    assert [link.carries(2**digits + n) for n in (-1, 0, 1, 2)] == [True, True, False, True]


@pytest.mark.parametrize(
    ("variable", "tunable"),
    [
        ("v parameter Real variability=tunable", True),
        ("v parameter Real variability=fixed", False),
        ("v calculatedParameter Real variability=tunable", False),
        ("v input Real variability=discrete", False),
    ],
)
def test_a_tunable_parameter_is_one_that_may_be_set_in_a_run(variable: str, tunable: bool) -> None:
    (element,) = Ports("c", fmi2(variable)).find("v")
    assert element.is_tunable is tunable


# Names


def names(ports: Ports, name: str) -> list[str]:
    return [element.name for element in ports.find(name)]


def test_elements_of_arrays_of_fmi_3_are_counted_from_1_row_by_row() -> None:
    ports = fmi3("m Float64 2 3", "s Float64", "v Float64 2")
    assert names(ports, "m") == ["m[1,1]", "m[1,2]", "m[1,3]", "m[2,1]", "m[2,2]", "m[2,3]"]
    assert [element.offset for element in ports.find("m")] == [0, 1, 2, 3, 4, 5]
    assert names(ports, "v") == ["v[1]", "v[2]"]
    assert (names(ports, "s"), ports.find("s")[0].offset) == (["s"], 0)
    assert names(ports, "m[2,1]") == ["m[2,1]"]
    assert [element.name for element in ports.all_elements()][5:] == ["m[2,3]", "s", "v[1]", "v[2]"]
    assert [variable.name for variable in variables_of(ports.all_elements())] == ["m", "s", "v"]
    for missing in ("m[0,1]", "m[1]", "v[3]", "v[0]", "s[1]"):
        with pytest.raises(SetupError, match="has no variable"):
            ports.find(missing)


def test_vectors_of_fmi_2_are_in_the_order_of_their_indices() -> None:
    ports = Ports("c", fmi2("v[10] input Real", "v[2] input Real", "w[2,1] input Real", "v[1] input Real",
                            "w[1,2] input Real", "x[a] input Real", "y.z[1] input Real"))  # fmt: skip
    assert names(ports, "v") == ["v[1]", "v[2]", "v[10]"]
    assert names(ports, "w") == ["w[1,2]", "w[2,1]"]
    assert names(ports, "x[a]") == ["x[a]"]
    assert names(ports, "y.z") == ["y.z[1]"]
    with pytest.raises(SetupError, match="has no variable 'x'"):
        ports.find("x")


def test_elements_by_causality_are_in_the_order_of_the_description() -> None:
    ports = Ports("c", fmi2("b input Real", "p parameter Real", "y output Real", "a input Real"))
    assert [element.name for element in ports.of_causality("input")] == ["b", "a"]
    assert [element.name for element in ports.of_causality("output")] == ["y"]
    assert ports.description_of("p").causality == "parameter"


def test_undeclared_dependencies_are_on_all_inputs() -> None:
    variables = "u input Real", "p parameter Real", "v input Real", "y output Real", "z output Real"
    assert Ports("c", fmi2(*variables)).feedthrough == {"y": set(), "z": set()}
    assert Ports("c", fmi2(*variables, feedthrough=True)).feedthrough == {"y": {"u", "v"}, "z": {"u", "v"}}


# Systems


def test_a_connection_is_as_it_stands_unless_told() -> None:
    system = System()
    system.connect("a.y", "b.u")
    assert system.connections == [Connection("a.y", "b.u")] == [Connection("a.y", "b.u", 1.0, 0.0, "equal")]


def test_signals_are_sums_only_where_they_disturb() -> None:
    system = System()
    system.drive("a.u", abs)
    system.disturb("a.v", abs, breakpoints=[1], vectorized=True)
    drive, disturbance = system.signals
    assert (drive.target, drive.breakpoints, drive.vectorized, drive.added) == ("a.u", (), False, False)
    assert (disturbance.target, disturbance.breakpoints) == ("a.v", (1.0,))
    assert (disturbance.vectorized, disturbance.added) == (True, True)


def test_a_component_takes_part_in_every_step_and_has_no_start_values_unless_told() -> None:
    system, start = System(), {"k": 1.0}
    system.add("a", "a.fmu")
    system.add("b", "b.fmu", start, 3)
    assert (system.components["a"].every, system.components["a"].start) == (1, {})
    start["k"] = 2.0
    assert (system.components["b"].every, system.components["b"].start) == (3, {"k": 1.0})


# Large arrays


def _array(n: int) -> ModelVariable:
    return ModelVariable(name="a", valueReference=1, type="Float64", causality="input", shape=(n // 10, 10))


def test_a_large_array_has_its_elements_without_making_them() -> None:
    """An object for each would take minutes, and more memory than there is."""
    array = ElementArray(_array(10**12))
    assert len(array) == 10**12
    assert [array[k].name for k in (0, 11, -1)] == ["a[1,1]", "a[2,2]", "a[100000000000,10]"]
    assert [(e.name, e.offset) for e in array[8:11]] == [("a[1,9]", 8), ("a[1,10]", 9), ("a[2,1]", 10)]
    found = array.element("a[99999999999,3]")
    assert found is not None
    assert (found.name, found.offset) == ("a[99999999999,3]", 10 * (99999999999 - 1) + 2)
    for name in ("a[1]", "a[0,1]", "a[1,11]", "a[01,1]", "a[1,1,1]"):
        assert array.element(name) is None
    with pytest.raises(IndexError):
        array[10**12]


def test_names_of_arrays_and_their_elements_are_found() -> None:
    description = ModelDescription(fmiVersion="3.0", modelVariables=[_array(10**6)])
    ports = Ports("c", description)
    assert len(ports.find("a")) == 10**6
    assert [e.name for e in ports.find("a[7,3]")] == ["a[7,3]"]
    with pytest.raises(SetupError, match=r"component 'c' has no variable 'a\[7,11\]'"):
        ports.find("a[7,11]")
    description.modelVariables[0].shape = (10**5, 10**5)
    with pytest.raises(SetupError, match=r"'c\.a' has 100000 x 100000 elements, more than can be read"):
        Ports("c", description)


def test_a_name_that_two_variables_have_is_refused_where_it_is_used() -> None:
    twice = [ModelVariable(name="x", valueReference=k, type="Real", causality="local") for k in (1, 2)]
    ports = Ports("c", ModelDescription(fmiVersion="2.0", modelVariables=twice))
    with pytest.raises(SetupError, match=r"'c\.x' is the name of several variables"):
        ports.find("x")
