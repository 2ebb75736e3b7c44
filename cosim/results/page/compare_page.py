"""The page of several runs, laid over each other: what differs first, then curves and their differences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from cosim.page.document import PLOT_SCRIPTS, PLOT_STYLES, Section, assets, document, table
from cosim.results.page import facts
from cosim.results.page.curves import BUDGET
from cosim.results.page.run_page import curves_section, left_of, pictures_of

if TYPE_CHECKING:
    from cosim.results.recorded import Recorded

#: Settings of runs that can differ.
_SETTINGS = (
    "scenario", "ssp", "osp", "fmu", "seed", "status", "step_size", "start_time", "stop_time", "order", "record_every",
)  # fmt: skip

#: So many differences of a kind are listed.
_MOST_DIFFERENCES = 200

#: Of a hash, so many digits tell files apart.
_DIGITS = 12


def labelled(runs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Runs by labels of which no two are equal: later ones of a name get a number."""
    found: dict[str, Any] = {}
    for label, run in runs:
        unique, k = label, 2
        while unique in found:
            unique, k = f"{label} ({k})", k + 1
        found[unique] = run
    return found


def compare_page(runs: Mapping[str, Recorded], title: str = "", budget: int = BUDGET, *, asks: bool = False) -> str:
    """The page of several runs as HTML; the first is the one that others are compared with.

    Parameters
    ----------
    runs : mapping
        Label -> results.
    title : str
        By default the labels.
    budget : int
        Bytes that the curves may take; see `curves_of`.
    asks : bool
        As of `run_page`.

    Raises
    ------
    CosimError
        An installed package that adds a section can't be loaded.
    """
    first, *others = runs
    name = title or f"{first} against {' and '.join(others)}"
    pictures = pictures_of(runs)
    curves = curves_section(runs, left_of(budget, pictures))
    sections = [_differences(runs), *pictures, *_metrics(runs), curves, _made(runs)]
    legend = "".join(
        f'<li><span class="swatch line-{k % 8}"></span><b>{escape(label)}</b>{_about(label, run)} '
        f"{facts.status_badge(run.info)} <small>{facts.in_a_line(run)}</small></li>"
        for k, (label, run) in enumerate(runs.items())
    )
    header = (
        f'<p class="over">{len(runs)} runs, compared with the first</p>\n<h1>{escape(name)}</h1>\n'
        f'<ol class="runs">{legend}</ol>'
    )
    return document(name, header, sections, styles=assets(PLOT_STYLES), scripts=assets(PLOT_SCRIPTS), asks=asks)


def _about(label: str, run: Recorded) -> str:
    """The title of a run, unless its label says the same."""
    title = facts.title_of(run.info, label)
    return f": {escape(title)}" if title != label else ""


def _differences(runs: Mapping[str, Recorded]) -> Section:
    parts = []
    infos = [run.info for run in runs.values()]
    for heading, column, values in (
        ("Settings", "setting", [_settings(info) for info in infos]),
        ("Start values", "variable", [facts.start_values(info) for info in infos]),
        ("FMUs", "component", [_hashes(info) for info in infos]),
        ("Connections", "input", [info.get("connections", {}) for info in infos]),
        ("Input signals", "input", [_signals(info) for info in infos]),
        ("Software", "package", [info.get("versions", {}) for info in infos]),
    ):
        rows = list(_differing(values))
        if rows:
            more = len(rows) - _MOST_DIFFERENCES
            parts.append(
                f"<h3>{heading}</h3>"
                + table((column, *map(escape, runs)), rows[:_MOST_DIFFERENCES], f"{heading} that differ", "differing")
                + (f'<p class="hint">and {more} more</p>' if more > 0 else "")
            )
    recorded = [set(run.names) for run in runs.values()]
    if lacking := sorted(recorded[0].union(*recorded) - recorded[0].intersection(*recorded)):
        named = ", ".join(f"<code>{escape(n)}</code>" for n in lacking[:_MOST_DIFFERENCES])
        parts.append(f"<h3>Not in all runs</h3><p>{named}</p>")
    html = "\n".join(parts) or "<p>Settings, start values, FMUs, connections, input signals and software are equal.</p>"
    return Section("differences", "What differs", html)


def _settings(info: Mapping[str, Any]) -> dict[str, Any]:
    return {name: info[name] for name in _SETTINGS if name in info} | {
        f"extrapolation.{name}": value for name, value in facts.flattened(info.get("extrapolation") or {}).items()
    }


def _hashes(info: Mapping[str, Any]) -> dict[str, Any]:
    return {name: str(fmu.get("sha256", ""))[:_DIGITS] for name, fmu in info.get("fmus", {}).items()}


def _signals(info: Mapping[str, Any]) -> dict[str, Any]:
    return facts.flattened({**info.get("signals", {}), **info.get("disturbances", {})})


def _differing(values: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    """A row for each name whose values are not all equal; those that differ from the first are marked."""
    for name in dict.fromkeys(name for each in values for name in each):
        found = [each.get(name, "–") for each in values]
        if any(value != found[0] for value in found):
            cells = [
                f'<span class="differs">{escape(facts.number(v))}</span>' if v != found[0] else escape(facts.number(v))
                for v in found
            ]
            yield [f"<code>{escape(name)}</code>", *cells]


def _metrics(runs: Mapping[str, Recorded]) -> list[Section]:
    """Metrics side by side, and how far they are from those of the first run."""
    values = [facts.flattened(run.info.get("metrics") or {}) for run in runs.values()]
    names = dict.fromkeys(name for each in values for name, value in each.items() if value is not None)
    if not names:
        return []
    rows = []
    for name in names:
        first, *others = (each.get(name) for each in values)
        cells = [f"{escape(facts.number(value))}{_change(value, first)}" for value in others]
        rows.append([f"<code>{escape(name)}</code>", escape(facts.number(first)), *cells])
    return [Section("metrics", "Metrics", table(("metric", *map(escape, runs)), rows, "Metrics side by side"))]


def _change(value: Any, first: Any) -> str:
    numbers = (int, float)
    if isinstance(value, bool) or not (isinstance(value, numbers) and isinstance(first, numbers)) or value == first:
        return ""
    if not first:
        return ""
    return f" <small>{100.0 * (value - first) / abs(first):+.3g} %</small>".replace("-", "−")


def _made(runs: Mapping[str, Recorded]) -> Section:
    parts = []
    for label, run in runs.items():
        about = facts.made(run.info, label) + facts.happened(run, label)
        parts.append(f"<details><summary>{escape(label)}</summary>{about}</details>")
    return Section("made", "How each was made", "\n".join(parts))
