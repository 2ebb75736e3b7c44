"""Why a shared library can't be loaded, and the remedy, from what the system's loader says."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from cosim.fmi.archive.libraries import is_damaged, machine_of_file

#: The loader's words for a further library that it does not find: glibc, musl, macOS.
_MISSING = re.compile(
    r"^(?:\S*/)?(?P<glibc>[^\s/:]+): cannot open shared object file"
    r"|^Error loading shared library (?P<musl>[^\s:]+):"
    r"|Library not loaded: (?:\S*/)?(?P<macos>[^\s/]+)"
)

_DAMAGED = "is damaged, or no library for this system; build or download the FMU again"

#: Message of the system's loader -> cause and remedy.
_CAUSES = (
    (
        r"undefined symbol: (?P<name>[^\s,]+)|symbol not found[^']*'(?P<macos>\w+)'",
        "calls '{name}', which neither it nor a library that it names has: it was linked incompletely; ask its maker "
        "for a complete one",
    ),
    (
        r"version [`'](?P<name>\w+_[\d.]+)' not found",
        "was built on a newer system than this one (it needs {name}); ask its maker for one built on an older system, "
        "or run it on a newer one",
    ),
    (
        r"failed to map segment|Operation not permitted|Permission denied",
        "lies in {folder}, from where nothing may be executed (mounted noexec?); set the environment variable TMPDIR "
        "to a folder from where programs can run",
    ),
    (
        r"cannot enable executable stack",
        "asks for an executable stack, which this system refuses; ask its maker for another one, or clear the mark "
        "with patchelf --clear-execstack",
    ),
    (
        r"static TLS",
        "finds no room left for its thread-local variables; start the program with the environment variable "
        "GLIBC_TUNABLES=glibc.rtld.optional_static_tls=16384",
    ),
    (
        r"file too short|invalid ELF header|file truncated|\[WinError 193\]",
        _DAMAGED,
    ),
    (
        r"\[WinError 126\]",
        "needs a further DLL, which is neither beside it nor in the system; install what its maker names (often the "
        "Visual C++ Redistributable)",
    ),
)


def missing_library(said: str, path: Path) -> str | None:
    """Name of the further library for want of which a library can't be loaded; None where that is not the cause."""
    found = _MISSING.search(said)
    name = next(filter(None, found.groups()), None) if found else None
    return name if name != path.name else None


def why_not_loaded(said: str, path: Path) -> str:
    """Cause and remedy in one line, to follow the name of the FMU.

    Parameters
    ----------
    said : str
        What the loader said.
    path : Path
        The library.
    """
    said = " ".join(said.split())
    where = f"can't be loaded: its library {path.name}"
    if (name := missing_library(said, path)) is not None and path.with_name(name).is_file():
        return (
            f"{where} needs {name}, which lies beside it, but has no name of its own (SONAME) by which the loader "
            "finds it; ask its maker for an RPATH of $ORIGIN, or set it with patchelf --set-rpath"
        )
    if name is not None:
        return f"{where} needs {name}, which is neither beside it nor on this machine; {_how_to_get(name)}"
    if why := not_loadable(path):
        return why
    for pattern, cause in _CAUSES:
        if found := re.search(pattern, said):
            names = [group for group in found.groups() if group]
            return f"{where} {cause.format(name=names[0] if names else '', folder=path.parent)}"
    return f"{where}: {said}"


def not_loadable(path: Path) -> str:
    """Why a library can't be loaded here, as far as its headers say, to follow the name of the FMU; else empty."""
    where = f"can't be loaded: its library {path.name}"
    made_for, here = machine_of_file(path), machine_of_file(Path(sys.executable))
    if made_for is not None and here is not None and not made_for.serves(here):
        return f"{where} is for {made_for}, and this process is {here}; get an FMU with a binary for this machine"
    return f"{where} {_DAMAGED}" if made_for is None or is_damaged(path) else ""


def _how_to_get(name: str) -> str:
    """Remedy for a missing shared library."""
    stem, ending, number = name.partition(".so.")
    if not ending:
        return "install it, or name its folder in LD_LIBRARY_PATH before the program starts"
    package = f"{stem}{'-' if stem[-1:].isdigit() else ''}{number}"
    return (
        f"install it (Debian and Ubuntu often have it in a package {package}), or name its folder in LD_LIBRARY_PATH "
        "before the program starts"
    )
