"""The archive of an SSP: what it holds, by the URIs of its descriptions, and nothing outside it."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from urllib.parse import unquote, urlsplit

from cosim.errors import nearest
from cosim.fmi.fmu_file import MOST_UNPACKED_BYTES
from cosim.ssp.schema import SSPError

#: XML files that are larger are refused: they would not fit into memory once decoded.
MOST_XML_BYTES = 64 * 1024**2


class Package(AbstractContextManager["Package"]):
    """An SSP archive, open for reading.

    Raises
    ------
    SSPError
        There is no such file, or it is no archive, or one that unpacks to more than any system needs.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_file():
            raise SSPError(f"{path}: there is no such SSP; check the path")
        try:
            self._archive = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError) as error:
            raise SSPError(f"{path}: not an SSP (not a readable zip archive: {error})") from None
        unpacked = sum(info.file_size for info in self._archive.infolist())
        if unpacked > MOST_UNPACKED_BYTES:
            self._archive.close()
            raise SSPError(f"{path}: unpacks to {unpacked} bytes, more than any system needs; not opened")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._archive.close()

    def read_xml(self, uri: str, inside: str | None = None) -> bytes:
        """An XML file, by its URI in the description; inside an FMU of the archive where that is named.

        Raises
        ------
        SSPError
            The archive has no such file, or it is too large.
        """
        if inside is None:
            return self._read(self._archive, uri, f"{self.path}", MOST_XML_BYTES)
        fmu = self._read(self._archive, inside, f"{self.path}", MOST_UNPACKED_BYTES)
        try:
            with zipfile.ZipFile(io.BytesIO(fmu)) as archive:
                return self._read(archive, uri, f"{self.path}: {inside}", MOST_XML_BYTES)
        except zipfile.BadZipFile:
            raise SSPError(f"{self.path}: {inside} is not an FMU (not a zip archive)") from None

    def extract(self, uri: str, folder: Path) -> Path:
        """Write a file of the archive below a folder; returns its path.

        Raises
        ------
        SSPError
            The archive has no such file, or the folder can't be written.
        """
        target = folder / member_name(uri, f"{self.path}")
        if not target.exists():
            data = self._read(self._archive, uri, f"{self.path}", MOST_UNPACKED_BYTES)
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            except OSError as error:
                raise SSPError(f"{self.path}: can't unpack {uri} into {folder}: {error}; free some space") from error
        return target

    def _read(self, archive: zipfile.ZipFile, uri: str, where: str, most: int) -> bytes:
        name = member_name(uri, where)
        try:
            info = archive.getinfo(name)
        except KeyError:
            hint = nearest(name, [n for n in archive.namelist() if not n.endswith("/")])
            raise SSPError(f"{where}: has no '{name}'; {hint}") from None
        if info.file_size > most:
            raise SSPError(f"{where}: '{name}' has {info.file_size} bytes, more than any such file needs; not opened")
        try:
            return archive.read(info)
        except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, EOFError, ValueError) as error:
            raise SSPError(f"{where}: '{name}' can't be unpacked: {error}") from None


def member_name(uri: str, where: str) -> str:
    """Name in the archive of a relative URI.

    Raises
    ------
    SSPError
        The URI leads out of the archive.
    """
    parts = urlsplit(uri)
    name = re.sub(r"^(\./)+", "", unquote(parts.path))
    steps = name.split("/")
    if parts.scheme or parts.netloc or parts.fragment or not name or ".." in steps or "" in steps:
        raise SSPError(f"{where}: '{uri}' is no file of this archive; sources must be relative, as resources/x.fmu")
    if re.search(r'[\\:*?"<>|\x00-\x1f]', name):  # these mean something else, or nothing, to some file systems
        raise SSPError(f"{where}: '{uri}' has characters that no file name should have; rename the file")
    return name
