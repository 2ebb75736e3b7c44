"""What an FMU says about itself: a page, a reference result, the licence, icons and terminals."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources.abc import Traversable

import numpy as np

from fmu_export.errors import DocumentationError, needs
from fmu_export.modelling.functions import rk4_step
from fmu_export.modelling.hybrid import HybridRun
from fmu_export.modelling.model import Model
from fmu_export.modelling.variables import Array, Layout
from fmu_export.package.description_common import DISTRIBUTION, package_version
from fmu_export.package.evaluation import Functions, functions_of
from fmu_export.package.icon import model_icon, terminal_icons
from fmu_export.package.interface import Interface, ScalarVariable, text_of
from fmu_export.package.metadata import NO_METADATA, Metadata
from fmu_export.package.plot import curves

with needs("export"):
    import casadi as ca
    from latex2mathml.converter import convert as mathml
    from markdown import Markdown
    from markdown.extensions.toc import TocExtension
    from markdown.inlinepatterns import InlineProcessor

_FROM_SOURCES = " from the C sources in <code>sources/</code>"

#: What each flavour is and what it needs to run.
_FLAVOURS = {
    "pythonfmu": "FMI 2.0 co-simulation, for Linux and Windows (x86-64). Runs Python inside: the importing process "
    "needs a Python of the version that the binary is linked with, but no package.",
    "fmi2": f"FMI 2.0 co-simulation and model exchange, compiled{_FROM_SOURCES} for the "
    "platforms in <code>binaries/</code>. Needs nothing else.",
    "fmi3": f"FMI 3.0 co-simulation and model exchange, compiled{_FROM_SOURCES} for the "
    "platforms in <code>binaries/</code>. Needs nothing else.",
}

#: The reference run: rows (s), duration (s), integration steps a row; its error is below 1e-9.
_ROW, _DURATION, _SUBSTEPS = 0.01, 2.0, 2
#: Input i = 1, 2, ... swings by this much (in its unit) at 0.4 + 0.1 i (Hz) about its start value.
_AMPLITUDE = 0.05


@dataclass(frozen=True, eq=False)
class ReferenceRun:
    """A run of a model alone from its start values: a row for each communication point.

    The inputs of a row are held until the next one. The outputs of a row are those that the step to it ends with, so
    they still see the inputs of the row before; that is when co-simulation masters such as fmpy read them.
    """

    time: Array
    inputs: Array
    outputs: Array


def documentation_members(
    model: Model,
    interface: Interface,
    page: str,
    flavour: str,
    figures: Mapping[str, bytes] | None = None,
    metadata: Metadata = NO_METADATA,
    sources: bool = True,
    unchecked: bool = False,
) -> dict[str, bytes]:
    """Members of the archive that explain it; the same arguments give the same bytes.

    Parameters
    ----------
    model, interface : Model, Interface
        The model and its flat variables.
    page : str
        Markdown: equations (`$...$` and `$$...$$` in LaTeX, which become MathML), symbols, background. HTML in it is
        shown, not interpreted.
    flavour : {"pythonfmu", "fmi2", "fmi3"}
        What the archive is; decides where the standard wants the icon.
    figures : mapping of str to bytes, optional
        The pictures that the page shows, by file name; `figures_of` reads them.
    metadata : Metadata, optional
        Who made the model and under which terms.
    sources : bool, optional
        Whether the archive has the sources.
    unchecked : bool, optional
        Whether the traced equations were not compared with what numpy computes.

    Raises
    ------
    DocumentationError
        A figure is missing, an equation can't be typeset, or the reference run is not finite.
    """
    figures = figures or {}
    for name in _shown_figures(page):
        if name not in figures:
            raise DocumentationError(f"{model.name}: the page shows {name}, which is not among its figures")
    run = reference_run(model, unchecked)
    reference = f"documentation/reference/{model.name}"
    icons = (
        terminal_icons(model, with_terminals=not interface.arrays)
        if flavour == "fmi3"
        else {"model.png": model_icon(model)}
    )
    return {
        "documentation/index.html": _html(model, interface, page, run, _stamp(flavour, metadata, sources)).encode(),
        f"{reference}_in.csv": _csv(model.inputs, run.time, run.inputs),
        f"{reference}_ref.csv": _csv(model.outputs, run.time, run.outputs),
        **{f"documentation/{name}": data for name, data in figures.items()},
        **icons,
    }


def figures_of(page: str, folder: Traversable) -> dict[str, bytes]:
    """The pictures that a page in Markdown shows, by file name, from the folder of the page.

    Raises
    ------
    OSError
        One of them can't be read.
    """
    return {name: (folder / name).read_bytes() for name in _shown_figures(page)}


def _shown_figures(page: str) -> list[str]:
    return re.findall(r"!\[[^\]]*\]\(([^):]+)\)", page)


@cache  # the same for all flavours
def reference_run(model: Model, unchecked: bool = False) -> ReferenceRun:
    """Run a model for two seconds, each input on a small sine of its own about its start value.

    Raises
    ------
    DocumentationError
        The result is not finite, or events follow each other without end.
    """
    p = model.parameters.starts
    start = model.default_experiment.start_time
    n = round(min(_DURATION, model.default_experiment.stop_time - start) / _ROW)
    time = np.round(start + _ROW * np.arange(n + 1), 9)
    frequencies = 0.4 + 0.1 * np.arange(1, len(model.inputs) + 1)
    swings = np.array([v.type == "real" for v in model.inputs.variables for _ in v.names], dtype=float)
    inputs = model.inputs.starts + _AMPLITUDE * swings * np.sin(2.0 * np.pi * np.outer(time - start, frequencies))
    inputs = np.round(inputs, 6)  # the last digits of a sine depend on the platform
    try:
        if model.is_continuous:
            outputs = _continuous_run(model, unchecked, time, inputs, p)
        else:
            outputs = _hybrid_run(model, time, inputs, p)
    except ArithmeticError as error:
        raise DocumentationError(
            f"the reference run: {error}; change the start values, or leave out the page"
        ) from None
    run = ReferenceRun(time, inputs, np.array(outputs))
    if not np.isfinite(run.outputs).all():
        raise DocumentationError(f"{model.name}: the reference run from the start values is not finite")
    return run


def _continuous_run(model: Model, unchecked: bool, time: Array, inputs: Array, p: Array) -> list[Array]:
    functions = functions_of(model, unchecked=unchecked)
    x = functions.initial_state(p)
    outputs = [functions.outputs(time[0], x, inputs[0], p)]
    advance = _advance(model, functions, unchecked)
    for t, t_end, u in zip(time, time[1:], inputs, strict=False):
        x = advance(t, x, u, p)
        outputs.append(functions.outputs(t_end, x, u, p))
    return outputs


def _hybrid_run(model: Model, time: Array, inputs: Array, p: Array) -> list[Array]:
    run = HybridRun(model, p, _ROW / _SUBSTEPS)
    state = run.start(time[0])
    outputs = [run.outputs(time[0], run.settled(time[0], state, inputs[0]), inputs[0])]
    for t, t_end, u in zip(time, time[1:], inputs, strict=False):
        state = run.advanced(t, run.settled(t, state, u), u, t_end)
        outputs.append(run.outputs(t_end, run.settled(t_end, state, u), u))
    return outputs


def _advance(model: Model, functions: Functions, unchecked: bool) -> Callable[[float, Array, Array, Array], Array]:
    """A function (t, x, u, p) -> states a row later, with constant inputs."""
    if not model.states:
        return lambda t, x, u, p: x
    if model.solver == "rk4":

        def runge_kutta(t: float, x: Array, u: Array, p: Array) -> Array:
            h = _ROW / _SUBSTEPS
            for i in range(_SUBSTEPS):
                x = rk4_step(functions.derivatives, t + i * h, x, u, p, h)
            return x

        return runge_kutta
    from fmu_export.trace.trace import trace

    # SUNDIALS' CVODES, with the row as unit of time; what an explicit method can integrate needs no Jacobian
    derivatives = trace(model, unchecked).derivatives
    t, x, u, p = derivatives.sx_in()
    since = ca.SX.sym("since")
    rates = derivatives(t + _ROW * since, x, u, p)
    system = {"t": since, "x": x, "p": ca.vertcat(t, u, p), "ode": _ROW * rates}
    options: dict[str, float | str] = {"reltol": 1e-12, "abstol": 1e-16}
    if model.solver != "rodas4":
        options |= {"linear_multistep_method": "adams", "nonlinear_solver_iteration": "functional"}
    integrator = ca.integrator("reference", "cvodes", system, 0.0, 1.0, options)
    return lambda t, x, u, p: integrator(x0=x, p=np.concatenate([[t], u, p]))["xf"].full().ravel()


def _csv(layout: Layout, time: Array, values: Array) -> bytes:
    """A line of quoted names, then a line a row, with 12 digits: beyond them platforms differ."""
    header = ",".join(f'"{name}"' for name in ("time", *layout.names))
    rows = (",".join(f"{value:.12g}" for value in (t, *row)) for t, row in zip(time, values.tolist(), strict=True))
    return ("\n".join([header, *rows]) + "\n").encode()


#: In double dollars an equation that stands alone, in single ones a part of a line.
_EQUATION = r"\$\$(.+?)\$\$|\$(?!\s)([^$]+?)(?<!\s)\$"


class _Equations(InlineProcessor):  # type: ignore[misc]  # markdown has no types
    """`$...$` and `$$...$$` in LaTeX become MathML, which browsers show without scripts."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:  # noqa: ARG002
        """Typeset one equation."""
        shown, inline = m.groups()
        try:
            found = str(mathml(shown or inline, display="block" if shown else "inline"))
        except Exception as error:  # whatever the converter stumbles over
            raise DocumentationError(f"the equation {m[0]} can't be typeset: {type(error).__name__}") from error
        unknown = re.search(r"\\\w+", found)
        if unknown:  # the converter passes on what it does not know
            raise DocumentationError(f"the equation {m[0]} can't be typeset: {unknown[0]} is unknown")
        if shown:  # a long equation scrolls in its own line, not the page
            found = f'<span class="equation">{found}</span>'
        return str(self.md.htmlStash.store(found)), m.start(), m.end()


