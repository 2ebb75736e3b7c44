"""FMUs from scripts for pythonfmu: any Python, not only what can be traced; pythonfmu's builder, its defects mended."""

from __future__ import annotations

import hashlib
import sys
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from fmu_export.errors import ArgumentError, needs
from fmu_export.package.archive import write_archive
from fmu_export.pythonfmu.binary import binaries

#: pythonfmu 0.7.0 runs the script at every instantiation, then drops a reference to its globals that it doesn't own.
_KEEP_GLOBALS = "\n\nimport ctypes\n\nctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))\n"


def build_script(
    script: str | PathLike[str], folder: str | PathLike[str] = ".", files: Iterable[str | PathLike[str]] = ()
) -> Path:
    """Write `<folder>/<class name>.fmu`, an FMI 2.0 co-simulation FMU.

    Unlike one of `pythonfmu build`, it does not harm its host at exit, can be instantiated often, and is not mistaken
    for another script of the same name in the host process.

    Parameters
    ----------
    script : path
        Python file with one class derived from `pythonfmu.Fmi2Slave`.
    folder : path
    files : iterable of path
        Other files and folders that the script needs, as modules that it imports.

    Raises
    ------
    ArgumentError
        There is no such script, or no such class in it.
    OSError
        The FMU can't be written; an older one is unchanged.
    BinariesMissing
        The installed pythonfmu has no binaries.
    MissingExtra
        pythonfmu is not installed.
    """
    with needs("export"):
        from pythonfmu.builder import FmuBuilder

    path = Path(script)
    if not path.is_file():
        raise ArgumentError(f"there is no script {path}")
    source = path.read_text(encoding="utf-8") + _KEEP_GLOBALS
    with TemporaryDirectory(prefix="build_script_") as name:
        # FMUs of one process share sys.modules: the name of the module says what is in it
        copy = Path(name) / f"{path.stem}_{hashlib.sha256(source.encode()).hexdigest()[:12]}.py"
        copy.write_text(source, encoding="utf-8")
        with _importable(path.resolve().parent):
            made = FmuBuilder.build_FMU(copy, dest=Path(name), project_files=[Path(f) for f in files])
        with zipfile.ZipFile(made) as archive:
            names = [n for n in archive.namelist() if not n.endswith("/") and not n.startswith("binaries/")]
            members = {n: archive.read(n) for n in names}
    target = Path(folder) / str(made.name)
    write_archive(target, members | binaries(made.stem))
    return target


@contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """The script is run to describe its FMU, and finds the modules beside it."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
