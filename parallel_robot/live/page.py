"""The live page: controls, robot, plots and the map of J, around the closed loop as WebAssembly."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import cosim.scenario.signals
import parallel_robot.live.surroundings
from cosim.model_page.controls import control, in_unit
from cosim.model_page.page import model_scripts, model_styles, worker
from cosim.page.document import Section, assets, document
from fmu_export.wasm.backend import WasmModel, read_module, script
from parallel_robot.animation.player import SCRIPTS as ROBOT_SCRIPTS
from parallel_robot.animation.player import STYLES as ROBOT_STYLES
from parallel_robot.choices import SCENARIOS
from parallel_robot.fmus import build_live
from parallel_robot.live.presets import index_data, presets
from parallel_robot.live.surroundings import surroundings
from parallel_robot.models import closed_loop_model
from parallel_robot.scenario import RobotScenario, load_scenario

#: Communication step (s) and relative tolerance of the implicit method. A fifth of the step with a tolerance of 1e-8
#: changes root mean squares of the error by at most 2e-4 of themselves, for gains as stiff as k = 1e-4.
STEP_SIZE, TOLERANCE = 5e-3, 1e-4

#: Control -> label, limits that the model has not, and the variables that it sets: of the closed loop, of what acts on
#: it ("acts."), or of the page itself (none).
_CONTROLS: dict[str, tuple[str, tuple[float, float] | None, tuple[str, ...]]] = {
    "alpha": ("Robust gain α", (0.0, 5.0), ("controller.alpha",)),
    "beta": ("PD gain β", (0.1, 10.0), ("controller.beta",)),
    "S": ("Ratio S<sub>ii</sub>", (0.1, 10.0), tuple(f"controller.S[{i}]" for i in (1, 2, 3))),
    "k": ("Adaptation k", (1e-4, 200.0), ("controller.k",)),
    "mass_amplitude": ("Mass change, amplitude", (0.0, 0.8), ("acts.mass_amplitude",)),
    "rms": ("Disturbance torque, rms", (0.0, 0.1), ("acts.rms",)),
    "x_E_start": ("Start, x", (0.16, 0.29), ("plant.x_E_start",)),
    "y_E_start": ("Start, y", (0.25, 0.43), ("plant.y_E_start",)),
    "n": ("Lobes of the path", (0.0, 12.0), ("trajectory.n",)),
    "R": ("Depth of the lobes", (0.0, 1.5), ("trajectory.R",)),
    "b": ("Scale of the path", (0.004, 0.03), ("trajectory.b",)),
    "w": ("Speed on the path", (0.2, 3.0), ("trajectory.w",)),
    "feedforward": ("Share of the nominal feedforward", (0.0, 1.0), ("controller.feedforward",)),
    "leakage": ("Leakage of the adaptation", (0.0, 1.0), ("controller.leakage",)),
    "bound_angles": ("Bound: factor of |θ<sub>a</sub>|²", (0.0, 1.0), ("controller.bound_angles",)),
    "bound_constant": ("Bound: constant", (0.0, 10.0), ("controller.bound_constant",)),
    "psi_start": ("ψ at the start", (0.0, 1.0), ("controller.psi_start[1]", "controller.psi_start[2]")),
    "tau_max": ("Largest torque of a motor", None, tuple(f"controller.tau_max[{i}]" for i in (1, 2, 3))),
    "mass_frequency": ("Mass change, frequency", (0.05, 3.0), ("acts.mass_frequency",)),
    "at_rest": ("The changing mass arrives at rest", None, ("acts.at_rest",)),
    "onset": ("Disturbance torque, from", (0.0, 15.0), ("acts.onset",)),
    "v_x_start": ("Velocity at the start, x", (-0.3, 0.3), ("plant.v_x_start",)),
    "v_y_start": ("Velocity at the start, y", (-0.3, 0.3), ("plant.v_y_start",)),
    "x_c": ("Centre of the path, x", (0.16, 0.29), ("trajectory.x_c",)),
    "y_c": ("Centre of the path, y", (0.27, 0.43), ("trajectory.y_c",)),
    "phase": ("Phase of the path", (-3.1416, 3.1416), ("trajectory.phase",)),
}

#: Heading -> controls; those of `_CLOSED` are closed at first.
_GROUPS = {
    "Gains": ("alpha", "beta", "S", "k"),
    "What acts on the robot": ("mass_amplitude", "rms"),
    "Start": ("x_E_start", "y_E_start"),
    "Path": ("n", "R", "b", "w"),
}
_CLOSED = {
    "More of the law": ("feedforward", "leakage", "bound_angles", "bound_constant", "psi_start", "tau_max"),
    "More of what acts": ("mass_frequency", "at_rest", "onset"),
    "More of start and path": ("v_x_start", "v_y_start", "x_c", "y_c", "phase"),
}

_STOP = {"name": "stop_time", "type": "integer", "unit": "s", "start": 15, "min": 5, "max": 60}

#: View [left, bottom, right, top] (m) of the whole robot and of the path, and the torque (N m) of usual size.
_VIEWS = {"whole": [-0.08, -0.08, 0.51, 0.58], "path": [0.14, 0.27, 0.31, 0.44]}
_TORQUE = 0.3


def modules(folder: Path, scenario: RobotScenario) -> tuple[WasmModel, WasmModel]:
    """The closed loop by an implicit method, and what acts on it; built in a folder of FMUs unless they are there.

    Raises
    ------
    BuildError
        As `build_live`.
    """
    loop = replace(closed_loop_model(), solver="rodas4")
    sources = (parallel_robot.live.surroundings, cosim.scenario.signals)
    files = [Path(str(module.__file__)) for module in sources]
    acting = build_live(folder, surroundings(scenario), *files, *sorted(SCENARIOS.glob("*.toml")))
    return read_module(build_live(folder, loop)), read_module(acting)


def live_section(folder: Path) -> Section:
    """The controls, the robot, plots and the map of J, as a section of a page that may use WebAssembly.

    The script that draws the robot looks for its views in `DATA.robot`, which the page has.

    Parameters
    ----------
    folder : Path
        Of the FMUs, where the modules are built.

    Raises
    ------
    BuildError
        The ziglang package is not installed, or the folder can't be written.
    """
    scenario = load_scenario("tracking")
    loop, acting = modules(folder, scenario)
    variables = {v["name"]: v for v in loop.description["variables"]}
    variables |= {f"acts.{v['name']}": v for v in acting.description["variables"]}
    chosen = presets()
    data = {
        "loop": _needed(loop.description),
        "acting": _needed(acting.description),
        "worker": worker(script(exports=False), *assets(("worker.js",), __package__)),
        "targets": {name: targets for name, (_, _, targets) in _CONTROLS.items()},
        "presets": {label: values for group in chosen.values() for label, values in group.items()},
        "index": index_data(),
        "step": STEP_SIZE,
        "tolerance": TOLERANCE,
        "steadyAfter": scenario.steady_after,
        "robot": {
            "l": variables["plant.l"]["start"],
            **{name: [variables[f"plant.{name}[{i}]"]["start"] for i in (1, 2, 3)] for name in ("x_A", "y_A")},
        },
    }
    return Section(
        "live",
        "Turn the gains",
        _html(variables, chosen),
        [*model_styles(), *ROBOT_STYLES, *assets(("live.css",), __package__)],
        [*model_scripts(), ROBOT_SCRIPTS[0], *assets(("index_map.js", "live.js"), __package__)],
        {"live": data},
        {"loop-module": zlib.compress(loop.code, 9), "acting-module": zlib.compress(acting.code, 9)},
    )


def live_page(folder: Path) -> str:
    """The page as HTML, which loads nothing; `folder` as for `live_section`.

    Raises
    ------
    BuildError
        As `live_section`.
    """
    header = """<p class="over">closed-chain-cosim</p>
