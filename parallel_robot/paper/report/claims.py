"""Claims, errata and tables of the page: everything that is text and numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import get_args

from parallel_robot.paper.report.prose import number, prose
from parallel_robot.paper.report.series import CONDITION_NAMES, controller_names
from parallel_robot.paper.reproduce.content import Claim, Erratum, Runs, TableRow, TheoremCheck, Verdict

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)

#: Verdict -> class of its style, and an icon that tells it without colour.
_LOOKS: dict[Verdict, tuple[str, str]] = {
    "holds": ("good", "✓"),
    "holds in part": ("part", "◐"),
    "does not hold": ("bad", "✗"),
    "cannot be judged": ("open", "?"),
}


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], caption: str, kind: str = "") -> str:
    """An HTML table whose cells are HTML already; of class `cards`, its rows become cards on narrow screens."""
    head = "".join(f'<th scope="col">{h}</th>' for h in heads)
    body = "\n".join(
        "<tr>"
        + "".join(f'<td data-head="{_words(h)}"><div>{c}</div></td>' for h, c in zip(heads, row, strict=True))
        + "</tr>"
        for row in rows
    )
    return (
        f'<table class="framed compact {kind}"><caption class="unseen">{caption}</caption>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>"
    )


def _words(html: str) -> str:
    """The text of HTML, for an attribute."""
    return re.sub(r"<[^>]*>", "", html)


def badge(verdict: Verdict) -> str:
    """A verdict as colour, icon and text."""
    look, icon = _LOOKS[verdict]
    return f'<span class="badge {look}"><span aria-hidden="true">{icon}</span> {verdict}</span>'


def scoreboard(claims: Sequence[Claim]) -> str:
    """How many claims have which verdict."""
    counts = Counter(c.verdict for c in claims)
    tiles = "".join(
        f'<li class="{look}"><b>{counts[v]}</b><span><span aria-hidden="true">{icon}</span> {v}</span></li>'
        for v, (look, icon) in _LOOKS.items()
    )
    return f'<ul class="scoreboard" aria-label="Verdicts on {len(claims)} claims">{tiles}</ul>'


def claims_section(claims: Sequence[Claim]) -> str:
    """The table of claims, with buttons that filter it."""
    counts = Counter(c.verdict for c in claims)
    buttons = f'<button type="button" data-filter="all" aria-pressed="true">all {len(claims)}</button>' + "".join(
        f'<button type="button" data-filter="{v}" aria-pressed="false"><span aria-hidden="true">{_LOOKS[v][1]}</span> '
        f"{v} {counts[v]}</button>"
        for v in VERDICTS
        if counts[v]
    )
    return f"""<section id="claims" aria-labelledby="claims-title">
<h2 id="claims-title">What the paper claims, and what holds</h2>
<p>Every verdict is computed: each value that was measured is held against the threshold. A claim holds when all
values meet it, in part when some do.</p>
<div class="claims">
<div class="controls"><div class="filters" role="group" aria-label="Show claims by verdict">{buttons}</div>
<label>Find <input type="search" placeholder="words" size="14"></label>
<span class="hint" role="status" aria-live="polite">all {len(claims)} claims</span></div>
<table class="framed cards"><caption class="unseen">Claims of the paper with verdicts</caption>
<thead><tr><th scope="col">Verdict</th><th scope="col">Claim</th><th scope="col">What was found</th></tr></thead>
<tbody>
{"".join(map(_claim, claims))}</tbody></table>
</div>
</section>"""


def _claim(c: Claim) -> str:
    return (
        f'<tr id="claim-{escape(c.id)}" data-verdict="{c.verdict}"><td data-head="Verdict">{badge(c.verdict)}</td>'
        f'<td data-head="Claim"><p>{prose(c.claim)}</p><p class="where">{prose(c.where)} · '
        f'<a href="#claim-{escape(c.id)}"><code>{escape(c.id)}</code></a></p></td>'
        f'<td data-head="What was found"><p>{prose(c.why)}</p>{_measure(c)}</td></tr>\n'
    )


def _measure(c: Claim) -> str:
    """The numbers behind a verdict, folded away."""
    if not c.metric:
        return ""
    unit = "" if c.unit == "1" else f" {escape(c.unit)}"
    threshold = "" if c.threshold is None else f", wanted {prose(c.relation)} {number(c.threshold)}{unit}"
    runs = f"<p>Runs: {escape(', '.join(c.runs))}</p>" if c.runs else ""
    values = "".join(f"<li><span>{prose(n)}</span> <b>{number(v)}{unit}</b></li>" for n, v in c.values.items())
    return (
        f"<details><summary>{c.met} of {c.total} values meet it{threshold}</summary>"
        f'<p>Measure: <code>{escape(c.metric)}</code></p>{runs}<ul class="values">{values}</ul></details>'
    )


def table1_section(rows: Sequence[TableRow]) -> str:
    """Table 1: computed and printed."""

    def pair(value: float, printed: str) -> str:
        return f"{value:.6f} <small>{escape(printed)}</small>"

    cells = [
        (
            f"{r.mu:g}, {r.nu:g}",
            pair(r.alpha, r.printed_alpha),
            pair(r.beta, r.printed_beta),
            pair(r.J, r.printed_J),
            '<span class="badge good"><span aria-hidden="true">✓</span> agrees</span>'
            if r.agrees
            else '<span class="badge bad"><span aria-hidden="true">✗</span> differs</span>',
        )
        for r in rows
    ]
    heads = ("μ, ν", "α", "β (N m s/rad)", "J<sub>min</sub>", "printed digits")
    body = table(heads, cells, "Table 1, computed and as printed", "cards")
    return f"""<section id="table1" aria-labelledby="table1-title">
