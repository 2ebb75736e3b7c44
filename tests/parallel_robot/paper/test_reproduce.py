"""The reproduction as a whole: its runs, its files, the command."""

from __future__ import annotations

import argparse
import csv
import dataclasses
import hashlib
import json
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from cosim.__main__ import main
from cosim.errors import CosimError
from cosim.master.simulation import Simulation
from parallel_robot.commands import reproduce as command
from parallel_robot.fmus import build
from parallel_robot.models import MODELS
from parallel_robot.paper.reproduce import figures, run, table
from parallel_robot.paper.reproduce import runs as command_runs
from parallel_robot.paper.reproduce.content import CONDITIONS, PaperFigure, Reproduction, Runs
from parallel_robot.paper.reproduce.figures import style
from parallel_robot.paper.reproduce.material import Material
from parallel_robot.paper.reproduce.readings import ASSUMPTIONS, Assumption, _command, _start, coupled_readings
from parallel_robot.paper.reproduce.runs import Plan
from parallel_robot.scenario import load_scenario
from tests.support import some
from tests.support.reproduction import WHOLE, needs_whole

#: One figure of each kind: they are drawn with few runs, all figures with all runs.
KINDS = (4, 5, 6, 7, 8, 13)


@pytest.fixture(scope="module")
def numbers(plan: Plan) -> tuple[int, ...]:
    """Numbers of the figures that are drawn."""
    return tuple(figures.NUMBERS) if plan is WHOLE else KINDS


@pytest.fixture(scope="module")
def all_drawings(runs: Runs) -> list[style.Drawing]:
    return figures.drawings(runs)


@pytest.fixture(scope="module")
def drawings(all_drawings: list[style.Drawing], numbers: tuple[int, ...]) -> list[style.Drawing]:
    return [drawing for drawing in all_drawings if drawing.number in numbers]


@pytest.fixture(scope="module")
def content(
    runs: Runs, drawings: list[style.Drawing], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Reproduction, Path]:
    folder = tmp_path_factory.mktemp("reproduction")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(figures, "drawings", lambda _: drawings)
        return run.reproduce(runs, folder), folder


# --- runs ---


def test_all_controllers_run_under_all_conditions(runs: Runs, plan: Plan) -> None:
    assert [c.key for c in WHOLE.controllers] == ["pd", "0.1", "0.2", "1", "5", "10"]
    assert runs.controllers == plan.controllers
    keys = [c.key for c in runs.controllers]
    assert set(runs.closed_loop) == {(key, condition) for key in keys for condition in CONDITIONS}
    assert {len(r.time) for r in runs.closed_loop.values()} == {15001}


def test_conditions_are_what_they_say(runs: Runs) -> None:
    disturbed, mass, nominal = (runs.closed_loop["1", condition] for condition in CONDITIONS)
    before = disturbed.time < runs.disturbed_from
    assert np.abs(disturbed["plant.tau_d"][before]).max() == 0.0
    assert 0.005 < np.sqrt(np.mean(disturbed["plant.tau_d"][~before] ** 2)) < 0.02
    for quiet in (mass, nominal):
        assert np.abs(quiet["plant.tau_d"]).max() == 0.0
    for changing in (disturbed, mass):
        np.testing.assert_allclose(changing["plant.dm"], 0.25 * np.sin(np.pi * changing.time), atol=1e-12)
    assert np.abs(nominal["plant.dm"]).max() == 0.0


def test_pd_is_the_control_without_its_robust_part(runs: Runs) -> None:
    """The torque of PD is -beta s, to rounding."""
    r = runs.closed_loop["pd", "disturbed"]
    error = r["plant.theta_a"] - r["trajectory.theta_ref"]
    s = r["plant.omega_a"] - r["trajectory.omega_ref"] + 2.0 * error
    np.testing.assert_allclose(r["controller.tau_a"], -runs.controller("pd").beta * s, atol=1e-12)


def test_accumulated_errors_of_the_scenario_s_torque_are_those_of_its_run(material: Material) -> None:
    found = material.runs.accumulated["1", material.runs.info["seed"], 0.01]
    for name, value in some(found.items()):
        assert value == material.metric("1", name, "accumulated")


def test_readings_start_from_the_printed_law(material: Material) -> None:
    """The first two are runs of the figures; the third and the others differ from them."""
    printed, pd, *others = material.runs.readings
    for reading, key in ((printed, "1"), (pd, "pd")):
        for name, error in some(reading.steady.items()):
            assert error == material.metric(key, name, "steady_max")
        assert not reading.reaches_printed
        assert not reading.within_axes
    assert len({(r.steady["x"], r.torque_rms) for r in (printed, pd, *others)}) == len(others) + 2


