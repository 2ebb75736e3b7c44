"""A folder that holds the results of one run: they come into it together, and lose nothing when it can't take them."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any, Self

from cosim.errors import CosimError

#: The file that says how a run was made, and which files of the folder belong to it.
SUMMARY = "summary.json"

#: Folder of files that are not complete yet.
_UNFINISHED = ".unfinished"

#: Other owners of whole folders: file that marks it -> its name.
_OTHERS = {"sweep.json": "a sweep"}


class OutputError(CosimError):
    """Results can't be written where they should; the message says where they are instead."""


def check_writable(folder: Path) -> None:
    """Make a folder and write into it, before anything is computed.

    Raises
    ------
    OutputError
        It can't be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as stream:
            stream.write(b"can this folder be written?")
    except OSError as error:
        raise OutputError(f"can't write into {folder}: {error.strerror or error}; choose another --out") from error


class ResultFolder:
    """The folder of one run, as a context; `put` writes the results.

    `summary.json` lists the files that belong to the run, each with its SHA-256. Those of an earlier run make room for
    those of this one; no other file is replaced or removed, nor is one that was changed after that run. While the
    context lasts, no other run can have the folder.

    Parameters
    ----------
    folder : Path
    names : iterable of str
        Names that are known to be written, to refuse them before anything is computed.

    Attributes
    ----------
    folder : Path
    unfinished : Path
        Folder for files that grow during the run; `put` gives them their places, too.

    Raises
    ------
    OutputError
        The folder can't be written, is in use, or holds something else.
    """

    def __init__(self, folder: Path, names: Iterable[str] = ()) -> None:
        self.folder = folder
        self.unfinished = folder / _UNFINISHED / "new"
        self._names = tuple(names)
        self._lock = _Lock(folder / _UNFINISHED / "lock")
        self._owned: frozenset[str] = frozenset()  # files of the earlier run
        self._lists_none = False  # the earlier run has none listed
        self._hashes: dict[Path, str] = {}

    def __enter__(self) -> Self:
        check_writable(self.folder)
        for name, what in _OTHERS.items():
            if (self.folder / name).is_file():
                raise OutputError(f"{self.folder} holds {what}; choose another --out")
        self._lock.acquire()
        try:
            self._take_over()
        except BaseException:
            self._leave()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leave()

    def _take_over(self) -> None:
        """Clear away what a killed run has left, and find out which files are those of an earlier one."""
        shutil.rmtree(self.unfinished, ignore_errors=True)
        self.unfinished.mkdir()
        summary = self.folder / SUMMARY
        if _exists(summary):
            said = _read(summary)
            if "files" in said:
                known = _listed(said)
            elif "versions" in said:  # version 0.1.0 lists none
                known, self._lists_none = {path.name: None for path in self.folder.glob("results.*")}, True
            else:
                raise OutputError(f"{summary} is there and not that of a run; choose another --out, or move it away")
            self._owned = frozenset(name for name, sha in known.items() if _is_unchanged(self.folder / name, sha))
        for name in self._names:
            if reason := self._obstacle(name):
                raise OutputError(f"{reason}; choose another --out, or move it away")

    def _obstacle(self, name: str) -> str:
        """Why a file can't have its place; empty when it can."""
        path = self.folder / name
        if not _exists(path) or name in self._owned or (self._lists_none and path.is_file()):
            return ""
        return f"{path} is there and belongs to no run, or was changed after it"

    def _leave(self) -> None:
        shutil.rmtree(self.unfinished, ignore_errors=True)
        self._lock.release()

    def hash(self, path: Path) -> None:
        """Hash a file that is whole; `put` does so with all others, but this one may be hashed beside other work."""
        self._hashes[path] = _sha256(path)

    def put(self, write: Callable[[Path], object]) -> None:
        """Call `write(folder)`, which writes all files of the run, and give them their places in one go.

        When that fails, they go into a fresh folder among the temporary files instead, and the results of an earlier
        run stay as they are.

        Parameters
        ----------
        write : callable
            Writes files into the folder that it gets, or into folders there, among them `summary.json`, if any; the
            list of files goes in there.

        Raises
        ------
        OutputError
            The folder can't take them; the message names the one that holds everything, or says that none could be
            written.
        """
        grown = list(_files(self.unfinished))
        cause: OSError | None = None
        self._hashes.clear()
        try:
            write(self.unfinished)
            names = self._list_files(self.unfinished)
            problem = next(filter(None, map(self._obstacle, names)), "")
            if not problem:
                self._place(names)
        except OSError as error:
            cause, problem = error, error.strerror or str(error)
        if problem:
            raise OutputError(f"can't write into {self.folder}: {problem}; {self._rescued(write, grown)}") from cause

    def _rescued(self, write: Callable[[Path], object], grown: list[Path]) -> str:
        """Write into another folder, into which files that have grown are moved; says how that went."""
        moved = ""
        try:
            rescue = Path(tempfile.mkdtemp(prefix="cosim_results_", dir=self.folder if grown else None))
            for path in grown:
                path.replace(rescue / path.name)
                moved = f"; what was recorded is in {rescue}"
            write(rescue)
            self._list_files(rescue)
        except OSError as second:
            return f"nor {'beside it' if grown else 'among the temporary files'}: {second}; free some space{moved}"
        return f"the results are in {rescue}"

    def _list_files(self, folder: Path) -> list[str]:
        """Write the names and hashes of all files in a folder into its summary; returns the names."""
        paths = {path.relative_to(folder).as_posix(): path for path in sorted(_files(folder))}
        files = {name: self._hashes.get(path) or _sha256(path) for name, path in paths.items() if name != SUMMARY}
        write_json(folder / SUMMARY, {**_read(folder / SUMMARY), "files": files})
        return list(files)

    def _place(self, names: Iterable[str]) -> None:
        """Remove the files of the earlier run, and give those of this one their places."""
        for name in self._owned:
            (self.folder / name).unlink(missing_ok=True)
            self._remove_empty((self.folder / name).parent)
        # from here on the summary is that of this run: whatever else is there, is listed in it
        (self.unfinished / SUMMARY).replace(self.folder / SUMMARY)
        for name in names:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.unfinished / name).replace(self.folder / name)
        self._owned, self._lists_none = frozenset(names), False

    def _remove_empty(self, folder: Path) -> None:
        while folder != self.folder:
            try:
                folder.rmdir()
            except OSError:  # something else is in it
                return
            folder = folder.parent


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write indented JSON; floats round-trip.

    Raises
    ------
    OSError
        The file can't be written.
    """
    path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` with another name, see the file on the disk, and give it its name: it is there whole or not at all.

    Raises
    ------
    OSError
        The file can't be written; one of that name is as it was.
    """
    part = part_of(path)
    try:
        write(part)
        _sync(part, os.O_RDWR)
        part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    if os.name != "nt":  # there a folder can't be opened
        _sync(path.parent, os.O_RDONLY)