<h2 id="table1-title">Table 1: the optimal gains</h2>
<p>Computed, and beside it in small what the paper prints.</p>
{body}
</section>"""


def theorem_section(checks: Sequence[TheoremCheck], runs: Runs) -> str:
    """Theorem 1 along the runs."""
    heads = (
        "Run",
        "printed: max of V′ + λ|Z|² − h",
        "time violated",
        "corrected: max of V′ + λ|Z|² − h",
        "|Z| at start, largest, steady",
        "bound at all times",
        "bound in the end (63)",
    )
    names = dict(zip((c.key for c in runs.controllers), controller_names(runs), strict=True))
    cells = [
        (
            f"{escape(names[t.controller])}<br><small>{CONDITION_NAMES[t.condition]}</small>",
            _sign(t.excess_printed),
            f"{100.0 * t.share_violated:.3g} %",
            _sign(t.excess_corrected),
            f"{number(t.Z_start)}, {number(t.Z_max)}, {number(t.Z_steady)}",
            number(t.d_chi),
            number(t.chi_min),
        )
        for t in checks
    ]
    return f"""<section id="theorem1" aria-labelledby="theorem1-title">
<h2 id="theorem1-title">Theorem 1 along the runs</h2>
<p>The theorem says that V′ ≤ −λ|Z|² + h at all times, and so bounds |Z|. The largest V′ + λ|Z|² − h of a run shows
whether it does: above zero, the inequality is violated. Printed: with h of (59) as it stands; corrected: with the h
that the proof supports.</p>
{table(heads, cells, "Theorem 1 along the runs", "cards")}
</section>"""


def _sign(excess: float) -> str:
    look, icon = _LOOKS["does not hold" if excess > 0.0 else "holds"]
    return f'<span class="badge {look}"><span aria-hidden="true">{icon}</span> {number(excess)}</span>'


def errata_section(errata: Sequence[Erratum]) -> str:
    """Errors and gaps of the paper as a list of cards."""
    cards = "".join(map(_erratum, errata))
    return f"""<section id="errata" aria-labelledby="errata-title">
<h2 id="errata-title">Errata and gaps of the paper</h2>
<div class="errata">
{cards}</div>
</section>"""


def _erratum(e: Erratum) -> str:
    mark = (
        '<span class="badge good"><span aria-hidden="true">✓</span> shown by the numbers</span>'
        if e.shown
        else '<span class="badge bad"><span aria-hidden="true">✗</span> not shown by the numbers</span>'
    )
    return (
        f'<article id="erratum-{escape(e.id)}"><h3>{prose(e.where)}</h3>'
        f"<dl><dt>printed</dt><dd>{prose(e.printed)}</dd><dt>holds</dt><dd>{prose(e.correct)}</dd></dl>"
        f"<p>{prose(e.evidence)}</p>{_numbers(e.numbers)}<p>{mark}</p></article>\n"
    )


def _numbers(numbers: Mapping[str, float]) -> str:
    items = "".join(f"<li><span>{prose(n)}</span> <b>{number(v, 5)}</b></li>" for n, v in numbers.items())
    return f'<ul class="values">{items}</ul>' if items else ""
