"""OSP configurations written by hand, held against the same systems coupled by hand, and against libcosim."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from cosim import System, simulate
from cosim.__main__ import main
from cosim.osp import OSPError, read_osp
from tests.support.bare_host import fresh
from tests.support.changed_fmus import in_millimetres
from tests.support.libcosim_run import LIBCOSIM
from tests.support.small_fmus import build, compiled
from tests.support.tiny_models import GAIN, INTEGRATOR
from tests.support.tiny_models import UNITS as LENGTHS
from tests.support.tiny_models import build as build_tiny

SPACE = 'xmlns="http://opensimulationplatform.com/MSMI/OSPSystemStructure" version="0.1"'

TIMES = (
    "<StartTime>0.0</StartTime><EndTime>1.0</EndTime><BaseStepSize>0.25</BaseStepSize><Algorithm>fixedStep</Algorithm>"
)


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of small FMUs."""
    folder = build_tiny(tmp_path_factory.mktemp("osp"), GAIN, INTEGRATOR, LENGTHS)
    in_millimetres(folder / "Units.fmu", folder / "mm.fmu", 'factor="0.001"')
    compiled(folder, "fmi2_probe").rename(folder / "Probe.fmu")
    return folder


def simulator(name: str, fmu: str, *values: str, more: str = "") -> str:
    """A simulator, with initial values from `name Type value`."""
    inner = ""
    for item in values:
        variable, kind, value = item.split()
        inner += f'<InitialValue variable="{variable}"><{kind} value="{value}"/></InitialValue>'
    held = f"<InitialValues>{inner}</InitialValues>" if inner else ""
    return f'<Simulator name="{name}" source="{fmu}"{more}>{held}</Simulator>'


def _end(kind: str, path: str) -> str:
    owner, _, name = path.partition(".")
    key = "function" if kind.startswith("Signal") else "simulator"
    return f'<{kind} {key}="{owner}" name="{name}"/>'


def variables(a: str, b: str, more: str = "") -> str:
    return f"<VariableConnection{more}>{_end('Variable', a)}{_end('Variable', b)}</VariableConnection>"


def groups(a: str, b: str) -> str:
    return f"<VariableGroupConnection>{_end('VariableGroup', a)}{_end('VariableGroup', b)}</VariableGroupConnection>"


def signal(function: str, variable: str) -> str:
    return f"<SignalConnection>{_end('Signal', function)}{_end('Variable', variable)}</SignalConnection>"


def signal_group(function: str, group: str) -> str:
    ends = _end("VariableGroup", group) + _end("SignalGroup", function)
    return f"<SignalGroupConnection>{ends}</SignalGroupConnection>"


def configuration(
    folder: Path, fmus: Path, simulators: str, connections: str = "", functions: str = "", times: str | None = None
) -> Path:
    """A folder with a configuration, and the FMUs beside it."""
    folder.mkdir(exist_ok=True)
    for fmu in fmus.glob("*.fmu"):
        shutil.copy(fmu, folder)
    head = TIMES if times is None else times
    between = f"<Functions>{functions}</Functions>" if functions else ""
    (folder / "OspSystemStructure.xml").write_text(
        f'<?xml version="1.0" encoding="UTF-8"?><OspSystemStructure {SPACE}>{head}'
        f"<Simulators>{simulators}</Simulators>{between}<Connections>{connections}</Connections></OspSystemStructure>"
    )
    return folder


def assert_equal_runs(found: System, by_hand: System) -> None:
    results, expected = (simulate(s, 1.0, 0.25) for s in (found, by_hand))
    assert results.names == expected.names
    assert results.values.tobytes() == expected.values.tobytes()


SIMULATORS = simulator("gain", "Gain.fmu", "K Real -0.5") + simulator("tank", "Integrator.fmu", "x_start Real 2.0")


def loop_by_hand(fmus: Path) -> System:
    system = System()
    system.add("gain", fmus / "Gain.fmu", start={"u[2]": 0.0, "K": -0.5})
    system.add("tank", fmus / "Integrator.fmu", start={"x_start": 2.0})
    system.connect("gain.y[1]", "tank.u")
    system.connect("tank.x", "gain.u[1]")
    return system


LOOP = variables("gain.y[1]", "tank.u") + variables("gain.u[1]", "tank.x")  # the second one from its target