@needs_whole
def test_steady_errors_of_readings_are_those_of_an_independent_check(runs: Runs) -> None:
    """Micrometres and microradians that a model in minimal coordinates gave under BDF, Radau and RK4."""
    found = {r.assumption: [1e6 * error for error in r.steady.values()] for r in runs.readings}
    for assumption, expected in {
        "k = 0.001": (12.0, 11.5, 41, 60, 55),
        "k = 0.001, gains of mu/nu = 0.1": (13.6,),
        "k = 0.001, gains of mu/nu = 10": (10.5,),
        "k = 0.0001": (2.6,),
        "no leakage in (37)": (910,),
        "no leakage, and k = 0.001": (0.055,),
        "angles in degrees in (89) and (90)": (0.12,),
        "k = 12 multiplies in (37): k in place of 1/k": (226,),
        "no leakage, and k = 12 multiplies": (28, 27, 78, 148, 86),
        "mass arrives at rest": (4160, 4120),
        "Pi = psi_1 + psi_2 |theta_a'|^2": (5260, 5980),
        "Pi = psi_1 + psi_2 |theta_a'|^2, and k = 0.001": (295, 310),
        "as printed": (3710, 4310),
    }.items():
        assert found[assumption][: len(expected)] == pytest.approx(expected, rel=0.02), assumption
    torque = {r.assumption: r.torque_max for r in runs.readings}
    assert torque["k = 0.001"] == pytest.approx(77, rel=0.01)


@needs_whole
def test_which_readings_fit(runs: Runs) -> None:
    readings = {r.assumption: r for r in runs.readings}
    within = [r for r in runs.readings if r.within_axes and r.condition == "disturbed"]
    best = min(within, key=lambda r: r.misfit)
    assert "k = 0.001" in best.assumption
    assert best.breaks == ("k >= 2 beta max S_ii", "psi within (91)")
    assert best.psi_max == pytest.approx(16.0, rel=0.02)
    # k of the paper is that of the run, unless it stands in for another law
    assert "k >= 2 beta max S_ii" in readings["no leakage, and k = 0.001"].breaks
    assert readings["no leakage, and k = 12 multiplies"].breaks == ("(37)", "psi within (91)")
    assert readings["angles in degrees in (89) and (90)"].breaks == ("(89)", "psi within (91)")
    assert readings["as printed"].breaks == ()
    assert best.misfit < 2.0
    assert not readings["as printed"].within_axes
    assert readings["PD control with beta = 3, start with the desired velocity"].within_axes
    for label in ("", *(f", gains of mu/nu = {key}" for key in ("0.1", "0.2", "5", "10"))):
        span = readings["start with the desired velocity" + label].span
        assert -5.2e-3 < span["x"][0] <= -5.0e-3
        assert span["theta_a[1]"][1] == pytest.approx(0.035, rel=0.01)
        assert span["theta_a[3]"][0] == pytest.approx(-0.0246, rel=0.01)
    moved = [readings[name].steady["x"] for name in ("as printed", "psi(0) = (0.25, 0.25)")]
    assert moved[0] == pytest.approx(moved[1], rel=1e-3)


@needs_whole
def test_the_implicit_method_gives_what_coupled_fmus_give(tmp_path: Path, runs: Runs) -> None:
    """The stiffest reading that FMUs coupled at 0.1 ms do right: k = 0.1."""
    scenario = load_scenario("tracking")
    assumption = Assumption("k = 0.1", start={"controller.k": 0.1}, step_size=1e-4)
    build(tmp_path, "fmi2")
    with Simulation(scenario.system(tmp_path, "fmi2"), order=scenario.order) as simulation:
        (coupled,) = coupled_readings(simulation, scenario, runs.controllers, [assumption], lambda _: None)
    implicit = next(r for r in runs.readings if r.assumption == "k = 0.1")
    for name, error in some(coupled.steady.items()):
        assert error == pytest.approx(implicit.steady[name], rel=1e-4)


@needs_whole
def test_commands_of_readings_run_the_same_law(
    runs: Runs, reproduction_fmus: Path, tmp_path: Path, no_figures: None
) -> None:
    """Those that take some seconds, of 15 s in steps of 0.1 ms and longer."""
    quick = [r for r in runs.readings if r.command and "0.00001" not in r.command and "0.000001" not in r.command]
    assert len(quick) > 20
    for number, reading in enumerate(r for r in quick if "--stop" not in r.command):
        folder = tmp_path / str(number)
        assert main([*reading.command.split()[1:], "--fmus", str(reproduction_fmus), "--out", str(folder)]) == 0
        found = json.loads((folder / "summary.json").read_text())["metrics"]["tracking"]
        for name, error in some(reading.steady.items()):
            assert found[name]["steady_max"] == pytest.approx(error, rel=2e-3, abs=1e-12), reading.assumption


