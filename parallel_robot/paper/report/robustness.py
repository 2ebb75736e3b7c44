"""The section of the page on the robustness study, where there is one."""

from __future__ import annotations

from html import escape
from pathlib import Path

from cosim.page.document import Section
from parallel_robot.paper.report.pictures import Picture
from parallel_robot.paper.report.prose import number, prose, table
from parallel_robot.paper.robustness.content import FIGURES, Front, Robustness
from parallel_robot.paper.robustness.text import CONDITION_WORDS, NEAR_IN_WORDS


def robustness_section(study: Robustness, folder: Path) -> Section:
    """Findings, figures and tables of a study in a folder.

    Raises
    ------
    OSError
        A figure can't be read.
    """
    findings = "".join(f"<dt>{prose(f.question)}</dt><dd>{prose(f.answer)}</dd>" for f in study.findings)
    figures = [
        Picture(f"robustness-{f.name}", f.title, f.caption, f.alt, (folder / FIGURES / f"{f.name}.svg").read_bytes())
        for f in study.figures
    ]
    sources = table(
        ("source", "factor", "unit", "distribution"),
        (
            (escape(s.group), f"<code>{escape(s.name)}</code>", escape(s.unit), prose(s.distribution))
            for s in study.sources
        ),
        "Uncertain factors",
        "cards",
    )
    spreads = table(
        ("result", "paper's case", "5 %", "median", "95 %", "largest"),
        (
            (
                f"{prose(s.name)} ({escape(s.unit)})",
                *(number(v, 3) for v in (s.nominal, s.low, s.median, s.high, s.largest)),
            )
            for s in study.spreads
        ),
        "Results over all runs",
        "cards",
    )
    fronts = "".join(map(_front, study.fronts))
    html = f"""<details class="folded">
<summary>{study.runs:,} runs over all uncertain factors, and the Pareto front over the gains</summary>
<p><code>cosim robustness</code> made {study.runs:,} runs of 15 s over all uncertain factors, and runs over a grid of
{study.levels} × {study.levels} gains under two conditions. The steady error is the root mean square of the end
effector’s distance from its desired position, from 8 s on; the control effort is the root mean square of
|τ<sub>a</sub>| over the run.</p>
<dl class="findings">{findings}</dl>
<div class="figures">
{"".join(picture.html(f"figure: {picture.title}") for picture in figures)}</div>
<h3>Uncertain factors</h3>
{sources}
<h3>Results over all runs</h3>
{spreads}
<h3>The paper’s controllers and the Pareto front</h3>
<p>{prose(NEAR_IN_WORDS[0].upper() + NEAR_IN_WORDS[1:])}.</p>
{fronts}
</details>"""
    return Section("robustness", "Robustness", html, blocks={f"{p.id}-data": p.deflated for p in figures})


def _front(front: Front) -> str:
    heads = (
        "controller",
        "α",
        "β (N m s/rad)",
        "steady error (mm)",
        "control effort (N m)",
        "place",
        "error could be lower by",
        "effort could be lower by",
    )
    rows = (
        (
            "PD" if p.controller == "pd" else f"optimum, μ/ν = {escape(p.controller)}",
            *(number(v) for v in (p.alpha, p.beta, p.error, p.effort)),
            p.place,
            *(f"{100 * (1 - 1 / factor):.2g} %" for factor in (p.error_alone, p.effort_alone)),
        )
        for p in front.placed
    )
    words = CONDITION_WORDS[front.condition]
    return f"<h4>{escape(words[0].upper() + words[1:])}</h4>\n{table(heads, rows, f'Controllers {words}', 'cards')}\n"
