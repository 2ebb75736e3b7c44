"""Run the matrix: `python -m interop`; exit code 0 only where every tool that is here agrees with us."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from interop.entries import ENTRIES
from interop.matrix import Outcome, run_entries
from interop.page import markdown
from interop.references import References
from interop.tools import TOOLS
from interop.tools.launch import tool
from interop.validators import validate
from parallel_robot.choices import FLAVOURS
from parallel_robot.fmus import BUILDABLE, build


def main(arguments: list[str] | None = None) -> int:
    """Run what is chosen, one line an entry; write the page where all was run."""
    parser = argparse.ArgumentParser(prog="python -m interop", description=__doc__)
    parser.add_argument("--tool", action="append", choices=TOOLS, help="only this tool (may be repeated)")
    parser.add_argument("--quick", action="store_true", help="only what the tests run")
    parser.add_argument("--fmus", type=Path, default=Path("fmus"), help="folder of the FMUs (default: fmus)")
    parser.add_argument("--page", type=Path, default=Path("docs/interop.md"), help="page to write when all is run")
    options = parser.parse_args(arguments)
    for flavour in FLAVOURS:
        build(options.fmus, flavour, BUILDABLE)
    chosen = [e for e in ENTRIES if (e.quick or not options.quick) and (not options.tool or e.tool in options.tool)]
    references, outcomes = References(options.fmus), []
    for outcome in run_entries(chosen, references):
        print(line(outcome), flush=True)
        outcomes.append(outcome)
    good = all(outcome.is_good for outcome in outcomes)
    if len(chosen) == len(ENTRIES):
        with tempfile.TemporaryDirectory() as folder:
            validations = list(validate(options.fmus, Path(folder)))
        good = good and all(v.is_good for v in validations)
        options.page.write_text(markdown(outcomes, validations, references), encoding="utf-8")
        print(f"written: {options.page}")
    return int(not good)


def line(outcome: Outcome) -> str:
    """An outcome for people."""
    e, v = outcome.entry, outcome.verdict
    what = f"{outcome.status:<8} {tool(e.tool).TITLE}, {e.files}, {e.flavour}"
    if v is not None:
        what += f": differs by {v.difference:.1e} m, at most {v.tolerance:.1e}"
    return f"{what}: {outcome.reason}" if outcome.reason else what


if __name__ == "__main__":
    sys.exit(main())
