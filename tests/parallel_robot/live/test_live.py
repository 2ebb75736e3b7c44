"""The live page: what acts on the robot, presets, J's map, and the page in a browser."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller_fmu.optimal_gains import PerformanceIndex
from cosim.__main__ import main
from cosim.master.simulation import Simulation
from cosim.scenario.signals import Multisine, Sine
from parallel_robot.live.page import _CLOSED, _CONTROLS, _GROUPS
from parallel_robot.live.presets import index_data, presets
from parallel_robot.live.surroundings import surroundings
from parallel_robot.models import closed_loop_model
from parallel_robot.paper.reproduce.acting import signals
from parallel_robot.paper.reproduce.readings import ASSUMPTIONS
from parallel_robot.scenario import RobotScenario, load_scenario
from tests.support import some
from tests.support.browser import Tabs, accessible, fits, until
from tests.support.html import Elements
from tests.support.native_fmus import DEFAULT_FLAVOUR


@pytest.fixture(scope="module")
def scenario() -> RobotScenario:
    return load_scenario("tracking")


def acting(model: Any, t: float, **others: float) -> Any:
    """Outputs of what acts, by numpy, with other values of parameters."""
    p = model.parameters.starts.copy()
    for name, value in others.items():
        p[model.parameters.names.index(name)] = value
    return model.outputs.unpack(model.output_values(t, np.zeros(0), np.zeros(0), p))


def test_what_acts_is_what_the_scenario_says(scenario: RobotScenario) -> None:
    model = surroundings(scenario)
    said = {name: scenario.signals[name].function(3, scenario.seed, name) for name in ("plant.tau_d", "plant.dm")}
    for t in (0.0, 1.3, 3.999, 4.0, 4.001, 14.9):
        found = acting(model, t)
        assert found.tau_d == pytest.approx(said["plant.tau_d"](t), rel=1e-13, abs=0.0)
        assert found.dm == pytest.approx(said["plant.dm"](t)[0], rel=1e-15)
        assert found.dm_rate == 0.0
        strong = Multisine(0.07, 0.5, 10.0, 20, 2.0).function(3, scenario.seed, "plant.tau_d")
        assert acting(model, t, rms=0.07, onset=2.0).tau_d == pytest.approx(strong(t), rel=1e-13, abs=0.0)
        slope = (acting(model, t + 1e-6).dm - acting(model, t - 1e-6).dm) / 2e-6
        assert acting(model, t, at_rest=1.0).dm_rate == pytest.approx(slope, abs=1e-8)


def test_drawn_sines_are_those_of_the_signal() -> None:
    shape = Multisine(0.5, 1.0, 4.0, 3, 1.0)
    frequencies, phases = shape.drawn(2, 7, "a.b")
    assert frequencies.shape == phases.shape == (3, 2)
    assert ((frequencies >= 1.0) & (frequencies <= 4.0)).all()
    t = np.linspace(1.0, 3.0, 50)
    waves = np.sin(2.0 * np.pi * frequencies[:, None] * (t[:, None] - 1.0) + phases[:, None]).sum(axis=0)
    assert shape.function(2, 7, "a.b")(t) == pytest.approx(0.5 * np.sqrt(2.0 / 3.0) * waves, rel=1e-12)
    assert Sine(2.0, 0.25, 0.5).function(1, 0, "x")(1.0) == pytest.approx(2.0 * np.sin(np.pi / 2.0 + 0.5))


def test_controls_set_variables_that_are_there(scenario: RobotScenario) -> None:
    known = {
        *closed_loop_model().parameters.names,
        *(f"acts.{name}" for name in surroundings(scenario).parameters.names),
    }
    assert {target for _, _, targets in _CONTROLS.values() for target in targets} <= known
    shown = [name for group in (_GROUPS, _CLOSED) for names in group.values() for name in names]
    assert sorted(shown) == sorted(_CONTROLS)


def test_presets_are_of_controls_and_hold_all_readings() -> None:
    found = presets()
    for values in some(values for group in found.values() for values in group.values()):
        assert values.keys() <= {*_CONTROLS, "weights", "stop_time"}
    readings = found["Readings of the paper"]
    left_out = {assumption.label for assumption in ASSUMPTIONS} - readings.keys()
    # what differs from another reading in the communication step alone, or is another's repetition in closed form
    assert left_out == {"the same with half the communication step"}
    assert readings["k = 0.001, gains of mu/nu = 10"]["weights"] == "10, 1"
    assert readings["mass arrives at rest"]["at_rest"] == 1.0
    assert readings["PD control, alpha = 0"]["alpha"] == 0.0
    assert found["Optima of Table 1"]["μ, ν = 5, 1"]["alpha"] == pytest.approx(1.7839, abs=1e-4)


def test_the_map_is_that_of_J() -> None:
    data = index_data()
    for label, row in some(list(data["rows"].items())):
        index = PerformanceIndex(*map(float, label.split(",")))
        for alpha, beta in ((0.3, 0.7), (1.36, 1.66), (4.0, 5.0)):
            terms = zip(row["coefficients"], data["powers"]["alpha"], data["powers"]["beta"], strict=True)
            assert sum(c * alpha**a * beta**b for c, a, b in terms) == pytest.approx(float(index(alpha, beta)))
        assert float(index(row["alpha"], row["beta"])) == pytest.approx(row["J"])


# ---- the page; its modules take seconds to trace and to compile


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("ziglang", reason="nothing here compiles WebAssembly: pip install ziglang")
    folder = tmp_path_factory.mktemp("live")
    assert main(["live", "--out", str(folder / "live.html"), "--fmus", str(folder / "fmus")]) == 0
    return folder / "live.html"


def opened(tabs: Tabs, page: Path, **options: Any) -> Any:
    tab = tabs.open(page, **options)
    computed(tab, 1)
    return tab


def computed(tab: Any, runs: int) -> None:
    until(tab, f"Number(document.querySelector('.live').dataset.runs ?? 0) >= {runs}")


def runs(tab: Any) -> int:
    return int(tab.evaluate("document.querySelector('.live').dataset.runs"))


@pytest.mark.slow
def test_the_page_is_small_and_loads_nothing(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    assert len(html.encode()) < 300_000
    elements = Elements(html)
    assert elements.open == []
    (policy,) = [a["content"] for _, a, _ in elements.all if a.get("http-equiv") == "Content-Security-Policy"]
    assert re.search(r"script-src 'sha256-[^']+' 'wasm-unsafe-eval'; worker-src blob:$", policy)
    assert "unsafe-inline" not in policy
    assert [a for _, a, _ in elements.all for k in ("src", "href") if not a.get(k, "#").startswith("#")] == []


@pytest.mark.slow
def test_the_error_is_that_of_coupled_fmus(tabs: Tabs, page: Path, robot_fmus: Path, scenario: RobotScenario) -> None:
    tab = opened(tabs, page)
    with Simulation(scenario.system(robot_fmus, DEFAULT_FLAVOUR), order=scenario.order) as simulation:
        for alpha, preset in ((0.0, "PD control: α = 0"), (None, "μ, ν = 1, 1")):
            before = runs(tab)
            tab.select_option(".preset", preset)
            computed(tab, before + 1)
            results = simulation.run(
                15.0,
                1e-3,
                signals=signals(scenario, "disturbed"),
                start={} if alpha is None else {"controller.alpha": alpha},
            )
            off = np.hypot(*(results[f"plant.{c}_E"] - results[f"trajectory.{c}_ref"] for c in "xy"))
            expected = 1e3 * np.sqrt(np.mean(off[results.time >= 8.0] ** 2))
            assert float(tab.inner_text(".rms")) == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
def test_gains_are_taken_from_map_sliders_and_presets(tabs: Tabs, page: Path) -> None:
    tab = opened(tabs, page)
    alpha = tab.locator('[data-name="alpha"] input[type=number]')
    before = tab.inner_text(".rms")
    tab.locator('[data-name="alpha"] input[type=range]').fill("4")
    computed(tab, 2)
    assert tab.inner_text(".rms") != before
    assert tab.input_value(".preset") == ""
    box = tab.locator(".map").bounding_box()
    tab.locator(".map").click(position={"x": box["width"] * 0.3, "y": box["height"] * 0.3})
    computed(tab, 3)
    assert 0.2 < float(alpha.input_value()) < 1.5
    tab.select_option("#weights", "10, 1")
    tab.click(".optimum")
    computed(tab, 4)
    assert float(alpha.input_value()) == pytest.approx(2.06545)
    assert re.search(r"J = 29\.3, at the optimum 29\.3", tab.inner_text(".J"))
    tab.click(".keep")
    for preset in ("k = 0.0001", "as printed, for 60 s", "nominal feedforward"):
        count = runs(tab)
        tab.select_option(".preset", preset)
        computed(tab, count + 1)
        until(tab, "document.querySelector('.live').dataset.state === 'shown'")
    assert tab.locator(".of-kept").is_visible()
    assert float(tab.inner_text(".rms")) < float(tab.inner_text(".kept"))
    tab.click(".reset")
    until(tab, f"document.querySelector('.rms').textContent === '{before}'")


@pytest.mark.slow
def test_a_run_that_fails_says_the_message_of_the_model(tabs: Tabs, page: Path) -> None:
    tab = opened(tabs, page)
    tab.fill('[data-name="x_E_start"] input[type=number]', "3")
    until(tab, "document.querySelector('.live').dataset.state === 'failed'")
    assert "reach" in tab.inner_text(".trouble")
    tab.click(".reset")
    until(tab, "document.querySelector('.live').dataset.state === 'shown'")
    assert tab.locator(".trouble").is_hidden()


@pytest.mark.slow
def test_without_webassembly_it_says_so(browser: Any, page: Path) -> None:
    context = browser.new_context()
    tab = context.new_page()
    tab.add_init_script("delete globalThis.WebAssembly")
    tab.goto(page.as_uri())
    until(tab, "document.querySelector('.live').dataset.state === 'failed'")
    assert "This browser has no WebAssembly" in tab.inner_text(".trouble")
    context.close()


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 900, 390])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everybody_can_use_it(tabs: Tabs, page: Path, width: int, scheme: str) -> None:
    tab = opened(tabs, page, width=width, color_scheme=scheme)
    fits(tab)
    if width == 390:
        accessible(tab)
        tab.click(".fold")
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    accessible(tab)
    fits(tab)


@pytest.mark.slow
def test_a_phone_shows_robot_readings_and_gains_at_once(tabs: Tabs, page: Path) -> None:
    tab = opened(tabs, page, width=390, height=844)

    def ends(selector: str) -> tuple[float, float]:
        box = tab.locator(selector).bounding_box()
        return box["y"], box["y"] + box["height"]

    top, bottom = ends(".settings")
    assert bottom <= 844
    for seen in (".robot", ".rms", ".effort", ".time"):
        first, last = ends(seen)
        assert 0 <= first < last <= top
    shown = "[...document.querySelectorAll('[data-name]')].filter((e) => e.checkVisibility())"
    assert tab.evaluate(f"{shown}.map((e) => e.dataset.name)") == ["alpha", "beta"]
    tab.evaluate("scrollTo(0, document.querySelector('.torque-plot').getBoundingClientRect().top - 100)")
    for gain in ("alpha", "beta"):
        first, last = ends(f'[data-name="{gain}"] input[type=range]')
        assert ends(".torque-plot")[0] < first < last <= 844
    before = runs(tab)
    tab.locator('[data-name="alpha"] input[type=range]').fill("3")
    computed(tab, before + 1)
    tab.click(".fold")
    tab.locator('[data-name="w"] input[type=range]').fill("1.5")
    tab.click(".fold")
    assert tab.evaluate(f"{shown}.map((e) => e.dataset.name)") == ["alpha", "w"]


@pytest.mark.slow
def test_it_plays_and_is_moved_by_keys(tabs: Tabs, page: Path) -> None:
    tab = opened(tabs, page)
    assert tab.inner_text(".play") == "Play"  # stillness is preferred
    tab.focus(".play")
    tab.keyboard.press("Enter")
    until(
        tab,
        "Math.abs(document.querySelector('.time').value - 5) < 4",  # from its end it began anew
    )
    assert tab.inner_text(".play") == "Pause"
    tab.focus(".time")
    tab.keyboard.press("Home")
    assert float(tab.input_value(".time")) == 0.0
    assert tab.inner_text(".play") == "Play"
    count = runs(tab)
    tab.focus('[data-name="beta"] input[type=range]')
    tab.keyboard.press("ArrowRight")
    computed(tab, count + 1)
    assert float(tab.input_value('[data-name="beta"] input[type=number]')) > 1.662