@pytest.mark.parametrize("way", ["folder", "file", "other name"])
def test_a_configuration_is_the_system_that_it_describes(fmus: Path, tmp_path: Path, way: str) -> None:
    path = configuration(tmp_path / "loop", fmus, SIMULATORS, LOOP)
    file = path / "OspSystemStructure.xml"
    if way == "other name":
        file = file.rename(path / "Variant.xml")
    found = read_osp(path if way == "folder" else file)
    assert (found.start_time, found.stop_time, found.step_size) == (0.0, 1.0, 0.25)
    assert (found.name, found.notes) == ("Variant" if way == "other name" else "loop", ())
    assert_equal_runs(found.system, loop_by_hand(fmus))


@pytest.mark.parametrize("source", ["../my%20fmus/Gain.fmu", "../my fmus/Gain.fmu", "{uri}"])
def test_sources_elsewhere(fmus: Path, tmp_path: Path, source: str) -> None:
    (tmp_path / "my fmus").mkdir()
    fmu = shutil.copy(fmus / "Gain.fmu", tmp_path / "my fmus")
    text = SIMULATORS.replace('"Gain.fmu"', f'"{source.format(uri=Path(fmu).as_uri())}"')
    assert_equal_runs(read_osp(configuration(tmp_path / "s", fmus, text, LOOP)).system, loop_by_hand(fmus))


def test_values_of_all_types(fmus: Path, tmp_path: Path, plain_path: Path) -> None:
    journal = f"{plain_path}/journal.txt"
    values = ("u Real 1.5", "n Integer 3", "b Boolean 1", "e Integer 2", f"journal String {journal}")
    found = read_osp(configuration(tmp_path / "v", fmus, simulator("p", "Probe.fmu", *values)))
    assert found.system.components["p"].start == {"u": 1.5, "n": 3, "b": True, "e": 2, "journal": journal}
    results = simulate(found.system, 1.0, 0.5)
    assert [results[f"p.{name}"][-1] for name in ("y", "n_out", "b_out", "e_out")] == [1.5, 3.0, 1.0, 2.0]


def test_steps_of_simulators(fmus: Path, tmp_path: Path) -> None:
    def every(step: str) -> tuple[int, tuple[str, ...]]:
        text = SIMULATORS.replace('source="Integrator.fmu"', f'source="Integrator.fmu" stepSize="{step}"')
        found = read_osp(configuration(tmp_path / "s", fmus, text, LOOP))
        return found.system.components["tank"].every, found.notes

    assert every("0.5") == (2, ())
    assert every("0") == (1, ())
    (note,) = every("0.51")[1]
    assert (every("0.51")[0], every("0.1")[0]) == (2, 1)
    assert note.endswith("stepSize 0.51 s is not a multiple of 0.25 s; 0.5 s is taken, as libcosim does")


def test_a_step_in_place_of_the_base_step(fmus: Path, tmp_path: Path) -> None:
    text = SIMULATORS.replace('source="Integrator.fmu"', 'source="Integrator.fmu" stepSize="0.5"')
    found = read_osp(configuration(tmp_path / "s", fmus, text, LOOP), step_size=0.1)
    assert (found.step_size, found.system.components["tank"].every, found.notes) == (0.1, 5, ())


def test_times_that_are_not_said(fmus: Path, tmp_path: Path) -> None:
    found = read_osp(configuration(tmp_path / "t", fmus, SIMULATORS, LOOP, times="<Algorithm>ecco</Algorithm>"))
    assert (found.start_time, found.stop_time, found.step_size) == (0.0, 1.0, 0.1)
    assert [re.sub(r"^.*\.xml: ", "", note) for note in found.notes] == [
        "has no BaseStepSize; 0.1 s is taken, as libcosim does",
        "algorithm 'ecco' is not supported; the step is fixed, 0.1 s",
        "has no EndTime; 1 s is taken, the latest of its FMUs' default experiments in whole steps",
    ]
    times = "<StartTime>2.0</StartTime><BaseStepSize>0.3</BaseStepSize>"  # the experiments of the FMUs end before
    late = configuration(tmp_path / "late", fmus, SIMULATORS, LOOP, times=times)
    assert (read_osp(late).stop_time, read_osp(late).notes) == (None, ())
    found = read_osp(late, duration=1.0)
    assert found.stop_time == pytest.approx(3.2)
    assert "say when to stop; 3.2 s is taken, 1.2 s after the start (--stop)" in found.notes[0]
    assert read_osp(late, start_time=0.5).stop_time == pytest.approx(1.1)


