"""Scenarios: what the shipped ones say, and that a malformed one is refused by its file and key."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.model_description import read_model_description
from hypothesis import given
from hypothesis import strategies as st

from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains
from cosim.scenario.reading import scenario_from
from cosim.scenario.scenario import Scenario, ScenarioComponent, ScenarioError
from cosim.scenario.signals import Multisine, Noise, Shape, Sine
from parallel_robot.choices import scenario_names
from parallel_robot.models import MODELS
from parallel_robot.scenario import FAMILY, RobotScenario, load_scenario
from parallel_robot.wiring import COMPONENTS, CONNECTIONS

SHIPPED = ["open-loop", "pd", "tracking", "tracking-feedforward", "tracking-noise", "tracking-undisturbed"]


def signal(scenario: Scenario, target: str, size: int):
    return scenario.signals[target].function(size, scenario.seed, target)


# What the shipped scenarios say


def test_the_shipped_scenarios():
    assert scenario_names() == SHIPPED


@pytest.mark.parametrize("name", SHIPPED)
def test_each_lasts_15_s_in_steps_of_1_ms(name):
    scenario = load_scenario(name)
    assert (scenario.name, scenario.stop_time, scenario.step_size) == (name, 15.0, 1e-3)
    assert scenario.order == "sequential"
    assert scenario.title
    assert "\n" not in scenario.title


@pytest.mark.parametrize("name", ["tracking", "pd"])
def test_the_mass_change_is_a_quarter_kilogram_sin_pi_t(name):
    dm = signal(load_scenario(name), "plant.dm", 1)
    for t, expected in ((0.0, 0.0), (1 / 6, 0.125), (0.5, 0.25), (1.0, 0.0), (1.5, -0.25), (14.5, 0.25)):
        assert dm(t) == pytest.approx([expected], abs=1e-14)


@pytest.mark.parametrize("name", ["tracking", "pd"])
def test_the_disturbance_sets_in_at_4_s(name):
    tau_d = signal(load_scenario(name), "plant.tau_d", 3)
    times = np.arange(15001) * 1e-3
    values = np.array([tau_d(t) for t in times[::20].tolist()])
    assert values.shape[1] == 3
    assert not values[times[::20] < 4.0].any()
    late = values[times[::20] >= 4.0]
    assert (np.abs(late).max(axis=0) > 0.005).all()
    # of the size the file names, within what 11 s of a 9.5 Hz band allow: six times 1 / sqrt(T B), on the mean square
    assert np.mean(late**2, axis=0) == pytest.approx(np.full(3, 0.01**2), rel=6.0 / math.sqrt(11.0 * 9.5))


def test_tracking_leaves_the_gains_to_the_controller_fmu():
    tracking = load_scenario("tracking")
    assert list(tracking.components) == ["plant", "controller", "trajectory"]
    assert tracking.start == {}
    assert set(tracking.signals) == {"plant.dm", "plant.tau_d"}
    assert tracking.steady_after == 8.0


def test_the_gains_of_the_controller_fmu_are_the_optimal_ones(fmus: Path):
    optimum = optimal_gains(PerformanceIndex())
    description = read_model_description(fmus / "RobotController.fmu")
    start = {v.name: float(v.start) for v in description.modelVariables if v.causality == "parameter"}
    assert start["alpha"] == pytest.approx(optimum.alpha, rel=1e-12)
    assert start["beta"] == pytest.approx(optimum.beta, rel=1e-12)
    assert start["alpha"] == pytest.approx(1.35976, abs=1e-5)  # Table 1, row (1, 1)
    assert start["beta"] == pytest.approx(1.6620, abs=5e-5)


def test_pd_is_tracking_with_alpha_zero_and_nothing_else():
    pd, tracking = load_scenario("pd"), load_scenario("tracking")
    assert pd.start == {"controller": {"alpha": 0.0}}
    assert dataclasses.replace(pd, name=tracking.name, title=tracking.title, start={}) == tracking
    # not only described alike: the random torque is the same one
    a, b = signal(pd, "plant.tau_d", 3), signal(tracking, "plant.tau_d", 3)
    assert a(7.77).tolist() == b(7.77).tolist()


def test_the_undisturbed_scenario_has_no_mass_change_and_no_torque():
    scenario = load_scenario("tracking-undisturbed")
    assert scenario.signals == {}
    assert scenario.start == {"plant": {"dm": 0.0, "tau_d": [0.0, 0.0, 0.0]}}
    assert scenario.components == load_scenario("tracking").components


def test_open_loop_drives_all_joints_with_a_cosine():
    scenario = load_scenario("open-loop")
    assert list(scenario.components) == ["plant"]
    assert scenario.start == {"plant": {"dm": 0.0, "tau_d": [0.0, 0.0, 0.0]}}
    assert set(scenario.signals) == {"plant.tau_a"}
    tau_a = signal(scenario, "plant.tau_a", 3)
    for t in (0.0, 0.25, 0.5, 1.0, 3.2):
        assert tau_a(t) == pytest.approx([0.1 * math.cos(math.pi * t)] * 3, abs=1e-15)


def test_the_system_has_the_components_connections_and_signals_of_the_scenario():
    system = load_scenario("pd").system(Path("somewhere"), "pythonfmu")
    assert {n: c.fmu for n, c in system.components.items()} == {
        "plant": Path("somewhere/pythonfmu/RobotPlant.fmu"),
        "controller": Path("somewhere/pythonfmu/RobotController.fmu"),
        "trajectory": Path("somewhere/pythonfmu/RobotTrajectory.fmu"),
    }
    assert system.components["controller"].start == {"alpha": 0.0}
    assert [(c.source, c.target) for c in system.connections] == list(CONNECTIONS)
    assert [s.target for s in system.signals] == ["plant.dm", "plant.tau_d"]
    alone = load_scenario("open-loop").system(Path("somewhere"), "pythonfmu")
    assert list(alone.components) == ["plant"]
    assert alone.connections == []


def test_with_start_value_changes_a_copy():
    pd = load_scenario("pd")
    changed = pd.with_start_value("controller", "beta", 2.0).with_start_value("plant", "X", 0.1)
    assert changed.start == {"controller": {"alpha": 0.0, "beta": 2.0}, "plant": {"X": 0.1}}
    assert pd.start == {"controller": {"alpha": 0.0}}


# Files


def written(tmp_path: Path, text: str) -> str:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_an_empty_file_is_the_closed_loop_with_all_defaults(tmp_path):
    scenario = load_scenario(written(tmp_path, ""))
    assert scenario == RobotScenario(name="mine", title="mine", connections=tuple(FAMILY.connections))
    assert list(scenario.components) == ["plant", "controller", "trajectory"]


def test_every_key_is_read(tmp_path):
    text = """
