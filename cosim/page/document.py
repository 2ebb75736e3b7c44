"""The frame of every page: one HTML file that loads nothing and runs no script but those that its policy names."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import Any

#: Styles and scripts that plots need, in this order: `plots.js` has the interface.
PLOT_STYLES = ("uplot/uPlot.min.css", "page.css", "plots.css")
PLOT_SCRIPTS = ("uplot/uPlot.iife.min.js", "theme.js", "decode.js", "plots.js")


@cache
def asset(name: str, package: str = "cosim.page") -> str:
    """A file of the folder `assets` of a package, as text."""
    text = (files(package) / "assets" / name).read_text(encoding="utf-8")
    return re.sub(r"\n//# sourceMappingURL=.*", "", text)  # of a file that is not in the page


def assets(names: Iterable[str], package: str = "cosim.page") -> list[str]:
    """Files of the folder `assets` of a package, as texts."""
    return [asset(name, package) for name in names]


@dataclass(frozen=True)
class Section:
    """A part of a page.

    Attributes
    ----------
    id, title : str
        Identifier and heading; the table of contents has both.
    html : str
        What stands below the heading.
    styles, scripts : sequence of str
        Texts that it needs in the page; equal ones of several sections go in once.
    data : mapping
        Name -> what a script finds in `DATA[name]`.
    blocks : mapping
        Id -> deflated bytes; see `decode.js`.
    listed : bool
        Whether the table of contents has it.
    """

    id: str
    title: str
    html: str
    styles: Sequence[str] = ()
    scripts: Sequence[str] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    blocks: Mapping[str, bytes] = field(default_factory=dict)
    listed: bool = True

    def in_page(self) -> str:
        """HTML of the section with its heading."""
        name = escape(self.id, quote=True)
        return (
            f'<section id="{name}" aria-labelledby="{name}-title">\n<h2 id="{name}-title">{self.title}</h2>\n'
            f"{self.html}\n</section>"
        )


def contents(sections: Iterable[Section]) -> str:
    """Links to sections, where there are several."""
    links = [f'<a href="#{escape(s.id, quote=True)}">{s.title}</a>' for s in sections if s.listed]
    return f'<nav class="contents" aria-label="Sections">{"".join(links)}</nav>' if len(links) > 1 else ""


def document(
    title: str,
    header: str,
    sections: Sequence[Section],
    *,
    styles: Sequence[str] = (),
    scripts: Sequence[str] = (),
    data: Mapping[str, Any] | None = None,
    blocks: Mapping[str, bytes] | None = None,
    webassembly: bool = False,
    asks: bool = False,
) -> str:
    """A page as HTML.

    Its security policy lets it load nothing from anywhere, and use these styles and scripts only, by their hashes.

    Parameters
    ----------
    title : str
        As text.
    header : str
        HTML above the table of contents; may be empty.
    sections : sequence of Section
    styles, scripts : sequence of str
        Texts before those of the sections.
    data : mapping, optional
        Name -> JSON value, in `DATA` of the scripts with those of the sections.
    blocks : mapping, optional
        Id -> deflated bytes, for `decode.js`.
    webassembly : bool, optional
        Its scripts may compile WebAssembly, and start workers from texts of the page.
    asks : bool, optional
        Its scripts may ask the server that it is from.
    """
    style = "\n".join(dict.fromkeys([*styles, *(text for s in sections for text in s.styles)]))
    script = "\n".join(dict.fromkeys([*scripts, *(text for s in sections for text in s.scripts)]))
    known: dict[str, Any] = {}
    binary = dict(blocks or {})
    for section in sections:
        known.update(section.data)
        binary.update(section.blocks)
    known.update(data or {})
    policy = "; ".join(
        (
            "default-src 'none'",
            "base-uri 'none'",
            "form-action 'none'",
            "img-src data: blob:",
            f"style-src {_hash(style)}",
            f"script-src {_hash(script)}" + " 'wasm-unsafe-eval'" * webassembly,
            *(["worker-src blob:"] if webassembly else []),
            *(["connect-src 'self'"] if asks else []),
        )
    )
    shown = "\n".join(section.in_page() for section in sections)
    embedded = "".join(
        f'<script type="text/plain" id="{escape(name, quote=True)}">{b64encode(content).decode()}</script>\n'
        for name, content in binary.items()
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{escape(title)}</title>
<style>{style}</style>
</head>
<body>
<a class="skip" href="#main">Skip to the content</a>
{f"<header>{header}</header>" if header else ""}
{contents(sections)}
<main id="main">
<noscript><p>Plots and diagrams need JavaScript; tables and texts do not.</p></noscript>
{shown}
</main>
<script type="application/json" id="data">{_json(known)}</script>
{embedded}<script>{script}</script>
</body>
</html>
"""


def _hash(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


def _json(data: object) -> str:
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c")  # "</" would end the script element, "<!--" begin a comment


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], caption: str, kind: str = "") -> str:
    """An HTML table whose cells are HTML already; wide ones can be scrolled.

    Parameters
    ----------
    heads : sequence of str
    rows : iterable of sequences of str
        The first cell of each is its head.
    caption : str
        As text, for those who do not see the page.
    kind : str
        Further classes.
    """
    head = "".join(f'<th scope="col">{h}</th>' for h in heads)
    body = "\n".join(
        f'<tr><th scope="row">{first}</th>' + "".join(f"<td>{cell}</td>" for cell in rest) + "</tr>"
        for first, *rest in rows
    )
    label = escape(f"Table: {caption}", quote=True)
    return (
        f'<div class="wide" tabindex="0" role="region" aria-label="{label}"><table class="framed {kind}">'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>"
    )
