"""The page as a whole: its sections, and how it was made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from cosim.page.document import PLOT_SCRIPTS, PLOT_STYLES, Section, assets, document
from parallel_robot.animation.player import SCRIPTS, STYLES, player_data, player_html
from parallel_robot.paper.report.claims import (
    VERDICTS,
    claims_section,
    errata_section,
    readings_section,
    table1_section,
    theorem_section,
)
from parallel_robot.paper.report.errors import errors_section
from parallel_robot.paper.report.pictures import Picture
from parallel_robot.paper.report.prose import table
from parallel_robot.paper.report.robustness import robustness_section
from parallel_robot.paper.report.series import CONDITION_NAMES, Series, all_series, controller_names
from parallel_robot.paper.reproduce.content import CONDITIONS, Claim, PaperFigure, Reproduction, Runs
from parallel_robot.paper.robustness.content import Robustness

_DOI = "10.1007/s11071-021-06739-y"

#: A vector figure larger than this goes in as PNG, which phones draw faster (bytes).
_LARGEST_SVG = 600_000

#: Settings of the runs in words, with their units.
_WORDS = {
    "flavour": "flavour of the FMUs",
    "step_size": "communication step (s)",
    "stop_time": "duration (s)",
    "order": "order of the exchange",
    "extrapolation": "inputs between communication points",
    "adaptive": "inputs by cubics where these predict them better than lines",
    "linear": "inputs by lines",
    "hold": "inputs held",
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


def page(content: Reproduction, study: tuple[Robustness, Path] | None = None, live: Section | None = None) -> str:
    """The report as HTML; with the robustness study and its folder, and the section of gains to turn, if there are any.

    Raises
    ------
    OSError
        A figure can't be read.
    """
    runs = content.runs
    series = all_series(runs)
    sections = [
        _animation_section(series),
        *(() if live is None else (live,)),
        claims_section(content.claims),
        errors_section(series, runs),
        _figures_section(content.figures),
        table1_section(content.table1),
        theorem_section(content.theorem1, runs),
        *(() if study is None else (robustness_section(*study),)),
        readings_section(runs.readings),
        errata_section(content.errata),
        _made_section(runs, content.versions),
    ]
    styles = [*assets(PLOT_STYLES), *STYLES, *assets(("report.css",), __package__)]
    scripts = [*assets(PLOT_SCRIPTS), *SCRIPTS, *assets(("errors.js", "claims.js", "figures.js"), __package__)]
    return document(
        "The paper, reproduced",
        _header(content),
        sections,
        styles=styles,
        scripts=scripts,
        webassembly=live is not None,
    )


def _header(content: Reproduction) -> str:
    runs = content.runs
    further = (runs.pd_same_beta, runs.pd_same_effort, runs.disturbed, runs.readings, runs.least_bound)
    n_runs = len(runs.closed_loop) + len(runs.accumulated) + sum(map(len, further)) + 1
    return f"""<p class="over">closed-chain-cosim {escape(content.versions.get("closed-chain-cosim", ""))}</p>
<h1>The paper, reproduced</h1>
<p class="lead">Han et al. 2021 (<a href="https://doi.org/{_DOI}">doi</a>), computed again from {n_runs} co-simulation
runs of three FMUs: {_in_numbers(content.claims)}.</p>"""


def _in_numbers(claims: Sequence[Claim]) -> str:
    """How many claims have which verdict, in words."""
    counts = Counter(c.verdict for c in claims)
    return f"of {len(claims)} claims " + ", ".join(
        f"{counts[v]} {v.replace('holds', 'hold') if counts[v] != 1 else v}" for v in VERDICTS if counts[v]
    ).replace("does not hold", "do not hold")


def _animation_section(series: Sequence[Series]) -> Section:
    """Two runs side by side."""
    same = [s.key for s in series if s.condition == series[0].condition]
    # the first controller (PD) against the last (the largest mu/nu), where most acts on the robot
    chosen = same[0], same[-1]
    groups = {
        f"With {CONDITION_NAMES[condition]}": [s for s in series if s.condition == condition]
        for condition in CONDITIONS
    }
    groups[""] = [s for s in series if s.condition is None]
    data, blocks = player_data(series)
    html = f"""{player_html(series, chosen, {name: runs for name, runs in groups.items() if runs})}
<p class="hint">Two runs on one clock. Each coloured chain is an active link, driven at its base A<sub>i</sub>, and a
passive link; all three meet at the end effector. Arrows there are the forces by which the closure holds the end of each
chain, from F<sub>c</sub> of equation (19): they add up to zero.</p>"""
    return Section("animation", "The robot in motion", html, data={"robot": data}, blocks=blocks)


def _figures_section(figures: Sequence[PaperFigure]) -> Section:
    pictures = [Picture(f"figure-{f.number}", f.title, f.caption, f.alt, _content(f)) for f in figures]
    numbers = [f.number for f in figures]
    html = f"""<p class="hint">The figures of the paper, from our runs.</p>
<div class="figures">
{"".join(p.html(f"figure {n}", f"Fig. {n}: ") for p, n in zip(pictures, numbers, strict=True))}</div>
<dialog class="large" aria-label="Figure, enlarged"><form method="dialog"><button>Close</button></form><img alt="">
<p></p></dialog>"""
    return Section("figures", "Figures", html, blocks={f"{p.id}-data": p.deflated for p in pictures})


def _content(figure: PaperFigure) -> bytes:
    svg = figure.svg.read_bytes()
    return svg if len(svg) <= _LARGEST_SVG else figure.png.read_bytes()


def _made_section(runs: Runs, versions: Mapping[str, str]) -> Section:
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
    html = f"""<p>The paper: Han, Wang, Dong, Zhao, Chen: <cite>Optimal design oriented adaptive robust control for a
planar 2-DOF redundantly actuated parallel robot</cite>, Nonlinear Dynamics 2021, doi {_DOI}. The page is made by
<code>cosim reproduce</code>, which makes it again byte for byte on the same machine; no date is in it for that reason.
Data of plots and animation: a row each 0.01 s, 32-bit floats.</p>
<div class="columns">
<div><h3>Runs</h3>{table(("setting", "value"), settings, "Settings of the runs")}</div>
<div><h3>Controllers</h3>{table(controller_heads, controllers, "Gains of the controllers")}</div>
<div><h3>FMU files</h3>{table(("file", "SHA-256"), hashes, "FMU files and their hashes", "hashes")}</div>
<div><h3>Software</h3>{table(("package", "version"), software, "Versions of the software")}</div>
</div>"""
    return Section("made", "How it was made", html)


def _text(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{_WORDS.get(k, k)}: {_text(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value)) or "none" if len(value) < 5 else str(len(value))
    return f"{value:g}" if isinstance(value, float) else str(value)
