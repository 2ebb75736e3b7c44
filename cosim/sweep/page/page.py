"""The page of a sweep as HTML: what it varies against what it measures, and the runs as a table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import pyarrow as pa

from cosim.page.document import PLOT_SCRIPTS, PLOT_STYLES, Section, asset, assets, document
from cosim.sweep.store import read, sweep_question

_PACKAGE = "cosim.sweep.page"

#: A page has so many values at most, and so many runs; of more every so many are shown.
MOST_VALUES, MOST_RUNS = 400_000, 20_000


def every_shown(points: int, columns: int) -> int:
    """Of a sweep with so many points and columns, every so many runs are shown."""
    most = max(1, min(MOST_RUNS, MOST_VALUES // max(columns, 1)))
    return max(1, -(-points // most))


def sweep_page(
    title: str,
    points: int,
    factors: Sequence[str],
    metrics: Sequence[str],
    runs: Mapping[str, Sequence[Any]] | None = None,
    *,
    ended: tuple[int, int] | None = None,
) -> str:
    """The page.

    Parameters
    ----------
    title : str
    points : int
        How many runs the sweep has.
    factors, metrics : sequence of str
        Columns of a run.
    runs : mapping, optional
        Those that are there; see `shown`.
    ended : (int, int), optional
        How many runs have ended and failed; by default they come from the server of the page.
    """
    live = ended is None
    every = every_shown(points, len(factors) + len(metrics))
    said = f" Every {every}th run is shown." if every > 1 else ""
    about = f"{points:,} point{'s' * (points != 1)}, {len(factors)} factor{'s' * (len(factors) != 1)}."
    state = '<span class="badge open" id="state" role="status">waiting for the sweep</span> ' if live else ""
    header = (
        f'<p class="over">Sweep{", live" * live}</p>\n<h1>{escape(title)}</h1>\n'
        f'<p class="lead">{state}{about}{said}</p>\n'
        f'<p><progress id="done" max="{points}" value="0" aria-label="Runs that are done"></progress> '
        '<output id="now"></output></p>'
    )
    data = {"factors": list(factors), "metrics": list(metrics), "points": points, "ended": ended, "runs": runs}
    return document(
        title,
        header,
        [_scatter(data), _table()],
        styles=assets(PLOT_STYLES),
        scripts=assets(PLOT_SCRIPTS),
        asks=live,
    )


def page_of_folder(folder: Path, title: str = "") -> str:
    """The page of the runs that a sweep has left in its folder.

    Raises
    ------
    SweepError
        It holds no sweep, or a file is damaged.
    """
    question = sweep_question(folder)
    table = read(folder)
    factors = [name for name in question["factors"] if name in table.column_names]
    metrics = [f.name for f in table.schema if pa.types.is_float64(f.type) and f.name not in factors]
    points = int(question["points"])
    every = every_shown(points, len(factors) + len(metrics))
    ended = len(table), len(table) - table["error"].null_count
    table = table.take([i for i, index in enumerate(table["index"].to_pylist()) if index % every == 0])
    columns = {name: table[name].to_pylist() for name in (*factors, *metrics)}
    runs = shown(table["index"].to_pylist(), columns, table["error"].to_pylist())
    return sweep_page(title or folder.resolve().name, points, factors, metrics, runs, ended=ended)


def shown(indices: Sequence[int], columns: Mapping[str, Sequence[Any]], errors: Sequence[str | None]) -> dict[str, Any]:
    """Runs as the script of the page takes them: `index`, `columns` in their order, and `errors` by position."""
    return {
        "index": list(indices),
        "columns": [[_short(value) for value in column] for column in columns.values()],
        "errors": {str(k): text for k, text in enumerate(errors) if text is not None},
    }


def _short(value: Any) -> Any:
    """A value in the page: numbers with seven digits, and nothing for those that are none."""
    if not isinstance(value, float):
        return value
    return float(f"{value:.7g}") if math.isfinite(value) else None


def _scatter(data: Mapping[str, Any]) -> Section:
    def axis(label: str, kind: str) -> str:
        return (
            f'<span class="axis"><label>{label} <select class="{kind}"></select></label>'
            f'<label class="check"><input type="checkbox" class="log-{kind}"> log</label></span>'
        )

    html = f"""<div class="toolbar static" role="group" aria-label="Axes">
{axis("Across", "across")}{axis("Up", "up")}
<label>Colour <select class="colour"></select></label></div>
<p class="hint">Choose a point to see its run; on the plot ← and → go from point to point.</p>
<div class="panel scatter"></div>
<div class="chosen" role="status"></div>"""
    styles, scripts = [asset("sweep.css", _PACKAGE)], [asset("scatter.js", _PACKAGE), asset("sweep.js", _PACKAGE)]
    return Section("scatter", "Scatter", html, styles=styles, scripts=scripts, data={"sweep": data})


def _table() -> Section:
    html = """<div class="toolbar static" role="group" aria-label="Runs">
<label class="check"><input type="checkbox" class="failed-only"> only failed runs</label>
<output class="found"></output></div>
<div class="wide" tabindex="0" role="region" aria-label="Table: runs"><table class="framed runs-table">
<thead><tr></tr></thead><tbody></tbody></table></div>
<p><button type="button" class="more" hidden>Show more</button></p>"""
    return Section("runs", "Runs", html)
