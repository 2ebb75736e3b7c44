"""The page of a run: what is in it, how few bytes, and that it works in a browser."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import re
import subprocess
import sys
import threading
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest

from cosim.__main__ import main
from cosim.page.encoding import column_of, encoded, extremes, times
from cosim.page.server import PageServer
from cosim.results.columns import TypedColumn
from cosim.results.page.compare_page import compare_page, labelled
from cosim.results.page.curves import curves_of
from cosim.results.page.detail import detail
from cosim.results.page.folder import read_run
from cosim.results.page.run_page import run_page
from cosim.results.results import Results
from tests.support import some
from tests.support.browser import accessible, fits, until, walked
from tests.support.html import Elements
from tests.support.patience import PATIENCE

NASTY = "</script><img src=x onerror=alert(1)> & \"quotes\" 'too' <!--"
T = np.linspace(0.0, 2.0, 501)


def decoded(octets: bytes, n: int) -> np.ndarray:
    """Columns of 32-bit floats, each n long, from what `encoded` makes; by integers without end."""
    planes = np.frombuffer(octets, "u1").reshape(-1, 4, n).astype(object)
    columns = []
    for plane in planes:
        value = difference = 0
        bits = []
        for folded in (plane[0] + plane[1] * 2**8 + plane[2] * 2**16 + plane[3] * 2**24).tolist():
            difference += folded // 2 if folded % 2 == 0 else -(folded + 1) // 2
            value += difference
            bits.append(value % 2**32)
        columns.append(np.array(bits, dtype="<u4").view("<f4"))
    return np.array(columns)


def results() -> Results:
    """A run with all that is hard to show: gaps, vectors, flags, texts, constants, tiny changes of large numbers."""
    values = {
        "motor.phi": np.sin(5.0 * T),
        "motor.tau[1]": np.where(np.abs(T - 1.0) < 0.1, np.nan, np.cos(3.0 * T)),
        "motor.tau[2]": np.cos(4.0 * T),
        "motor.p": 101325.0 + 1e-4 * np.sin(7.0 * T),
        "motor.huge": 1e60 * np.sin(T),
        "load.on": np.zeros(501),
        "load.said": np.full(501, np.nan),
        "load.constant": np.full(501, 3.0),
    }
    typed = {
        "load.on": TypedColumn("bool", T > 0.5),
        "load.said": TypedColumn("string", np.where(T > 1.5, NASTY, "begin").astype(object)),
    }
    values["load.on"] = typed["load.on"].numbers
    info = {
        "title": f"A run {NASTY}",
        "status": "completed",
        "order": "sequential",
        "step_size": 4e-3,
        "units": {"motor.phi": "rad", "motor.tau[1]": "N.m", "motor.tau[2]": "N.m", "motor.p": "Pa"},
        "fmus": {
            "motor": {"path": f"/a/b/Motor{NASTY}.fmu", "sha256": "ab" * 32},
            "load": {"path": "c\\Load.fmu", "sha256": "cd" * 32},
        },
        "connections": {"load.torque": "motor.tau", "motor.angle": "load.phi", "load.own": "load.out"},
        "breakpoints": {"motor.u": [0.75], "load.w": [0.6, 1.9]},
        "signals": {"load.w": {"shape": "multisine", "start_time": 0.6}},
        "messages": {
            "motor": {
                "warnings": 1,
                "errors": 0,
                "first": [{"time": 1.25, "status": "warning", "category": "", "text": NASTY, "count": 1}],
            }
        },
        "inputs_kept": ["load.friction"],
        "parameters": {"motor.R": 1.5, "load.name": NASTY},
        "metrics": {"error": {"max": 1e-3}},
        "versions": {"python": "3"},
        "profile": {
            "measured_points": 10,
            "components": {
                "motor": {"steps": 500, "steps_s": 0.5, "exchange_s": 0.25, "steps_repeated": 0},
                "load": {"steps": 500, "steps_s": 1.0, "exchange_s": 0.5, "steps_repeated": 0},
            },
        },
        "coupling": {
            "tolerance": 1e-3, "step_size": 4e-3, "error": 5e-4, "variable": "motor.phi", "time": 0.25, "runs": 3,
            "tried": [{"step_size": 4e-3, "error": 5e-4}, {"step_size": 8e-3, "error": 2e-3}],
        },
        "nonfinite": {"motor.tau[1]": {"time": 0.904, "rows": 49}},
        "commands": [{"point": 375, "time": 1.5, "set": {"motor.u": 2.0}}],
    }  # fmt: skip
    return Results(T, list(values), np.column_stack(list(values.values())), info, typed)


@pytest.fixture(scope="module")
def run() -> Results:
    return results()


@pytest.fixture(scope="module")
def html(run: Results) -> str:
    return run_page(run, log=f"t = 1 s: {NASTY}")


@pytest.fixture(scope="module")
def page(html: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("page") / "page.html"
    path.write_text(html, encoding="utf-8")
    return path


def data(html: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found
    read: dict[str, Any] = json.loads(found[1])
    return read


# ---- numbers


def test_32_bit_floats_come_back_bit_for_bit():
    rng = np.random.default_rng(3)
    for values in (
        rng.standard_normal(200),
        np.cumsum(rng.standard_normal(200)),
        np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-45, 3.4e38]),
        rng.integers(0, 2**32, 300, dtype=np.uint32).view(np.float32),
    ):
        floats = values.astype("<f4")
        np.testing.assert_array_equal(decoded(encoded(floats), len(floats))[0].view("u4"), floats.view("u4"))


def test_a_column_keeps_what_32_bits_alone_would_lose():
    for values in (
        101325.0 + 1e-4 * np.sin(T),
        1e60 * np.sin(T),
        1e-60 * np.cos(T),
        np.full(501, 1e300),
        np.zeros(501),
    ):
        column = column_of(values)
        back = column.offset + column.scale * column.numbers.astype(np.float64)
        assert np.abs(back - values).max() <= 1e-6 * max(np.ptp(values), 1e-10 * np.abs(values).max())


def test_smooth_curves_take_few_bytes():
    time = np.linspace(0.0, 15.0, 15_001)
    smooth = np.sin(2.0 * time).astype("<f4")
    assert len(zlib.compress(encoded(smooth), 6)) < 0.6 * len(zlib.compress(smooth.tobytes(), 6))


def test_extremes_of_pieces_are_those_of_all_and_come_in_their_order():
    rng = np.random.default_rng(5)
    values = rng.standard_normal(1003)
    found = extremes(values, 10).reshape(-1, 2)
    for k, (first, second) in enumerate(some(found)):
        piece = values[10 * k : 10 * k + 10].tolist()
        assert {first, second} == {min(piece), max(piece)}
        assert piece.index(first) <= piece.index(second)
    values[55] = np.nan
    assert np.isnan(extremes(values, 10)[11])
    assert np.isnan(extremes(np.full(7, np.nan), 3)).all()


def test_times_are_a_start_and_a_step_or_each_one():
    even = 4.0 + 1e-3 * np.arange(1000)
    described, content = times(even)
    assert (described, content) == ({"rows": 1000, "start": 4.0, "step": pytest.approx(1e-3)}, None)
    uneven = np.cumsum(np.random.default_rng(1).uniform(0.1, 1.0, 50))
    described, content = times(uneven)
    assert described == {"rows": 50}
    octets = np.frombuffer(zlib.decompress(content), "u1").reshape(8, 50).T
    np.testing.assert_array_equal(np.ascontiguousarray(octets).view("<f8")[:, 0], uneven)


def test_too_many_values_become_extremes_within_the_budget_and_the_page_says_so():
    time = np.linspace(0.0, 100.0, 20_001)
    rng = np.random.default_rng(2)
    values = np.cumsum(rng.standard_normal((20_001, 12)), axis=0)
    values[12_345, 7] = 1e4
    run = Results(time, [f"c.v[{i}]" for i in range(1, 13)], values)
    curves = curves_of({"a": run}, budget=100_000)
    assert sum(len(base64.b64encode(block)) for block in curves.blocks.values()) <= 100_000
    resolution = curves.data["runs"][0]["resolution"]
    assert 0.01 < resolution < 1.0
    (variable,) = curves.data["variables"]
    rows = curves.data["runs"][0]["time"]["rows"]
    assert {column["rows"] for column in variable["columns"]} == {rows}
    assert rows == 2 * -(-20_001 // round(resolution / 0.005))
    found = decoded(zlib.decompress(curves.blocks["curves-0"]), rows).astype(np.float64)
    np.testing.assert_array_equal(found.max(axis=1), values.astype("<f4").max(axis=0))
    np.testing.assert_array_equal(found.min(axis=1), values.astype("<f4").min(axis=0))
    whole = curves_of({"a": run}, budget=10_000_000)
    assert whole.data["runs"][0]["resolution"] is None
    assert f"of each {resolution:.6g} s" in run_page(run, budget=100_000)


def test_differences_count_what_is_not_finite_and_never_overflow():
    def far(first: list[float], second: list[float]) -> Any:
        runs = {k: Results(T[:3], ["a"], np.array([v]).T) for k, v in (("one", first), ("two", second))}
        (variable,) = curves_of(runs).data["variables"]
        json.dumps(variable, allow_nan=False)
        return variable["difference"]

    inf, nan = np.inf, np.nan
    assert far([0.0, 1.0, inf], [0.0, 1.5, inf]) == 0.5
    assert far([0.0, 1.0, nan], [0.0, 1.0, nan]) == 0.0
    assert far([0.0, 2.0, inf], [0.0, 2.0, -inf]) == far([0.0, 2.0, 1.0], [0.0, 2.0, nan]) == 1.0
    assert far([-1.7e308, 1.7e308, 0.0], [1.7e308, 1.7e308, 0.0]) == 1.0
    assert far([0.0, 0.0, 5e-324], [1e308, 0.0, 0.0]) == 1e300


def test_texts_are_shortened_and_binary_values_are_digits():
    values = np.array([b"\x00\xff" if i % 2 else b"" for i in range(501)], dtype=object)
    typed = {"c.b": TypedColumn("binary", values), "c.t": TypedColumn("string", np.array(["ä" * 501] * 501, object))}
    html = run_page(Results(T, list(typed), np.full((501, 2), np.nan), {}, typed))
    assert "<b>c.b</b>: from 0 s (empty); from 0.004 s 00 ff; " in html
    assert "<summary>496 more changes</summary>" in html
    assert f"from 0 s {'ä' * 200}… (501 characters)</li>" in html


def test_a_run_without_signals_says_so():
    html = run_page(Results(T, [], np.empty((501, 0)), {"title": "t"}))
    assert "<p>Nothing was recorded.</p>" in html
    assert "curves" not in data(html)


def test_what_never_changes_comes_last():
    time = np.linspace(0.0, 1.0, 5)
    names = ["a.still", "a.none", "a.v[1]", "a.v[2]", "a.x"]
    values = np.column_stack([np.full(5, 3.0), np.full(5, np.nan), np.zeros(5), time, time])
    variables = curves_of({"run": Results(time, names, values)}).data["variables"]
    assert [(v["name"], v["still"]) for v in variables] == [
        ("a.v", False),
        ("a.x", False),
        ("a.still", True),
        ("a.none", True),
    ]


# ---- the page as text


def test_the_policy_names_the_style_and_the_script_and_nothing_else_is_loaded(html):
    elements = Elements(html).all
    (policy,) = [a["content"] for _, a, _ in elements if a.get("http-equiv") == "Content-Security-Policy"]
    for kind in ("style", "script"):
        (text,) = re.findall(rf"<{kind}>(.*?)</{kind}>", html, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy
    assert "unsafe" not in policy
    assert "default-src 'none'" in policy
    addresses = [a[k] for _, a, _ in elements for k in ("src", "href", "action", "data", "poster") if k in a]
    assert all(address.startswith("#") for address in some(addresses))
    assert not any(name == "style" or name.startswith("on") for _, a, _ in elements for name in a)


def test_texts_stay_texts_and_names_are_unique(html):
    elements = Elements(html)
    assert elements.open == []
    assert "<img" not in html
    ids = [a["id"] for _, a, _ in elements.all if "id" in a]
    assert len(ids) == len(set(ids))
    assert html.count("<script") == html.count("</script>") == 2 + len(data(html)["curves"]["variables"])


def test_it_says_what_happened_and_how_it_was_made(html):
    for text in ("Nothing feeds these inputs", "load.friction", "ab" * 32, "motor.R", "error.max", "t = 1 s: ", "0.75"):
        assert text in html
    events = data(html)["events"][0]
    assert [(e["time"], e["kind"]) for e in events] == [
        (0.25, "message"),
        (0.6, "input"),
        (0.75, "input"),
        (0.904, "message"),
        (1.25, "message"),
        (1.5, "input"),
        (1.9, "input"),
    ]
    assert [events[i]["text"] for i in (1, 5, 6)] == ["load.w sets in", "motor.u = 2", "load.w jumps or bends"]
    bars = re.findall(
        r'<li><span>(.*?)</span><svg.*?<rect width="(.*?)".*?x="(.*?)" width="(.*?)".*?<b>(.*?)</b>', html
    )
    assert bars == [
        ("load", "133.3", "133.3", "66.67", "1.5"),
        ("motor", "66.67", "66.67", "33.33", "0.75"),
        ("0.008 s", "200", "200", "0", "0.002"),
        ("0.004 s", "50", "50", "0", "0.0005"),
    ]
    assert [len(b["pairs"]) for b in data(html)["diagram"]["bundles"]] == [1, 1, 1]


def test_the_commands_write_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = results().thinned(50)
    run.report("direct.html", title="Direct")
    assert "<h1>Direct</h1>" in Path("direct.html").read_text(encoding="utf-8")
    folder = Path("a run")
    folder.mkdir()
    run.save(folder / "results.parquet")
    (folder / "summary.json").write_text(json.dumps(run.info), encoding="utf-8")
    (folder / "messages.log").write_text("what was said", encoding="utf-8")
    assert main(["view", "a run", "--out", "there/page.html"]) == 0
    text = Path("there/page.html").read_text(encoding="utf-8")
    assert "what was said" in text
    assert "motor.R" in text
    found = read_run(folder)
    assert found.results.names == run.names
    assert main(["view", "nowhere"]) == 1
    assert main(["view", "there"]) == 1
    said = capsys.readouterr().err
    assert "nowhere: there is no such folder or file" in said
    assert "name the folder that `cosim run` has written" in said


def test_runs_import_nothing_of_pages():
    code = "import sys, cosim.commands.run, cosim.commands.run_scenario; print(*sys.modules)"
    known = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "cosim.commands.execution" in known
    assert [
        name
        for name in known
        if name.startswith(("cosim.page", "cosim.results.page", "tornado", "parallel_robot.anim"))
    ] == []


# ---- several runs


def other(run: Results) -> Results:
    """The same system with another start value, on other times."""
    time = np.linspace(0.0, 1.9, 381)
    names = ["motor.phi", "motor.tau[1]", "motor.new"]
    values = np.column_stack([np.sin(5.0 * time) + 0.25 * time, np.cos(3.0 * time), time])
    info = {**run.info, "parameters": {"motor.R": 2.5, "load.name": NASTY}, "metrics": {"error": {"max": 2e-3}}}
    return Results(time, names, values, {**info, "versions": {"python": "4"}})


def test_several_runs_are_laid_over_each_other(run):
    text = compare_page(labelled([("a", run), ("a", run), (NASTY, other(run))]))
    elements = Elements(text)
    assert elements.open == []
    assert "<img" not in text
    section = re.search(r'<section id="differences".*?</section>', text, re.DOTALL)
    assert section
    assert text.index('<section id="differences"') < text.index('<section id="signals"')
    rows = {row[0]: row[1:] for row in (re.findall(r"<t[hd].*?>(.*?)</t[hd]>", tr) for tr in section[0].split("<tr>"))
            if row}  # fmt: skip
    assert rows["<code>motor.R</code>"] == ["1.5", "1.5", '<span class="differs">2.5</span>']
    assert rows["<code>python</code>"] == ["3", "3", '<span class="differs">4</span>']
    assert "load.name" not in section[0]
    assert "<code>motor.new</code>" in section[0]
    assert "+100 %" in text
    variables = {v["name"]: v for v in data(text)["curves"]["variables"]}
    assert [c["run"] for c in variables["motor.phi"]["columns"]] == [0, 1, 2]
    # linear between rows of the first run, whose sine bends a little there
    assert variables["motor.phi"]["difference"] == pytest.approx(0.25 * 1.9 / 2.0, abs=1e-3)
    assert variables["motor.p"]["difference"] == 0.0
    assert variables["motor.new"]["difference"] is None
    assert [run["label"] for run in data(text)["curves"]["runs"]] == ["a", "a (2)", NASTY]


def test_the_command_compares_runs(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, results_ in (("one", run.thinned(20)), ("two", other(run))):
        Path(name).mkdir()
        results_.save(Path(name) / "results.parquet")
        Path(name, "summary.json").write_text(json.dumps(results_.info), encoding="utf-8")
    assert main(["view", "one", "two", "--out", "page.html", "--title", "Both"]) == 0
    text = Path("page.html").read_text(encoding="utf-8")
    assert "<h1>Both</h1>" in text
    assert '<span class="differs">2.5</span>' in text


# ---- the page in a browser


def drawn(tab: Any, n: int = 1) -> None:
    tab.locator(".panels").scroll_into_view_if_needed()
    until(tab, f"document.querySelectorAll('[data-drawn]').length >= {n}")


def test_it_works_in_a_browser(tabs, page, run):
    tab = tabs.open(page)
    drawn(tab, 2)
    # the numbers are those of the run, to the last bit of 32
    for variable in some(data(page.read_text(encoding="utf-8"))["curves"]["variables"]):
        columns = tab.evaluate(
            "([id, columns]) => columnsOf(id, columns).then((all) => all.map((c) => Array.from(c)))",
            [variable["block"], variable["columns"]],
        )
        for column, described in zip(columns, variable["columns"], strict=True):
            name = variable["name"] + (described["label"] if described["label"].startswith("[") else "")
            expected = run.values[:, run.names.index(name)]
            found = np.array(column, dtype=float)
            limit = 1e-6 * np.nanmax(np.abs(expected - described.get("offset", 0.0)))
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=limit, equal_nan=True)
    # by keyboard: cursor, zoom, all
    tab.locator(".plot-area").first.focus()
    tab.keyboard.press("ArrowRight")
    assert "motor.phi at 1.01 s" in tab.locator(".plot [role=status]").first.inner_text()
    tab.keyboard.press("+")
    assert float(tab.get_attribute("#signals", "data-to")) - float(tab.get_attribute("#signals", "data-from")) == 1.0
    tab.keyboard.press("Escape")
    assert tab.get_attribute("#signals", "data-from") == "0"
    # by pointer
    box = tab.locator(".u-over").first.bounding_box()
    tab.mouse.move(box["x"] + box["width"] / 4, box["y"] + 50)
    tab.mouse.down()
    tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + 60, steps=3)
    tab.mouse.up()
    assert float(tab.get_attribute("#signals", "data-from")) == pytest.approx(0.5, abs=0.02)
    tab.click("[data-act=all]")
    # search and grouping
    tab.fill(".search", "tau")
    until(tab, "document.querySelectorAll('.panel').length === 1")
    tab.fill(".search", "")
    tab.select_option(".grouping", "unit")
    until(tab, "document.querySelector('.panel h3').textContent.startsWith('rad')")
    # the diagram
    tab.locator(".diagram [role=button]").last.focus()
    tab.keyboard.press("Enter")
    assert "torque ← motor.tau" in tab.inner_text(".chosen")
    assert tab.input_value(".component") == "load"
    accessible(tab)


#: In the page: a plot gets other values, then another label; whether it stays the same, with its hidden curve.
_ANEW = """(() => {
    const plot = [...signals.plots].find((p) => p.settings.series.length > 1);
    const first = plot.uplot;
    plot.settings.series[0].hidden = true;
    const changed = (change) => plot.settings.series.map((s) => ({ ...s, hidden: false, ...change }));
    const others = (change) => plot.set({ series: changed(change) });
    others({});
    const kept = [plot.uplot === first, plot.settings.series[0].hidden];
    others({ label: "another" });
    return [...kept, plot.uplot === first, plot.settings.series[0].hidden];
})()"""


def test_plots_draw_numbers_of_any_size_and_points_alone_and_other_values_in_place(tabs, page):
    tab = tabs.open(page)
    magnitudes = [0.0, 1.0, 5e-324, 3e-310, 1e-12, 9e14, 1e15, 1.79e308]
    powers = tab.evaluate("(all) => all.map((v) => factorOf([{ values: [0, -v, NaN] }]))", magnitudes)
    assert powers == [1.0, 1.0, 1e-323, 1e-310, 1.0, 1.0, 1e15, 1e308]
    rows = "(values) => alone({ data: [[], values], series: [{}, { idxs: [0, values.length - 1] }] }, 1, false)"
    assert tab.evaluate(rows, [1, None, 2, 3, None, 4, None, None, 5]) == [0, 5, 8]
    assert tab.evaluate(rows, [None, 1, 2, None]) is None
    assert tab.evaluate("distinct([1e6, 1e6 + 5e-4, 1e6 + 1e-3])") == ["1e6", "+0.0005", "+0.001"]
    assert tab.evaluate("distinct([1234567.25, 1234567.5])") == ["1.23457e6−2.75", "−2.5"]
    assert tab.evaluate("new TimeView(1e6, 1e6 + 1e-3).text(1e6 + 5e-4)") == "1000000.0005"
    assert tab.evaluate("valueAt({ times: [0, 1], values: [-1.7e308, 1.7e308] }, 0.5)") == 0.0
    drawn(tab, 2)
    assert tab.evaluate(_ANEW) == [True, True, False, False]


def test_it_fits_a_phone(tabs, page):
    tab = tabs.open(page, width=390, height=844, is_mobile=True, has_touch=True)
    drawn(tab)
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    fits(tab)


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_compared_runs_in_a_browser(tabs, run, tmp_path, width):
    page = tmp_path / "page.html"
    page.write_text(compare_page({"one": run, "two": other(run)}), encoding="utf-8")
    tab = tabs.open(page, width=width)
    tab.fill(".search", "motor.phi")
    until(tab, "document.querySelectorAll('.panel').length === 1")
    drawn(tab)
    tab.locator(".differences .plot-area").focus()
    tab.keyboard.press("End")
    tab.keyboard.press("ArrowLeft")
    tab.keyboard.press("Shift+ArrowLeft")
    said = tab.locator(".differences [role=status]").inner_text()
    time, off = re.search(r"at ([\d.]+) s: two − one ([\d.]+) rad", said).groups()
    assert float(off) == pytest.approx(0.25 * float(time), abs=2e-3)
    tab.fill(".search", "")
    tab.select_option(".grouping", "difference")
    until(tab, "document.querySelector('.panel h3').textContent.includes('differ by 23')")
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    accessible(tab)
    fits(tab)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_everybody_can_use_it(tabs, page, width, scheme):
    tab = tabs.open(page, width=width, color_scheme=scheme)
    drawn(tab)
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    accessible(tab)
    fits(tab)
    for panel in some(tab.locator(".panel").all()):  # what is drawn while one walks past can't be reached
        panel.scroll_into_view_if_needed()
    until(tab, "document.querySelectorAll('.panel:not([data-drawn])').length === 0")
    walked(tab)


@pytest.mark.slow
def test_two_hundred_signals(tabs, tmp_path):
    """5,000 rows are all there; 100,000 are reduced to what the budget takes."""
    rng = np.random.default_rng(1)
    names = [f"c{k}.v[{i}]" for k in range(20) for i in range(1, 11)]
    for n, reduced in ((5_000, False), (100_000, True)):
        values = np.cumsum(rng.standard_normal((n, 200)), axis=0)
        page = tmp_path / f"{n}.html"
        Results(1e-3 * np.arange(n), names, values).report(page)
        assert page.stat().st_size < 6_000_000
        run = data(page.read_text(encoding="utf-8"))["curves"]["runs"][0]
        assert (run["resolution"] is not None) == reduced
        tab = tabs.open(page)
        drawn(tab, 2)


# ---- a page that asks for values


def served(run: Results) -> tuple[str, Callable[[], None]]:
    """Address of a page that asks for values of a run, and a function that ends its server."""
    page = run_page(run, budget=20_000, asks=True)
    ready = threading.Event()
    found: dict[str, Any] = {}

    async def serve() -> None:
        with PageServer(page, {"detail": partial(detail, {"a": run})}) as server:
            found["address"], found["loop"] = server.address, asyncio.get_running_loop()
            found["task"] = asyncio.current_task()
            ready.set()
            with suppress(asyncio.CancelledError):
                await server.serve()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    assert ready.wait(PATIENCE)

    def end() -> None:
        found["loop"].call_soon_threadsafe(found["task"].cancel)
        thread.join(PATIENCE)

    return found["address"], end


def many() -> Results:
    """A run of more values than a small page takes, with a spike."""
    time = np.linspace(0.0, 100.0, 50_001)
    values = np.column_stack([np.sin(40.0 * time), np.cos(time)])
    values[25_000, 0] = 7.0
    return Results(time, ["a.x", "a.y"], values)


@pytest.mark.slow
def test_values_that_a_page_lacks_are_answered_to_whom_they_belong():
    run = many()
    address, end = served(run)
    try:

        def ask(path: str, **headers: str) -> tuple[int, bytes]:
            try:
                with urlopen(Request(address.rpartition("/")[0] + path, headers=headers)) as answer:
                    return answer.status, answer.read()
            except HTTPError as error:
                return error.code, b""

        assert address.startswith("http://127.0.0.1:")
        status, text = ask("/")
        assert status == 200
        assert b"connect-src 'self'" in text
        assert ask("/", Host="evil.example")[0] == 421
        assert ask("/../detail?names=0:a.x&from=0&to=1")[0] == 404  # without the token
        assert ask("/detail?names=0:a.none&from=0&to=1")[0] == 400
        assert ask("/detail?names=0:a.x&from=0")[0] == 400
        status, text = ask("/detail?names=0:a.x%0A0:a.y&from=49.999&to=50.001")
        assert status == 200
    finally:
        end()
    answer = json.loads(text)
    (x, y) = answer["curves"]
    first = np.searchsorted(run.time, 49.999) - 1
    assert (x["rows"], x["resolution"], x["time"]["start"]) == (y["rows"], None, run.time[first])
    columns = decoded(zlib.decompress(base64.b64decode(answer["bytes"])), x["rows"])
    np.testing.assert_array_equal(columns[0], run.values[first : first + x["rows"], 0].astype("<f4"))
    assert columns[0].max() == 7.0
    whole = detail({"a": run}, {"names": "0:a.x", "from": "-1", "to": "1e9"})["curves"][0]
    assert whole["rows"] <= 4000
    assert whole["resolution"] == pytest.approx(26 * 0.002)


@pytest.mark.slow
def test_zoom_asks_for_values(browser):
    address, end = served(many())
    tab = browser.new_page()
    try:
        tab.goto(address)
        drawn(tab, 2)
        tab.evaluate("signals.zoom(49.99, 50.01)")
        until(tab, "document.querySelector('.curves').dataset.resolution === 'all'")
        tab.evaluate("signals.point(50)")
        assert tab.locator(".panel output").first.inner_text() == "7"
        tab.click("[data-act=all]")
    finally:
        tab.close()
        end()
