"""The section with errors, torques and estimates of all runs over time, in one plot."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from cosim.page.document import Section
from parallel_robot.paper.report.series import Series, controller_names
from parallel_robot.paper.reproduce.content import CONDITIONS, Condition, Runs
from parallel_robot.paper.reproduce.figures.style import CONTROLLER_LINES

_CONDITIONS: dict[Condition, str] = {
    "disturbed": "disturbed (mass change and torque)",
    "mass change": "mass change only",
    "nominal": "nominal (neither)",
}

#: Of a dash of the figures (pixels).
_LINE_WIDTH = 1.5

#: What can be plotted, in groups: column, label, unit, factor from the column's unit.
_QUANTITIES: dict[str, tuple[tuple[str, str, str, float], ...]] = {
    "Tracking error": (
        ("error", "Distance from the desired position", "mm", 1e3),
        ("x", "Error in x", "mm", 1e3),
        ("y", "Error in y", "mm", 1e3),
        *((f"q{i}", f"Error of joint {i}", "mrad", 1e3) for i in (1, 2, 3)),
    ),
    "Accumulated error": (
        ("sum_x", "Accumulated error in x", "mm s", 1e3),
        ("sum_y", "Accumulated error in y", "mm s", 1e3),
        *((f"sum_q{i}", f"Accumulated error of joint {i}", "mrad s", 1e3) for i in (1, 2, 3)),
    ),
    "Inside": (
        *((f"tau{i}", f"Torque of motor {i}", "N m", 1.0) for i in (1, 2, 3)),
        ("psi1", "Estimate psi 1", "1", 1.0),
        ("psi2", "Estimate psi 2", "1", 1.0),
        ("closure", "Loop closure error", "m", 1.0),
    ),
}


def errors_section(series: Sequence[Series], runs: Runs) -> Section:
    """The plot, its controls, and a table that is its legend."""
    names, steady_after = controller_names(runs), runs.steady_after
    closed = [s for s in series if s.controller is not None]
    rows = "".join(
        _row(s, names[s.controller], runs.controllers[s.controller].key) for s in closed if s.controller is not None
    )
    groups = "".join(
        f'<optgroup label="{group}">'
        + "".join(f'<option value="{column}">{label} ({unit})</option>' for column, label, unit, _ in quantities)
        + "</optgroup>"
        for group, quantities in _QUANTITIES.items()
    )
    present = [c for c in CONDITIONS if any(s.condition == c for s in closed)]
    conditions = "".join(
        f'<label class="check"><input type="checkbox" name="condition" value="{c}"{" checked" if not k else ""}>'
        f"{_CONDITIONS[c]}</label>"
        for k, c in enumerate(present)
    )
    html = f"""<div class="errors" role="group" aria-label="Plot of errors over time">
<div class="curves"></div>
<table class="key-table"><caption class="unseen">Curves of the plot, and their values</caption>
<thead><tr><th scope="col">Curve</th><th scope="col"><span class="cursor-time">at the cursor</span> (<span class="unit"></span>)</th>
<th scope="col">peak (<span class="unit"></span>)</th><th scope="col">rms (<span class="unit"></span>)</th></tr></thead>
<tbody>
{rows}</tbody></table>
<div class="controls">
<label>Quantity <select class="quantity">{groups}</select></label>
<fieldset class="checks"><legend>Runs with</legend>{conditions}</fieldset>
<label class="check"><input type="checkbox" class="log">Logarithmic</label>
<button type="button" class="steady" data-from="{steady_after:g}">Steady part, from {steady_after:g} s</button>
<button type="button" class="reset">Show all</button>
</div>
<p class="hint">Drag across the plot to zoom, double-click to see all again. The table is the legend: it switches curves on
and off and gives the value at the cursor, and the peak and root mean square of the visible part. Keys on the plot: ← and →
move the cursor (with shift faster), + and − zoom, Esc shows all.</p>
</div>"""  # noqa: E501
    quantities = {
        column: {"label": label, "unit": unit, "scale": scale}
        for group in _QUANTITIES.values()
        for column, label, unit, scale in group
    }
    dashes = [_dash(c.key) for c in runs.controllers]
    return Section("errors", "Errors over time", html, data={"errors": {"quantities": quantities, "dashes": dashes}})


def _dash(key: str) -> list[float]:
    """Dashes (pixels) of a controller as in the figures, which tell curves apart without colour."""
    style = CONTROLLER_LINES[key]["linestyle"]
    return [] if isinstance(style, str) else [round(_LINE_WIDTH * length, 1) for length in style[1]]


def _row(s: Series, name: str, controller: str) -> str:
    assert s.condition is not None
    dash = " ".join(f"{d:g}" for d in _dash(controller))
    return (
        f'<tr data-run="{escape(s.key)}" data-condition="{s.condition}" data-colour="{s.controller}" '
        f'data-name="{escape(s.label)}"><th scope="row"><label class="check"><input type="checkbox" checked>'
        f'<svg class="sample" viewBox="0 0 28 8" aria-hidden="true"><path d="M1 4H27" stroke-dasharray="{dash}" '
        f'class="line-{s.controller}"/></svg>'
        f"<span>{escape(name)} <small>{s.condition}</small></span></label></th>"
        "<td><output></output></td><td><output></output></td><td><output></output></td></tr>\n"
    )
