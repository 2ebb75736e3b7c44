"""Sweeps of the robot: what points mean, which numbers come out, and what is refused before anything runs."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import pytest

from cosim import simulate
from cosim.scenario.scenario import ScenarioError
from cosim.scenario.signals import Noise
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Levels, Range, parse_factor
from cosim.sweep.scenarios import check
from fmu_export.package.start_values import write_start_values
from parallel_robot.metrics import metrics, tracking_errors
from parallel_robot.scenario import load_scenario
from parallel_robot.sweep import METRICS, RobotStudy, flat, robot_study
from tests.support import some
from tests.support.native_fmus import DEFAULT_FLAVOUR


def scenario(name: str = "tracking"):
    """Short, and after 0.2 s steady and disturbed."""
    loaded = load_scenario(name)
    signals = {
        target: dataclasses.replace(signal, start_time=0.1) if hasattr(signal, "start_time") else signal
        for target, signal in loaded.signals.items()
    }
    return dataclasses.replace(loaded, stop_time=0.3, steady_after=0.2, signals=signals)


@pytest.fixture(scope="module")
def made(robot_fmus: Path) -> tuple[RobotStudy, dict[str, Path]]:
    scenarios = {name: scenario(name) for name in ("tracking", "pd")}
    return robot_study(scenarios, robot_fmus, [DEFAULT_FLAVOUR])


def run(made: tuple[RobotStudy, dict[str, Path]], point: dict) -> dict:
    study, files = made
    planned = study.plan(point)
    with study.simulation(planned.variant, files.__getitem__) as simulation:
        results = simulation.run(planned.stop_time, planned.step_size, start=planned.start, signals=planned.signals)
        return study.row(planned, results)


def by_simulate(robot_fmus: Path, changed) -> dict:
    results = simulate(
        changed.system(robot_fmus, DEFAULT_FLAVOUR), changed.stop_time, changed.step_size, order=changed.order
    )
    return dict(flat(metrics(results, changed.steady_after)))


def without_times(row: dict) -> dict:
    return {name: value for name, value in row.items() if name not in ("loop_time_s", "steady_after")}


def test_a_row_is_all_metrics_of_the_run(made, robot_fmus):
    row = run(made, {})
    expected = by_simulate(robot_fmus, scenario())
    assert without_times(row) == without_times(expected)
    assert tuple(row) == METRICS
    assert all(isinstance(value, float) for value in row.values())


@pytest.mark.parametrize(
    ("point", "change"),
    [
        ({"controller.alpha": 2.5}, lambda s: s.with_start_value("controller", "alpha", 2.5)),
        ({"controller.S[2]": 3.0}, lambda s: s.with_start_value("controller", "S[2]", 3.0)),
        ({"seed": 7}, lambda s: dataclasses.replace(s, seed=7)),
        (
            {"plant.tau_d.rms": 0.05, "plant.tau_d.components": 5.0, "seed": 3},
            lambda s: dataclasses.replace(
                s,
                seed=3,
                signals={
                    **s.signals,
                    "plant.tau_d": dataclasses.replace(s.signals["plant.tau_d"], rms=0.05, components=5),
                },
            ),
        ),
    ],
)
def test_a_factor_does_what_the_same_change_of_the_scenario_does(made, robot_fmus, point, change):
    changed = without_times(run(made, point))
    assert changed == without_times(by_simulate(robot_fmus, change(scenario())))
    assert changed != without_times(run(made, {}))


def test_the_noise_of_a_sensor_and_the_step_are_factors(robot_fmus):
    noisy = scenario("tracking-noise")
    made = robot_study({"tracking-noise": noisy}, robot_fmus, [DEFAULT_FLAVOUR])
    point = {"controller.theta_a.rms": 2e-3, "controller.omega_a.period": 0.01, "step_size": 2e-3, "seed": 4}
    changed = dataclasses.replace(
        noisy,
        seed=4,
        step_size=2e-3,
        disturbances={"controller.theta_a": Noise(2e-3, 4e-3), "controller.omega_a": Noise(0.01, 0.01)},
    )
    rows = [without_times(run(made, p)) for p in (point, {})]
    expected = [without_times(by_simulate(robot_fmus, s)) for s in (changed, noisy)]
    assert rows == expected
    assert rows[0] != rows[1]
    # the noise is there: without it the torque is another one
    quiet = run(made, {"controller.theta_a.rms": 0.0, "controller.omega_a.rms": 0.0})
    assert quiet["control_effort.integral"] < 0.99 * rows[1]["control_effort.integral"]
    study, files = made
    check(study, files, [Levels("step_size", (1e-3, 2e-3)), Levels("controller.theta_a.rms", (0.0, 1.0))])
    with pytest.raises(SweepError, match=r"not a whole number of steps of 0\.07 s"):
        check(study, files, [Levels("step_size", (1e-3, 0.07))])
    with pytest.raises(SweepError, match="a noise has no number 'mean'"):
        check(study, files, [Levels("controller.theta_a.mean", (0.0, 1.0))])


def test_rows_have_curves_of_the_errors_where_asked(robot_fmus):
    made = robot_study({"tracking": scenario()}, robot_fmus, [DEFAULT_FLAVOUR], curve_period=0.1)
    study, files = made
    assert study.curves == tuple(f"tracking.{e}.curve" for e in ("x", "y", "theta_a[1]", "theta_a[2]", "theta_a[3]"))
    fine, coarse = (run(made, {"step_size": step}) for step in (1e-3, 2e-3))
    assert tuple(fine) == (*METRICS, *study.curves)
    results = simulate(scenario().system(robot_fmus, DEFAULT_FLAVOUR), 0.3, 1e-3)
    for name, errors in some(tracking_errors(results).items()):
        assert fine[f"tracking.{name}.curve"].tolist() == errors[[0, 100, 200, 300]].tolist()
        # the same times, whatever the step; linear coupling is good to 1e-6 m at 2 ms
        assert coarse[f"tracking.{name}.curve"] == pytest.approx(errors[[0, 100, 200, 300]], abs=1e-5)
    with pytest.raises(SweepError, match=r"need steps that divide it, not 0\.03 s"):
        check(study, files, [Levels("step_size", (1e-3, 0.03))])


def test_the_scenario_is_a_factor(made, robot_fmus):
    assert without_times(run(made, {"scenario": "pd"})) == without_times(by_simulate(robot_fmus, scenario("pd")))


def test_flavours_and_fmu_files_are_factors(robot_fmus, tmp_path):
    tuned = tmp_path / "tuned.fmu"
    shutil.copy(robot_fmus / DEFAULT_FLAVOUR / "RobotController.fmu", tuned)
    write_start_values(tuned, {"alpha": 2.5})
    first = robot_fmus / DEFAULT_FLAVOUR / "RobotController.fmu"
    flavours = list(dict.fromkeys([DEFAULT_FLAVOUR, "pythonfmu"]))
    held = dataclasses.replace(scenario(), extrapolation="hold")
    made = robot_study({"tracking": held}, robot_fmus, flavours, {"controller": [first, tuned]})
    study, files = made
    assert len(files) == 3 * len(flavours) + 1
    plain, changed = ({"controller.fmu": str(path)} for path in (first, tuned))
    by_value = without_times(run(made, {"controller.alpha": 2.5}))
    assert without_times(run(made, changed)) == by_value
    assert without_times(run(made, plain)) != by_value
    for flavour in flavours:  # the native ones to the last bit
        found = without_times(run(made, {**changed, "flavour": flavour}))
        assert found == (by_value if flavour == DEFAULT_FLAVOUR else pytest.approx(by_value, rel=1e-11, abs=1e-12))
    variants = {study.plan({**c, "flavour": f}).variant for c in (plain, changed) for f in flavours}
    assert len(variants) == 2 * len(flavours)
    assert variants == set(study.variants())
    check(study, files, [])


def test_neighbours_with_the_same_seed_share_their_signals(made):
    study, _ = made
    a, b = (study.plan({"seed": 5, "controller.alpha": x}).signals for x in (1.0, 2.0))
    assert [s.function for s in a] == [s.function for s in b]
    assert [s.function for s in study.plan({"seed": 6}).signals] != [s.function for s in a]
    assert study.plan({"seed": scenario().seed}).signals == []


def test_what_a_run_does_not_have_is_none(robot_fmus):
    short = dataclasses.replace(load_scenario("open-loop"), stop_time=0.01)
    row = run(robot_study({"open-loop": short}, robot_fmus, [DEFAULT_FLAVOUR]), {})
    assert row["tracking.x.max"] is None
    assert row["closure_error_max"] < 1e-9
    early = dataclasses.replace(load_scenario("tracking"), stop_time=0.01)
    row = run(robot_study({"tracking": early}, robot_fmus, [DEFAULT_FLAVOUR]), {})
    assert row["tracking.x.steady_max"] is None
    assert row["tracking.x.max"] > 0.0


def test_the_fingerprint_holds_all_that_decides(made, robot_fmus):
    study, _ = made
    fingerprint = json.dumps(study.fingerprint())
    assert json.loads(fingerprint) == study.fingerprint()
    held = {label: dataclasses.replace(s, extrapolation="hold") for label, s in study.scenarios.items()}
    changed = [
        robot_study({"tracking": scenario()}, robot_fmus, [DEFAULT_FLAVOUR]),
        robot_study(held, robot_fmus, [DEFAULT_FLAVOUR]),
        robot_study(
            {**study.scenarios, "pd": dataclasses.replace(scenario("pd"), seed=2)},
            robot_fmus,
            [DEFAULT_FLAVOUR],
        ),
    ]
    assert len({fingerprint, *(json.dumps(other.fingerprint()) for other, _ in changed)}) == 4


# Refused before anything runs


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        ("controller.alfa=1,2", "did you mean 'alpha'?"),
        ("controler.alpha=1,2", "did you mean 'controller'?"),
        ("alpha=1,2", "component.variable"),
        ("plant.x_E=1,2", "output variables can't be set"),
        ("plant.tau_a=1,2", "a connection or a signal feeds it"),
        ("plant.dm=0:1", "a connection or a signal feeds it"),
        ("plant.tau_d.rsm=0:1", "a multisine has no number 'rsm'; did you mean 'rms'?"),
    ],
)
def test_a_wrong_name_is_one_line(made, factor, says):
    study, files = made
    with pytest.raises(SweepError) as error:
        check(study, files, [parse_factor(factor)])
    assert str(error.value).startswith("scenario tracking: ")
    assert says in str(error.value)
    assert factor.partition("=")[0].split(".")[0] in str(error.value)
    assert "\n" not in str(error.value)


def test_values_that_some_runs_can_not_have_are_their_rows(made):
    study, files = made
    check(study, files, [Levels("controller.alpha", (-1.0, 1.0)), Range("plant.tau_d.rms", -1.0, 1.0)])
    with pytest.raises(ScenarioError, match=r"plant\.tau_d\.rms: rms = -1\.0 must"):
        study.plan({"plant.tau_d.rms": -1.0})
    with pytest.raises(ScenarioError, match="whole number"):
        study.plan({"plant.tau_d.components": 2.5})


def test_a_step_that_does_not_fit_is_one_line(robot_fmus):
    odd = dataclasses.replace(scenario(), step_size=0.07)
    study, files = robot_study({"tracking": odd}, robot_fmus, [DEFAULT_FLAVOUR])
    with pytest.raises(SweepError, match=r"not a whole number of steps of 0\.07 s; stop at 0\.28 s or 0\.35 s"):
        check(study, files, [])


@pytest.mark.parametrize(
    ("own", "says"),
    [({"controler": ["a.fmu"]}, "did you mean 'controller'?"), ({"plant": ["nowhere.fmu"]}, "nowhere.fmu: No such")],
)
def test_fmu_files_that_make_no_sense_are_one_line(robot_fmus, own, says):
    paths = {instance: [Path(p) for p in names] for instance, names in own.items()}
    with pytest.raises(SweepError) as error:
        robot_study({"tracking": scenario()}, robot_fmus, [DEFAULT_FLAVOUR], paths)
    assert says in str(error.value)


def test_what_is_no_fmu_is_one_line(robot_fmus, tmp_path):
    (tmp_path / "text.fmu").write_text("no archive")
    own = {"plant": [tmp_path / "text.fmu"]}
    study, files = robot_study({"tracking": scenario()}, robot_fmus, [DEFAULT_FLAVOUR], own)
    with pytest.raises(SweepError, match="not an FMU"):
        check(study, files, [])
