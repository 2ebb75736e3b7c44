"""Values of parameter sets on their way: conversion, mapping and arrays, each worked out on paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim import CosimError, simulate
from cosim.ssp.errors import SSPError
from cosim.ssp.format.values import Value
from tests.support.small_fmus import compiled, redescribed
from tests.support.ssp_files import (
    archive,
    binding,
    bindings,
    component,
    connection,
    connections,
    connectors,
    description,
    elements,
    entry,
    linear,
    mapping,
    parameter_set,
    read,
    start,
)
from tests.support.tiny_models import INTEGRATOR, UNITS
from tests.support.tiny_models import build as build_tiny

#: In SSP files, by name: what a number in the unit is in K.
TEMPERATURES = """
<ssc:Unit name="degC"><ssc:BaseUnit K="1" offset="273.15"/></ssc:Unit>
<ssc:Unit name="degF"><ssc:BaseUnit K="1" factor="0.5" offset="200.0"/></ssc:Unit>
<ssc:Unit name="mK"><ssc:BaseUnit K="1" factor="0.001"/></ssc:Unit>
"""  # degF: an easier one, of which 100 are 250 K


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """An FMU whose input `length` is a temperature in K: absolute, or a difference."""
    folder = build_tiny(tmp_path_factory.mktemp("values"), UNITS, INTEGRATOR)
    kelvin = {'<BaseUnit m="1"': '<BaseUnit K="1"'}
    difference = '<TypeDefinitions><SimpleType name="D"><Real unit="m" relativeQuantity="true"/></SimpleType>'
    relative = {'<Real unit="m"': '<Real declaredType="D"'}
    types = {"</UnitDefinitions>": f"</UnitDefinitions>{difference}</TypeDefinitions>"}
    return {
        "absolute": redescribed(folder / "Units.fmu", folder / "absolute.fmu", kelvin),
        "relative": redescribed(folder / "Units.fmu", folder / "relative.fmu", {**kelvin, **relative, **types}),
        "integrator": folder / "Integrator.fmu",
    }


def with_temperatures(text: str) -> str:
    """The same, with their units defined wherever units are; those of the tests' own files are of lengths."""
    assert "</ssv:Units>" in text or "</ssd:Units>" in text
    for end in ("</ssv:Units>", "</ssd:Units>"):
        text = text.replace(end, TEMPERATURES + end)
    return text


def given(tmp_path: Path, fmus: dict[str, Path], kind: str, bound: str, **files: str) -> float:
    """Start value of the temperature by a binding of its component."""
    system = with_temperatures(description(elements(component("c", kind, bindings=bindings(bound)))))
    return start(archive(tmp_path / "v.ssp", system, fmus, **files))["c.length"]


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        ("absolute", "20.0 degC", 293.15),
        ("absolute", "100.0 degF", 250.0),
        ("absolute", "-40.0 degF", 180.0),
        ("absolute", "1500.0 mK", 1.5),
        ("relative", "20.0 degC", 20.0),
        ("relative", "100.0 degF", 50.0),
        ("relative", "1500.0 mK", 1.5),
        ("absolute", "7.0", 7.0),  # a number without a unit is one of the variable's
        ("relative", "7.0", 7.0),
    ],
)
def test_units_with_factor_and_offset(
    fmus: dict[str, Path], tmp_path: Path, kind: str, value: str, expected: float
) -> None:
    assert given(tmp_path, fmus, kind, binding(f"length Real {value}")) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("kind", "inner", "more", "expected"),
    [
        # converted first: 100 degF are 250 K, or a difference of 50 K
        ("absolute", linear(3, -1), "", 749.0),
        ("relative", linear(3, -1), "", 149.0),
        ("absolute", linear(3, -1), ' suppressUnitConversion="true"', 299.0),
        ("absolute", linear(3), "", 750.0),
        ("absolute", linear(1, 10), "", 260.0),
        ("absolute", "", ' suppressUnitConversion="true"', 100.0),
        ("absolute", "", ' suppressUnitConversion="false"', 250.0),
    ],
)
def test_mapped_values_are_converted_then_transformed(
    fmus: dict[str, Path], tmp_path: Path, kind: str, inner: str, more: str, expected: float
) -> None:
    bound = binding("t Real 100.0 degF", mapped=mapping(entry("t", "length", inner, more)))
    assert given(tmp_path, fmus, kind, bound) == pytest.approx(expected, rel=1e-14)


