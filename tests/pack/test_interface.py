"""The interface of a packed FMU: inputs, outputs, parameters, units, dependencies; and what can't be packed."""

from __future__ import annotations

import zipfile
from pathlib import Path

import fmpy
import pytest
from fmpy.validation import validate_fmu

from cosim import SetupError, System
from cosim.pack import pack
from cosim.regression.shipped import shipped_cases
from tests.support.fmi1_fmu import build_fmi1_tank
from tests.support.packed_fmus import VERSIONS, run_in_fmpy, small_loop
from tests.support.small_fmus import compiled


@pytest.fixture
def fmus(small_fmus: dict[str, Path]) -> Path:
    return small_fmus["fmi2"]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("foreign")
    compiled(folder, "fmi2_probe")
    compiled(folder, "fmi3_types")
    return folder


@pytest.mark.parametrize("version", VERSIONS)
def test_it_is_valid(fmus: Path, foreign: Path, tmp_path: Path, version: int) -> None:
    system = small_loop(fmus)
    system.add("p", foreign / "probe.fmu")
    system.add("t", foreign / "types.fmu")
    packed = pack(system, tmp_path / "My whole-2.fmu", 0.1, fmi=version, stop_time=2.0, description="A loop")
    assert validate_fmu(str(packed.path)) == []
    description = fmpy.read_model_description(str(packed.path))
    assert description.modelName == "My whole-2"
    assert description.coSimulation.modelIdentifier == "My_whole_2"
    assert description.description == "A loop"
    experiment = description.defaultExperiment
    assert [float(v) for v in (experiment.startTime, experiment.stopTime, experiment.stepSize)] == [0.0, 2.0, 0.1]


def test_the_same_system_gives_the_same_bytes(fmus: Path, tmp_path: Path) -> None:
    files = [pack(small_loop(fmus), tmp_path / k / "W.fmu", 0.1).path.read_bytes() for k in "ab"]
    assert files[0] == files[1]


def test_a_file_is_packed_once(fmus: Path, tmp_path: Path) -> None:
    system = System()
    for name in ("one", "two", "a/b", "CON.x"[:3]):
        system.add(name, fmus / "Integrator.fmu", start={"x_start": float(len(name))})
    packed = pack(system, tmp_path / "W.fmu", 0.1)
    with zipfile.ZipFile(packed.path) as archive:
        descriptions = [n for n in archive.namelist() if n.endswith("/modelDescription.xml")]
    assert descriptions == ["resources/one/modelDescription.xml"]
    assert run_in_fmpy(packed.path, 0.1, 0.1, ["one.x", "a/b.x"])[-1].tolist() == [3.0, 3.0]


@pytest.mark.parametrize("version", VERSIONS)
def test_chosen_inputs_and_outputs(fmus: Path, foreign: Path, tmp_path: Path, version: int) -> None:
    system = small_loop(fmus)
    system.add("t", foreign / "types.fmu")
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version, inputs=["t.Int8", "g.u[2]"], outputs=["i.x", "g.y"])
    assert packed.inputs == ("t.Int8[1]", "t.Int8[2]", "g.u[2]")
    assert packed.outputs == ("i.x", "g.y[1]", "g.y[2]")
    assert any("t.Float32[1]" in note and "keep the start values" in note for note in packed.notes)
    without = pack(system, tmp_path / "V.fmu", 0.1, fmi=version, inputs=[], outputs=[])
    assert without.inputs == without.outputs == ()


def test_what_fmi_2_has_no_type_for(foreign: Path, tmp_path: Path) -> None:
    system = System()
    system.add("t", foreign / "types.fmu")
    packed = pack(system, tmp_path / "W.fmu", 0.1)
    assert "t.Int64[1]" not in packed.inputs
    assert any(n == "output 't.UInt32_out[1]' is left out: FMI 2.0 has no type for UInt32" for n in packed.notes)
    with pytest.raises(SetupError, match=r"'t.Int64\[1\]' is of type Int64, for which FMI 2.0 has none"):
        pack(system, tmp_path / "V.fmu", 0.1, inputs=["t.Int64"])
    assert "t.Int64[1]" in pack(system, tmp_path / "V.fmu", 0.1, fmi=3).inputs


