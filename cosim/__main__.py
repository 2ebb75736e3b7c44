"""The program `cosim`."""

from __future__ import annotations

import argparse
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.metadata import entry_points

from cosim.errors import CosimError
from cosim.master.interrupts import take_as_ctrl_c
from cosim.terminal import filtered_output
from cosim.versions import versions
from fmu_export.errors import ModelError

#: Commands of the program itself -> modules.
_OWN = {
    name: f"cosim.commands.{name}"
    for name in (
        "run",
        "view",
        "compare",
        "sweep",
        "pack",
        "page",
        "info",
        "scenarios",
        "validate",
        "sign",
        "verify",
        "completion",
    )
}

#: Messages that are longer are cut off.
_LONGEST = 4000

#: Entry-point group by which other packages add commands: name -> module with a function `register(subparsers)`.
COMMAND_GROUP = "cosim.commands"


class _Help(argparse.HelpFormatter):
    """Help that breaks lines, but for texts that have lines already, as examples do."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n" in text:
            return "".join(f"{indent}{line}\n" for line in text.splitlines())
        return super()._fill_text(text, width, indent)


def commands() -> dict[str, str]:
    """All commands -> modules: the program's own, and those of installed packages."""
    return {entry.name: entry.value for entry in entry_points(group=COMMAND_GROUP)} | _OWN


def command_line(chosen: Mapping[str, str] | None = None) -> argparse.ArgumentParser:
    """The parser of commands and their options.

    Parameters
    ----------
    chosen : mapping, optional
        Commands -> modules; all of them by default.
    """
    about = "Co-simulation of FMUs at a fixed communication step."
    parser = argparse.ArgumentParser(prog="cosim", description=about, epilog="cosim COMMAND --help has examples.")
    parser.add_argument("--version", action="version", version=versions()["closed-chain-cosim"])
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.set_defaults(command_line=command_line)  # for what needs to know all commands
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for module in (commands() if chosen is None else chosen).values():
        import_module(module).register(subparsers)
    for command in subparsers.choices.values():
        command.formatter_class = _Help
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 only on success, 130 after Ctrl-C, SIGTERM or SIGHUP.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the program by default.
    """
    given = sys.argv[1:] if arguments is None else arguments

    def command() -> int:
        if arguments is None:
            take_as_ctrl_c()
        options = command_line(_asked_for(given)).parse_args(given)
        if arguments is not None or not getattr(options, "runs_fmus", False):
            return int(options.run(options))
        from cosim.commands.supervision import supervised

        return supervised(lambda: _code_of(lambda: int(options.run(options)), given))

    with filtered_output():
        return _code_of(command, given)


def _code_of(command: Callable[[], int], given: Sequence[str]) -> int:
    """Exit code of a command with these arguments; its errors are said."""
    try:
        return command()
    except KeyboardInterrupt:
        print("cosim: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        if "--debug" in given:
            traceback.print_exc()
        else:
            print(f"cosim: {_line(error)}", file=sys.stderr)
        return 1


def _line(error: Exception) -> str:
    """What is said of an error: its text; of one that is not meant for users also what it is."""
    text = " ".join(str(error).split())
    if len(text) > _LONGEST:
        text = f"{text[:_LONGEST]} ... ({len(text) - _LONGEST} characters more)"
    if text and isinstance(error, (CosimError, ModelError, ValueError, OSError, MemoryError)):
        return text
    return f"{type(error).__name__}: {text}; this is a fault of the program: please report what --debug shows"


def _asked_for(arguments: Sequence[str]) -> dict[str, str] | None:
    """The command that is named, if one is: importing all takes a while."""
    first = next((a for a in arguments if not a.startswith("-")), None)
    if first is None:
        return None
    known = _OWN if first in _OWN else commands()
    return {first: known[first]} if first in known else None


if __name__ == "__main__":
    sys.exit(main())
