"""The robot's FMUs for a command: which flavour, those that are missing built, and a word on outdated ones."""

from __future__ import annotations

from pathlib import Path

from parallel_robot import fmus


def chosen_flavour(folder: Path, flavour: str | None) -> str:
    """The flavour asked for, else the default; prints why it is not the native one."""
    if flavour is not None:
        return flavour
    default, note = fmus.default_flavour(folder)
    if note:
        print(note)
    return default


def make_ready(folder: Path, flavour: str) -> None:
    """Build the missing FMUs of a flavour; prints what was built, and a note where sources are newer than an FMU.

    Raises
    ------
    BuildError
        As `parallel_robot.fmus.build`.
    """
    for path in fmus.build_missing(folder, flavour):
        print(f"built {path}")
    outdated = fmus.outdated(folder, flavour)
    if outdated:
        print(f"note: the sources have changed since {outdated[0]} was built; rebuild with: python build_fmus.py")
