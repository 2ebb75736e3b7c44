"""SSPs that we write: in our own master, in libcosim and fmpy, before other validators; and SSPs of another library."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Sequence
from itertools import combinations, pairwise
from pathlib import Path

import fmpy.ssp.ssd as fmpy_ssd
import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from pyssp_standard import SSD, SSP, SSV, Connection
from pyssp_standard.common_content_ssc import TypeReal
from pyssp_standard.ssd import Component, Connector, DefaultExperiment
from pyssp_standard.ssd import ParameterBinding as Binding
from pyssp_standard.ssd import System as OtherSystem

from cosim import CosimError, Results, System, simulate
from cosim.__main__ import main
from cosim.ssp.format.diagram import Box, arrange
from cosim.ssp.writer import Experiment, ParameterSet, write_ssp
from cosim.system.system import AsWritten
from parallel_robot.paper.reproduce.table import table1
from parallel_robot.scenario import load_scenario
from parallel_robot.ssp import write_robot_ssp
from tests.support.bare_host import fresh
from tests.support.libcosim_run import LIBCOSIM
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.small_fmus import FLAVOURS, build, compiled
from tests.support.ssp_files import (
    archive,
    binding,
    bindings,
    component,
    connection,
    connections,
    description,
    elements,
    linear,
    parameter_set,
    read,
)
from tests.support.tiny_models import GAIN, INTEGRATOR, REVERSED

STOP, STEP = 0.3, 1e-3
POSITION = ("plant.x_E", "plant.y_E")
#: The row of Table 1 that the robot's SSPs here take; the start values of the controller are those of (1, 1).
ROW = next(row for row in table1() if (row.mu, row.nu) == (10.0, 1.0))
GAINS = {"alpha": ROW.alpha, "beta": ROW.beta}


@pytest.fixture(scope="module")
def robot(robot_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The robot as an SSP, with gains that are not the start values of its FMU."""
    path = tmp_path_factory.mktemp("ssp") / "robot.ssp"
    write_robot_ssp(path, robot_fmus, DEFAULT_FLAVOUR, row=(ROW.mu, ROW.nu))
    return path


def by_hand(robot_fmus: Path, gains: dict[str, float], **options: object) -> Results:
    scenario = load_scenario("tracking-undisturbed")
    for name, value in gains.items():
        scenario = scenario.with_start_value("controller", name, value)
    return simulate(scenario.system(robot_fmus, DEFAULT_FLAVOUR), STOP, options.pop("step", STEP), **options)


def description_of(path: Path) -> str:
    with zipfile.ZipFile(path) as archive:
        return archive.read("SystemStructure.ssd").decode()


# Our own master


def test_the_robot_comes_back_with_its_gains(robot: Path, robot_fmus: Path) -> None:
    found = read(robot)
    assert (found.start_time, found.stop_time, found.step_size, found.notes) == (0.0, 15.0, 1e-3, ())
    results, expected = simulate(found.system, STOP, STEP), by_hand(robot_fmus, GAINS)
    assert results.names == expected.names
    assert results.values.tobytes() == expected.values.tobytes()
    assert results.info["parameters"]["controller.alpha"] == ROW.alpha
    assert not np.allclose(results["plant.x_E"], by_hand(robot_fmus, {})["plant.x_E"], rtol=0, atol=1e-7)


def test_every_row_of_table_1_is_in_the_archive(robot: Path) -> None:
    with zipfile.ZipFile(robot) as archive:
        sets = {n: archive.read(n).decode() for n in archive.namelist() if n.endswith(".ssv")}
    assert set(sets) == {f"resources/gains_mu{r.mu:g}_nu{r.nu:g}.ssv" for r in table1()} | {"resources/plant.ssv"}
    for row in table1():
        text = sets[f"resources/gains_mu{row.mu:g}_nu{row.nu:g}.ssv"]
        assert f'value="{row.alpha!r}"' in text
        assert f'value="{row.beta!r}" unit="N.m.s/rad"' in text
    text = description_of(robot)
    assert text.count('<ssd:ParameterBinding source="resources/gains_') == 1
    assert 'source="resources/gains_mu10_nu1.ssv"' in text


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    for flavour in FLAVOURS:
        build(folder / flavour, flavour, GAIN, INTEGRATOR, *([REVERSED] if flavour == "pythonfmu" else []))
    return folder


