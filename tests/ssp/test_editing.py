"""SSPs that are read, changed and written again."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

from cosim import SetupError, simulate
from cosim.ssp import SSPError, SSPFile
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
    read,
    start,
)
from tests.support.tiny_models import GAIN, INTEGRATOR, LAG
from tests.support.tiny_models import build as build_tiny

ANNOTATION = (
    '<ssd:Annotations><ssc:Annotation type="org.example"><x:Note xmlns:x="urn:x" y="1">&lt;kept&gt;</x:Note>'
    "</ssc:Annotation></ssd:Annotations>"
)
TANK = component("tank.one", "integrator", "input u", "output x", bindings=bindings(binding("x_start Real 2.0")))
INNER = (
    connectors("input in", "output out")
    + elements(TANK)
    + connections(connection(".in", "tank.one.u"), connection(".out", "tank.one.x"))
)
SYSTEM = (
    elements(
        component("gain", "gain", "input u[1]", "output y[1]", bindings=bindings(binding("K Real -0.5"))),
        f'<ssd:System name="sub">{INNER}</ssd:System>',
    )
    + connections(connection("gain.y[1]", "sub.in"), connection("sub.out", "gain.u[1]"))
    + ANNOTATION
)


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = build_tiny(tmp_path_factory.mktemp("editing"), GAIN, INTEGRATOR, LAG)
    probe = compiled(folder, "fmi2_probe")
    return {n.lower(): folder / f"{n}.fmu" for n in ("Gain", "Integrator", "Lag")} | {"probe": probe}


@pytest.fixture
def loop(fmus: dict[str, Path], tmp_path: Path) -> Path:
    """An SSP with a comment, an annotation and a file that no one reads."""
    # the helper splits at the first dot
    text = SYSTEM.replace('endElement="tank" endConnector="one.', 'endElement="tank.one" endConnector="')
    path = archive(tmp_path / "loop.ssp", description(text).replace("<ssd:Units>", "<!-- kept --><ssd:Units>"), fmus)
    with zipfile.ZipFile(path, "a") as out:
        out.writestr("extra/org.example/notes.txt", "kept")
    return path


def text_of(path: Path) -> str:
    with zipfile.ZipFile(path) as packed:
        return packed.read("SystemStructure.ssd").decode()


def test_what_is_not_changed_stays(loop: Path, tmp_path: Path) -> None:
    ssp = SSPFile(loop)
    assert ssp.components == ["gain", "sub/tank/one"]
    assert ssp.connections() == [("gain.y[1]", "sub.in"), ("sub.out", "gain.u[1]")]
    assert ssp.connections("sub") == [(".in", "tank.one.u"), (".out", "tank.one.x")]
    assert ssp.notes == ()
    copy = tmp_path / "copy.ssp"
    ssp.write(copy)
    same = [ElementTree.canonicalize(text_of(path), with_comments=True) for path in (copy, loop)]
    assert same[0] == same[1]
    with zipfile.ZipFile(loop) as old, zipfile.ZipFile(copy) as new:
        assert old.namelist() == new.namelist()
        others = [n for n in old.namelist() if n != "SystemStructure.ssd"]
        assert all(old.read(n) == new.read(n) for n in others)
        assert all(old.getinfo(n).date_time == new.getinfo(n).date_time for n in others)


def test_connections_are_changed(loop: Path) -> None:
    ssp = SSPFile(loop)
    ssp.disconnect("sub.in", "gain.y[1]")  # in any order
    ssp.connect("gain.y[1]", "sub.in", factor=3.0, offset=0.25, convert_units=False)
    ssp.disconnect(".out", "tank.one.x", system="sub")
    ssp.connect("tank.one.x", ".out", system="sub", factor=2.0)
    ssp.write(loop)  # over itself
    changed = text_of(loop)
    assert ANNOTATION in changed
    assert "<!-- kept -->" in changed
    assert 'suppressUnitConversion="true"' in changed
    found = {(c.source, c.target): (c.factor, c.offset) for c in read(loop).system.connections}
    assert found == {
        ("gain.y[1]", "sub/tank/one.u"): (3.0, 0.25),
        ("sub/tank/one.x", "gain.u[1]"): (2.0, 0.0),
    }


def test_the_last_connection_is_removed_and_a_first_one_added(loop: Path) -> None:
    ssp = SSPFile(loop)
    for start_, end in ssp.connections():
        ssp.disconnect(start_, end)
    ssp.write(loop)
    assert read(loop).system.connections == []
    ssp = SSPFile(loop)
    ssp.connect("gain.y[1]", "sub.in")
    ssp.write(loop)
    (connection_,) = read(loop).system.connections
    assert (connection_.source, connection_.target) == ("gain.y[1]", "sub/tank/one.u")


@pytest.mark.parametrize("above", ["", bindings(binding("gain.K Real 9.0", "sub.tank.one.x_start Real 9.0"))])
def test_parameters_are_set_whatever_systems_say(fmus: dict[str, Path], tmp_path: Path, above: str) -> None:
    text = SYSTEM.replace('endElement="tank" endConnector="one.', 'endElement="tank.one" endConnector="')
    path = archive(tmp_path / "p.ssp", description(above + text), fmus)
    ssp = SSPFile(path)
    ssp.set_parameter("gain.K", -1.5)
    ssp.set_parameter("sub/tank/one.x_start", 4.0)
    ssp.set_parameter("sub/tank/one.T", 2.0)
    ssp.write(path)
    values = start(path)
    assert (values["gain.K"], values["sub/tank/one.x_start"], values["sub/tank/one.T"]) == (-1.5, 4.0, 2.0)
    results = simulate(read(path).system, 1.0, 0.5)
    assert results["sub/tank/one.x"][0] == 4.0
    again = SSPFile(path)
    again.set_parameter("gain.K", -2.5)
    again.write(path)
    assert start(path)["gain.K"] == -2.5


def test_parameters_of_all_types(fmus: dict[str, Path], tmp_path: Path) -> None:
    path = archive(tmp_path / "t.ssp", description(elements(component("p", "probe"))), fmus)
    ssp = SSPFile(path)
    for name, value in (("n", 3), ("b", True), ("e", 2), ("u", 1.5), ("journal", str(tmp_path / "j.txt"))):
        ssp.set_parameter(f"p.{name}", value)
    ssp.write(path)
    values = start(path)
    assert [values[f"p.{n}"] for n in ("n", "b", "e", "u", "journal")] == [3, True, 2.0, 1.5, str(tmp_path / "j.txt")]


def test_another_fmu(loop: Path, fmus: dict[str, Path], tmp_path: Path) -> None:
    other = tmp_path / "Lag #1.fmu"
    other.write_bytes(fmus["lag"].read_bytes())
    ssp = SSPFile(loop)
    ssp.replace_fmu("sub/tank/one", other)
    ssp.set_parameter("sub/tank/one.T", 2.0)
    ssp.write(tmp_path / "lag.ssp")
    system = read(tmp_path / "lag.ssp").system
    assert system.components["sub/tank/one"].fmu.name == "Lag #1.fmu"
    x = simulate(system, 1.0, 0.25, order="sequential", extrapolation="hold")["sub/tank/one.x"]
    assert x[1] < x[0] == 2.0  # x' = (-x / 2 - x) / 2
    for component_, fmu, message in (
        (
            "gain",
            "probe",
            r"has no variables for connectors 'u\[1\]' \(input\), 'y\[1\]' \(output\) of compo",
        ),
        ("gian", "gain", r"no component 'gian'; did you mean 'gain'\?"),
        ("sub", "gain", r"no component 'sub'; "),  # a system
    ):
        with pytest.raises(SSPError, match=message):
            ssp.replace_fmu(component_, fmus[fmu])


def test_a_description_with_a_namespace_of_its_own(fmus: dict[str, Path], tmp_path: Path) -> None:
    """As tools write it that make the standard's namespace the one without a prefix, and declare no other."""
    text = description(SYSTEM.partition("<ssd:Annotations>")[0]).replace("one.", "").replace("tank.one", "tank")
    text = re.sub(r'endElement="tank" endConnector="', 'endElement="tank" endConnector="', text)
    plain = re.sub(r"(</?)ssd:", r"\1", text).replace("xmlns:ssd=", "xmlns=").replace("xmlns:ssm=", "xmlns:other=")
    plain = re.sub(r' xmlns:ssv="[^"]*"', "", plain, count=1)
    path = archive(tmp_path / "n.ssp", plain, fmus)
    ssp = SSPFile(path)
    ssp.disconnect("gain.y[1]", "sub.in")
    ssp.connect("gain.y[1]", "sub.in", factor=2.0)
    ssp.set_parameter("gain.K", -1.0)
    ssp.write(path)
    assert start(path)["gain.K"] == -1.0
    assert "ssd:" not in text_of(path)
    assert {c.factor for c in read(path).system.connections} == {1.0, 2.0}


