"""The page about a session: one HTML file, without scripts and without anything from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from cosim.regression.comparison import SignalComparison
from cosim.regression.outcome import Outcome, share
from cosim.regression.plot import plot
from cosim.whole_files import write_whole

#: Content of the page for one case; texts and flags only, for it may come from another process.
Part = dict[str, str | bool]


def part(outcome: Outcome) -> Part:
    """A line of the summary and a section."""
    anchor = escape(f"{outcome.fmu}-{outcome.case}-{outcome.interface}", quote=True).replace(" ", "-")
    passed = not outcome.findings
    verdict = _verdict(passed)
    title = f"{escape(outcome.case)} <small>{outcome.interface}</small>"
    worst = outcome.worst
    farthest = (
        f"<td>{escape(worst.name)}</td><td>{_number(worst, worst.distance[worst.worst])}</td>"
        f"<td>{_number(worst, worst.allowed)}</td>"
        if worst is not None
        else "<td>–</td><td>–</td><td>–</td>"
    )
    row = (
        f'<tr><th scope="row"><a href="#{anchor}">{title}</a></th><td>{verdict}</td>{farthest}'
        f'<td>{len(outcome.signals)}</td><td>{outcome.seconds:.2g} s</td><td class="path">{escape(outcome.fmu)}'
        "</td></tr>"
    )
    findings = "".join(f"<li>{escape(finding)}</li>" for finding in outcome.findings)
    said = f"<details><summary>What the FMU printed</summary><pre>{escape(outcome.said)}</pre></details>"
    ordered = sorted(outcome.signals, key=share, reverse=True)
    off = [signal for signal in ordered if signal.finding]
    within = [signal for signal in ordered if not signal.finding]
    section = [
        f'<section id="{anchor}"><h2>{title} {verdict}</h2>',
        f'<p class="path">{escape(outcome.fmu)}</p>',
        f'<ul class="findings">{findings}</ul>' if findings else "",
        _figures(off),
        f"<details><summary>{_count(len(within), 'signal')} within the tolerance</summary>{_figures(within)}</details>"
        if within
        else "",
        said if outcome.said else "",
        "</section>",
    ]
    return {"passed": passed, "row": row, "section": "\n".join(filter(None, section))}


def write_page(parts: Sequence[Part], path: Path) -> None:
    """Write the page of a session.

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
    style = (files("cosim.regression") / "page.css").read_text(encoding="utf-8")
    heads = ("Case", "Verdict", "Farthest off", "Difference", "Allowed", "Signals", "Time", "File")
    table = "".join(f'<th scope="col">{h}</th>' for h in heads)
    rows = "\n".join(str(one["row"]) for one in ordered)
    sections = "\n".join(str(one["section"]) for one in ordered)
    text = f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{head}: regression of FMUs</title>
<style>
{style}</style>
</head>
<body>
<main>
<h1>Regression of FMUs: {head[0].lower()}{head[1:]}</h1>
<p>CS is co-simulation, ME model exchange. Upper panels: <span class="key reference">reference</span>,
<span class="key result">result</span> and <span class="key band">band</span> that the result has to stay in.
Lower panels: where in the band it is, from −1 to 1. Differences with a time shift are those from the funnel.</p>
<div class="wide" tabindex="0" role="region" aria-label="All runs"><table>
<thead><tr>{table}</tr></thead>
<tbody>
{rows}
</tbody></table></div>
{sections}
</main>
</body>
</html>
"""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def _figures(signals: Sequence[SignalComparison]) -> str:
    figures = [f"<figure><figcaption>{_caption(s)}</figcaption>\n{plot(s)}\n</figure>" for s in signals]
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
    return f'<span class="verdict {"passed" if passed else "failed"}">{"passed" if passed else "failed"}</span>'