def part_of(path: Path) -> Path:
    """Name of a file until it is whole; a kill may leave it behind."""
    return path.with_name(f".{path.name}.part")


def _sync(path: Path, mode: int) -> None:
    handle = os.open(path, mode)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


# Which files belong to a run


def _listed(summary: Mapping[str, Any]) -> dict[str, str | None]:
    """Name -> SHA-256 of the files that a summary lists, as far as they can be in its folder."""
    files = summary["files"]
    known = files.items() if isinstance(files, dict) else ()
    return {name: sha for name, sha in known if isinstance(sha, str) and _is_inside(name)}


def _exists(path: Path) -> bool:
    """Whether there is something of that name, be it a link to nothing."""
    return path.is_symlink() or path.exists()


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return bool(path.parts) and not path.is_absolute() and ".." not in path.parts and "\\" not in name


def _is_unchanged(path: Path, sha256: str | None) -> bool:
    try:
        return path.is_file() and (sha256 is None or _sha256(path) == sha256)
    except OSError:
        return False


def _read(summary: Path) -> dict[str, Any]:
    """Contents of a summary; nothing if there is none, or another file of that name."""
    try:
        data = json.loads(summary.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if path.is_file())


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class _Lock:
    """A file that one process at a time holds; the system lets it go when the process ends, however it does."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle: int | None = None

    def acquire(self) -> None:
        """Make the file and hold it.

        Raises
        ------
        OutputError
            Another run holds it.
        """
        while self._handle is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            try:
                handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            except FileNotFoundError:  # the run before has just removed the folder
                continue
            if not _hold(handle):
                os.close(handle)
                raise OutputError(
                    f"another run is writing into {self._path.parent.parent}; wait for it, or choose another --out"
                )
            if self._is_there(handle):
                self._handle = handle
            else:
                os.close(handle)

    def _is_there(self, handle: int) -> bool:
        """Whether the file still has its name: the run before may have removed it."""
        try:
            return self._path.stat().st_ino == os.fstat(handle).st_ino
        except FileNotFoundError:
            return False

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


if sys.platform == "win32":
    import msvcrt

    def _hold(handle: int) -> bool:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _hold(handle: int) -> bool:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a file system without locks: then the user takes care
            return True
        return True
