"""SSPs written by hand, held against arithmetic and against systems coupled by hand."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim import CosimError, SetupError, System, simulate
from cosim.ssp.format import package
from tests.support.changed_fmus import in_millimetres
from tests.support.small_fmus import compiled
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
from tests.support.tiny_models import CLOCK, GAIN, INTEGRATOR
from tests.support.tiny_models import UNITS as LENGTHS
from tests.support.tiny_models import build as build_tiny


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Small FMUs by name: `m` passes a torque and a length on, `mm` is the same with its lengths in mm."""
    folder = build_tiny(tmp_path_factory.mktemp("ssp"), GAIN, INTEGRATOR, CLOCK, LENGTHS)
    mm = in_millimetres(folder / "Units.fmu", folder / "mm.fmu", 'factor="0.001"')
    return {"gain": folder / "Gain.fmu", "integrator": folder / "Integrator.fmu", "m": folder / "Units.fmu", "mm": mm}


def last(path: Path, name: str, **options: object) -> float:
    """Value of a variable at the end of a run of an SSP."""
    return float(simulate(read(path).system, 1.0, 0.5, **options)[name][-1])


# Structure


LOOP = elements(
    component("gain", "gain", "input u[1]", "input u[2]", "output y[1]", bindings=bindings(binding("K Real -0.5"))),
    '<ssd:System name="outer">'
    + connectors("input rate", "output level")
    + elements(
        '<ssd:System name="inner">'
        + connectors("input u", "output x")
        + elements(component("tank", "integrator", "input u", "output x"))
        + connections(connection(".u", "tank.u"), connection(".x", "tank.x"))  # written from the target to the source
        + "</ssd:System>"
    )
    + connections(connection(".rate", "inner.u"), connection("inner.x", ".level"))
    + "</ssd:System>",
) + connections(connection("gain.y[1]", "outer.rate"), connection("gain.u[1]", "outer.level"))


def test_nested_systems_are_what_they_hold(fmus: dict[str, Path], tmp_path: Path) -> None:
    values = binding("outer.inner.tank.x_start Real 2.0", "gain.u[2] Real 7.0")
    path = archive(tmp_path / "loop.ssp", description(bindings(values) + LOOP), fmus)
    by_hand = System()
    by_hand.add("gain", fmus["gain"], start={"K": -0.5, "u[2]": 7.0})
    by_hand.add("outer/inner/tank", fmus["integrator"], start={"x_start": 2.0})
    by_hand.connect("gain.y[1]", "outer/inner/tank.u")
    by_hand.connect("outer/inner/tank.x", "gain.u[1]")
    found = read(path)
    assert (found.name, found.start_time, found.stop_time, found.notes) == ("by hand", 0.0, 1.0, ())
    results, expected = (simulate(s, 1.0, 0.01) for s in (found.system, by_hand))
    assert results.names == expected.names
    assert results.values.tobytes() == expected.values.tobytes()
    # x' = -x / 2; a held input makes it first order in the step
    assert results["outer/inner/tank.x"][-1] == pytest.approx(2.0 * np.exp(-0.5), rel=0.01)


def test_the_same_fmu_twice_is_unpacked_once(fmus: dict[str, Path], tmp_path: Path) -> None:
    path = archive(
        tmp_path / "two.ssp",
        description(elements(component("a", "gain", "output y[1]"), component("b.c", "gain", "input u[1]"))),
        fmus,
    )
    system = read(path).system
    assert set(system.components) == {"a", "b/c"}
    assert len({c.fmu for c in system.components.values()}) == 1
    assert system.components["b/c"].start == {}  # inputs keep the value of the FMU


# Units and transformations


def through(
    first: str = "", second: str = "", *, unit: str = "mm", target: str = "m", more: tuple[str, str] = ("", "")
) -> str:
    """A length of 2 m from a component to another, through the connector of a system; its unit may be given."""
    inner = elements(component("b", target, "input length")) + connections(
        connection(".in", "b.length", second, more[1])
    )
    sub = f'<ssd:System name="sub">{connectors(f"input in {unit}".strip())}{inner}</ssd:System>'
    a = component("a", "m", "output place", bindings=bindings(binding("length Real 2.0")))
    return description(elements(a, sub) + connections(connection("a.place", "sub.in", first, more[0])))