def test_a_unit_without_a_definition_is_known_by_its_name_only(fmus: dict[str, Path], tmp_path: Path) -> None:
    assert given(tmp_path, fmus, "absolute", binding("length Real 3.0 furlong")) == 3.0
    (note,) = read(tmp_path / "v.ssp").notes
    assert note.endswith("unit 'furlong' of the value of 'c.length' is not defined; it is taken in 'm'")
    # the FMU's unit has this name, whatever the set says of it
    assert given(tmp_path, fmus, "absolute", binding("length Real 3.0 m")) == 3.0
    undefined = parameter_set("length Real 3.0 m")
    undefined = undefined[: undefined.index("<ssv:Units>")] + "</ssv:ParameterSet>"
    reference = binding(more=' source="resources/u.ssv"')
    assert given(tmp_path, fmus, "absolute", reference, u_ssv=undefined) == 3.0
    furlong = undefined.replace('unit="m"', 'unit="furlong"')
    assert given(tmp_path, fmus, "absolute", reference, u_ssv=furlong) == 3.0
    (note,) = read(tmp_path / "v.ssp").notes
    assert note.startswith(f"{tmp_path}/v.ssp: resources/u.ssv: unit 'furlong'")


def test_connectors_of_systems_convert_by_what_they_feed(fmus: dict[str, Path], tmp_path: Path) -> None:
    """20 degC at a connector in degC, whose number goes to one variable twice as large."""
    for kind, expected in (("absolute", 2 * 293.15), ("relative", 2 * 20.0)):
        inner = connectors("input in degC") + elements(component("c", kind, "input length"))
        sub = f'<ssd:System name="s">{inner}{connections(connection(".in", "c.length", linear(2)))}</ssd:System>'
        text = with_temperatures(description(bindings(binding("s.in Real 20.0")) + elements(sub)))
        assert start(archive(tmp_path / f"{kind}.ssp", text, fmus))["s/c.length"] == pytest.approx(expected, rel=1e-14)
        text = text.replace('<ssv:Real value="20.0"/>', '<ssv:Real value="180.0" unit="degF"/>')  # 290 K, or 90 K
        found = start(archive(tmp_path / f"{kind}_F.ssp", text, fmus))["s/c.length"]
        assert found == pytest.approx(2 * (290.0 if kind == "absolute" else 90.0), rel=1e-14)


# Tables


def table(kind: str, *pairs: tuple[Any, Any]) -> str:
    entries = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in pairs)
    return f"<ssc:{kind}MappingTransformation>{entries}</ssc:{kind}MappingTransformation>"


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {"probe": compiled(tmp_path_factory.mktemp("probe"), "fmi2_probe")}


def mapped(tmp_path: Path, probe: dict[str, Path], value: str, inner: str, name: str = "n") -> Any:
    """Start value of a variable of the probe by a mapping."""
    bound = bindings(binding(value, mapped=mapping(entry("x", name, inner))))
    path = archive(tmp_path / "t.ssp", description(elements(component("p", "probe", bindings=bound))), probe)
    return start(path)[f"p.{name}"]


@pytest.mark.parametrize(("number", "expected"), [(3, 4), (4, 3), (5, 5), (-3, -3)])
def test_numbers_that_a_table_lacks_stay(probe: dict[str, Path], tmp_path: Path, number: int, expected: int) -> None:
    assert mapped(tmp_path, probe, f"x Integer {number}", table("Integer", (3, 4), (4, 3))) == expected


@pytest.mark.parametrize(
    ("value", "pairs", "expected"),
    [
        ("true", [("true", "false")], False),
        ("false", [("true", "false")], False),
        ("true", [("true", "false"), ("false", "true")], False),
        ("false", [("true", "false"), ("false", "true")], True),
        ("true", [("false", "true")], True),
    ],
)
def test_tables_of_booleans(
    probe: dict[str, Path], tmp_path: Path, value: str, pairs: list[tuple[str, str]], expected: bool
) -> None:
    assert mapped(tmp_path, probe, f"x Boolean {value}", table("Boolean", *pairs), "b") is expected


def test_texts_that_a_table_lacks_stay(probe: dict[str, Path], tmp_path: Path) -> None:
    items = table("Enumeration", ("an", "on"), ("off", "on"))
    assert mapped(tmp_path, probe, "x Enumeration an", items, "e") == 2.0
    assert mapped(tmp_path, probe, "x Enumeration off", items, "e") == 2.0
    assert mapped(tmp_path, probe, "x Enumeration on", items, "e") == 2.0
    with pytest.raises(SSPError, match=r"'p\.e' can't become 'aus'; known are: off, on$"):
        mapped(tmp_path, probe, "x Enumeration aus", items, "e")