<h1>Turn the gains, and the robot answers</h1>
<p class="lead">The closed loop of Han et al. 2021, computed by the code of its FMU in your browser.</p>"""
    return document(
        "Turn the gains",
        header,
        [live_section(folder)],
        data={"robot": {"runs": [], "views": _VIEWS, "force": 1.0, "torque": _TORQUE}},
        webassembly=True,
    )


def _needed(description: Mapping[str, Any]) -> dict[str, Any]:
    """What a worker has to know of a module: no texts for people."""
    known = ("name", "causality", "start", "items")
    variables = [{k: v[k] for k in known if k in v} for v in description["variables"]]
    return {k: description[k] for k in ("name", "experiment", "tables")} | {"variables": variables}


def _control(name: str, variables: Mapping[str, Any]) -> str:
    label, limits, targets = _CONTROLS[name]
    own = dict(variables[targets[0]]) | {"name": name}
    own |= dict(zip(("min", "max"), limits, strict=True)) if limits else {}
    if name == "n":
        own["type"] = "integer"
    return control(own, label + in_unit(own.get("unit", "1")))


def _html(variables: Mapping[str, Any], chosen: Mapping[str, Mapping[str, Any]]) -> str:
    def controls(names: Iterable[str]) -> str:
        return "".join(_control(name, variables) for name in names)

    open_groups = "".join(f"<h3>{title}</h3>{controls(names)}" for title, names in _GROUPS.items())
    closed = "".join(
        f"<details><summary>{title}</summary>{controls(names)}</details>" for title, names in _CLOSED.items()
    )
    stop = control(_STOP, "Duration (s)")
    first = next(iter(next(iter(chosen.values()))))
    options = "".join(
        f'<optgroup label="{escape(heading)}">'
        + "".join(
            f'<option value="{escape(label)}"{" selected" if label == first else ""}>{escape(label)}</option>'
            for label in group
        )
        + "</optgroup>"
        for heading, group in chosen.items()
    )
    index = index_data()
    rows = "".join(f'<option value="{row}">μ, ν = {row}</option>' for row in index["rows"])
    return f"""<div class="live">