@pytest.mark.parametrize(
    ("system", "expected"),
    [
        (through(), 2.0),
        (through(unit=""), 2.0),
        (through(target="mm"), 2000.0),
        (through(target="mm", unit="m"), 2000.0),
        (through(target="mm", unit=""), 2000.0),
        # the number is converted first, then transformed in the unit of the target
        (through(linear(2, 1)), (2 * 2000.0 + 1) / 1000),
        (through(linear(2, 1), linear(3, -0.5)), 3 * (2 * 2000.0 + 1) / 1000 - 0.5),
        (through(second=linear(3, -0.5), target="mm"), 3 * 2000.0 - 0.5),
        # without conversion it is taken as it is
        (through(more=(' suppressUnitConversion="true"', "")), 2.0 / 1000),
        (through(linear(5), more=(' suppressUnitConversion="1"', "")), 10.0 / 1000),
        (through(more=("", ' suppressUnitConversion="true"')), 2000.0),
        (through(unit="", target="mm", more=("", ' suppressUnitConversion="true"')), 2.0),
        (through(unit="", target="mm", more=(' suppressUnitConversion="true"', "")), 2.0),
        (through(unit="N.m", more=(' suppressUnitConversion="true"',) * 2), 2.0),
    ],
)
def test_units_and_transformations(fmus: dict[str, Path], tmp_path: Path, system: str, expected: float) -> None:
    path = archive(tmp_path / "chain.ssp", system, fmus)
    assert last(path, "sub/b.length") == pytest.approx(expected, rel=1e-14)


def test_equal_units_change_no_bit(fmus: dict[str, Path], tmp_path: Path) -> None:
    system = read(archive(tmp_path / "chain.ssp", through(unit="m"), fmus)).system
    assert [(c.factor, c.offset) for c in system.connections] == [(1.0, 0.0)]


# Parameters


def parametrized(tmp_path: Path, fmus: dict[str, Path], at_system: str, at_component: str = "", **files: str) -> Path:
    system = elements(component("g", "gain", "input u[1]", bindings=at_component), component("l", "m"))
    return archive(tmp_path / "p.ssp", description(at_system + system), fmus, **files)


def test_later_bindings_and_higher_levels_take_precedence(fmus: dict[str, Path], tmp_path: Path) -> None:
    low = bindings(binding("K Real 1.0"), binding(more=' source="resources/k.ssv"'))
    file = {"k_ssv": parameter_set("K Real 2.0", "u[2] Real 9.0")}
    path = parametrized(tmp_path, fmus, "", low, **file)
    assert start(path)["g.K"] == 2.0
    high = bindings(binding("g.K Real 3.0"), binding("K Real 4.0", more=' prefix="g."'))
    values = start(parametrized(tmp_path, fmus, high, low, **file))
    assert (values["g.K"], values["g.u[2]"]) == (4.0, 9.0)
    results = simulate(read(path).system, 1.0, 0.5)
    assert results["g.y[2]"].tolist() == [36.0] * 3


def test_values_are_converted_and_mapped(fmus: dict[str, Path], tmp_path: Path) -> None:
    entries = mapping(
        entry("s.a", "g.u[1]", linear(2, 1)),
        entry("s.a", "g.u[2]"),
        entry("s.b", "l.length", linear(3, 0.5)),
        entry("absent", "g.K"),
    )
    values = ("a Real 5.0", "b Real 250.0 mm", "K Real 8.0")
    high = bindings(binding(*values, more=' prefix="s."', mapped=entries))
    found = start(parametrized(tmp_path, fmus, high))
    assert found == {"g.u[1]": 11.0, "g.u[2]": 5.0, "l.length": 3 * 0.25 + 0.5}
    # by files, without conversion
    entries = mapping(entry("b", "length", linear(3, 0.5), ' suppressUnitConversion="true"'))
    mapped = '<ssd:ParameterMapping source="resources/m.ssm"/>'
    reference = bindings(f'<ssd:ParameterBinding source="resources/v.ssv">{mapped}</ssd:ParameterBinding>')
    system = elements(component("l", "m", bindings=reference))
    files = {"v_ssv": parameter_set(*values), "m_ssm": entries}
    path = archive(tmp_path / "m.ssp", description(system), fmus, **files)
    assert start(path)["l.length"] == 750.5