# Functions


def test_a_linear_transformation_is_one_of_the_connection(fmus: Path, tmp_path: Path) -> None:
    function = '<LinearTransformation name="f" factor="2.5" offset="0.5"/>'
    ways = variables("gain.u[1]", "tank.x") + signal("f.in", "gain.y[1]") + signal("f.out", "tank.u")
    found = read_osp(configuration(tmp_path / "l", fmus, SIMULATORS, ways, function))
    by_hand = System()
    by_hand.components.update(loop_by_hand(fmus).components)
    by_hand.connect("tank.x", "gain.u[1]")
    by_hand.connect("gain.y[1]", "tank.u", factor=2.5, offset=0.5)
    assert_equal_runs(found.system, by_hand)


def test_a_sum_is_a_component(fmus: Path, tmp_path: Path) -> None:
    sims = SIMULATORS + simulator("other", "Gain.fmu", "u[1] Real 3.0", "u[2] Real 5.0")
    ways = (
        variables("gain.u[1]", "tank.x")
        + signal("s.in[0]", "gain.y[1]")
        + signal("s.in[1]", "other.y[1]")
        + signal("s.in[2]", "other.y[2]")
        + signal("s.out", "tank.u")
    )
    found = read_osp(configuration(tmp_path / "s", fmus, sims, ways, '<Sum name="s" inputCount="3"/>'))
    results = simulate(found.system, 1.0, 0.25, order="sequential", extrapolation="hold")
    level = 2.0
    for row in range(5):  # x += h (K x + 2 * 3 + 2 * 5), held over a step
        assert results["tank.x"][row] == pytest.approx(level, rel=1e-12)
        assert results["s.out"][row] == pytest.approx(-0.5 * level + 16.0, rel=1e-12)
        level += 0.25 * (-0.5 * level + 16.0)


MODEL = """<OspModelDescription xmlns="{space}" version="1.0"><UnitDefinitions/><VariableGroups>
<Generic name="in"><Variable ref="u[1]"/><Variable ref="u[2]"/></Generic>
<Generic name="both"><Generic name="out"><Variable ref="y[2]"/><Variable ref="y[1]" unit="N"/></Generic></Generic>
<LinearMechanicalPort name="port"><Force name="force"><Variable ref="u[1]"/></Force>
<LinearVelocity name="velocity"><Variable ref="y[1]"/></LinearVelocity></LinearMechanicalPort>
</VariableGroups></OspModelDescription>"""


def described(folder: Path) -> Path:
    space = "https://open-simulation-platform.com/OspModelDescription/1.0.0"
    (folder / "Gain_OspModelDescription.xml").write_text(MODEL.format(space=space))
    return folder


def test_groups_are_connected_in_their_order(fmus: Path, tmp_path: Path) -> None:
    sims = simulator("a", "Gain.fmu", "u[1] Real 3.0", "u[2] Real 5.0") + simulator("b", "Gain.fmu")
    folder = described(configuration(tmp_path / "g", fmus, sims, groups("b.in", "a.out")))
    found = read_osp(folder)
    assert {(c.source, c.target) for c in found.system.connections} == {("a.y[2]", "b.u[1]"), ("a.y[1]", "b.u[2]")}
    described(configuration(tmp_path / "p", fmus, sims, groups("b.in", "a.in")))
    with pytest.raises(OSPError, match=r"2 things are wrong: .*'b.u\[1\]' is input and 'a.u\[1\]' input; one end must"):
        read_osp(tmp_path / "p")
    described(configuration(tmp_path / "q", fmus, sims, groups("b.in", "a.both")))
    with pytest.raises(OSPError, match=r"'in' has 2 variables and 0 groups, 'both' 0 and 1; only groups of one struct"):
        read_osp(tmp_path / "q")


