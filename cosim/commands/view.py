"""`cosim view`: a page about a run, or about several of them side by side, in the browser or as a file."""

from __future__ import annotations

import argparse
import tempfile
import webbrowser
from pathlib import Path
from typing import Any

from cosim.output import OutputError


def register(subparsers: Any) -> None:
    """Add the parser of `cosim view`."""
    parser = subparsers.add_parser(
        "view",
        help="show a run as a page, or compare several",
        description="Make a page of a run: the diagram of its system, all curves with zoom and search, what happened, "
        "and how it was made. Several runs are laid over each other. The page is one file that needs no network.",
    )
    parser.add_argument(
        "runs", nargs="+", type=Path, metavar="FOLDER", help="folder that `cosim run` has written, or a table"
    )
    parser.add_argument("--out", type=Path, metavar="HTML", help="write the page into this file, and open no browser")
    parser.add_argument("--title", default="", help="title of the page")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim view`; returns the exit code, raises CosimError with one line on bad input."""
    from cosim.results.page.compare_page import labelled, write_compare_page
    from cosim.results.page.folder import read_run
    from cosim.results.page.run_page import write_run_page

    found = [read_run(path) for path in args.runs]
    path = Path(tempfile.mkdtemp(prefix="cosim_view_")) / "page.html" if args.out is None else args.out
    try:
        if len(found) == 1:
            write_run_page(found[0].results, path, args.title, found[0].log)
        else:
            write_compare_page(labelled((one.label, one.results) for one in found), path, args.title)
    except OSError as error:
        raise OutputError(f"can't write {path}: {error.strerror or error}; choose another --out") from error
    print(path)
    if args.out is None and not webbrowser.open(path.resolve().as_uri()):
        print("there is no browser to open it with")
    return 0
