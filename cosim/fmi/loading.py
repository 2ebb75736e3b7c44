"""Loading a shared library, and finding functions of FMI in it; quick to import, for processes of isolated FMUs."""

from __future__ import annotations

import _ctypes
import ctypes
import sys
from collections.abc import Iterable
from pathlib import Path

from cosim.errors import CosimError
from cosim.fmi.load_failure import missing_library, why_not_loaded


class LibraryError(CosimError):
    """The shared library of an FMU can't be loaded, or lacks a function."""


def load(path: Path) -> list[ctypes.CDLL]:
    """A library by its full path, and after it the further ones beside it that had to be loaded before.

    On Windows the loader finds further ones beside it; on Linux it does not, unless the library says so. They are then
    loaded before, and the loader takes them by their names.

    Raises
    ------
    LibraryError
        It can't be loaded; the text says why, and what to do.
    """
    beside: dict[str, list[ctypes.CDLL]] = {}
    while True:
        try:
            library = ctypes.CDLL(str(path))
        except OSError as error:
            further = missing_library(str(error), path)
            if further is None or further in beside or not (other := path.with_name(further)).is_file():
                unload(one for several in beside.values() for one in several)
                raise LibraryError(why_not_loaded(str(error), path)) from error
            beside[further] = load(other)
        else:
            return [library, *(one for several in reversed(beside.values()) for one in several)]


def unload(libraries: Iterable[ctypes.CDLL]) -> None:
    """Unload libraries."""
    for library in libraries:
        if sys.platform == "win32":
            _ctypes.FreeLibrary(library._handle)
        else:
            _ctypes.dlclose(library._handle)


def in_standard(name: str) -> str:
    """Name of a function in the standard; ours begin with `fmi1` for the `fmi` of FMI 1.0."""
    return f"fmi{name[4:]}" if name.startswith("fmi1") else name


def names_in_library(name: str, identifier: str) -> tuple[str, str]:
    """Names that a function may have in a library.

    They begin with the model identifier in FMI 1.0, and in libraries of sources that were meant to be linked.
    """
    return f"{identifier}_{in_standard(name)}", in_standard(name)