def loop(folder: Path) -> System:
    """Two FMUs in a loop, of which a vector, a transformation, start values and signals are part."""
    system = System()
    system.add("gain", folder / "Gain.fmu", start={"K": -0.5})
    system.add("again", folder / "Gain.fmu", start={"K": 3.0})
    system.add("integrator", folder / "Integrator.fmu", start={"x_start": 2.0})
    system.connect("integrator.x", "gain.u[1]", factor=2.0, offset=0.25)
    system.connect("gain.y", "again.u")
    system.connect("again.y[1]", "integrator.u", units="ignore")
    system.drive("gain.u[2]", lambda t: 0.0)
    return system


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_system_comes_back(small: Path, tmp_path: Path, flavour: str, version: str) -> None:
    path, system = tmp_path / "loop.ssp", loop(small / flavour)
    write_ssp(path, system, "loop", Experiment(2.0, 0.1, 0.5), version=version)
    found = read(path)
    assert (found.start_time, found.stop_time, found.step_size) == (0.5, 2.0, 0.1)
    results, expected = simulate(found.system, 2.0, 0.1), simulate(system, 2.0, 0.1)
    assert results.values.tobytes() == expected.values.tobytes()
    with zipfile.ZipFile(path) as archive:
        assert sorted(n for n in archive.namelist() if n.endswith(".fmu")) == [
            "resources/Gain.fmu",
            "resources/Integrator.fmu",
        ]
    text = description_of(path)
    assert ("<ssc:Float64" in text) == (version == "2.0" and flavour == "fmi3")
    first = path.read_bytes()
    write_ssp(path, system, "loop", Experiment(2.0, 0.1, 0.5), version=version)
    assert path.read_bytes() == first


def test_elements_of_vectors_are_paired_by_index(small: Path, tmp_path: Path) -> None:
    system = System()
    system.add("a", small / "pythonfmu" / "Reversed.fmu", start={"u": [1.0, 2.0]})
    system.add("b", small / "pythonfmu" / "Gain.fmu")
    system.connect("a.y", "b.u")
    write_ssp(tmp_path / "r.ssp", system, "r", Experiment(1.0, 0.5))
    assert simulate(read(tmp_path / "r.ssp").system, 1.0, 0.5)["b.y"][-1].tolist() == [2.0, 4.0]


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_values_of_all_types_come_back(tmp_path: Path, version: str) -> None:
    probe = compiled(tmp_path, "fmi2_probe")
    system = System()
    system.add("a", probe, start={"u": 0.1, "n": 3, "b": True, "e": 2, "journal": str(tmp_path / "x.txt")})
    system.add("b", probe)
    for name, kind in (("y", "u"), ("n_out", "n"), ("e_out", "e"), ("b_out", "b")):
        system.connect(f"a.{name}", f"b.{kind}")
    path = tmp_path / "types.ssp"
    write_ssp(path, system, "types", Experiment(1.0, 0.5), version=version)
    results = simulate(read(path).system, 1.0, 0.5)
    assert [results[f"b.{name}"][-1] for name in "uneb"] == [0.1, 3.0, 2.0, 1.0]
    assert '<ssc:Enumeration name="Mode" />' in description_of(path)


