"""`cosim run FILE.fmu`: one FMU, its default experiment, values of every type, and inputs from a CSV file."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from cosim.__main__ import main
from cosim.results.columns import TypedColumn
from cosim.results.plot_file import write_plot
from cosim.results.results import Results
from tests.support.quirks import Quirk, quirky
from tests.support.small_fmus import TANK, build, compiled, redescribed


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tank.fmu, which takes linear inputs; probe.fmu with inputs of every type; smooth.fmu with a continuous one."""
    folder = build(tmp_path_factory.mktemp("made"), "fmi2", TANK)
    probe = compiled(folder, "fmi2_probe")
    discrete = '<ScalarVariable name="u" valueReference="0" causality="input" variability="discrete">'
    redescribed(probe, folder / "smooth.fmu", {discrete: discrete.replace("discrete", "continuous")})
    return folder


@pytest.fixture
def here(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_figures: None) -> Path:
    for path in made.glob("*.fmu"):
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def results(name: str) -> Results:
    return Results.from_csv(f"results/{name}/results.csv")


def summary(name: str) -> dict:
    return json.loads(Path(f"results/{name}/summary.json").read_text(encoding="utf-8"))


def error_line(capsys: pytest.CaptureFixture[str]) -> str:
    said = capsys.readouterr().err
    assert said.startswith("cosim: ")
    assert said.count("\n") == 1
    return said


@pytest.mark.usefixtures("here")
def test_the_default_experiment_of_the_fmu(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "Tank.fmu"]) == 0
    found = results("Tank")
    assert found.time == pytest.approx(np.arange(11) * 0.1, abs=1e-15)
    assert found.names == ["Tank.a", "Tank.b", "Tank.x"]
    assert not found.values.any()
    shown = capsys.readouterr().out
    assert "keep the start values of their FMUs: Tank.a, Tank.b" in shown
    assert "results and summary: results/Tank" in shown  # figures are left out here
    about = summary("Tank")
    assert (about["fmu"], about["title"], about["status"]) == ("Tank.fmu", "Tank", "completed")
    assert (about["inputs_kept"], about["driven"], about["metrics"]) == (["Tank.a", "Tank.b"], [], {})


@pytest.mark.usefixtures("here")
def test_a_page_of_the_run_if_one_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "Tank.fmu", "--report", "--set", "a=0.25"]) == 0
    page = Path("results/Tank/report.html")
    assert capsys.readouterr().out.splitlines()[-2:] == [f"page: {page}", "results and summary: results/Tank"]
    text = page.read_text(encoding="utf-8")
    about = summary("Tank")
    for said in ("<h1>Tank</h1>", about["fmus"]["Tank"]["sha256"], "Tank.x", "0.25"):
        assert said in text
    assert about["files"]["report.html"] == hashlib.sha256(page.read_bytes()).hexdigest()
    assert main(["run", "Tank.fmu"]) == 0  # without a page, and the one of the run before is no longer right
    assert not page.exists()
    assert "page:" not in capsys.readouterr().out


@pytest.mark.usefixtures("here")
def test_times_and_start_values_of_options(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--start", "2", "--stop", "3", "--step", "0.25", "--set", "Tank.x_start=1", "--set", "a=0.5"]
    assert main(["run", "Tank.fmu", *options, "--record-every", "2"]) == 0
    assert "keep the start values of their FMUs: Tank.b\n" in capsys.readouterr().out
    found = results("Tank")
    assert found.time.tolist() == [2.0, 2.5, 3.0]
    assert found["Tank.x"] == pytest.approx([1.0, 1.25, 1.5], rel=1e-12)


@pytest.mark.usefixtures("here")
def test_names_to_record_need_not_name_the_only_component(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "Tank.fmu", "--record", "x", "--record", "Tank.a"]) == 0
    assert results("Tank").names == ["Tank.x", "Tank.a"]
    capsys.readouterr()
    assert main(["run", "Tank.fmu", "--record", "level"]) == 1
    assert "component 'Tank' has no variable 'level'; known are" in error_line(capsys)


@pytest.mark.usefixtures("here")
def test_an_fmu_that_says_no_times_is_run_for_a_second_in_500_steps(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "probe.fmu", "--start", "1"]) == 0
    said = "probe.fmu has no default stop time; it is 2 s here, 1 s after the start (--stop)"
    assert f"note: {said}\n" in capsys.readouterr().out
    assert results("probe").time[[0, -1]].tolist() == [1.0, 2.0]
    assert said in json.loads(Path("results/probe/summary.json").read_text())["notes"]
    assert main(["run", "probe.fmu", "--stop", "2"]) == 0
    assert "note: probe.fmu has no default step; it is 0.004 s here" in capsys.readouterr().out
    assert len(results("probe").time) == 501


