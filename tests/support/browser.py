"""Pages in Chromium: what they log or load, what axe-core finds, and a walk by keyboard."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.patience import wait_for


@contextmanager
def chromium() -> Iterator[Any]:
    """Chromium by Playwright: CHROMIUM names it, else it is looked for on the path; the test is skipped without it."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="pages are not tried in a browser: pip install playwright"
    )
    names = (os.environ.get("CHROMIUM"), "chromium", "chromium-browser", "google-chrome", "chrome")
    path = next(filter(None, map(shutil.which, filter(None, names))), None)
    if path is None:
        pytest.skip("pages are not tried in a browser: no Chromium on the path, nor named by CHROMIUM")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu", "--disable-quic"])
        yield browser
        browser.close()


class Tabs:
    """Opens pages; `close` asserts that none has logged an error or asked for anything outside of itself."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser
        self._contexts: list[Any] = []
        self._troubles: list[str] = []

    def open(self, page: Path, *, width: int = 1280, height: int = 900, clock: bool = False, **options: Any) -> Any:
        """A tab with a page; `clock` puts one into it that the test moves."""
        options = {"reduced_motion": "reduce", **options}
        context = self._browser.new_context(viewport={"width": width, "height": height}, **options)
        self._contexts.append(context)
        tab = context.new_page()
        if clock:
            tab.clock.install()
        tab.on("console", lambda message: self._troubles.append(message.text))
        tab.on("pageerror", lambda error: self._troubles.append(str(error)))
        tab.on("request", lambda r: None if r.url.startswith(("file:", "data:", "blob:")) else self._refuse(r.url))
        tab.goto(page.as_uri())
        return tab

    def _refuse(self, url: str) -> None:
        self._troubles.append(f"asks for {url}")

    def close(self) -> None:
        """Close all tabs."""
        for context in self._contexts:
            context.close()
        assert self._troubles == []


def until(tab: Any, condition: str | Callable[[], Any]) -> Any:
    """Wait for an expression in the page; Playwright's `wait_for_function` needs eval, which policies forbid."""
    return wait_for((lambda: tab.evaluate(condition)) if isinstance(condition, str) else condition)


#: Resolves when nothing in the page has changed for a while (panels are drawn as they come into view); a live page
#: changes for ever, so there is an end.
_AT_REST = """new Promise((resolve) => {
    setTimeout(resolve, 5000);
    let last = setTimeout(resolve, 300);
    const again = () => { clearTimeout(last); last = setTimeout(resolve, 300); };
    const all = {subtree: true, childList: true, characterData: true, attributes: true};
    new MutationObserver(again).observe(document, all);
})"""

#: Rules whose "incomplete" has a reason: text over a canvas or an SVG has no background that axe-core can find.
_UNDECIDED = {"color-contrast"}


def accessible(tab: Any) -> None:
    """Assert that axe-core finds nothing wrong, that ids are unique, and that what is to be hit is 24 pixels large."""
    library = pytest.importorskip("axe_playwright_python", reason="accessibility is not tried: pip install it")
    source = Path(library.__file__).with_name("axe.min.js").read_text(encoding="utf-8")
    session = tab.context.new_cdp_session(tab)  # a script of the page would be against its policy
    session.send("Runtime.evaluate", {"expression": source})
    tab.evaluate(_AT_REST)  # axe-core reads the page in pieces, and calls headings undecided that have changed between
    options = "{resultTypes: ['violations', 'incomplete']}"
    found = tab.evaluate(f"() => axe.run(document, {options})")

    def said(kind: str) -> list[Any]:
        return [(rule["id"], [node["html"][:200] for node in rule["nodes"][:3]]) for rule in found[kind]]

    assert not (wrong := said("violations")), wrong
    assert not (open_ := [rule for rule in said("incomplete") if rule[0] not in _UNDECIDED]), open_
    ids = tab.evaluate("[...document.querySelectorAll('[id]')].map((e) => e.id)")
    assert len(ids) == len(set(ids))
    small = tab.evaluate(
        """[...document.querySelectorAll('button, select, input, summary, nav a, [role=button]')].filter((e) => {
            const boxes = [e, e.closest('label') ?? e].map((t) => t.getBoundingClientRect());
            const size = Math.max(...boxes.map(({ width, height }) => Math.min(width, height)));
            return e.checkVisibility() && boxes[0].width > 0 && size < 24;
        }).map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert not small, small


def fits(tab: Any) -> None:
    """Assert that nothing is wider than the window."""
    assert tab.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


#: What a keyboard must reach, and is to be seen; of radio buttons one of a group.
_REACHED = """[...document.querySelectorAll('a[href], button, input, select, summary, [tabindex="0"]')].filter(
    (e) => e.checkVisibility({visibilityProperty: true}) && !e.disabled && !(e.type === 'radio' && !e.checked))"""


def walked(tab: Any) -> None:
    """Assert that the tabulator reaches all that can be used, and that the focus can be seen each time."""
    tab.evaluate("const skip = document.querySelector('.skip'); skip.focus(); window.reached = new Set([skip])")
    unseen = []
    for _ in range(2000):
        tab.keyboard.press("Tab")
        state = tab.evaluate(
            """(() => {
                const e = document.activeElement, again = window.reached.has(e);
                window.reached.add(e);
                const shown = [e, e.nextElementSibling, e.closest('.segmented'), ...e.querySelectorAll('.box, .wire')];
                const seen = shown.some((s) => s && (getComputedStyle(s).outlineStyle !== 'none'
                    || parseFloat(getComputedStyle(s).strokeWidth) >= 3));
                return [e === document.body || again, seen, e.outerHTML.slice(0, 100)];
            })()"""
        )
        if state[0]:
            break
        if not state[1]:
            unseen.append(state[2])
    assert not unseen, unseen
    missed = tab.evaluate(f"{_REACHED}.filter((e) => !window.reached.has(e)).map((e) => e.outerHTML.slice(0, 120))")
    assert not missed, missed
