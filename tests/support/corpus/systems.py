"""SSPs, SSDs and OSP configurations that are broken, hostile, or unclean."""

from __future__ import annotations

import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

from tests.support.corpus.case import REFUSED, RUNS, Case, Materials, Member, fmu_2, in_memory, members_2, zipped
from tests.support.ssp_files import (
    SPACES,
    binding,
    bindings,
    component,
    connection,
    connections,
    connectors,
    description,
    elements,
    parameter_set,
)

_ONE = elements(component("a", "x", "input u", "output y"))
_TWO = elements(component("a", "x", "input u", "output y"), component("b", "x", "input u", "output y"))
_PLAIN = description(_TWO + connections(connection("a.y", "b.u")))


def _ssp(name: str, text: str | bytes, *more: Member, expected: str = REFUSED, says: str = "") -> Case:
    """An SSP of a description, the FMU, and further members."""

    def make(folder: Path, materials: Materials) -> Path:
        data = text.encode() if isinstance(text, str) else text
        fmu = ("resources/x.fmu", in_memory(*members_2(materials)))
        return zipped(folder / "s.ssp", ("SystemStructure.ssd", data), fmu, *more)

    return Case(f"SSP: {name}", make, expected, says, "system", arguments=("--step", "0.1"))


def _made(name: str, make: Callable[[Path, Materials], Path], says: str = "", expected: str = REFUSED) -> Case:
    return Case(name, make, expected, says, "system", arguments=("--step", "0.1"))


def _archive(name: str, *members: Member, says: str = "") -> Case:
    return _made(f"SSP: {name}", lambda folder, m: zipped(folder / "s.ssp", *members), says)


def _bytes(name: str, data: bytes, says: str = "") -> Case:
    def make(folder: Path, materials: Materials) -> Path:
        (folder / "s.ssp").write_bytes(data)
        return folder / "s.ssp"

    return _made(f"SSP: {name}", make, says)


def _osp(name: str, text: str, says: str = "", expected: str = REFUSED) -> Case:
    """An OSP configuration beside the FMU."""

    def make(folder: Path, materials: Materials) -> Path:
        fmu_2(folder, materials)
        (folder / "OspSystemStructure.xml").write_text(text, encoding="utf-8")
        return folder / "OspSystemStructure.xml"

    return Case(f"OSP: {name}", make, expected, says, "system", arguments=("--stop", "1"))


def _link(name: str, target: str) -> Member:
    info = zipfile.ZipInfo(name)
    info.create_system, info.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
    return info, target.encode()


def _nested(depth: int) -> str:
    system = elements(component("a", "x", "input u", "output y"))
    for k in range(depth):
        system = elements(f'<ssd:System name="s{k}">{system}</ssd:System>')
    return description(system)


def _itself(folder: Path, materials: Materials) -> Path:
    inner = '<ssd:Component name="a" type="application/x-ssp-definition" source="SystemStructure.ssd"/>'
    return zipped(folder / "s.ssp", ("SystemStructure.ssd", description(elements(inner)).encode()))


def _packages(folder: Path, materials: Materials) -> Path:
    """SSPs in SSPs, fifty deep."""
    data = in_memory(
        ("SystemStructure.ssd", description(_ONE).encode()), ("resources/x.fmu", in_memory(*members_2(materials)))
    )
    inner = '<ssd:Component name="a" type="application/x-ssp-package" source="resources/s.ssp"/>'
    for _ in range(50):
        data = in_memory(("SystemStructure.ssd", description(elements(inner)).encode()), ("resources/s.ssp", data))
    (folder / "s.ssp").write_bytes(data)
    return folder / "s.ssp"


def _bad_fmu(name: str, data: bytes, says: str) -> Case:
    members = (("SystemStructure.ssd", description(_ONE).encode()), ("resources/x.fmu", data))
    return _archive(name, *members, says=says)


def _folder(folder: Path, materials: Materials) -> Path:
    (folder / "resources").mkdir()
    fmu_2(folder / "resources", materials)
    (folder / "SystemStructure.ssd").write_text(_PLAIN, encoding="utf-8")
    return folder


def _source(source: str) -> str:
    return description(f'<ssd:Elements><ssd:Component name="a" source="{source}"/></ssd:Elements>')


_ENTITY = '<!DOCTYPE x [<!ENTITY e "x">]>'
_HEAD = '<?xml version="1.0" encoding="UTF-8"?>'
_DEEP = f"<ssd:SystemStructureDescription {SPACES}>" + "<ssd:System name='a'><ssd:Elements>" * 5000
_OSP = '<OspSystemStructure version="0.1"><BaseStepSize>0.1</BaseStepSize>{}</OspSystemStructure>'
_SIMULATORS = '<Simulators><Simulator name="a" source="x.fmu"/><Simulator name="b" source="x.fmu"/></Simulators>'
_FED = (
    '<Connections><VariableConnection><Variable simulator="a" name="y"/><Variable simulator="b" name="u"/>'
    "</VariableConnection></Connections>"
)
_BOUND = binding("u Real 2")


