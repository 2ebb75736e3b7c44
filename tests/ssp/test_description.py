"""What stands in the files of an SSP that we write, read by an XML parser of its own."""

from __future__ import annotations

import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

from cosim import System
from cosim.ssp.errors import SSPError
from cosim.ssp.format.schema import NAMESPACES
from cosim.ssp.writer import Experiment, ParameterSet, write_ssp
from tests.support.small_fmus import redescribed
from tests.support.tiny_models import UNITS, build

EXPONENTS = {"kg": "-1", "m": "2", "s": "-3", "A": "4", "K": "-5", "mol": "6", "cd": "-7", "rad": "8"}

JOULE = {"kg": "1", "m": "2", "s": "-2"}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`plain` passes a torque and a length on; in `all` the length is in a unit that has all there is."""
    folder = build(tmp_path_factory.mktemp("description"), UNITS)
    every = " ".join(f'{base}="{n}"' for base, n in EXPONENTS.items()) + ' factor="2.5" offset="-0.5"'
    redescribed(folder / "Units.fmu", folder / "all.fmu", {'<BaseUnit m="1"': f"<BaseUnit {every}"})
    for base in EXPONENTS:
        redescribed(folder / "Units.fmu", folder / f"{base}.fmu", {'<BaseUnit m="1"': f'<BaseUnit {base}="-1"'})
    return folder


def pair(fmu: Path, **connection: object) -> System:
    system = System()
    system.add("a", fmu, start={"torque": 1.0, "length": 2.0})
    system.add("b", fmu, start={"torque": 1.0})
    system.connect("a.place", "b.length", **connection)
    return system


def written(path: Path, system: System, *sets: ParameterSet, name: str = "two") -> ElementTree.Element:
    """The description of a system in an SSP."""
    write_ssp(path, system, name, Experiment(2.5, 0.25, 0.5), sets)
    with zipfile.ZipFile(path) as archive:
        return ElementTree.fromstring(archive.read("SystemStructure.ssd"))


def units(root: ElementTree.Element) -> dict[str, dict[str, str]]:
    found = root.findall(".//ssc:Unit", NAMESPACES)
    return {u.attrib["name"]: u.find("ssc:BaseUnit", NAMESPACES).attrib for u in found}


def test_units_have_all_exponents_that_are_not_0(fmus: Path, tmp_path: Path) -> None:
    assert units(written(tmp_path / "a.ssp", pair(fmus / "all.fmu"))) == {
        "m": {**EXPONENTS, "factor": "2.5", "offset": "-0.5"},
        "J": JOULE,
    }
    for base in EXPONENTS:
        assert units(written(tmp_path / f"{base}.ssp", pair(fmus / f"{base}.fmu"))) == {"m": {base: "-1"}, "J": JOULE}


def test_two_units_of_one_name_are_refused(fmus: Path, tmp_path: Path) -> None:
    system = pair(fmus / "Units.fmu", units="ignore")
    system.add("c", fmus / "kg.fmu", start={"torque": 1.0})
    system.connect("b.place", "c.length", units="ignore")
    with pytest.raises(SSPError, match=r"^two FMUs have different units of the name 'm'; rename one of them$"):
        written(tmp_path / "r.ssp", system)


@pytest.mark.parametrize(
    ("connection", "attributes", "transformation"),
    [
        ({}, {}, None),
        ({"units": "convert"}, {}, None),
        ({"units": "ignore"}, {"suppressUnitConversion": "true"}, None),
        ({"factor": 2.0}, {}, {"factor": "2.0", "offset": "0.0"}),
        ({"offset": 0.1}, {}, {"factor": "1.0", "offset": "0.1"}),
        (
            {"factor": -0.3, "offset": 1e-9, "units": "ignore"},
            {"suppressUnitConversion": "true"},
            {"factor": "-0.3", "offset": "1e-09"},
        ),
    ],
)
def test_connections_with_what_they_do(
    fmus: Path, tmp_path: Path, connection: dict[str, object], attributes: dict[str, str], transformation: object
) -> None:
    root = written(tmp_path / "c.ssp", pair(fmus / "Units.fmu", **connection))
    (found,) = root.findall(".//ssd:Connection", NAMESPACES)
    ends = {"startElement": "a", "startConnector": "place", "endElement": "b", "endConnector": "length"}
    assert found.attrib == ends | attributes
    linear = found.find("ssc:LinearTransformation", NAMESPACES)
    assert (None if linear is None else linear.attrib) == transformation


def test_experiment_and_step_are_where_other_tools_look(fmus: Path, tmp_path: Path) -> None:
    root = written(tmp_path / "e.ssp", pair(fmus / "Units.fmu"), name="two tanks, 1.0")
    experiment = root.find("ssd:DefaultExperiment", NAMESPACES)
    assert experiment.attrib == {"startTime": "0.5", "stopTime": "2.5"}
    steps = [e.attrib for e in root.iter() if {"baseStepSize", "stepSize"} & set(e.attrib)]
    assert steps == [{"description": "oms-ma", "stepSize": "0.25"}, {"baseStepSize": "0.25"}]
    assert (root.attrib["name"], root.find("ssd:System", NAMESPACES).attrib["name"]) == (
        "two tanks, 1.0",
        "two_tanks__1_0",
    )


def test_the_diagram_is_in_the_description(fmus: Path, tmp_path: Path) -> None:
    """Two boxes of two outputs each; the line goes from the second one to the only input; see test_diagram."""
    root = written(tmp_path / "d.ssp", pair(fmus / "Units.fmu"))
    corners = [box.attrib for box in root.findall(".//ssd:ElementGeometry", NAMESPACES)]
    assert corners == [
        {"x1": "24", "y1": "-15", "x2": "84", "y2": "0"},
        {"x1": "108", "y1": "-15", "x2": "168", "y2": "0"},
    ]
    (line,) = root.findall(".//ssd:ConnectionGeometry", NAMESPACES)
    assert line.attrib == {"pointsX": "96 96", "pointsY": "-10 -5"}
    extent = root.find("ssd:System/ssd:SystemGeometry", NAMESPACES)
    assert extent.attrib == {"x1": "-12", "y1": "-27", "x2": "192", "y2": "12"}


def test_only_bound_parameter_sets_are_taken(fmus: Path, tmp_path: Path) -> None:
    system = pair(fmus / "Units.fmu")
    free = ParameterSet("free", "b", {"torque": 5.0}, "To be chosen")
    bound = ParameterSet("bound", "b", {"torque": 6.0}, bound=True)
    root = written(tmp_path / "new" / "folder" / "p.ssp", system, free, bound)
    sources = {
        c.attrib["name"]: [b.attrib["source"] for b in c.findall(".//ssd:ParameterBinding", NAMESPACES)]
        for c in root.findall(".//ssd:Component", NAMESPACES)
    }
    assert sources == {"a": ["resources/a.ssv"], "b": ["resources/b.ssv", "resources/bound.ssv"]}
    with zipfile.ZipFile(tmp_path / "new" / "folder" / "p.ssp") as archive:
        assert archive.namelist().count("resources/Units.fmu") == 1
        values = ElementTree.fromstring(archive.read("resources/free.ssv"))
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    assert values.attrib["description"] == "To be chosen"
    (real,) = values.findall(".//ssv:Real", NAMESPACES)
    assert real.attrib == {"value": "5.0", "unit": "N.m"}
    assert units(values) == {"N.m": JOULE}