@pytest.mark.parametrize(
    ("attributes", "end", "rows", "said"),
    [
        ('stopTime="0" stepSize="0.1"', 1.0, 11, 'has stopTime="0" in its default experiment, which makes no sense'),
        ('startTime="2" stopTime="1" stepSize="0.5"', 3.0, 3, 'has stopTime="1" in its default experiment, which'),
        ('stopTime="2" stepSize="0"', 2.0, 501, 'has stepSize="0" in its default experiment, which makes no sense'),
        ('stopTime="1" stepSize="0.3"', 1.0, 5, "asks for steps of 0.3 s, of which the run is not a whole number; it"),
        ('stopTime="1" stepSize="10"', 1.0, 2, "asks for steps of 10 s, of which the run is not a whole number; it is"),
    ],
)
def test_a_default_experiment_that_makes_no_sense_is_said_and_run_otherwise(
    here: Path, capsys: pytest.CaptureFixture[str], attributes: str, end: float, rows: int, said: str
) -> None:
    redescribed(
        here / "probe.fmu", here / "odd.fmu", {"<ModelVariables>": f"<DefaultExperiment {attributes}/><ModelVariables>"}
    )
    assert main(["run", "odd.fmu"]) == 0
    assert f"note: odd.fmu {said}" in capsys.readouterr().out
    found = results("odd").time
    assert (len(found), found[-1]) == (rows, pytest.approx(end, abs=1e-12))
    assert any(said in note for note in summary("odd")["notes"])