@pytest.mark.parametrize("version", VERSIONS)
def test_units_types_and_start_values(fmus: Path, foreign: Path, tmp_path: Path, version: int) -> None:
    system = small_loop(fmus)
    system.add("p", foreign / "probe.fmu", start={"e": "on", "n": 3})
    packed = pack(system, tmp_path / "W.fmu", 0.1, fmi=version)
    description = fmpy.read_model_description(str(packed.path))
    variables = {v.name: v for v in description.modelVariables}
    assert variables["i.T"].unit == "s"
    assert float(variables["i.x_start"].start) == 1.0  # the system's
    assert variables["g.K"].min == "-10.0"
    assert (variables["p.e"].start, variables["p.n"].start) == ("2", "3")
    assert [i.name for i in variables["p.e"].declaredType.items] == ["off", "on"]
    assert variables["max_step"].start == "0.1"
    units = {u.name: u for u in description.unitDefinitions}
    assert units["s"].baseUnit.s == 1


@pytest.mark.parametrize(("order", "expected"), [("sequential", {"g.u[2]"}), ("parallel", set())])
def test_dependencies_are_those_of_the_components(fmus: Path, tmp_path: Path, order: str, expected: set[str]) -> None:
    packed = pack(small_loop(fmus), tmp_path / "W.fmu", 0.1, order=order)
    outputs = {
        u.variable.name: {d.name for d in u.dependencies} for u in fmpy.read_model_description(str(packed.path)).outputs
    }
    assert outputs == {"i.x": set(), "g.y[1]": set(), "g.y[2]": expected}


def test_what_cannot_be_packed(fmus: Path, foreign: Path, tmp_path: Path) -> None:
    def refused(system: System, message: str, **options: object) -> None:
        with pytest.raises(SetupError, match=message):
            pack(system, tmp_path / "W.fmu", 0.1, **options)
        assert not (tmp_path / "W.fmu").exists()

    refused(System(), "has no components")
    function = small_loop(fmus)
    function.add_function("f", lambda t, u: u, inputs=["u"], outputs=["y"], start={"u": 0.0})
    refused(function, "component 'f' is a function in Python, which can't be packed; make it an FMU first")
    refused(small_loop(fmus), "'g.u\\[1\\]' can't be an input", inputs=["g.u"])
    refused(small_loop(fmus), "component 'g' has no variable 'v'", outputs=["g.v"])
    refused(small_loop(fmus), "is of causality input", outputs=["g.u"])
    refused(small_loop(fmus), "order 'x' is unknown", order="x")
    refused(small_loop(fmus), "stop time -1.0 s must be later", stop_time=-1.0)
    refused(small_loop(fmus), "platform 'vax' is unknown; there are: x86_64-linux", platforms=["vax"])
    refused(small_loop(fmus), "component 'i': .* has no library for x86_64-windows", platforms=["x86_64-windows"])
    refused(small_loop(fmus), "FMI 2.0 has no place", platforms=["aarch64-linux"])
    sine = small_loop(fmus)
    sine.drive("g.u[2]", lambda t: t)
    refused(sine, "feeds 'g.u\\[2\\]' has to be sampled, and it is not known until when")
    refused(sine, "would have 300000003 samples", stop_time=1e7)
    binary = System()
    for name in "ab":
        binary.add(name, foreign / "types.fmu")
    binary.connect("a.Binary_out", "b.Binary")
    refused(binary, "with binary values: that can't be packed")
    old = System()
    old.add("t", build_fmi1_tank(tmp_path / "tank.fmu"))
    refused(old, "is of FMI 1.0, which can't be packed")


def test_no_references_are_claimed_for_it(fmus: Path, tmp_path: Path) -> None:
    packed = pack(small_loop(fmus), tmp_path / "W.fmu", 0.1)
    assert shipped_cases(packed.path, tmp_path).cases == []
