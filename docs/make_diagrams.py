"""Draw the diagrams of the documentation: robot, desired path, rooms of the project, design procedure.

python docs/make_diagrams.py      # writes plant_fmu/geometry.svg, trajectory_fmu/path.svg, docs/architecture.svg,
                                  # docs/procedure.svg

Geometry and path are computed from the models, so that angles and lengths are those of the equations.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from plant_fmu.kinematics import inverse_kinematics
from plant_fmu.model import PARAMETERS as PLANT
from trajectory_fmu.model import PARAMETERS as PATH
from trajectory_fmu.model import desired_path

ROOT = Path(__file__).resolve().parents[1]

#: Colours of figures on light and on dark paper: paper, ink, faint, active links, passive links, accent.
LIGHT = ("#ffffff", "#222222", "#8a8f98", "#0072b2", "#d55e00", "#00765a")
DARK = ("#16181c", "#e6e6e6", "#8a919c", "#56b4e9", "#f0904a", "#35c59b")
NAMES = ("paper", "ink", "faint", "active", "passive", "accent")


def style() -> str:
    """CSS of a figure; the paper is drawn too, so that it stays legible on a page that does not follow the system."""

    def colours(values: Iterable[str]) -> str:
        return "".join(
            f".f-{name}{{fill:{value}}}.s-{name}{{stroke:{value}}}" for name, value in zip(NAMES, values, strict=True)
        )

    return (
        "text{font:italic 19px 'STIX Two Text',Georgia,'Times New Roman',serif}"
        ".plain{font:15px system-ui,'Segoe UI',Helvetica,Arial,sans-serif}"
        ".bold{font-weight:600}.small{font-size:13px}"
        ".line{fill:none;stroke-linecap:round;stroke-linejoin:round}"
        f"{colours(LIGHT)}@media(prefers-color-scheme:dark){{{colours(DARK)}}}"
    )


class Drawing:
    """An SVG figure, drawn in pixels from the upper left corner."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self._lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
            f'height="{height}" role="img">',
            f"<title>{title}</title>",
            f"<style>{style()}</style>",
            f'<rect class="f-paper" width="{width}" height="{height}" rx="10"/>',
        ]

    def path(self, points: np.ndarray, colour: str, width: float, dash: str = "", closed: bool = False) -> None:
        """A polyline through points (n, 2)."""
        data = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + ("Z" if closed else "")
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._lines.append(f'<path class="line s-{colour}" stroke-width="{width:g}"{dashes} d="{data}"/>')

    def dot(self, at: np.ndarray, radius: float, fill: str, edge: str) -> None:
        """A circle with an edge."""
        self._lines.append(
            f'<circle class="f-{fill} s-{edge}" stroke-width="2" cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:g}"/>'
        )

    def box(self, at: np.ndarray, size: float, fill: str) -> None:
        """A square about a point."""
        x, y = at - size / 2.0
        self._lines.append(f'<rect class="f-{fill}" x="{x:.1f}" y="{y:.1f}" width="{size:g}" height="{size:g}"/>')

    def arrow(self, start: np.ndarray, end: np.ndarray, colour: str, width: float = 1.6, both: bool = False) -> None:
        """A line with a head at its end, or at both."""
        self.path(np.stack([start, end]), colour, width)
        for tip, tail in ((end, start), (start, end))[: 1 + both]:
            self.head(tip, tip - tail, colour)

    def head(self, tip: np.ndarray, direction: np.ndarray, colour: str) -> None:
        """The head of an arrow."""
        along = direction / np.linalg.norm(direction)
        across = np.array([-along[1], along[0]])
        corners = np.stack([tip, tip - 10.0 * along + 4.0 * across, tip - 10.0 * along - 4.0 * across])
        data = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in corners) + "Z"
        self._lines.append(f'<path class="f-{colour}" d="{data}"/>')

    def panel(self, x: float, y: float, width: float, height: float, colour: str, strength: float = 1.6) -> None:
        """A rounded frame."""
        self._lines.append(
            f'<rect class="line s-{colour}" stroke-width="{strength:g}" x="{x:g}" y="{y:g}" width="{width:g}" '
            f'height="{height:g}" rx="6"/>'
        )

    def words(self, x: float, y: float, text: str, kind: str = "plain", colour: str = "ink") -> None:
        """Text in letters of the page, from the left."""
        self._lines.append(f'<text class="{kind} f-{colour}" x="{x:g}" y="{y:g}">{text}</text>')

    def text(self, at: np.ndarray, text: str, colour: str = "ink", anchor: str = "middle", plain: bool = False) -> None:
        """Text; `_{...}` sets a subscript, `^{...}` a superscript."""

        def shifted(match: re.Match[str]) -> str:
            down = 5 if match[1] == "_" else -7
            return f'<tspan dy="{down}" font-size="70%">{match[2]}</tspan><tspan dy="{-down}">\u200b</tspan>'

        words = re.sub(r"([_^])\{([^}]*)\}", shifted, text)
        kind = "plain " if plain else ""
        self._lines.append(
            f'<text class="{kind}f-{colour}" x="{at[0]:.1f}" y="{at[1]:.1f}" text-anchor="{anchor}">{words}</text>'
        )

    def svg(self) -> str:
        """The finished file."""
        return "\n".join([*self._lines, "</svg>"]) + "\n"