<div class="settings" tabindex="0" role="region" aria-label="Settings">
<div class="top"><label for="preset">Preset</label>
<select id="preset" class="preset"><option value="">own settings</option>{options}</select>
<button type="button" class="fold">All settings</button></div>
{open_groups}{closed}
<details><summary>The run</summary>{stop}<p class="hint">By RODAS, an implicit method, with a relative tolerance of
{TOLERANCE:g} and communication points each {1000 * STEP_SIZE:g} ms. The torque is renewed all the time, also under
readings that renew it at other intervals.</p></details>
<p class="buttons"><button type="button" class="reset">Start values</button></p>
</div>
<div class="view">
<canvas class="robot" role="img" aria-label="The robot on its path; the wide pale line is the desired path"></canvas>
<div class="readings">
<p><b class="rms">–</b> mm<small>error, rms after {{steady}}</small></p>
<p><b class="peak">–</b> mm<small>largest after {{steady}}</small></p>
<p><b class="effort">–</b> N m<small>torque, rms</small></p>
<p class="of-kept" hidden><b class="kept"></b> mm<small>the same, of what is kept</small></p>
</div>
<div class="moment-row"><button type="button" class="play">Pause</button>
<input type="range" class="time" min="0" max="15" step="any" value="0" aria-label="Time"></div>
<p class="buttons"><button type="button" class="keep">Keep to compare</button>
<button type="button" class="drop" hidden>Drop what is kept</button></p>
<p class="state hint">loading</p>
<p class="trouble bad" role="alert" hidden></p>
<p class="spoken unseen" role="status"></p>
</div>
<div class="index">
<h3>Performance index J of α and β</h3>
<div class="weights"><label for="weights">Weights of Table 1</label> <select id="weights">{rows}</select>
<button type="button" class="optimum">Take the optimum</button></div>
<canvas class="map" role="img" aria-label="Map of J over alpha and beta; cross: optimum, ring: present gains"></canvas>
<p class="hint">A click takes the gains of a place, as the sliders do. The more colour, the larger is J: each line
doubles J − J<sub>min</sub>. The cross is the optimum, the ring the present gains. J is that of the printed
k = {index["k"]:g} and S<sub>ii</sub> = 2.</p>
<p class="J">J = <b>–</b>, at the optimum <b>–</b></p>
</div>
<div class="plots">
<div class="panel"><h3>Distance from the desired position (mm)</h3><div class="error-plot"></div></div>
<div class="panel"><h3>Torques of the motors (N m)</h3><div class="torque-plot"></div></div>
<div class="panel"><h3>Estimated bound ψ of the uncertainty (1)</h3><div class="psi-plot"></div></div>
</div>
</div>""".replace("{steady}", "8 s")
