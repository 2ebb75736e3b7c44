"""The page of a model: controls of its parameters and inputs, and plots of its outputs, computed in the browser."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from html import escape
from math import prod
from typing import Any

from cosim.model_page.controls import control, has_slider, in_unit, shown_unit
from cosim.page.document import PLOT_SCRIPTS, PLOT_STYLES, Section, asset, assets, document

#: Numerics that the exporter adds to models with states.
_NUMERICS = ("max_step", "rtol")

#: More controls without limits than this are closed at first.
_MANY = 12

_PACKAGE = "cosim.model_page"

#: Scripts of pages that run models, after those of plots.
SCRIPTS = ("engine.js", "controls.js")


def worker(script: str, *own: str) -> str:
    """Text of a worker.

    Parameters
    ----------
    script : str
        The JavaScript that loads modules, as a plain script.
    own : str
        What it computes: a call of `serve`.
    """
    return "\n".join([script, asset("serve.js", _PACKAGE), *own])


def model_styles() -> list[str]:
    """Styles of pages that run models."""
    return [*assets(PLOT_STYLES), asset("model_page.css", _PACKAGE)]


def model_scripts() -> list[str]:
    """Scripts of pages that run models."""
    return [*assets(PLOT_SCRIPTS), *assets(SCRIPTS, _PACKAGE)]


def model_page(code: bytes, description: Mapping[str, Any], script: str) -> str:
    """The page of a model as HTML, which loads nothing.

    Parameters
    ----------
    code : bytes
        Its WebAssembly module.
    description : mapping
        What the module is: name, description, variables, declared, experiment, tables.
    script : str
        The JavaScript that loads modules, as a plain script.
    """
    panels = _panels(description)
    shown = "".join(
        f'<div class="panel" data-panel="{i}"><h3>{escape(panel["title"])}'
        f"{in_unit(panel['unit'])}<small> {escape(panel['about'])}</small></h3>"
        '<div class="drawn"></div></div>'
        for i, panel in enumerate(panels)
    )
    html = f"""<div class="model">
<div class="settings" tabindex="0" role="region" aria-label="Settings">
<div class="top"><p class="hint">Change a value, and all is computed again.</p>
<button type="button" class="fold">All settings</button></div>
{_settings(description)}
<p class="buttons"><button type="button" class="reset">Start values</button></p>
</div>
<div>
<p class="trouble bad" role="alert" hidden></p>
<p class="state">loading</p>
<p class="spoken unseen" role="status"></p>
<div class="panels">{shown}</div>
</div>
</div>"""
    about = description["description"]
    header = f"""<p class="over">{escape(description["tool"])}</p>
<h1>{escape(description["name"])}</h1>
{f"<p>{escape(about)}</p>" if about else ""}"""
    own = worker(script, asset("simulate.js", _PACKAGE))
    return document(
        description["name"],
        header,
        [Section("simulation", "Simulation", html)],
        styles=model_styles(),
        scripts=[*model_scripts(), asset("model_page.js", _PACKAGE)],
        data={"model": {"description": description, "worker": own, "panels": panels}},
        blocks={"module": zlib.compress(code, 9)},
        webassembly=True,
    )


def _panels(description: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A plot for each output and each local, as the model declares them."""
    variables = description["variables"]
    panels = []
    for declared in description["declared"]:
        first = declared["reference"]
        elements = variables[first : first + prod(declared["shape"])]
        if elements and elements[0]["causality"] in ("output", "local"):
            name = declared["name"]
            panels.append(
                {
                    "title": name,
                    "unit": "" if elements[0]["unit"] == "1" else shown_unit(elements[0]["unit"]),
                    "about": declared["description"],
                    "names": [v["name"] for v in elements],
                    "labels": [v["name"].removeprefix(name) or name for v in elements],
                }
            )
    return panels


def _settings(description: Mapping[str, Any]) -> str:
    """Sliders first, then inputs and parameters without limits, then what is numerics."""
    given = [v for v in description["variables"] if v["causality"] in ("parameter", "input")]
    numerics = [v for v in given if v["name"] in _NUMERICS and v["causality"] == "parameter"]
    others = [v for v in given if v not in numerics]
    sliders = [v for v in others if has_slider(v) or v["type"] in ("boolean", "enumeration", "string")]
    fields = [v for v in others if v not in sliders]
    experiment = description["experiment"]
    times = [
        {"name": name, "unit": "s", "start": experiment[name], "description": about}
        for name, about in (("stopTime", "End"), ("stepSize", "Communication step"), ("startTime", "Begin"))
    ]
    run = "".join(control(t, about=f"{t['description']} (s)") for t in times) + "".join(map(control, numerics))
    parts = []
    if sliders:
        parts.append("<h3>Values</h3>" + "".join(map(control, sliders)))
    if fields:
        is_open = " open" if not sliders or len(fields) <= _MANY else ""
        title = "Values without both limits" if sliders else "Values"
        parts.append(f"<details{is_open}><summary>{title}</summary>{''.join(map(control, fields))}</details>")
    if inputs := [v["name"] for v in given if v["causality"] == "input"]:
        parts.append(f'<p class="hint">Inputs stay as they are during a run: {escape(", ".join(inputs))}.</p>')
    return "\n".join([*parts, f"<details><summary>The run</summary>{run}</details>"])