def _arc(centre: np.ndarray, radius: float, angle: float) -> np.ndarray:
    """Points of an arc from the x axis to an angle (rad); y points down in pixels."""
    angles = np.linspace(0.0, angle, 40)
    return centre + radius * np.column_stack([np.cos(angles), -np.sin(angles)])


def _angle(
    drawing: Drawing, at: np.ndarray, angle: float, radius: float, colour: str, name: str, share: float = 0.5
) -> None:
    """An angle from the x axis, with its name outside the arc, at a share of the way along it."""
    drawing.path(np.stack([at, at + np.array([radius + 26.0, 0.0])]), "faint", 1.2, "4 4")
    arc = _arc(at, radius, angle)
    drawing.path(arc[:-3], colour, 1.6)
    drawing.head(arc[-1], arc[-1] - arc[-4], colour)
    outward = np.array([np.cos(share * angle), -np.sin(share * angle)])
    drawing.text(at + np.array([0.0, 6.0]) + (radius + 22.0) * outward, name, colour)


def _dimension(drawing: Drawing, start: np.ndarray, end: np.ndarray, name: str, away: float) -> None:
    """A length between two points, drawn `away` pixels beside them."""
    along = (end - start) / np.linalg.norm(end - start)
    across = away * np.array([along[1], -along[0]])
    for point in (start, end):
        drawing.path(np.stack([point + 0.25 * across, point + 1.15 * across]), "faint", 1.0)
    drawing.arrow(start + across, end + across, "faint", 1.2, both=True)
    drawing.text((start + end) / 2.0 + 1.45 * across + np.array([0.0, 6.0]), name)


def geometry() -> str:
    """The robot at its start, and one chain with its lengths and masses."""
    p = PLANT.unpack(PLANT.starts)
    scale, corner = 960.0, np.array([66.0, 520.0])

    def pixel(x: float, y: float) -> np.ndarray:
        return corner + scale * np.array([x, -y])

    drawing = Drawing(640, 900, "Geometry of the robot: three two-link chains that meet at the end effector")
    theta = inverse_kinematics(p.x_E_start, p.y_E_start, p.l, p.x_A, p.y_A)
    a, b = theta[:3], theta[3:]
    E = pixel(p.x_E_start, p.y_E_start)
    bases = [pixel(*A) for A in zip(p.x_A, p.y_A, strict=True)]
    elbows = [
        pixel(x + p.l * np.cos(angle), y + p.l * np.sin(angle)) for x, y, angle in zip(p.x_A, p.y_A, a, strict=True)
    ]
    origin = np.array([30.0, 560.0])
    for name, end, place in (("x", [60.0, 0.0], [74.0, 6.0]), ("y", [0.0, -60.0], [0.0, -68.0])):
        drawing.arrow(origin, origin + end, "ink")
        drawing.text(origin + place, name)
    for A, elbow in zip(bases, elbows, strict=True):
        drawing.path(np.stack([A, elbow]), "active", 9.0)
        drawing.path(np.stack([elbow, E]), "passive", 5.0)
    radii_a, radii_b = (44.0, 40.0, 40.0), (46.0, 40.0, 34.0)
    for i in range(3):
        _angle(drawing, bases[i], a[i], radii_a[i], "active", f"\u03b8_{{a{i + 1}}}")
        _angle(drawing, elbows[i], b[i], radii_b[i], "passive", f"\u03b8_{{b{i + 1}}}", share=0.25 if i == 2 else 0.5)
    for i, shift in enumerate(([-26.0, 6.0], [4.0, 34.0], [34.0, -14.0])):
        drawing.box(bases[i], 20.0, "ink")
        drawing.dot(elbows[i], 7.0, "paper", "ink")
        drawing.text(bases[i] + shift, f"A_{{{i + 1}}}")
    drawing.dot(E, 9.0, "accent", "ink")
    drawing.text(E + np.array([-12.0, 34.0]), "E (x_{E}, y_{E})", "accent", "end")
    _chain(drawing, p)
    return drawing.svg()


