"""`cosim completion`: a script that lets a shell complete commands, options and files of the program."""

from __future__ import annotations

import argparse
from typing import Any

from cosim.errors import needs

_SHELLS = ("bash", "zsh", "tcsh")

_EXAMPLES = """\
examples:
  cosim completion bash > ~/.local/share/bash-completion/completions/cosim
  cosim completion zsh > ~/.zfunc/_cosim
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim completion`."""
    parser = subparsers.add_parser(
        "completion",
        help="print a script that lets a shell complete commands and options",
        epilog=_EXAMPLES,
        description="Print a script that lets a shell complete the commands and options of cosim. It is made once, so "
        "completing starts no Python; make it again after an update.",
    )
    parser.add_argument("shell", choices=_SHELLS)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim completion`; returns 0.

    Raises
    ------
    MissingExtra
        The library that writes such scripts is not installed.
    """
    with needs("shell"):
        import shtab
    parser = args.command_line()
    _complete_files(parser, shtab.FILE)
    print(shtab.complete(parser, args.shell))
    return 0


def _complete_files(parser: argparse.ArgumentParser, by_files: object) -> None:
    """Have arguments completed that are files, which are those without choices that a user writes as such."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _complete_files(command, by_files)
        elif action.choices is None and _is_file(action):
            action.complete = by_files  # type: ignore[attr-defined]


def _is_file(action: argparse.Action) -> bool:
    written = str(action.metavar or "")
    return "FILE" in written or "DIR" in written or (not action.option_strings and action.nargs != 0)