def test_ports_have_both_directions(fmus: Path, tmp_path: Path) -> None:
    """A force in and a velocity out, as a bond between two of them crosses: u of each is y of the other."""
    sims = simulator("a", "Gain.fmu") + simulator("b", "Gain.fmu")
    model = MODEL.replace('name="force"><Variable ref="u[1]"', 'name="force"><Variable ref="y[1]"')
    other = model.replace('name="velocity"><Variable ref="y[1]"', 'name="velocity"><Variable ref="u[1]"')
    folder = configuration(tmp_path / "b", fmus, sims, groups("a.port", "b.port"))
    (folder / "Gain_OspModelDescription.xml").write_text(other.format(space="x"))
    with pytest.raises(OSPError, match="one end must give values"):
        read_osp(folder)


def test_groups_without_a_description(fmus: Path, tmp_path: Path) -> None:
    sims = simulator("a", "Gain.fmu") + simulator("b", "Gain.fmu")
    folder = configuration(tmp_path / "n", fmus, sims, groups("a.out", "b.in"))
    with pytest.raises(OSPError, match=r"simulator 'a' has no variable groups: there is no Gain_OspModel"):
        read_osp(folder)
    described(folder)
    (folder / "OspSystemStructure.xml").write_text(
        (folder / "OspSystemStructure.xml").read_text().replace('name="out"', 'name="uot"')
    )
    with pytest.raises(OSPError, match=r"there is no variable group 'uot'"):
        read_osp(folder)


def test_a_sum_of_vectors(fmus: Path, tmp_path: Path) -> None:
    sims = (
        simulator("a", "Gain.fmu", "u[1] Real 3.0", "u[2] Real 5.0")
        + simulator("b", "Gain.fmu", "u[1] Real 7.0", "u[2] Real 11.0")
        + simulator("c", "Gain.fmu")
    )
    ways = signal_group("v.in[0]", "a.out") + signal_group("v.in[1]", "b.out") + signal_group("v.out", "c.in")
    function = '<VectorSum name="v" inputCount="2" dimension="2"/>'
    found = read_osp(described(configuration(tmp_path / "v", fmus, sims, ways, function)))
    results = simulate(found.system, 1.0, 0.25)
    # out is y[2], y[1] = 2 u[2], 2 u[1]; c doubles the sum
    assert [results[f"c.y[{i}]"][-1] for i in (1, 2)] == [2 * (10.0 + 22.0), 2 * (6.0 + 14.0)]


@pytest.mark.parametrize(
    ("function", "ways", "message"),
    [
        (
            '<Sum name="s" inputCount="2"/>',
            signal("s.in[0]", "gain.y[1]"),
            r"nothing feeds in\[1\] of Sum 's'",
        ),
        ('<Sum name="s" inputCount="2"/>', signal("s.in[2]", "gain.y[1]"), r"Sum 's' has no signal 'in\[2\]'; did you"),
        ('<Sum name="s" inputCount="two"/>', "", r"Sum 's': inputCount is 'two', which is not a number"),
        ('<Sum name="s" inputCount="0"/>', "", r"inputCount is 0.0; it must be a positive whole number"),
        ('<Sum name="s"/>', "", r"a Sum has no inputCount; give it one"),
        ('<Sum name="s" inputCount="9999999"/>', "", r"has 9999999 inputs, more than any system needs"),
        ('<Product name="s"/>', "", r"Product 's' is a function that is not known; known are LinearTransformation"),
        ('<LinearTransformation name="s" factor="x"/>', "", r"factor is 'x', which is not a number; correct it"),
        ('<LinearTransformation name="s"/>', signal("s.in", "tank.u"), r"both ends are inputs; one end must give"),
        ('<LinearTransformation name="s"/>', signal("t.in", "tank.x"), r"there is no function 't'"),
        ('<LinearTransformation name="tank"/>', "", r"there are two simulators or functions named 'tank'; rename one"),
    ],
)
def test_functions_that_are_none(fmus: Path, tmp_path: Path, function: str, ways: str, message: str) -> None:
    folder = configuration(tmp_path / "f", fmus, SIMULATORS, ways, function)
    with pytest.raises(OSPError, match=message) as caught:
        read_osp(folder)
    assert "\n" not in str(caught.value)


# What is noted


