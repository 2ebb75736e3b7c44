"""SSPs in the manner of other tools: each runs as the same system coupled by hand, or is refused in one line."""

from __future__ import annotations

import json
import re
import shutil
import zipfile
from pathlib import Path
from typing import Any

import pytest

from cosim import CosimError, System, simulate
from cosim.__main__ import main
from cosim.results import Results
from cosim.ssp import SSPError, read_ssp
from tests.support.changed_fmus import in_millimetres
from tests.support.small_fmus import compiled, redescribed
from tests.support.ssp_files import (
    EXPERIMENT,
    SPACES,
    UNITS,
    archive,
    binding,
    bindings,
    component,
    connection,
    connections,
    connectors,
    description,
    elements,
    linear,
    parameter_set,
    read,
    start,
    step_size_hint,
)
from tests.support.tiny_models import GAIN, INTEGRATOR
from tests.support.tiny_models import UNITS as LENGTHS
from tests.support.tiny_models import build as build_tiny


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Small FMUs by name: `m` passes a torque and a length on, `mm` is the same with its lengths in mm."""
    folder = build_tiny(tmp_path_factory.mktemp("guests"), GAIN, INTEGRATOR, LENGTHS)
    mm = in_millimetres(folder / "Units.fmu", folder / "mm.fmu", 'factor="0.001"')
    probe = compiled(folder, "fmi2_probe")
    return {
        "gain": folder / "Gain.fmu",
        "integrator": folder / "Integrator.fmu",
        "m": folder / "Units.fmu",
        "mm": mm,
        "probe": probe,
    }


def assert_equal_runs(found: System, by_hand: System) -> None:
    results, expected = (simulate(s, 1.0, 0.25) for s in (found, by_hand))
    assert results.names == expected.names
    assert results.values.tobytes() == expected.values.tobytes()


LOOP = elements(
    component("gain", "gain", "input u[1]", "output y[1]", bindings=bindings(binding("K Real -0.5"))),
    component("tank", "integrator", "input u", "output x", bindings=bindings(binding("x_start Real 2.0"))),
) + connections(connection("gain.y[1]", "tank.u"), connection("gain.u[1]", "tank.x"))


def loop_by_hand(fmus: dict[str, Path], **gain: float) -> System:
    system = System()
    system.add("gain", fmus["gain"], start={"u[2]": 0.0, "K": -0.5, **gain})
    system.add("tank", fmus["integrator"], start={"x_start": 2.0})
    system.connect("gain.y[1]", "tank.u")
    system.connect("tank.x", "gain.u[1]")
    return system


# Where files are


@pytest.mark.parametrize(
    ("source", "member"),
    [
        ("resources/my%20gain.fmu", "resources/my gain.fmu"),
        ("resources/my gain.fmu", "resources/my gain.fmu"),
        ("./resources/../gain.fmu", "gain.fmu"),
        ("resources/a%23b.fmu", "resources/a#b.fmu"),
        ("resources/a#b.fmu", "resources/a#b.fmu"),
        ("resources/100%25.fmu", "resources/100%.fmu"),
        ("resources/a%20b.fmu", "resources/a%20b.fmu"),
        ("resources\\gain.fmu", "resources/gain.fmu"),
        ("resources/gain.fmu", "resources\\gain.fmu"),
        ("resources/Stra%C3%9Fe.fmu", "resources/Straße.fmu"),
    ],
)
def test_sources_of_all_spellings(fmus: dict[str, Path], tmp_path: Path, source: str, member: str) -> None:
    text = description(LOOP).replace('source="resources/gain.fmu"', f'source="{source}"')
    path = tmp_path / "s.ssp"
    with zipfile.ZipFile(path, "w") as out:
        out.writestr("SystemStructure.ssd", text)
        out.writestr("resources/integrator.fmu", fmus["integrator"].read_bytes())
        info = zipfile.ZipInfo("x")
        info.filename = member  # as it is: the constructor changes backslashes on Windows
        out.writestr(info, fmus["gain"].read_bytes())
    found = read(path)
    assert found.notes == ()
    assert_equal_runs(found.system, loop_by_hand(fmus))


def test_files_of_another_kind_or_version_are_called_so(fmus: dict[str, Path], tmp_path: Path) -> None:
    bound = elements(component("gain", "gain", bindings=bindings(binding(more=' source="resources/p.ssv"'))))
    given = {"gain": fmus["gain"]}
    for text, what in (
        (description(""), r"p\.ssv: is a SystemStructureDescription, not a ParameterSet of SSP; check what names it"),
        ("<html/>", r"p\.ssv: is a html, not a ParameterSet of SSP"),
        (parameter_set("K Real 2", version="3.0"), r"p\.ssv: is of version 3\.0 of SSP; 1\.0 and 2\.0 can be read"),
    ):
        with pytest.raises(SSPError, match=what):
            read(archive(tmp_path / "s.ssp", description(bound), given, p_ssv=text))
    for version in ("3.0", "10.0", "0.9"):
        with pytest.raises(SSPError, match=rf"is of version {re.escape(version)} of SSP; 1\.0 and 2\.0 can be read"):
            read(archive(tmp_path / "v.ssp", description(bound, version=version), given))


def test_a_parameter_that_is_there_twice_is_noted(fmus: dict[str, Path], tmp_path: Path) -> None:
    twice = elements(component("gain", "gain", bindings=bindings(binding("K Real 2", "K Real 3"))))
    found = read(archive(tmp_path / "twice.ssp", description(twice), {"gain": fmus["gain"]}))
    assert found.system.components["gain"].start == {"K": 3.0}
    assert [note.rpartition(": ")[2] for note in found.notes] == ["parameter 'K' is there twice; the last one holds"]


@pytest.mark.parametrize(("n", "more"), [(3, ""), (4, " (and 1 more)"), (6, " (and 3 more)")])
def test_violations_beyond_three_are_counted(tmp_path: Path, n: int, more: str) -> None:
    nameless = elements(*['<ssd:Component source="resources/gain.fmu"/>'] * n)
    with pytest.raises(SSPError, match=rf"'name'{re.escape(more)}; correct it in the tool that wrote it$"):
        read(archive(tmp_path / "n.ssp", description(nameless)))


def test_a_connector_of_another_kind_is_noted_but_that_of_a_constant(fmus: dict[str, Path], tmp_path: Path) -> None:
    whole, variable = 'causality="output" variability="%s"', 'description="Test quantity x" '
    changes = {variable + whole % "continuous": variable + whole % "constant"}
    constant = redescribed(fmus["integrator"], tmp_path / "constant.fmu", changes)
    told = []
    for fmu in (fmus["integrator"], constant):
        text = description(elements(component("p", "p", "calculatedParameter x")))
        told.append(read(archive(tmp_path / f"{fmu.stem}.ssp", text, {"p": fmu})).notes)
    assert len(told[0]) == 1
    assert told[0][0].endswith("is of kind calculatedParameter, but the variable of the FMU is output, which holds")
    assert told[1] == ()


@pytest.mark.slow
def test_a_description_of_many_megabytes_is_read(fmus: dict[str, Path], tmp_path: Path) -> None:
    text = description(LOOP).replace("<ssd:System ", f"<!--{'x' * 8_000_000}--><ssd:System ", 1)
    given = {"gain": fmus["gain"], "integrator": fmus["integrator"]}
    assert_equal_runs(read(archive(tmp_path / "large.ssp", text, given)).system, loop_by_hand(fmus))


@pytest.mark.parametrize(("given", "expected"), [(1, 3), (3, 1), (2, 2)])
def test_a_value_of_the_system_is_mapped_on_its_way(
    fmus: dict[str, Path], tmp_path: Path, given: int, expected: int
) -> None:
    entries = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in ((1, 3), (3, 1)))
    table = f"<ssc:IntegerMappingTransformation>{entries}</ssc:IntegerMappingTransformation>"
    text = description(
        (connectors("input i") + elements(component("p", "p", "input n"))).replace("<ssc:Real/>", "<ssc:Integer/>")
        + connections(connection(".i", "p.n", table))
        + bindings(binding(f"i Integer {given}"))
    )
    found = read(archive(tmp_path / "m.ssp", text, {"p": fmus["probe"]}))
    assert found.system.components["p"].start == {"n": expected}


def test_an_ssp_without_components(tmp_path: Path) -> None:
    path = archive(tmp_path / "none.ssp", description(elements()))
    with pytest.raises(
        SSPError, match=r"none\.ssp: .*has no components; add one there, a Component element with an FMU"
    ):
        read(path)


def test_a_file_in_another_case_is_taken_with_a_note(fmus: dict[str, Path], tmp_path: Path) -> None:
    text = description(LOOP).replace("resources/gain.fmu", "Resources/GAIN.fmu")
    found = read(archive(tmp_path / "s.ssp", text, fmus))
    assert found.notes == (
        f"{tmp_path}/s.ssp: 'Resources/GAIN.fmu' is written 'resources/gain.fmu' in the archive; it is taken",
    )
    assert_equal_runs(found.system, loop_by_hand(fmus))


def test_a_file_of_this_machine_is_taken_with_a_note(fmus: dict[str, Path], tmp_path: Path) -> None:
    shutil.copy(fmus["gain"], tmp_path / "my gain.fmu")
    uri = (tmp_path / "my gain.fmu").as_uri()
    assert "%20" in uri
    found = read(archive(tmp_path / "s.ssp", description(LOOP.replace("resources/gain.fmu", uri)), fmus))
    assert found.notes == (f"{tmp_path}/s.ssp: '{uri}' is not in the archive; it is taken from this machine",)
    assert_equal_runs(found.system, loop_by_hand(fmus))


def test_an_fmu_for_a_proxy_on_this_machine_is_taken_with_a_note(fmus: dict[str, Path], tmp_path: Path) -> None:
    uri = "proxyfmu://localhost?file=resources/gain.fmu"
    found = read(archive(tmp_path / "s.ssp", description(LOOP.replace("resources/gain.fmu", uri)), fmus))
    assert found.notes == (f"{tmp_path}/s.ssp: '{uri}' is for a process of its own; the FMU runs in this one",)
    assert_equal_runs(found.system, loop_by_hand(fmus))


def test_prefixes_without_a_namespace_are_given_one(fmus: dict[str, Path], tmp_path: Path) -> None:
    """As some descriptions have it that the Open Simulation Platform publishes."""
    foreign = '<ssd:Annotations><ssc:Annotation type="x"><osp:Step x:size="1"/></ssc:Annotation></ssd:Annotations>'
    text = description(LOOP.replace("<ssd:Elements>", f"<!-- <no:thing/> -->{foreign}<ssd:Elements>", 1))
    text = re.sub(r' xmlns:ssc="[^"]*"', "", text).replace("?>", "?><!-- <first:thing/> -->", 1)
    found = read(archive(tmp_path / "s.ssp", text, fmus))
    assert "prefix 'ssc' has no namespace; it is taken as that of SSP" in " ".join(found.notes)
    assert "prefix 'osp' has no namespace; what has it is ignored" in " ".join(found.notes)
    assert "'no'" not in " ".join(found.notes)
    assert_equal_runs(found.system, loop_by_hand(fmus))


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("https://example.org/gain.fmu", r"'https://.*' is not a file of this archive; download it and give its path$"),
        ("proxyfmu://host:9090?file=gain.fmu", r"it is meant for libcosim's proxies on another machine; give the path"),
        ("proxyfmu://localhost", r"it is meant for libcosim's proxies"),
        ("proxyfmu://localhost?file=none.fmu", r"has no 'none.fmu'; known are"),
        ("file:///nowhere/gain.fmu", r"there is no file '/nowhere/gain.fmu' for 'file:///nowhere/gain.fmu'; correct"),
        ("file://host/gain.fmu", r"'file://host/gain.fmu' is not a file of this archive"),
        ("C:/models/gain.fmu", r"'C:/models/gain.fmu' is not a file of this archive; sources must be relative"),
        ("../gain.fmu", r"'../gain.fmu' is not a file of this archive"),
        ("resources/%2e%2e/%2e%2e/gain.fmu", r"is not a file of this archive"),
        ("/etc/passwd", r"'/etc/passwd' is not a file of this archive"),
        ("http://[gain.fmu", r"is not a URI: .*; sources must be relative"),
    ],
)
def test_sources_elsewhere_are_refused(fmus: dict[str, Path], tmp_path: Path, source: str, message: str) -> None:
    path = archive(tmp_path / "s.ssp", description(LOOP.replace("resources/gain.fmu", source)), fmus)
    with pytest.raises(SSPError, match=f"^{re.escape(str(path))}: component 'gain': .*{message}") as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_members_that_lead_out_of_the_archive_are_never_written(fmus: dict[str, Path], tmp_path: Path) -> None:
    path = archive(tmp_path / "s.ssp", description(LOOP.replace("resources/gain.fmu", "../gain.fmu")), fmus)
    with zipfile.ZipFile(path, "a") as out:
        out.writestr("../gain.fmu", fmus["gain"].read_bytes())
    with pytest.raises(SSPError, match=r"the path '\.\./gain\.fmu' in it leads out of the archive"):
        read(path)
    assert not list(tmp_path.rglob("gain.fmu"))


def test_a_folder_and_a_description_alone(fmus: dict[str, Path], tmp_path: Path) -> None:
    folder = tmp_path / "system"
    (folder / "resources").mkdir(parents=True)
    shutil.copy(fmus["gain"], folder / "resources")
    shutil.copy(fmus["integrator"], tmp_path / "tank.fmu")
    text = description(LOOP.replace("resources/integrator.fmu", "../tank.fmu").replace("gain.fmu", "Gain.fmu"))
    (folder / "SystemStructure.ssd").write_text(text)
    (folder / "variant.ssd").write_text(text.replace('value="-0.5"', 'value="-0.25"'))
    unpacked = tmp_path / "unpacked"
    assert_equal_runs(read_ssp(folder, unpacked).system, loop_by_hand(fmus))
    assert_equal_runs(read_ssp(folder / "variant.ssd", unpacked).system, loop_by_hand(fmus, K=-0.25))
    assert not unpacked.exists()  # FMUs stay where they are
    with pytest.raises(SSPError, match=rf"^{tmp_path}: has no SystemStructure.ssd, nor OspSystemStructure.xml; name"):
        read_ssp(tmp_path, unpacked)
    (folder / "variant.ssd").write_text(text.replace("Gain.fmu", "Gian.fmu"))
    with pytest.raises(SSPError, match=r"component 'gain': has no 'resources/Gian.fmu'; did you mean 'resources/Gain"):
        read_ssp(folder / "variant.ssd", unpacked)


# All that is missing


def test_all_that_is_missing_is_said_at_once(fmus: dict[str, Path], tmp_path: Path) -> None:
    system = elements(
        component("a", "none", "input u"),
        component("b", "nowhere", "output y"),
        component("c", "gain", "input uu", "output y[1]"),
        component("d", "integrator", "input u"),
    ) + connections(
        connection("a.u", "b.y"),  # of what is missing nothing more is said
        connection("c.y[1]", "d.q"),
        connection("e.y", "d.u"),
        connection("c.uu", "d.u"),
    )
    path = archive(tmp_path / "m.ssp", description(system), fmus)
    with pytest.raises(SSPError) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: 5 things are wrong: (1) component 'a': has no 'resources/none.fmu'; ")
    for part in (
        "(2) component 'b': has no 'resources/nowhere.fmu'",
        "(3) component 'c': the FMU has no variable for connector 'uu'",
        "(4) SystemStructure.ssd: connection 'c.y[1]' -> 'd.q': element 'd' has no connector 'q'",
        "(5) SystemStructure.ssd: connection 'e.y' -> 'd.u': there is no element 'e'",
    ):
        assert part in message
    assert "(6)" not in message
    assert "\n" not in message


# Units


@pytest.mark.parametrize("unit", ["", "[m]", "furlong"])
def test_empty_and_undefined_units_run_with_a_note(fmus: dict[str, Path], tmp_path: Path, unit: str) -> None:
    typed = f'<ssc:Real unit="{unit}"/>'
    inner = connectors("input in") + elements(component("b", "mm", "input length"))
    system = elements(
        component("a", "m", "output place", bindings=bindings(binding("length Real 2.0"))),
        f'<ssd:System name="sub">{inner}{connections(connection(".in", "b.length"))}</ssd:System>',
    ) + connections(connection("a.place", "sub.in"))
    found = read(archive(tmp_path / "u.ssp", description(system.replace("<ssc:Real/>", typed)), fmus))
    where = f"{tmp_path}/u.ssp: SystemStructure.ssd"
    if unit:
        assert found.notes == (
            f"{tmp_path}/u.ssp: component 'a': unit '{unit}' of connector 'place' is not defined; "
            "it is taken in the FMU's, 'm'",
            f"{tmp_path}/u.ssp: component 'sub/b': unit '{unit}' of connector 'length' is not defined; "
            "it is taken in the FMU's, 'mm'",
            f"{where}: connector 'in': unit '{unit}' is not defined, so nothing is converted by it",
        )
    else:
        assert found.notes == (f"{where}: units that are empty are taken for none",)
    by_hand = System()
    by_hand.add("a", fmus["m"], start={"torque": 0.0, "length": 2.0})
    by_hand.add("sub/b", fmus["mm"], start={"torque": 0.0})
    by_hand.connect("a.place", "sub/b.length", units="convert")
    assert_equal_runs(found.system, by_hand)


def test_units_can_be_ignored(fmus: dict[str, Path], tmp_path: Path) -> None:
    system = elements(
        component("a", "m", "output place", bindings=bindings(binding("length Real 2000.0 mm"))),
        component("b", "mm", "input length N.m"),
    ) + connections(connection("a.place", "b.length"))
    path = archive(tmp_path / "i.ssp", description(system), fmus)
    with pytest.raises(SSPError, match=r"connector 'length' is in 'N.m', but the FMU in 'mm'; .*\(--units ignore\)$"):
        read(path)
    found = read_ssp(path, tmp_path / "unpacked", units="ignore")
    assert found.system.components["a"].start["length"] == 2000.0
    assert simulate(found.system, 1.0, 0.5)["b.length"].tolist() == [2000.0] * 3


def test_an_empty_element_is_the_system_itself(fmus: dict[str, Path], tmp_path: Path) -> None:
    """As OMSimulator writes connectors of systems."""
    inner = connectors("input in") + elements(component("g", "gain", "input u[1]"))
    way = connections(connection(".in", "g.u[1]").replace("startConnector", 'startElement="" startConnector'))
    system = bindings(binding("s.in Real 3.0")) + elements(f'<ssd:System name="s">{inner}{way}</ssd:System>')
    found = read(archive(tmp_path / "e.ssp", description(system), fmus))
    (note,) = found.notes
    assert note.endswith("an empty startElement or endElement means the system itself")
    assert found.system.components["s/g"].start["u[1]"] == 3.0


# Violations of the schema


def test_what_leaves_no_doubt_is_noted(fmus: dict[str, Path], tmp_path: Path) -> None:
    text = description(LOOP)
    head, _, tail = text.partition("<ssd:Elements>")
    inner, _, rest = tail.partition("</ssd:Elements>")
    moved, _, after = rest.partition("</ssd:System>")
    odd = (
        f'{head}{moved}<ssd:Elements>{inner}<ssd:System name="empty"><ssd:Connectors/><ssd:Elements/></ssd:System>'
        f'</ssd:Elements><ssd:Annotations><ssd:Annotation type="x"/></ssd:Annotations></ssd:System>{after}'
    ).replace('kind="input"', 'kind="input" type="Real"')
    found = read(archive(tmp_path / "o.ssp", odd, fmus))
    assert len(found.notes) == 3
    assert sum("attribute 'type' is not of the standard and ignored" in note for note in found.notes) == 2
    assert sum("it is not where the schema has it" in note for note in found.notes) == 1
    assert_equal_runs(found.system, loop_by_hand(fmus))


def test_common_elements_in_another_namespace_of_ssp_are_taken_as_such(fmus: dict[str, Path], tmp_path: Path) -> None:
    """A transformation that is ignored would change numbers."""
    ends = elements(
        component("p", "probe", "output n_out", bindings=bindings(binding("n Integer 3"))),
        component("q", "probe", "input n"),
    )
    inner = table("Integer", (3, 40)).replace("ssc:", "ssd:")
    found = read(
        archive(tmp_path / "c.ssp", description(ends + connections(connection("p.n_out", "q.n", inner))), fmus)
    )
    assert found.notes[0].endswith(
        "IntegerMappingTransformation, MapEntry: taken as of the common namespace of SSP (ssc)"
    )
    assert simulate(found.system, 1.0, 0.5)["q.n_out"].tolist() == [40.0] * 3


def test_what_leaves_doubt_is_refused_all_at_once(fmus: dict[str, Path], tmp_path: Path) -> None:
    odd = description(LOOP, experiment='<ssd:DefaultExperiment stopTime="two"/>').replace(' endConnector="x"', "")
    with pytest.raises(SSPError, match=r"missing required attribute 'endConnector'; at .*stopTime='two'"):
        read(archive(tmp_path / "o.ssp", odd, fmus))


def test_another_file_under_the_name(fmus: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(SSPError, match=r"is a ParameterSet, not a SystemStructureDescription of SSP"):
        read(archive(tmp_path / "p.ssp", parameter_set("K Real 1.0"), fmus))


@pytest.mark.parametrize("kind", ["laughs", "external"])
def test_entities_are_refused(fmus: dict[str, Path], tmp_path: Path, kind: str) -> None:
    lines = '<!ENTITY a0 "ha">' + "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 12))
    if kind == "external":
        lines = '<!ENTITY a11 SYSTEM "file:///etc/passwd">'
    text = description(LOOP).replace("?>", f"?><!DOCTYPE x [{lines}]>", 1).replace("by hand", "&a11;")
    with pytest.raises(SSPError, match="Entities are forbidden"):
        read(archive(tmp_path / "b.ssp", text, fmus))


# Connectors


def test_connectors_that_are_not_declared_are_the_variables(fmus: dict[str, Path], tmp_path: Path) -> None:
    found = read(
        archive(tmp_path / "c.ssp", description(re.sub("<ssd:Connectors>.*?</ssd:Connectors>", "", LOOP)), fmus)
    )
    assert len(found.notes) == 3
    assert all("declares no connector" in note for note in found.notes)
    assert found.notes[-1].endswith("(and 1 more of this kind)")
    assert_equal_runs(found.system, loop_by_hand(fmus))


def test_local_variables_give_values(fmus: dict[str, Path], tmp_path: Path) -> None:
    """As SSP 2.0 has it; an FMU doesn't say what they depend on, so it may be all inputs."""
    described = redescribed(fmus["m"], tmp_path / "plain.fmu", {})
    with zipfile.ZipFile(described) as packed:
        text = packed.read("modelDescription.xml").decode()
    line = next(part for part in re.findall(r"<ScalarVariable[^>]*>", text) if 'name="place"' in part)
    local = {line: line.replace('causality="output"', 'causality="local"')}
    outputs, unknowns = re.findall(r"<Unknown [^>]*>", text), re.findall(r'<Unknown index="4"[^>]*>', text)
    assert unknowns
    assert len(outputs) > len(unknowns)
    own = {**fmus, "local": redescribed(described, tmp_path / "local.fmu", {**local, unknowns[0]: ""})}
    system = elements(
        component("a", "local", "local place", bindings=bindings(binding("length Real 2.0"))),
        component("b", "mm", "input length", "output place"),
    ) + connections(connection("a.place", "b.length"))
    found = read(archive(tmp_path / "l.ssp", description(system, version="2.0"), own)).system
    results = simulate(found, 1.0, 0.5)
    assert results["b.length"].tolist() == [pytest.approx(2000.0)] * 3  # also at the start: in order
    by_hand = System()
    by_hand.add("a", fmus["m"], start={"length": 2.0})
    by_hand.add("b", fmus["mm"])
    by_hand.connect("a.place", "b.length", units="convert")
    assert results["b.place"].tolist() == simulate(by_hand, 1.0, 0.5)["b.place"].tolist()


