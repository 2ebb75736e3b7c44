"""The robustness study: what is varied, verdicts that follow the numbers, and the command with its files."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import zlib
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from controller_fmu.membership import Sine, Triangle, d_operation
from cosim.__main__ import main
from cosim.sweep.errors import SweepError
from cosim.sweep.points import Levels, Range
from cosim.sweep.store import read
from parallel_robot.paper.report.robustness import robustness_section
from parallel_robot.paper.reproduce.figures.style import ERROR_NAMES
from parallel_robot.paper.reproduce.table import controllers
from parallel_robot.paper.robustness import draw
from parallel_robot.paper.robustness.content import FIGURES, Index, Robustness, RobustnessError, Sensitivity, load
from parallel_robot.paper.robustness.front import NEAR, fronts, gain_of_others
from parallel_robot.paper.robustness.rows import Rows
from parallel_robot.paper.robustness.rows import gains as gain_rows
from parallel_robot.paper.robustness.spread import bands, spreads
from parallel_robot.paper.robustness.study import (
    ALPHA,
    BETA,
    CONDITIONS,
    CURVE_PERIOD,
    SCENARIO,
    drawn_by_membership,
    monte_carlo,
    sources,
)
from parallel_robot.paper.robustness.text import findings
from parallel_robot.scenario import load_scenario
from tests.support import some
from tests.support.html import Elements
from tests.support.native_fmus import DEFAULT_FLAVOUR
from tests.support.patience import PATIENCE, wait_for

ROOT = Path(__file__).parents[3]

# What is uncertain


@pytest.mark.parametrize("membership", [Sine(), Triangle(0.1, 0.4, 0.5)])
def test_a_mean_over_draws_of_a_fuzzy_number_is_its_d_operation(membership):
    quantile = drawn_by_membership(membership)
    draws = quantile((np.arange(4096) + 0.5) / 4096)
    assert membership.support[0] < draws.min() < draws.max() < membership.support[1]
    for f in (lambda v: v, lambda v: v**2, lambda v: np.exp(3.0 * v)):
        assert np.mean(f(draws)) == pytest.approx(d_operation(f, membership), rel=1e-5)
    # drawn evenly over the support, the mean of the square is another one
    even = np.linspace(*membership.support, 4096)
    assert np.mean(even**2) != pytest.approx(d_operation(lambda v: v**2, membership), rel=0.01)


def test_draws_of_the_paper_s_membership_in_closed_form():
    # integral of sin(2 pi v) up to v over that up to 0.5: (1 - cos(2 pi v))/2
    u = np.linspace(0.01, 0.99, 50)
    expected = np.arccos(1.0 - 2.0 * u) / (2.0 * np.pi)
    assert drawn_by_membership(Sine())(u) == pytest.approx(expected, abs=1e-6)


def test_everything_that_the_issue_of_robustness_names_is_varied():
    scenario = load_scenario(SCENARIO)
    factors = {s.uncertain.factor.name: s.uncertain.factor for s in sources(scenario)}
    assert set(factors) == {
        "plant.dm.amplitude",
        "plant.dm.phase",
        "plant.x_E_start",
        "plant.y_E_start",
        "plant.tau_d.rms",
        "seed",
        "controller.theta_a.rms",
        "controller.omega_a.rms",
        "step_size",
    }
    # the paper's case lies inside of all ranges
    for name, value in {
        "plant.dm.amplitude": 0.25,
        "plant.x_E_start": 0.22,
        "plant.y_E_start": 0.30,
        "plant.tau_d.rms": load_scenario("tracking").signals["plant.tau_d"].rms,
    }.items():
        assert isinstance(factors[name], Range)
        assert factors[name].low < value < factors[name].high
        assert value == pytest.approx((factors[name].low + factors[name].high) / 2.0)


def test_all_steps_see_the_same_noise_and_meet_the_points_of_the_bands():
    scenario = load_scenario(SCENARIO)
    (steps,) = [s.uncertain.factor for s in sources(scenario) if s.uncertain.factor.name == "step_size"]
    assert isinstance(steps, Levels)
    for step in steps.values:
        for whole in (CURVE_PERIOD, scenario.stop_time, *(n.period for n in scenario.disturbances.values())):
            assert whole / step == pytest.approx(round(whole / step), rel=1e-12)


# Verdicts follow the numbers


def gain_study(cost_of_one: tuple[float, float]) -> Rows:
    """Runs over a grid whose front is error * effort = 1, with the optimum of (1, 1) at a given error and effort."""
    six = controllers()
    alpha, beta = (g.ravel() for g in np.meshgrid(np.geomspace(0.1, 100.0, 15), [1.0, 2.0], indexing="ij"))
    error, effort = 10.0 / np.sqrt(alpha), np.sqrt(alpha) / 10.0 * beta  # beta = 2: twice the effort for nothing
    paper = np.array([cost_of_one if c.key == "1" else (50.0, 50.0) for c in six])
    n = len(six) + len(alpha)
    return Rows(
        error=np.tile([*paper[:, 0], *error], 2),
        effort=np.tile([*paper[:, 1], *effort], 2),
        steady_max={name: np.ones(2 * n) for name in ERROR_NAMES},
        curves={name: np.zeros((2 * n, 4)) for name in ERROR_NAMES},
        factors={
            "scenario": np.repeat(CONDITIONS, n),
            ALPHA: np.tile([*(c.alpha for c in six), *alpha], 2),
            BETA: np.tile([*(c.beta for c in six), *beta], 2),
        },
    )


@pytest.mark.parametrize(
    ("error", "effort", "place", "dominated_by"),
    [
        (0.999, 1.0, "on the front", 0),
        (1.05, 1.05, "near the front", 1),
        (1.2, 1.05, "away from the front", 1),
        (1.05, 1.2, "away from the front", 1),
        (30.0, 30.0, "away from the front", 28),
    ],
)
def test_places_of_controllers(error, effort, place, dominated_by):
    for front in some(fronts(gain_study((error, effort)))):
        one = next(p for p in front.placed if p.controller == "1")
        assert (one.place, one.dominated_by) == (place, dominated_by)
        assert (one.error, one.effort) == (error, effort)
        # the front: beta = 1 only; alpha = 1 is the point (1, 1) of it
        assert {p.beta for p in front.points} == {1.0}
        assert (front.gains, len(front.points), front.at_edge, front.beyond_proof) == (30, 15, 1, 0)
        if 1.0 <= min(error, effort) < 10.0 and max(error, effort) < 1.25:
            assert (one.error_alone, one.effort_alone) == pytest.approx((error, effort))
        answer = answers(gain_study((error, effort)))[-1]
        assert f"is {place}: " in answer
        assert ("better in both; at no more effort" in answer) == (dominated_by > 0)


def answers(gains_of: Rows, error: float = 2.0, total: tuple[float, float] = (0.5, 0.7)) -> list[str]:
    """Answers for runs of a given steady error (mm), of which one source explains so much."""
    n = 40
    runs = Rows(
        error=np.full(n, error),
        effort=np.ones(n),
        steady_max={name: np.full(n, error) for name in ERROR_NAMES},
        curves={name: np.full((n, 4), error) for name in ERROR_NAMES},
        factors={},
    )
    indices = (Index("mass", 0.6, 0.6, (0.5, 0.7), total), Index("start", 0.0, 0.0, (-0.1, 0.1), (0.0, 0.01)))
    found = findings(
        runs,
        3,
        spreads(runs, gains_of, 0),
        [Sensitivity("steady error", indices, {"mass": -0.5})],
        fronts(gains_of),
    )
    return [finding.answer for finding in found]


def test_answers_follow_the_numbers():
    gains_of = gain_study((1.0, 1.0))
    assert answers(gains_of)[0].startswith("3 of 40 runs failed. The steady error is 2 mm in the median")
    assert "none does" in answers(gains_of)[1]
    reached = answers(gains_of, error=0.01)[1]  # below 0.012 mm in y and the joints, not below 0.006 mm in x
    assert reached.startswith("Of the 40 runs 40 in y, 40 in active joint 1")
    assert "in x," not in reached.split(".")[0]
    depends = answers(gains_of)[2]
    assert depends.startswith("It depends on the mass (60 % of the variance, 50 to 70 %, falling as it grows).")
    assert depends.endswith("Each of these surely explains less than 5 %: start.")
    assert answers(gains_of, total=(0.01, 0.3))[2].startswith("It depends on no source for sure.")
    assert answers(gains_of, total=(0.01, 0.3))[2].endswith("The runs are too few to judge: mass.")


def test_near_is_what_is_said():
    assert pytest.approx(1.0 / 0.9) == NEAR
    grid = np.array([[1.0, 4.0], [2.0, 2.0], [4.0, 1.0]])
    factors = gain_of_others(np.array([[2.0, 2.0], [3.0, 3.0], [0.5, 9.0], [5.0, 0.5]]), grid)
    assert factors.tolist() == [[1.0, 1.0], [1.5, 1.5], [1.0, 1.0], [1.0, 1.0]]


def test_bands_are_the_runs_in_order_and_leave_failed_ones_out():
    curves = np.array([[float(i), -2.0 * i] for i in range(101)] + [[np.nan, np.nan]])
    rows = dataclasses.replace(gain_study((1.0, 1.0)), curves={"x": curves})
    assert bands(rows)["x"].T.tolist() == [[5.0, 25.0, 50.0, 75.0, 95.0], [-190.0, -150.0, -100.0, -50.0, -10.0]]


# The command

RUNS, LEVELS = "20", "3"


def arguments(fmus: Path, out: Path) -> list[str]:
    options = ("--runs", RUNS, "--levels", LEVELS, "--workers", "1")
    return ["robustness", "--fmus", str(fmus), "--out", str(out), *options]


@pytest.fixture(scope="module")
def finished(robot_fmus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small study."""
    out = tmp_path_factory.mktemp("robustness") / "out"
    assert main(arguments(robot_fmus, out)) == 0
    return out


