"""The study in words: findings that are computed from its numbers, and a page of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from cosim.sweep.sensitivity import Index
from parallel_robot.paper.reproduce.content import PRINTED_STEADY
from parallel_robot.paper.reproduce.figures.style import ERROR_WORDS
from parallel_robot.paper.robustness.content import (
    FIGURES,
    Finding,
    Front,
    Place,
    Placed,
    Robustness,
    Sensitivity,
    Spread,
)
from parallel_robot.paper.robustness.front import MORE_EFFORT, NEAR
from parallel_robot.paper.robustness.rows import Rows
from parallel_robot.paper.robustness.study import CONDITIONS

#: A group whose total index is surely below this hardly matters.
_NEGLIGIBLE = 0.05

#: Rank correlations below this are no trend.
_TREND = 0.2

#: Conditions in words.
CONDITION_WORDS: Mapping[str, str] = dict(zip(CONDITIONS, ("without sensor noise", "with sensor noise"), strict=True))


def findings(
    rows: Rows,
    failed: int,
    spreads: Sequence[Spread],
    sensitivities: Sequence[Sensitivity],
    fronts: Sequence[Front],
) -> tuple[Finding, ...]:
    """All questions with their answers."""
    return (
        _bounded(len(rows.error), failed, spreads),
        _printed(rows),
        *(_depends(s) for s in sensitivities),
        *(_near(front) for front in fronts),
    )


def _bounded(runs: int, failed: int, spreads: Sequence[Spread]) -> Finding:
    error = spreads[0]
    return Finding(
        "Does the tracking stay accurate under all uncertainties?",
        f"{failed} of {runs} runs failed. The steady error is {error.median:.3g} {error.unit} in the median, in 90 % "
        f"of the runs between {error.low:.3g} and {error.high:.3g} {error.unit}, at worst {error.largest:.3g} "
        f"{error.unit}; in the paper's case it is {error.nominal:.3g} {error.unit}.",
    )


def _printed(rows: Rows) -> Finding:
    reached = {
        ERROR_WORDS[name]: int((rows.steady_max[name] <= 1e3 * printed).sum())
        for name, printed in PRINTED_STEADY.items()
    }
    some = [f"{number} in {name}" for name, number in reached.items() if number]
    answer = f"{_listed(some)} do" if some else "none does, in none of the five errors"
    least = {name: float(np.nanmin(rows.steady_max[name])) for name in ("x", "y")}
    return Finding(
        "Does any run reach the steady errors of the insets of Figs. 8 to 12?",
        f"Of the {len(rows.error)} runs {answer}. The best one has {least['x']:.3g} mm in x, {least['y']:.3g} mm in y; "
        f"printed are {1e3 * PRINTED_STEADY['x']:.2g} and {1e3 * PRINTED_STEADY['y']:.2g} mm.",
    )


def _depends(sensitivity: Sensitivity) -> Finding:
    ranked = sorted(sensitivity.indices, key=lambda index: -index.total)
    matter = [index for index in ranked if index.total_interval[0] > _NEGLIGIBLE]
    hardly = [index.group for index in ranked if index.total_interval[1] < _NEGLIGIBLE]
    unclear = [index.group for index in ranked if index not in matter and index.group not in hardly]
    sources = _listed([_shares(i, sensitivity.trends) for i in matter]) if matter else "no source for sure"
    text = f"It depends on {sources}."
    if hardly:
        text += f" Each of these surely explains less than {100 * _NEGLIGIBLE:.0f} %: {_listed(hardly)}."
    if unclear:
        text += f" The runs are too few to judge: {_listed(unclear)}."
    return Finding(f"What does the {sensitivity.result} depend on?", text)


def _shares(index: Index, trends: Mapping[str, float]) -> str:
    low, high = (100 * end for end in index.total_interval)
    trend = trends.get(index.group, 0.0)
    way = "" if abs(trend) < _TREND else ", rising with it" if trend > 0 else ", falling as it grows"
    return f"the {index.group} ({100 * index.total:.0f} % of the variance, {low:.0f} to {high:.0f} %{way})"


def _near(front: Front) -> Finding:
    one = next(p for p in front.placed if p.controller == "1")
    others = [p for p in front.placed if p.controller not in ("pd", "1")]
    return Finding(
        "Is the optimum of J anywhere near the Pareto front of steady error and control effort, "
        f"{CONDITION_WORDS[front.condition]}?",
        f"The optimum for (mu, nu) = (1, 1) is {one.place}: {one.error:.3g} mm at {one.effort:.3g} N m, "
        f"{_improvements(one)} The other four: {_places(others)}. For comparison: of the "
        f"{front.gains} gains of the grid {front.near} are on the front or near it, PD is {_pd(front)}. "
        f"{_reach(front)}",
    )


def _improvements(placed: Placed) -> str:
    if not placed.dominated_by:
        text = "and no gains of the grid are better in both."
    else:
        text = (
            f"{placed.dominated_by} gains of the grid are better in both; at no more "
            f"effort the error can be {_percent(placed.error_alone)} smaller, at no more error the effort "
            f"{_percent(placed.effort_alone)} smaller."
        )
    more = f"{100 * (MORE_EFFORT - 1):.0f} % more effort"
    return f"{text} For {more} the error can be {placed.error_for_more:.2f} times smaller."


def _pd(front: Front) -> Place:
    return next(p.place for p in front.placed if p.controller == "pd")


def _reach(front: Front) -> str:
    """Where the front goes that the paper's gains do not."""
    points = len(front.points)
    return (
        f"Of the {points} points of the front {front.at_edge} have the largest alpha or beta of the grid, and "
        f"{front.beyond_proof} a beta above k/(2 max S_ii), which the proof excludes."
    )


