"""Sweeps of systems that have no robot in them, from a TOML file or an SSP: what rows hold, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from cosim import Simulation, System
from cosim.__main__ import main
from cosim.scenario import Scenario, ScenarioError, load_scenario
from cosim.ssp.writer import Experiment, write_ssp
from cosim.sweep import SweepError, read
from cosim.sweep.points import parse_factor
from cosim.sweep.scenarios import ScenarioStudy, check, scenario_study
from tests.support.c_fmus import sources_of_tank
from tests.support.quirks import quirky
from tests.support.scripts import scripted, slave
from tests.support.small_fmus import build, compiled
from tests.support.ssp_files import archive, component, description, elements, step_size_hint
from tests.support.tiny_models import GAIN

#: A gain after a probe, which passes values of all types through; a random signal feeds the probe.
TOML = """
title = "A gain after a probe"
[components.p]
fmu = "probe.fmu"
[components.g]
fmu = "Gain.fmu"
[[connections]]
from = "p.y"
to = "g.u[1]"
[start.g]
"u[2]" = 1.0
[start.p]
n = 3
e = 1
b = false
[run]
start_time = 1.0
stop_time = 2.0
step_size = 0.125
seed = 4
[signals."p.u"]
shape = "multisine"
rms = 0.5
lowest = 0.5
highest = 2.0
"""

METRICS = """
[metrics.deviation]
of = "g.y[1]"
minus = "p.y"
measure = "rms"
after = 1.5
[metrics.last]
of = "p.n_out"
measure = "final"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenarios, with metrics and without, and their FMUs."""
    folder = tmp_path_factory.mktemp("system")
    compiled(folder, "fmi2_probe")
    build(folder, "fmi2", GAIN)
    (folder / "plain.toml").write_text(TOML)
    (folder / "measured.toml").write_text(TOML + METRICS)
    return folder


def scaled(time: float, u: float, gain: float) -> float:
    return gain * u + time


class WithFunction(Scenario):
    """A scenario of a family that adds a function in Python."""

    def system(self) -> System:
        system = super().system()
        system.add_function("f", scaled, inputs=["u", "gain"], outputs=["y"], start={"gain": 2.0})
        system.connect("g.y[1]", "f.u")
        return system


@pytest.fixture
def here(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the scenarios."""
    for path in folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scenario(folder: Path, name: str, **changes) -> Scenario:
    return dataclasses.replace(load_scenario(str(folder / f"{name}.toml")), **changes)


def row_of(study: ScenarioStudy, files: dict[str, Path], point: dict) -> dict:
    """The row of a point, as a worker makes it from a study that has travelled."""
    study = pickle.loads(pickle.dumps(study))
    planned = study.plan(point)
    with study.simulation(planned.variant, files.__getitem__) as simulation:
        results = simulation.run(
            planned.stop_time,
            planned.step_size,
            start_time=planned.start_time,
            start=planned.start,
            signals=planned.signals,
            record_every=planned.record_every,
        )
        return study.row(planned, results)


def by_simulation(changed: Scenario, **start: object):
    with Simulation(changed.system(), order=changed.order) as simulation:
        return simulation.run(
            changed.stop_time,
            changed.step_size,
            start_time=changed.start_time,
            start={name.replace("__", "."): value for name, value in start.items()},
        )


def test_a_function_in_python_takes_part_by_a_scenario_that_adds_it(folder):
    plain = scenario(folder, "measured")
    fields = {f.name: getattr(plain, f.name) for f in dataclasses.fields(plain)}
    metrics = {"last": dataclasses.replace(plain.metrics["last"], of="f.y")}
    changed = WithFunction(**fields | {"metrics": metrics})
    study, files = scenario_study({"with": changed})
    check(study, files, [parse_factor("f.gain=2,-3")])
    expected = by_simulation(plain)
    for gain in (2.0, -3.0):
        row = row_of(study, files, {"f.gain": gain})
        assert row["last"] == gain * expected["g.y[1]"][-1] + expected.time[-1]