@pytest.fixture(scope="module")
def study(finished: Path) -> Robustness:
    return load(finished)


@pytest.mark.slow
def test_the_study_is_whole(finished, study):
    names = {p.name for p in finished.iterdir()}
    assert names == {"monte-carlo", "gains", "figures", "bands.csv", "robustness.json", "robustness.md", "summary.json"}
    assert (study.runs, study.failed, study.levels) == (20, 0, 3)
    assert [len(f.placed) for f in study.fronts] == [6, 6]
    assert {i.group for s in study.sensitivities for i in s.indices} == {s.group for s in study.sources}
    text = (finished / "robustness.md").read_text(encoding="utf-8")
    for finding in study.findings:
        assert finding.answer in text
    bands_csv = np.genfromtxt(finished / "bands.csv", delimiter=",", names=True, deletechars="")
    assert len(bands_csv) == 151
    assert bands_csv["time"][-1] == 15.0


@pytest.mark.slow
def test_the_paper_s_case_is_that_of_a_run_alone(finished, study, robot_fmus):
    from cosim import simulate
    from parallel_robot.metrics import tracking_errors

    scenario = load_scenario("tracking")
    results = simulate(scenario.system(robot_fmus, DEFAULT_FLAVOUR), scenario.stop_time, scenario.step_size)
    errors = tracking_errors(results)
    steady = results.time >= 8.0
    distance = 1e3 * np.hypot(errors["x"][steady], errors["y"][steady])
    torque = np.linalg.norm(results["plant.tau_a"], axis=1)
    one = next(p for p in study.fronts[0].placed if p.controller == "1")
    assert one.error == pytest.approx(np.sqrt(np.mean(distance**2)), rel=1e-9)
    assert one.effort == pytest.approx(np.sqrt(np.trapezoid(torque**2, results.time) / 15.0), rel=1e-9)
    assert study.spreads[0].nominal == one.error
    curves = gain_rows(finished).curves["x"]
    which = [c.key for c in controllers()].index("1")
    assert curves[which] == pytest.approx(1e3 * errors["x"][::100], rel=1e-6)