def _markdown(page: str) -> str:
    converter = Markdown(extensions=["tables", "fenced_code", "sane_lists", TocExtension(baselevel=2)])
    converter.preprocessors.deregister("html_block")
    converter.inlinePatterns.deregister("html")
    # after `code`, before backslashes and underscores get a meaning
    converter.inlinePatterns.register(_Equations(_EQUATION, converter), "equations", 185)
    return str(converter.convert(page))


def _variable_table(interface: Interface) -> str:
    def number(v: ScalarVariable, value: float | None) -> str:
        return "" if value is None else f"{value:.12g}" if v.type == "real" else text_of(v.type, value, v.items)

    rows = []
    for v in interface.variables:
        cells = (
            v.causality,
            v.variability,
            v.unit if v.type == "real" else v.type,
            *(number(v, value) for value in (v.start, v.min, v.max)),
            v.description,
        )
        rows.append(f"<tr><td><code>{escape(v.name)}</code></td>" + "".join(f"<td>{escape(c)}</td>" for c in cells))
    heads = ("name", "causality", "variability", "unit", "start", "min", "max", "description")
    return (
        '<table id="variable-table">\n<thead><tr>'
        + "".join(f"<th>{h}</th>" for h in heads)
        + "</tr></thead>\n<tbody>\n"
        "" + "</tr>\n".join(rows) + "</tr>\n</tbody>\n</table>"
    )