def test_a_scenario_without_metrics_has_those_of_its_outputs(folder):
    plain = scenario(folder, "plain")
    study, files = scenario_study({"plain": plain})
    row = row_of(study, files, {"g.K": 2.0})
    results = by_simulation(plain, g__K=2.0)
    outputs = ["p.y", "p.n_out", "p.e_out", "p.b_out", "g.y[1]", "g.y[2]"]
    assert list(row) == [*(f"{o}.{m}" for o in outputs for m in ("final", "min", "max")), "loop_time_s"]
    for name in outputs:
        values = results[name]
        found = [row[f"{name}.{m}"] for m in ("final", "min", "max")]
        assert found == [values[-1], values.min(), values.max()], name
    assert row["g.y[1].min"] < 0.0 < row["g.y[1].max"]
    assert row["loop_time_s"] > 0.0


def test_metrics_of_a_scenario_and_nothing_else_are_measured_and_recorded(folder):
    measured = scenario(folder, "measured")
    study, files = scenario_study({"measured": measured})
    assert study.metrics == ("deviation", "last", "loop_time_s")
    planned = study.plan({})
    with study.simulation(planned.variant, files.__getitem__) as simulation:
        assert simulation.names == ["g.y[1]", "p.y", "p.n_out"]
    row = row_of(study, files, {"g.K": 3.0, "p.n": 5})
    results = by_simulation(measured, g__K=3.0)
    errors = (results["g.y[1]"] - results["p.y"])[results.time >= 1.5]
    assert len(errors) == 5
    assert row["deviation"] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-12)
    assert row["last"] == 5.0


def test_points_mean_what_the_same_change_of_the_scenario_means(folder):
    measured = scenario(folder, "measured")
    study, files = scenario_study({"measured": measured})
    shape = measured.signals["p.u"]
    point = {"seed": 9, "p.u.rms": 2.0, "p.u.components": 3.0, "step_size": 0.0625, "g.K": 0.5}
    changed = dataclasses.replace(
        measured, seed=9, step_size=0.0625, signals={"p.u": dataclasses.replace(shape, rms=2.0, components=3)}
    )
    errors = by_simulation(changed, g__K=0.5)
    late = (errors["g.y[1]"] - errors["p.y"])[errors.time >= 1.5]
    assert row_of(study, files, point)["deviation"] == pytest.approx(np.sqrt(np.mean(late**2)), rel=1e-12)
    assert row_of(study, files, {})["deviation"] != row_of(study, files, {"seed": 9})["deviation"]


def test_every_nth_point_counts_as_in_a_run_and_curves_have_their_points(folder):
    sparse = scenario(folder, "measured", record_every=2)
    study, files = scenario_study({"s": sparse}, curve_period=0.5)
    assert study.curves == ("g.y[1].curve", "p.y.curve", "p.n_out.curve")
    row = row_of(study, files, {"g.K": 2.0})
    values = by_simulation(sparse, g__K=2.0)["g.y[1]"]
    assert row["g.y[1].curve"].tolist() == values[::4].tolist()
    late = values[4::2] - values[4::2] / 2.0
    assert row["deviation"] == pytest.approx(np.sqrt(np.mean(late**2)), rel=1e-12)
    with pytest.raises(SweepError, match=r"need steps that divide it, not 0\.25 s"):
        check(*scenario_study({"s": sparse}, curve_period=0.3), [])


def test_fmu_files_of_a_component_are_a_factor(folder, tmp_path):
    plain = scenario(folder, "measured")
    other = tmp_path / "other.fmu"
    shutil.copy(folder / "Gain.fmu", other)
    study, files = scenario_study({"s": plain}, {"g": [folder / "Gain.fmu", other]})
    assert len(files) == 2  # the same contents travel once
    check(study, files, [])
    rows = [row_of(study, files, {"g.fmu": str(path), "g.K": 2.0}) for path in (folder / "Gain.fmu", other)]
    assert rows[0]["deviation"] == rows[1]["deviation"]
    with pytest.raises(SweepError, match=r"--fmu G=\.\.\.: there is no such component; known are p, g"):
        scenario_study({"s": plain}, {"G": [other]})