def test_kinds_that_the_other_end_settles(fmus: dict[str, Path], tmp_path: Path) -> None:
    system = LOOP.replace('kind="output"', 'kind="unspecified"').replace('kind="input"', 'kind="inout"')
    found = read(archive(tmp_path / "k.ssp", description(system, version="2.0"), fmus))
    assert found.notes == ()
    assert_equal_runs(found.system, loop_by_hand(fmus))
    found = read(archive(tmp_path / "l.ssp", description(system), fmus))
    (note,) = found.notes
    assert note.endswith("is of version 1.0 by its own words, but has what 2.0 brought; it is read as 2.0")
    assert_equal_runs(found.system, loop_by_hand(fmus))


# Signal dictionaries


def dictionary(name: str, *entries: str, source: str = "") -> str:
    """A signal dictionary from `name` or `name unit`."""
    inner = ""
    for item in entries:
        entry, *unit = item.split()
        real = f'<ssc:Real unit="{unit[0]}"/>' if unit else "<ssc:Real/>"
        inner += f'<ssb:DictionaryEntry name="{entry}">{real}</ssb:DictionaryEntry>'
    units = UNITS.replace("ssd:", "ssb:")
    content = f'<ssb:SignalDictionary {SPACES} version="1.0">{inner}{units}</ssb:SignalDictionary>'
    if source:
        return content
    return f'<ssd:SignalDictionary name="{name}">{content}</ssd:SignalDictionary>'