def test_what_is_noted(fmus: Path, tmp_path: Path) -> None:
    sims = simulator("a", "Units.fmu", "length Real 2.0") + simulator("b", "mm.fmu")
    ways = variables("a.place", "b.length", ' powerBond="p"')
    folder = configuration(tmp_path / "n", fmus, sims, ways)
    found = read_osp(folder)
    assert [re.sub(r"^.*\.xml: ", "", note) for note in found.notes] == [
        "connection 'a.place' - 'b.length': that it is half of power bond 'p' is ignored",
        "'a.place' is in 'm' and 'b.length' in 'mm'; the number is taken as it is, as libcosim does "
        "(--units convert converts it)",
    ]
    assert simulate(found.system, 1.0, 0.5)["b.length"][-1] == 2.0
    converted = read_osp(folder, units="convert")
    assert len(converted.notes) == 1
    assert simulate(converted.system, 1.0, 0.5)["b.length"][-1] == pytest.approx(2000.0)


# What is refused


def test_all_that_is_wrong_is_said_at_once(fmus: Path, tmp_path: Path) -> None:
    sims = (
        simulator("a", "None.fmu")
        + simulator("b", "proxyfmu://host:9090?file=Gain.fmu")
        + simulator("c", "Gain.fmu", "KK Real 1.0", "K Real x")
    )
    ways = variables("a.y", "c.u[1]") + variables("d.y", "c.u[1]") + variables("c.y[3]", "c.u[1]")
    folder = configuration(tmp_path / "w", fmus, sims, ways)
    with pytest.raises(OSPError) as caught:
        read_osp(folder)
    message = str(caught.value)
    file = folder / "OspSystemStructure.xml"
    assert message.startswith(f"{file}: 6 things are wrong: (1) simulator 'a': has no 'None.fmu'; ")
    for part in (
        "(2) simulator 'b': 'proxyfmu://host:9090?file=Gain.fmu' is not a file of this folder; it is meant for",
        "(3) simulator 'c': initial value of 'KK', which the FMU does not have; did you mean 'K'?",
        "(4) simulator 'c': initial value of 'K': 'x' is not of type Real; correct it",
        "(5) connection of variable 'y': there is no simulator 'd'",
        "(6) connection 'c.y[3]' - 'c.u[1]': simulator 'c' has no variable 'y[3]'; did you mean 'y[2]'?",
    ):
        assert part in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no XML", "not readable as XML"),
        ("<SystemStructure/>", "is not an OspSystemStructure, but a SystemStructure; check the path"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><OspSystemStructure/>', "has a document type, which could define entities"),
        ("<OspSystemStructure><BaseStepSize>fast</BaseStepSize></OspSystemStructure>", "BaseStepSize is 'fast', which"),
        ("<OspSystemStructure><BaseStepSize>-1</BaseStepSize></OspSystemStructure>", "it must be a positive number of"),
        (
            "<OspSystemStructure><Connections><PipeConnection/></Connections></OspSystemStructure>",
            "a PipeConnection is not known",
        ),
    ],
)
def test_files_that_are_none(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "OspSystemStructure.xml").write_text(text)
    with pytest.raises(OSPError, match=message):
        read_osp(tmp_path)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(OSPError, match=r"OspSystemStructure.xml: can't be read: No such file"):
        read_osp(tmp_path)


def test_a_configuration_without_simulators(fmus: Path, tmp_path: Path) -> None:
    with pytest.raises(OSPError, match=r"OspSystemStructure\.xml: has no simulators; name FMUs there, in Simulator el"):
        read_osp(configuration(tmp_path / "none", fmus, ""))


# The command line