def test_an_item_for_what_is_no_enumeration(probe: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(SSPError, match=r"'p\.n' can't become 'on'; it is not an enumeration$"):
        mapped(tmp_path, probe, "x Enumeration on", "")


@pytest.mark.parametrize(
    ("value", "name"), [("x Boolean true", "b"), ("x Enumeration on", "e"), ("x String text", "journal")]
)
def test_only_numbers_are_transformed_linearly(probe: dict[str, Path], tmp_path: Path, value: str, name: str) -> None:
    with pytest.raises(SSPError, match=r"'x' is not a number and can't be transformed linearly$"):
        mapped(tmp_path, probe, value, linear(2, 1), name)


def test_an_integer_is_transformed_linearly(probe: dict[str, Path], tmp_path: Path) -> None:
    assert mapped(tmp_path, probe, "x Integer 3", linear(2, 1)) == 7.0


# Arrays


def value_of(data: Any, **changes: Any) -> Value:
    return Value(
        "x", data, None, **{"item": False, "convert": True, "factor": 1.0, "offset": 0.0, **changes}, origin="o"
    )


@pytest.mark.parametrize(
    ("data", "size", "expected"),
    [
        ([1.0, 2.0, 3.0], 3, [[1.0], [2.0], [3.0]]),
        ([7.0], 3, [[7.0]] * 3),
        ([1.0, 2.0], 1, [[1.0, 2.0]]),  # of one variable, which is an array itself
        ([7.0], 1, [[7.0]]),
        ("text", 2, ["text", "text"]),
    ],
)
def test_elements_of_an_array(data: Any, size: int, expected: list[Any]) -> None:
    value = value_of(data, factor=2.0)
    found = value.split(size)
    assert [part.data for part in found] == expected
    assert all((part.name, part.factor, part.origin) == ("x", 2.0, "o") for part in found)


@pytest.mark.parametrize(("n", "size"), [(2, 3), (4, 3), (0, 2), (3, 2)])
def test_arrays_of_another_size(n: int, size: int) -> None:
    with pytest.raises(SSPError, match=f"^o: {n} values were given for 'x', which has {size}$"):
        value_of([1.0] * n).split(size)


def test_numbers_that_are_not_changed_keep_every_bit() -> None:
    third = 1.0 / 3.0
    assert repr(value_of([third, -0.0]).fit("v", None, {}, relative=False)) == repr([third, -0.0])
    assert value_of([1.0, 2.0], factor=3.0, offset=0.5).fit("v", None, {}, relative=False) == [3.5, 6.5]
    assert value_of([1.0], offset=0.5).fit("v", None, {}, relative=False) == [1.5]
    assert value_of([1.0], factor=3.0).fit("v", None, {}, relative=False) == [3.0]
    assert value_of("text").fit("v", None, {}, relative=False) == "text"
    assert value_of("on", item=True).fit("v", None, {"off": 1.0, "on": 2.0}, relative=False) == [2.0]


# Bindings


def test_every_entry_of_a_mapping_takes_what_it_names(fmus: dict[str, Path], tmp_path: Path) -> None:
    entries = mapping(entry("b", "length"), entry("a", "torque"), entry("none", "length"))
    bound = binding("a Real 1.0", "b Real 2.0", "length Real 9.0", mapped=entries)
    system = description(elements(component("c", "absolute", bindings=bindings(bound))))
    assert start(archive(tmp_path / "m.ssp", system, fmus)) == {"c.length": 2.0, "c.torque": 1.0}


@pytest.mark.parametrize("where", ["set", "mapping"])
def test_a_prefix_is_that_of_what_a_mapping_names(fmus: dict[str, Path], tmp_path: Path, where: str) -> None:
    source = "p.t" if where == "set" else "t"
    bound = binding("t Real 4.0", more=' prefix="p."', mapped=mapping(entry(source, "length")))
    system = description(elements(component("c", "absolute", bindings=bindings(bound))))
    found = start(archive(tmp_path / "p.ssp", system, fmus))
    assert found == ({"c.length": 4.0} if where == "set" else {})


@pytest.mark.parametrize(
    ("bound", "message"),
    [
        (
            '<ssd:ParameterBinding source="resources/v.ssv"><ssd:ParameterMapping/></ssd:ParameterBinding>',
            r"'c': a ParameterMapping has neither a source nor a ParameterMapping; give it one$",
        ),
        (
            '<ssd:ParameterBinding source="resources/v.ssv"><ssd:ParameterMapping type="text/csv"/>'
            "</ssd:ParameterBinding>",
            r"'c': parameters of type text/csv are not supported; use application/x-ssp-parameter-mapping$",
        ),
        (
            '<ssd:ParameterBinding type="text/csv" source="resources/v.ssv"/>',
            r"'c': parameters of type text/csv are not supported; use application/x-ssp-parameter-set$",
        ),
    ],
)
def test_bindings_that_are_none(fmus: dict[str, Path], tmp_path: Path, bound: str, message: str) -> None:
    with pytest.raises(SSPError, match=message):
        given(tmp_path, fmus, "absolute", bound, v_ssv=parameter_set("length Real 1.0"))


def test_a_system_has_no_files_of_a_component(fmus: dict[str, Path], tmp_path: Path) -> None:
    bound = bindings(binding(more=' source="resources/v.ssv" sourceBase="component"'))
    system = description(bound + elements(component("c", "absolute")))
    with pytest.raises(CosimError, match=r"the system: 'resources/v.ssv' is looked for in a component, .*sourceBase"):
        start(archive(tmp_path / "s.ssp", system, fmus))


def test_texts_and_binary_values_of_arrays(tmp_path: Path) -> None:
    """Of FMI 3.0 and SSP 2.0: one value, or an element for each."""
    types = {"types": compiled(tmp_path, "fmi3_types")}
    values = (
        '<ssv:Parameter name="words"><ssv:String><ssv:Value value="one"/><ssv:Value value="two 2"/></ssv:String>'
        '<ssc:Dimension size="2"/></ssv:Parameter>'
        '<ssv:Parameter name="String"><ssv:String value="text"/></ssv:Parameter>'
        '<ssv:Parameter name="Binary"><ssv:Binary value="0aFF"/></ssv:Parameter>'
    )
    text = parameter_set(version="2.0").replace("<ssv:Parameters>", f"<ssv:Parameters>{values}")
    names = ("words", "String", "Binary")
    system = elements(
        component("c", "types", bindings=bindings(binding(more=' source="resources/t.ssv"'))), component("d", "types")
    ) + connections(*[connection(f"c.{name}_out", f"d.{name}") for name in names])
    path = archive(tmp_path / "b.ssp", description(system, version="2.0"), types, t_ssv=text)
    found = start(path)
    assert (found["c.words"], found["c.String"], found["c.Binary"]) == (["one", "two 2"], "text", b"\x0a\xff")
    results = simulate(read(path).system, 1.0, 0.5)
    for component_ in "cd":  # also by way of connections
        assert results[f"{component_}.words_out[1]"].tolist() == ["one"] * 3
        assert results[f"{component_}.words_out[2]"].tolist() == ["two 2"] * 3
        assert results[f"{component_}.String_out"].tolist() == ["text"] * 3
        assert results[f"{component_}.Binary_out"].tolist() == [b"\x0a\xff"] * 3


# Connectors of systems


def handed_down(
    tmp_path: Path, fmus: dict[str, Path], connector: str, value: str, first: str, second: str = ""
) -> float:
    """A value at a connector of a system, through one of a system in it, to an absolute temperature in K."""
    inner = connectors("input in") + elements(component("c", "absolute", "input length"))
    sub = f'<ssd:System name="s">{inner}{connections(connection(".in", "c.length", "", second))}</ssd:System>'
    outer = connectors(f"input out {connector}".strip()) + bindings(binding(f"out Real {value}")) + elements(sub)
    text = with_temperatures(description(outer + connections(connection(".out", "s.in", "", first))))
    return start(archive(tmp_path / "h.ssp", text, fmus))["s/c.length"]


AS_IT_IS = ' suppressUnitConversion="true"'


@pytest.mark.parametrize(
    ("connector", "value", "first", "second", "expected"),
    [
        # a connector without a unit has that of what it feeds
        ("", "20.0 degC", "", "", 293.15),
        ("", "20.0", "", "", 20.0),
        ("degC", "20.0", "", "", 293.15),
        ("degC", "100.0 degF", "", "", 250.0),
        # where that is told apart, it has none, and a number is taken as it is
        ("", "20.0 degC", AS_IT_IS, "", 20.0),
        ("", "20.0 degC", "", AS_IT_IS, 20.0),
        ("degC", "20.0", AS_IT_IS, "", 20.0),
        ("degC", "20.0", "", AS_IT_IS, 20.0),
    ],
)
def test_units_through_connectors_of_systems(
    fmus: dict[str, Path], tmp_path: Path, connector: str, value: str, first: str, second: str, expected: float
) -> None:
    assert handed_down(tmp_path, fmus, connector, value, first, second) == pytest.approx(expected, rel=1e-14)


def test_texts_go_through_connectors_of_systems_as_they_are(probe: dict[str, Path], tmp_path: Path) -> None:
    def system(inner: str) -> str:
        parts = elements(component("p", "probe", "parameter journal"))
        way = connections(connection(".in", "p.journal", inner))
        return description(connectors("parameter in") + bindings(binding("in String text")) + parts + way)

    assert start(archive(tmp_path / "s.ssp", system(""), probe))["p.journal"] == "text"
    with pytest.raises(SSPError, match=r"'in' is a text and can't be transformed on its way to 'p\.journal'$"):
        start(archive(tmp_path / "t.ssp", system(linear(2)), probe))
