"""Scenarios of systems of one's own: what a TOML file says is the system that runs, to the last key."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from cosim.__main__ import main
from cosim.master.simulation import simulate
from cosim.results.results import Results
from cosim.scenario import family as family_module
from cosim.scenario.family import ScenarioFamily, default_scenario, families, named
from cosim.scenario.metrics import Metric
from cosim.scenario.reading import load_scenario
from cosim.scenario.scenario import Scenario, ScenarioComponent, ScenarioError
from cosim.scenario.signals import CsvColumn, Noise, Step
from cosim.system.system import Connection, System
from tests.support.tiny_models import GAIN, INTEGRATOR, LAG, build

#: A loop: the lag's output is integrated, and fed back by a gain whose second element has a signal.
LOOP = """
title = "a loop"

[components.lag]
fmu = "parts/Lag.fmu"

[components.integrator]
fmu = "parts/Integrator.fmu"
every = 2

[components.gain]
fmu = "parts/Gain.fmu"

[[connections]]
from = "lag.x"
to = "integrator.u"
factor = -0.5
offset = 0.25
units = "ignore"

[[connections]]
from = "integrator.x"
to = "gain.u[1]"

[[connections]]
from = "gain.y[1]"
to = "lag.u"

[run]
start_time = 1.0
stop_time = 3.0
step_size = 0.05
order = "parallel"
extrapolation = "hold"
seed = 3
record = ["lag.x", "integrator.x", "gain.y"]
record_every = 4

[start.lag]
x_start = 1.5
T = 2

[signals."gain.u[2]"]
shape = "step"
time = 2.0
after = 1.0

[disturbances."integrator.u"]
shape = "noise"
rms = 0.1
period = 0.2

[metrics.peak]
of = "lag.x"
measure = "max_abs"