def test_commands_of_readings_set_what_there_is() -> None:
    """Every reading has its command, but those that coupling would take hours for, or that need other signals."""
    readings = {a.label: _command(a, _start(a, table.controllers()), load_scenario("tracking")) for a in ASSUMPTIONS}
    without = {label for label, command in readings.items() if not command}
    assert without == {
        *("k = 0.0001", "angles in degrees in (89) and (90)", "mass arrives at rest"),
        *("nominal feedforward, and no disturbance torque", "nominal feedforward, and no mass change"),
    }
    assert readings["k = 0.001"] == ("cosim run tracking --set controller.k=0.001 --step 0.000001 --record-every 1000")
    assert readings["as printed, and the robot is as the model says"] == "cosim run tracking-undisturbed"
    known = {f"{component}.{v.name}" for component, model in MODELS.items() for v in model.parameters.variables}
    for name in some(re.findall(r"--set ([^=]+)=", " ".join(readings.values()))):
        assert name in known


@needs_whole
def test_the_bound_grows_with_the_gains(runs: Runs) -> None:
    assert {beta: round(later, 3) for beta, (_, later) in runs.least_bound.items()} == {100.0: 0.033, 400.0: 0.128}
    assert all(whole >= later for whole, later in runs.least_bound.values())


def test_readings_with_limits_stay_within_them(runs: Runs) -> None:
    limited = [r.torque_max for r in runs.readings if "motors of 0.1 N m" in r.assumption]
    assert limited == [0.1]


# --- Table 1 ---


@pytest.mark.parametrize(
    ("value", "printed", "expected"),
    [(1.35976, "1.3597", True), (1.35976, "1.3598", True), (1.3596, "1.3597", False), (1.3599, "1.3597", False)],
)
def test_agreement_allows_rounding_and_cutting(value: float, printed: str, expected: bool) -> None:
    assert table.agrees(value, printed) is expected


def test_table_1_is_the_paper_s() -> None:
    rows = table.table1()
    assert [(f"{r.mu:g}", f"{r.nu:g}", f"{r.beta:.4f}", f"{r.J:.4f}") for r in rows] == [
        ("1", "1", "1.6620", "9.1329"),
        ("5", "1", "1.9337", "18.9766"),
        ("10", "1", "2.1671", "29.3006"),
        ("1", "10", "1.1195", "34.1584"),
        ("1", "5", "1.2535", "22.3282"),
    ]
    assert all(r.agrees for r in rows)


# --- figures ---


def test_figures_4_to_17_are_drawn(all_drawings: list[style.Drawing]) -> None:
    assert [drawing.number for drawing in all_drawings] == list(range(4, 18)) == list(figures.NUMBERS)


@pytest.mark.slow
def test_every_figure_is_there_as_vectors_and_pixels(
    content: tuple[Reproduction, Path], numbers: tuple[int, ...]
) -> None:
    found = content[0].figures
    assert tuple(f.number for f in found) == numbers
    for figure in found:
        assert ET.parse(figure.svg).getroot().tag.endswith("svg")
        height, width, _ = matplotlib.image.imread(figure.png).shape
        assert width > 800
        assert height > 400


@pytest.mark.slow
def test_every_figure_says_what_it_shows_in_words(content: tuple[Reproduction, Path]) -> None:
    for figure in some(content[0].figures):
        for text in (figure.title, figure.caption, figure.alt):
            assert text
            assert not any(sign in text for sign in "$\\{}")
        assert len(figure.alt) > 60


def test_controllers_are_told_apart_by_colour_by_dashes_and_by_marker() -> None:
    for what in ("color", "linestyle", "marker"):
        assert len({str(line[what]) for line in style.CONTROLLER_LINES.values()}) == len(style.CONTROLLER_LINES)


def test_no_text_is_cut_and_every_axis_has_its_unit(drawings: list[style.Drawing]) -> None:
    """Everything that is drawn lies inside the page."""
    from matplotlib import style as mpl_style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    for drawing in some(drawings):
        with mpl_style.context(style.STYLE):
            figure = Figure(figsize=drawing.size, layout="constrained")
            drawing.draw(figure)
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
            page = figure.bbox
            for axes in some(figure.axes):
                box = axes.get_tightbbox(canvas.get_renderer())
                assert box is not None
                assert box.x0 > -2, drawing.number
                assert box.y0 > -2, drawing.number
                assert box.x1 < page.x1 + 2, drawing.number
                assert box.y1 < page.y1 + 2, drawing.number
                if axes.get_label() != "<colorbar>":
                    for label in (axes.get_xlabel(), axes.get_ylabel()):
                        assert label.endswith(")"), (drawing.number, label)


# --- files ---


