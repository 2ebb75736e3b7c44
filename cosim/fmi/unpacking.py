"""Temporary folders in which FMUs can be unpacked and run."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from cosim.files.temporary import TemporaryFolder


def folder_for_fmus() -> TemporaryFolder:
    """A temporary folder whose path FMUs can live with, and from where libraries can be loaded.

    FMUs get the address of their resources as a URI, and many don't decode what is escaped in it, at most a space. So
    the folder is elsewhere where the system's folder for temporary files has such a path or is mounted noexec, if there
    is a better one.
    """
    return TemporaryFolder(place=place_for_fmus())


def place_for_fmus() -> Path:
    """Where such folders are."""
    usual = Path(tempfile.gettempdir())
    return next((folder for folder in (usual, *_others()) if is_plain(folder) and _is_for_programs(folder)), usual)


def is_plain(folder: Path) -> bool:
    """Whether nothing in the address of a folder, a URI, has to be escaped but spaces."""
    return "%" not in folder.absolute().as_uri().replace("%20", "")


def _others() -> Iterator[Path]:
    """Other folders where temporary files may be."""
    if os.name == "nt":
        yield from (Path(os.environ[name]) for name in ("PUBLIC", "PROGRAMDATA") if name in os.environ)
    else:
        yield from map(Path, ("/tmp", "/var/tmp", "/dev/shm"))
        if "HOME" in os.environ:
            yield Path(os.environ["HOME"]) / ".cache"


def _is_for_programs(folder: Path) -> bool:
    """Whether one can write there, and libraries can be loaded from there."""
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        return False
    without = getattr(os, "ST_NOEXEC", 0)  # Linux
    return not (without and os.statvfs(folder).f_flag & without)
