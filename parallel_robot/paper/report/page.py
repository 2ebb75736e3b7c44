"""The page as a whole: head, sections, styles, scripts and data in one file."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from functools import cache
from hashlib import sha256
from html import escape
from importlib.resources import files
from pathlib import Path

from parallel_robot.paper.report.animation import animation_data, animation_section
from parallel_robot.paper.report.claims import (
    claims_section,
    errata_section,
    readings_section,
    scoreboard,
    table1_section,
    theorem_section,
)
from parallel_robot.paper.report.curves import curves_data, curves_section
from parallel_robot.paper.report.prose import prose, table
from parallel_robot.paper.report.robustness import robustness_section
from parallel_robot.paper.report.series import all_series, controller_names
from parallel_robot.paper.reproduce.content import PaperFigure, Reproduction, Runs
from parallel_robot.paper.robustness.content import Robustness

_DOI = "10.1007/s11071-021-06739-y"

_SCRIPTS = ("data.js", "robot.js", "player.js", "curves.js", "claims.js")

#: A vector figure larger than this goes in as PNG, which phones draw faster (bytes).
_LARGEST_SVG = 600_000

#: Settings of the runs in words, with their units.
_WORDS = {
    "flavour": "flavour of the FMUs",
    "step_size": "communication step (s)",
    "stop_time": "duration (s)",
    "order": "order of the exchange",
    "linear": "inputs linear between communication points",
    "held": "inputs held",
    "disturbance": "disturbance torque, a random-phase multisine",
    "mass_change": "mass change, a sine",
    "rms": "rms (N m)",
    "lowest": "lowest frequency (Hz)",
    "highest": "highest (Hz)",
    "components": "sines",
    "start_time": "from (s)",
    "amplitude": "amplitude (kg)",
    "frequency": "frequency (Hz)",
    "phase": "phase (rad)",
}


@cache
def _asset(name: str) -> str:
    return (files(__package__) / "assets" / name).read_text(encoding="utf-8")


def page(content: Reproduction, study: tuple[Robustness, Path] | None = None) -> str:
    """The report as HTML; with the robustness study and its folder, if there is one.

    Its security policy lets it load nothing from anywhere, and run the scripts of this package only.

    Raises
    ------
    OSError
        A figure can't be read.
    """
    runs = content.runs
    series = all_series(runs)
    names = controller_names(runs)
    data = {**animation_data(series), **curves_data(runs.controllers), "runs": [s.as_json() for s in series]}
    script = "\n".join(map(_asset, _SCRIPTS))
    policy = "; ".join(
        (
            "default-src 'none'",
            "img-src data:",
            "style-src 'unsafe-inline'",
            f"script-src 'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'",
        )
    )
    sections = "\n".join(
        (
            animation_section(series, names),
            claims_section(content.claims),
            curves_section(series, runs),
            _figures_section(content.figures),
            table1_section(content.table1),
            theorem_section(content.theorem1, runs),
            *(() if study is None else (robustness_section(*study),)),
            readings_section(runs.readings),
            errata_section(content.errata),
            _made_section(runs, content.versions),
        )
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>The paper, reproduced</title>
<style>
{_asset("report.css")}</style>
</head>
<body>
<a class="skip" href="#main">Skip to the content</a>
{_header(content, with_study=study is not None)}
<main id="main">
<noscript><p>Animation, plots and filters need JavaScript; claims, figures and tables do not.</p></noscript>
{sections}
</main>
<dialog class="large" aria-label="Figure, enlarged"><form method="dialog"><button>Close</button></form><img alt="">
<p></p></dialog>
<script type="application/json" id="data">{_json(data)}</script>
<script>{script}</script>
</body>
</html>
"""


def _json(data: object) -> str:
    # "</" would end the script element
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("</", "<\\/")