def test_what_an_ssp_can_not_say(small: Path, tmp_path: Path) -> None:
    def refused(system: System, message: str, *sets: ParameterSet) -> None:
        with pytest.raises(CosimError, match=message):
            write_ssp(tmp_path / "n.ssp", system, "n", Experiment(1.0, 0.1), sets)
        assert not (tmp_path / "n.ssp").exists()

    system = loop(small / "fmi2")
    system.disturb("gain.u[1]", lambda t: 1.0)
    refused(system, r"^a signal is added to 'gain.u\[1\]'; an SSP can't describe that$")
    system = System()
    system.add("slow", small / "fmi2" / "Gain.fmu", start={"u": 0.0}, every=2)
    refused(system, r"^component 'slow' has steps of its own \(every\); an SSP can't describe that$")
    system = loop(small / "fmi2")
    refused(system, "there is no component 'gian'; did you mean 'gain'", ParameterSet("s", "gian", {}))
    refused(system, "has no variable 'KK'; did you mean 'K'", ParameterSet("s", "gain", {"KK": 1.0}))
    refused(system, "two parameter sets named 's'; rename one", *[ParameterSet("s", "gain", {"K": 1.0})] * 2)
    system.connect("gain.y[1]", "gain.u[3]")
    refused(system, r"component 'gain' has no variable 'u\[3\]'")


# Other tools


def test_libcosim_gives_the_same_with_the_same_gains(robot: Path, robot_fmus: Path, tmp_path: Path) -> None:
    """It exchanges values in the parallel order, and sees component-level parameters."""
    names = [*POSITION, "controller.tau_a[1]", "controller.psi[1]", "plant.theta_a[3]", "controller.alpha"]
    n = round(STOP / STEP)
    other = fresh(tmp_path, LIBCOSIM, ssp=robot, names=names, n=n)
    assert other["time"] == pytest.approx(STEP * np.arange(1, n + 1), abs=1e-9)
    assert other["controller.alpha"][-1] == ROW.alpha
    results = simulate(read(robot).system, STOP, STEP, order="parallel", extrapolation="hold")
    for name in names[:-1]:
        expected = results[name][1:]
        np.testing.assert_allclose(other[name], expected, rtol=0, atol=1e-12 * max(1.0, np.max(np.abs(expected))))
    default = by_hand(robot_fmus, {}, order="parallel", extrapolation="hold")  # other gains would be seen
    assert np.max(np.abs(np.array(other["plant.x_E"]) - default["plant.x_E"][1:])) > 1e-7


def test_libcosim_agrees_on_transformations_and_bindings(small: Path, tmp_path: Path) -> None:
    """An SSP written by hand; units are left out, since libcosim converts none."""
    parts = elements(
        component("gain", "gain", "input u[1]", "output y[1]", bindings=bindings(binding("K Real -0.5"))),
        component("tank", "tank", "input u", "output x", bindings=bindings(binding(more=' source="resources/x.ssv"'))),
    )
    wires = connections(
        connection("tank.x", "gain.u[1]", linear(2.0, 0.25)),
        connection("gain.y[1]", "tank.u", linear(1.5, -1.0)),
    )
    fmus = {"gain": small / "fmi2" / "Gain.fmu", "tank": small / "fmi2" / "Integrator.fmu"}
    text = description(parts + wires, units="")
    path = archive(tmp_path / "hand.ssp", text, fmus, x_ssv=parameter_set("x_start Real 2.0"))
    script = LIBCOSIM.replace("ssp_path=A.ssp)", "ssp_path=A.ssp, step_size=10**7)")
    other = fresh(tmp_path, script, ssp=path, names=["tank.x", "gain.y[1]"], n=100)
    results = simulate(read(path).system, 1.0, 0.01, order="parallel", extrapolation="hold")
    assert results["tank.x"][0] == 2.0
    for name in ("tank.x", "gain.y[1]"):
        np.testing.assert_allclose(other[name], results[name][1:], rtol=0, atol=1e-12)
    # x' = 1.5 (-0.5 (2 x + 0.25)) - 1 = -1.5 x - 1.1875
    rest = -1.1875 / 1.5
    assert results["tank.x"][-1] == pytest.approx(rest + (2.0 - rest) * np.exp(-1.5), abs=0.03)