def reference(name: str, of: str, *items: str) -> str:
    kind = "ssd:SignalDictionaryReference"
    return f'<{kind} name="{name}" dictionary="{of}">{connectors(*items)}</{kind}>'


def on_a_bus(kinds: tuple[str, str], units: tuple[str, str, str] = ("", "", "")) -> str:
    """A length in m goes over a bus, deep in nested systems, to a component in mm."""
    deep = '<ssd:System name="deep">{}</ssd:System>'
    giver = elements(
        component("a", "m", "output place", bindings=bindings(binding("length Real 2.0"))),
        reference("bus", "signals", f"{kinds[0]} place {units[0]}".strip()),
    ) + connections(connection("a.place", "bus.place"))
    taker = elements(
        component("b", "mm", "input length"), reference("bus", "signals", f"{kinds[1]} place {units[2]}".strip())
    ) + connections(connection("bus.place", "b.length"))
    inner = elements(deep.format(giver), f'<ssd:System name="other">{taker}</ssd:System>')
    signals = f"<ssd:SignalDictionaries>{dictionary('signals', f'place {units[1]}'.strip())}</ssd:SignalDictionaries>"
    return description(inner + signals)


@pytest.mark.parametrize("kinds", [("input", "output"), ("inout", "inout"), ("inout", "output")])
@pytest.mark.parametrize("units", [("", "", ""), ("m", "mm", "m"), ("mm", "m", ""), ("", "mm", "mm")])
def test_signals_of_a_dictionary_go_from_reference_to_reference(
    fmus: dict[str, Path], tmp_path: Path, kinds: tuple[str, str], units: tuple[str, str, str]
) -> None:
    found = read(archive(tmp_path / "d.ssp", on_a_bus(kinds, units), fmus))
    by_hand = System()
    by_hand.add("deep/a", fmus["m"], start={"torque": 0.0, "length": 2.0})
    by_hand.add("other/b", fmus["mm"], start={"torque": 0.0})
    by_hand.connect("deep/a.place", "other/b.length", units="convert")
    results, expected = (simulate(s, 1.0, 0.5) for s in (found.system, by_hand))
    assert results["other/b.length"] == pytest.approx(expected["other/b.length"], rel=1e-14)
    assert results["other/b.length"][-1] == pytest.approx(2000.0)