@pytest.mark.usefixtures("no_figures")
def test_what_an_fmu_does_when_it_is_told_that_the_run_is_over_is_in_the_summary_and_on_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Though all was written before."""
    fmu = quirky(tmp_path, Quirk.FAILS_TO_TERMINATE, experiment='stopTime="1" stepSize="0.5"')
    command = ["run", str(fmu), "--out", str(tmp_path / "o"), "--log", "info", "--report"]
    for _ in range(2):  # the second one takes the place of the first
        assert main(command) == 0
        said = f"{fmu.stem} failed at t = 1 s: fmi2Terminate returned error"
        assert capsys.readouterr().out.splitlines()[-1] == f"note: {said}"
        about = json.loads((tmp_path / "o/summary.json").read_text(encoding="utf-8"))
        assert (about["status"], about["not_terminated"]) == ("completed", {fmu.stem: said})
        assert set(about["files"]) == {"messages.log", "report.html", "results.csv"}
        for name, sha256 in about["files"].items():
            assert hashlib.sha256((tmp_path / "o" / name).read_bytes()).hexdigest() == sha256
        assert said in (tmp_path / "o/report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("here")
def test_results_of_a_run_drive_the_next_one(capsys: pytest.CaptureFixture[str]) -> None:
    Path("in.csv").write_text("time,Tank.a,b\n0,1,2\n1,3,4\n", encoding="utf-8")
    assert main(["run", "Tank.fmu", "--input", "in.csv", "--out", "first"]) == 0
    capsys.readouterr()
    assert main(["run", "Tank.fmu", "--input", "first/results.csv", "--out", "second"]) == 0
    assert "results.csv has 1 more columns, which are not inputs of the FMU" in capsys.readouterr().out
    assert Path("second/results.csv").read_bytes() == Path("first/results.csv").read_bytes()


@pytest.mark.usefixtures("here")
def test_values_of_every_type_are_read_by_the_type_of_their_variable() -> None:
    values = ["u=1.5", "n=-3", "e=on", "b=true", "journal=5"]  # a text of digits is a text where the variable is one
    options = [part for value in values for part in ("--set", value)]
    assert main(["run", "probe.fmu", "--stop", "0.1", "--step", "0.1", *options]) == 0
    found = results("probe")
    assert [found[f"probe.{name}"][-1] for name in ("y", "n_out", "e_out", "b_out")] == [1.5, -3.0, 2.0, 1.0]
    assert Path("5").stat().st_size > 0  # where the FMU keeps its journal
    assert summary("probe")["start_values"] == {
        "probe.u": 1.5,
        "probe.n": -3,
        "probe.e": "on",
        "probe.b": True,
        "probe.journal": "5",
    }


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("b=maybe", "start value of 'probe.b': 'maybe' is not a value of type Boolean"),
        ("b=2", "start value of 'probe.b': 2 is not a value of type Boolean"),
        ("e=onn", "start value of 'probe.e': 'onn' is not a value of type Enumeration; did you mean 'on'?"),
        ("n=1.5", "start value of 'probe.n': 1.5 is not a value of type Integer"),
        ("n=true", "start value of 'probe.n': 'true' is not a value of type Integer"),
        ("u=", "start value of 'probe.u': '' is not a value of type Real"),
        ("y=1", "start value of 'probe.y'"),
        ("w=1", "component 'probe' has no variable 'w'"),
        ("u", "--set u: write COMPONENT.NAME=VALUE"),
    ],
)
def test_values_that_do_not_fit_are_one_line(capsys: pytest.CaptureFixture[str], value: str, says: str) -> None:
    assert main(["run", "probe.fmu", "--stop", "0.1", "--step", "0.1", "--set", value]) == 1
    assert says in error_line(capsys)


# Inputs


TABLE = "time,u,n,b\n0,0,1,0\n1,2,3,1\n1,5,3,1\n2,7,4,0\n"


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("fmu", ["probe", "smooth"])
def test_continuous_inputs_are_linear_between_rows_and_others_held(fmu: str) -> None:
    Path("in.csv").write_text(TABLE, encoding="utf-8")
    options = ["--stop", "2", "--step", "0.25", "--extrapolation", "hold"]
    assert main(["run", f"{fmu}.fmu", "--input", "in.csv", *options]) == 0
    found = results(fmu)
    linear, held = [0.0, 0.5, 1.0, 1.5, 5.0, 5.5, 6.0, 6.5, 7.0], [0.0] * 4 + [5.0] * 4 + [7.0]
    assert found[f"{fmu}.u"] == pytest.approx(linear if fmu == "smooth" else held, rel=1e-14)
    assert found[f"{fmu}.n"].tolist() == [1.0] * 4 + [3.0] * 4 + [4.0]
    assert found[f"{fmu}.b"].tolist() == [0.0] * 4 + [1.0] * 4 + [0.0]
    assert summary(fmu)["driven"] == ["u", "n", "b"]
    assert summary(fmu)["inputs_kept"] == [f"{fmu}.e"]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (' stepSize="', ' stepSize="fast', "default experiment has stepSize='fast"),
        (
            'modelIdentifier="Tank"',
            'modelIdentifier="../Tank"',
            "its model identifier '../Tank' is not a name of a library",
        ),
        ('fmiVersion="2.0"', "", "not a readable FMU: modelDescription.xml, it has no fmiVersion"),
        ('<Unknown index="', '<Unknown index="99', "its ModelStructure refers to variable '99"),
    ],
)
def test_what_is_wrong_with_a_description_is_named(
    capsys: pytest.CaptureFixture[str], before: str, after: str, message: str
) -> None:
    redescribed(Path("Tank.fmu"), Path("odd.fmu"), {before: after})
    assert main(["run", "odd.fmu"]) == 1
    assert message in error_line(capsys)
    if "standard" in message:
        assert main(["validate", "odd.fmu"]) == 1
        assert message in capsys.readouterr().out.splitlines()[0]


def test_texts_are_left_out_of_the_plot(tmp_path: Path) -> None:
    found = Results(
        np.arange(3.0), ["s", "x"], np.zeros((3, 2)), {}, {"s": TypedColumn("string", np.array(list("abc")))}
    )
    assert write_plot(found, "t", tmp_path) == [tmp_path / "results.png"]
    assert write_plot(dataclasses.replace(found, names=["s"], values=found.values[:, :1]), "t", tmp_path) == []


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("name", ["in.csv", "in.parquet", "in.npz", "in.mat", "in.json"])
def test_inputs_of_any_format(capsys: pytest.CaptureFixture[str], name: str) -> None:
    Path("comma.csv").write_text("Time;b;a [1]\n0;0;0\n1;0;0,5\n", encoding="utf-8")
    Results.read("comma.csv").save(name)
    assert main(["run", "Tank.fmu", "--input", name]) == 0
    found = results("Tank")
    assert found["Tank.a"] == pytest.approx(0.5 * found.time, abs=1e-15)
    assert summary("Tank")["driven"] == ["b", "a"]


@pytest.mark.usefixtures("here")
def test_a_trajectory_drives_the_inputs_and_the_rest_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    Results(np.arange(2.0), ["a", "x", "other"], np.ones((2, 3))).save("all.mat")
    assert main(["run", "Tank.fmu", "--input", "all.mat"]) == 0
    assert "note: all.mat has 2 more columns, which are not inputs of the FMU" in capsys.readouterr().out
    assert summary("Tank")["driven"] == ["a"]
    Results(np.arange(2.0), ["x", "other"], np.ones((2, 2))).save("all.mat")
    assert main(["run", "Tank.fmu", "--input", "all.mat"]) == 1
    assert "all.mat: the FMU has no input 'x'" in error_line(capsys)


@pytest.mark.usefixtures("here")
def test_an_input_in_another_unit_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    Path("in.csv").write_text("time,a [furlong]\n0,1\n1,1\n", encoding="utf-8")
    assert main(["run", "Tank.fmu", "--input", "in.csv"]) == 1
    assert "in.csv: column 'a' is in 'furlong', the input in '" in error_line(capsys)


@pytest.mark.usefixtures("here")
def test_booleans_whole_numbers_and_units_of_a_table() -> None:
    Path("in.csv").write_text("time;b;u\n0;true;0,5\n1;FALSE;1,5\n", encoding="utf-8")
    options = ["--stop", "1", "--step", "0.5", "--units-row", "--extrapolation", "hold"]
    assert main(["run", "probe.fmu", "--input", "in.csv", *options]) == 0
    found = results("probe")
    assert found["probe.b"].tolist() == [1.0, 1.0, 0.0]
    lines = Path("results/probe/results.csv").read_text(encoding="utf-8").splitlines()
    assert lines[1].startswith('"s",')
    assert len(lines) == 5


@pytest.mark.usefixtures("here")
def test_the_integral_of_a_linear_input_is_exact_across_its_jump() -> None:
    Path("in.csv").write_text("time,a\n0,0\n0.5,2\n0.5,-1\n1,-1\n", encoding="utf-8")
    assert main(["run", "Tank.fmu", "--input", "in.csv"]) == 0
    time, x = results("Tank").time, results("Tank")["Tank.x"]
    expected = np.where(time <= 0.5, 2.0 * time**2, 0.5 - (time - 0.5))
    assert x == pytest.approx(expected, abs=1e-12)


@pytest.mark.usefixtures("here")
def test_outside_of_the_rows_the_first_and_the_last_hold_and_it_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    Path("in.csv").write_text("time,u\n0.5,1\n0.75,2\n", encoding="utf-8")
    assert main(["run", "smooth.fmu", "--input", "in.csv", "--stop", "1", "--step", "0.25"]) == 0
    assert results("smooth")["smooth.u"].tolist() == [1.0, 1.0, 1.0, 2.0, 2.0]
    assert "note: in.csv goes from 0.5 s to 0.75 s; its first and last rows hold outside" in capsys.readouterr().out


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,x\n0,0\n", "in.csv: the FMU has no input 'x'; known are a, b"),
        ("u,a\n0,0\n", "in.csv: the first column must be 'time'"),
        ("time,a\n", "in.csv: has no rows"),
        ("time,a\n1,0\n0,0\n", "in.csv: values must be finite numbers, and times must not descend"),
        ("time,a\n0,inf\n", "in.csv: values must be finite numbers"),
        ("time,a\n0,much\n", "column 'a' is text"),
        (None, "in.csv: can't be read: No such file"),
    ],
)
def test_inputs_that_make_no_sense_are_one_line(
    capsys: pytest.CaptureFixture[str], text: str | None, says: str
) -> None:
    if text is not None:
        Path("in.csv").write_text(text, encoding="utf-8")
    assert main(["run", "Tank.fmu", "--input", "in.csv"]) == 1
    assert says in error_line(capsys)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--set", "a=1"], "--set a=1: 'Tank.a' is fed by a connection or a signal; take it out of in.csv"),
        (["--seed", "1"], "--seed is for scenarios; Tank.fmu is a single FMU"),
        (["--fmu", "a=b"], "--fmu is for scenarios"),
        (["--flavour", "fmi2"], "--flavour is for scenarios"),
    ],
)
def test_options_that_make_no_sense_are_one_line(
    capsys: pytest.CaptureFixture[str], options: list[str], says: str
) -> None:
    Path("in.csv").write_text("time,a\n0,0\n1,0\n", encoding="utf-8")
    assert main(["run", "Tank.fmu", "--input", "in.csv", *options]) == 1
    assert says in error_line(capsys)


def test_a_file_that_is_none_is_one_line(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "none.fmu"]) == 1
    assert "none.fmu: there is no such FMU file" in error_line(capsys)


def test_a_mat_file_has_no_room_for_texts_and_it_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_figures: None, capsys: pytest.CaptureFixture[str]
) -> None:
    compiled(tmp_path, "fmi3_types")
    monkeypatch.chdir(tmp_path)
    options = ["--stop", "1", "--step", "0.5", "--format", "mat", "--format", "csv"]
    assert main(["run", "types.fmu", *options]) == 0
    whole, left = results("types"), Results.read("results/types/results.mat")
    texts = [name for name in whole.names if name not in left.names]
    assert texts
    assert f"note: .mat has no room for texts and leaves out {', '.join(texts)}\n" in capsys.readouterr().out
