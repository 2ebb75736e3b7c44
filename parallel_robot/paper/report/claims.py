"""Claims, Table 1, Theorem 1, open readings and errata of the page: everything that is text and numbers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from typing import get_args

from cosim.page.document import Section
from parallel_robot.paper.report.prose import number, prose, table
from parallel_robot.paper.report.series import CONDITION_NAMES, controller_names
from parallel_robot.paper.reproduce.content import (
    LINE_WIDTH,
    Claim,
    Erratum,
    Reading,
    Runs,
    TableRow,
    TheoremCheck,
    Verdict,
)

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)

#: Verdict -> class of its style, and an icon that tells it without colour.
_LOOKS: dict[Verdict, tuple[str, str]] = {
    "holds": ("good", "✓"),
    "holds in part": ("part", "◐"),
    "does not hold": ("bad", "✗"),
    "cannot be judged": ("open", "?"),
}


#: A claim shows so many values without being asked.
_FEW = 6


def scoreboard(claims: Sequence[Claim]) -> str:
    """How many claims have which verdict."""
    counts = Counter(c.verdict for c in claims)
    tiles = "".join(
        f'<li class="{look}"><b>{counts[v]}</b><span><span aria-hidden="true">{icon}</span> {v}</span></li>'
        for v, (look, icon) in _LOOKS.items()
    )
    return f'<ul class="scoreboard" aria-label="Verdicts on {len(claims)} claims">{tiles}</ul>'


def claims_section(claims: Sequence[Claim]) -> Section:
    """The claims, one line each that opens, with buttons that filter them."""
    counts = Counter(c.verdict for c in claims)
    buttons = f'<button type="button" data-filter="all" aria-pressed="true">all {len(claims)}</button>' + "".join(
        f'<button type="button" data-filter="{v}" aria-pressed="false"><span aria-hidden="true">{_LOOKS[v][1]}</span> '
        f"{v} {counts[v]}</button>"
        for v in VERDICTS
        if counts[v]
    )
    html = f"""{scoreboard(claims)}
<p>The program computes every verdict: it compares each measured value with the threshold. A claim holds when all values
meet it, and in part when some do.</p>
<div class="claims">
<div class="controls"><div class="filters" role="group" aria-label="Show claims by verdict">{buttons}</div>
<label>Find <input type="search" placeholder="words" size="14"></label>
<span class="hint" role="status" aria-live="polite">all {len(claims)} claims</span></div>
<div class="lines">
{"".join(map(_claim, claims))}</div>
</div>"""
    return Section("claims", "Claims", html)


def _claim(c: Claim) -> str:
    look, icon = _LOOKS[c.verdict]
    word = f'<span class="word"> {c.verdict}</span>'
    return (
        f'<details class="claim" id="claim-{escape(c.id)}" data-verdict="{c.verdict}"><summary>'
        f'<span class="badge {look}"><span aria-hidden="true">{icon}</span>{word}</span> '
        f'<span class="line">{prose(c.claim)}</span></summary>'
        f'<p class="where">{prose(c.where)} · <a href="#claim-{escape(c.id)}"><code>{escape(c.id)}</code></a></p>'
        f"<p>{prose(c.why)}</p>{_measure(c)}</details>\n"
    )


def _measure(c: Claim) -> str:
    """The numbers behind a verdict."""
    if not c.metric:
        return ""
    unit = "" if c.unit == "1" else f" {escape(c.unit)}"
    threshold = "" if c.threshold is None else f", wanted {prose(c.relation)} {number(c.threshold)}{unit}"
    runs = f"; runs: {escape(', '.join(c.runs))}" if c.runs else ""
    values = "".join(f"<li><span>{prose(n)}</span> <b>{number(v)}{unit}</b></li>" for n, v in c.values.items())
    shown = f'<ul class="values">{values}</ul>'
    if len(c.values) > _FEW:
        shown = f"<details><summary>All {len(c.values)} values</summary>{shown}</details>"
    return f'<p class="where">Measure: <code>{escape(c.metric)}</code>{threshold}{runs}</p>{shown}'


def table1_section(rows: Sequence[TableRow]) -> Section:
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
    html = f"""<p>The computed number stands first, the printed one beside it in small.</p>
{body}"""
    return Section("table1", "Table 1", html)


def theorem_section(checks: Sequence[TheoremCheck], runs: Runs) -> Section:
    """Theorem 1 along the runs."""
    heads = (
        "Run",
        "printed: max of V′ + λ|Z|² − h",
        "time violated",
        "corrected: max of V′ + λ|Z|² − h",
        "|Z| at start, largest, steady",
        "bound at all times, d",
        "bound in the end (63), and T (64) to twice that: computed, in the run (s)",
        "V over its envelope (74), printed and corrected: largest; at the end",
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
            f"{number(t.chi_min)}; {number(t.T_chi, 3)}, {number(t.below_from, 3)}",
            f"{number(t.envelope_printed, 3)}, {number(t.envelope_corrected, 3)}; "
            + ", ".join(number(t.V_curves["V"][-1] / t.V_curves[name][-1], 3) for name in ("printed", "corrected")),
        )
        for t in checks
    ]
    drawn = next((t for t in checks if t.controller == "1"), checks[0])
    html = f"""<details class="folded"><summary>{len(checks)} runs</summary>