def test_dictionaries_in_files_and_their_names(fmus: dict[str, Path], tmp_path: Path) -> None:
    inline = dictionary("signals", "place")
    text = on_a_bus(("input", "output"))
    assert inline in text
    by_file = text.replace(inline, '<ssd:SignalDictionary name="signals" source="resources/signals.ssb"/>')
    file = {"signals_ssb": dictionary("signals", "place", source="file")}
    found = read(archive(tmp_path / "f.ssp", by_file, fmus, **file))
    assert simulate(found.system, 1.0, 0.5)["other/b.length"][-1] == pytest.approx(2000.0)
    for old, new, message in (
        (
            'name="signals"',
            'name="signale"',
            r"'deep/bus' refers to a signal dictionary 'signals', which does not exist; did",
        ),
        ('DictionaryEntry name="place"', 'DictionaryEntry name="plce"', r"dictionary 'signals' has no signal 'place'"),
    ):
        with pytest.raises(SSPError, match=message):
            read(archive(tmp_path / "g.ssp", text.replace(old, new), fmus))


def test_two_that_feed_one_signal(fmus: dict[str, Path], tmp_path: Path) -> None:
    system = elements(
        component("a", "m", "output place"),
        component("b", "m", "output place"),
        reference("one", "d", "input place"),
        reference("two", "d", "input place"),
    ) + connections(connection("a.place", "one.place"), connection("b.place", "two.place"))
    signals = f"<ssd:SignalDictionaries>{dictionary('d', 'place')}</ssd:SignalDictionaries>"
    with pytest.raises(SSPError, match=r"signal 'place' of 'two': 'place' is fed by another connection too"):
        read(archive(tmp_path / "t.ssp", description(system + signals), fmus))


