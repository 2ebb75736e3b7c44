"""Draw the README's animation: one lap of the robot on its path, with the closure forces, as an animated SVG.

cosim run tracking && python docs/make_animation.py results/tracking/results.csv docs/robot.svg
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from cosim import Results
from parallel_robot.animation.motion import chain_forces
from plant_fmu.model import PARAMETERS

#: One lap takes 2 pi s (w = 1 rad/s); the second is steady, and ends nearly where it began.
START, LAP = 2.0 * np.pi, 2.0 * np.pi
FRAMES = 150
#: Pixels per m, pixels per N, and the corner of the picture (m), whose y points down.
SCALE, FORCE, LEFT, TOP = 880.0, 260.0, -0.1, 0.575
WIDTH, HEIGHT = 560, 560

P = PARAMETERS.unpack(PARAMETERS.starts)

STYLE = """
svg { --ink: #1b2430; --paper: #fff; --band: #d3bfe6; --c1: #0072b2; --c2: #d55e00; --c3: #009e73;
  font: 600 15px system-ui, sans-serif; }
@media (prefers-color-scheme: dark) {
  svg { --ink: #f1f4f8; --paper: #151b23; --band: #5b4a78; --c1: #4db2f2; --c2: #f58a4b; --c3: #3ccb9f; } }
.still { display: none; }
@media (prefers-reduced-motion: reduce) { .moving { display: none; } .still { display: inline; } }
rect.stage { fill: var(--paper); }
path, polyline { fill: none; stroke-linecap: round; stroke-linejoin: round; }
text { fill: var(--ink); text-anchor: middle; }
.band { stroke: var(--band); stroke-width: 6; }
.trail { stroke: var(--ink); stroke-width: 2.2; stroke-linecap: butt; }
.base { fill: var(--ink); }
.joint { fill: var(--paper); stroke-width: 2.5; }
.E { fill: var(--ink); stroke: var(--paper); stroke-width: 2; }
"""


def pixels(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Positions (n, 2) in the picture, to a tenth of a pixel, of positions (m)."""
    return np.round(SCALE * np.column_stack([x - LEFT, TOP - y]), 1)


def points(*corners: np.ndarray) -> list[str]:
    """A polyline for each frame, through corners (n, 2) each."""
    return [" ".join(f"{x:g},{y:g}" for x, y in frame) for frame in np.stack(corners, axis=1)]


def arrows(tail: np.ndarray, shift: np.ndarray) -> list[str]:
    """A path with a head for each frame."""
    length = np.maximum(np.hypot(*shift.T), 1e-9)[:, None]
    along, head = shift / length, np.minimum(13.0, 0.7 * length)
    across = np.column_stack([along[:, 1], -along[:, 0]])
    tip, foot = tail + shift, tail + shift - head * along
    corners = (tail, tip, foot + 0.45 * head * across, foot - 0.45 * head * across)
    found = []
    for a, b, left, right in np.round(np.stack(corners, axis=1), 1):
        text = [f"{x:g} {y:g}" for x, y in (a, b, left, right)]
        found.append(f"M{text[0]}L{text[1]}M{text[2]}L{text[1]}L{text[3]}")
    return found


def element(tag: str, changing: dict[str, list[str]], moving: bool, **fixed: str) -> str:
    """An SVG element whose attributes change from frame to frame, or stand still at the first frame."""
    attributes = fixed | {name: values[0] for name, values in changing.items()}
    text = "".join(f' {name.replace("_", "-").rstrip("-")}="{value}"' for name, value in attributes.items())
    if not moving:
        return f"<{tag}{text}/>"
    inside = "".join(
        f'<animate attributeName="{name}" dur="{LAP:.2f}s" repeatCount="indefinite" values="{";".join(values)}"/>'
        for name, values in changing.items()
    )
    return f"<{tag}{text}>{inside}</{tag}>"


def robot(results: Results, moving: bool) -> str:
    """Chains, forces and end effector."""
    frames = np.searchsorted(results.time, START + LAP * np.arange(FRAMES + 1) / FRAMES)
    a, forces = results["plant.theta_a"][frames], chain_forces(results)[frames]
    end = pixels(results["plant.x_E"][frames], results["plant.y_E"][frames])
    links, arrows_, joints = [], [], []
    for i in range(3):
        colour = f"stroke:var(--c{i + 1})"
        base = pixels(np.full(len(a), P.x_A[i]), np.full(len(a), P.y_A[i]))
        elbow = pixels(P.x_A[i] + P.l * np.cos(a[:, i]), P.y_A[i] + P.l * np.sin(a[:, i]))
        links.append(element("polyline", {"points": points(elbow, end)}, moving, style=f"{colour};stroke-width:5"))
        links.append(element("polyline", {"points": points(base, elbow)}, moving, style=f"{colour};stroke-width:10"))
        centre = {"cx": [f"{x:g}" for x in elbow[:, 0]], "cy": [f"{y:g}" for y in elbow[:, 1]]}
        joints.append(element("circle", centre, moving, r="6", class_="joint", style=colour))
        force = FORCE * forces[:, i] * (1.0, -1.0)
        arrows_.append(element("path", {"d": arrows(end, force)}, moving, style=f"{colour};stroke-width:3.5"))
        x, y = base[0]
        away = 30 if elbow[0, 1] < y else -20  # the label is where the link is not
        joints.append(
            f'<rect class="base" x="{x - 11:g}" y="{y - 11:g}" width="22" height="22" rx="5"/>'
            f'<circle class="joint" cx="{x:g}" cy="{y:g}" r="4.5" style="{colour}"/>'
            f'<text x="{x:g}" y="{y + away:g}">A{"₁₂₃"[i]}</text>'
        )
    centre = {"cx": [f"{x:g}" for x in end[:, 0]], "cy": [f"{y:g}" for y in end[:, 1]]}
    return "\n".join([*links, *joints, *arrows_, element("circle", centre, moving, r="7", class_="E")])


def paths(results: Results) -> str:
    """The desired lap as a band, and the actual one as a line."""
    lap = (results.time >= START) & (results.time <= START + LAP + 0.02)
    every = slice(None, None, 20)
    desired = pixels(results["trajectory.x_ref"][lap][every], results["trajectory.y_ref"][lap][every])
    actual = pixels(results["plant.x_E"][lap][every], results["plant.y_E"][lap][every])
    return "\n".join(
        f'<path class="{kind}" d="M{"L".join(f"{x:g} {y:g}" for x, y in line)}"/>'
        for kind, line in (("band", desired), ("trail", actual))
    )


def scales() -> str:
    """How long 100 mm and 0.2 N are."""
    bars = ((0.1 * SCALE, "100 mm", HEIGHT - 20), (0.2 * FORCE, "0.2 N", HEIGHT - 44))
    return "\n".join(
        f'<path d="M18 {y - 4}V{y + 4}M18 {y}H{18 + long:g}M{18 + long:g} {y - 4}V{y + 4}" '
        f'style="stroke:var(--ink);stroke-width:1.5"/>'
        f'<text x="{26 + long:g}" y="{y + 5}" style="text-anchor:start;font-weight:400">{text}</text>'
        for long, text, y in bars
    )


def main(result: str, picture: str) -> None:
    """Write the SVG; who prefers no motion sees it still."""
    results = Results.from_csv(result)
    results.info["parameters"] = {f"plant.{n}": v for n, v in zip(PARAMETERS.names, PARAMETERS.starts, strict=True)}
    text = f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}"
role="img" aria-labelledby="t d"><title id="t">The robot on its path</title>
<desc id="d">Three two-link chains carry the end effector along a five-lobed path; arrows are the closure forces.</desc>
<style>{STYLE}</style>
<rect class="stage" width="{WIDTH}" height="{HEIGHT}" rx="12"/>
{paths(results)}
{scales()}
<g class="moving">
{robot(results, moving=True)}
</g>
<g class="still">
{robot(results, moving=False)}
</g>
</svg>
"""
    Path(picture).write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