<p>The theorem says that V′ ≤ −λ|Z|² + h at all times, and so bounds |Z|. The largest V′ + λ|Z|² − h of a run shows
whether it does: above zero, the inequality is violated. Printed: with h of (59) as it stands; corrected: with the h
that the proof supports. The ball that the proof guarantees in the end is large: a run that begins within twice its
radius has T = 0.</p>
{table(heads, cells, "Theorem 1 along the runs", "cards")}
{_envelope(drawn, names[drawn.controller])}
</details>"""
    return Section("theorem1", "Theorem 1", html)


#: Size of the drawing of V (px), and its margins: left, right, top, bottom.
_PLOT, _MARGINS = (340, 240), (44, 8, 8, 40)


def _envelope(check: TheoremCheck, name: str) -> str:
    """V of a run and its envelopes by time, V on a logarithmic scale."""
    curves = check.V_curves
    values = [v for which in ("V", "printed", "corrected") for v in curves[which]]
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    (width, height), (left, right, top, bottom), end = _PLOT, _MARGINS, curves["time"][-1]

    def across(t: float) -> float:
        return left + (width - left - right) * t / end

    def down(v: float) -> float:
        return top + (height - top - bottom) * (high - math.log10(v)) / max(high - low, 1)

    def line(which: str) -> str:
        points = zip(curves["time"], curves[which], strict=True)
        return f'<path class="{which}" d="M{"L".join(f"{across(t):.1f} {down(v):.1f}" for t, v in points)}"/>'

    decades = "".join(
        f'<path class="grid" d="M{left} {down(10.0**n):.1f}H{width - right}"/><text x="{left - 4}" '
        f'y="{down(10.0**n) + 4:.1f}" text-anchor="end">{10.0**n:g}</text>'
        for n in range(low, high + 1)
    )
    seconds = "".join(
        f'<text x="{across(t):.1f}" y="{height - bottom + 15}" text-anchor="middle">{t:g}</text>'
        for t in (0.0, end / 3.0, 2.0 * end / 3.0, end)
    )
    ends = {which: number(curves[which][-1], 3) for which in ("V", "printed", "corrected")}
    return f"""<figure class="envelope"><svg viewBox="0 0 {width} {height}" role="img" aria-label="V and its envelopes">
{decades}{seconds}<text x="{left + 4}" y="{top + 10}">V (J)</text>
<text x="{width - right}" y="{height - 6}" text-anchor="end">t (s)</text>
{line("printed")}{line("corrected")}{line("V")}</svg>
<figcaption>V of the run of {escape(name)} (solid) and its envelope (74), with the printed h (dashed) and the corrected
one (dotted). After {number(end, 3)} s V is {ends["V"]} J, and the envelopes are {ends["printed"]} and
{ends["corrected"]} J. V contains k/2 |ψ − ψ̄|² with the least ψ̄ that meets (35).</figcaption></figure>"""


def _sign(excess: float) -> str:
    look, icon = _LOOKS["does not hold" if excess > 0.0 else "holds"]
    return f'<span class="badge {look}"><span aria-hidden="true">{icon}</span> {number(excess)}</span>'


def errata_section(errata: Sequence[Erratum]) -> Section:
    """Errors and gaps of the paper, one line each that opens."""
    html = f"""<details class="folded"><summary>{len(errata)} errors and gaps of the paper</summary>
<p>A line says where, and what is printed there; it opens to what holds.</p>
<div class="lines">
{"".join(map(_erratum, errata))}</div>
</details>"""
    return Section("errata", "Errata", html)


def _erratum(e: Erratum) -> str:
    return (
        f'<details id="erratum-{escape(e.id)}"><summary>{_badge(e.shown, "shown by the numbers")} '
        f'<span class="line"><b>{prose(e.where)}</b> {prose(e.printed)}</span></summary>'
        f"<dl><dt>holds</dt><dd>{prose(e.correct)}</dd></dl>"
        f"<p>{prose(e.evidence)}</p>{_numbers(e.numbers)}</details>\n"
    )


def _numbers(numbers: Mapping[str, float]) -> str:
    items = "".join(f"<li><span>{prose(n)}</span> <b>{number(v, 5)}</b></li>" for n, v in numbers.items())
    return f'<ul class="values">{items}</ul>' if items else ""


#: Ends of the scale of ratios, as powers of ten, and its size (px).
_LEAST, _MOST = -3, 4

_WIDTH, _HEIGHT = 136, 14


def readings_section(readings: Sequence[Reading]) -> Section:
    """Steady errors, axes and torques under each assumption, one line each that opens."""
    reached = sum(r.reaches_printed for r in readings)
    html = f"""<details class="folded">