# Components that are systems of other descriptions


INNER = connectors("input flow", "output level", "parameter level0") + elements(
    component(
        "tank", "integrator", "input u", "output x", "parameter x_start", bindings=bindings(binding("T Real 2.0"))
    )
)
INNER += connections(
    connection(".flow", "tank.u"), connection(".level", "tank.x"), connection(".level0", "tank.x_start")
)


def outer(source: str, kind: str, bound: str = "") -> str:
    ports = connectors("input flow", "output level")
    return elements(
        component("gain", "gain", "input u[1]", "output y[1]", bindings=bindings(binding("K Real -0.5"))),
        f'<ssd:Component name="sub" type="application/{kind}" source="{source}">{ports}{bound}</ssd:Component>',
    ) + connections(connection("gain.y[1]", "sub.flow"), connection("gain.u[1]", "sub.level"))


@pytest.mark.parametrize("kind", ["package", "variant", "description", "id"])
def test_a_component_may_be_a_system(fmus: dict[str, Path], tmp_path: Path, kind: str) -> None:
    inner = archive(tmp_path / "inner.ssp", description(INNER), fmus)
    with zipfile.ZipFile(inner, "a") as out:
        out.writestr("variant.ssd", description(INNER).replace('value="2.0"', 'value="4.0"'))
    bound = bindings(binding("tank.T Real 8.0", "level0 Real 2.0"))
    source, of = {
        "package": ("resources/inner.ssp", "x-ssp-package"),
        "variant": ("resources/inner.ssp#variant.ssd", "x-ssp-package"),
        "description": ("resources/inner.ssd", "x-ssp-definition"),
        "id": ("#tank", "x-ssp-definition"),
    }[kind]
    text = description(outer(source, of, "" if kind in ("variant", "package") else bound))
    if kind == "id":
        definition = f'<ssd:System name="definition" id="tank">{INNER}</ssd:System>'
        text = text.replace("</ssd:Elements>", f"{definition}</ssd:Elements>", 1)
    path = archive(tmp_path / "outer.ssp", text, fmus)
    with zipfile.ZipFile(path, "a") as out:
        out.write(inner, "resources/inner.ssp")
        out.writestr("resources/inner.ssd", description(INNER).replace("resources/integrator", "integrator"))
    found = read(path).system
    expected = {"package": {"T": 2.0}, "variant": {"T": 4.0}}.get(kind, {"T": 8.0, "x_start": 2.0})
    assert found.components["sub/tank"].start == expected
    by_hand = System()
    by_hand.add("gain", fmus["gain"], start={"u[2]": 0.0, "K": -0.5})
    by_hand.add("sub/tank", fmus["integrator"], start=expected)
    if kind == "id":
        by_hand.add("definition/tank", fmus["integrator"], start={"u": 0.0, "T": 2.0})
    by_hand.connect("gain.y[1]", "sub/tank.u")
    by_hand.connect("sub/tank.x", "gain.u[1]")
    assert_equal_runs(found, by_hand)