[metrics.difference]
of = "lag.x"
minus = "integrator.x"
measure = "rms"
after = 2.0
"""


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("parts"), LAG, INTEGRATOR, GAIN)


@pytest.fixture
def here(parts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder beside that of the scenario, whose FMUs are in a folder of its own."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/parts").symlink_to(parts, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(text: str) -> str:
    Path("mine/loop.toml").write_text(text, encoding="utf-8")
    return "mine/loop.toml"


def by_hand() -> Results:
    """The same system by the Python interface."""
    system = System()
    system.add("lag", "mine/parts/Lag.fmu", start={"x_start": 1.5, "T": 2.0})
    system.add("integrator", "mine/parts/Integrator.fmu", every=2)
    system.add("gain", "mine/parts/Gain.fmu")
    system.connect("lag.x", "integrator.u", factor=-0.5, offset=0.25, units="ignore")
    system.connect("integrator.x", "gain.u[1]")
    system.connect("gain.y[1]", "lag.u")
    system.drive("gain.u[2]", lambda t: float(t >= 2.0 - 1e-9), breakpoints=[2.0])
    system.disturb("integrator.u", Noise(0.1, 0.2).function(1, 3, "integrator.u"), vectorized=True)
    return simulate(
        system,
        3.0,
        0.05,
        start_time=1.0,
        order="parallel",
        extrapolation="hold",
        record=["lag.x", "integrator.x", "gain.y"],
        record_every=4,
    )


@pytest.mark.usefixtures("here")
def test_every_key_is_read() -> None:
    scenario = load_scenario(written(LOOP))
    assert scenario == Scenario(
        name="loop",
        title="a loop",
        components={
            "lag": ScenarioComponent(Path("mine/parts/Lag.fmu")),
            "integrator": ScenarioComponent(Path("mine/parts/Integrator.fmu"), every=2),
            "gain": ScenarioComponent(Path("mine/parts/Gain.fmu")),
        },
        connections=(
            Connection("lag.x", "integrator.u", -0.5, 0.25, "ignore"),
            Connection("integrator.x", "gain.u[1]"),
            Connection("gain.y[1]", "lag.u"),
        ),
        start_time=1.0,
        stop_time=3.0,
        step_size=0.05,
        order="parallel",
        extrapolation="hold",
        seed=3,
        record=("lag.x", "integrator.x", "gain.y"),
        record_every=4,
        start={"lag": {"x_start": 1.5, "T": 2}},
        signals={"gain.u[2]": Step(2.0, 1.0)},
        disturbances={"integrator.u": Noise(0.1, 0.2)},
        metrics={
            "peak": Metric("lag.x", "max_abs"),
            "difference": Metric("lag.x", "rms", minus="integrator.x", after=2.0),
        },
    )


@pytest.mark.usefixtures("here", "no_figures")
def test_the_program_runs_it_as_the_python_interface_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", written(LOOP), "--out", "out"]) == 0
    expected, found = by_hand(), Results.from_csv("out/results.csv")
    assert found.names == expected.names
    assert found.time.tolist() == expected.time.tolist()
    assert found.values.tolist() == expected.values.tolist()
    assert np.ptp(found["lag.x"]) > 0.1
    shown = capsys.readouterr().out.splitlines()
    values = {line.split()[0]: float(line.split()[1]) for line in shown if line.startswith(("peak", "difference"))}
    late = expected.time >= 2.0
    difference = (expected["lag.x"] - expected["integrator.x"])[late]
    assert values["peak"] == pytest.approx(np.abs(expected["lag.x"]).max(), rel=1e-5)
    assert values["difference"] == pytest.approx(np.sqrt(np.mean(difference**2)), rel=1e-5)


@pytest.mark.usefixtures("here", "no_figures")
def test_options_of_the_command_line_win() -> None:
    options = ["--start", "0", "--stop", "1", "--step", "0.1", "--order", "sequential", "--extrapolation", "auto"]
    more = ["--seed", "4", "--record", "lag.x", "--record-every", "1", "--set", "lag.T=3", "--out", "out"]
    assert main(["run", written(LOOP), *options, *more]) == 0
    results = Results.from_csv("out/results.csv")
    assert results.names == ["lag.x"]
    assert results.time == pytest.approx(np.arange(11) * 0.1, abs=1e-15)


@pytest.mark.usefixtures("here", "no_figures")
def test_steps_may_be_variable_and_iterated(capsys: pytest.CaptureFixture[str]) -> None:
    text, _, metrics = LOOP.replace("every = 2", "").partition("[disturbances")
    text += metrics[metrics.index("[metrics.peak]") :]
    for before, after in (("0.05", '"variable"'), ('"parallel"', '"sequential"'), ("seed = 3", "iterations = 2")):
        assert before in text
        text = text.replace(before, after)
    assert main(["run", written(text), "--coupling-tolerance", "0.1", "--out", "out"]) == 0
    said = capsys.readouterr().out
    assert "for a coupling error of 0.1 (" in said
    assert "iterated steps: " in said
    summary = json.loads(Path("out/summary.json").read_text())
    assert summary["step_size"] == "variable"
    assert summary["variable_steps"]["steps"] > 10
    assert main(["pack", "mine/loop.toml", "--out", "packed.fmu"]) == 1
    assert "a packed system takes a fixed communication step, not 'variable'" in capsys.readouterr().err


@pytest.mark.usefixtures("here", "no_figures")
def test_metrics_that_record_leaves_out_are_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", written(LOOP), "--record", "lag.x", "--out", "out"]) == 0
    shown = capsys.readouterr().out
    assert "note: --record leaves out what these metrics need: difference" in shown
    assert "\npeak" in shown


@pytest.mark.usefixtures("here", "no_figures")
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--set", "gain.u[2]=1"], "'gain.u[2]' is fed by a connection or a signal; change the scenario's TOML"),
        (["--set", "lag.u=1"], "'lag.u' is fed by a connection or a signal"),
        (["--set", "lga.T=1"], "has no component 'lga'; did you mean 'lag'?"),
        (["--set", "lag.T=long"], "'long' is not a value of type Real"),
        (["--flavour", "fmi3"], "--flavour is for scenarios of parallel_robot"),
        (["--fmus", "there"], "--fmus is for scenarios of parallel_robot"),
        (["--input", "in.csv"], "--input is for a single FMU"),
        (["--fmu", "lag=none.fmu"], "component 'lag': none.fmu: there is no such FMU file"),
        (["--seed", "-1"], "--seed -1: must be 0 or greater"),
    ],
)
def test_options_that_make_no_sense_are_one_line(
    capsys: pytest.CaptureFixture[str], options: list[str], expected: str
) -> None:
    assert main(["run", written(LOOP), *options]) == 1
    said = capsys.readouterr().err
    assert expected in said
    assert said.count("\n") == 1


#: What is changed in LOOP, and what the message says.
BAD = {
    "no FMU": ('fmu = "parts/Lag.fmu"', "every = 1", ["[components.lag] lacks fmu"]),
    "unknown key of a component": ("every = 2", "evry = 2", ["[components.integrator]", "'evry'", "'every'"]),
    "a component twice as fast": ("every = 2", "every = 0", ["[components.integrator] every = 0"]),
    "every a number": ("every = 2", "every = 2.0", ["[components.integrator] every = 2.0", "whole number"]),
    "FMU a number": ('fmu = "parts/Gain.fmu"', "fmu = 1", ["[components.gain] fmu = 1", "must be a text"]),
    "a dot in a name": ("[components.lag]", '[components."l.ag"]', ["[components.l.ag]", "without a dot"]),
    "connection lacks an end": ('to = "integrator.u"', "", ["[[connections]] number 1 lacks to"]),
    "connection of no component": ('to = "lag.u"', 'to = "leg.u"', ["number 3", "'leg'", "did you mean 'lag'?"]),
    "connection without a dot": ('from = "integrator.x"', 'from = "x"', ["number 2 from = 'x'", "component.variable"]),
    "unknown key of a connection": ("factor = -0.5", "facto = -0.5", ["number 1", "'facto'", "'factor'"]),
    "factor a text": ("factor = -0.5", 'factor = "x"', ["number 1 factor = 'x'", "must be a number"]),
    "units unknown": ('units = "ignore"', 'units = "convrt"', ["units = 'convrt'", "did you mean 'convert'?"]),
    "order unknown": ('order = "parallel"', 'order = "jacobi"', ["[run] order = 'jacobi'", "known are sequential"]),
    "extrapolation unknown": ('"hold"', '"cubc"', ["[run] extrapolation = 'cubc'"]),
    "no stop time": ("stop_time = 3.0", "", ["[run] lacks stop_time"]),
    "no step": ("step_size = 0.05", "", ["[run] lacks step_size"]),
    "key of another system": ("seed = 3", "seed = 3\nsteady_after = 1.0", ["[run]", "'steady_after'"]),
    "record a text": ('record = ["lag.x", "integrator.x", "gain.y"]', 'record = "lag.x"', ["record = 'lag.x'", "list"]),
    "record a number": ('record = ["lag.x",', "record = [1,", ["[run] record = 1", "must be a text"]),
    "nothing recorded": ('record = ["lag.x", "integrator.x", "gain.y"]', "record = []", ["records nothing"]),
    "record_every zero": ("record_every = 4", "record_every = 0", ["record_every = 0 must be 1 or greater"]),
    "start of no component": ("[start.lag]", "[start.leg]", ["[start]", "'leg'", "did you mean 'lag'?"]),
    "signal of no component": ('"gain.u[2]"', '"gian.u[2]"', ["'gian'", "did you mean 'gain'?"]),
    "disturbance of what no connection feeds": (
        '"integrator.u"]\nshape',
        '"lag.y"]\nshape',
        ["no connection feeds it"],
    ),
    "step lacks its time": ("time = 2.0\n", "", ['[signals."gain.u[2]"] lacks time']),
    "measure unknown": ('"max_abs"', '"maxabs"', ["[metrics.peak] measure = 'maxabs'", "did you mean 'max_abs'?"]),
    "metric of no component": ('minus = "integrator.x"', 'minus = "i.x"', ["[metrics.difference] minus", "'i'"]),
    "metric without a measure": ('measure = "rms"\n', "", ["[metrics.difference] lacks measure"]),
    "unknown key of a metric": ("after = 2.0", "from = 2.0", ["[metrics.difference]", "'from'"]),
    "unknown system": ('title = "a loop"', 'system = "parallel_robt"', ["'parallel_robt'", "'parallel_robot'"]),
    "system a number": ('title = "a loop"', "system = 1", ["system = 1 must be a text"]),
    "connections a table": ("[[connections]]\nfrom", "[connections]\nfrom", ["TOML"]),
}


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_by_file_and_key(case: str) -> None:
    before, after, expected = BAD[case]
    assert before in LOOP
    path = written(LOOP.replace(before, after, 1))
    with pytest.raises(ScenarioError) as refused:
        load_scenario(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for part in expected:
        assert part in message


@pytest.mark.usefixtures("here", "no_figures")
@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("parts/Lag.fmu", "parts/Leg.fmu", ["component 'lag'", "mine/parts/Leg.fmu: there is no such FMU file"]),
        ('from = "lag.x"', 'from = "lag.z"', ["component 'lag' has no variable 'z'"]),
        ('of = "lag.x"\nmeasure', 'of = "lag.u"\nmeasure', ["metric 'peak': 'lag.u' is not recorded"]),
        (
            'of = "lag.x"\nmeasure',
            'of = "gain.y"\nmeasure',
            ["metric 'peak': 'gain.y' is not recorded, or is not a scalar"],
        ),
        ('"gain.u[2]"', '"gain.u"', ["'gain.u[1]' is fed twice"]),
        ("T = 2", "T = 'x'", ["'lag.T'", "not a number"]),
        ("T = 2", "X = 2", ["component 'lag' has no variable 'X'"]),
    ],
)
def test_what_does_not_fit_the_fmus_is_refused_by_file_and_name(
    capsys: pytest.CaptureFixture[str], before: str, after: str, expected: list[str]
) -> None:
    assert before in LOOP
    assert main(["run", written(LOOP.replace(before, after, 1))]) == 1
    said = capsys.readouterr().err
    assert said.startswith("cosim: mine/loop.toml: ")
    assert said.count("\n") == 1
    for part in expected:
        assert part in said
    assert not Path("results/loop/results.csv").exists()


@pytest.mark.usefixtures("here")
def test_a_column_of_a_csv_file_is_read_beside_the_scenario() -> None:
    Path("mine/in.csv").write_text("time,u\n0,0\n1,2\n", encoding="utf-8")
    table = '[signals."gain.u[2]"]\nshape = "table"\nfile = "in.csv"\ncolumn = "{}"\n'
    step = LOOP[LOOP.index('[signals."gain') : LOOP.index("[disturbances")]
    scenario = load_scenario(written(LOOP.replace(step, table.format("u"))))
    assert scenario.signals["gain.u[2]"] == CsvColumn("mine/in.csv", "u")
    with pytest.raises(ScenarioError, match=r"loop\.toml: .*gain\.u\[2\].*mine/in\.csv: there is no column 'v'"):
        load_scenario(written(LOOP.replace(step, table.format("v"))))


# Families


class Loops(ScenarioFamily):
    """A family whose members are all the same loop."""

    system = "a loop"
    components: Mapping[str, ScenarioComponent] = {
        "lag": ScenarioComponent(Path("mine/parts/Lag.fmu")),
        "gain": ScenarioComponent(),
    }
    connections = (Connection("lag.x", "gain.u[1]"), Connection("gain.y[1]", "lag.u"))
    metric_names = ("further",)


@pytest.fixture
def loops(monkeypatch: pytest.MonkeyPatch) -> dict[str, ScenarioFamily]:
    """The only family is the loop."""
    known: dict[str, ScenarioFamily] = {"loops": Loops()}
    monkeypatch.setattr(family_module, "families", lambda: known)
    return known


RUN = "[run]\nstop_time = 1.0\nstep_size = 0.1\n"


@pytest.mark.usefixtures("here", "loops")
def test_a_file_without_components_belongs_to_the_only_family() -> None:
    scenario = load_scenario(written(RUN))
    assert dict(scenario.components) == dict(Loops.components)
    assert scenario.connections == Loops.connections
    alone = load_scenario(written("components = ['lag']\n" + RUN))
    assert list(alone.components) == ["lag"]
    assert alone.connections == ()


@pytest.mark.usefixtures("here", "loops")
def test_a_table_of_components_changes_those_of_the_family_that_is_named() -> None:
    more = '[components.gain]\nfmu = "parts/Gain.fmu"\nevery = 3\n[components.more]\nfmu = "parts/Lag.fmu"\n'
    own = '[[connections]]\nfrom = "more.x"\nto = "lag.u"\n'
    scenario = load_scenario(written('system = "loops"\n' + more + own + RUN))
    assert dict(scenario.components) == {
        "lag": ScenarioComponent(Path("mine/parts/Lag.fmu")),
        "gain": ScenarioComponent(Path("mine/parts/Gain.fmu"), 3, stands_in=True),
        "more": ScenarioComponent(Path("mine/parts/Lag.fmu")),
    }
    # the connection of the file takes the place of the family's at that input
    assert scenario.connections == (Connection("lag.x", "gain.u[1]"), Connection("more.x", "lag.u"))
    # without the name of the system the file is on its own
    assert list(load_scenario(written(more + RUN)).components) == ["gain", "more"]


@pytest.mark.usefixtures("here", "loops")
def test_what_a_family_can_t_have_is_refused() -> None:
    with pytest.raises(ScenarioError, match="component 'gain' has no FMU; name its file"):
        load_scenario(written(RUN)).system()
    with pytest.raises(ScenarioError, match="its component does not take part; known are lag"):
        load_scenario(written("components = ['lag']\n" + RUN + '[signals."gain.u"]\nshape = "constant"\nvalue = 1\n'))
    with pytest.raises(ScenarioError, match=r"\[metrics\.further\]: all scenarios of this system have a metric"):
        load_scenario(written(RUN + '[metrics.further]\nof = "lag.x"\nmeasure = "max"\n'))


@pytest.mark.usefixtures("here")
def test_among_several_families_a_file_says_which(loops: dict[str, ScenarioFamily]) -> None:
    loops["others"] = ScenarioFamily()
    with pytest.raises(ScenarioError, match=r'a line system = "loops" or "others"$'):
        load_scenario(written(RUN))
    assert "lag" in load_scenario(written('system = "loops"\n' + RUN)).components
    loops.clear()
    with pytest.raises(ScenarioError, match="no package that knows a system is installed"):
        load_scenario(written(RUN))


def test_names_and_defaults_of_families(tmp_path: Path, loops: dict[str, ScenarioFamily]) -> None:
    with pytest.raises(ScenarioError, match="there is no default scenario; give the name of a TOML file"):
        default_scenario()

    class Shipped(Loops):
        folder = tmp_path
        default = "one"

    (tmp_path / "one.toml").write_text(RUN, encoding="utf-8")
    loops["shipped"] = shipped = Shipped()
    assert default_scenario() == "one"
    assert named("one") == named(str(tmp_path / "one.toml")) == (shipped, tmp_path / "one.toml")
    assert named("two") is None
    loops["again"] = Shipped()
    with pytest.raises(ScenarioError, match="several packages have a scenario 'one'"):
        named("one")
    with pytest.raises(ScenarioError, match="there is no default scenario; give the name of one, one, or"):
        default_scenario()


def test_a_relative_folder_is_beside_the_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site/far_away"
    (package / "cases").mkdir(parents=True)
    (package / "cases/one.toml").write_text(RUN, encoding="utf-8")
    (package / "__init__.py").write_text(
        "from pathlib import Path\nfrom cosim.scenario import ScenarioFamily\n"
        "class Far(ScenarioFamily):\n    folder = Path('cases')\nclass Further(Far):\n    pass\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.chdir(tmp_path)
    module = import_module("far_away")
    assert module.Far().scenario_names() == module.Further().scenario_names() == ["one"]
    assert module.Further.folder == package / "cases"


def test_the_robot_is_a_family() -> None:
    assert "parallel_robot" in families()
    assert default_scenario() == "tracking"
