"""The page about regressions: one file, no scripts, readable on a phone; and `cosim compare --report`."""

from __future__ import annotations

import os
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from cosim.__main__ import main
from cosim.regression import Comparison, Outcome, Tolerance, Tolerances, compare_signals
from cosim.regression.page import part, write_page
from cosim.regression.plot import _PIECES, plot
from cosim.results.results import Results

TIME = np.linspace(0.0, 2.0, 401)
HOSTILE = '<script>alert("x")</script> & co'


def compared() -> Comparison:
    """Signals that pass and fail in all ways, some with values that are hard to label."""
    columns = {
        "stair": np.floor(TIME / 0.4),
        "nearly[1]": 0.3 + 1e-7 * np.exp(-TIME),
        "constant": np.full(401, 3.0),
        "hole": np.sin(5.0 * TIME),
        HOSTILE: -1e12 * np.sin(30.0 * TIME),
    }
    reference = Results(TIME, list(columns), np.column_stack(list(columns.values())))
    values = reference.values.copy()
    values[:, 0] = np.floor((TIME - 0.03) / 0.4).clip(0.0)
    values[:, 1] += 2e-12
    values[200:210, 3] = np.nan
    values[77, 4] *= 5.0
    tolerances = Tolerances(
        signals={
            "stair": Tolerance(relative=0.05, time_shift=0.02),
            "nearly": Tolerance(relative=1e-4),
            "constant": Tolerance(absolute=1e-8),
        }
    )
    units = {"stair": "1", "nearly[1]": "m", "constant": "Pa", "hole": "", HOSTILE: "N.m"}
    return compare_signals(Results(TIME, reference.names, values, {"units": units}), reference, tolerances)


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    comparison = compared()
    assert len(comparison.findings) == 3
    failed = Outcome("Demo", "fmus/Demo.fmu", "CS", comparison.findings, comparison.signals, HOSTILE, 0.3)
    broken = Outcome("Demo", "fmus/Demo.fmu", "ME", ["fmus/Demo.fmu: ended its process (SIGSEGV)"], [], "", 0.1)
    good = [s for s in comparison.signals if not s.finding]
    passed = Outcome("Good", "fmus/" + "long_name_" * 20 + ".fmu", "CS", [], good, "", 0.1)
    path = tmp_path_factory.mktemp("page") / "page.html"
    write_page([part(outcome) for outcome in (passed, failed, broken)], path)
    return path


class Elements(HTMLParser):
    """Names of the elements in order, and whether all are closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.names: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, _attributes):
        self.names.append(tag)
        if tag not in ("meta", "path", "rect", "circle"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in ("path", "rect", "circle"):
            assert self.open.pop() == tag


def test_the_page_is_one_file_without_scripts(page):
    text = page.read_text(encoding="utf-8")
    elements = Elements(text)
    assert elements.open == []
    assert not {"script", "link", "img", "iframe"} & set(elements.names)
    assert not re.search(r"https?://|url\(|@import", text)
    assert HOSTILE not in text
    assert "2 of 3 runs failed" in text
    # what failed comes first
    assert text.index("SIGSEGV") < text.rindex("long_name_")
    assert "nan" not in "".join(re.findall(r' d="[^"]*"', text))


def test_each_signal_has_its_curves_and_says_them(page):
    text = page.read_text(encoding="utf-8")
    assert elements_of(text, "svg") == elements_of(text, "figure") == 5 + 2
    labels = re.findall(r'role="img" aria-label="([^"]*)"', text)
    assert len(labels) == 7
    assert any("leaves the funnel" in label for label in labels)
    late = next(signal for signal in compared().signals if signal.name == "stair")
    assert len(re.findall(r'class="outside"', text)) == 10 + 1 + np.count_nonzero(late.distance)


def elements_of(text: str, name: str) -> int:
    return Elements(text).names.count(name)


def test_a_long_curve_is_thinned_but_keeps_its_peaks():
    time = np.linspace(0.0, 1.0, 100_001)
    values = np.zeros((100_001, 1))
    spiked = values.copy()
    spiked[77_777, 0] = 1.0
    (signal,) = compare_signals(
        Results(time, ["x"], spiked), Results(time, ["x"], values), Tolerances(absolute=0.1)
    ).signals
    drawn = plot(signal)
    assert len(drawn) < 120 * 4 * _PIECES
    (path,) = re.findall(r'class="result" d="([^"]*)"', drawn)
    heights = [float(word.split()[1]) for word in re.split("[ML]", path)[1:]]
    assert max(heights) - min(heights) > 100.0
    assert drawn.count('class="outside"') == 1


def test_the_command_writes_the_page(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Results(TIME, ["x"], TIME[:, None]).to_csv("reference.csv")
    Results(TIME, ["x"], 1.1 * TIME[:, None]).to_csv("result.csv")
    assert main(["compare", "result.csv", "reference.csv", "--report", "out/page.html"]) == 1
    assert capsys.readouterr().out.startswith("'x' differs at 400 of 401 times")
    assert "'x' differs at 400 of 401 times" in re.sub("&#x27;", "'", Path("out/page.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def browser():
    """Chromium by Playwright: CHROMIUM names it, else it is looked for on the path."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="the page is not tried in a browser: pip install playwright"
    )
    names = (os.environ.get("CHROMIUM"), "chromium", "chromium-browser", "google-chrome", "chrome")
    found = next(filter(None, (shutil.which(name) for name in names if name)), None)
    if found is None:
        pytest.skip("the page is not tried in a browser: no Chromium found; set CHROMIUM to one")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.mark.parametrize("width", [360, 1100])
def test_nothing_is_cut_in_a_browser(browser, page, width):
    tab = browser.new_page(viewport={"width": width, "height": 800})
    asked = []
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(page.as_uri())
    tab.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    assert asked == [page.as_uri()]
    assert tab.evaluate("document.documentElement.scrollWidth") == width
    cut = tab.evaluate(
        """[...document.querySelectorAll('svg text')].filter(t => {
            const box = t.getBBox(), view = t.ownerSVGElement.viewBox.baseVal;
            return box.x < 0 || box.y < 0 || box.x + box.width > view.width || box.y + box.height > view.height;
        }).map(t => t.textContent)"""
    )
    assert cut == []
    tab.close()