def test_values_of_a_system_override_those_of_the_component_and_of_the_package(
    fmus: dict[str, Path], tmp_path: Path
) -> None:
    inner = archive(tmp_path / "inner.ssp", description(bindings(binding("tank.T Real 3.0")) + INNER), fmus)
    for at_root, at_component, expected in (("", "", 3.0), ("", "4.0", 4.0), ("5.0", "4.0", 5.0)):
        low = bindings(binding(f"tank.T Real {at_component}")) if at_component else ""
        high = bindings(binding(f"sub.tank.T Real {at_root}")) if at_root else ""
        path = archive(tmp_path / "o.ssp", description(high + outer("resources/i.ssp", "x-ssp-package", low)), fmus)
        with zipfile.ZipFile(path, "a") as out:
            out.write(inner, "resources/i.ssp")
        assert start(path)["sub/tank.T"] == expected


def test_a_system_that_has_itself_as_a_component(fmus: dict[str, Path], tmp_path: Path) -> None:
    text = description(connectors("input flow", "output level") + outer("SystemStructure.ssd", "x-ssp-definition"))
    with pytest.raises(SSPError, match="the system has itself as a component; cut this circle"):
        read(archive(tmp_path / "c.ssp", text, fmus))
    with pytest.raises(SSPError, match="no system of this description has the id 'x'"):
        read(archive(tmp_path / "d.ssp", description(outer("#x", "x-ssp-definition")), fmus))
    with pytest.raises(SSPError, match=r"is an FMU by its type, but 'resources/x.ssp' is not one; set type"):
        read(archive(tmp_path / "e.ssp", description(outer("resources/x.ssp", "x-fmu-sharedlibrary")), fmus))


# Transformations of connections


def table(kind: str, *pairs: tuple[Any, Any]) -> str:
    entries = "".join(f'<ssc:MapEntry source="{a}" target="{b}"/>' for a, b in pairs)
    return f"<ssc:{kind}MappingTransformation>{entries}</ssc:{kind}MappingTransformation>"


@pytest.mark.parametrize(
    ("name", "value", "inner", "expected"),
    [
        ("n", "Integer 3", table("Integer", (3, 40), (5, 6)), 40.0),
        ("n", "Integer 4", table("Integer", (3, 40), (5, 6)), 4.0),
        ("b", "Boolean true", table("Boolean", ("true", "false"), ("false", "true")), 0.0),
        ("b", "Boolean false", table("Boolean", ("true", "false"), ("false", "true")), 1.0),
        ("b", "Boolean true", table("Boolean", ("false", "true")), 1.0),
        ("e", "Enumeration on", table("Enumeration", ("on", "off")), 1.0),
        ("e", "Enumeration off", table("Enumeration", ("on", "off")), 1.0),
        ("e", "Enumeration on", table("Integer", (2, 1)), 1.0),
    ],
)
def test_connections_with_tables(
    fmus: dict[str, Path], tmp_path: Path, name: str, value: str, inner: str, expected: float
) -> None:
    system = elements(
        component("p", "probe", f"output {name}_out", bindings=bindings(binding(f"{name} {value}"))),
        component("q", "probe", f"input {name}"),
    ) + connections(connection(f"p.{name}_out", f"q.{name}", inner))
    found = read_ssp(archive(tmp_path / "t.ssp", description(system), fmus), tmp_path / "unpacked", step_size=0.5)
    (note,) = found.notes
    assert f"its mapping is a component, 'q/{name}'" in note
    assert simulate(found.system, 1.0, 0.5)[f"q.{name}_out"].tolist() == [expected] * 3