def _chain(drawing: Drawing, p: object) -> None:
    """One chain, stretched, with mass centres and the inertia constants (13)."""
    l, r_a, r_b = 240.0, 240.0 * p.r_a / p.l, 240.0 * p.Z / (p.m_b * p.l) / p.l  # type: ignore[attr-defined]
    A, right = np.array([80.0, 720.0]), np.array([1.0, 0.0])
    elbow, end = A + l * right, A + 2.0 * l * right
    drawing.path(np.array([[20.0, 610.0], [620.0, 610.0]]), "faint", 0.8)
    drawing.path(np.stack([A, elbow]), "active", 9.0)
    drawing.path(np.stack([elbow, end]), "passive", 5.0)
    _dimension(drawing, A, elbow, "l", -34.0)
    _dimension(drawing, elbow, end, "l", -34.0)
    for start, length, name, mass, colour in (
        (A, r_a, "r_{a}", "m_{a}, J_{a}", "active"),
        (elbow, r_b, "r_{b}", "m_{b}, J_{b}", "passive"),
    ):
        centre = start + length * right
        _dimension(drawing, start, centre, name, 34.0)
        drawing.dot(centre, 8.0, "paper", colour)
        drawing.dot(centre, 2.0, colour, colour)
        drawing.text(centre + np.array([34.0, -14.0]), mass, colour)
    drawing.box(A, 20.0, "ink")
    drawing.dot(elbow, 7.0, "paper", "ink")
    drawing.dot(end, 9.0, "accent", "ink")
    drawing.text(A + np.array([-34.0, 6.0]), "A_{i}")
    drawing.text(end + np.array([26.0, 6.0]), "E")
    for row, text in enumerate(
        (
            "X = J_{a} + m_{a} r_{a}^{2} + m_{b} l^{2}",
            "Y = J_{b} + m_{b} r_{b}^{2}",
            "Z = m_{b} l r_{b}",
        )
    ):
        drawing.text(np.array([80.0, 806.0 + 32.0 * row]), text, anchor="start")
    for row, (text, colour) in enumerate((("active link, driven at A_{i}", "active"), ("passive link", "passive"))):
        drawing.path(np.array([[350.0, 800.0 + 32.0 * row], [386.0, 800.0 + 32.0 * row]]), colour, 9.0 - 4.0 * row)
        drawing.text(np.array([400.0, 805.0 + 32.0 * row]), text, "ink", "start", plain=True)
    drawing.dot(np.array([368.0, 864.0]), 8.0, "paper", "ink")
    drawing.dot(np.array([368.0, 864.0]), 2.0, "ink", "ink")
    drawing.text(np.array([400.0, 869.0]), "mass centre", "ink", "start", plain=True)


def path() -> str:
    """The desired path with its parameters."""
    p = PATH.unpack(PATH.starts)
    scale, middle = 3600.0, np.array([320.0, 250.0])
    drawing = Drawing(640, 500, "The desired path and its parameters")

    def pixel(position: np.ndarray) -> np.ndarray:
        return middle + scale * (position - [p.x_c, p.y_c]) * [1.0, -1.0]

    curve = np.array([pixel(desired_path(t, PATH.starts)[0]) for t in np.linspace(0.0, 2.0 * np.pi / p.w, 361)])
    for radius in (p.a, p.a + p.R, p.a - p.R):
        circle = _arc(middle, scale * p.b * radius, 2.0 * np.pi)
        drawing.path(circle, "faint", 1.2, "5 5" if radius != p.a else "")
    drawing.path(curve, "active", 4.0, closed=True)
    for angle, radius, name, shift in (
        (54.0, p.a + p.R, "(a + R) b", [-58.0, -6.0]),
        (0.0, p.a, "a b", [10.0, -8.0]),
        (162.0, p.a - p.R, "(a \u2212 R) b", [16.0, -12.0]),
    ):
        arm = scale * p.b * radius * np.array([np.cos(np.radians(angle)), -np.sin(np.radians(angle))])
        drawing.arrow(middle, middle + arm, "ink", 1.4)
        drawing.text(middle + 0.55 * arm + shift, name)
    start = curve[0]
    drawing.dot(middle, 4.0, "ink", "ink")
    drawing.text(middle + np.array([-14.0, 32.0]), "(x_{c}, y_{c})", anchor="end")
    drawing.dot(start, 8.0, "accent", "ink")
    drawing.text(start + np.array([0.0, 30.0]), "t = 0", "accent")
    drawing.path(np.stack([middle, start]), "faint", 1.2, "4 4")
    arc = _arc(middle, 62.0, p.phase)
    drawing.path(arc[:-3], "accent", 1.6)
    drawing.head(arc[-1], arc[-1] - arc[-4], "accent")
    drawing.text(middle + np.array([72.0, 64.0]), "phase", "accent")
    drawing.head(curve[8], curve[8] - curve[5], "active")
    return drawing.svg()


