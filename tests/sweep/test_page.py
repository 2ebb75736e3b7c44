"""The page of a sweep: what it has of the runs, and how they come to it as they end."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest

from cosim.__main__ import main
from cosim.sweep.batch import Rows
from cosim.sweep.page import page as module
from cosim.sweep.page.live import SweepView
from cosim.sweep.page.page import every_shown, page_of_folder
from cosim.sweep.points import Levels, Points, design
from cosim.sweep.store import Store
from tests.support.browser import accessible, fits, until, walked
from tests.support.html import Elements
from tests.support.patience import PATIENCE

NASTY = "</script><img src=x>"


def points(n: int = 6) -> Points:
    return design("grid", [Levels("mode", ("low", NASTY)), Levels("a.k", tuple(0.1 * i for i in range(n // 2)))])


def rows(indices: range) -> Rows:
    values = [None if i == 2 else np.sin(i) for i in indices]
    curves: list[Any] = [np.zeros(3) for _ in indices]
    errors = ["a.k: is too small" if i == 2 else None for i in indices]
    return Rows(list(indices), {"off": values, "course": curves}, errors, 0.1)


def store(folder: Path, n: int = 6) -> Store:
    """A sweep whose last point is still to come."""
    made = Store(folder, points(n), ["off"], {"version": "1"}, curves=["course"])
    made.add(rows(range(n - 1)))
    made.flush()
    return made


def data(html: str) -> Any:
    return json.loads(re.findall(r'<script type="application/json" id="data">(.*?)</script>', html)[0])["sweep"]


def test_the_page_has_the_runs_that_are_done(tmp_path: Path) -> None:
    store(tmp_path / "s")
    html = page_of_folder(tmp_path / "s", "A <sweep>")
    assert Elements(html).open == []
    assert "<img" not in html
    assert "A &lt;sweep&gt;" in html
    found = data(html)
    assert (found["factors"], found["metrics"]) == (["mode", "a.k"], ["off"])
    assert (found["points"], found["ended"]) == (6, [5, 1])
    assert found["runs"]["index"] == [0, 1, 2, 3, 4]
    mode, k, off = found["runs"]["columns"]
    assert mode == ["low"] * 3 + [NASTY] * 2
    assert k == pytest.approx([0.0, 0.1, 0.2, 0.0, 0.1])
    assert off[2] is None
    assert off[:2] + off[3:] == pytest.approx([np.sin(i) for i in (0, 1, 3, 4)], rel=1e-6)
    assert found["runs"]["errors"] == {"2": "a.k: is too small"}


def test_of_many_runs_every_so_many_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (every_shown(20_000, 3), every_shown(20_001, 3), every_shown(20_000, 100)) == (1, 2, 5)
    monkeypatch.setattr(module, "MOST_RUNS", 20)
    store(tmp_path, 100)
    html = page_of_folder(tmp_path)
    assert data(html)["runs"]["index"] == list(range(0, 99, 5))
    assert "Every 5th run is shown" in html
    assert data(html)["ended"] == [99, 1]


def test_the_command_shows_a_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    store(Path("s"))
    assert main(["view", "s", "--out", "page.html", "--title", "Mine"]) == 0
    assert "<h1>Mine</h1>" in Path("page.html").read_text(encoding="utf-8")
    assert main(["view", "s", "s"]) == 1
    assert "s holds a sweep; name it alone" in capsys.readouterr().err


def test_rows_come_to_the_page_as_runs_end(tmp_path: Path) -> None:
    pytest.importorskip("tornado", reason="the live view is not tried: pip install tornado")
    kept = store(tmp_path).kept()
    with SweepView("Mine", points(), ["off"]) as view:
        view.observe(kept)
        view.progress(5, 0)
        view.observe(rows(range(5, 6)))
        view.progress(6, 2)
        with urlopen(f"{view.process.address}rows", timeout=PATIENCE) as stream:
            lines = (line for line in stream if line.startswith(b"data: "))
            messages = (json.loads(line[6:]) for line in lines)
            found: list[dict[str, Any]] = []
            while not any(m.get("progress", {}).get("done") == 6 for m in found):
                found.append(next(messages))
    runs = [m["runs"] for m in found if "runs" in m]
    assert [i for run in runs for i in run["index"]] == [0, 1, 2, 3, 4, 5]
    assert runs[-1]["columns"] == [[NASTY], [0.2], [round(np.sin(5), 7)]]
    assert found[-1]["progress"] == {"done": 6, "failed": 1, "workers": 2}
    assert view.process.returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_everybody_can_use_it(tabs: Any, tmp_path: Path, width: int, scheme: str) -> None:
    store(tmp_path / "s", 100)
    page = tmp_path / "page.html"
    page.write_text(page_of_folder(tmp_path / "s"), encoding="utf-8")
    tab = tabs.open(page, width=width, color_scheme=scheme)
    until(tab, "document.querySelector('.plot-area').dataset.points === '98'")
    assert tab.locator(".runs-table tbody tr").count() == 25
    tab.click(".more")
    assert tab.locator(".runs-table tbody tr").count() == 99
    # sorted by the metric, what is missing last
    tab.locator(".runs-table th button", has_text="off").click()
    *texts, last = tab.locator(".runs-table tbody td:nth-child(4)").all_inner_texts()
    assert last == "–"
    values = [float(text.replace("−", "-")) for text in texts]
    assert values == sorted(values)
    assert tab.locator(".runs-table tbody th").last.inner_text() == "2 failed"
    tab.check(".failed-only")
    assert tab.locator(".runs-table tbody tr").count() == 1
    tab.uncheck(".failed-only")
    # a point by keyboard and by pointer
    tab.locator(".plot-area").focus()
    tab.keyboard.press("End")
    assert tab.inner_text(".chosen h3") == f"Run {max(range(50, 99), key=np.sin)}"  # of the second mode the highest
    tab.select_option(".across", "a.k")
    before = tab.inner_text(".chosen h3")
    box = tab.locator(".scatter .u-over").bounding_box()
    for part in range(40):  # somewhere on this line there is a point
        tab.mouse.click(box["x"] + part * box["width"] / 40, box["y"] + box["height"] / 2)
    assert tab.inner_text(".chosen h3") != before
    tab.check(".log-across")
    until(tab, "document.querySelector('.plot-area').dataset.points === '96'")  # zero has no logarithm
    accessible(tab)
    fits(tab)
    walked(tab)


@pytest.mark.slow
def test_the_live_page_in_a_browser(browser: Any) -> None:
    pytest.importorskip("tornado", reason="the live view is not tried: pip install tornado")
    with SweepView("Mine", points(), ["off"]) as view:
        tab = browser.new_page()
        troubles: list[str] = []
        tab.on("console", lambda message: troubles.append(message.text))
        tab.on("pageerror", lambda error: troubles.append(str(error)))
        tab.goto(view.process.address)
        until(tab, "document.getElementById('state').textContent === 'running'")
        view.observe(rows(range(3)))
        view.progress(3, 1)
        until(tab, "document.querySelectorAll('.runs-table tbody tr').length === 3")
        view.observe(rows(range(3, 6)))
        view.progress(6, 1)
        until(tab, "document.querySelector('.plot-area').dataset.points === '5'")
        until(tab, "document.getElementById('now').textContent === '6 of 6 runs, 1 failed, 1 worker'")
        accessible(tab)
        assert troubles == []
        tab.close()