@pytest.mark.usefixtures("no_figures")
def test_from_the_command_line(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    configuration(Path("loop"), fmus, SIMULATORS.replace('"Integrator.fmu"', '"Integrator.fmu" stepSize="0.3"'), LOOP)
    assert main(["run", "loop", "--set", "gain.K=-1"]) == 0
    assert "note: loop/OspSystemStructure.xml: simulator 'tank': stepSize 0.3 s" in capsys.readouterr().out
    summary = json.loads(Path("results/loop/summary.json").read_text())
    assert (summary["osp"], summary["parameters"]["gain.K"], len(summary["notes"])) == ("loop", -1.0, 1)
    assert (summary["order"], summary["extrapolation"]["mode"]) == ("parallel", "hold")  # as libcosim's algorithm
    assert main(["run", "loop/OspSystemStructure.xml", "--stop", "0.5", "--order", "sequential"]) == 0
    summary = json.loads(Path("results/OspSystemStructure/summary.json").read_text())
    assert (summary["order"], summary["extrapolation"]["mode"]) == ("sequential", "hold")
    assert main(["run", "loop", "--ssv", "x.ssv"]) == 1
    assert "--ssv is for SSPs; an OSP configuration takes start values by --set" in capsys.readouterr().err


def test_configurations_are_swept(
    fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    configuration(Path("loop"), fmus, SIMULATORS, LOOP)
    options = ["--vary", "gain.K=-1,-0.5", "--metric", "end=final:tank.x", "--workers", "1"]
    assert main(["sweep", "loop", *options]) == 0, capsys.readouterr().err
    ways = signal("s.in[0]", "gain.y[1]") + signal("s.in[1]", "gain.y[2]") + signal("s.out", "tank.u")
    configuration(Path("sum"), fmus, SIMULATORS, ways, '<Sum name="s" inputCount="2"/>')
    assert main(["sweep", "sum", *options]) == 1
    assert "sum: 's' maps or sums values, which sweeps can't do yet" in capsys.readouterr().err


def test_of_two_descriptions_one_is_read(fmus: Path, tmp_path: Path) -> None:
    folder = configuration(tmp_path / "two", fmus, SIMULATORS, LOOP)
    (folder / "SystemStructure.ssd").write_text("not read")
    assert read_osp(folder).notes == (f"{folder}: has SystemStructure.ssd, too, which is not read; name it to run it",)
    assert read_osp(folder / "OspSystemStructure.xml").notes == ()


def test_a_folder_with_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    assert main(["run", "empty"]) == 1
    assert "empty: has no SystemStructure.ssd, nor OspSystemStructure.xml; name a folder" in capsys.readouterr().err


# libcosim


def test_libcosim_gives_the_same(tmp_path: Path) -> None:
    """In parallel order with held inputs, up to rounding; a function is evaluated where its inputs are set."""
    folder = build(tmp_path / "native", "fmi2", GAIN, INTEGRATOR, LENGTHS)
    function = '<LinearTransformation name="f" factor="2.5" offset="0.5"/>'
    ways = variables("gain.u[1]", "tank.x") + signal("f.in", "gain.y[1]") + signal("f.out", "tank.u")
    path = configuration(tmp_path / "c", folder, SIMULATORS, ways, function)
    script = LIBCOSIM.replace("from_ssp_file(ssp_path=A.ssp)", "from_osp_config_file(osp_path=A.ssp)")
    other = fresh(tmp_path, script, ssp=path, names=["tank.x", "gain.y[1]"], n=4)
    found = read_osp(path)
    results = simulate(found.system, 1.0, 0.25, order=found.order, extrapolation=found.extrapolation)
    for name in ("tank.x", "gain.y[1]"):
        np.testing.assert_allclose(other[name], results[name][1:], rtol=0, atol=1e-12)


def test_libcosim_reads_groups_and_steps_alike(tmp_path: Path) -> None:
    folder = build(tmp_path / "native", "fmi2", GAIN, INTEGRATOR)
    sims = (
        simulator("a", "Gain.fmu", "u[1] Real 3.0", "u[2] Real 5.0")
        + simulator("b", "Gain.fmu")
        + simulator("tank", "Integrator.fmu", more=' stepSize="0.5"')
    )
    ways = groups("b.in", "a.out") + variables("b.y[1]", "tank.u")
    path = described(configuration(tmp_path / "g", folder, sims, ways))
    script = LIBCOSIM.replace("from_ssp_file(ssp_path=A.ssp)", "from_osp_config_file(osp_path=A.ssp)")
    names = ["b.y[1]", "b.y[2]", "tank.x"]
    other = fresh(tmp_path, script, ssp=path, names=names, n=4)
    results = simulate(read_osp(path).system, 1.0, 0.25, order="parallel", extrapolation="hold")
    for name in names:  # it samples what has made a step
        expected = results[name][2::2] if name == "tank.x" else results[name][1:]
        np.testing.assert_allclose(other[name], expected, rtol=0, atol=1e-12)
