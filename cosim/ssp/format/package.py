"""The files of an SSP, in an archive or in a folder, found by the URIs of its descriptions."""

from __future__ import annotations

import io
import posixpath
import re
import unicodedata
import zipfile
from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from urllib.parse import SplitResult, parse_qs, unquote, urlsplit
from urllib.request import url2pathname

from cosim.errors import nearest
from cosim.files.kinds import FMU, SSP, kind_of, not_read
from cosim.fmi.archive.members import MOST_UNPACKED_BYTES, UNREADABLE, ArchiveError, Members
from cosim.ssp.errors import SSPError
from cosim.system.read import Findings

#: The description of an SSP that has several.
DESCRIPTION = "SystemStructure.ssd"

#: XML files that are larger are refused: they would not fit into memory once decoded.
MOST_XML_BYTES = 64 * 1024**2

#: Remedies for sources that are no files of this machine.
_REMEDIES = {
    "http": "download it and give its path",
    "https": "download it and give its path",
    "proxyfmu": "it is meant for libcosim's proxies on another machine; give the path of the FMU itself",
}


class Package(AbstractContextManager["Package"], ABC):
    """The files of an SSP.

    Attributes
    ----------
    path : Path
        Of the archive or folder, for messages.
    findings : Findings
        Takes notes of sources that were found in another way than they are written.
    """

    #: Kind of the package, for messages.
    kind = "archive"

    def __init__(self, path: Path, findings: Findings) -> None:
        self.path = path
        self.findings = findings
        self._others: list[Package] = []

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the archive, if it is one."""
        for other in self._others:
            other.close()

    def close_with_it(self, other: Package) -> None:
        """Close another package, too, when this one is closed."""
        self._others.append(other)

    @abstractmethod
    def where(self, name: str) -> str:
        """A file of the package, for messages."""

    @abstractmethod
    def read(self, name: str, most: int) -> bytes:
        """A file by its name; at most so many bytes."""

    @abstractmethod
    def unpack(self, name: str, folder: Path) -> Path:
        """Path of a file by its name; it is written below the folder if it is in an archive."""

    @abstractmethod
    def _names(self) -> list[str]:
        """Names of all files."""

    @abstractmethod
    def _found(self, name: str) -> str | None:
        """A name as the package has it, if it does."""

    def name_of(self, uri: str, base: str) -> str:
        """Name of the file that a URI stands for.

        Parameters
        ----------
        uri : str
            Relative to the description that has it, or with the scheme `file`.
        base : str
            Name of that description.

        Raises
        ------
        SSPError
            There is no such file, or it is not one of this package.
        """
        parts = self._split(uri)
        if (
            parts.scheme == "proxyfmu"
            and parts.netloc in ("", "localhost")
            and (file := parse_qs(parts.query).get("file"))
        ):
            self.findings.note(f"{self.path}: '{uri}' is for a process of its own; the FMU runs in this one", "proxies")
            uri, parts = file[0], self._split(file[0])
        if parts.scheme:
            return self._outside(uri, parts)
        folder = posixpath.dirname(base)
        candidates = [posixpath.normpath(posixpath.join(folder, text)) for text in (unquote(parts.path), uri)]
        candidates += [posixpath.normpath(posixpath.join(folder, c.replace("\\", "/"))) for c in (parts.path, uri)]
        for name in candidates:
            if self._inside(name) and (found := self._found(name)) is not None:
                return self._checked(found, uri)
        if not self._inside(candidates[0]):
            raise self.findings.error(
                f"{self.path}: '{uri}' is not a file of this {self.kind}; sources must be relative, as resources/x.fmu"
            )
        loose = {_loose(name): name for name in self._names()}
        if _loose(candidates[0]) in loose:
            found = loose[_loose(candidates[0])]
            self.findings.note(f"{self.path}: '{uri}' is written '{found}' in the {self.kind}; it is taken", "spelling")
            return self._checked(found, uri)
        raise self.findings.error(f"{self.path}: has no '{candidates[0]}'; {nearest(candidates[0], self._names())}")

    def read_xml(self, name: str, inside: str | None = None) -> bytes:
        """An XML file; one of an FMU of the package, where that is named.

        Raises
        ------
        SSPError
            There is no such file, or it is too large.
        """
        if inside is None:
            return self.read(name, MOST_XML_BYTES)
        fmu = self.read(inside, MOST_UNPACKED_BYTES)
        try:
            with zipfile.ZipFile(io.BytesIO(fmu)) as archive:
                return _read(archive, posixpath.normpath(unquote(name)), f"{self.path}: {inside}", MOST_XML_BYTES)
        except UNREADABLE:
            raise self.findings.error(f"{self.path}: {inside} is not an FMU (not a zip archive)") from None

    def _inside(self, name: str) -> bool:
        return not (name.startswith(("/", "../")) or name in ("", ".", ".."))

    def _checked(self, name: str, uri: str) -> str:  # noqa: ARG002
        return name

    def _split(self, uri: str) -> SplitResult:
        """Parts of a URI; what only looks like one, as C:/x.fmu, is a path that no other machine has."""
        remedy = "sources must be relative, as resources/x.fmu"
        if re.match(r"[A-Za-z]:[\\/]", uri):
            raise self.findings.error(f"{self.path}: '{uri}' is not a file of this {self.kind}; {remedy}")
        try:
            return urlsplit(uri)
        except ValueError as error:
            raise self.findings.error(f"{self.path}: '{uri}' is not a URI: {error}; {remedy}") from None

    def _outside(self, uri: str, parts: SplitResult) -> str:
        """A file that is not in the package, but on this machine."""
        if parts.scheme != "file" or parts.netloc not in ("", "localhost"):
            remedy = _REMEDIES.get(parts.scheme, "sources must be relative, as resources/x.fmu")
            raise self.findings.error(f"{self.path}: '{uri}' is not a file of this {self.kind}; {remedy}")
        path = Path(url2pathname(parts.path))
        if not path.is_file():
            raise self.findings.error(f"{self.path}: there is no file '{path}' for '{uri}'; correct the source")
        self.findings.note(f"{self.path}: '{uri}' is not in the {self.kind}; it is taken from this machine")
        return str(path)


class Archive(Package):
    """An SSP archive, open for reading.

    Raises
    ------
    SSPError
        There is no such file, or it is not an archive, or one that unpacks to more than any system needs.
    """

    def __init__(self, path: Path, findings: Findings, said: Path | None = None) -> None:
        super().__init__(said or path, findings)
        if not path.is_file():
            raise SSPError(f"{path}: there is no such SSP; check the path")
        try:
            self._archive = Members(path, "system", with_backslashes=True).archive
        except ArchiveError as error:
            raise SSPError(f"{self.path}: {error}") from None
        except (zipfile.BadZipFile, OSError) as error:
            why = f"not an SSP (not a readable zip archive: {error})"
            raise SSPError(not_read(path, "an SSP", why, SSP)) from None
        if DESCRIPTION not in self._archive.namelist() and kind_of(path) is FMU:
            self._archive.close()
            raise SSPError(not_read(path, "an SSP", ""))
        # a few tools separate folders by backslashes
        self._members = {_clean(n): n for n in self._archive.namelist() if not n.endswith(("/", "\\"))}

    def close(self) -> None:
        """Close the archive."""
        super().close()
        self._archive.close()

    def where(self, name: str) -> str:
        """A file of the archive, for messages."""
        return f"{self.path}: {name}"

    def read(self, name: str, most: int) -> bytes:
        """A file by its name; at most so many bytes.

        Raises
        ------
        SSPError
            It is missing, too large, or can't be unpacked.
        """
        if Path(name).is_absolute():
            return _read_file(Path(name), most)
        return _read(self._archive, self._members.get(name, name), f"{self.path}", most)

    def unpack(self, name: str, folder: Path) -> Path:
        """Write a file below a folder; returns its path.

        Raises
        ------
        SSPError
            It can't be read, or the folder can't be written.
        """
        if Path(name).is_absolute():
            return Path(name)
        target = folder / name
        if not target.exists():
            data = self.read(name, MOST_UNPACKED_BYTES)
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            except OSError as error:
                raise SSPError(f"{self.path}: can't unpack {name} into {folder}: {error}; free some space") from error
        return target

    def _checked(self, name: str, uri: str) -> str:
        if re.search(r'[\\:*?"<>|\x00-\x1f]', name):  # these mean something else, or nothing, to some file systems
            raise SSPError(f"{self.path}: '{uri}' has characters that no file name should have; rename the file")
        return name

    def _names(self) -> list[str]:
        return list(self._members)

    def _found(self, name: str) -> str | None:
        return name if name in self._members else None


class Folder(Package):
    """A folder with the files of an SSP that is not packed; its descriptions may name files outside it."""

    kind = "folder"

    def where(self, name: str) -> str:
        """A file of the folder, for messages."""
        return str(self.path / name)

    def read(self, name: str, most: int) -> bytes:
        """A file by its name; at most so many bytes.

        Raises
        ------
        SSPError
            It is missing, too large, or can't be read.
        """
        return _read_file(self.path / name, most)

    def unpack(self, name: str, folder: Path) -> Path:  # noqa: ARG002
        """Path of a file, which stays where it is."""
        return self.path / name

    def _names(self) -> list[str]:
        return [
            file.relative_to(self.path).as_posix()
            for pattern in ("*.*", "resources/*.*", "resources/*/*.*")
            for file in sorted(self.path.glob(pattern))[:1000]
            if file.is_file()
        ]

    def _found(self, name: str) -> str | None:
        return name if (self.path / name).is_file() else None

    def _inside(self, name: str) -> bool:
        return name not in ("", ".", "..")


def open_package(path: Path, findings: Findings) -> tuple[Package, str]:
    """The package of an archive, a folder or a single description, and the name of the description.

    Raises
    ------
    SSPError
        There is none.
    """
    if path.is_dir():
        if not (path / DESCRIPTION).is_file():
            raise SSPError(f"{path}: has no {DESCRIPTION}, nor OspSystemStructure.xml; name a folder with one of them")
        return Folder(path, findings), DESCRIPTION
    if path.suffix.lower() == ".ssd":
        if not path.is_file():
            raise SSPError(f"{path}: there is no such description; check the path")
        return Folder(path.parent, findings), path.name
    package = Archive(path, findings)
    return package, DESCRIPTION


def _clean(name: str) -> str:
    return posixpath.normpath(name.replace("\\", "/"))


def _loose(name: str) -> str:
    """A name without what systems of files treat differently: case, and how letters with accents are composed."""
    return unicodedata.normalize("NFC", name).casefold()


def _read(archive: zipfile.ZipFile, name: str, where: str, most: int) -> bytes:
    try:
        info = archive.getinfo(name)
    except KeyError:
        hint = nearest(name, [n for n in archive.namelist() if not n.endswith("/")])
        raise SSPError(f"{where}: has no '{name}'; {hint}") from None
    if info.file_size > most:
        raise SSPError(f"{where}: '{name}' has {info.file_size} bytes, more than any such file needs; not opened")
    try:
        return archive.read(info)
    except UNREADABLE as error:
        raise SSPError(f"{where}: '{name}' can't be unpacked: {error}") from None


def _read_file(path: Path, most: int) -> bytes:
    try:
        size = path.stat().st_size
        if size > most:
            raise SSPError(f"{path}: has {size} bytes, more than any such file needs; not opened")
        return path.read_bytes()
    except OSError as error:
        raise SSPError(f"{path}: can't be read: {error.strerror or error}; check the path") from None
