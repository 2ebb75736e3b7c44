"""The library of an FMU that comes as C sources, compiled on this machine."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import fmpy
from fmpy.model_description import ModelDescription, SourceFileSet

from cosim.errors import SetupError
from cosim.fmi.archive.findings import quoted

_C = ("cc", "gcc", "clang")
_CXX = ("c++", "g++", "clang++")

#: So much of what a compiler says is passed on (characters).
_MOST_SAID = 300

#: Libraries that were compiled in this process: hash of the FMU file and model identifier -> library.
_compiled: dict[tuple[str, str], bytes] = {}


def has_sources(files: Sequence[str]) -> bool:
    """Whether there are C sources among the files of an FMU."""
    return any(name.startswith("sources/") and _is_source(name) for name in files)


def compile_library(folder: Path, description: ModelDescription, identifier: str, sha256: str, library: Path) -> None:
    """Compile the sources of an unpacked FMU.

    Parameters
    ----------
    folder : Path
        Folder with the unpacked FMU.
    description : ModelDescription
        Its model description, which lists the sources.
    identifier : str
        Model identifier of the interface.
    sha256 : str
        Hash of the FMU file; what was compiled from it before in this process serves again.
    library : Path
        File to write.

    Raises
    ------
    SetupError
        There is no compiler, or it refuses the sources.
    """
    library.parent.mkdir(parents=True, exist_ok=True)
    if (sha256, identifier) not in _compiled:
        _compile(folder / "sources", _file_sets(folder / "sources", description, identifier), library)
        _compiled[sha256, identifier] = library.read_bytes()
    library.write_bytes(_compiled[sha256, identifier])


def _compile(sources: Path, sets: Sequence[SourceFileSet], library: Path) -> None:
    objects: list[str] = []
    c_plus_plus = False
    for file_set in sets:
        _check_names(sources, (*file_set.sourceFiles, *file_set.includeDirectories))
        options = ["-O2", "-w", "-fPIC", f"-I{sources}", f"-I{Path(fmpy.__file__).parent / 'c-code'}"]
        options += [f"-I{sources / name}" for name in file_set.includeDirectories]
        options += [f"-D{d.name}={d.value or ''}" for d in file_set.preprocessorDefinitions if not d.optional]
        options.append("-DFMI3_OVERRIDE_FUNCTION_PREFIX")  # a library has the names of the standard
        if file_set.language:
            options.append(f"-std={file_set.language.lower()}")
        for name in file_set.sourceFiles:
            plus = Path(name).suffix != ".c"
            c_plus_plus |= plus
            objects.append(f"{library.parent / str(len(objects))}.o")
            _call([*_compiler(plus), *options, "-c", name, "-o", objects[-1]], sources)
    _call([*_compiler(c_plus_plus), "-shared", *objects, "-o", str(library), "-lm"], sources)
    for name in objects:
        Path(name).unlink()


def _check_names(sources: Path, names: Sequence[str | None]) -> None:
    """Refuse names that the compiler would take for options, or that lead out of the FMU."""
    for name in names:
        inside = (sources / (name or "")).resolve().is_relative_to(sources.parent.resolve())
        if not name or name.startswith(("-", "@")) or not inside:
            raise SetupError(
                f"can't be compiled: its list of sources has {quoted(name)}, which is not a name of one of its files"
            )


def _file_sets(sources: Path, description: ModelDescription, identifier: str) -> list[SourceFileSet]:
    """The sources that the FMU lists; where it lists none, all that lie there, or the one that includes all."""
    for configuration in description.buildConfigurations:
        if configuration.modelIdentifier == identifier:
            return list(configuration.sourceFileSets)
    found = sorted(path.name for path in sources.iterdir() if _is_source(path.name))
    return [SourceFileSet(sourceFiles=["all.c"] if "all.c" in found else found)]


def _is_source(name: str) -> bool:
    return Path(name).suffix in (".c", ".cc", ".cpp", ".cxx")


def _compiler(c_plus_plus: bool) -> list[str]:
    """The compiler that CC or CXX names, or the first one that is found."""
    if named := os.environ.get("CXX" if c_plus_plus else "CC", "").strip():
        return shlex.split(named)
    for name in _CXX if c_plus_plus else _C:
        if found := shutil.which(name):
            return [found]
    if find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "c++" if c_plus_plus else "cc"]
    raise SetupError("can't be compiled: there is no C compiler; install gcc or clang, or pip install ziglang")


def _call(command: Sequence[str], folder: Path) -> None:
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=os.environ | {"LC_ALL": "C"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
        )
    except OSError as error:
        raise SetupError(f"can't be compiled: {command[0]} can't be started: {error}") from error
    if done.returncode:
        said = done.stderr.decode(errors="replace").splitlines()
        errors = [line for line in said if "error" in line or "undefined" in line] or said
        text = " ".join(" ".join(errors[:2]).split())[:_MOST_SAID]
        raise SetupError(f"can't be compiled: {Path(command[0]).name} refuses its C sources: {text}")
