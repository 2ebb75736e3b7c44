"""`cosim view`: a page about a run, or about several of them side by side, in the browser or as a file."""

from __future__ import annotations

import argparse
import tempfile
import webbrowser
from functools import partial
from pathlib import Path
from typing import Any

from cosim.errors import MissingExtra
from cosim.results.output import OutputError

_EXAMPLES = """\
examples:
  cosim view results/tanks
  cosim view results/before results/after --title 'Another controller'
  cosim view theirs.csv --out page.html
  cosim view results/sweep-tracking
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim view`."""
    parser = subparsers.add_parser(
        "view",
        help="show a run as a page, or compare several",
        epilog=_EXAMPLES,
        description="Make a page of a run: the diagram of its system, all curves with zoom and search, what happened, "
        "and how it was made. Several runs are laid over each other; a sweep is a scatter plot and a table of its "
        "runs. The page is one file that needs no network; where the values are too many for it, zoom asks for them at "
        "an address of this machine, until Ctrl-C.",
    )
    parser.add_argument(
        "runs",
        nargs="+",
        type=Path,
        metavar="FOLDER",
        help="folder that `cosim run` or `cosim sweep` has written, or a table",
    )
    parser.add_argument("--out", type=Path, metavar="HTML", help="write the page into this file, and open no browser")
    parser.add_argument("--title", default="", help="title of the page")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim view`; returns the exit code, raises CosimError with one line on bad input."""
    from cosim.results.page.folder import is_sweep, read_run

    if len(args.runs) == 1 and is_sweep(args.runs[0]):
        from cosim.sweep.page.page import page_of_folder

        return _shown(page_of_folder(args.runs[0], args.title), args.out)
    from cosim.results.page.compare_page import compare_page, labelled
    from cosim.results.page.run_page import run_page

    found = [read_run(path) for path in args.runs]
    runs = labelled((one.label, one.results) for one in found)
    asks = args.out is None
    if len(found) == 1:
        page = run_page(found[0].results, args.title, found[0].log, asks=asks)
    else:
        page = compare_page(runs, args.title, asks=asks)
    if asks and 'class="hint coarse"' in page and _served(page, runs):
        return 0
    return _shown(page, args.out)


def _shown(page: str, out: Path | None) -> int:
    """Write a page, and unless it was to be a file show it."""
    path = _written(page, out)
    print(path)
    if out is None and not webbrowser.open(path.resolve().as_uri()):
        print("there is no browser to open it with")
    return 0


def _served(page: str, runs: Any) -> bool:
    """Serve a page until Ctrl-C, with the values that it has no room for; whether that can be done."""
    from cosim.results.page.detail import detail

    try:
        from cosim.page.server import PageServer
    except MissingExtra as error:
        print(f"note: zoom shows no more than the page has; {error}")
        return False
    with PageServer(page, {"detail": partial(detail, runs)}) as server:
        print(f"{server.address} (Ctrl-C ends it)", flush=True)
        webbrowser.open(server.address)
        server.run()
    return True


def _written(page: str, out: Path | None) -> Path:
    from cosim.files.whole import write_whole

    path = Path(tempfile.mkdtemp(prefix="cosim_view_")) / "page.html" if out is None else out
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, lambda part: part.write_text(page, encoding="utf-8", newline="\n"))
    except OSError as error:
        raise OutputError(f"can't write {path}: {error.strerror or error}; choose another --out") from error
    return path
