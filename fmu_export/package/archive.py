"""FMU archives: the same files give the same bytes, and a write either succeeds or leaves the old file whole."""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

#: The earliest time a zip archive can hold; a fixed one keeps the bytes reproducible.
_TIMESTAMP = (1980, 1, 1, 0, 0, 0)


def write_archive(path: Path, files: dict[str, bytes]) -> None:
    """Write an FMU with the given members, sorted by name, modelDescription.xml first.

    Raises
    ------
    OSError
        The file can't be written; an older one at `path` is unchanged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files, key=lambda n: (n != "modelDescription.xml", n)):
            info = zipfile.ZipInfo(name, _TIMESTAMP)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.create_system = 3  # Unix, whatever system builds
            info.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(info, files[name])


def replace_members(path: Path, new: dict[str, bytes]) -> None:
    """Replace members of an archive and keep all others byte for byte.

    Raises
    ------
    OSError, zipfile.BadZipFile
        The archive can't be read or written; it is unchanged.
    """
    with zipfile.ZipFile(path) as old, replacing(path) as stream, zipfile.ZipFile(stream, "w") as archive:
        archive.comment = old.comment
        for info in old.infolist():
            archive.writestr(info, new.get(info.filename, old.read(info)))


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` and put it in its place once all is written.

    Raises
    ------
    OSError
        The file can't be written; an older one at `path` is unchanged and the temporary one is gone.
    """
    path = path.resolve()  # a symbolic link stays one
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        temporary.chmod(path.stat().st_mode if path.exists() else 0o644)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