def _header(content: Reproduction, *, with_study: bool) -> str:
    runs = content.runs
    links = "".join(
        f'<a href="#{target}">{text}</a>'
        for target, text in (
            ("animation", "Animation"),
            ("claims", "Claims"),
            ("errors", "Errors"),
            ("figures", "Figures"),
            ("table1", "Table 1"),
            ("theorem1", "Theorem 1"),
            *([("robustness", "Robustness")] if with_study else []),
            ("readings", "Assumptions"),
            ("errata", "Errata"),
            ("made", "How it was made"),
        )
    )
    n_runs = len(runs.closed_loop) + len(runs.accumulated) + len(runs.pd_same_beta) + len(runs.readings) + 1
    return f"""<header>
<p class="over">closed-chain-cosim {escape(content.versions.get("closed-chain-cosim", ""))}</p>
<h1>The paper, reproduced</h1>
<p class="lead">Han, Wang, Dong, Zhao, Chen: <cite>Optimal design oriented adaptive robust control for a planar 2-DOF
redundantly actuated parallel robot</cite>, Nonlinear Dynamics 2021
(<a href="https://doi.org/{_DOI}">doi {_DOI}</a>). Everything it computed, computed again from {n_runs} co-simulation
runs of three FMUs, and every claim judged.</p>
{scoreboard(content.claims)}
<nav aria-label="Sections">{links}</nav>
</header>"""


def _figures_section(figures: Sequence[PaperFigure]) -> str:
    return f"""<section id="figures" aria-labelledby="figures-title">
<h2 id="figures-title">The figures of the paper, from our runs</h2>
<div class="figures">
{"".join(map(_figure, figures))}</div>
</section>"""


def _figure(figure: PaperFigure) -> str:
    # as an image and not inline: the names inside two SVGs of matplotlib clash
    data, kind = figure.svg.read_bytes(), "image/svg+xml"
    if len(data) > _LARGEST_SVG:
        data, kind = figure.png.read_bytes(), "image/png"
    return f"""<figure id="figure-{figure.number}">
<button type="button" class="enlarge" aria-label="Enlarge figure {figure.number}">
<img src="data:{kind};base64,{b64encode(data).decode()}" alt="{escape(figure.alt)}" decoding="async"></button>
<figcaption><b>Fig. {figure.number}: {prose(figure.title)}.</b> {prose(figure.caption)}</figcaption>
</figure>
"""


def _made_section(runs: Runs, versions: Mapping[str, str]) -> str:
    """Settings, FMUs and versions; nothing that differs from time to time."""
    settings = [(escape(_WORDS.get(k, k)), escape(_text(v))) for k, v in runs.info.items()]
    fmus: dict[str, str] = {}
    for results in (*runs.closed_loop.values(), runs.open_loop):
        for fmu in results.info["fmus"].values():
            fmus[Path(fmu["path"]).name] = fmu["sha256"]
    hashes = [(f"<code>{escape(name)}</code>", f"<code>{digest}</code>") for name, digest in sorted(fmus.items())]
    software = [(escape(name), escape(version)) for name, version in versions.items()]
    controllers = [
        (escape(name), f"{c.mu:g}, {c.nu:g}", f"{c.alpha:.6g}", f"{c.beta:.6g}")
        for name, c in zip(controller_names(runs), runs.controllers, strict=True)
    ]
    controller_heads = ("controller", "μ, ν", "α", "β (N m s/rad)")
    return f"""<section id="made" aria-labelledby="made-title">
<h2 id="made-title">How it was made</h2>
<p>By <code>cosim reproduce</code>, which makes this page again byte for byte on the same machine.
No date is in it for that reason. Data of plots and animation: a row each 0.01 s, 32-bit floats.</p>
<div class="columns">
<div><h3>Runs</h3>{table(("setting", "value"), settings, "Settings of the runs")}</div>
<div><h3>Controllers</h3>{table(controller_heads, controllers, "Gains of the controllers")}</div>
<div><h3>FMU files</h3>{table(("file", "SHA-256"), hashes, "FMU files and their hashes", "hashes")}</div>
<div><h3>Software</h3>{table(("package", "version"), software, "Versions of the software")}</div>
</div>
</section>"""


def _text(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{_WORDS.get(k, k)}: {_text(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value)) or "none" if len(value) < 5 else str(len(value))
    return f"{value:g}" if isinstance(value, float) else str(value)
