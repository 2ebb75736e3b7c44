"""What the workers of a test session share: the same sources are compiled once, the same FMUs are built once."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from fmu_export.native import backend, toolchain
from fmu_export.native.toolchain import Target, Unit, compile_library, compiler_identity

#: Set by conftest before any FMU is built: a folder of the session, the same in all workers.
folder: Path | None = None

#: Of the FMUs that users build.
OPTIMISATION_OF_USERS = toolchain.OPTIMISATION

#: Of the robot's FMUs, which run for long.
OPTIMISATION_OF_ROBOT = "-O1"


@contextmanager
def shared_compilation(optimisation: str | None = None) -> Iterator[None]:
    """Native FMUs that are built inside take a library from the folder of the session if one of its sources is there.

    For FMUs that tests use, not for tests of how they are built.
    """
    before = backend.compile_library, toolchain.OPTIMISATION
    backend.compile_library, toolchain.OPTIMISATION = _compile_once, optimisation or toolchain.OPTIMISATION
    try:
        yield
    finally:
        backend.compile_library, toolchain.OPTIMISATION = before


def _compile_once(
    sources: Mapping[str, bytes], name: str, target: Target | None = None, *, units: Sequence[Unit] = ()
) -> bytes:
    assert folder is not None
    digest = hashlib.sha256(repr((sorted(sources.items()), name, target, units, toolchain.OPTIMISATION)).encode())
    digest.update(compiler_identity(all_platforms=target is not None).encode())
    path = folder / digest.hexdigest()
    if not path.exists():
        folder.mkdir(exist_ok=True)
        handle, part = tempfile.mkstemp(dir=folder)
        with os.fdopen(handle, "wb") as file:
            file.write(compile_library(sources, name, target, units=units))
        Path(part).replace(path)  # whole or not at all: another worker may want it too
    return path.read_bytes()


def built_once(name: str, build: Callable[[Path], object], destination: Path, optimisation: str | None = None) -> None:
    """Put into a folder what a function builds, which one worker does for all; each has a copy of its own."""
    assert folder is not None
    folder.mkdir(exist_ok=True)
    common = folder / name
    with _locked(folder / f"{name}.lock"):
        if not common.exists():
            part = Path(tempfile.mkdtemp(dir=folder))
            with shared_compilation(optimisation):
                build(part)
            if not common.exists():
                part.rename(common)
    shutil.copytree(common, destination, dirs_exist_ok=True)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One worker at a time, where the system has such locks; it frees those of a process that dies."""
    with path.open("w") as file:
        try:
            import fcntl
        except ImportError:  # Windows: two may build, and one of them is taken
            yield
        else:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield
