"""The page about regressions: one file, pictures first, for everybody; and `cosim compare --report`."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cosim.__main__ import main
from cosim.regression import Comparison, Outcome, Tolerance, Tolerances, compare_signals
from cosim.regression.page import part, write_page
from cosim.results.results import Results
from tests.support.browser import Tabs, accessible, fits, until, walked
from tests.support.html import Elements

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


def test_the_page_is_one_file_whose_policy_allows_nothing_else(page):
    text = page.read_text(encoding="utf-8")
    elements = Elements(text)
    assert elements.open == []
    names = [name for name, _, _ in elements.all]
    assert not {"link", "img", "iframe"} & set(names)
    assert not any("style" in a or any(k.startswith("on") for k in a) for _, a, _ in elements.all)
    assert re.search(r"style-src 'sha256-[^']+'; script-src 'sha256-[^']+'\"", text)
    assert HOSTILE not in text
    assert "2 of 3 runs failed" in text
    # what failed comes first
    assert text.index("SIGSEGV") < text.rindex("long_name_")
    assert names.count("figure") == 5 + 2


def test_the_command_writes_the_page(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Results(TIME, ["x"], TIME[:, None]).to_csv("reference.csv")
    Results(TIME, ["x"], 1.1 * TIME[:, None]).to_csv("result.csv")
    assert main(["compare", "result.csv", "reference.csv", "--report", "out/page.html"]) == 1
    assert capsys.readouterr().out.startswith("'x' differs at 400 of 401 times")
    text = Path("out/page.html").read_text(encoding="utf-8")
    assert "'x' differs at 400 of 401 times" in text.replace("&#x27;", "'")
    assert "<h1>result.csv against reference.csv: 1 of 1 signals differ</h1>" in text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "scheme"),
    [(w, s) for w in (390, 1100, 1280) for s in ("light", "dark")],
)
def test_it_works_in_a_browser(browser, page, width, scheme):
    tabs = Tabs(browser)
    tab = tabs.open(page, width=width, height=800, color_scheme=scheme)
    tab.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    for figure in tab.locator("figure").all():
        figure.scroll_into_view_if_needed()
    until(tab, "document.querySelectorAll('figure[data-drawn]').length === 7")
    tab.locator("figure .plot-area").first.focus()
    tab.keyboard.press("Home")
    assert re.match(r"hole at 0 s: lower bound .*, upper bound .*, reference 0, result 0",
                    tab.locator("figure [role=status]").first.inner_text())  # fmt: skip
    accessible(tab)
    fits(tab)
    if width == 390:
        walked(tab)
    tabs.close()