def test_a_connector_of_a_system_hands_its_value_down(fmus: dict[str, Path], tmp_path: Path) -> None:
    inner = (
        connectors("input in", "parameter start mm")
        + elements(component("l", "m", "input length", bindings=bindings(binding("length Real 9.0"))))
        + connections(connection(".in", "l.length", linear(2)))
    )
    tank = component("t", "integrator", "parameter x_start")
    sub = f'<ssd:System name="sub">{inner}</ssd:System>'
    outer = (
        connectors("input x mm", "parameter x0")
        + bindings(binding("x Real 3000.0", "x0 Real 7.0"))
        + elements(sub, tank)
        + connections(connection(".x", "sub.in"), connection(".x0", "t.x_start", linear(10)))
    )
    found = start(archive(tmp_path / "c.ssp", description(outer), fmus))
    assert (found["sub/l.length"], found["t.x_start"]) == (6.0, 70.0)
    # no value there: the component's own holds
    bare = description(outer.replace(bindings(binding("x Real 3000.0", "x0 Real 7.0")), ""))
    assert start(archive(tmp_path / "d.ssp", bare, fmus)) == {"sub/l.length": 9.0}


def test_parameters_that_match_nothing_are_ignored_with_a_note(fmus: dict[str, Path], tmp_path: Path) -> None:
    found = read(parametrized(tmp_path, fmus, bindings(binding("g.KK Real 1.0")), bindings(binding("Kp Real 2.0"))))
    here = f"{tmp_path}/p.ssp: SystemStructure.ssd"
    assert found.notes == (
        f"{here}: 'g': nothing is named 'Kp', which is ignored; did you mean 'K'?",
        f"{here}: the system: nothing is named 'g.KK', which is ignored; did you mean 'g.K'?",
    )
    assert "g.K" not in {f"g.{n}" for n in found.system.components["g"].start}


def test_values_of_all_types(tmp_path: Path, plain_path: Path) -> None:
    probe = {"probe": compiled(tmp_path, "fmi2_probe")}
    table = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in ((3, 4), (5, 6)))
    entries = mapping(
        entry("n", "n", f"<ssc:IntegerMappingTransformation>{table}</ssc:IntegerMappingTransformation>"),
        entry(
            "b",
            "b",
            "<ssc:BooleanMappingTransformation>"
            '<ssc:MapEntry source="false" target="true"/></ssc:BooleanMappingTransformation>',
        ),
        entry(
            "e",
            "e",
            "<ssc:EnumerationMappingTransformation>"
            '<ssc:MapEntry source="an" target="on"/></ssc:EnumerationMappingTransformation>',
        ),
        entry("journal", "journal"),
    )
    journal = str(plain_path / "x.txt")  # the FMU writes it
    values = ("n Integer 3", "b Boolean false", "e Enumeration an", f"journal String {journal}")
    bound = bindings(binding(*values, mapped=entries), binding("status Integer 2"))
    system = elements(component("p", "probe", bindings=bound))
    path = archive(tmp_path / "t.ssp", description(system), probe)
    assert start(path) == {"p.n": 4, "p.e": 2.0, "p.b": True, "p.status": 2, "p.journal": journal}
    results = simulate(read(path).system, 1.0, 0.5)
    assert [results[f"p.{n}_out"][-1] for n in "neb"] == [4.0, 2.0, 1.0]
    wrong = system.replace('target="on"', 'target="broken"')
    with pytest.raises(CosimError, match=r"'p.e' can't become 'broken'; known are: off, on$"):
        read(archive(tmp_path / "t.ssp", description(wrong), probe))