def test_rows_of_python_fmus_that_differ_in_a_module_are_each_their_own(tmp_path):
    """The worker's process has both, one after the other and again."""
    script = slave("self.y = gains.K", "import gains")
    fmus = [scripted(tmp_path / f"v{k}", script, {"gains.py": f"K = {k}.0\n"}) for k in (1, 2)]
    (tmp_path / "one.toml").write_text(
        f"title = 'One'\n[components.c]\nfmu = '{fmus[0].as_posix()}'\n[run]\nstop_time = 0.2\nstep_size = 0.1\n"
        "[metrics.last]\nof = 'c.y'\nmeasure = 'final'\n"
    )
    study, files = scenario_study({"s": load_scenario(tmp_path / "one.toml")}, {"c": fmus})
    order = [fmus[i] for i in (0, 1, 0, 1, 1)]
    assert [row_of(study, files, {"c.fmu": str(fmu)})["last"] for fmu in order] == [1.0, 2.0, 1.0, 2.0, 2.0]


def test_scenarios_are_a_factor_and_rows_have_the_metrics_of_all(folder):
    both = {"plain": scenario(folder, "plain"), "measured": scenario(folder, "measured")}
    study, files = scenario_study(both)
    rows = {label: row_of(study, files, {"scenario": label}) for label in both}
    assert list(rows["plain"]) == list(rows["measured"]) == list(study.metrics)
    assert rows["plain"]["deviation"] is None
    assert rows["measured"]["p.y.final"] is None
    assert rows["plain"]["p.y.final"] is not None
    assert rows["measured"]["deviation"] is not None


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        ("g.k=1,2", "component 'g' has no variable 'k'; known are u, y, K"),
        ("h.K=1,2", "there is no component 'h'"),
        ("g.u[1]=1,2", "a connection or a signal feeds it"),
        ("p.u.rsm=1,2", "a multisine has no number 'rsm'; did you mean 'rms'?"),
        ("p.u.rms=high,low", "p.u.rms = 'high' must be a number"),
        ("p.e=off,onn", "'onn' is not"),
        ("p.b=true,no", "'no' is "),
        ("g.K=1,two", "'two' is not a number"),
        ("p.journal=1,2", "2.0 is not a value of type String"),
    ],
)
def test_what_can_not_be_varied_is_one_line_before_anything_runs(folder, factor, says):
    study, files = scenario_study({"s": scenario(folder, "measured")})
    with pytest.raises(SweepError) as error:
        check(study, files, [parse_factor(factor)])
    assert str(error.value).startswith("scenario s: ")
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_words_texts_and_numbers_can_be_varied(folder):
    study, files = scenario_study({"s": scenario(folder, "plain")})
    factors = ("p.e=off,on", "p.e=1,2", "p.b=true,false", 'p.journal="1","2"', "g.K=-100,1", "g.K=-1:1")
    check(study, files, [parse_factor(factor) for factor in factors[:1]])
    for factor in factors:
        check(study, files, [parse_factor(factor)])
    rows = [row_of(study, files, {"p.e": e, "p.b": b}) for e, b in (("on", "true"), (2, True), ("off", "false"))]
    assert [(row["p.e_out.final"], row["p.b_out.final"]) for row in rows] == [(2.0, 1.0), (2.0, 1.0), (1.0, 0.0)]


def test_a_metric_of_what_is_not_there_is_one_line(folder):
    wrong = scenario(folder, "measured")
    metric = dataclasses.replace(wrong.metrics["last"], of="p.m_out")
    study, files = scenario_study({"s": dataclasses.replace(wrong, metrics={"last": metric})})
    with pytest.raises(SweepError, match=r"scenario s: component 'p' has no variable 'm_out'; did you mean 'n_out'\?"):
        check(study, files, [])


