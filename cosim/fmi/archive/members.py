"""The members of a zip archive, checked against its own headers and against limits before one of them is unpacked.

A zip archive says everything twice, in its directory at the end and before each member, and readers differ in which of
the two they believe. Here both have to agree, so that what was checked is what is unpacked.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path, PurePosixPath
from types import TracebackType

from cosim.errors import SetupError
from cosim.fmi.archive.findings import FileFindings, quoted

#: An archive that unpacks to more than this is refused: no co-simulation FMU is so large, but zip bombs are.
MOST_UNPACKED_BYTES = 4 * 1024**3

#: An archive that unpacks to more than so many bytes, and to so many times its packed size, is one, too.
_SUSPECT_BYTES, _SUSPECT_RATIO = 64 * 1024**2, 200

#: Archives with more members, or a longer path, are refused.
_MOST_MEMBERS, _MOST_PATH, _MOST_NAME = 100_000, 1024, 255

#: Methods of compression that FMI has, and further ones that can be unpacked here.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_FURTHER_METHODS = (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)

#: Names that Windows keeps for devices.
_DEVICES = re.compile(r"(?:con|prn|aux|nul|com[1-9]|lpt[1-9]|conin\$|conout\$)(?:\..*)?", re.IGNORECASE)

#: Characters that no path in an archive may have, and those that Windows does not have in names.
_NEVER = re.compile(r"[\x00-\x1f\x7f\\:]")
_NOT_ON_WINDOWS = re.compile(r'[*?"<>|]|[. ]$')

#: Begin and size of the headers: end of the directory, its 64-bit pair, and a member.
_END, _END_SIZE = b"PK\5\6", 22
_LOCAL, _LOCAL_SIZE = b"PK\3\4", 30

_ENCRYPTED, _SIZES_FOLLOW, _UTF8 = 0x1, 0x8, 0x800

#: What zipfile raises for archives that are damaged or hostile.
UNREADABLE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    LookupError,
    NotImplementedError,
    OSError,
    OverflowError,
    RuntimeError,
    ValueError,
)


class ArchiveError(SetupError):
    """A file is not an archive, or one that is not unpacked; the text is to follow its name."""


class Members(AbstractContextManager["Members"]):
    """The members of an archive, open for reading.

    Parameters
    ----------
    path : Path
        The archive.
    what : str
        What it is, for messages.
    with_backslashes : bool
        Whether folders may be separated by backslashes, as a few tools write them.

    Raises
    ------
    BadZipFile
        It is not an archive.
    ArchiveError
        It is one that is not unpacked.
    """

    def __init__(self, path: Path, what: str = "FMU", *, with_backslashes: bool = False) -> None:
        self.findings = FileFindings()
        self._what = what
        counted = _check_directory(path)
        try:
            self.archive = zipfile.ZipFile(path)
        except zipfile.BadZipFile:
            raise
        except UNREADABLE as error:
            raise ArchiveError(f"its directory of members can't be read: {error}; get the {what} again") from None
        self.infos = self.archive.infolist()
        try:
            if counted not in (None, len(self.infos)):
                raise ArchiveError(
                    f"says that it has {counted} members, and has {len(self.infos)}; get the {what} again"
                )
            self._check_sizes()
            for info in self.infos:
                name = info.orig_filename.replace("\\", "/") if with_backslashes else info.orig_filename
                self._check_name(name)
                self._check_kind(info)
            self._check_headers()
            self._check_collisions()
            if self.findings.wrong:
                raise ArchiveError("; ".join(self.findings.wrong[:3]))
        except UNREADABLE as error:
            self.archive.close()
            raise ArchiveError(f"its members can't be read: {_in_words(error)}; get the {what} again") from None
        except BaseException:
            self.archive.close()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.archive.close()

    @property
    def names(self) -> list[str]:
        """Names of all members; those of folders end in a slash."""
        return [info.filename for info in self.infos]

    def read(self, name: str, most: int) -> bytes:
        """A member of at most so many bytes.

        Raises
        ------
        ArchiveError
            There is none of this name, it is larger, or damaged.
        """
        try:
            info = self.archive.getinfo(name)
        except KeyError:
            raise ArchiveError(f"has no {name}{self._elsewhere(name)}") from None
        if info.file_size > most:
            raise ArchiveError(f"its {name} has {info.file_size} bytes, more than any {self._what} needs; not opened")
        try:
            return self.archive.read(info)
        except UNREADABLE as error:
            raise ArchiveError(
                f"its {name} can't be unpacked: {_in_words(error)}; get the {self._what} again"
            ) from None

    def unpack(self, folder: Path) -> None:
        """Unpack all members into an empty folder; each is compared with its checksum.

        Raises
        ------
        ArchiveError
            A member is damaged, or the folder can't be written.
        """
        for info in self.infos:
            try:
                self.archive.extract(info, folder)
            except OSError as error:
                why = f"can't be unpacked into {folder}: {error.strerror or error}; free some space"
                raise ArchiveError(f"{quoted(info.filename)} {why}") from error
            except UNREADABLE as error:
                raise ArchiveError(
                    f"{quoted(info.filename)} can't be unpacked: {_in_words(error)}; get the {self._what} again"
                ) from error

    def _elsewhere(self, name: str) -> str:
        """Where else a member may be that is not where it should be, and the remedy."""
        if f"{name}/" in self.names or any(other.startswith(f"{name}/") for other in self.names):
            return f", but a folder of that name; get the {self._what} again"
        other = next((n for n in self.names if PurePosixPath(n).name.casefold() == name.casefold()), None)
        if other is None:
            return f"; it is not an {self._what}, or was packed wrongly"
        if "/" in other:
            return f" (it has {quoted(other)}); pack the content of the folder, not the folder"
        return f" (it has {quoted(other)}); rename it"

    # Checks

    def _check_sizes(self) -> None:
        if len(self.infos) > _MOST_MEMBERS:
            raise ArchiveError(f"has {len(self.infos)} members, more than any {self._what} needs; not opened")
        unpacked = sum(info.file_size for info in self.infos)
        packed = sum(info.compress_size for info in self.infos)
        bomb = unpacked > _SUSPECT_BYTES and unpacked > _SUSPECT_RATIO * packed
        if unpacked > MOST_UNPACKED_BYTES or bomb:
            times = f", {unpacked // max(1, packed)} times what is packed" if bomb else ""
            raise ArchiveError(f"unpacks to {unpacked} bytes{times}, more than any {self._what} needs; not opened")

    def _check_name(self, name: str) -> None:
        parts = name.removesuffix("/").split("/")
        why = (
            "is not a name of a file"
            if name in ("", "/") or "" in parts[1:]
            else "is an absolute path"
            if name.startswith("/")
            else "leads out of the archive"
            if ".." in parts
            else "has a drive letter, a backslash or a control character"
            if _NEVER.search(name)
            else "is longer than a file system takes"
            if len(name) > _MOST_PATH or any(len(os.fsencode(part)) > _MOST_NAME for part in parts if _is_text(part))
            else "has characters that are none"
            if not _is_text(name)
            else ""
        )
        if why:
            self.findings.add(wrong=f"can't be unpacked: the path {quoted(name)} in it {why}; pack it again")
            return
        if any(_DEVICES.fullmatch(part) or _NOT_ON_WINDOWS.search(part) for part in parts if part != "."):
            text = f"the path {quoted(name)} in it can't be written on Windows; rename the file"
            if os.name == "nt":
                self.findings.add(wrong=f"can't be unpacked: {text}")
            else:
                self.findings.add(unclean=text)

    def _check_kind(self, info: zipfile.ZipInfo) -> None:
        name = quoted(info.filename)
        mode = stat.S_IFMT(info.external_attr >> 16)
        if mode not in (0, stat.S_IFREG, stat.S_IFDIR):
            what = "a link" if mode == stat.S_IFLNK else "neither a file nor a folder"
            self.findings.add(wrong=f"can't be unpacked: {name} in it is {what}; pack the file itself")
        if info.flag_bits & _ENCRYPTED:
            self.findings.add(wrong=f"can't be unpacked: {name} in it is encrypted; get the {self._what} unencrypted")
        if info.compress_type in _FURTHER_METHODS:
            self.findings.add(unclean=f"{name} in it is compressed by another method than FMI has (deflate or none)")
        elif info.compress_type not in _METHODS:
            method = f"is compressed by method {info.compress_type}"
            self.findings.add(wrong=f"can't be unpacked: {name} in it {method}; pack it by deflate")

    def _check_headers(self) -> None:
        """What stands before each member is what the directory says of it, and no two members share their bytes."""
        file = self.archive.fp
        assert file is not None
        ends: list[tuple[int, int, str]] = []
        for info in self.infos:
            name = quoted(info.filename)
            wrong = f"can't be unpacked: {name} in it is not where its directory says, or another member; get it again"
            file.seek(max(0, info.header_offset))
            header = file.read(_LOCAL_SIZE)
            if len(header) < _LOCAL_SIZE or not header.startswith(_LOCAL):
                self.findings.add(wrong=wrong)
                continue
            flags, method, _, _, _, packed, unpacked, name_size, extra_size = struct.unpack("<2xHHHHIIIHH", header[4:])
            said = file.read(name_size).decode("utf-8" if flags & _UTF8 else "cp437", "replace")
            sizes = ((packed, info.compress_size), (unpacked, info.file_size))
            differ = not flags & _SIZES_FOLLOW and any(a not in (b, 0xFFFFFFFF) for a, b in sizes)
            if said != info.orig_filename or method != info.compress_type or differ:
                self.findings.add(wrong=wrong)
            end = info.header_offset + _LOCAL_SIZE + name_size + extra_size + info.compress_size
            ends.append((info.header_offset, end, name))
        ends.sort()
        for k, (_, end, name) in enumerate(ends):
            if end > (ends[k + 1][0] if k + 1 < len(ends) else self.archive.start_dir):
                self.findings.add(wrong=f"can't be unpacked: {name} in it overlaps another member; get it again")

    def _check_collisions(self) -> None:
        """No two members have one path, here or where case does not count."""
        paths: dict[str, zipfile.ZipInfo] = {}
        loose: dict[str, str] = {}
        for info in self.infos:
            path = PurePosixPath(info.filename).as_posix()
            first = paths.setdefault(path, info)
            if first is not info:
                same = (first.CRC, first.file_size, first.is_dir()) == (info.CRC, info.file_size, info.is_dir())
                text = f"{quoted(path)} is there twice"
                self.findings.add(
                    wrong="" if same else f"can't be unpacked: {text}, with different contents; pack it again",
                    unclean=text if same else "",
                )
            known = loose.setdefault(unicodedata.normalize("NFC", path).casefold(), path)
            if known != path:
                text = f"{quoted(known)} and {quoted(path)} are one file where case does not count; rename one of them"
                ambiguous = os.path.normcase("A") == "a"
                self.findings.add(wrong=f"can't be unpacked: {text}" if ambiguous else "", unclean=text)
        files = {path for path, info in paths.items() if not info.is_dir()}
        for path in paths:
            above = next((p for p in PurePosixPath(path).parents if p.as_posix() in files), None)
            if above is not None:
                self.findings.add(
                    wrong=f"can't be unpacked: {quoted(above)} is both a file and a folder in it; pack it again"
                )


def _check_directory(path: Path) -> int | None:
    """Refuse a directory of members that would fill the memory, before it is read; how many it says that there are."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _END_SIZE - 0xFFFF))
        tail = file.read()
    for place in _places(tail, _END):
        if len(tail) - place >= _END_SIZE:
            disk, first, here, members, length = struct.unpack("<HHHHI", tail[place + 4 : place + 16])
            if (disk, first) not in ((0, 0), (0xFFFF, 0xFFFF)) or here != members:
                raise ArchiveError("is a part of an archive in several; join them")
            if length != 0xFFFFFFFF and length > _MOST_MEMBERS * (_MOST_PATH // 4):
                raise ArchiveError(f"has a directory of members of {length} bytes; not opened")
            return members if members != 0xFFFF else None
    return None


def _places(data: bytes, what: bytes) -> Iterator[int]:
    place = data.rfind(what)
    while place >= 0:
        yield place
        place = data.rfind(what, 0, place)


def _is_text(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _in_words(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