def test_tables_that_fit_nothing(fmus: dict[str, Path], tmp_path: Path) -> None:
    def refused(name: str, inner: str, message: str) -> None:
        ends = component("p", "probe", f"output {name}"), component("q", "probe", f"input {name.removesuffix('_out')}")
        if name == "y":
            ends = component("p", "m", "output place"), component("q", "m", "input length")
        way = connection(f"p.{name}", f"q.{name.removesuffix('_out')}", inner)
        if name == "y":
            way = connection("p.place", "q.length", inner)
        with pytest.raises(SSPError, match=message):
            read(archive(tmp_path / "t.ssp", description(elements(*ends) + connections(way)), fmus))

    refused("y", table("Integer", (1, 2)), "maps values of type Real; only truth values and whole numbers can be")
    refused("n_out", table("Boolean", ("true", "false")), "has a BooleanMappingTransformation, but values of type Int")
    refused("n_out", table("Enumeration", ("a", "b")), "maps names of items, but not both ends are enumerations")
    refused("e_out", table("Enumeration", ("on", "broken")), "'on' would become 'broken', which 'e' can't: off, on$")
    refused("n_out", table("Integer", (1, 2), (1, 3)), "maps 1 to two values; remove one of them")


# Enumerations


def test_items_of_an_enumeration_that_the_file_defines(fmus: dict[str, Path], tmp_path: Path) -> None:
    text = parameter_set("e Enumeration an").replace('value="an"', 'value="an" name="Modus"')
    defined = text.replace(
        "<ssv:Units>",
        '<ssv:Enumerations><ssc:Enumeration name="Modus"><ssc:Item name="an" value="2"/></ssc:Enumeration>'
        "</ssv:Enumerations><ssv:Units>",
    )
    system = description(
        elements(component("p", "probe", bindings=bindings(binding(more=' source="resources/e.ssv"'))))
    )
    assert start(archive(tmp_path / "e.ssp", system, fmus, e_ssv=defined))["p.e"] == 2.0
    with pytest.raises(SSPError, match=r"'p.e' can't become 'an'; known are: off, on"):
        read(archive(tmp_path / "f.ssp", system, fmus, e_ssv=text))
    by_number = archive(tmp_path / "g.ssp", system, fmus, e_ssv=text.replace('value="an"', 'value="2"'))
    assert start(by_number)["p.e"] == 2.0


# Parameters that do nothing, and sets that a user names


def test_values_of_what_can_not_be_set_are_ignored_with_a_note(fmus: dict[str, Path], tmp_path: Path) -> None:
    found = read(archive(tmp_path / "o.ssp", description(bindings(binding("tank.x Real 1.0")) + LOOP), fmus))
    (note,) = found.notes
    assert note == (
        f"{tmp_path}/o.ssp: SystemStructure.ssd: the system: 'tank.x' is of causality output and can't be set; "
        "its value is ignored"
    )
    assert_equal_runs(found.system, loop_by_hand(fmus))


