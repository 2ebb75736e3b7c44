"""The documentation site: `pip install -e ".[docs]"`, then `python -m sphinx -W docs site`."""

from __future__ import annotations

import sys
from importlib.metadata import version as _version
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert as _mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

from cosim.results.formats import markdown_table as _formats
from parallel_robot.live.page import live_page

sys.path.insert(0, str(Path(__file__).parent))

from errors_tree import errors_tree as _errors

project = "closed-chain-cosim"
author = "the closed-chain-cosim authors"
copyright = "closed-chain-cosim contributors, MIT licence"
version = release = _version("closed-chain-cosim")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_argparse_cli"]

# Pages are plain Markdown, readable without this site too; headings are link targets, as they are for Git hosts.
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath", "substitution"]
myst_substitutions = {"formats": _formats(), "errors": _errors()}  # {{ formats }} in a page
# model pages and changelog begin and end as files of their own; some names are there twice, as one error for each root
suppress_warnings = ["myst.header", "ref.python"]

# Docstrings: numpy style, `code` in single backticks.
default_role = "code"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
smartquotes_action = "D"  # dashes, but no quotation marks: theta'' is a derivative
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the parameters' text says it, with shapes and units
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = "closed-chain-cosim"
html_show_sphinx = False
html_show_sourcelink = False
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]

# Equations are MathML, which browsers show as it is: MathJax would come from another server.
html_math_renderer = "mathml"


def _equation(translator: HTML5Translator, node: nodes.Node) -> None:
    if isinstance(node, nodes.math_block):
        translator.body.append(f'<div class="equation">{_mathml(node.astext(), display="block")}</div>')
    else:
        translator.body.append(_mathml(node.astext()))
    raise nodes.SkipNode


def _live(app: Sphinx, exception: Exception | None) -> None:
    """The page that the front page shows: made with the site, so that it is that of these models and scripts."""
    if exception is None and app.builder.format == "html" and "live" in app.env.found_docs:
        page = live_page(Path(app.doctreedir) / "fmus")
        (Path(app.outdir) / "_static" / "live.html").write_text(page, encoding="utf-8")


def setup(app: Sphinx) -> None:
    """Register the renderer of equations, and what is made with the site."""
    app.add_html_math_renderer("mathml", (_equation, None), (_equation, None))
    app.connect("build-finished", _live)
