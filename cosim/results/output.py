"""A folder that holds the results of one run: they come into it together, and lose nothing when it can't take them."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any, Self

from cosim.errors import CosimError
from cosim.files.locks import FileLock
from cosim.files.whole import PART, part_of, sync, whole_of, write_json, write_whole

#: The file that says how a run was made, and which files of the folder belong to it.
SUMMARY = "summary.json"

#: Status in the summary of a run that is whole.
COMPLETED = "completed"

#: Folder of files that are not complete yet.
_UNFINISHED = ".unfinished"

#: Folders in there: for files that are being written, and for all files of a run, about to get their places.
_NEW, _WHOLE = "new", "whole"

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


def clear_unfinished(folder: Path) -> list[Path]:
    """Remove what a process that is gone has left of files that were not whole; those that outlast it are returned."""
    unfinished = folder / _UNFINISHED
    lock = FileLock(unfinished / "lock")
    if not unfinished.is_dir() or not lock.acquire():  # another run has the folder now
        return []
    if not (unfinished / _WHOLE).is_dir():  # else the next run places what is there
        shutil.rmtree(unfinished / _NEW, ignore_errors=True)
    lock.release()
    return sorted(folder.glob(f"results.*{PART}"))


def amend_summary(summary: Path, said: Mapping[str, Any], hashes: Mapping[str, str] | None = None) -> None:
    """Add entries to the summary of a run, and the SHA-256 of files that have changed.

    Raises
    ------
    OSError
        It can't be written; it is as it was.
    """
    known = _read(summary)
    data = {**known, **said, "files": {**known.get("files", {}), **(hashes or {})}}
    write_whole(summary, lambda path: write_json(path, data))


class ResultFolder:
    """The folder of one run, as a context; `put` writes the results.

    `summary.json` lists the files that belong to the run, each with its SHA-256, and is written last. Files of an
    earlier run make room for those of this one; no other file is replaced or removed, nor is one that was changed after
    that run. While the context lasts, no other run can have the folder.

    What a process has begun to place that was killed meanwhile, the next one places.

    Parameters
    ----------
    folder : Path
    names : iterable of str
        Names that are known to be written, to refuse them before anything is computed.
    overwrite : bool
        Whether files may be replaced that belong to no run.
    resumes : bool
        Whether the run goes on from a checkpoint, which has all that a killed run had recorded.

    Attributes
    ----------
    folder : Path
    unfinished : Path
        Folder for files of the run until `put` gives them their places.
    holds_whole_run : bool
        Whether it has the results of an earlier run that ended well.
    killed : list of Path
        What earlier runs had recorded that were killed, under names that nothing else takes.

    Raises
    ------
    OutputError
        The folder can't be written, is in use, or holds something else.
    """

    def __init__(
        self, folder: Path, names: Iterable[str] = (), *, overwrite: bool = False, resumes: bool = False
    ) -> None:
        self.folder = folder
        self.unfinished = folder / _UNFINISHED / _NEW
        self.killed: list[Path] = []
        self._whole = folder / _UNFINISHED / _WHOLE
        self._journal = folder / _UNFINISHED / "places.json"  # of these
        self._names = tuple(names)
        self._overwrite, self._resumes = overwrite, resumes
        self._lock = FileLock(folder / _UNFINISHED / "lock")
        self._owned: dict[str, str | None] = {}  # files of earlier runs, with their SHA-256
        self.holds_whole_run = self._lists_none = False
        self._hashes: dict[Path, str] = {}
        self._ending: str | None = None  # of the names of what was put

    def __enter__(self) -> Self:
        check_writable(self.folder)
        for name, what in _OTHERS.items():
            if (self.folder / name).is_file():
                raise OutputError(f"{self.folder} holds {what}; choose another --out")
        if not self._lock.acquire():
            raise OutputError(f"another run is writing into {self.folder}; wait for it, or choose another --out")
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

    def grow(self) -> Path:
        """Folder for files with `.part` that have to outlast a kill; those of an earlier run that was not whole go."""
        for name in [name for name in self._owned if name.endswith(PART)]:
            (self.folder / name).unlink(missing_ok=True)
            del self._owned[name]
        return self.folder

    # What earlier runs have left

    def _take_over(self) -> None:
        """Finish or clear away what a killed run has left, and find out which files are those of an earlier one."""
        if self._whole.is_dir() and self._journal.is_file():
            self._go_on_placing()
        for left in (self.unfinished, self._whole):
            shutil.rmtree(left, ignore_errors=True)
        self.unfinished.mkdir()
        self._find_owned()
        self._set_aside()
        for name in self._names:
            if reason := self._obstacle(name):
                raise OutputError(f"{reason}; choose another --out, move it away, or --overwrite it")

    def _go_on_placing(self) -> None:
        """Place the files of a run that was killed when it was about to, unless something else stands there now."""
        journal = _read(self._journal)
        for name in journal["names"]:
            target = self.folder / name
            if not (self._whole / name).is_file() or not _exists(target) or journal["overwrite"]:
                continue
            if name not in journal["replaced"] or not _is_unchanged(target, journal["replaced"][name]):
                kept = Path(tempfile.mkdtemp(prefix="results-of-cosim-", dir=self.folder))
                self._whole.replace(kept)
                self.killed.append(kept)
                return
        self._place()

    def _find_owned(self) -> None:
        summary = self.folder / SUMMARY
        known: dict[str, str | None] = {}
        if _exists(summary):
            said = _read(summary)
            if "files" in said:
                known = _listed(said)
            elif "versions" in said:  # version 0.1.0 lists none
                known, self._lists_none = {path.name: None for path in self.folder.glob("results.*")}, True
            elif not self._overwrite or not summary.is_file():
                raise OutputError(
                    f"{summary} is there and not that of a run; choose another --out, move it away, or --overwrite it"
                )
            known[SUMMARY] = None
            self.holds_whole_run = said.get("status", COMPLETED) == COMPLETED
        if "files" in (said := _read(part_of(summary))):
            known |= {**_listed(said), part_of(summary).name: None}
        self._owned = {name: sha for name, sha in known.items() if _is_unchanged(self.folder / name, sha)}

    def _set_aside(self) -> None:
        """Give what killed runs had recorded names that no run takes."""
        for part in sorted(self.folder.glob(f"results.*{PART}")):
            if part.name in self._owned or not part.is_file():
                continue
            if self._overwrite or self._resumes:
                part.unlink()
                continue
            number = 1
            while _exists(kept := part.with_name(f"killed-{number}-{part.name}")):
                number += 1
            part.replace(kept)
            self.killed.append(kept)

    def _obstacle(self, name: str) -> str:
        """Why a file can't have its place; empty when it can."""
        path = self.folder / name
        if not _exists(path) or name in self._owned:
            return ""
        if path.is_file() and (self._lists_none or self._overwrite):
            return ""
        return f"{path} is there and belongs to no run, or was changed after it"

    def _leave(self) -> None:
        if not self._whole.is_dir():  # else the next run has to place what is there
            shutil.rmtree(self.unfinished, ignore_errors=True)
            self._journal.unlink(missing_ok=True)
        self._lock.release()

    # What this one leaves

    def finish(self, path: Path) -> None:
        """Have a file that is whole on the disk, and hash it; `put` does so with all that this was not done for."""
        sync(path)
        self._hashes[path] = _sha256(path)

    def put(self, write: Callable[[Path], object], *, whole: bool = True) -> list[str]:
        """Call `write(folder)`, which writes all files of the run, and give them their places in one go.

        When that fails, they go into a fresh folder among the temporary files instead, and the results of an earlier
        run stay as they are.

        Parameters
        ----------
        write : callable
            Writes files into the folder that it gets, or into folders there, among them `summary.json`, if any; the
            list of files goes in there.
        whole : bool
            Whether the run is whole. One that is not leaves a whole one in the folder alone: its files get names with
            `.part` then.

        Returns
        -------
        list of str
            Names of all files in the folder.

        Raises
        ------
        OutputError
            The folder can't take them; the message names the one that holds everything, or says that none could be
            written.
        """
        grown = list(_files(self.unfinished))
        cause: OSError | None = None
        self._hashes.clear()
        ending = PART if self.holds_whole_run and not whole else ""
        try:
            write(self.unfinished)
            names = self._list_files(self.unfinished, ending)
            problem = next(filter(None, map(self._obstacle, names)), "")
            if not problem:
                self._commit(names, ending)
        except OSError as error:
            cause, problem = error, error.strerror or str(error)
        if problem:
            raise OutputError(f"can't write into {self.folder}: {problem}; {self._rescued(write, grown)}") from cause
        self._place()
        self._ending = ending
        return names

    def path_of(self, name: str) -> Path:
        """Path of a file of the run, before or after it was put."""
        return self.unfinished / name if self._ending is None else self.folder / f"{name}{self._ending}"

    def amend(self, said: Mapping[str, Any], names: Iterable[str], write: Callable[[Path], object]) -> None:
        """Add to the summary that was put, and have `write(folder)` write files anew that are not results.

        Parameters
        ----------
        said : mapping
            Entries of the summary.
        names : iterable of str
            Files that have changed where they are, if they are there.
        write : callable

        Raises
        ------
        OSError
            The folder can't take it; the results are as they were.
        """
        if self._ending is None:  # all is elsewhere
            return
        write(self.unfinished)
        changed = [self.path_of(name) for name in names]
        changed += [path.replace(self.path_of(path.name)) for path in list(_files(self.unfinished))]
        hashes = {path.name: _sha256(path) for path in changed if path.is_file()}
        amend_summary(self.path_of(SUMMARY), said, hashes)

    def _rescued(self, write: Callable[[Path], object], grown: list[Path]) -> str:
        """Write into another folder, into which files that have grown are moved; says how that went."""
        moved = ""
        self._hashes.clear()
        try:
            rescue = Path(tempfile.mkdtemp(prefix="results-of-cosim-", dir=self.folder if grown else None))
            for path in grown:
                (path if path.is_file() else path.with_name(path.name + PART)).replace(rescue / path.name)
                moved = f"; what was recorded is in {rescue}"
            write(rescue)
            self._list_files(rescue)
        except OSError as second:
            moved = moved or self._left_beside()
            return f"nor {'beside it' if grown else 'among the temporary files'}: {second}; free some space{moved}"
        return f"the results are in {rescue}"

    def _left_beside(self) -> str:
        """Leave what could be written of the results beside those of the earlier run; says so."""
        beside = []
        for path in self.unfinished.glob("results.*"):
            part = part_of(self.folder / whole_of(path).name)
            with suppress(OSError):
                path.replace(part)
                beside.append(str(part))
        return f"; what could be written is in {', '.join(beside)}" if beside else ""

    def _list_files(self, folder: Path, ending: str = "") -> list[str]:
        """Give all files in a folder names with an ending, and write names and hashes into the summary there.

        Returns the names, that of the summary last.
        """
        paths = sorted(path for path in _files(folder) if path != folder / SUMMARY)
        for path in paths:
            if path not in self._hashes:
                self.finish(path)
        if ending:
            for path in filter(Path.is_file, (*paths, folder / SUMMARY)):
                path.replace(path.with_name(path.name + ending))
        files = {path.relative_to(folder).as_posix() + ending: self._hashes[path] for path in paths}
        summary = folder / f"{SUMMARY}{ending}"
        write_json(summary, {**_read(summary), "files": files})
        for path in {summary, folder, *(path.parent for path in paths)}:
            sync(path)
        return [*files, summary.name]

    def _commit(self, names: list[str], ending: str) -> None:
        """Say where all files go, and that they are whole: from here on they get there, if need be by the next run.

        A run that is not whole replaces such a one only.
        """
        replaced = {n: sha for n, sha in self._owned.items() if not ending or n.endswith(ending)}
        overwrite = self._overwrite or self._lists_none
        write_json(self._journal, {"names": names, "replaced": replaced, "overwrite": overwrite})
        sync(self._journal)
        self.unfinished.replace(self._whole)
        sync(self._whole.parent)

    def _place(self) -> None:
        """Remove the files of the earlier run, and give those of this one their places, its summary last.

        Without a summary, as in between, the folder holds no whole run.
        """
        journal = _read(self._journal)
        names = list(journal["names"])
        if (self._whole / names[-1]).is_file():  # else a killed run has placed it, and all the others
            (self.folder / names[-1]).unlink(missing_ok=True)
        for name in journal["replaced"].keys() - names:
            (self.folder / name).unlink(missing_ok=True)
            self._remove_empty((self.folder / name).parent)
        for name in names:
            source, target = self._whole / name, self.folder / name
            if source.is_file():
                target.parent.mkdir(parents=True, exist_ok=True)
                source.replace(target)
        sync(self.folder)
        shutil.rmtree(self._whole, ignore_errors=True)
        self._journal.unlink(missing_ok=True)
        self._owned = dict.fromkeys(names)
        self.unfinished.mkdir(exist_ok=True)

    def _remove_empty(self, folder: Path) -> None:
        while folder != self.folder:
            try:
                folder.rmdir()
            except OSError:  # something else is in it
                return
            folder = folder.parent


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
