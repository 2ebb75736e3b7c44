"""The page about a session: one HTML file, with pictures of what is off first."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from cosim.files.whole import write_whole
from cosim.page.document import PLOT_SCRIPTS, PLOT_STYLES, Section, asset, assets, document, table
from cosim.regression.comparison import SignalComparison
from cosim.regression.outcome import Outcome, share
from cosim.regression.pictures import picture

#: Content of the page for one case; texts and flags only, for it may come from another process.
Part = dict[str, str | bool]

_PACKAGE = "cosim.regression"


def part(outcome: Outcome) -> Part:
    """A case: whether it passed, its title, its cells of the table, its section, and its pictures as JSON."""
    passed = not outcome.findings
    worst = outcome.worst
    farthest = (
        [escape(worst.name), _number(worst, worst.distance[worst.worst]), _number(worst, worst.allowed)]
        if worst is not None
        else ["–", "–", "–"]
    )
    cells = [_verdict(passed), *farthest, f"{len(outcome.signals)}", f"{outcome.seconds:.2g} s", escape(outcome.fmu)]
    ordered = sorted(outcome.signals, key=share, reverse=True)
    off = [signal for signal in ordered if signal.finding]
    within = [signal for signal in ordered if not signal.finding]
    findings = "".join(f"<li>{escape(finding)}</li>" for finding in outcome.findings)
    folded = f"<details><summary>{_count(len(within), 'signal')} within the tolerance</summary>"
    section = [
        _figures(off, 0),
        f'<ul class="findings">{findings}</ul>' if findings else "",
        f"{folded}{_figures(within, len(off))}</details>" if within else "",
        f"<details><summary>What the FMU printed</summary><pre>{escape(outcome.said)}</pre></details>"
        if outcome.said
        else "",
        f'<p class="path">{escape(outcome.fmu)}</p>',
    ]
    pictures = [picture(signal) for signal in (*off, *within)]
    drawn = [{**p.data, "bytes": b64encode(p.block).decode()} for p in pictures]
    return {
        "passed": passed,
        "title": f"{escape(outcome.case)} <small>{outcome.interface}</small>",
        "cells": json.dumps(cells),
        "section": "\n".join(filter(None, section)),
        "pictures": json.dumps(drawn),
    }


def write_page(parts: Sequence[Part], path: Path, title: str = "") -> None:
    """Write the page of a session.

    Parameters
    ----------
    parts : sequence of mapping
        As `part` makes them.
    path : path
    title : str
        By default how many runs of FMUs failed.

    Raises
    ------
    OSError
        The file can't be written.
    """
    failed = sum(not one["passed"] for one in parts)
    head = (
        "No case was run"
        if not parts
        else f"{failed} of {_count(len(parts), 'run')} failed"
        if failed
        else (f"All {_count(len(parts), 'run')} passed" if len(parts) > 1 else "The run passed")
    )
    ordered = sorted(parts, key=lambda one: one["passed"])  # what failed comes first
    sections, rows = [], []
    for k, one in enumerate(ordered, 1):
        section = _section(one, f"run-{k}")
        sections.append(section)
        rows.append([f'<a href="#{section.id}">{one["title"]}</a>', *json.loads(str(one["cells"]))])
    pictures: dict[str, Any] = {}
    for section in sections:
        pictures |= section.data["pictures"]
    heads = ("Case", "Verdict", "Farthest off", "Difference", "Allowed", "Signals", "Time", "File")
    sections.append(Section("all", "All runs", table(heads, rows, "All runs")))
    heading = escape(title) or f"Regression of FMUs: {head[0].lower()}{head[1:]}"
    header = f"""<h1>{heading}</h1>
<p class="hint">CS is co-simulation, ME model exchange. Upper plots: reference, result, and the band that it has to stay
in. Lower plots: where in the band it is, from −1 to 1. Differences with a time shift are those from the funnel. Drag to
zoom, double-click to see all.</p>"""
    text = document(
        title or f"{head}: regression of FMUs",
        header,
        sections,
        styles=[*assets(PLOT_STYLES), asset("regression.css", _PACKAGE)],
        scripts=[*assets(PLOT_SCRIPTS), asset("regression.js", _PACKAGE)],
        data={"pictures": pictures},
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def _section(one: Part, name: str) -> Section:
    """The section of a case, whose pictures get names of their own in the page."""
    html, data, blocks = str(one["section"]), {}, {}
    drawn: list[Mapping[str, Any]] = json.loads(str(one["pictures"]))
    for k, described in enumerate(drawn):
        block = f"{name}-{k}"
        html = html.replace(f'data-picture="{k}"', f'data-picture="{block}"', 1)
        data[block] = {key: value for key, value in described.items() if key != "bytes"} | {"block": block}
        blocks[block] = b64decode(described["bytes"])
    title = f"{one['title']} {_verdict(bool(one['passed']))}"
    return Section(name, title, html, data={"pictures": data}, blocks=blocks, listed=not one["passed"])


def _figures(signals: Sequence[SignalComparison], first: int) -> str:
    figures = [
        f'<figure data-picture="{k}"><figcaption>{_caption(s)}</figcaption><div class="curves"></div>'
        '<div class="place"></div></figure>'
        for k, s in enumerate(signals, first)
    ]
    return '<div class="figures">' + "\n".join(figures) + "</div>" if figures else ""


def _caption(signal: SignalComparison) -> str:
    shift = signal.tolerance.time_shift
    off = _number(signal, signal.distance[signal.worst])
    what = "outside the funnel by" if shift else "off by"
    allowed = f"band ±{_number(signal, signal.allowed)}" + (f", {shift:.3g} s earlier or later" if shift else "")
    return f"<b>{escape(signal.name)}</b> at most {what} {off}; {allowed}"


def _number(signal: SignalComparison, value: float) -> str:
    unit = "" if signal.unit in ("", "1") else f" {signal.unit}"
    return escape(f"{value:.3g}{unit}".replace("-", "−"))


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" + ("" if n == 1 else "s")


def _verdict(passed: bool) -> str:
    look, icon, text = ("good", "✓", "passed") if passed else ("bad", "✗", "failed")
    return f'<span class="badge {look}"><span aria-hidden="true">{icon}</span> {text}</span>'