title = "all of it"
components = ["trajectory", "plant", "controller"]
[run]
stop_time = 2
step_size = 0.01
order = "parallel"
seed = 7
steady_after = 1
[start.controller]
alpha = 2
S = [1.0, 2, 3.0]
[signals."plant.dm"]
shape = "sine"
amplitude = 1
frequency = 2
phase = 3
[signals."plant.tau_d"]
shape = "multisine"
rms = 1
lowest = 2
highest = 3
components = 4
start_time = 5
[disturbances."controller.omega_a"]
shape = "noise"
rms = 2
period = 3
"""
    scenario = load_scenario(written(tmp_path, text))
    assert scenario == RobotScenario(
        name="mine",
        title="all of it",
        components=dict.fromkeys(("trajectory", "plant", "controller"), ScenarioComponent()),
        connections=tuple(FAMILY.connections),
        stop_time=2.0,
        step_size=0.01,
        steady_after=1.0,
        order="parallel",
        seed=7,
        start={"controller": {"alpha": 2, "S": [1.0, 2, 3.0]}},
        signals={"plant.dm": Sine(1.0, 2.0, 3.0), "plant.tau_d": Multisine(1.0, 2.0, 3.0, 4, 5.0)},
        disturbances={"controller.omega_a": Noise(2.0, 3.0)},
    )
    assert isinstance(scenario.stop_time, float)
    assert isinstance(scenario.signals["plant.dm"].amplitude, float)


def test_one_element_of_a_vector_can_be_driven(tmp_path):
    text = '[signals."plant.tau_d[2]"]\nshape = "sine"\namplitude = 1.0\nfrequency = 1.0'
    scenario = load_scenario(written(tmp_path, text))
    drive = scenario.system(Path("f"), "pythonfmu").signals[0]
    assert (drive.target, drive.function_for(1)(0.25).shape) == ("plant.tau_d[2]", (1,))


@pytest.mark.parametrize(("name", "hint"), [("trackng", "tracking"), ("PD", "known are"), ("open_loop", "open-loop")])
def test_a_missing_name_offers_the_nearest(name, hint):
    with pytest.raises(ScenarioError, match=f"there is no scenario '{name}'") as refused:
        load_scenario(name)
    assert hint in str(refused.value)
    assert "TOML file" in str(refused.value)


@pytest.mark.parametrize("name", ["", ".", "..", "/", "tracking.toml"])
def test_names_that_are_no_files_are_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError, match="there is no scenario"):
        load_scenario(name)


def test_a_missing_path_is_named(tmp_path):
    with pytest.raises(ScenarioError, match="there is no scenario") as refused:
        load_scenario(str(tmp_path / "nowhere" / "mine.toml"))
    assert str(tmp_path / "nowhere" / "mine.toml") in str(refused.value)


SINE = '[signals."plant.dm"]\nshape = "sine"\namplitude = 1.0\nfrequency = 1.0\n'
MULTISINE = '[signals."plant.tau_d"]\nshape = "multisine"\nrms = 1.0\nlowest = 1.0\nhighest = 2.0\n'
NOISE = '[disturbances."controller.theta_a"]\nshape = "noise"\nrms = 1.0\n'
HUGE = "1" + "0" * 400

BAD = {
    "not TOML": ("title = ", ["can't be read as TOML", "at end of document"]),
    "key twice": ("title = 'a'\ntitle = 'b'", ["can't be read as TOML"]),
    "unknown key": ("titel = 'a'", ["'titel'", "did you mean 'title'?"]),
    "unknown key far off": (
        "zzz = 1",
        ["'zzz'", "known are title, system, components, connections, run, start, signals"],
    ),
    "unknown in run": ("[run]\nstop = 1.0", ["[run]", "'stop'", "did you mean 'stop_time'?"]),
    "unknown instance in start": ("[start.plnt]\ndm = 0", ["[start]", "'plnt'", "did you mean 'plant'?"]),
    "unknown in a sine": (SINE + "freq = 1.0", ["plant.dm", "'freq'", "did you mean 'frequency'?"]),
    "unknown in a multisine": (MULTISINE + "phase = 1.0", ["plant.tau_d", "'phase'", "unknown key 'phase'"]),
    "title a number": ("title = 1", ["title = 1", "must be a text"]),
    "components a text": ("components = 'plant'", ["components = 'plant'", "must be a list"]),
    "components a table": ("[components]\nplant = 1", ["[components.plant] = 1", "must be a table"]),
    "components empty": ("components = []", ["components = []", "must be a list of names"]),
    "component unknown": ("components = ['plnat']", ["components", "'plnat'", "did you mean 'plant'?"]),
    "component a number": ("components = [1]", ["components", "1", "known are plant"]),
    "component a list": ("components = [['plant']]", ["components", "['plant']"]),
    "component a table": ("components = [{a = 1}]", ["components"]),
    "component twice": ("components = ['plant', 'plant']", ["components", "plant"]),
    "run a number": ("run = 1", ["run = 1 must be a table"]),
    "start a text": ("start = 'x'", ["start = 'x' must be a table"]),
    "start of an instance a number": ("[start]\nplant = 1", ["[start] plant", "must be a table"]),
    "start for one that does not take part": (
        "components = ['plant']\n[start.controller]\nalpha = 0.0",
        ["[start]", "'controller'", "known are plant"],
    ),
    "signals a list": ("signals = []", ["signals = [] must be a table"]),
    "signal a number": ("[signals]\n'plant.dm' = 1", ["plant.dm", "must be a table"]),
    "stop_time a text": ("[run]\nstop_time = '1'", ["[run] stop_time = '1'", "must be a number"]),
    "stop_time a bool": ("[run]\nstop_time = true", ["[run] stop_time = true must be a number"]),
    "stop_time nan": ("[run]\nstop_time = nan", ["[run] stop_time = nan", "must be finite"]),
    "stop_time inf": ("[run]\nstop_time = inf", ["[run] stop_time = inf", "must be finite"]),
    "stop_time beyond floats": (f"[run]\nstop_time = {HUGE}", ["[run] stop_time"]),
    "step_size a date": ("[run]\nstep_size = 2020-01-01", ["[run] step_size", "must be a number"]),
    "steady_after a list": ("[run]\nsteady_after = [8.0]", ["[run] steady_after = [8.0]", "must be a number"]),
    "seed a float": ("[run]\nseed = 1.0", ["[run] seed = 1.0", "must be a whole number"]),
    "seed a bool": ("[run]\nseed = true", ["[run] seed = true", "must be a whole number"]),
    "seed negative": ("[run]\nseed = -1", ["seed", "-1"]),
    "order a number": ("[run]\norder = 1", ["[run] order = 1", "must be a text"]),
    "order unknown": ("[run]\norder = 'paralel'", ["order", "'paralel'", "parallel"]),
    "a truth where numbers are": (
        "[signals.'plant.dm']\nshape = 'step'\ntime = 1\nafter = true",
        ["plant.dm", "after = true must be a number; a Boolean input is true at 1, false at 0"],
    ),
    "shape unknown": (SINE.replace('"sine"', '"sinus"'), ["plant.dm", "'sinus'", "did you mean 'sine'?"]),
    "shape missing": ("[signals.'plant.dm']\namplitude = 1.0", ["plant.dm", "lacks shape"]),
    "shape a list": (SINE.replace('"sine"', "[]"), ["plant.dm", "shape = []"]),
    "shape a table": (SINE.replace('"sine"', "{a = 1}"), ["plant.dm", "shape"]),
    "target without a dot": (SINE.replace("plant.dm", "plant"), ['"plant"', "must be written as component.variable"]),
    "target of no component": (SINE.replace("plant.dm", "plnt.dm"), ["plnt.dm", "did you mean 'plant'?"]),
    "target of one that does not take part": (
        "components = ['plant']\n" + SINE.replace("plant.dm", "controller.theta_a"),
        ["controller", "theta_a"],
    ),
    "amplitude missing": (SINE.replace("amplitude = 1.0\n", ""), ["plant.dm", "lacks amplitude"]),
    "two missing": ('[signals."plant.dm"]\nshape = "sine"\n', ["plant.dm", "lacks amplitude, frequency"]),
    "band missing": (MULTISINE.replace("lowest = 1.0\nhighest = 2.0\n", ""), ["plant.tau_d", "lacks lowest, highest"]),
    "amplitude a text": (SINE.replace("= 1.0", "= 'x'", 1), ["plant.dm", "amplitude = 'x'", "must be a number"]),
    "amplitude a bool": (SINE.replace("= 1.0", "= false", 1), ["plant.dm", "amplitude = false", "must be a number"]),
    "amplitude nan": (SINE.replace("= 1.0", "= nan", 1), ["plant.dm", "amplitude = nan", "must be finite"]),
    "amplitude -inf": (SINE.replace("= 1.0", "= -inf", 1), ["plant.dm", "amplitude = -inf", "must be finite"]),
    "amplitude beyond floats": (SINE.replace("= 1.0", f"= {HUGE}", 1), ["plant.dm", "amplitude"]),
    "components of a multisine zero": (
        MULTISINE + "components = 0",
        ["plant.tau_d", "components = 0", "between 1 and"],
    ),
    "components of a multisine a float": (MULTISINE + "components = 2.0", ["plant.tau_d", "whole number"]),
    "rms of a noise negative": (NOISE.replace("1.0", "-1.0"), ["controller.theta_a", "-1.0", "not be negative"]),
    "period of a noise zero": (NOISE + "period = 0", ["controller.theta_a", "period = 0.0 s", "at least 1e-09 s"]),
    "disturbances a list": ("disturbances = []", ["disturbances = [] must be a table"]),
    "disturbance of no input": (NOISE.replace("theta_a", "theta"), ["disturbances.", "no connection feeds it"]),
    "disturbance where no connection is": (
        NOISE.replace("controller.theta_a", "plant.tau_d"),
        ["plant.tau_d", "no connection feeds it", "[signals]"],
    ),
    "disturbance of one that does not take part": (
        "components = ['plant']\n" + NOISE,
        ["controller.theta_a", "does not take part"],
    ),
    "disturbance whose source does not take part": (
        "components = ['plant', 'trajectory']\n" + NOISE.replace("controller.theta_a", "plant.tau_a"),
        ["plant.tau_a", "no connection feeds it"],
    ),
    "band descending": (MULTISINE.replace("2.0", "0.5"), ["plant.tau_d", "0.5", "must ascend"]),
    "band negative": (MULTISINE.replace("lowest = 1.0", "lowest = -1.0"), ["plant.tau_d", "-1.0", "not be negative"]),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_by_file_and_key(tmp_path, case):
    text, expected = BAD[case]
    path = written(tmp_path, text)
    with pytest.raises(ScenarioError) as refused:
        load_scenario(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for part in expected:
        assert part in message


def test_the_same_file_without_its_mistake_is_accepted(tmp_path):
    scenario = load_scenario(written(tmp_path, SINE + MULTISINE + NOISE))
    assert list(scenario.signals) == ["plant.dm", "plant.tau_d"]
    assert list(scenario.disturbances) == ["controller.theta_a"]


def test_a_file_that_is_not_utf_8_is_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes("title = 'Grüße'".encode("latin-1"))
    with pytest.raises(ScenarioError, match=r"mine\.toml: can't be read as TOML: .*utf-8"):
        load_scenario(str(path))


def test_a_folder_is_no_scenario(tmp_path):
    (tmp_path / "mine.toml").mkdir()
    with pytest.raises(ScenarioError, match="there is no scenario"):
        load_scenario(str(tmp_path / "mine.toml"))


def test_brackets_beyond_measure_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match=r"mine\.toml: can't be read as TOML"):
        load_scenario(written(tmp_path, "x = " + "[" * 5000))


TARGETS = {
    "no variable": ("plant.mass", ["'plant'", "'mass'", "did you mean 'm_a'?"]),
    "an output": ("plant.x_E", ["'plant.x_E'", "output", "must be an input"]),
    "beyond a vector": ("plant.tau_d[4]", ["'tau_d[4]'", "did you mean 'tau_d["]),
}


@pytest.mark.parametrize("case", TARGETS)
def test_a_signal_for_what_is_no_input_of_the_fmu_is_refused_by_file_and_name(robot_run, capsys, case):
    target, expected = TARGETS[case]
    assert robot_run(SINE.replace("plant.dm", target)) == 1
    check_line(capsys, expected)


START = {
    "unknown variable": ("alhpa = 1.0", ["alhpa", "did you mean 'alpha'?"]),
    "text": ("alpha = 'x'", ["alpha", "'x'", "not a number"]),
    "bool": ("alpha = true", ["alpha", "True"]),
    "nan": ("alpha = nan", ["alpha", "nan", "finite"]),
    "inf": ("alpha = inf", ["alpha", "inf", "finite"]),
    "beyond floats": (f"alpha = {HUGE}", ["alpha"]),
    "negative": ("alpha = -1.0", ["alpha", "-1.0", "at least 0.0"]),
    "table": ("alpha = {a = 1}", ["alpha", "not a number"]),
    "wrong size": ("S = [1.0, 2.0]", ["S", "2 values were given for 3"]),
    "ragged": ("S = [[1.0], [2.0, 3.0]]", ["S", "not a number"]),
    "output": ("tau_a = 1.0", ["tau_a", "output"]),
}


@pytest.fixture
def robot_run(fmus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Run a scenario file with the text; names are held against the model descriptions, so the FMUs must be there."""
    from cosim.__main__ import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("parallel_robot.fmus.build_missing", lambda folder, flavour: [])
    monkeypatch.setattr("parallel_robot.fmus.outdated", lambda folder, flavour: [])
    (tmp_path / "pythonfmu").symlink_to(fmus)

    def run(text: str) -> int:
        path = written(tmp_path, "[run]\nstop_time = 0.002\n" + text)
        return main(["run", path, "--flavour", "pythonfmu", "--fmus", str(tmp_path)])

    return run


