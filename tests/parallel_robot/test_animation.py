"""The robot in motion in pages of runs: whatever controller ran, whatever the components are called."""

from __future__ import annotations

import dataclasses
import zlib
from pathlib import Path

import numpy as np
import pytest

from cosim import System, simulate
from cosim.results.page.run_page import run_page
from cosim.results.results import Results
from parallel_robot.animation.motion import chain_forces, motion_of
from parallel_robot.animation.section import robot_section
from parallel_robot.scenario import load_scenario
from tests.support import some
from tests.support.browser import Tabs, accessible, fits, until
from tests.support.native_fmus import DEFAULT_FLAVOUR


@pytest.fixture(scope="module")
def run(robot_fmus: Path) -> Results:
    system = load_scenario("tracking").system(robot_fmus, DEFAULT_FLAVOUR)
    return simulate(system, stop_time=1.0, step_size=1e-3)


@pytest.fixture(scope="module")
def alone(robot_fmus: Path) -> Results:
    """A plant of another name, without controller and path."""
    system = System()
    system.add("arm", robot_fmus / DEFAULT_FLAVOUR / "RobotPlant.fmu")
    system.drive("arm.tau_a", lambda t: [0.05, 0.0, -0.05])
    return simulate(system, stop_time=0.5, step_size=1e-3)


def test_closure_forces_add_up_to_zero_and_do_the_work_of_F_c(run, alone):
    for results, plant in ((run, "plant."), (alone, "arm.")):
        f = chain_forces(results, plant)
        assert np.abs(f.sum(axis=1)).max() < 1e-9 * np.abs(f).max()
        l = results.info["parameters"][f"{plant}l"]
        for name, columns in (("theta_a", slice(0, 3)), ("theta_b", slice(3, 6))):
            angle = results[f"{plant}{name}"]
            torque = l * (-np.sin(angle) * f[:, :, 0] + np.cos(angle) * f[:, :, 1])
            assert np.abs(torque - results[f"{plant}F_c"][:, columns]).max() < 1e-12


def test_the_chains_as_drawn_meet_at_the_end_effector(run, alone):
    for results in (run, alone):
        motion = motion_of(results, "0", "a run")
        assert motion is not None
        assert (motion.step, motion.rows) == (pytest.approx(0.01), 1 + (len(results.time) - 1) // 10)
        c, l = motion.columns, motion.geometry["l"]
        for i in (1, 2, 3):
            a, b = c[f"a{i}"], c[f"b{i}"]
            assert motion.geometry["x_A"][i - 1] + l * (np.cos(a) + np.cos(b)) == pytest.approx(c["E_x"], abs=1e-9)
            assert motion.geometry["y_A"][i - 1] + l * (np.sin(a) + np.sin(b)) == pytest.approx(c["E_y"], abs=1e-9)
    assert "error" not in c
    tracking = motion_of(run, "0", "a run")
    assert tracking is not None
    errors = np.hypot(run["plant.x_E"] - run["trajectory.x_ref"], run["plant.y_E"] - run["trajectory.y_ref"])
    np.testing.assert_array_equal(tracking.columns["error"], errors[::10])


def test_the_section_has_all_runs_with_the_robot_and_views_that_hold_all_that_moves(run, alone):
    other = Results(run.time, ["tank.level"], np.zeros((len(run.time), 1)))
    assert robot_section({"other": other}) is None
    nameless = Results(run.time, run.names, run.values)  # whose geometry nobody knows
    assert robot_section({"other": nameless}) is None
    section = robot_section({"first": run, "other": other, "second": alone})
    assert section is not None
    data = section.data["robot"]
    assert [r["label"] for r in data["runs"]] == ["first", "second"]
    left, bottom, right, top = data["views"]["whole"]
    for motion in some([motion_of(run, "0", ""), motion_of(alone, "0", "")]):
        for i in (1, 2, 3):
            x_A, y_A, l = motion.geometry["x_A"][i - 1], motion.geometry["y_A"][i - 1], motion.geometry["l"]
            assert left < min(x_A, (x_A + l * np.cos(motion.columns[f"a{i}"])).min())
            assert right > max(x_A, (x_A + l * np.cos(motion.columns[f"a{i}"])).max())
            assert bottom < min(y_A, (y_A + l * np.sin(motion.columns[f"a{i}"])).min())
            assert top > max(y_A, (y_A + l * np.sin(motion.columns[f"a{i}"])).max())
    for described in data["runs"]:
        octets = zlib.decompress(section.blocks[described["block"]])
        assert len(octets) == 4 * described["rows"] * len(described["names"])


def test_the_force_of_the_third_chain_is_sent_where_it_does_not_follow_from_the_others(run):
    motion = motion_of(run, "a", "")
    assert motion is not None
    assert set(motion.columns) - set(motion.sent) == {"f3_x", "f3_y"}
    for changed in ({"f3_x": motion.columns["f3_x"] + 0.01}, {"f1_x": np.full(motion.rows, np.nan)}):
        other = dataclasses.replace(motion, columns={**motion.columns, **changed})
        assert other.sent == other.columns


def test_the_page_of_a_run_has_it(run):
    text = run_page(run)
    assert text.index('<section id="robot"') < text.index('<section id="signals"')
    assert text.count('class="stage"') == 2


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_it_plays_in_the_page_of_a_run(browser, run, tmp_path, width):
    page = tmp_path / "page.html"
    page.write_text(run_page(run), encoding="utf-8")
    tabs = Tabs(browser)
    tab = tabs.open(page, width=width)
    until(tab, "document.querySelector('.player').dataset.state === 'paused'")
    third = tab.evaluate("at([...MOTIONS.values()][0], 'f3_x', 0.5)")
    force = motion_of(run, "a", "").columns["f3_x"][50]
    assert third == pytest.approx(force, rel=1e-5)  # 32-bit floats of the others
    tab.focus(".player")
    tab.keyboard.press("End")
    assert tab.get_attribute(".player", "data-time") == "1.000"
    tab.keyboard.press("Home")
    tab.click(".play")
    until(tab, "Number(document.querySelector('.player').dataset.time) > 0.1")
    accessible(tab)
    fits(tab)
    tabs.close()