def test_a_scenario_without_fmus_is_one_line(folder):
    bare = scenario(folder, "plain")
    components = {**bare.components, "p": dataclasses.replace(bare.components["p"], fmu=None)}
    with pytest.raises(ScenarioError, match="component 'p' has no FMU"):
        scenario_study({"s": dataclasses.replace(bare, components=components)})


def test_the_study_is_the_same_wherever_the_files_are(folder, tmp_path):
    for path in folder.iterdir():
        if path.is_file():
            shutil.copy(path, tmp_path / path.name)
    here, there = (scenario_study({"s": scenario(f, "measured")})[0].fingerprint() for f in (folder, tmp_path))
    assert here == there == json.loads(json.dumps(here))
    other, _ = scenario_study({"s": scenario(folder, "measured", extrapolation="hold")})
    assert other.fingerprint() != here


# The command


def swept(*arguments: str) -> list[dict]:
    assert main(["sweep", *arguments, "--workers", "1", "--out", "out"]) == 0
    return read(Path("out")).to_pylist()


def test_the_command_sweeps_a_toml_file_with_words_and_metrics(here, capsys):
    rows = swept(
        *("measured.toml", "--vary", "p.e=off,on", "--vary", "g.K=1,2", "--seeds", "1:2"),
        *("--metric", "mode=final:p.e_out", "--metric", "late=max_abs:g.y[1]:p.y@1.5"),
    )
    assert capsys.readouterr().out.startswith("runs      8 of 8, 8 of them now\nfailed    none\n")
    assert list(rows[0]) == ["index", "seed", "p.e", "g.K", "deviation", "last", "mode", "late", "loop_time_s", "error"]
    assert [row["p.e"] for row in rows] == ["off", "off", "on", "on"] * 2
    assert [row["mode"] for row in rows] == [1.0, 1.0, 2.0, 2.0] * 2
    measured = scenario(here, "measured")
    for row in rows:
        results = by_simulation(dataclasses.replace(measured, seed=row["seed"]), g__K=row["g.K"])
        errors = (results["g.y[1]"] - results["p.y"])[results.time >= 1.5]
        assert row["late"] == np.abs(errors).max()


def test_the_command_sweeps_an_ssp(here):
    system = System()
    system.add("first", "Gain.fmu", start={"u": [3.0, 3.0]})
    system.add("second", "Gain.fmu")
    system.connect("first.y", "second.u")
    write_ssp(Path("gains.ssp"), system, "two gains", Experiment(stop_time=1.0, step_size=0.25, start_time=0.5))
    rows = swept("gains.ssp", "--vary", "first.K=1,2", "--vary", "second.K=-1:1:3", "--vary", "first.u[1]=3,4")
    assert len(rows) == 12
    for row in rows:
        assert row["error"] is None
        assert row["second.y[1].final"] == row["first.u[1]"] * row["first.K"] * row["second.K"]
        assert row["second.y[2].final"] == 3.0 * row["first.K"] * row["second.K"]
        assert row["first.y[1].max"] == row["first.u[1]"] * row["first.K"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["plain.toml", "--vary", "g.k=1,2"], "scenario plain.toml: g.k: component 'g' has no variable 'k'"),
        (["plain.toml", "--vary", "g.K=1,2", "--flavour", "fmi3"], "--flavour is for scenarios of parallel_robot"),
        (["plain.toml", "tracking", "--seeds", "1:2"], "tracking: its system is not that of plain.toml"),
        (["plain.toml", "--vary", "g.K=1,2", "--metric", "w=max"], "write NAME=MEASURE:VARIABLE"),
        (["plain.toml", "--vary", "g.K=1,2", "--metric", "w=max:g.y[1]@soon"], "write NAME=MEASURE:VARIABLE"),
        (["plain.toml", "--vary", "g.K=1,2", "--metric", "w=mux:g.y[1]"], "did you mean 'max'?"),
        (["plain.toml", "--vary", "g.K=1,2", "--metric", "w=max:g.z"], "component 'g' has no variable 'z'"),
        (["measured.toml", "--vary", "g.K=1,2", "--metric", "last=max:g.y[1]"], "there is a metric 'last' already"),
        (["tracking", "--vary", "controller.alpha=1,2", "--metric", "tracking=max:plant.x_E"], "already"),
        (["plain.toml", "--vary", "g.K=1,2", "--metric", "g.K=max:g.y[1]"], "two columns are named 'g.K'"),
        (["plain.toml", "--vary", "g.K=1,2", "--metric", "error=max:g.y[1]"], "two columns are named 'error'"),
        (["nowhere.ssp", "--vary", "g.K=1,2"], "nowhere.ssp"),
        (["Gain.fmu", "--vary", "g.K=1,2"], "Gain.fmu is a single FMU; write a TOML scenario"),
    ],
)
def test_what_makes_no_sense_is_one_line(here, capsys, arguments, says):
    assert main(["sweep", *arguments]) == 1
    err = capsys.readouterr().err
    assert err.startswith("cosim: ")
    assert says in err
    assert err.count("\n") == 1
    assert list(Path().rglob("part-*")) == []