def test_fmpy_differs_by_its_delay(robot: Path, robot_fmus: Path) -> None:
    """It exchanges values in parallel too, but starts with zeros and takes parameters from its caller only.

    So it may differ by no more than a few times what halving the step changes in the parallel order, as any first-order
    coupling; with other gains it differs by more.
    """

    def run(gains: dict[str, float]) -> np.ndarray:
        values = [fmpy_ssd.Parameter(name=f"controller.{n}", value=v) for n, v in gains.items()]
        given = fmpy_ssd.ParameterSet(parameters=values)
        found = simulate_ssp(str(robot), stop_time=STOP, step_size=STEP, parameter_set=given)
        return np.column_stack([found[name][: round(STOP / STEP)] for name in POSITION])

    def ours(step: float) -> np.ndarray:
        results = simulate(read(robot).system, STOP, step, order="parallel", extrapolation="hold")
        return np.column_stack([results[name] for name in POSITION])[round(STEP / step) :: round(STEP / step)]

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.max(np.abs(a - b)))

    halving = distance(ours(STEP), ours(STEP / 2))
    assert 0.0 < distance(run(GAINS), ours(STEP)) < 4 * halving < distance(run({}), ours(STEP))


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_other_validators_find_nothing(robot_fmus: Path, tmp_path: Path, version: str) -> None:
    path = tmp_path / "v.ssp"
    write_robot_ssp(path, robot_fmus, DEFAULT_FLAVOUR, version=version)
    if version == "1.0":  # lxml with the 1.0 schemas of fmpy
        found = fmpy_ssd.read_ssd(str(path), validate=True)
        assert sorted(c.name for c in found.system.elements) == ["controller", "plant", "trajectory"]
        bound = {c.name: c.parameterBindings for c in found.system.elements}["controller"][0]
        assert [p.name for p in bound.parameterValues[0].parameters] == ["alpha", "beta"]
    with SSP(path, mode="r") as ssp:
        with ssp.system_structure as ssd:
            ssd.__check_compliance__()
            assert ssd.check_connections(unconnected_inputs=True, connector_not_in_system=True) == []
            assert ssd.version == version
        for ssv in ssp.ssv:
            ssv.__check_compliance__()


def made_elsewhere(path: Path, folder: Path) -> Path:
    """An SSP of pyssp-standard: a tank with feedback, with parameters in a file and the start value inline."""

    def component(name: str, fmu: str, connectors: Sequence[tuple[str, str]], binding: Binding) -> Component:
        made = Component()
        made.name, made.source, made.parameter_bindings = name, f"resources/{fmu}.fmu", [binding]
        made.connectors = [Connector(name=n, kind=k, type_=TypeReal(None)) for k, n in connectors]
        return made

    with SSP(path, mode="w") as ssp:
        for fmu in ("Gain", "Integrator"):
            ssp.add_resource(folder / f"{fmu}.fmu")
        values = path.parent / "values.ssv"
        with SSV(values, "w") as ssv:
            ssv.add_parameter("K", "Real", value=-0.5, unit="1")
            ssv.add_unit("1", {})
        ssp.add_resource(values)
        inline = SSV(path.parent / "inline.ssv", "w").ssv_elem
        inline.parameters.append({**ssv.parameters[0], "name": "x_start"})
        with ssp.system_structure as ssd:
            ssd: SSD
            ssd.name, ssd.version, ssd.system = "made elsewhere", "1.0", OtherSystem(None, "root")
            gain, tank = [("input", "u[1]"), ("output", "y[1]")], [("input", "u"), ("output", "x")]
            ssd.system.elements += [
                component("gain", "Gain", gain, Binding(source="resources/values.ssv")),
                component("tank", "Integrator", tank, Binding(ssv=inline)),
            ]
            for a, b in ((("tank", "x"), ("gain", "u[1]")), (("gain", "y[1]"), ("tank", "u"))):
                ssd.add_connection(
                    Connection(start_element=a[0], start_connector=a[1], end_element=b[0], end_connector=b[1])
                )
            ssd.default_experiment = DefaultExperiment()
            ssd.default_experiment.start_time, ssd.default_experiment.stop_time = 0.0, 1.0
    return path