def _usage(model: Model, run: ReferenceRun) -> str:
    name, stop = model.name, f"{run.time[-1]:g}"
    signals = f'read_csv("documentation/reference/{name}_in.csv")' if len(model.inputs) else "None  # it has no inputs"
    held = {v.name: list(v.starts) if v.size else v.starts[0] for v in model.inputs.variables}
    return f"""from fmpy import simulate_fmu
result = simulate_fmu("{name}.fmu", output=["{model.computed.names[0]}"])  # or all outputs

# the reference result, with the documentation unpacked
from fmpy.util import read_csv
inputs = {signals}
result = simulate_fmu("{name}.fmu", fmi_type="CoSimulation", stop_time={stop}, output_interval={_ROW}, input=inputs)

# with the master of the package that made this FMU; here inputs keep their values, system.connect feeds them
from cosim import System, simulate
system = System()
system.add("{name.lower()}", "{name}.fmu", start={held!r})
results = simulate(system, stop_time={stop}, step_size={model.default_experiment.step_size!r})
results.to_csv("results.csv")"""


def _stamp(flavour: str, metadata: Metadata, sources: bool) -> str:
    what = _FLAVOURS[flavour] if sources else _FLAVOURS[flavour].replace(_FROM_SOURCES, "")
    lines = [f"Made by {DISTRIBUTION} {escape(package_version())}, flavour <code>{escape(flavour)}</code>: {what}"]
    given = metadata.attributes
    about = [f"Author: {given['author']}"] if metadata.author else []
    # the version of this package says enough of its own models
    about += [f"version {given['version']}"] if metadata.version not in ("", package_version()) else []
    about += [metadata.copyright] if metadata.copyright else []
    lines += [escape("; ".join(about)) + "."] if about else []
    if metadata.license_text:
        link = '<a href="licenses/license.txt">licenses/license.txt</a>'
        lines.append(f"{escape(f'{metadata.license} licence'.strip())}: {link}.")
    elif metadata.license:
        lines.append(f"Licence: {escape(metadata.license)}.")
    return "\n".join(lines)