@pytest.fixture
def two_sets(fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An SSP with one parameter set that is bound, and one that is not."""
    monkeypatch.chdir(tmp_path)
    bound = LOOP.replace(binding("K Real -0.5"), binding(more=' source="resources/weak.ssv"'))
    sets = {"weak_ssv": parameter_set("K Real -0.5"), "strong_ssv": parameter_set("K Real -2.0")}
    return archive(tmp_path / "two.ssp", description(bound), fmus, **sets)


@pytest.mark.parametrize(
    ("named", "expected"),
    [
        ([], -0.5),
        (["gain=resources/strong.ssv"], -2.0),
        (["resources/weak.ssv=resources/strong.ssv"], -2.0),
        (["weak.ssv=strong.ssv"], -7.0),
        (["all.ssv"], -8.0),
        (["all.ssv", "gain=strong.ssv"], -7.0),
        (["gain=strong.ssv", "all.ssv"], -8.0),
    ],
)
def test_parameter_sets_of_the_user(two_sets: Path, named: list[str], expected: float) -> None:
    Path("strong.ssv").write_text(parameter_set("K Real -7.0"))
    Path("all.ssv").write_text(parameter_set("gain.K Real -8.0"))
    found = read_ssp(two_sets, Path("unpacked"), parameter_sets=named)
    assert found.system.components["gain"].start["K"] == expected


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ("none.ssv", "none.ssv: there is no such file, nor one in two.ssp; check the path"),
        ("local.ssv", "local.ssv: none of its parameters is one of the system, as 'K'; names are component.parameter"),
        ("gian=local.ssv", "gian=local.ssv: 'gian' is neither a component nor a bound parameter set; did you mean"),
    ],
)
@pytest.mark.usefixtures("no_figures")
def test_parameter_sets_that_would_do_nothing(
    two_sets: Path, named: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("local.ssv").write_text(parameter_set("K Real -7.0"))
    assert main(["run", two_sets.name, "--ssv", named, "--step", "0.5"]) == 1
    shown = capsys.readouterr().err
    assert message in shown
    assert shown.count("\n") == 1


# The command line


@pytest.mark.usefixtures("no_figures")
def test_folders_notes_and_options_on_the_command_line(
    fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    archive(Path("s.ssp"), description(LOOP.replace('kind="output"', 'kind="output" type="Real"')), fmus)
    with zipfile.ZipFile("s.ssp") as packed:
        packed.extractall("folder")
    Path("k.ssv").write_text(parameter_set("gain.K Real -0.25"))
    assert main(["run", "folder", "--step", "0.5", "--ssv", "k.ssv", "--units", "ignore"]) == 0
    assert "note: folder/SystemStructure.ssd: at " in capsys.readouterr().out
    summary = json.loads(Path("results/folder/summary.json").read_text())
    assert summary["parameters"]["gain.K"] == -0.25
    assert "attribute 'type' is not of the standard" in summary["notes"][0]
    assert summary["ssp"] == "folder"
    assert main(["run", "folder/SystemStructure.ssd", "--step", "0.5"]) == 0
    for option in (["--ssv", "k.ssv"], ["--units", "ignore"]):
        assert main(["run", str(fmus["gain"]), *option]) == 1
        assert f"{option[0]} is for SSPs and OSP configurations" in capsys.readouterr().err


def test_experiments_without_times(fmus: dict[str, Path], tmp_path: Path) -> None:
    found = read(
        archive(tmp_path / "e.ssp", description(LOOP, experiment=EXPERIMENT.replace('startTime="0.0"', "")), fmus)
    )
    assert (found.start_time, found.stop_time) == (0.0, 1.0)
    with pytest.raises(CosimError):
        read(archive(tmp_path / "f.ssp", description(LOOP, experiment='<ssd:DefaultExperiment stopTime=""/>'), fmus))


def test_a_linear_transformation_goes_on_as_before(fmus: dict[str, Path], tmp_path: Path) -> None:
    system = LOOP.replace(connection("gain.y[1]", "tank.u"), connection("gain.y[1]", "tank.u", linear(2, 1)))
    by_hand = loop_by_hand(fmus)
    by_hand.connections.clear()
    by_hand.connect("gain.y[1]", "tank.u", factor=2, offset=1)
    by_hand.connect("tank.x", "gain.u[1]")
    assert_equal_runs(read(archive(tmp_path / "l.ssp", description(system), fmus)).system, by_hand)


def hinted(hint: str) -> str:
    """The loop, with a step of its own for the tank."""
    first, tank, rest = LOOP.partition('<ssd:Component name="tank"')
    return first + tank + rest.replace("</ssd:Component>", f"{step_size_hint(hint)}</ssd:Component>", 1)


@pytest.mark.parametrize(
    ("hint", "step", "every", "noted"),
    [("0.4", None, 4, 0), ("0.4", 0.2, 2, 0), ("0.25", None, 2, 1), ("0", None, 1, 0)],
)
def test_components_with_steps_of_their_own(
    fmus: dict[str, Path], tmp_path: Path, hint: str, step: float | None, every: int, noted: int
) -> None:
    path = archive(tmp_path / "h.ssp", description(hinted(hint)), fmus)
    found = read_ssp(path, tmp_path / "unpacked", step_size=step)
    assert (found.step_size, found.system.components["tank"].every) == (step or 0.1, every)
    assert found.system.components["gain"].every == 1
    assert len(found.notes) == noted


def test_steps_that_omsimulator_controls_are_noted(fmus: dict[str, Path], tmp_path: Path) -> None:
    master = (
        '<o:SimulationInformation xmlns:o="x"><o:VariableStepMaster initialStepSize="1"/></o:SimulationInformation>'
    )
    annotation = f'<ssc:Annotation type="org.openmodelica">{master}</ssc:Annotation>'
    text = description(LOOP + f"<ssd:Annotations>{annotation}</ssd:Annotations>")
    found = read(archive(tmp_path / "v.ssp", text, fmus))
    (note,) = found.notes
    assert note.endswith("its steps are controlled by OMSimulator; here the step is fixed")
    assert found.step_size == 0.1  # of the FMUs


def test_another_tools_ssp_without_times_is_run_and_drawn_in_one_command(
    fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    archive(Path("s.ssp"), description(LOOP, experiment=""), fmus)
    assert main(["run", "s.ssp", "--report"]) == 0
    shown = capsys.readouterr().out
    assert "has no stop time; 1 s is taken, the latest of its FMUs' default experiments\n" in shown
    assert shown.endswith("\nresults, summary and figures: results/s\n")
    assert sorted(p.name for p in Path("results/s").iterdir()) == [
        *("report.html", "results.csv", "results.png", "summary.json")
    ]
    assert Results.from_csv("results/s/results.csv").time[-1] == 1.0
    assert "has no stop time" not in str(read_ssp("s.ssp", "unpacked", stop_time=2.0).notes)
    found = read_ssp("s.ssp", "unpacked", stop_time=0.25)  # of FMUs that ask for steps of 0.1 s
    assert found.step_size == 0.25 / 3
    assert (
        "not a whole number of steps of 0.1 s, the smallest that an FMU asks for; 0.0833333 s is taken"
        in found.notes[0]
    )


def test_where_nothing_says_how_long_it_is_a_second_and_said_so(
    fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    archive(Path("s.ssp"), description(elements(component("p", "probe", "output y")), experiment=""), fmus)
    found = read_ssp("s.ssp", "unpacked")
    assert (found.stop_time, found.step_size, found.notes) == (None, None, ())
    assert main(["run", "s.ssp", "--start", "3", "--report"]) == 0
    said = "neither it nor its FMUs say when to stop; 4 s is taken, 1 s after the start (--stop)"
    shown = capsys.readouterr().out
    assert said in shown
    assert "neither it nor its FMUs have a default step; 0.002 s is taken" in shown
    results = Results.from_csv("results/s/results.csv")
    assert (results.time[0], results.time[-1], len(results.time)) == (3.0, 4.0, 501)
    assert said in json.loads(Path("results/s/summary.json").read_text())["notes"][0]
    assert said in Path("results/s/report.html").read_text(encoding="utf-8")
    found = read_ssp("s.ssp", "unpacked", stop_time=2.0)
    assert (found.stop_time, found.step_size) == (2.0, 0.004)
    assert "neither it nor its FMUs have a default step; 0.004 s is taken, 500 steps in all" in found.notes[0]


def test_where_nothing_else_has_a_step_it_is_the_smallest_of_the_hints(fmus: dict[str, Path], tmp_path: Path) -> None:
    hints = [
        component("p", "probe", "output y", bindings=step_size_hint("0.2")),
        component("q", "probe", "output y", bindings=step_size_hint("0.1")),
    ]
    found = read(archive(tmp_path / "h.ssp", description(elements(*hints)), fmus))
    assert (found.step_size, [c.every for c in found.system.components.values()], found.notes) == (0.1, [2, 1], ())