#: Rooms of `cosim` from the highest to the lowest: names, and what each is about or more names.
ROOMS = (
    ("commands", "the program: run, sweep, compare, validate"),
    (
        "scenario \u00b7 ssp \u00b7 osp \u00b7 regression",
        "sweep \u00b7 analysis \u00b7 pack \u00b7 model_page \u00b7 live",
    ),
    ("master", "simulation, algorithm, run, recording"),
    ("results", "result objects, file formats, plots"),
    ("system", "components, connections, units, levels"),
    ("fmi", "FMU files and their instances"),
    ("loop \u00b7 page", "the compiled loop; frame of HTML pages"),
)


def architecture() -> str:
    """The packages and rooms, each above those that it imports, and where FMU files come from and go to."""
    drawing = Drawing(640, 700, "Packages and rooms of the project: each imports only what stands below it")
    drawing.panel(24, 24, 592, 62, "accent", 2.2)
    drawing.words(40, 49, "parallel_robot", "plain bold", "accent")
    drawing.words(40, 72, "the paper's system: wiring, scenarios, metrics, figures, the paper itself")
    drawing.panel(24, 116, 366, 560, "active", 2.2)
    drawing.words(40, 142, "cosim", "plain bold", "active")
    drawing.words(92, 142, "the master; it knows no robot")
    for row, (name, about) in enumerate(ROOMS):
        drawing.panel(40, 156 + 64 * row, 334, 54, "active", 1.2)
        names = "\u00b7" in about  # so many that they need both lines
        drawing.words(52, 179 + 64 * row, name, "plain bold small" if names else "plain bold")
        drawing.words(52, 199 + 64 * row, about, "plain bold small" if names else "plain small")
    drawing.words(40, 630, "errors, files, terminal, signing: below all", "plain small", "faint")
    drawing.words(40, 656, "Every room may import those beside and below it.", "plain small", "faint")
    drawing.panel(430, 116, 186, 92, "passive", 2.2)
    for row, name in enumerate(("plant_fmu", "controller_fmu", "trajectory_fmu")):
        drawing.words(446, 142 + 24 * row, name, "plain bold", "passive")
    drawing.panel(430, 240, 186, 300, "passive", 2.2)
    drawing.words(446, 266, "fmu_export", "plain bold", "passive")
    back_ends = ("back ends", "native, Python, wasm")
    rooms = (back_ends, ("package", "descriptions, archive"), ("trace", "numpy to equations"))
    for row, (name, about) in enumerate((*rooms, ("modelling", "Model, Layout"))):
        drawing.panel(444, 280 + 64 * row, 158, 54, "passive", 1.2)
        drawing.words(454, 303 + 64 * row, name, "plain bold")
        drawing.words(454, 323 + 64 * row, about, "plain small")
    drawing.panel(430, 590, 186, 62, "ink", 2.2)
    drawing.words(446, 616, "FMU files", "plain bold")
    drawing.words(446, 637, "ours or anybody's", "plain small")

    def arrow(*points: tuple[float, float], colour: str = "ink", dash: str = "") -> None:
        line = np.array(points)
        drawing.path(line, colour, 1.8, dash)
        drawing.head(line[-1], line[-1] - line[-2], colour)

    arrow((207, 86), (207, 114))
    arrow((523, 86), (523, 114))
    arrow((616, 162), (628, 162), (628, 499), (604, 499))
    arrow((374, 183), (410, 183), (410, 307), (428, 307), dash="5 4")
    arrow((523, 540), (523, 588), colour="passive")
    drawing.words(533, 570, "builds", "plain small", "passive")
    arrow((430, 620), (410, 620), (410, 503), (376, 503), colour="active")
    drawing.words(392, 640, "loads", "plain small", "active")
    return drawing.svg()