def _html(model: Model, interface: Interface, page: str, run: ReferenceRun, stamp: str) -> str:
    title = escape(model.name)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{_STYLE}</style>
</head>
<body>
<h1>{title}</h1>
<p>{escape(model.description)}.</p>
<p class="stamp">{stamp}</p>
{_markdown(page)}
<h2>Variables</h2>
{_variable_table(interface)}
<h2>Reference result</h2>
<p>The model alone, from its start values. Input i = 1, 2, ... (in the order of the table) is its start value
+ {_AMPLITUDE} sin(2 pi (0.4 + 0.1 i) t) in its unit, held from row to row ({_ROW} s).
The outputs of a row are those at the end of the step to it, before its inputs are set.
Inputs: <a href="reference/{title}_in.csv">reference/{title}_in.csv</a>.
Outputs: <a href="reference/{title}_ref.csv">reference/{title}_ref.csv</a>.</p>
<figure>
{curves(model.outputs, run.time, run.outputs)}<figcaption>Outputs of the reference run.</figcaption>
</figure>
<h2>How to use it</h2>
<pre><code>{escape(_usage(model, run), quote=False)}
</code></pre>
</body>
</html>
"""


_STYLE = """body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto;
padding: 0 1rem; }
h1, h2, h3 { line-height: 1.2; color: #1f4e79; }
h2 { margin-top: 2.2rem; border-bottom: 1px solid #d5dde5; padding-bottom: 0.2rem; }
.stamp { background: #eaf1f8; padding: 0.6rem 0.9rem; border-radius: 0.4rem; }
table { border-collapse: collapse; display: block; overflow-x: auto; font-size: 0.9rem; }
th, td { border: 1px solid #d5dde5; padding: 0.2rem 0.6rem; text-align: left; vertical-align: top; }
th { background: #eaf1f8; }
code { font: 0.9em ui-monospace, monospace; }
pre { background: #f5f7f9; padding: 0.8rem; overflow-x: auto; border-radius: 0.4rem; }
figure { margin: 1rem 0; }
svg, img { max-width: 100%; height: auto; }
.equation { display: block; overflow-x: auto; overflow-y: hidden; padding: 0.2rem 0; }
math { font-family: "STIX Two Math", "Latin Modern Math", "Cambria Math", math; }
figcaption { font-size: 0.9rem; color: #555; }
"""
