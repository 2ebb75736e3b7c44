"""Files that this worker process has received, by the SHA-256 of their contents."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from socket import gethostname

from cosim.sweep.errors import WorkerTrouble

#: SHA-256 -> file.
_paths: dict[str, Path] = {}

#: SHA-256 -> how often it has arrived; more than once would be a waste.
arrivals: Counter[str] = Counter()


def put(sha256: str, data: bytes, folder: Path) -> None:
    """Keep what has arrived in a folder of this process.

    Raises
    ------
    OSError
        The folder can't be written.
    """
    arrivals[sha256] += 1
    folder.mkdir(parents=True, exist_ok=True)
    # unpacked FMUs go there too: Dask removes a worker's folder, also when an FMU has taken the process down
    tempfile.tempdir = str(folder)
    path = folder / sha256
    path.write_bytes(data)
    _paths[sha256] = path


def know(paths: dict[str, Path]) -> None:
    """Take over files that another process of this worker has received."""
    _paths.update(paths)


def all_paths() -> dict[str, Path]:
    """SHA-256 -> file, of all that is here."""
    return dict(_paths)


def path(sha256: str) -> Path:
    """The file of these contents.

    Raises
    ------
    WorkerTrouble
        It has not arrived.
    """
    if sha256 not in _paths:
        raise WorkerTrouble(f"{gethostname()}: file {sha256[:12]} has not arrived; look for a full disk in its log")
    return _paths[sha256]
