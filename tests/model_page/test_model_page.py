"""The page of a model: its controls, its policy, and that it computes and complains in a browser."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from cosim.__main__ import main
from cosim.model_page.controls import control
from cosim.model_page.page import model_page
from fmu_export.modelling.finding import find_model
from fmu_export.modelling.model import Model
from fmu_export.wasm.backend import WasmModel, script, wasm_model
from tests.support.browser import Tabs, accessible, fits, until
from tests.support.html import Elements
from tests.support.wasm_models import Swing, Typed

pytest.importorskip("ziglang", reason="nothing here compiles WebAssembly: pip install ziglang")


def written(made: WasmModel, folder: Path) -> Path:
    path = folder / f"{made.name}.html"
    path.write_text(model_page(made.code, made.description, script(exports=False)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def swing() -> WasmModel:
    return wasm_model(Swing)


@pytest.fixture(scope="module")
def page(swing: WasmModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(swing, tmp_path_factory.mktemp("page"))


def test_what_has_both_limits_has_a_slider() -> None:
    slider = control({"name": "k", "unit": "N/m", "start": 0.1, "min": 0.0, "max": 2.0})
    assert 'type="range"' in slider
    assert 'min="0.0" max="2.0" step="any"' in slider
    assert 'data-start="0.1"' in slider
    assert "(N/m)" in slider
    assert 'min="-3.0" max="2.0"' in control({"name": "k", "start": 0.1, "min": 1e-3, "max": 100.0})
    assert 'step="1"' in control({"name": "n", "type": "integer", "start": 3.0, "min": 1.0, "max": 9.0})
    for limits in ({}, {"min": 0.0}, {"max": 2.0}):
        assert "range" not in control({"name": "k", "start": 0.1, **limits})
    nasty = control({"name": "k", "start": 0.1, "description": '<img src=x onerror="alert(1)">'})
    assert "<img" not in nasty


def test_values_of_other_types_have_switches_and_choices() -> None:
    assert " checked" in control({"name": "on", "type": "boolean", "start": 1.0})
    choice = control({"name": "speed", "type": "enumeration", "start": 2, "items": [["slow", 1], ["fast <b>", 2]]})
    assert re.findall(r'<option value="(\d)"( selected)?>', choice) == [("1", ""), ("2", " selected")]
    assert "fast &lt;b&gt;" in choice


def test_the_page_loads_nothing_and_its_policy_lets_it_compile(page: Path) -> None:
    html = page.read_text(encoding="utf-8")
    elements = Elements(html)
    assert elements.open == []
    (policy,) = [a["content"] for _, a, _ in elements.all if a.get("http-equiv") == "Content-Security-Policy"]
    assert re.search(r"script-src 'sha256-[^']+' 'wasm-unsafe-eval'; worker-src blob:$", policy)
    assert "unsafe-inline" not in policy
    assert [a for _, a, _ in elements.all for k in ("src", "href") if not a.get(k, "#").startswith("#")] == []
    assert len(html) < 150_000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{folder}/two.py", "name the model, as .*two.py:A; its models are A, B"),
        ("{folder}/two.py:C", "has no model 'C'; its models are A, B"),
        ("{folder}/none.py", "has no Model and no ModelClass"),
        ("{folder}/bad.py", r"can't be run: ZeroDivisionError: division by zero \(bad.py, line 2\)"),
        ("{folder}/missing.py", "there is no file"),
        ("{folder}/a.fmu", "is not a Python file"),
        ("nowhere.model", "there is no module 'nowhere'"),
    ],
)
def test_a_model_that_is_not_found_is_one_line(tmp_path: Path, capsys, text: str, message: str) -> None:
    head = "from fmu_export import ModelClass, state\n"
    body = "(ModelClass):\n    x = state(1.0)\n    def derivatives(m):\n        return dict(x=-m.x)\n"
    (tmp_path / "two.py").write_text(f"{head}class A{body}class B{body}")
    (tmp_path / "none.py").write_text(head)
    (tmp_path / "bad.py").write_text("\n1 / 0\n")
    (tmp_path / "a.fmu").write_bytes(b"PK")
    assert main(["page", text.format(folder=tmp_path)]) == 1
    said = capsys.readouterr().err
    assert re.search(message, said)
    assert said.count("\n") == 1
    assert find_model(f"{tmp_path}/two.py:B").__name__ == "B"  # type: ignore[union-attr]


def test_a_model_is_found_in_a_module_and_beside_other_modules(tmp_path: Path) -> None:
    assert isinstance(find_model("trajectory_fmu.model:MODEL"), Model)
    (tmp_path / "beside_it.py").write_text("START = 3.0\n")
    (tmp_path / "own_model.py").write_text(
        "from fmu_export import ModelClass, state\nfrom beside_it import START\n"
        "class Own(ModelClass):\n    x = state(START)\n    def derivatives(m):\n        return dict(x=-m.x)\n"
    )
    assert find_model(str(tmp_path / "own_model.py")).model().parameters.starts.tolist() == [3.0]  # type: ignore


# ---- in a browser


def computed(tab: Any, runs: int) -> None:
    until(tab, f"Number(document.querySelector('.model').dataset.runs ?? 0) >= {runs}")


def value(tab: Any, panel: int) -> str:
    """What the legend of a plot says at the end of the run."""
    tab.focus(f'[data-panel="{panel}"] .plot-area')
    tab.keyboard.press("End")
    return str(tab.inner_text(f'[data-panel="{panel}"] .plot-legend output'))


def near(tab: Any) -> list[str]:
    """Controls that are seen at the foot of the window."""
    shown = "[...document.querySelectorAll('[data-name]')].filter((e) => e.checkVisibility())"
    inside = "e.getBoundingClientRect().top > innerHeight / 2 && e.getBoundingClientRect().bottom <= innerHeight"
    return list(tab.evaluate(f"{shown}.filter((e) => {inside}).map((e) => e.dataset.name)"))


def test_it_computes_and_complains_in_a_browser(tabs: Tabs, page: Path, swing: WasmModel) -> None:
    tab = tabs.open(page)
    computed(tab, 1)
    tab.locator(".panels").scroll_into_view_if_needed()
    until(tab, "document.querySelectorAll('.u-over').length >= 2")
    before = value(tab, 0)
    slider = tab.locator('[data-name="length"] input[type=range]')
    slider.fill("1.5")
    computed(tab, 2)
    assert tab.input_value('[data-name="length"] input[type=number]') == "1.5"
    assert value(tab, 0) != before
    tab.fill('[data-name="push"] input', "60")  # over the top
    until(tab, "document.querySelector('.model').dataset.state === 'failed'")
    assert re.fullmatch(r"t = [\d.]+ s: the pendulum must not turn over; push less", tab.inner_text(".trouble"))
    tab.click(".reset")
    until(tab, "document.querySelector('.model').dataset.state === 'shown'")
    assert tab.locator(".trouble").is_hidden()
    assert value(tab, 0) == before
    tab.set_viewport_size({"width": 390, "height": 844})
    until(tab, lambda: sorted(near(tab)) == ["length", "push"])  # what was used last


@pytest.mark.slow
def test_a_narrow_window_keeps_what_was_used_last_in_reach(tabs: Tabs, page: Path) -> None:
    tab = tabs.open(page, width=390, height=844)
    computed(tab, 1)
    assert near(tab) == ["length", "g"]  # the one slider, and the first of the fields
    tab.evaluate("scrollTo(0, document.body.scrollHeight)")
    assert tab.locator(".settings").bounding_box()["height"] < 844 / 4
    assert len(near(tab)) == 2
    tab.click(".fold")
    assert tab.get_attribute(".fold", "aria-expanded") == "true"
    tab.fill('[data-name="grip"] input', "0.5")
    tab.click(".fold")
    assert sorted(near(tab)) == ["grip", "length"]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["nothing", "refused"])
def test_a_browser_without_webassembly_is_said(browser: Any, page: Path, tmp_path: Path, how: str) -> None:
    html = page.read_text(encoding="utf-8")
    if how == "refused":
        html = html.replace(" 'wasm-unsafe-eval'", "")
    changed = tmp_path / "page.html"
    changed.write_text(html, encoding="utf-8")
    context = browser.new_context()
    tab = context.new_page()
    if how == "nothing":
        tab.add_init_script("delete globalThis.WebAssembly")
    tab.goto(changed.as_uri())
    until(tab, "document.querySelector('.model').dataset.state === 'failed'")
    assert "WebAssembly" in tab.inner_text(".trouble")
    assert tab.locator(".trouble").get_attribute("role") == "alert"
    context.close()


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("model", [Swing, Typed])
def test_everybody_can_use_it(tabs: Tabs, tmp_path: Path, model: type, width: int, scheme: str) -> None:
    tab = tabs.open(written(wasm_model(model), tmp_path), width=width, color_scheme=scheme)
    computed(tab, 1)
    accessible(tab)
    if width == 390:
        tab.click(".fold")
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    accessible(tab)
    fits(tab)


@pytest.mark.slow
def test_it_is_used_by_keyboard(tabs: Tabs, page: Path) -> None:
    tab = tabs.open(page)
    computed(tab, 1)
    reached = []
    for _ in range(30):
        tab.keyboard.press("Tab")
        reached.append(tab.evaluate("document.activeElement.closest('[data-name]')?.dataset.name ?? ''"))
        if reached[-1] == "length":
            break
    assert reached[-1] == "length"
    tab.keyboard.press("ArrowRight")
    computed(tab, 2)
    assert float(tab.input_value('[data-name="length"] input[type=number]')) > 0.7
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    tab.fill('[data-name="stepSize"] input', "0.3")
    until(tab, "document.querySelector('.model').dataset.state === 'failed'")
    assert tab.inner_text(".trouble") == "From 0 s to 2 s is not a whole number of steps of 0.3 s"
    tab.fill('[data-name="g"] input', "")
    assert tab.get_attribute('[data-name="g"] input', "aria-invalid") == "true"


@pytest.mark.slow
def test_values_of_all_types_are_set(tabs: Tabs, tmp_path: Path) -> None:
    tab = tabs.open(written(wasm_model(Typed), tmp_path))
    computed(tab, 1)
    tab.select_option('[data-name="speed"] select', "3")
    tab.select_option('[data-name="text"] select', "0")
    tab.uncheck('[data-name="on"] input')
    computed(tab, 4)
    assert value(tab, 0) == "303"  # n = 3, and 100 times the third item