@pytest.mark.slow
def test_a_killed_study_goes_on_and_comes_to_the_same(finished, robot_fmus, tmp_path, capsys, monkeypatch):
    command = [sys.executable, "-m", "cosim", *arguments(robot_fmus, tmp_path / "out")]
    started = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, start_new_session=True)
    results = tmp_path / "out" / "monte-carlo" / "results"
    wait_for(lambda: started.poll() is not None or list(results.glob("part-*.parquet")))
    assert started.poll() is None
    os.killpg(started.pid, signal.SIGKILL)  # all at once: the study, its scheduler and its workers
    started.wait(timeout=PATIENCE)
    done = read(tmp_path / "out" / "monte-carlo").num_rows
    assert 1 <= done < 20
    assert not (tmp_path / "out" / "robustness.json").exists()

    monkeypatch.setattr(draw, "save", lambda *_: None)  # takes longer than the runs
    assert main(arguments(robot_fmus, tmp_path / "out")) == 0
    assert f"20 of 20, {20 - done} of them now" in capsys.readouterr().out
    for name in ("monte-carlo", "gains"):
        tables = [read(folder / name).drop_columns("loop_time_s") for folder in (finished, tmp_path / "out")]
        assert tables[0].equals(tables[1])
    for name in ("robustness.json", "robustness.md", "bands.csv"):
        assert (finished / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


@pytest.mark.slow
def test_figures_are_there_and_no_text_is_cut(finished, study):
    for figure in some(study.figures):
        picture = matplotlib.image.imread(finished / "figures" / f"{figure.name}.png")
        edge = np.concatenate([picture[[0, -1]].reshape(-1, 4), picture[:, [0, -1]].reshape(-1, 4)])
        assert (edge[:, :3] == 1.0).all(), figure.name
        assert figure.title
        assert figure.caption
        assert figure.alt


@pytest.mark.slow
def test_the_section_of_the_report_holds_all_of_it(finished, study):
    section = robustness_section(study, finished)
    html = section.html
    elements = Elements(html)
    assert elements.open == []
    images = [a for tag, a, _ in elements.all if tag == "img"]
    assert [a["alt"] for a in images] == [figure.alt for figure in study.figures]
    names = [figure.name for figure in study.figures]
    assert [zlib.decompress(block) for block in section.blocks.values()] == [
        (finished / FIGURES / f"{name}.svg").read_bytes() for name in names
    ]
    for text in (*(s.group for s in study.sources), "on the front", "fuzzy number (88)"):
        assert text in html
    assert html.count("<dt>") == len(study.findings)


@pytest.mark.slow
def test_a_folder_without_a_study_is_one_line(finished, tmp_path, capsys):
    assert main(["reproduce", "--robustness", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"cosim: {tmp_path}/robustness.json: No such file")
    assert err.endswith(f"run: cosim robustness --out {tmp_path}\n")
    for text in (
        "[1]",
        "{}",
        "no JSON",
        json.dumps({**json.loads((finished / "robustness.json").read_text()), "x": 1}),
    ):
        (tmp_path / "robustness.json").write_text(text)
        with pytest.raises(RobustnessError, match="no study of this version"):
            load(tmp_path)
    (tmp_path / "robustness.json").write_bytes((finished / "robustness.json").read_bytes())
    with pytest.raises(RobustnessError, match=r"bands\.svg is missing"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--runs", "0", "0 runs can't be made"),
        ("--runs", "10", "10 runs are too few for sensitivities; ask for at least 11"),
        ("--levels", "1", "a grid of 1 levels has no front"),
        ("--seed", "-1", "seed -1 must be 0 or greater"),
        ("--workers", "0", "at least one"),
    ],
)
def test_what_makes_no_sense_is_one_line(robot_fmus, tmp_path, capsys, option, value, says):
    assert main(["robustness", "--fmus", str(robot_fmus), "--out", str(tmp_path / "out"), f"{option}={value}"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1


@pytest.mark.slow
def test_another_design_in_the_same_folder_is_refused(finished, robot_fmus, capsys):
    command = [*arguments(robot_fmus, finished), "--seed", "5"]
    assert main(command) == 1
    assert "holds another sweep (other points_sha256)" in capsys.readouterr().err


def test_the_design_is_fixed_by_its_seed(robot_fmus):
    same, again, other = (monte_carlo(robot_fmus, DEFAULT_FLAVOUR, 20, seed).points.sha256() for seed in (1, 1, 2))
    assert same == again != other
    with pytest.raises(SweepError, match="more than one sweep takes"):
        monte_carlo(robot_fmus, DEFAULT_FLAVOUR, 10**9, 0)