def _percent(factor: float) -> str:
    return f"{100 * (1 - 1 / factor):.2g} %"


def _places(placed: Sequence[Placed]) -> str:
    found = {p.controller: p.place for p in placed}
    if len(set(found.values())) == 1:
        return f"all {placed[0].place}"
    return ", ".join(f"mu/nu = {key} {place}" for key, place in found.items())


def _listed(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"


#: How near is meant, for readers.
NEAR_IN_WORDS = (
    f"on the front: no gains of the grid are better in both; near it: none lower one by more than "
    f"{100 * (1 - 1 / NEAR):.0f} % without raising the other"
)


def in_markdown(study: Robustness) -> str:
    """Findings, tables and figures; the same study gives the same text."""
    parts = [
        "# Robustness of the closed loop",
        f"{study.runs} runs of 15 s over all uncertainties, with the gains of (mu, nu) = (1, 1), and a grid "
        f"of {study.levels} x {study.levels} gains. Written by `cosim robustness`.",
        "## Findings",
        "\n".join(f"- **{finding.question}** {finding.answer}" for finding in study.findings),
        "## Uncertain factors",
        _table(
            ("factor", "judged as", "unit", "distribution"),
            ((f"`{s.name}`", s.group, s.unit, s.distribution) for s in study.sources),
        ),
        "## Results over all runs",
        "Steady: from 8 s on. Steady error: root mean square of the end effector's distance from its desired position. "
        "Control effort: root mean square of |tau_a| over the run. Nominal: the paper's case, without noise.",
        _table(
            ("", "unit", "nominal", "5 %", "median", "95 %", "largest"),
            (
                (s.name, s.unit, *(f"{v:.3g}" for v in (s.nominal, s.low, s.median, s.high, s.largest)))
                for s in study.spreads
            ),
        ),
        "## Sensitivities",
        "The tables give Sobol' indices in % of the variance with 95 % confidence intervals, for each source alone and "
        "with its interactions. A share lies between 0 and 100 %; an interval that goes beyond says how uncertain the "
        "estimate from so many runs is.",
        *(
            _table(
                (sensitivity.result, "alone", "with interactions"),
                ((i.group, _share(i, "first"), _share(i, "total")) for i in sensitivity.indices),
            )
            for sensitivity in study.sensitivities
        ),
        "## Trade-off of the gains",
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