def test_arrays_of_ssp_2_and_fmi_3(tmp_path: Path) -> None:
    array = {"types": compiled(tmp_path, "fmi3_types")}

    def connector(kind: str, name: str) -> str:
        inner = '<ssc:Float64/><ssc:Dimension size="2"/>'
        return f'<ssd:Connectors><ssd:Connector kind="{kind}" name="{name}">{inner}</ssd:Connector></ssd:Connectors>'

    value = '<ssv:Parameter name="Float64"><ssv:Float64 value="1.5 2.5"/><ssc:Dimension size="2"/></ssv:Parameter>'
    bound = parameter_set(version="2.0").replace("<ssv:Parameters>", f"<ssv:Parameters>{value}")
    a = component("a", "types").replace(
        "></ssd:Component>",
        f'>{connector("output", "Float64_out")}<ssd:ParameterBindings><ssd:ParameterBinding source="resources/v.ssv"/>'
        "</ssd:ParameterBindings></ssd:Component>",
    )
    b = component("b", "types").replace("></ssd:Component>", f">{connector('input', 'Float64')}</ssd:Component>")
    down = connections(connection(".in", "b.Float64", linear(2)))
    sub = f'<ssd:System name="sub">{connector("input", "in")}{elements(b)}{down}</ssd:System>'
    system = elements(a, sub) + connections(connection("a.Float64_out", "sub.in"))
    path = archive(tmp_path / "a.ssp", description(system, version="2.0"), array, v_ssv=bound)
    results = simulate(read(path).system, 1.0, 0.5)
    assert results["sub/b.Float64"][-1].tolist() == [3.0, 5.0]
    # an array of a connector of a system goes to what that is connected to
    cut = system.replace(connections(connection("a.Float64_out", "sub.in")), "")
    given = bindings('<ssd:ParameterBinding source="resources/v.ssv" prefix="sub."/>') + cut
    values = bound.replace('name="Float64"', 'name="in"')
    path = archive(tmp_path / "b.ssp", description(given, version="2.0"), array, v_ssv=values)
    found = start(path)
    assert [found[f"sub/b.Float64[{i}]"] for i in (1, 2)] == [3.0, 5.0]
    three = values.replace("1.5 2.5", "1 2 3")
    with pytest.raises(CosimError, match=r"3 values were given for 'sub\.in', which has 2$"):
        start(archive(path, description(given, version="2.0"), array, v_ssv=three))
    large = given.replace(
        '"in"><ssc:Float64/><ssc:Dimension size="2"', '"in"><ssc:Float64/><ssc:Dimension size="20000000"'
    )
    with pytest.raises(CosimError, match="connector 'in' has 20000000 values, more than any system needs"):
        start(archive(path, description(large, version="2.0"), array, v_ssv=values))
    indexed = system.replace('startConnector="Float64_out"', 'startConnector="Float64_out" startIndices="1"')
    with pytest.raises(CosimError, match="takes elements of an array by indices, which is not supported"):
        read(archive(tmp_path / "i.ssp", description(indexed, version="2.0"), array, v_ssv=bound))


# Times


def step_of(tmp_path: Path, fmus: dict[str, Path], experiment: str) -> float | None:
    system = elements(component("g", "gain"))
    return read(archive(tmp_path / "s.ssp", description(system, experiment=experiment), fmus)).step_size


def test_the_step_is_that_of_an_annotation_or_of_the_fmus(fmus: dict[str, Path], tmp_path: Path) -> None:
    annotated = (
        '<ssd:DefaultExperiment stopTime="2"><ssd:Annotations><ssc:Annotation type="com.opensimulationplatform">'
        '<Algorithm xmlns="x"><FixedStepAlgorithm baseStepSize="0.25"/></Algorithm></ssc:Annotation></ssd:Annotations>'
        "</ssd:DefaultExperiment>"
    )
    assert step_of(tmp_path, fmus, annotated) == 0.25
    assert step_of(tmp_path, fmus, "") == 0.1  # of the FMU
    with pytest.raises(CosimError, match=r"the step size 'fast' in an annotation is not a number$"):
        step_of(tmp_path, fmus, annotated.replace("0.25", "fast"))