def test_an_ssp_that_does_not_say_how_long_is_as_long_as_its_fmus_or_a_second(here, capsys):
    archive(Path("short.ssp"), description(elements(component("a", "Gain")), experiment=""), {"Gain": Path("Gain.fmu")})
    rows = swept("short.ssp", "--vary", "a.K=1,2", "--vary", "a.u[2]=3")  # as long as the FMU says
    assert "has no stop time; 1 s is taken" in capsys.readouterr().out
    assert [row["a.y[2].final"] for row in rows] == [3.0, 6.0]
    shutil.rmtree("out")
    probe = description(elements(component("p", "probe")), experiment="")
    archive(Path("short.ssp"), probe, {"probe": Path("probe.fmu")})
    assert len(swept("short.ssp", "--vary", "p.e=off,on")) == 2
    assert "say when to stop; 1 s is taken, 1 s after the start (--stop)" in capsys.readouterr().out


def test_steps_of_components_are_multiples_of_the_step_of_a_sweep(here, capsys):
    system = elements(component("a", "Gain"), component("b", "Gain", bindings=step_size_hint("0.2")))
    archive(Path("own.ssp"), description(system), {"Gain": Path("Gain.fmu")})
    rows = swept("own.ssp", "--vary", "a.K=1,2", "--step", "0.05")
    assert [row["error"] for row in rows] == [None, None]
    components = json.loads(Path("out/sweep.json").read_text())["scenarios"]["own.ssp"]["components"]
    assert [components[name]["every"] for name in ("a", "b")] == [1, 4]
    assert main(["sweep", "own.ssp", "--vary", "a.K=1,2", "--step", "0.05,0.1"]) == 1
    assert "'b' has a step of its own; give one --step" in capsys.readouterr().err


def test_c_sources_are_compiled_where_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    archive(Path("s.ssp"), description(elements(component("tank", "tank"))), {"tank": sources_of_tank(Path("t.fmu"))})
    options = ["--vary", "tank.u=1,2", "--step", "0.5", "--metric", "end=final:tank.y", "--workers", "1", "--out", "o"]
    assert main(["sweep", "s.ssp", *options]) == 1
    assert "or compile its C sources: --build" in capsys.readouterr().err
    assert main(["sweep", "s.ssp", *options, "--build"]) == 0, capsys.readouterr().err
    assert read(Path("o"))["end"].to_pylist() == [1.0, 2.0]


@pytest.mark.slow
def test_a_sweep_of_which_every_run_fails_is_no_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    archive(Path("s.ssp"), description(elements(component("q", "q"))), {"q": quirky(tmp_path)})
    options = ["--metric", "end=final:q.y", "--workers", "1", "--step", "0.5"]
    assert main(["sweep", "s.ssp", "--vary", "q.internal=0.3,0.4", *options, "--out", "none"]) == 1
    assert "failed    2; the first: point 0: q failed at t = 0 s: fmi2DoStep did not finish" in capsys.readouterr().out
    assert main(["sweep", "s.ssp", "--vary", "q.internal=0.3,0.5", *options, "--out", "some"]) == 0
