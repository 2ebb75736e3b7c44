"""FMUs that run Python in this process (pythonfmu's): made ready before they are loaded.

Python keeps modules by name for the whole process, so that of two such FMUs with a module of one name both run the
first one's, and a new version of an FMU runs the old one's code. `fmu_export.build_script` gives its archives an entry
that keeps their modules apart; archives of others get the same entry here, in the folder that they were unpacked into.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Container
from pathlib import Path

import fmpy
from fmpy.model_description import ModelDescription

from cosim.errors import SetupError

#: The file that names the module which pythonfmu's binary starts; there and in `fmu_export.pythonfmu.entry`.
_MODULE_FILE = "slavemodule.txt"

#: Texts in every binary of pythonfmu, from 0.3 on: the file that it reads, and what it calls of Python.
_MARKS = (_MODULE_FILE.encode(), b"PyImport_ImportModule")

#: The Python library that a binary is tied to; none since pythonfmu 0.6.4, which works with any Python.
_TIED = re.compile(rb"libpython3\.(\d+)\w*\.|python3(\d+)\.dll")


def runs_python(folder: Path) -> bool:
    """Whether an unpacked FMU runs Python in this process."""
    return (folder / "resources" / _MODULE_FILE).is_file()


def is_script(files: Container[str]) -> bool:
    """Whether an FMU with these files runs Python in this process."""
    return f"resources/{_MODULE_FILE}" in files


def prepare(folder: Path, description: ModelDescription) -> None:
    """Make an unpacked FMU ready, if it runs Python in this process; others are left alone.

    Raises
    ------
    SetupError
        It can't run here; the text says why and what to do.
    """
    resources = folder / "resources"
    co_simulation = description.coSimulation
    if not runs_python(folder) or co_simulation is None:
        return
    name = co_simulation.modelIdentifier
    member = f"binaries/{fmpy.platform}/{name}{fmpy.sharedLibraryExtension}"
    library = folder / member
    binary = library.read_bytes() if library.is_file() else b""
    if not all(mark in binary for mark in _MARKS):
        return
    if "%20" in str(folder):
        raise SetupError(
            f"can't be unpacked into {folder}: pythonfmu's binary takes '%20' for a space; set TMPDIR to another folder"
        )
    from fmu_export.pythonfmu.binary import mended
    from fmu_export.pythonfmu.entry import ENTRY_BEGINS, entry_members, is_module

    better = _untied(binary, name, member) or mended(binary)
    if better != binary:
        library.write_bytes(better)
    script = (resources / _MODULE_FILE).read_text(encoding="utf-8").partition("\n")[0].rstrip("\r")
    source = resources / f"{script}.py"
    if not source.is_file():
        raise SetupError(f"its script resources/{script}.py is missing; get a complete FMU")
    if source.read_bytes().startswith(ENTRY_BEGINS.encode()):
        return
    paths = {file.relative_to(resources).as_posix(): file for file in resources.rglob("*") if file.is_file()}
    modules = {path: file.read_bytes() for path, file in paths.items() if is_module(path)}
    for path, content in entry_members(name, script, modules, slave=name).items():
        (resources / path).parent.mkdir(exist_ok=True)
        (resources / path).write_bytes(content)


def _untied(binary: bytes, name: str, member: str) -> bytes | None:
    """The installed pythonfmu's binary in place of one that is tied to a Python library."""
    # the search alone would take longer than all else here
    tied = _TIED.search(binary) if b"libpython3." in binary or member.endswith(".dll") else None
    if tied is None:
        return None
    from fmu_export.errors import ModelError
    from fmu_export.pythonfmu.binary import binaries

    try:
        return binaries(name)[member]
    except (ModelError, KeyError) as error:
        version = f"3.{int(tied[1] or tied[2])}"
        if version == f"{sys.version_info[0]}.{sys.version_info[1]}":
            return None
        raise SetupError(
            f"needs Python {version}, and this is Python {sys.version_info[0]}.{sys.version_info[1]}; "
            "with pythonfmu installed (pip install pythonfmu) its binary takes the place of this one"
        ) from error


def resources_uri(resources: Path) -> str:
    """The URI of an unpacked FMU's resources, as the FMU understands it: pythonfmu's binary decodes none but '%20'."""
    if (resources / _MODULE_FILE).is_file():
        return f"file://{'/' if fmpy.platform.startswith('win') else ''}{resources.as_posix()}"
    return resources.as_uri()
