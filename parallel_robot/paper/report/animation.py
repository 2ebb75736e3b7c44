"""The robot in motion: views and scales for the script, and the controls around it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from parallel_robot.paper.report.series import CONDITION_NAMES, Series
from parallel_robot.paper.reproduce.content import CONDITIONS

_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)

#: Views are this much wider than what is in them.
_MARGIN = 0.07


def animation_data(series: Sequence[Series]) -> dict[str, Any]:
    """Views [left, bottom, right, top] (m), and the force (N) and torque (N m) of usual size, which set the scales."""
    closed = [s for s in series if s.controller is not None]
    joints = [points for s in series for points in _joints(s)]
    paths = [np.column_stack([s.columns[x], s.columns[y]]) for s in closed for x, y in (("E_x", "E_y"), ("d_x", "d_y"))]
    forces = [np.hypot(s.columns[f"f{i}_x"], s.columns[f"f{i}_y"]) for s in closed for i in (1, 2, 3)]
    torques = [np.abs(s.columns[f"tau{i}"]) for s in closed for i in (1, 2, 3)]
    return {
        "views": {"whole": _view(joints), "path": _view(paths)},
        "force": _usual(forces),
        "torque": _usual(torques),
    }


def _joints(s: Series) -> list[np.ndarray]:
    """Bases, elbows and end effector of a run, each (n, 2) (m)."""
    robot, found = s.geometry(), [np.column_stack([s.columns["E_x"], s.columns["E_y"]])]
    for i, (x, y) in enumerate(zip(robot["x_A"], robot["y_A"], strict=True), start=1):
        a = s.columns[f"a{i}"]
        found.append(np.column_stack([x + robot["l"] * np.cos(a), y + robot["l"] * np.sin(a)]))
        found.append(np.array([[x, y]]))
    return found


def _view(points: Sequence[np.ndarray]) -> list[float]:
    low = np.min([p.min(axis=0) for p in points], axis=0)
    high = np.max([p.max(axis=0) for p in points], axis=0)
    margin = _MARGIN * float((high - low).max())
    return [round(float(v), 4) for v in (*(low - margin), *(high + margin))]


def _usual(magnitudes: Sequence[np.ndarray]) -> float:
    """What 98 of 100 values stay below, to two digits; peaks of the run-in may be larger."""
    return float(f"{np.nanpercentile(np.concatenate(magnitudes), 98.0):.2g}")


def animation_section(series: Sequence[Series], names: Sequence[str]) -> str:
    """HTML of the player; `names` are those of the controllers."""
    left, right = _first_choice(series)
    speeds = "".join(
        f'<option value="{v:g}"{" selected" if v == 1.0 else ""}>{v:g}×</option>' for v in _SPEEDS
    )  # fmt: skip
    stop = max(s.start + s.step * (len(s.columns["E_x"]) - 1) for s in series)
    return f"""<section id="animation" aria-labelledby="animation-title">
<h2 id="animation-title">The robot in motion</h2>
<p>Two runs side by side on one clock. Each coloured chain is an active link, driven at its base A<sub>i</sub>, and a
passive link; all three meet at the end effector. Arrows at the end effector are the forces by which the closure holds
the end of each chain, from F<sub>c</sub> of equation (19): they add up to zero.</p>
<div class="player" role="group" aria-label="Animation of the robot" tabindex="0">
<div class="stages">
{_stage(series, names, left, "First run")}
{_stage(series, names, right, "Second run")}
</div>
<div class="dock">
<div class="timeline"><canvas aria-hidden="true"></canvas>
<input type="range" min="0" max="{stop:g}" step="0.01" value="0" aria-label="Time"></div>
<div class="controls">
<button type="button" class="play primary">{_icon("M4 2l10 6-10 6z")}<span class="word">Play</span></button>
<button type="button" class="restart" aria-label="Restart">{_icon("M2 2h2v12H2zM14 2v12L5 8z")}</button>
<label><span class="word">Speed</span> <select class="speed" aria-label="Speed">{speeds}</select></label>
<span class="clock" aria-hidden="true"><b class="now">0.00</b> s</span>
</div>
</div>
<div class="controls">
<fieldset class="segmented"><legend class="unseen">View</legend>
<label><input type="radio" name="view" value="whole" checked><span>Whole robot</span></label>
<label><input type="radio" name="view" value="path"><span>Close-up</span></label></fieldset>
<label class="check"><input type="checkbox" class="forces" checked>Closure forces</label>
<label class="check"><input type="checkbox" class="torques">Motor torques</label>
<label class="check"><input type="checkbox" class="trail" checked>Trail</label>
<label class="check"><input type="checkbox" class="two" checked>Second robot</label>
</div>
<p class="legend"><span><i class="key desired"></i>desired path; ring: where the end effector should be</span>
<span><i class="key actual"></i>actual path, and error of the first run over time</span>
<span class="legend-second"><i class="key second"></i>error of the second run over time</span></p>
<p class="hint">Error: distance of the end effector from its desired position; force and torque: the largest of the three.
Keys: space plays and pauses, ← and → move by 0.1 s (with shift by 1 s), Home and End.</p>
<p class="unseen" role="status" aria-live="polite"></p>
</div>
</section>"""  # noqa: E501


def _first_choice(series: Sequence[Series]) -> tuple[str, str]:
    """The first controller (PD) against the last (the largest mu/nu), where most acts on the robot."""
    same = [s.key for s in series if s.condition == series[0].condition]
    return same[0], same[-1]


def _stage(series: Sequence[Series], names: Sequence[str], chosen: str, label: str) -> str:
    groups = []
    for condition in CONDITIONS:
        options = "".join(
            _option(s.key, names[s.controller], chosen)
            for s in series
            if s.condition == condition and s.controller is not None
        )
        if options:
            groups.append(f'<optgroup label="With {CONDITION_NAMES[condition]}">{options}</optgroup>')
    others = "".join(_option(s.key, s.label, chosen) for s in series if s.controller is None)
    return f"""<div class="stage">
<label><span class="unseen">{label}</span><select>{"".join(groups)}{others}</select></label>
<canvas role="img" aria-label="{label}"></canvas>
<p class="readout"><span>error <b></b> mm</span> <span>force <b></b> N</span> <span>torque <b></b> N m</span></p>
</div>"""


def _icon(path: str) -> str:
    return f'<svg class="icon" viewBox="0 0 16 16" aria-hidden="true"><path d="{path}"/></svg>'


def _option(key: str, label: str, chosen: str) -> str:
    return f'<option value="{escape(key)}"{" selected" if key == chosen else ""}>{escape(label)}</option>'
