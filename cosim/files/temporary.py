"""Temporary folders, each held by its process: those of processes that were killed are cleared away by the next one.

A folder is locked as long as its process lives. Its name has the number of the process, for people.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path

from cosim.files.locks import hold, is_at

#: Names of these folders; a folder of another program must not look as one.
_NAME = re.compile(r"cosim_(?:[a-z]+_)?pid\d+_\w+")

#: Folders where abandoned ones have been looked for.
_cleared: set[Path] = set()


class TemporaryFolder(tempfile.TemporaryDirectory[str]):
    """A temporary folder, as a context that gives its path.

    Parameters
    ----------
    purpose : str, optional
        A word for its name.
    place : Path, optional
        Folder where it is made; by default that of the system.

    Raises
    ------
    OSError
        It can't be made.
    """

    def __init__(self, purpose: str = "", place: Path | None = None) -> None:
        place = Path(tempfile.gettempdir()) if place is None else place
        if place not in _cleared:
            _cleared.add(place)
            clear_abandoned(place)
        prefix = f"cosim_{purpose}{'_' if purpose else ''}pid{os.getpid()}_"
        while True:
            # an FMU whose library is still in use can't be removed on Windows; that must not hide what it has computed
            super().__init__(prefix=prefix, dir=place, ignore_cleanup_errors=True)
            try:
                handle = _locked(Path(self.name))
            except OSError:  # a file system without locks, where nothing is ever taken for abandoned
                return
            if handle is not None:
                self._let_go = weakref.finalize(self, os.close, handle)
                return
            self.cleanup()  # another process took it for abandoned, before it was held

    def cleanup(self) -> None:
        """Remove the folder, now."""
        let_go = getattr(self, "_let_go", None)
        if let_go is not None and os.name == "nt":  # there an open file can't be removed
            let_go()
        super().cleanup()
        if let_go is not None:
            let_go()


def clear_abandoned(place: Path) -> None:
    """Remove temporary folders there whose processes have ended without doing so."""
    with suppress(OSError):
        for folder in [Path(entry.path) for entry in os.scandir(place) if _NAME.fullmatch(entry.name)]:
            with suppress(OSError):
                _clear(folder)


def _clear(folder: Path) -> None:
    if os.name != "nt" and folder.lstat().st_uid != os.getuid():
        return
    handle = None if folder.is_symlink() else _locked(folder)
    if handle is None:
        return
    if os.name == "nt":  # there an open file can't be removed
        os.close(handle)
    shutil.rmtree(folder, ignore_errors=True)
    if os.name != "nt":
        os.close(handle)


def _locked(folder: Path) -> int | None:
    """Hold a folder; None where another process does, or has removed it.

    Raises
    ------
    OSError
        The file system has no locks.
    """
    is_file = os.name == "nt"  # there a folder can't be opened
    path = folder / ".held" if is_file else folder
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT if is_file else os.O_RDONLY)
    except FileNotFoundError:
        return None
    try:
        if hold(handle) and is_at(handle, path):
            return handle
    except OSError:
        os.close(handle)
        raise
    os.close(handle)
    return None
