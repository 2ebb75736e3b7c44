"""`cosim page`: a page that runs a model in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cosim.errors import needs

_EXAMPLES = """\
examples:
  cosim page my_controller.py
  cosim page models.py:Tank --out tank.html
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim page`."""
    parser = subparsers.add_parser(
        "page",
        help="write a page that runs a model in the browser",
        epilog=_EXAMPLES,
        description="Write a page with a model as WebAssembly: controls of its parameters and inputs, sliders where "
        "they have both limits, and plots of its outputs, computed again at each change: one file that loads nothing.",
    )
    parser.add_argument(
        "model",
        metavar="MODEL",
        help="Python file of a model, as `cosim new` writes it; followed by :NAME for one of several; or MODULE:NAME",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="the page (default: <name of the model>.html)")
    parser.set_defaults(run=run)


@needs("export")
def run(args: argparse.Namespace) -> int:
    """Run `cosim page`; returns the exit code."""
    # CasADi takes a while to import, and other commands don't need it
    from cosim.files.whole import write_whole
    from cosim.model_page.page import model_page
    from fmu_export.modelling.finding import find_model
    from fmu_export.wasm.backend import script, wasm_model

    made = wasm_model(find_model(args.model))
    path = args.out or Path(f"{made.name}.html")
    page = model_page(made.code, made.description, script(exports=False))
    write_whole(path, lambda part: part.write_text(page, encoding="utf-8"))
    print(f"wrote {path}, {path.stat().st_size / 1024:.0f} kB")
    return 0
