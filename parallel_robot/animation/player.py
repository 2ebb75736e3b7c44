"""The player: one or two robots on one clock, with views and scales for its script, and the controls around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from cosim.page.document import assets
from cosim.page.encoding import block
from parallel_robot.animation.motion import Motion

_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)

#: Views are this much wider than what is in them.
_MARGIN = 0.07

#: Styles and scripts, after those of plots.
STYLES = tuple(assets(("player.css",), __package__))
SCRIPTS = tuple(assets(("robot.js", "player.js"), __package__))


def player_data(motions: Sequence[Motion]) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What the script finds in `DATA.robot`, and the deflated columns by id.

    The data have the motions, the views [left, bottom, right, top] (m), and the force (N) and torque (N m) of usual
    size, which set the scales.
    """
    blocks = {f"motion-{k}": block([c.astype("<f4") for c in m.sent.values()]) for k, m in enumerate(motions)}
    aimed = [m for m in motions if "d_x" in m.columns] or list(motions)
    joints = [points for m in motions for points in _joints(m)]
    pairs = (("E_x", "E_y"), ("d_x", "d_y"))
    paths = [np.column_stack([m.columns[x], m.columns[y]]) for m in aimed for x, y in pairs if x in m.columns]
    forces = [np.hypot(m.columns[f"f{i}_x"], m.columns[f"f{i}_y"]) for m in aimed for i in _chains(m, "f1_x")]
    data = {
        "runs": [m.as_data(name) for m, name in zip(motions, blocks, strict=True)],
        "views": {"whole": _view(joints), "path": _view(paths)},
        "force": _usual(forces),
        "torque": _usual([np.abs(m.columns[f"tau{i}"]) for m in aimed for i in _chains(m, "tau1")]),
    }
    return data, blocks


def _chains(motion: Motion, name: str) -> tuple[int, ...]:
    return (1, 2, 3) if name in motion.columns else ()


def _joints(motion: Motion) -> list[np.ndarray]:
    """Bases, elbows and end effector of a run, each (n, 2) (m)."""
    robot, found = motion.geometry, [np.column_stack([motion.columns["E_x"], motion.columns["E_y"]])]
    for i, (x, y) in enumerate(zip(robot["x_A"], robot["y_A"], strict=True), start=1):
        a = motion.columns[f"a{i}"]
        found.append(np.column_stack([x + robot["l"] * np.cos(a), y + robot["l"] * np.sin(a)]))
        found.append(np.array([[x, y]]))
    return found


def _view(points: Sequence[np.ndarray]) -> list[float]:
    low = np.nanmin([np.nanmin(p, axis=0) for p in points], axis=0)
    high = np.nanmax([np.nanmax(p, axis=0) for p in points], axis=0)
    margin = _MARGIN * float((high - low).max()) or 0.01
    return [round(float(v), 4) for v in (*(low - margin), *(high + margin))]


def _usual(magnitudes: Sequence[np.ndarray]) -> float:
    """What 98 of 100 values stay below, to two digits; peaks of the run-in may be larger."""
    if not magnitudes:
        return 1.0
    return float(f"{np.nanpercentile(np.concatenate(magnitudes), 98.0):.2g}") or 1.0


def player_html(motions: Sequence[Motion], chosen: tuple[str, str], groups: Mapping[str, Sequence[Motion]]) -> str:
    """The player as HTML.

    Parameters
    ----------
    motions : sequence of Motion
    chosen : tuple of str
        Keys of the runs that the two robots show at first.
    groups : mapping
        Heading -> runs, for the choice; those of the empty heading stand alone.
    """
    several = len(motions) > 1
    names = ("First run", "Second run") if several else ("Run", "Second run")
    stages = "\n".join(
        _stage(groups, key, label, choice=several, hidden=bool(k) and not several)
        for k, (key, label) in enumerate(zip(chosen, names, strict=True))
    )
    speeds = "".join(f'<option value="{v:g}"{" selected" if v == 1.0 else ""}>{v:g}×</option>' for v in _SPEEDS)
    start = min(m.start for m in motions)
    stop = max(m.start + m.step * (m.rows - 1) for m in motions)
    box = "checked" if several else "hidden"
    known = {name for m in motions for name in m.columns}
    toggles = "".join(
        f'<label class="check"{"" if needed in known else " hidden"}><input type="checkbox" class="{kind}"{on}>{text}'
        "</label>\n"
        for kind, text, needed, on in (
            ("forces", "Closure forces", "f1_x", " checked"),
            ("torques", "Motor torques", "tau1", ""),
            ("trail", "Trail", "E_x", " checked"),
        )
    )
    return f"""<div class="player{"" if several else " single"}" role="group" aria-label="Animation of the robot" tabindex="0">
<div class="stages">
{stages}
</div>
<div class="dock">
<div class="timeline"><canvas aria-hidden="true"></canvas>
<input type="range" min="{start:g}" max="{stop:g}" step="any" value="{start:g}" aria-label="Time"></div>
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
{toggles}<label class="check" {"" if several else "hidden"}><input type="checkbox" class="two" {box}>Second robot</label>
</div>
<p class="legend"><span><i class="key desired"></i>desired path; ring: where the end effector should be</span>
<span><i class="key actual"></i>actual path{", and error of the first run over time" if several else ", and error over time"}</span>
<span class="legend-second"{"" if several else " hidden"}><i class="key second"></i>error of the second run over time</span></p>
<p class="hint">Error: distance of the end effector from its desired position; force and torque: the largest of the three.
Keys: space plays and pauses, ← and → move by 0.1 s (with shift by 1 s), Home and End.</p>
<p class="unseen" role="status" aria-live="polite"></p>
</div>"""  # noqa: E501


def _stage(groups: Mapping[str, Sequence[Motion]], chosen: str, label: str, *, choice: bool, hidden: bool) -> str:
    options = "".join(
        f'<optgroup label="{escape(heading, quote=True)}">{_options(runs, chosen)}</optgroup>'
        if heading
        else _options(runs, chosen)
        for heading, runs in groups.items()
    )
    return f"""<div class="stage"{" hidden" if hidden else ""}>
<label{"" if choice else " hidden"}><span class="unseen">{label}</span><select>{options}</select></label>
<canvas role="img" aria-label="{label}"></canvas>
<p class="readout"><span>error <b></b> mm</span> <span>force <b></b> N</span> <span>torque <b></b> N m</span></p>
</div>"""


def _icon(path: str) -> str:
    return f'<svg class="icon" viewBox="0 0 16 16" aria-hidden="true"><path d="{path}"/></svg>'


def _options(motions: Sequence[Motion], chosen: str) -> str:
    keys = {m.key: (escape(m.key, quote=True), " selected" if m.key == chosen else "") for m in motions}
    return "".join(f'<option value="{keys[m.key][0]}"{keys[m.key][1]}>{escape(m.label)}</option>' for m in motions)
