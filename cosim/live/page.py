"""The page of a run that goes on: curves that grow, and what can be set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import islice
from typing import Any

from cosim.page.document import PLOT_SCRIPTS, PLOT_STYLES, Section, asset, assets, document

_PACKAGE = "cosim.live"

#: Fields for values that can be set; those of large arrays would fill the page.
_MOST_FIELDS = 200


def live_page(
    title: str,
    names: Sequence[str],
    units: Mapping[str, str],
    settable: Mapping[str, Mapping[str, Any]],
    start_time: float,
    stop_time: float,
) -> str:
    """The page as HTML.

    Parameters
    ----------
    title : str
    names : sequence of str
        Columns of the rows that will come, behind the time.
    units : mapping
        Name -> unit.
    settable : mapping
        Name -> "value", "unit", "min" and "max" of what can be set as the run goes on.
    start_time, stop_time : float
        In s.
    """
    header = (
        f'<p class="over">Co-simulation run, live</p>\n<h1>{escape(title)}</h1>\n'
        '<p class="lead"><span class="badge open" id="state" role="status">waiting for the run</span> '
        '<output id="now"></output></p>'
    )
    sections = [_steering(settable), _curves()]
    data = {"live": {"names": list(names), "units": dict(units), "start": start_time, "stop": stop_time}}
    return document(
        title, header, sections, styles=assets(PLOT_STYLES), scripts=assets(PLOT_SCRIPTS), data=data, asks=True
    )


def _steering(settable: Mapping[str, Mapping[str, Any]]) -> Section:
    fields = "\n".join(_field(i, name, about) for i, (name, about) in enumerate(islice(settable.items(), _MOST_FIELDS)))
    said = f"{len(settable)} values can be set" if settable else "nothing can be set in this system"
    more = len(settable) - _MOST_FIELDS
    fewer = f'<p class="hint">The first {_MOST_FIELDS} are here; a program can set the others.</p>' if more > 0 else ""
    html = f"""<p><span class="buttons" role="group" aria-label="The run">
<button type="button" data-act="pause">Pause</button>
<button type="button" data-act="resume" disabled>Resume</button>
<button type="button" data-act="stop">Stop</button></span></p>
<details><summary>{said}</summary>
<p class="hint">A value is set at the next communication point. What is done is kept, and repeats the run.</p>
<div class="settings">{fields}</div>{fewer}</details>
<p class="hint" id="done" role="status"></p>"""
    return Section("steer", "Steer", html, styles=[asset("live.css", _PACKAGE)])


def _field(i: int, name: str, about: Mapping[str, Any]) -> str:
    limits = "".join(f' {key}="{about[key]!r}"' for key in ("min", "max") if about.get(key) is not None)
    value = "" if about.get("value") is None else f' value="{float(about["value"])!r}"'
    unit = f" <small>{escape(about['unit'])}</small>" if about.get("unit") else ""
    return (
        f'<p><label for="set-{i}">{escape(name)}{unit}</label>'
        f'<input id="set-{i}" type="number" step="any" data-name="{escape(name, quote=True)}"{value}{limits}></p>'
    )


def _curves() -> Section:
    html = """<div class="toolbar" role="group" aria-label="Curves">
<label class="grow"><span class="unseen">Search</span><input type="search" class="search" placeholder="Search"></label>
<span class="buttons"><button type="button" data-act="all">Show all</button></span></div>
<div class="panels"></div>"""
    return Section("signals", "Signals", html, scripts=[asset("live.js", _PACKAGE)])
