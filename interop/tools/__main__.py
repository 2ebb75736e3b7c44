"""Run one tool in this process: `python -m interop.tools NAME CASE.json OUT.npz`; without arguments, list them."""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
from pathlib import Path

from interop.tools import TOOLS
from interop.tools.case import Case


def main() -> int:
    """Exit code 0 after a run or a list, 1 where the tool can't run here or fails."""
    parser = argparse.ArgumentParser(prog="python -m interop.tools", description=__doc__)
    parser.add_argument("name", nargs="?", choices=TOOLS, help="which tool; none lists all")
    parser.add_argument("case", nargs="?", type=Path, help="case to run (JSON)")
    parser.add_argument("out", nargs="?", type=Path, help="where its ToolRun goes (.npz)")
    arguments = parser.parse_args()
    for name in [arguments.name] if arguments.name else TOOLS:
        tool = importlib.import_module(f"interop.tools.{name}")
        reason = tool.unavailable()
        if arguments.case is None:
            print(f"{name:<16} {tool.TITLE}: {reason or 'available'}")
        elif arguments.out is None:
            parser.error("CASE needs OUT")
        elif reason:
            print(f"{name}: {reason}", file=sys.stderr)
            return 1
        else:
            try:
                with tempfile.TemporaryDirectory(prefix=f"tool_{name}_", ignore_cleanup_errors=True) as folder:
                    tool.run(Case.from_json(arguments.case), Path(folder)).to_npz(arguments.out)
            except Exception as error:  # of whatever type the tool raises
                print(f"{name}: {type(error).__name__}: {error}", file=sys.stderr)
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
