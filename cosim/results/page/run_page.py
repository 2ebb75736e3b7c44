"""The page of one run: its system, its curves, what happened, and how it was made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from html import escape
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.errors import CosimError
from cosim.files.whole import write_whole
from cosim.page.diagram import diagram_section
from cosim.page.document import PLOT_SCRIPTS, PLOT_STYLES, Section, asset, assets, document
from cosim.results.page import facts
from cosim.results.page.curves import BUDGET, curves_of

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded

_PACKAGE = "cosim.results.page"

#: Entry points of this group give pages sections of their own, as a picture of what the system is.
PAGE_GROUP = "cosim.pages"

#: Of the changes of a text, so many are in view, and the others behind a summary.
_FIRST_CHANGES = 5

#: Of a text, so many characters are shown.
_LONGEST_TEXT = 200

#: Results by label -> a section, or None where it knows nothing of such a system.
Further = Callable[[Mapping[str, "Recorded"]], Section | None]


@cache
def further_sections() -> tuple[Further, ...]:
    """What installed packages add to pages.

    Raises
    ------
    CosimError
        An entry point can't be loaded.
    """
    found = []
    for entry in entry_points(group=PAGE_GROUP):
        try:
            found.append(entry.load())
        except Exception as error:  # whatever a package raises
            raise CosimError(
                f"entry point {entry.name} = {entry.value} of the group {PAGE_GROUP}: {type(error).__name__}: {error}; "
                "mend or uninstall its package"
            ) from error
    return tuple(found)


def run_page(run: Recorded, title: str = "", log: str = "", budget: int = BUDGET, *, asks: bool = False) -> str:
    """The page of a run as HTML.

    Parameters
    ----------
    run : Recorded
    title : str
        By default that of the scenario.
    log : str
        What the FMUs said.
    budget : int
        Bytes that the curves may take; see `curves_of`.
    asks : bool
        Whether it may ask the server that it is from for values that it has no room for.

    Raises
    ------
    CosimError
        An installed package that adds a section can't be loaded.
    """
    name = title or facts.title_of(run.info, "Run")
    pictures = [s for s in (*pictures_of({name: run}), diagram_section(run.info)) if s is not None]
    sections = [*pictures, curves_section({name: run}, left_of(budget, pictures))]
    sections += _facts(run, log)
    return document(
        name, _header(run, name), sections, styles=assets(PLOT_STYLES), scripts=assets(PLOT_SCRIPTS), asks=asks
    )


def pictures_of(runs: Mapping[str, Recorded]) -> list[Section]:
    """What installed packages add to the page of these runs.

    Raises
    ------
    CosimError
        One of them can't be loaded.
    """
    return [section for make in further_sections() if (section := make(runs)) is not None]


def left_of(budget: int, sections: Sequence[Section]) -> int:
    """Bytes that curves may take beside other sections: at least half of all."""
    taken = sum(len(block) * 4 // 3 for section in sections for block in section.blocks.values())
    return max(budget - taken, budget // 2)


def _header(run: Recorded, name: str) -> str:
    return (
        f'<p class="over">Co-simulation run</p>\n<h1>{escape(name)}</h1>\n'
        f'<p class="lead">{facts.status_badge(run.info)} {facts.in_a_line(run)}</p>'
    )


def curves_section(runs: Mapping[str, Recorded], budget: int = BUDGET) -> Section:
    """All curves of runs, in plots that are drawn when they come into view."""
    curves = curves_of(runs, budget)
    events = [facts.events(run) for run in runs.values()]
    coarse = [run["resolution"] for run in curves.data["runs"] if run["resolution"]]
    said = (
        f'<p class="hint coarse">There are too many values for a page: curves show the smallest and the largest '
        f"value of each {facts.number(max(coarse))} s.</p>"
        if coarse
        else ""
    )
    if not curves.data["variables"] and not curves.data["texts"]:
        return Section("signals", "Signals", "<p>Nothing was recorded.</p>")
    texts = "".join(_text_line(one, named=len(runs) > 1) for one in curves.data.pop("texts"))
    html = f"""<p class="hint">Drag across a plot to zoom all of them, double-click to see all again; on a plot that has
the focus, ← and → move the cursor, + and − zoom, Esc shows all.</p>
{said}
<div class="toolbar" role="group" aria-label="Curves">
<label class="grow"><span class="unseen">Search</span><input type="search" class="search" placeholder="Search"></label>
<label>Panels <select class="grouping"></select></label>
<label class="of-component">Component <select class="component"><option value="">all</option></select></label>
<span class="buttons" role="group" aria-label="Time range">
<button type="button" data-act="out" aria-label="Zoom out">−</button>
<button type="button" data-act="in" aria-label="Zoom in">+</button>
<button type="button" data-act="left" aria-label="Earlier">←</button>
<button type="button" data-act="right" aria-label="Later">→</button>
<button type="button" data-act="all">Show all</button></span>
<output class="range"></output>
</div>
<p class="hint found" role="status"></p>
<div class="panels"></div>
{f"<h3>Texts</h3><ul>{texts}</ul>" if texts else ""}"""
    return Section(
        "signals",
        "Signals",
        html,
        scripts=[asset("signals.js", _PACKAGE)],
        data={"curves": curves.data, "events": events},
        blocks=curves.blocks,
    )


def _text_line(text: Mapping[str, Any], *, named: bool) -> str:
    """What a text was when, as an item of a list."""
    of_run = f" ({escape(text['run'])})" if named else ""
    said = [f"from {facts.moment(time)} s {_value(value)}" for time, value in text["changes"]]
    first, rest = "; ".join(said[:_FIRST_CHANGES]), said[_FIRST_CHANGES:]
    if rest:
        number = len(rest) + text["more"]
        more = f"; and {text['more']} more" if text["more"] else ""
        summary = f"{number} more change{'s' * (number != 1)}"
        first += f"<details><summary>{summary}</summary>{'; '.join(rest)}{more}</details>"
    return f"<li><b>{escape(text['name'])}</b>{of_run}: {first}</li>"


def _value(value: str) -> str:
    """A text that a signal had, shortened where it is long."""
    if not value:
        return "(empty)"
    shown = escape(value[:_LONGEST_TEXT])
    return shown if len(value) <= _LONGEST_TEXT else f"{shown}… ({len(value):,} characters)"


def _facts(run: Recorded, log: str) -> Sequence[Section]:
    info: Mapping[str, Any] = run.info
    found = [Section("happened", "What happened", html) for html in [facts.happened(run)] if html]
    found += [Section("profile", "Time and error", html) for html in [facts.profile(info)] if html]
    if metrics := facts.flattened(info.get("metrics") or {}):
        found.append(Section("metrics", "Metrics", facts.pairs(metrics, ("metric", "value"), "Metrics")))
    if values := facts.start_values(info):
        table = facts.pairs(values, ("variable", "value"), "Start values")
        said = f"{len(values)} value{'s' * (len(values) != 1)}"
        html = f"<details><summary>{said}</summary>{table}</details>"
        found.append(Section("parameters", "Start values", html))
    if html := facts.made(info):
        found.append(Section("made", "How it was made", html))
    if log:
        found.append(Section("log", "Log of the FMUs", facts.log_text(log)))
    return found


def write_run_page(run: Recorded, path: Path, title: str = "", log: str = "") -> Path:
    """Write the page of a run, which needs no other file and no network.

    Raises
    ------
    OSError
        It can't be written.
    CosimError
        As `run_page`.
    """
    text = run_page(run, title, log)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8", newline="\n"))
    return path