def procedure() -> str:
    """The seven steps of the paper's design procedure (Fig. 3), and the loop that they lead to."""
    drawing = Drawing(760, 620, "Steps 1 to 3 lead to the model, 4 and 5 to the control, 6 and 7 to its gains")
    width, height = 222, 70
    columns = {"active": (20, "Model"), "passive": (269, "Control"), "accent": (518, "Optimal gains")}
    for colour, (x, name) in columns.items():
        drawing.words(x, 34, name, "plain bold", colour)

    def step(colour: str, y: int, *lines: str) -> None:
        x = columns[colour][0]
        drawing.panel(x, y, width, height, colour)
        for row, line in enumerate(lines):
            drawing.words(x + 12, y + 22 + 20 * row, line, "plain bold" if row == 0 else "plain small")

    def arrow(*points: tuple[float, float], colour: str = "ink") -> None:
        line = np.array(points)
        drawing.path(line, colour, 1.8)
        drawing.head(line[-1], line[-1] - line[-2], colour)

    step("active", 50, "1  Open chains", "their masses and forces: (14)", "plant_fmu.dynamics")
    step("active", 150, "2  Constraint force", "Udwadia-Kalaba: (8)-(10)", "udwadia_kalaba(M, Q, A, b)")
    step("active", 250, "3  Complete model", "in all joints (20)", "in the active joints (27)")
    step("passive", 50, "4  Bound of uncertainty", "Π, k, adaptive law: (37)", "bound_angles, bound_constant")
    step("passive", 150, "5  Robust part", "τ₁ = −s Π²: (38)", "S gives s")
    step("passive", 250, "5  PD part", "τ₂ = −s: (38)", "S gives s")
    step("accent", 50, "6  Performance index", "J by D-operation: (78)-(81)", "PerformanceIndex")
    step("accent", 150, "7  Its parameters", "ρ₀ ... ρ₇: (81)", "V₀ and the fuzzy set")
    step("accent", 250, "7  Optimum", "∂J/∂α = ∂J/∂β = 0: (86)", "optimal_gains; cosim tune")
    for x in (131, 629):
        for y in (120, 220):
            arrow((x, y), (x, y + 28))
    arrow((380, 120), (380, 148))
    arrow((242, 275), (255, 275), (255, 85), (267, 85))
    arrow((491, 85), (516, 85))

    drawing.panel(269, 380, width, height, "passive", 2.2)
    drawing.words(281, 402, "Control input", "plain bold")
    drawing.words(281, 424, "τₐ = α τ₁ + β τ₂: (38)", "plain small")
    drawing.words(281, 443, "RobotController", "plain small")
    arrow((380, 320), (380, 378))
    arrow((491, 200), (505, 200), (505, 400), (493, 400))
    arrow((629, 320), (629, 425), (493, 425), colour="accent")
    drawing.words(525, 418, "α, β", "plain small", "accent")
    drawing.panel(20, 380, width, height, "active", 2.2)
    drawing.words(32, 402, "Robot", "plain bold")
    drawing.words(32, 424, "angles and their velocities", "plain small")
    drawing.words(32, 443, "RobotPlant", "plain small")
    arrow((131, 320), (131, 378))
    arrow((269, 415), (244, 415))
    drawing.panel(20, 500, width, height, "active", 2.2)
    drawing.words(32, 522, "Forward kinematics", "plain bold")
    drawing.words(32, 544, "and Jacobian: place and", "plain small")
    drawing.words(32, 563, "velocity of the end effector", "plain small")
    arrow((131, 450), (131, 498))
    drawing.panel(269, 500, width, height, "passive", 2.2)
    drawing.words(281, 522, "Desired motion", "plain bold")
    drawing.words(281, 544, "path (93) in joint angles", "plain small")
    drawing.words(281, 563, "RobotTrajectory", "plain small")
    arrow((380, 500), (380, 452))
    arrow((242, 440), (255, 440), (255, 475), (325, 475), (325, 452))
    drawing.words(
        20, 602, "Thick frames: the closed loop. Numbers in parentheses: equations of the paper.", "plain small"
    )
    return drawing.svg()


#: File -> what draws it.
FIGURES = {
    ROOT / "plant_fmu/geometry.svg": geometry,
    ROOT / "trajectory_fmu/path.svg": path,
    ROOT / "docs/architecture.svg": architecture,
    ROOT / "docs/procedure.svg": procedure,
}

if __name__ == "__main__":
    for file, draw in FIGURES.items():
        file.write_text(draw(), encoding="utf-8")