def test_tables_hold_everything(content: tuple[Reproduction, Path]) -> None:
    found, folder = content
    rows = list(csv.DictReader((folder / "table1.csv").read_text(encoding="utf-8").splitlines()))
    assert [float(r["alpha"]) for r in rows] == [r.alpha for r in found.table1]
    claims = json.loads((folder / "claims.json").read_text())["claims"]
    assert [c["verdict"] for c in claims] == [c.verdict for c in found.claims]
    errata = json.loads((folder / "errata.json").read_text())
    assert [e["id"] for e in errata["errata"]] == [e.id for e in found.errata]
    assert [t["controller"] for t in errata["theorem1"]] == [c.key for c in found.runs.proposed]
    summary = json.loads((folder / "summary.json").read_text())
    assert sum(summary["verdicts"].values()) == len(found.claims)
    assert summary["table1_agrees"] is True


def digests(folder: Path) -> dict[str, str]:
    """Of all files but the page, and of the summary without its list of files, which has to be right."""
    files = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    summary = json.loads(files["summary.json"])
    found = {name: hashlib.sha256(data).hexdigest() for name, data in files.items() if name != "summary.json"}
    assert summary.pop("files", found) == found
    content = hashlib.sha256(json.dumps(summary).encode()).hexdigest()
    return {name: sha for name, sha in found.items() if not name.endswith(".html")} | {"summary": content}


# --- the command ---


def parsed(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    command.register(parser.add_subparsers())
    return parser.parse_args(["reproduce", *arguments])


def test_the_command_writes_one_folder(
    content: tuple[Reproduction, Path],
    plan: Plan,
    reproduction_fmus: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With the runs that are made and the figures that are drawn already."""
    found, before = content

    def runs_of_before(folder: Path, progress: Callable[[str], None]) -> Runs:
        assert folder == reproduction_fmus
        for i in range(plan.number_of_runs):
            progress(f"run {i}")
        return found.runs

    def figures_of_before(_: Runs, folder: Path, progress: Callable[[str], None]) -> tuple[PaperFigure, ...]:
        shutil.copytree(before / "figures", folder)
        for number in figures.NUMBERS:
            progress(f"figure {number}")
        return found.figures

    said: list[str] = []
    monkeypatch.setattr(command, "_progress", lambda total: nullcontext(said.append))
    monkeypatch.setattr(
        command, "_write_report", lambda content, folder, *further: (folder / "report.html").write_text("")
    )
    monkeypatch.setattr(command_runs, "run_all", runs_of_before)
    monkeypatch.setattr(run, "write_figures", figures_of_before)
    assert command.run(parsed("--out", str(tmp_path / "out"), "--fmus", str(reproduction_fmus))) == 0
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {"figures", "table1.csv", "claims.json", "errata.json", "summary.json", "report.html"}
    assert digests(tmp_path / "out") == digests(before)
    assert len(said) == run.number_of_steps() - WHOLE.number_of_runs + plan.number_of_runs
    output = capsys.readouterr().out
    assert "Table 1: 5 of 5 rows" in output
    assert "claims:" in output


def test_a_figure_has_the_same_bytes_each_time(
    content: tuple[Reproduction, Path], drawings: list[style.Drawing], tmp_path: Path
) -> None:
    for path in some(style.save(drawings[0], tmp_path)):
        assert path.read_bytes() == (content[1] / "figures" / path.name).read_bytes()


@needs_whole
def test_the_command_writes_the_same_bytes_each_time(
    content: tuple[Reproduction, Path],
    tmp_path: Path,
    reproduction_fmus: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From new runs on: every file but the page, which has its own tests."""
    said: list[str] = []
    monkeypatch.setattr(command, "_progress", lambda total: nullcontext(said.append))
    monkeypatch.setattr(
        command, "_write_report", lambda content, folder, *further: (folder / "report.html").write_text("")
    )
    assert command.run(parsed("--out", str(tmp_path / "out"), "--fmus", str(reproduction_fmus))) == 0
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {"figures", "table1.csv", "claims.json", "errata.json", "summary.json", "report.html"}
    assert digests(tmp_path / "out") == digests(content[1])
    assert len(said) == run.number_of_steps()


def test_the_command_refuses_a_folder_it_cannot_write(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CosimError, match="can't write into"):
        command.run(parsed("--out", str(tmp_path / "file" / "out")))


def test_the_command_fails_when_table_1_differs(content: tuple[Reproduction, Path]) -> None:
    found = content[0]
    wrong = dataclasses.replace(found.table1[0], agrees=False)
    with pytest.raises(command.ReproductionError, match=r"row \(1, 1\)"):
        command._check(dataclasses.replace(found, table1=(wrong, *found.table1[1:])))
    hidden = dataclasses.replace(found.errata[0], shown=False)
    with pytest.raises(command.ReproductionError, match=hidden.id):
        command._check(dataclasses.replace(found, errata=(hidden, *found.errata[1:])))
    command._check(found)
