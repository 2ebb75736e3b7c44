"""The study as a page of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from cosim.sweep.sensitivity import Index
from parallel_robot.paper.robustness.content import FIGURES, Robustness
from parallel_robot.paper.robustness.findings import CONDITION_WORDS, NEAR_IN_WORDS


def in_markdown(study: Robustness) -> str:
    """Findings, tables and figures; the same study gives the same text."""
    parts = [
        "# Robustness of the closed loop",
        f"{study.runs} runs of 15 s over everything that is uncertain, with the gains of (mu, nu) = (1, 1), and a grid "
        f"of {study.levels} x {study.levels} gains. Written by `cosim robustness`.",
        "## Findings",
        "\n".join(f"- **{finding.question}** {finding.answer}" for finding in study.findings),
        "## What is uncertain",
        _table(
            ("factor", "judged as", "unit", "distribution"),
            ((f"`{s.name}`", s.group, s.unit, s.distribution) for s in study.sources),
        ),
        "## What comes of it",
        "Steady: from 8 s on. Steady error: root mean square of the end effector's distance from where it should be. "
        "Control effort: root mean square of |tau_a| over the run. Nominal: the paper's case, without noise.",
        _table(
            ("", "unit", "nominal", "5 %", "median", "95 %", "largest"),
            (
                (s.name, s.unit, *(f"{v:.3g}" for v in (s.nominal, s.low, s.median, s.high, s.largest)))
                for s in study.spreads
            ),
        ),
        "## What it depends on",
        "Sobol' indices in % of the variance: of each source alone, and with its interactions, with 95 % confidence "
        "intervals.",
        *(
            _table(
                (sensitivity.result, "alone", "with interactions"),
                ((i.group, _share(i, "first"), _share(i, "total")) for i in sensitivity.indices),
            )
            for sensitivity in study.sensitivities
        ),
        "## What the gains trade off",
        f"{NEAR_IN_WORDS[0].upper()}{NEAR_IN_WORDS[1:]}. The last columns: by what factor other gains lower the "
        "error at no more effort, the effort at no more error, and the error for 5 % more effort.",
        *(
            f"{CONDITION_WORDS[front.condition][0].upper()}{CONDITION_WORDS[front.condition][1:]}:\n\n"
            + _table(
                ("", "alpha", "beta", "error (mm)", "effort (N m)", "is", "error", "effort", "5 % more"),
                (
                    (
                        "PD" if p.controller == "pd" else f"mu/nu = {p.controller}",
                        *(f"{v:.4g}" for v in (p.alpha, p.beta, p.error, p.effort)),
                        p.place,
                        *(f"{v:.3f}" for v in (p.error_alone, p.effort_alone, p.error_for_more)),
                    )
                    for p in front.placed
                ),
            )
            for front in study.fronts
        ),
        "## Figures",
        *(f"![{f.alt}]({FIGURES}/{f.name}.png)\n\n{f.title}. {f.caption}" for f in study.figures),
    ]
    return "\n\n".join(parts) + "\n"


def _share(index: Index, kind: str) -> str:
    low, high = getattr(index, f"{kind}_interval")
    return f"{100 * getattr(index, kind):.1f} ({100 * low:.1f} to {100 * high:.1f})"


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
