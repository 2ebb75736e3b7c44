"""Pages in Chromium: how soon they show, a frame of a zoom, and from a gain's change to the picture."""

from __future__ import annotations

import os
import shutil
import statistics
import time as clock
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.measure import Section
from cosim import Results

#: Largest median time (ms) of a frame of a zoom, and the panels, lines and rows of that page.
FRAME, PANELS, LINES, ROWS = 25.0, 8, 6, 15_001

#: Largest median and 95th percentile (ms) from a change of a gain to the picture.
CHANGE, LATE = 100.0, 250.0

#: Largest time (s) until the first panels are drawn, and size (MB) of the page of a long run.
FIRST, SIZE = 2.0, 6.0

_ROUNDS, _FRAMES, _CHANGES = 5, 60, 40

#: In the page: another time range in each of some frames.
_ZOOM = """async (n) => {
    for (let k = 0; k < n; k++) {
        signals.zoom(0.01 * k, 15 - 0.02 * k);
        await new Promise((done) => requestAnimationFrame(done));
    }
}"""


#: In the page: a slider is moved, as by a hand.
_SET = """([name, value]) => {
    const slider = document.querySelector(`[data-name="${name}"] input[type=number]`);
    slider.value = value;
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    slider.dispatchEvent(new Event("change", { bubbles: true }));
}"""


@contextmanager
def _tab() -> Iterator[Any]:
    """A tab of 1280 by 2000 pixels, in which eight panels are in view."""
    from playwright.sync_api import sync_playwright

    found = map(shutil.which, filter(None, (os.environ.get("CHROMIUM"), "chromium", "google-chrome")))
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=next(filter(None, found), None), args=["--no-sandbox", "--disable-gpu"]
        )
        size = {"width": 1280, "height": 2000}
        yield browser.new_context(viewport=size, reduced_motion="reduce").new_page()
        browser.close()


def _until(tab: Any, condition: str) -> None:
    while not tab.evaluate(condition):
        clock.sleep(0.01)


def _curves(rows: int, names: list[str]) -> Results:
    rng = np.random.default_rng(1)
    time = np.linspace(0.0, 15.0, rows)
    return Results(time, names, np.cumsum(rng.standard_normal((rows, len(names))), axis=0))


def _zoom(tab: Any, folder: Path) -> list[float]:
    """Processor time (ms) of the page's thread for a frame of a zoom in dense panels, in several rounds."""
    page = folder / "dense.html"
    _curves(ROWS, [f"c.v{k}[{i}]" for k in range(PANELS) for i in range(1, LINES + 1)]).report(page)
    tab.goto(page.as_uri())
    tab.locator(".panels").scroll_into_view_if_needed()
    _until(tab, f"document.querySelectorAll('[data-drawn]').length === {PANELS}")
    tab.evaluate("document.querySelector('.panels').scrollIntoView()")
    session = tab.context.new_cdp_session(tab)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def busy() -> float:
        metrics = session.send("Performance.getMetrics")["metrics"]
        return 1e3 * next(float(m["value"]) for m in metrics if m["name"] == "TaskDuration")

    found = []
    for _ in range(_ROUNDS):
        before = busy()
        tab.evaluate(_ZOOM, _FRAMES)
        found.append((busy() - before) / _FRAMES)
    return found


def _opening(tab: Any, folder: Path, rows: int) -> tuple[float, float]:
    """Seconds until two panels of 200 signals are drawn, and the size (MB) of their page."""
    page = folder / f"{rows}.html"
    _curves(rows, [f"c{k}.v[{i}]" for k in range(20) for i in range(1, 11)]).report(page)
    began = clock.perf_counter()
    tab.goto(page.as_uri())
    tab.locator(".panels").scroll_into_view_if_needed()
    _until(tab, "document.querySelectorAll('[data-drawn]').length >= 2")
    return clock.perf_counter() - began, page.stat().st_size / 1e6


def _gains(tab: Any, folder: Path, fmus: Path) -> tuple[list[float], float]:
    """Times (ms) from the change of a gain to the picture, as the live page measures them; processor time of one."""
    from parallel_robot.live.page import live_page

    page = folder / "live.html"
    page.write_text(live_page(fmus), encoding="utf-8")
    tab.goto(page.as_uri())
    runs = "Number(document.querySelector('[data-runs]')?.dataset.runs ?? 0)"
    _until(tab, f"{runs} > 0")
    session = tab.context.browser.new_browser_cdp_session()

    def busy() -> float:
        processes = session.send("SystemInfo.getProcessInfo")["processInfo"]
        return 1e3 * max(float(p["cpuTime"]) for p in processes if p["type"] == "renderer")

    found, began = [], busy()
    for k in range(_CHANGES):
        before = tab.evaluate(runs)
        tab.evaluate(_SET, ["beta" if k % 2 else "alpha", 0.5 + 0.1 * k])
        _until(tab, f"{runs} > {before}")
        found.append(float(tab.evaluate("document.querySelector('[data-waited]').dataset.waited")))
    return found, (busy() - began) / _CHANGES


def measure_pages(fmus: Path) -> Section:
    """All of it."""
    try:
        with TemporaryDirectory() as name, _tab() as tab:
            folder = Path(name)
            frames = _zoom(tab, folder)
            openings = {rows: _opening(tab, folder, rows) for rows in (5_000, 1_000_000)}
            changes, change_busy = _gains(tab, folder, fmus)
    except ImportError as error:
        return Section("Pages in Chromium", f"Not measured: {error}.", (), [], {})
    frame, change = statistics.median(frames), statistics.median(changes)
    late = float(np.percentile(changes, 95.0))
    dense = f"{PANELS} panels of {LINES} lines of {ROWS:,} points"
    rows = [
        (f"frame of a zoom, {dense}: processor time", f"{frame:.1f} ms", f"{max(frames):.1f} ms"),
        ("gain to picture", f"{change:.0f} ms", f"{max(changes):.0f} ms"),
        ("gain to picture: processor time", f"{change_busy:.0f} ms", ""),
    ]
    for n, (seconds, size) in openings.items():
        rows.append((f"200 signals of {n:,} rows, to the first panels", f"{seconds:.2f} s", f"{size:.2f} MB"))
    return Section(
        "Pages in Chromium",
        "Without a graphics processor. A frame is what the page's thread computes for one change of the time range in "
        f"all panels, {_ROUNDS} rounds of {_FRAMES}. The live page says itself how long it is from a change of a gain "
        f"to the picture, of which {_CHANGES} are made; its processor time has all threads, also what is drawn in "
        "between. Of pages of runs: seconds and size.",
        ("what", "median", "largest, or size"),
        rows,
        {"frames_ms": frames, "changes_ms": changes, "change_processor_ms": change_busy, "openings": openings},
        [
            (f"frame of a zoom {frame:.1f} ms, at most {FRAME:g}", frame <= FRAME),
            (f"gain to picture {change:.0f} ms, at most {CHANGE:g}", change <= CHANGE),
            (f"gain to picture, 95th percentile {late:.0f} ms, at most {LATE:g}", late <= LATE),
            *(
                (f"{n:,} rows: first panels after {s:.2f} s, at most {FIRST:g}", s <= FIRST)
                for n, (s, _) in openings.items()
                if n < 100_000
            ),
            (f"page of the long run {openings[1_000_000][1]:.2f} MB, at most {SIZE:g}", openings[1_000_000][1] <= SIZE),
        ],
    )