def test_an_ssp_of_another_library(small: Path, tmp_path: Path) -> None:
    """X' = K x from x(0) = K = -0.5."""
    found = read(made_elsewhere(tmp_path / "other.ssp", small / "fmi2"))
    assert (found.name, found.stop_time, found.step_size, found.notes) == ("made elsewhere", 1.0, 0.1, ())
    errors = []
    for step in (0.1, 0.05, 0.025):
        results = simulate(found.system, 1.0, step, extrapolation="linear")
        errors.append(abs(results["tank.x"][-1] + 0.5 * np.exp(-0.5)))
    assert all(3.0 < a / b < 5.0 for a, b in pairwise(errors))  # second order
    assert errors[-1] < 1e-4


# The diagram


def crosses(box: Box, a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether a line along an axis passes through the inside of a box."""
    (x1, x2), (y1, y2) = sorted((a[0], b[0])), sorted((a[1], b[1]))
    return x1 < box.x2 and x2 > box.x1 and y1 < box.y2 and y2 > box.y1


WIRES = [
    (("source", "a"), ("middle", "u")),
    (("middle", "y"), ("end", "u")),
    (("end", "y"), ("middle", "v")),
    (("source", "b"), ("end", "v")),
    (("end", "z"), ("end", "w")),
    (("lone", "y"), ("end", "x")),
]
INPUTS = {"middle": ["u", "v"], "end": ["u", "v", "w", "x"], "source": [], "lone": []}
OUTPUTS = {"middle": ["y"], "end": ["y", "z"], "source": ["a", "b"], "lone": ["y"]}


def test_the_diagram_is_tidy() -> None:
    layout = arrange(INPUTS, OUTPUTS, WIRES)
    boxes, canvas = layout.boxes, layout.canvas
    for box in boxes.values():
        assert canvas.x1 < box.x1 < box.x2 < canvas.x2
        assert canvas.y1 < box.y1 < box.y2 < canvas.y2
    for a, b in combinations(boxes.values(), 2):
        assert a.x2 < b.x1 or b.x2 < a.x1 or a.y2 < b.y1 or b.y2 < a.y1
    verticals = []
    for (source, target), line in zip(WIRES, layout.lines, strict=True):
        ends = []
        for end in (source, target):
            box, (x, y) = boxes[end[0]], layout.connectors[end]
            ends.append((box.x1 + x * (box.x2 - box.x1), box.y1 + y * (box.y2 - box.y1)))
        assert (layout.connectors[source][0], layout.connectors[target][0]) == (1.0, 0.0)
        for a, b in pairwise([ends[0], *line, ends[1]]):
            assert a[0] == pytest.approx(b[0]) or a[1] == pytest.approx(b[1])
            assert all(canvas.y1 < p[1] < canvas.y2 and canvas.x1 < p[0] < canvas.x2 for p in (a, b))
            inner = [Box(b.x1 + 1e-6, b.y1 + 1e-6, b.x2 - 1e-6, b.y2 - 1e-6) for b in boxes.values()]
            assert not any(crosses(box, a, b) for box in inner)
        verticals += [p[0] for p in line[::2]]
    assert len(set(verticals)) == len(verticals)  # no two on one another


# Command line


@pytest.fixture
def here(robot_fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(robot_fmus / DEFAULT_FLAVOUR, tmp_path / "fmus" / DEFAULT_FLAVOUR)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("no_figures")
def test_from_the_command_line(here: Path, robot_fmus: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ssp", "--mu", "10"]) == 0
    assert "wrote RobotClosedLoop.ssp" in capsys.readouterr().out
    assert main(["run", "RobotClosedLoop.ssp", "--stop", str(STOP), "--set", "controller.alpha=2.5"]) == 0
    assert "300 ms" not in capsys.readouterr().out
    results = Results.from_csv("results/RobotClosedLoop/results.csv")
    expected = by_hand(robot_fmus, {**GAINS, "alpha": 2.5})
    assert (results.names, results.values.tolist()) == (expected.names, expected.values.tolist())
    summary = json.loads(Path("results/RobotClosedLoop/summary.json").read_text())
    assert summary["fmus"]["plant"]["path"] == "RobotClosedLoop.ssp: resources/RobotPlant.fmu"
    assert (summary["ssp"], summary["error"]) == ("RobotClosedLoop.ssp", None)
    assert summary["parameters"]["controller.beta"] == ROW.beta


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ssp", "--mu", "3"], "Table 1 has no row for mu = 3, nu = 1; its rows (mu, nu) are (1, 1), (5, 1)"),
        (["ssp", "--out", "fmus"], "can't write fmus: Is a directory; choose another --out"),
        (["run", "no.ssp"], "no.ssp: there is no such SSP"),
        (["run", "R.ssp", "--seed", "1"], "--seed is for scenarios"),
        (["run", "R.ssp", "--set", "contrller.alpha=1"], "has no component 'contrller'; did you mean 'controller'?"),
        (
            ["run", "R.ssp", "--set", "controller.theta_a[1]=1"],
            "fed by a connection or a signal; disconnect it",
        ),
        (["run", "R.ssp", "--set", "controller.alpa=1"], "R.ssp: component 'controller' has no variable 'alpa'"),
        (["run", "R.ssp", "--step", "0.7"], "R.ssp: the duration 15 s is not a whole number of steps"),
    ],
)
@pytest.mark.usefixtures("no_figures")
def test_bad_input_is_one_line(
    here: Path, robot: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    shutil.copy(robot, "R.ssp")
    assert main(arguments) == 1
    shown = capsys.readouterr().err
    assert message in shown
    assert (shown.startswith("cosim: "), shown.count("\n")) == (True, 1)


@pytest.mark.usefixtures("no_figures")
def test_errors_name_the_archive_and_not_where_it_was_unpacked(
    here: Path, robot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with zipfile.ZipFile(robot) as old, zipfile.ZipFile("B.ssp", "w") as new:
        for name in old.namelist():
            new.writestr(name, b"no FMU" if name.endswith("Plant.fmu") else old.read(name))
    assert main(["run", "B.ssp"]) == 1
    shown = capsys.readouterr().err
    assert shown.startswith(
        "cosim: component 'plant': B.ssp: resources/RobotPlant.fmu: is a text, not an FMU (not a zip archive); "
    )
    assert shown.count("\n") == 1


def test_start_values_are_written_whatever_way_they_are_given(tmp_path: Path) -> None:
    """As words and as numbers of an enumeration and a Boolean, and as a person has typed them."""
    found = []
    probe = compiled(tmp_path, "fmi2_probe")
    for i, given in enumerate(({"e": "on", "b": "true", "n": 3}, {"e": 2, "b": True, "n": AsWritten("3")})):
        system = System()
        system.add("p", probe, start=given)
        path = tmp_path / f"{i}.ssp"
        write_ssp(
            str(path), system, "words", Experiment(1.0, 0.5), [ParameterSet("off", "p", {"e": "off", "b": "false"})]
        )
        with zipfile.ZipFile(path) as written:
            found.append((written.read("resources/p.ssv"), written.read("resources/off.ssv")))
        start = read(path).system.components["p"].start
        assert {name: start[name] for name in given} == {"e": 2, "b": True, "n": 3}
    assert found[0] == found[1]