def check_line(capsys, expected: list[str]) -> None:
    """One line that names the file and what was wrong in it."""
    shown = capsys.readouterr()
    assert shown.out == ""
    lines = shown.err.splitlines()
    assert len(lines) == 1
    assert "mine.toml" in lines[0]
    assert expected
    for part in expected:
        assert part in lines[0]


@pytest.mark.parametrize("case", START)
def test_a_bad_start_value_is_refused_by_file_and_key(robot_run, capsys, case):
    text, expected = START[case]
    assert robot_run(f"[start.controller]\n{text}\n" + SINE + MULTISINE) == 1
    check_line(capsys, ["controller", *expected])


KEYS = (
    st.sampled_from(
        ["title", "components", "run", "start", "signals", "plant", "plant.dm", "plant.tau_d", "controller.x"]
    )
    | st.sampled_from(["shape", "amplitude", "frequency", "phase", "rms", "lowest", "highest", "start_time", "seed"])
    | st.text(max_size=5)
)
SCALARS = (
    st.sampled_from(["sine", "multisine", "plant", "controller", "sequential", "", 10**400, -(10**400), 0, 1, -1])
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.dates()
    | st.datetimes()
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS, inner, max_size=5),
    max_leaves=12,
)
#: Tables that come near to a scenario, so that more than the first check is reached.
SPECS = st.fixed_dictionaries(
    {},
    optional={
        "shape": st.sampled_from(["sine", "multisine"]) | SCALARS | VALUES,
        **{
            k: st.floats(0.0, 1.0) | VALUES
            for k in ("amplitude", "frequency", "rms", "lowest", "highest", "start_time")
        },
        "components": st.integers(-1, 3) | VALUES,
    },
)
DATA = st.fixed_dictionaries(
    {},
    optional={
        "title": st.text() | VALUES,
        "components": st.lists(st.sampled_from(list(MODELS)) | VALUES, max_size=4) | VALUES,
        "run": st.fixed_dictionaries(
            {}, optional=dict.fromkeys(("stop_time", "step_size", "order", "seed", "steady_after"), VALUES)
        )
        | VALUES,
        "start": st.dictionaries(st.sampled_from(list(MODELS)), VALUES) | VALUES,
        "signals": st.dictionaries(
            st.sampled_from(["plant.dm", "plant.tau_d", "plant.tau_d[1]"]) | KEYS, SPECS | VALUES
        )
        | VALUES,
    },
)


@given(DATA | st.dictionaries(KEYS, VALUES, max_size=5))
def test_whatever_the_file_says_it_is_a_scenario_or_a_scenario_error(data):
    try:
        scenario = scenario_from(data, "mine", Path(), FAMILY)
    except ScenarioError:
        return
    assert set(scenario.components) <= set(COMPONENTS)
    assert all(isinstance(s, Shape) for s in (*scenario.signals.values(), *scenario.disturbances.values()))
    assert all(math.isfinite(v) for v in (scenario.stop_time, scenario.step_size, scenario.steady_after))