def test_what_can_not_be_changed(loop: Path) -> None:
    ssp = SSPFile(loop)
    for action, message in (
        (lambda: ssp.connect("gain.y[1]", "sub.in"), r"'gain.y\[1\]' and 'sub.in' are connected already; disconnect"),
        (lambda: ssp.connect("gain.y[2]", "sub.in"), r"'gain.y\[2\]': there is no connector 'y\[2\]'; did you mean"),
        (lambda: ssp.connect("gian.y[1]", "sub.in"), r"'gian.y\[1\]': there is no element 'gian'; did you mean 'gain'"),
        (lambda: ssp.connect("gain", "sub.in"), r"'gain': there is no element 'gain'"),
        (lambda: ssp.disconnect("gain.y[1]", "sub.out"), r"are not connected; did you mean 'gain.y\[1\] -> sub.in'"),
        (lambda: ssp.connections("sbu"), r"there is no system 'sbu'; did you mean 'sub'"),
        (lambda: ssp.set_parameter("gian.K", 1.0), r"'gian.K': there is no component 'gian'; did you mean 'gain'"),
    ):
        with pytest.raises(SSPError, match=message):
            action()
    ssp.set_parameter("gain.KK", 1.0)
    before = loop.read_bytes()
    with pytest.raises(SetupError, match="component 'gain' has no variable 'KK'; did you mean 'K'"):
        ssp.write(loop)
    assert loop.read_bytes() == before
    with pytest.raises(SSPError, match="there is no such SSP; check the path"):
        SSPFile(loop.with_name("none.ssp"))