# What is refused


GAIN_A = component("a", "gain", "input u[1]", "output y[1]")
REFUSED = {
    r"connection 'a.y\[1\]' -> 'a.u\[3\]': element 'a' has no connector 'u\[3\]'; did you mean 'u\[1\]'\?": elements(
        GAIN_A
    )
    + connections(connection("a.y[1]", "a.u[3]")),
    r"there is no element 'aa'; did you mean 'a'\?": elements(GAIN_A) + connections(connection("a.y[1]", "aa.u[1]")),
    r"the system has no connector 'q'; there are none": elements(GAIN_A) + connections(connection("a.y[1]", ".q")),
    r"the system can't connect output and output; one end must give values, the other take them": elements(GAIN_A)
    + connections(connection("a.y[1]", "a.y[1]")),
    r"'u\[1\]' is fed by another connection too; remove one of them": elements(GAIN_A)
    + connections(connection("a.y[1]", "a.u[1]"), connection("a.u[1]", "a.y[1]")),
    r"maps values of type Real; only truth values and whole numbers can be": elements(GAIN_A)
    + connections(
        connection(
            "a.y[1]",
            "a.u[1]",
            '<ssc:IntegerMappingTransformation><ssc:MapEntry source="1" target="2"/>'
            "</ssc:IntegerMappingTransformation>",
        )
    ),
    r"component 'a': the FMU has no variable for connector 'w'; known are": elements(component("a", "gain", "input w")),
    r"connector 'y\[1\]' is of kind input, but the variable of the FMU is output; correct it": elements(
        component("a", "gain", "input y[1]")
    ),
    r"connector 'length' is in 'mm', but the FMU in 'm'": elements(component("a", "m", "input length mm")),
    r"units 'N.m' and 'm' don't match; .*, or set suppressUnitConversion": connectors("input x N.m")
    + bindings(binding("x Real 1.0"))
    + elements(component("a", "m", "input length"))
    + connections(connection(".x", "a.length")),
    r"value of 'a.length': units 'N.m' and 'm' don't match": elements(
        component("a", "m", bindings=bindings(binding("length Real 1.0 N.m")))
    ),
    r"has no 'resources/gian.fmu'; did you mean 'resources/gain.fmu'\?": elements(component("a", "gian")),
    r"'resources/../../gain.fmu' is not a file of this archive": elements(component("a", "../../gain")),
    r"component 'a' is of type text/x-modelica, which is not supported; use an FMU": elements(
        component("a", "gain", more=' type="text/x-modelica; path=A.B"')
    ),
    r"component 'a' is meant for ScheduledExecution": elements(
        component("a", "gain", more=' implementation="ScheduledExecution"')
    ),
    r"'d' refers to a signal dictionary 'e', which does not exist; there are none": elements(
        '<ssd:SignalDictionaryReference name="d" dictionary="e"/>'
    ),
    r"there are two elements named 'a'": elements(GAIN_A, GAIN_A),
    r"there are two elements named 'a/b'": elements(
        '<ssd:System name="a.b"/>', f'<ssd:System name="a">{elements(component("b", "gain"))}</ssd:System>'
    ),
    r"violates the SSP schema at SystemStructureDescription/System/Elements/Component/Connectors/Connector: attribute "
    r"kind='outpt': value must be one of": elements(component("a", "gain", "outpt y[1]")),
    r"violates the SSP schema at .*/Real: attribute value='x'": elements(
        component("a", "gain", bindings=bindings(binding("K Real x")))
    ),
    r"a ParameterBinding has neither a source nor a ParameterSet": elements(
        component("a", "gain", bindings=bindings(binding()))
    ),
    r"parameters of type text/csv are not supported": elements(
        component("a", "gain", bindings=bindings(binding("K Real 1", more=' type="text/csv"')))
    ),
    r"connections of systems lead back to": elements(
        '<ssd:System name="s">'
        + connectors("input i", "output o")
        + connections(connection(".i", ".o"))
        + "</ssd:System>",
        GAIN_A,
        component("b", "gain", "input u[1]"),
    )
    + connections(connection("s.o", "s.i"), connection("s.o", "b.u[1]")),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_can_not_be_run_is_refused_in_one_line(fmus: dict[str, Path], tmp_path: Path, message: str) -> None:
    path = archive(tmp_path / "r.ssp", description(REFUSED[message]), fmus)
    with pytest.raises(CosimError, match=message) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert not (tmp_path.parent / "gain.fmu").exists()


@pytest.mark.parametrize("value", ["NaN", "INF", "99.0"])
def test_numbers_that_no_parameter_takes(fmus: dict[str, Path], tmp_path: Path, value: str) -> None:
    system = read(parametrized(tmp_path, fmus, bindings(binding(f"g.K Real {value}")))).system
    with pytest.raises(
        SetupError, match=r"start value of 'g.K': (nan|inf|99.0) is (not a finite number|out of bounds)"
    ):
        simulate(system, 1.0, 0.5)


def test_archives_that_are_none(fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: Path, message: str) -> None:
        with pytest.raises(CosimError, match=message):
            read(path)

    refused(tmp_path / "none.ssp", "there is no such SSP; check the path")
    (tmp_path / "text.ssp").write_text("no archive")
    refused(tmp_path / "text.ssp", "is a text, not an SSP .*; cosim run takes")
    with zipfile.ZipFile(tmp_path / "empty.ssp", "w") as out:
        out.writestr("SystemStructure.xml", "")
    refused(tmp_path / "empty.ssp", "has no 'SystemStructure.ssd'; did you mean 'SystemStructure.xml'")
    good = description(elements(component("a", "gain")))
    refused(archive(tmp_path / "x.ssp", "no XML"), "not readable as XML")
    entities = good.replace("?>", '?><!DOCTYPE a [<!ENTITY b "c">]>', 1)
    refused(archive(tmp_path / "e.ssp", entities, fmus), "Entities are forbidden")
    draft = good.replace("http://ssp-standard.org/SSP1/SystemStructureDescription", "urn:draft")
    refused(
        archive(tmp_path / "draft.ssp", draft, fmus), "root element has the namespace 'urn:draft', as in drafts of SSP"
    )
    without = description("").replace("ssd:", "")
    refused(archive(tmp_path / "without.ssp", without, fmus), "root element has no namespace, as in drafts of SSP")
    deep = description('<ssd:Elements><ssd:System name="s">' * 3000 + "</ssd:System></ssd:Elements>" * 3000)
    refused(archive(tmp_path / "deep.ssp", deep, fmus), "not readable as XML")
    damaged = bytearray(archive(tmp_path / "d.ssp", good, fmus).read_bytes())
    middle = damaged.index(b"by hand")
    damaged[middle : middle + 4] = b"xxxx"
    (tmp_path / "d.ssp").write_bytes(damaged)
    refused(tmp_path / "d.ssp", "'SystemStructure.ssd' can't be unpacked: Bad CRC-32")
    path = archive(tmp_path / "large.ssp", good, fmus)
    monkeypatch.setattr(package, "MOST_XML_BYTES", 100)
    refused(path, r"'SystemStructure.ssd' has \d+ bytes, more than any such file needs")
    monkeypatch.setattr("cosim.fmi.archive.members.MOST_UNPACKED_BYTES", 1000)
    refused(path, r"unpacks to \d+ bytes, more than any system needs")


def test_parameters_inside_an_fmu(fmus: dict[str, Path], tmp_path: Path) -> None:
    own = tmp_path / "own.fmu"
    own.write_bytes(fmus["gain"].read_bytes())
    with zipfile.ZipFile(own, "a") as out:
        out.writestr("resources/k.ssv", parameter_set("K Real 3.5"))
    bound = bindings(binding(more=' source="resources/k.ssv" sourceBase="component"'))
    path = archive(tmp_path / "in.ssp", description(elements(component("a", "own", bindings=bound))), {"own": own})
    assert start(path)["a.K"] == 3.5
