"""Locks on files and folders, which the system lets go when a process ends, however it does."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path


class FileLock:
    """A file that one process at a time holds; it is made, and removed with its folder when that is empty."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle: int | None = None

    def acquire(self) -> bool:
        """Make the file and hold it; whether no other process holds it."""
        while self._handle is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            try:
                handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            except FileNotFoundError:  # the holder before has just removed the folder
                continue
            try:
                is_held = hold(handle)
            except OSError:  # a file system without locks: then the user takes care
                is_held = True
            if not is_held:
                os.close(handle)
                return False
            if is_at(handle, self._path):
                self._handle = handle
            else:
                os.close(handle)
        return True

    def release(self) -> None:
        """Let go of the file and remove it, with its folder."""
        if self._handle is None:
            return
        if os.name == "nt":  # there a file can't be removed while it is open
            os.close(self._handle)
        with suppress(OSError):
            self._path.unlink(missing_ok=True)
            self._path.parent.rmdir()
        if os.name != "nt":
            os.close(self._handle)
        self._handle = None


def is_at(handle: int, path: Path) -> bool:
    """Whether an open file, or folder, has this name: another process may have removed it since."""
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False


if sys.platform == "win32":
    import msvcrt

    def hold(handle: int) -> bool:
        """Hold an open file until it is closed; whether no other process does."""
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def hold(handle: int) -> bool:
        """Hold an open file or folder until it is closed; whether no other process does.

        Raises
        ------
        OSError
            The file system has no locks.
        """
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