<summary>{len(readings)} readings, {reached} of them as good as the insets</summary>
<p>The insets of Figs. 8 to 12 show steady errors of some {prose("1e-6")} m and {prose("1e-5")} rad, and the main axes
show how far the errors go on the way. Each line is one run under one assumption, with the gains of row (1, 1) unless it
says otherwise: {reached} of {len(readings)} have steady errors as small as the insets show.
{_best(readings)} That a reading fits does not prove that the authors ran it.</p>
<p>The number of a line is the largest steady error over what its inset can show; where there is room, a bar shows it
on a logarithmic scale from {prose(f"10^{_LEAST}")} to {prose(f"10^{_MOST}")}, with a mark at 1. Feedforward adds to
(38) the torque that the nominal robot of (27) needs for the desired motion, the least that its three motors can do
it with. Feedforward, torque limits, the velocity at the start, the leakage of (37) and the bounding function Π of
(89) are parameters of the FMUs, whose defaults are the paper's law. The fuzzy set (91) of the estimate ψ ends at
0.5. Each command runs the same law with coupled FMUs; where there is none, coupling would take hours, or a scenario
of your own has to say what acts on
the robot.</p>
<div class="lines readings">
{"".join(map(_reading, readings))}</div>
</details>"""
    return Section("readings", "What the figures may have been", html)


def _reading(r: Reading) -> str:
    axes = "stays within them" if r.within_axes else f"leaves them by {number(100.0 * r.beyond_axes, 3)} % of an axis"
    rows = (
        ("acts on the robot", CONDITION_NAMES[r.condition]),
        ("steady error in x, y", ", ".join(prose(f"{r.steady[name]:.2e}") for name in ("x", "y")) + " m"),
        ("main axes", axes),
        ("torque, steady rms", f"{number(r.torque_rms, 3)} N m"),
        ("torque, steady largest", f"{number(r.torque_steady, 3)} N m"),
        ("torque, largest", f"{number(r.torque_max, 4)} N m"),
        ("does not keep to", prose(", ".join(r.breaks)) or "–"),
        ("computed by", prose(r.method)),
    )
    values = "".join(f"<li><span>{name}</span> <b>{value}</b></li>" for name, value in rows)
    return (
        f'<details><summary>{_badge(r.reaches_printed, "reached")} <span class="line">{prose(r.assumption)}</span>'
        f'<span class="ratio">{_scale(r.over_insets)}<b>{number(r.over_insets, 3)}</b>'
        '<span class="unseen"> times what its inset shows</span></span></summary>'
        f'<ul class="values">{values}</ul>{_command(r.command)}</details>\n'
    )


def _command(command: str) -> str:
    """A command, broken between its options only."""
    if not command:
        return ""
    words, *options = command.split(" --")
    spans = " ".join(f"<span>{escape(part)}</span>" for part in (words, *(f"--{option}" for option in options)))
    return f"<p><code>{spans}</code></p>"


def _best(readings: Sequence[Reading]) -> str:
    """Which disturbed run fits best, by the sizes in the insets, of those within the main axes."""
    fitting = [r for r in readings if r.within_axes and r.condition == "disturbed"]
    if not fitting:
        return f"None stays within the main axes (up to {LINE_WIDTH:.0%} of an axis, the width of a line)."
    best = min(fitting, key=lambda r: r.misfit)
    broken = f", against {prose(', '.join(best.breaks))}" if best.breaks else ""
    return (
        f"Of those that stay within the main axes (up to {LINE_WIDTH:.0%} of an axis, the width of a line), under mass "
        f"change and disturbance, the one nearest to the insets is “{prose(best.assumption)}”: all five errors are "
        f"within a factor of {number(best.misfit, 2)}; the largest torque is {number(best.torque_max, 3)} N m{broken}."
    )


def _badge(good: bool, what: str) -> str:
    """A yes or no in colour, as an icon and in words."""
    look, icon, word = ("good", "✓", what) if good else ("bad", "✗", f"not {what}")
    return f'<span class="badge {look}"><span aria-hidden="true">{icon}</span><span class="word"> {word}</span></span>'


def _scale(ratio: float) -> str:
    """A bar on a scale of powers of ten, with a line at 1; what it shows stands beside it in numbers."""
    printed = _place(1.0)
    return (
        f'<svg class="scale" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" aria-hidden="true">'
        f'<rect class="track" y="4" width="{_WIDTH}" height="6" rx="3"/>'
        f'<rect class="bar" y="4" width="{_place(ratio):.1f}" height="6" rx="3"/>'
        f'<path d="M{printed:.1f} 0V{_HEIGHT}"/></svg>'
    )


def _place(ratio: float) -> float:
    share = (math.log10(max(ratio, 10.0**_LEAST)) - _LEAST) / (_MOST - _LEAST)
    return _WIDTH * min(share, 1.0)