def _of_a(more: str) -> str:
    return description(elements(component("a", "x", "input u", "output y", bindings=bindings(more))))


SYSTEMS: tuple[Case, ...] = (
    _ssp("as it is", _PLAIN, expected=RUNS),
    _made("SSP: a folder", _folder, expected=RUNS),
    _bytes("an empty file", b"", "s.ssp"),
    _bytes("a text", b"hello", "s.ssp"),
    _bytes("a magic number only", b"PK\3\4", "s.ssp"),
    _archive("no members", says="SystemStructure.ssd"),
    _archive("no description", ("readme", b""), says="has no 'SystemStructure.ssd'"),
    _archive("a description in a folder", ("S/SystemStructure.ssd", _PLAIN.encode()), says="SystemStructure.ssd"),
    _ssp("an empty description", "", says="SystemStructure.ssd"),
    _ssp("a description that is a text", "hello", says="SystemStructure.ssd"),
    _ssp("a description that is an image", b"\x89PNG\r\n\x1a\n" + bytes(100), says="SystemStructure.ssd"),
    _ssp("a description cut off", _PLAIN[:500], says="SystemStructure.ssd"),
    _ssp("an unknown encoding", '<?xml version="1.0" encoding="uuf-8"?><a/>', says="not readable as XML"),
    _ssp("a description of zeros", bytes(100), says="SystemStructure.ssd"),
    _ssp("a description in UTF-16", _PLAIN.replace("UTF-8", "UTF-16").encode("utf-16"), expected=RUNS),
    _ssp("a description with a byte order mark", _PLAIN.encode("utf-8-sig"), expected=RUNS),
    _ssp("another encoding than it says", _PLAIN.replace("UTF-8", "UTF-16"), says="SystemStructure.ssd"),
    _ssp("bytes that are not UTF-8", _PLAIN.encode().replace(b"by hand", b"\xff"), says="SystemStructure.ssd"),
    _ssp("entities", _PLAIN.replace(_HEAD, _HEAD + _ENTITY), says="SystemStructure.ssd"),
    _ssp("5,000 nested systems", _DEEP, says="SystemStructure.ssd"),
    _ssp("systems nested 60 deep", _nested(60), says="nested"),
    _ssp("systems nested 200 deep", _nested(200), says="SystemStructure.ssd"),
    _ssp("another root", f"<ssd:Nothing {SPACES}/>", says="Nothing"),
    _ssp("no namespace", "<SystemStructureDescription/>", says="no namespace"),
    _ssp("no system", f'<ssd:SystemStructureDescription {SPACES} version="1.0" name="x"/>', says="has no System"),
    _ssp("no components", description(""), says="has no components"),
    _ssp("version 9", _PLAIN.replace('version="1.0"', 'version="9.0"', 1).replace('version="1.0" name', 'version="9.0" name'),
         says=""),
    _ssp("a path out of it", _PLAIN, ("../escaped", b""), says="leads out of the archive"),
    _ssp("a link", _PLAIN, _link("resources/l", "/etc"), says="is a link"),
    _ssp("a description twice", _PLAIN, ("SystemStructure.ssd", b"<x/>"), says="twice, with different contents"),
    _ssp("70 MiB of zeros", _PLAIN, ("resources/z", bytes(10)), expected=RUNS),
    _ssp("a source out of it", _source("../../etc/passwd"), says="is not a file of this archive"),
    _ssp("a source of the system", _source("file:///etc/passwd"), says="etc/passwd"),
    _ssp("a source of another machine", _source("http://127.0.0.1:9/x.fmu"), says="is not a file of this archive"),
    _ssp("a source that is not a URI", _source("http://[x"), says="is not a URI"),
    _ssp("a source that is not there", _source("resources/y.fmu"), says="has no 'resources/y.fmu'"),
    _ssp("an empty source", _source(""), says="s.ssp"),
    _ssp("a source of a NUL", _source("resources/%00x.fmu"), says="s.ssp"),
    _ssp("a source of a device", _source("file:///dev/zero"), says=""),
    _ssp("two components of one name", description(elements(component("a", "x"), component("a", "x"))),
         says="two elements named 'a'"),
    _ssp("a connection of nothing", description(_ONE + connections(connection("a.y", "c.u"))), says="no element 'c'"),
    _ssp("a connection to no connector", description(_ONE + connections(connection("a.y", "a.w"))), says="w"),
    _ssp("a connection to itself", description(_ONE + connections(connection("a.y", "a.u"))), expected=RUNS),
    _ssp("an input that is fed twice",
         description(elements(*(component(n, "x", "input u", "output y") for n in "abc"))
                     + connections(connection("a.y", "c.u"), connection("b.y", "c.u"))), says="c"),
    _ssp("connectors in a circle",
         description('<ssd:Connectors/>' + elements(
             '<ssd:System name="s">' + connectors("input i", "output o") + connections(connection(".i", ".o"))
             + "</ssd:System>", component("a", "x", "input u", "output y"))
             + connections(connection("s.o", "s.i"), connection("s.o", "a.u"))), says=""),
    _ssp("a parameter of NaN", _of_a(binding("u Real NaN")), says=""),
    _ssp("a parameter of infinity", _of_a(binding("u Real INF")), says=""),
    _ssp("a parameter that is not a number", _of_a(binding("u Real two")), says="u"),
    _ssp("a parameter of another type", _of_a(binding("u String two")), says="u"),
    _ssp("a parameter of no variable", _of_a(binding("w Real 2")), expected=RUNS),
    _ssp("a parameter set that is not there", _of_a(binding(more=' source="resources/p.ssv"')), says="p.ssv"),
    _ssp("a parameter set that is a text", _of_a(binding(more=' source="resources/p.ssv"')), ("resources/p.ssv", b"x"),
         says="p.ssv"),
    _ssp("a parameter set with entities", _of_a(binding(more=' source="resources/p.ssv"')),
         ("resources/p.ssv", (_ENTITY + parameter_set("u Real 2")).encode()), says="p.ssv"),
    _ssp("a parameter set that is a description", _of_a(binding(more=' source="SystemStructure.ssd"')),
         says="not a ParameterSet"),
    _ssp("a parameter twice", _of_a(binding("u Real 2", "u Real 3")), expected=RUNS),
    _ssp("a name with an escape code", description(elements(component("a\x9b31m", "x", "input u", "output y"))),
         expected=RUNS),
    _ssp("a stop time that is not a number", _PLAIN.replace('stopTime="1.0"', 'stopTime="soon"'), says="stopTime"),
    _ssp("a stop time of NaN", _PLAIN.replace('stopTime="1.0"', 'stopTime="NaN"'), says=""),
    _ssp("a stop time before the start", _PLAIN.replace('stopTime="1.0"', 'stopTime="-1.0"'), says=""),
    _ssp("an unknown type of component",
         description('<ssd:Elements><ssd:Component name="a" type="x/y" source="resources/x.fmu"/></ssd:Elements>'),
         says="is of type x/y"),
    _bad_fmu("an FMU that is a text", b"hello", "resources/x.fmu"),
    _bad_fmu("an FMU that is empty", b"", "resources/x.fmu"),
    _bad_fmu("an FMU with a path out of it", in_memory(("../x", b"")), "leads out of the archive"),
    _bad_fmu("an FMU without a library", in_memory(("modelDescription.xml", b"<fmiModelDescription/>")), "fmiVersion"),
    _made("SSP: itself as a component", _itself, "has itself as a component"),
    _made("SSP: packages nested 50 deep", _packages, ""),
    # OSP
    _osp("as it is", _OSP.format(_SIMULATORS + _FED), expected=RUNS),
    _osp("an empty file", "", "not readable as XML"),
    _osp("another root", "<x/>", ""),
    _osp("entities", '<!DOCTYPE x [<!ENTITY e "0.1">]>' + _OSP.format(_SIMULATORS), "document type"),
    _osp("5,000 nested elements", _OSP.format("<a>" * 5000 + "</a>" * 5000), ""),
    _osp("no simulators", _OSP.format(""), "has no simulators"),
    _osp("a simulator without a source", _OSP.format('<Simulators><Simulator name="a"/></Simulators>'), "has no source"),
    _osp("a simulator without a name", _OSP.format('<Simulators><Simulator source="x.fmu"/></Simulators>'), "has no name"),
    _osp("two simulators of one name", _OSP.format(_SIMULATORS.replace('"b"', '"a"')), "named 'a'"),
    _osp("an FMU that is not there", _OSP.format(_SIMULATORS.replace("x.fmu", "y.fmu")), "y.fmu"),
    _osp("a step of NaN", _OSP.replace("0.1</Base", "NaN</Base").format(_SIMULATORS), "BaseStepSize"),
    _osp("a step that is not a number", _OSP.replace("0.1</Base", "short</Base").format(_SIMULATORS), "not a number"),
    _osp("a negative step", _OSP.replace("0.1</Base", "-1</Base").format(_SIMULATORS), "positive"),
    _osp("a connection of no simulator", _OSP.format(_SIMULATORS + _FED.replace('"b"', '"c"')), "no simulator 'c'"),
    _osp("a connection of one end", _OSP.format(
        _SIMULATORS + _FED.replace('<Variable simulator="b" name="u"/>', "")), "it must have 2"),
)  # fmt: skip
